"""`adr archive`: benchmarks as files, to carry, publish and verify."""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from adr_service.errors import AdrError, InvalidInput
from api.cli.options import AsJson, Url
from api.cli.terminal import console
from api.client import Json, connect
from api.settings import DEFAULT_URL

if TYPE_CHECKING:
    from adr_service.benchmark.verification import Verified
    from db.staging import Staged

app = typer.Typer(help="Write benchmarks to files, and read and verify them.", no_args_is_help=True)
File = Annotated[Path, typer.Argument(help="An archive, as `adr archive export` writes it.")]
_SHORT = 12  # digits of a digest in tables


class NotVerified(AdrError):
    """Stages have other results here than in the archive."""

    code = "not_verified"


@app.command("export")
def export_(
    benchmark: Annotated[str, typer.Argument(help="Id of a benchmark, finished or not.")],
    file: Annotated[Path, typer.Argument(help="The file to write.")],
    url: Url = DEFAULT_URL,
) -> None:
    """Write a benchmark with all its results and policies to one file."""
    if file.exists():
        raise InvalidInput(f"{file} is there already; an export overwrites nothing")
    part = file.with_name(f"{file.name}.part")
    try:
        with connect(url) as client, part.open("wb") as written:
            client.export_archive(benchmark, written)
        part.rename(file)
    finally:
        part.unlink(missing_ok=True)
    console.print(f"{file}: {file.stat().st_size / 1e6:.1f} MB")


@app.command("import")
def import_(file: File, url: Url = DEFAULT_URL, as_json: AsJson = False) -> None:
    """Add what the service lacks of a benchmark; runs that were live can be resumed."""
    with connect(url) as client, file.open("rb") as archive:
        added = client.import_archive(archive)
    if as_json:
        console.print_json(data=added)
    else:
        console.print(_summary(added))


@app.command()
def verify(
    file: File,
    sample: Annotated[int, typer.Option(min=1, help="Number of stages.")] = 5,
    seed: Annotated[int, typer.Option(min=0, help="Of the sample.")] = 0,
) -> None:
    """Check an archive, and compute some of its stages again; no service is needed."""
    from db.staging import staged

    with (
        tempfile.TemporaryDirectory(prefix="adr-") as folder,
        file.open("rb") as archive,
        staged(archive, Path(folder)) as archived,
    ):
        different: list[str] = []
        for verified in _verified(archived, sample, seed):
            share = "" if verified.agreement == "identical" else f", by {verified.deviation:.2g}"
            console.print(
                f"{verified.kind} {verified.digest[:_SHORT]}: {verified.agreement}{share} "
                f"({verified.seconds:.1f} s)"
            )
            different += [verified.digest] if verified.agreement == "different" else []
    if different:
        raise NotVerified(f"{len(different)} stages have other results here: {different}")


def _verified(archived: "Staged", sample: int, seed: int) -> Iterator["Verified"]:
    """Stages of the archive, drawn at random and computed again."""
    from adr_service.benchmark.verification import sampled, verify
    from adr_service.provenance import provenance
    from adr_service.randomness import stream
    from db.archive_checks import replays
    from db.stages import find_result, provenance_of

    here = provenance()
    with archived.database.read() as session:

        def is_same(digest: str) -> bool:
            return provenance_of(session, digest) == here

        drawn = sampled(
            (replay for _, replay in replays(archived)),
            sample,
            stream("verify", str(seed)),
            lambda stage: stage.role != "trainer" or is_same(stage.digest),
        )
        for stage in drawn:
            stored = find_result(session, stage.digest)
            assert stored is not None, "it was drawn from the stored ones"
            yield verify(stage, stored, is_same(stage.digest))


def _summary(added: Json) -> str:
    lines = [
        f"{added['benchmark']}: {added['added']} of {added['runs']} runs are new, "
        f"{added['continued']} go further than before, {added['unchanged']} were here already; "
        f"{added['stages']} new stages",
        f"the events of {added['replayed']} runs were computed again from their results"
        + ("" if added["replayed"] == added["runs"] else ", of the others as far as results go"),
    ]
    if added["left"]:
        lines.append(f"left as they are, because they went on here: {', '.join(added['left'])}")
    return "\n".join(lines)
