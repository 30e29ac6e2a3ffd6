"""A long study that is carried from machine to machine by its archive.

    python -m benchmarks.study docs/studies/hopper.json results/hopper [--hours 2]

Starts a service on data/studies/<name>, imports the archives in results/hopper if the service
lacks something of them, and goes on: first the benchmark `first`, then its extensions, one after
the other. Every half an hour, at the end, and when it is stopped (SIGINT, SIGTERM, or after
`--hours`), the report and the archives are written into the folder; other files there stay as they
are. The runs of `first` are in study.adr, and those of each extension in an archive of their own,
so that what is finished keeps its bytes. What a training had done when the study was stopped is
lost, nothing else.
"""

import argparse
import json
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Collection
from itertools import chain
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from adr_service.client import AdrClient, Json, Refused, Unreachable, is_finished
from adr_service.specs import BenchmarkExtension, BenchmarkSpec, members_of
from api.cli.own_service import own_service
from api.cli.ports import free_port
from api.report import write_report

_EXPORT_S = 1800.0
_TRIES, _PAUSE_S = 30, 60.0
_POLL_S = 2.0
P, T = ParamSpec("P"), TypeVar("T")
_KINDS = BenchmarkExtension.model_fields  # of members
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Stopped(Exception):
    """The study shall stop now."""


def main(given: argparse.Namespace) -> bool:
    """Go on with a study; False if runs failed."""
    study: dict[str, Any] = json.loads(Path(given.study).read_text())
    parts = parts_of(study)
    folder, deadline = Path(given.folder), time.monotonic() + 3600 * given.hours
    for number in _SIGNALS:
        signal.signal(number, _stop)
    data = Path("data/studies") / Path(given.study).stem
    with own_service(data, free_port()) as client:
        id = benchmark_of(client, study["first"], folder, parts)
        first = {kind: given for kind, given in study["first"].items() if kind in _KINDS}
        try:
            for extension in [first, *study["then"]]:
                patiently(extend, client, id, extension)
                finish(client, id, folder, parts, deadline)
            _ignore_signals()
        except Stopped:
            _ignore_signals()  # it stops already
            patiently(client.cancel, id)
            client.wait(id, progress=False)  # what ends meanwhile still counts
        patiently(publish, client, id, folder, parts)
        return set(client.get(id)["states"]) <= {"succeeded", "cancelled"}


def parts_of(study: Json) -> dict[str, Json]:
    """The members of the first benchmark and of each extension, by the name of their archive."""
    spec = BenchmarkSpec.model_validate(study["first"])
    parts = {"study.adr": names_of(spec)}
    for given in study["then"]:
        extension = BenchmarkExtension.model_validate(given)
        added = {kind: names for kind, names in names_of(extension).items() if names}
        if len(added) != 1:
            sys.exit(f"an extension adds members of one kind, so that its runs are a grid: {given}")
        spec = spec.extended(extension)
        parts[f"study-{'-'.join(chain(*added.values()))}.adr"] = names_of(spec) | added
    return parts


def present_in(client: AdrClient, id: str) -> dict[str, list[str]]:
    """The names of a stored benchmark's members of each kind."""
    return names_of(BenchmarkSpec.model_validate(client.get(id)["spec"]))


def names_of(spec: BenchmarkSpec | BenchmarkExtension) -> dict[str, list[str]]:
    """The names of the members of each kind."""
    return {kind: list(members) for kind, members in members_of(spec).items()}


def benchmark_of(client: AdrClient, spec: Json, folder: Path, parts: Collection[str]) -> str:
    """The study's benchmark: imported, stored or new; runs that were stopped go on."""
    present = {path.name for path in folder.glob("*.adr")}
    if strange := sorted(present - set(parts)):
        sys.exit(f"{folder} has {strange}, which are no archives of this study: {list(parts)}")
    ids = {import_archive(client, folder / name) for name in parts if name in present}
    if len(ids) > 1:
        sys.exit(f"the archives in {folder} are of several benchmarks: {sorted(ids)}")
    stored = [benchmark["id"] for benchmark in client.list_all("benchmarks")]
    id = str([*ids, *stored][0] if ids or stored else client.submit_benchmark(spec)["id"])
    client.resume(id)
    return id


def import_archive(client: AdrClient, archive: Path) -> str:
    """Add what the service lacks of an archive, and return its benchmark's id."""
    with archive.open("rb") as file:
        added = client.import_archive(file)
    print(added, file=sys.stderr, flush=True)
    if added["left"]:
        sys.exit(f"these runs went on apart here and in {archive}: {added['left']}")
    return str(added["benchmark"])


def extend(client: AdrClient, id: str, extension: Json) -> None:
    """Add the members of an extension that the benchmark lacks."""
    present = present_in(client, id)
    names = names_of(BenchmarkExtension.model_validate(extension))
    missing = {
        kind: [m for m, name in zip(members, names[kind], strict=True) if name not in present[kind]]
        for kind, members in extension.items()
    }
    if any(missing.values()):
        client.extend_benchmark(id, {kind: members for kind, members in missing.items() if members})


def finish(
    client: AdrClient, id: str, folder: Path, parts: dict[str, Json], deadline: float
) -> None:
    """Wait until all runs have ended, and publish now and then; raises Stopped at the deadline."""
    published, shown = time.monotonic(), None
    while True:
        seen = patiently(client.get, id)
        if seen["states"] != shown:
            shown = seen["states"]
            print(shown, flush=True)
        if is_finished(seen):
            return
        if time.monotonic() > deadline:
            raise Stopped
        if time.monotonic() > published + _EXPORT_S:
            patiently(publish, client, id, folder, parts)
            published = time.monotonic()
        time.sleep(_POLL_S)


def patiently(act: Callable[P, T], *given: P.args, **more: P.kwargs) -> T:
    """Do something with a service that may be busy for half an hour, as beside other work."""
    for _ in range(_TRIES):
        try:
            return act(*given, **more)
        except (Refused, Unreachable) as error:
            print(f"{error}; trying again", file=sys.stderr, flush=True)
            time.sleep(_PAUSE_S)
    return act(*given, **more)


def publish(client: AdrClient, id: str, folder: Path, parts: dict[str, Json]) -> None:
    """Put the report and the archives in the place of those before, file by file."""
    present = present_in(client, id)
    begun = {
        name: part
        for name, part in parts.items()
        if all(set(names) <= set(present[kind]) for kind, names in part.items())
    }
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent) as place:
        write_report(client, id, Path(place), begun)
        for written in [path for path in Path(place).rglob("*") if path.is_file()]:
            target = folder / written.relative_to(place)
            target.parent.mkdir(exist_ok=True)
            written.replace(target)


def _stop(*_: object) -> None:
    _ignore_signals()
    raise Stopped


def _ignore_signals() -> None:
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study")
    parser.add_argument("folder")
    parser.add_argument("--hours", type=float, default=float("inf"))
    sys.exit(0 if main(parser.parse_args()) else 1)
