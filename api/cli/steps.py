"""Progress of a long computation in this process, line by line."""

import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

from rich.console import Console

from adr_service.progress import Checkpoint, Progress

_AGAIN_S = 60.0  # after which a step that lasts has another line, where the output is no terminal


@contextmanager
def progress_on(console: Console) -> Generator[Progress]:
    """A progress callback that shows the fact `doing` with the seconds since the beginning.

    A terminal has it in its last line; elsewhere each step is a line of its own.
    """
    began = time.monotonic()
    last, said_at = "", began
    with console.status("beginning") as status:

        def tell(fraction: float, checkpoint: Checkpoint | None = None, **facts: Any) -> None:
            nonlocal last, said_at
            doing, now = str(facts.get("doing", "")), time.monotonic()
            line = f"{now - began:.0f} s, {fraction:.0%}: {doing}"
            if console.is_terminal:
                status.update(line)
            elif doing != last or now - said_at > _AGAIN_S:
                console.print(line, highlight=False)
                last, said_at = doing, now

        yield tell
