"""A benchmark's page as a folder of files that needs no server.

    with connect() as client:
        write_report(client, "bench_0123456789abcdef", Path("report"))

All links are relative and nothing is a script, so any web host can show it, and a browser opens
`index.html` from the disk.
"""

import json
import shutil
from collections.abc import Mapping
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from adr_service.benchmark.archive import ArchiveReader, Manifest
from adr_service.benchmark.figures import CAPTIONS
from adr_service.benchmark.improvements import improvement_matrices
from adr_service.client import AdrClient, Json, check_benchmark
from adr_service.errors import InvalidInput

_PAGE = Path(__file__).parent / "page"  # without the service, which imports Ray


WHOLE: Mapping[str, Json] = {"study.adr": {}}


def write_report(
    client: AdrClient, benchmark_id: str, folder: Path, archives: Mapping[str, Json] = WHOLE
) -> Path:
    """Write a benchmark's report, with its archives, into a new or empty folder; return the page.

    `archives` are names of files, and the part of the benchmark that each has, as
    `AdrClient.export_archive` takes it. Raises InvalidInput if something is in the folder.
    """
    check_benchmark(benchmark_id, "a report is")
    if folder.exists() and any(folder.iterdir()):
        raise InvalidInput(f"{folder} is not empty; a report overwrites nothing")
    folder = folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        _write_files(client, benchmark_id, folder, archives)
    except BaseException:  # a part of a report would be in the way of the next one
        for path in folder.iterdir():
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()
        raise
    return folder / "index.html"


def _write_files(
    client: AdrClient, benchmark_id: str, folder: Path, archives: Mapping[str, Json]
) -> None:
    benchmark, found = client.get(benchmark_id), client.results(benchmark_id)
    claims, figures = client.claims(benchmark_id), client.figures(benchmark_id)
    (folder / "figures").mkdir()
    for name in figures:
        for file in (f"{name}.{kind}" for kind in ("svg", "png", "csv")):
            (folder / "figures" / file).write_bytes(client.figure(benchmark_id, file))
    (folder / "results.csv").write_text(client.results_csv(benchmark_id), encoding="utf-8")
    for name, content in (("results", found), ("claims", claims), ("spec", benchmark["spec"])):
        (folder / f"{name}.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
    manifests = [
        _archive(client, benchmark_id, folder / name, part) for name, part in archives.items()
    ]
    versions = [combination for each in manifests for combination in each.computed_with]
    page = _templates().get_template("report.html")
    text = page.render(
        benchmark=benchmark,
        found=found,
        claims=claims,
        figures=figures,
        captions=CAPTIONS,
        matrices=improvement_matrices(found["comparisons"]),
        cost=client.cost(benchmark_id),
        archives=list(archives),
        adr_service=manifests[0].adr_service,
        computed_with=[one for i, one in enumerate(versions) if one not in versions[:i]],
        spec=json.dumps(benchmark["spec"], indent=1),
    )
    (folder / "index.html").write_text(text, encoding="utf-8")
    shutil.copyfile(_PAGE / "static" / "style.css", folder / "style.css")


def _archive(client: AdrClient, benchmark_id: str, path: Path, part: Json) -> Manifest:
    with path.open("w+b") as file:
        client.export_archive(benchmark_id, file, part)
        with ArchiveReader(file) as archive:
            return archive.manifest


def _templates() -> Environment:
    loader = FileSystemLoader(_PAGE / "templates")
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
