"""Films of runs' policies, made one at a time in a process of its own.

    path = Films(Path("films")).of(spec, policy, distribution_view(outcome).model_dump())

Drawing takes seconds, and a graphics driver that crashes takes its process along.
"""

import json
import logging
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import adr_service
from adr_service.errors import AdrError, InvalidInput
from adr_service.json_values import canonical_json, sha256
from adr_service.specs import RunSpec
from adr_service.whole_files import written_whole

log = logging.getLogger(__name__)
_MOST_KEPT = 32
_LONGEST_S = 180.0
_MOST_WAITING = 2  # for the film that is being made: each holds one of the service's threads
_REFUSED = 2  # the status of `adr` for a wrong input
_FPS = 25


class NoFilm(AdrError):
    """A film that cannot be made now."""

    code = "no_film"


class Films:
    """Makes films, and keeps the latest in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._free = folder, threading.Lock()
        self._waiting = threading.BoundedSemaphore(_MOST_WAITING)
        self._making = ""  # the key of the film that is being made
        self._drawing: subprocess.Popen[str] | None = None
        self._is_closed = False

    def of(self, spec: RunSpec, policy: bytes, distribution: dict[str, Any]) -> Path:
        """The film of a policy's episode in the mean of its training distribution.

        Beside it is an episode on the target, where that is simulated. Two who ask for the film
        that is being made wait for it. Raises NoFilm for more of them, while another one is made,
        and if it takes too long or breaks, InvalidInput for what cannot be drawn.
        """
        if spec.extension or getattr(spec.target, "effects", ()):
            raise InvalidInput("films show a task's own simulator; this run has effects beyond it")
        about = [adr_service.__version__, spec.target.kind, distribution]
        key = sha256(policy + canonical_json(about).encode())
        film = self._folder / f"{key}.mp4"
        with suppress(FileNotFoundError):
            os.utime(film)  # kept longest
            return film
        is_made_already = key == self._making
        if is_made_already and self._waiting.acquire(blocking=False):
            self._free.acquire()
            self._waiting.release()
        elif not self._free.acquire(blocking=False):
            which = "the" if is_made_already else "another"
            raise NoFilm(f"{which} film is being made; ask again in some seconds")
        try:
            if is_made_already and not film.exists():
                raise NoFilm("the film could not be made; ask again for the reason")
            if not film.exists():
                self._making = key
                self._keep(film, self._film(spec, policy, distribution))
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

    def _film(self, spec: RunSpec, policy: bytes, distribution: dict[str, Any]) -> bytes:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "policy").write_bytes(policy)
            (folder / "distribution").write_text(json.dumps(distribution))
            # -P: not an api of the folder in which the service was started
            command = [sys.executable, "-P", "-m", "api", "render", str(folder / "film.mp4")]
            command += ["--task", spec.task, "--fps", str(_FPS), "--policy", str(folder / "policy")]
            command += _world(spec, distribution, folder)
            status, errors = self._drawn(command)
            if self._is_closed:
                raise NoFilm("the service is stopping")
            if status == _REFUSED:
                raise InvalidInput(f"there is no film: {errors.strip()[-500:]}")
            if status != 0:
                log.warning("a film could not be made, status %d: %s", status, errors.strip())
                raise NoFilm("drawing the film failed; the service's log says why")
            return (folder / "film.mp4").read_bytes()

    def _drawn(self, command: list[str]) -> tuple[int, str]:
        """The exit status of a command that draws, and its messages. Raises NoFilm."""
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as drawing:  # noqa: S603 - our own command
            self._drawing = drawing
            if self._is_closed:
                drawing.kill()
            try:
                errors = drawing.communicate(timeout=_LONGEST_S)[1]
            except subprocess.TimeoutExpired as error:
                drawing.kill()
                raise NoFilm(f"the film took longer than {_LONGEST_S:.0f} s") from error
            finally:
                self._drawing = None
        return drawing.returncode, errors

    def close(self) -> None:
        """End the drawing that goes on, which a service that stops would wait for."""
        self._is_closed = True
        if (drawing := self._drawing) is not None:
            drawing.kill()


def _world(spec: RunSpec, distribution: dict[str, Any], folder: Path) -> Iterator[str]:
    """Options for what is filmed: source beside target, or the source alone if nothing is known."""
    yield from ("--variant", spec.variant)
    if spec.target.kind == "simulated":
        yield from ("--distribution", str(folder / "distribution"))
        return
    for parameter in distribution["parameters"]:
        yield from ("--set", f"{parameter['name']}={parameter['mean'][0]}")
