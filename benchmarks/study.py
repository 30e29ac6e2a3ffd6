"""A long study that is carried from machine to machine by its archive.

    python -m benchmarks.study docs/studies/hopper.json results/hopper [--hours 2]

Starts a service on data/studies/<name>, imports results/hopper/*.adr if the service lacks
something of them, and goes on: first the benchmark `first`, then its extensions, one after the
other. Every half an hour, at the end, and when it is stopped (SIGINT, SIGTERM, or after `--hours`),
the report and the archives are written into the folder; other files there stay as they are. The
runs of `first` are in study.adr, and those of each extension in an archive of their own, so that
what is finished keeps its bytes. What a training had done when the study was stopped is lost,
nothing else.
"""

import argparse
import json
import signal
import sys
import tempfile
import time
from itertools import chain
from pathlib import Path
from typing import Any

from adr_service.client import AdrClient, Json, is_finished
from adr_service.specs import BenchmarkExtension, BenchmarkSpec
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
        parts = parts_of(study)
        id = benchmark_of(client, study["first"], [folder / name for name in parts])
        try:
            for extension in [{}, *study["then"]]:
                extend(client, id, extension)
                finish(client, id, folder, parts, deadline)
        except Stopped:
            stop(client, id)
        publish(client, id, folder, parts)
        return set(client.get(id)["states"]) <= {"succeeded", "cancelled"}


def parts_of(study: Json) -> dict[str, Json]:
    """The members of the first benchmark and of each extension, by the name of their archive."""
    spec = BenchmarkSpec.model_validate(study["first"])
    parts = {"study.adr": members_of(spec)}
    for given in study["then"]:
        extension = BenchmarkExtension.model_validate(given)
        added = {field: names for field, names in members_of(extension).items() if names}
        spec = spec.extended(extension)
        parts[f"study-{'-'.join(chain(*added.values()))}.adr"] = members_of(spec) | added
    return parts


def members_of(spec: BenchmarkSpec | BenchmarkExtension) -> dict[str, list[str]]:
    """The names of tasks, variants, methods, collectors and seeds."""
    return {
        field: [str(getattr(member, "name", member)) for member in getattr(spec, field)]
        for field in BenchmarkExtension.model_fields
    }


def benchmark_of(client: AdrClient, spec: Json, archives: list[Path]) -> str:
    """The study's benchmark: stored, imported or new; runs that were stopped go on."""
    for archive in (path for path in archives if path.exists()):
        with archive.open("rb") as file:
            added = client.import_archive(file)
        print(added, file=sys.stderr, flush=True)
        if added["left"]:
            sys.exit(f"these runs went on apart here and in {archive}: {added['left']}")
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


def finish(
    client: AdrClient, id: str, folder: Path, parts: dict[str, Json], deadline: float
) -> None:
    """Wait until all runs have ended, and publish now and then; raises Stopped at the deadline."""
    published = time.monotonic()
    while not is_finished(seen := client.get(id)):
        print(seen["states"], flush=True)
        if time.monotonic() > deadline:
            raise Stopped
        if time.monotonic() > published + _EXPORT_S:
            publish(client, id, folder, parts)
            published = time.monotonic()
        time.sleep(_LOOK_S)


def stop(client: AdrClient, id: str) -> None:
    """Stop all runs; what ends meanwhile still counts."""
    client.cancel(id)
    while not is_finished(client.get(id)):
        time.sleep(1.0)


def publish(client: AdrClient, id: str, folder: Path, parts: dict[str, Json]) -> None:
    """Put the report and the archives in the place of those before, file by file."""
    present = members_of(BenchmarkSpec.model_validate(client.get(id)["spec"]))
    begun = {
        name: part
        for name, part in parts.items()
        if all(set(part[field]) <= set(present[field]) for field in part)
    }
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent) as place:
        write_report(client, id, Path(place), begun)
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
