"""Films of runs' policies, made one at a time in a process of its own.

    path = Films(Path("films")).of(spec, policy, distribution_view(outcome).model_dump())

Drawing takes seconds, and a graphics driver that crashes takes its process along.
"""

import json
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from adr_service.errors import AdrError, InvalidInput
from adr_service.json_values import canonical_json, sha256
from adr_service.specs import RunSpec
from adr_service.whole_files import written_whole

_MOST_KEPT = 32
_LONGEST_S = 180.0
_FPS = 25


class NoFilm(AdrError):
    """A film that cannot be made now."""

    code = "no_film"


class Films:
    """Makes films, and keeps the latest in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._free = folder, threading.Lock()
        self._making = ""  # the key of the film that is being made

    def of(self, spec: RunSpec, policy: bytes, distribution: dict[str, Any]) -> Path:
        """The film of a policy's episode in the mean of its training distribution.

        Beside it is an episode on the target, where that is simulated. Whoever asks for the film
        that is being made waits for it. Raises NoFilm while another one is made, and if it takes
        too long, InvalidInput for what cannot be drawn.
        """
        if spec.extension or getattr(spec.target, "effects", ()):
            raise InvalidInput("films show a task's own simulator; this run has effects beyond it")
        key = sha256(policy + canonical_json([spec.target.kind, distribution]).encode())
        film = self._folder / f"{key}.mp4"
        if film.exists():
            return film
        is_made_already = key == self._making
        if not self._free.acquire(blocking=is_made_already):
            raise NoFilm("another film is being made; ask again in some seconds")
        try:
            if is_made_already and not film.exists():
                raise NoFilm("the film could not be made; ask again for the reason")
            if not film.exists():
                self._making = key
                self._keep(film, _film(spec, policy, distribution))
        finally:
            self._making = ""
            self._free.release()
        return film

    def _keep(self, film: Path, content: bytes) -> None:
        self._folder.mkdir(exist_ok=True)
        with written_whole(film) as part:
            part.write_bytes(content)
        oldest_first = sorted(self._folder.glob("*.mp4"), key=lambda path: path.stat().st_mtime)
        for old in oldest_first[:-_MOST_KEPT]:
            old.unlink()


def _film(spec: RunSpec, policy: bytes, distribution: dict[str, Any]) -> bytes:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "policy").write_bytes(policy)
        (folder / "distribution").write_text(json.dumps(distribution))
        # -P: not an api of the folder in which the service was started
        command = [sys.executable, "-P", "-m", "api", "render", str(folder / "film.mp4")]
        command += ["--task", spec.task, "--fps", str(_FPS), "--policy", str(folder / "policy")]
        command += _world(spec, distribution, folder)
        try:
            done = subprocess.run(  # noqa: S603 - our own command
                command, capture_output=True, text=True, timeout=_LONGEST_S, check=False
            )
        except subprocess.TimeoutExpired as error:
            raise NoFilm(f"the film took longer than {_LONGEST_S:.0f} s") from error
        if done.returncode != 0:
            raise InvalidInput(f"there is no film: {done.stderr.strip()[-500:]}")
        return (folder / "film.mp4").read_bytes()


def _world(spec: RunSpec, distribution: dict[str, Any], folder: Path) -> Iterator[str]:
    """Options for what is filmed: source beside target, or the source alone if nothing is known."""
    yield from ("--variant", spec.variant)
    if spec.target.kind == "simulated":
        yield from ("--distribution", str(folder / "distribution"))
        return
    for parameter in distribution["parameters"]:
        yield from ("--set", f"{parameter['name']}={parameter['mean'][0]}")
