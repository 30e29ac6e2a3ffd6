"""Films of runs' policies, made one at a time in a process of its own.

    path = Films().of(spec, policy, distribution_view(outcome).model_dump())     # an .mp4

Drawing takes seconds, and a graphics driver that crashes takes its process along.
"""

import json
import shutil
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

_MOST_KEPT = 32
_LONGEST_S = 180.0
_FPS = 25


class NoFilm(AdrError):
    """A film that cannot be made now."""

    code = "no_film"


class Films:
    """Makes films, and keeps the latest as files until it is closed."""

    def __init__(self) -> None:
        self._folder: Path | None = None  # made with the first film
        self._kept: dict[str, Path] = {}
        self._free = threading.Lock()
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
        if key in self._kept:
            return self._kept[key]
        if not self._free.acquire(blocking=key == self._making):
            raise NoFilm("another film is being made; ask again in some seconds")
        try:
            if key not in self._kept:
                self._making = key
                self._folder = self._folder or Path(tempfile.mkdtemp(prefix="adr_films_"))
                film = self._folder / f"{key}.mp4"
                film.write_bytes(_film(spec, policy, distribution))
                self._kept[key] = film
                if len(self._kept) > _MOST_KEPT:
                    self._kept.pop(next(iter(self._kept))).unlink()  # the oldest
            return self._kept[key]
        finally:
            self._making = ""
            self._free.release()

    def close(self) -> None:
        """Delete the films."""
        if self._folder is not None:
            shutil.rmtree(self._folder)


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
