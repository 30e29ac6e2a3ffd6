"""Cases of a long benchmark, kept as they end: it goes on where it was interrupted."""

import ast
import json
import os
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, TypeVar

import adr_service
from adr_service.json_values import sha256
from adr_service.whole_files import written_whole

Case = dict[str, Any]
Job = TypeVar("Job", bound=Hashable)


def all_cases(
    path: Path,
    origin: dict[str, Any],
    jobs: Sequence[Job],
    one: Callable[[Job], Case],
    job_of: Callable[[Case], Job],
    line: Callable[[Case], str],
) -> list[Case]:
    """The cases of all jobs, in their order.

    Those that the file of JSON at the path has are not computed again. The others are, as many at
    once as there are cores, and each is written there as it ends, and its line printed. The first
    error is raised when all others have ended. A file of another origin (method, seed, …) is set
    aside.
    """
    ended = _resumed(path, origin)
    done = {job_of(case) for case in ended}
    path.parent.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        begun = [pool.submit(one, job) for job in jobs if job not in done]
        try:
            for future in as_completed(begun):
                if future.exception() is not None:
                    continue
                ended.append(case := future.result())
                with written_whole(path) as part:
                    part.write_text(json.dumps({**origin, "cases": ended}, indent=1))
                print(line(case), flush=True)
        finally:
            for future in begun:
                future.cancel()
    for future in begun:
        future.result()
    found = {job_of(case): case for case in ended}
    return [found[job] for job in jobs]


def _resumed(path: Path, origin: dict[str, Any]) -> list[Case]:
    known = json.loads(path.read_text()) if path.exists() else {}
    if known and {name: known.get(name) for name in origin} != origin:
        other = sha256(path.read_bytes())[:12]
        path.rename(path.with_name(f"{path.stem}-{other}.json"))
        return []
    return known.get("cases", [])


def digest_of(*places: str) -> str:
    """Digest of what sources of this project do, whatever their comments and docstrings say: of
    files, and of all in folders."""
    root = Path(adr_service.__file__).parent.parent
    files = [file for place in places for file in (root / place).rglob("*.py")]
    files += [root / place for place in places if place.endswith(".py")]
    return sha256("".join(without_words(file.read_text()) for file in sorted(files)).encode())[:12]


def without_words(source: str) -> str:
    """The syntax tree of a module, as text, without its docstrings."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            is_said = ast.get_docstring(node, clean=False) is not None
            node.body = node.body[is_said:]
    return ast.dump(tree)
