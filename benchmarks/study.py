"""A long study that is carried from machine to machine by its archive.

    python -m benchmarks.study docs/studies/hopper.json results/hopper [--hours 2]

Starts a service on data/studies/<name>, imports results/hopper/study.adr if the service lacks
something of it, and goes on: first the benchmark `first`, then its extensions, one after the other.
Every half an hour, at the end, and when it is stopped (SIGINT, SIGTERM, or after `--hours`), the
report and the archive are written into the folder; other files there stay as they are. What a
training had done when the study was stopped is lost, nothing else.
"""

import argparse
import json
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from adr_service.client import AdrClient, Json, is_finished
from api.cli.own_service import free_port, own_service
from api.report import write_report

_EXPORT_S, _LOOK_S = 1800.0, 5.0
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Stopped(Exception):
    """The study shall stop now."""


def main(given: argparse.Namespace) -> bool:
    """Go on with a study; False if runs failed."""
    study: dict[str, Any] = json.loads(Path(given.study).read_text())
    folder, deadline = Path(given.folder), time.monotonic() + 3600 * given.hours
    for number in _SIGNALS:
        signal.signal(number, _stop)
    data = Path("data/studies") / Path(given.study).stem
    with own_service(data, free_port()) as client:
        id = benchmark_of(client, study["first"], folder / "study.adr")
        try:
            for extension in [None, *study["then"]]:
                if extension is not None:
                    extend(client, id, extension)
                finish(client, id, folder, deadline)
        except Stopped:
            stop(client, id)
        publish(client, id, folder)
        return set(client.get(id)["states"]) <= {"succeeded", "cancelled"}


def benchmark_of(client: AdrClient, spec: Json, archive: Path) -> str:
    """The study's benchmark: stored, imported or new; runs that were stopped go on."""
    if archive.exists():
        with archive.open("rb") as file:
            added = client.import_archive(file)
        print(added, file=sys.stderr, flush=True)
        if added["left"]:
            sys.exit(f"these runs went on apart here and in {archive}: {added['left']}")
        id = str(added["benchmark"])
    else:
        stored = client.list_all("benchmarks")
        id = str((stored[0] if stored else client.submit_benchmark(spec))["id"])
    client.resume(id)
    return id


def extend(client: AdrClient, id: str, extension: Json) -> None:
    """Add the members of an extension that the benchmark lacks."""
    spec = client.get(id)["spec"]
    missing = {
        name: [member for member in members if member not in spec.get(name, [])]
        for name, members in extension.items()
    }
    if any(missing.values()):
        client.extend_benchmark(id, {name: members for name, members in missing.items() if members})


def finish(client: AdrClient, id: str, folder: Path, deadline: float) -> None:
    """Wait until all runs have ended, and publish now and then; raises Stopped at the deadline."""
    published = time.monotonic()
    while not is_finished(seen := client.get(id)):
        print(seen["states"], flush=True)
        if time.monotonic() > deadline:
            raise Stopped
        if time.monotonic() > published + _EXPORT_S:
            publish(client, id, folder)
            published = time.monotonic()
        time.sleep(_LOOK_S)


def stop(client: AdrClient, id: str) -> None:
    """Stop all runs; what ends meanwhile still counts."""
    client.cancel(id)
    while not is_finished(client.get(id)):
        time.sleep(1.0)


def publish(client: AdrClient, id: str, folder: Path) -> None:
    """Put the report and the archive in the place of those before, file by file."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent) as place:
        write_report(client, id, Path(place))
        for written in [path for path in Path(place).rglob("*") if path.is_file()]:
            target = folder / written.relative_to(place)
            target.parent.mkdir(exist_ok=True)
            written.replace(target)


def _stop(*_: object) -> None:
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # it stops already
    raise Stopped


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study")
    parser.add_argument("folder")
    parser.add_argument("--hours", type=float, default=float("inf"))
    sys.exit(0 if main(parser.parse_args()) else 1)
