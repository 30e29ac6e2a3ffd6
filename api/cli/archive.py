"""`adr archive`: benchmarks as files, to carry, publish and verify."""

import os
import secrets
import tempfile
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

import typer

from adr_service.client import Json, Refused, check_benchmark, connect
from adr_service.errors import AdrError, InvalidInput
from adr_service.whole_files import written_whole
from api.cli.files import check_new
from api.cli.options import AsJson, Url, members
from api.cli.single_options import SingleOptionApp
from api.cli.terminal import console

if TYPE_CHECKING:
    from adr_service.benchmark.replay import Replay
    from adr_service.benchmark.verification import Verified
    from db.staging import Staged

app = SingleOptionApp(
    help="Write benchmarks to files, and read and verify them.", no_args_is_help=True
)
File = Annotated[Path, typer.Argument(help="An archive, as `adr archive export` writes it.")]
Files = Annotated[list[Path], typer.Argument(help="Archives, as `adr archive export` writes them.")]
_ONLY = "Only this one; may be repeated."
Only = Annotated[list[str] | None, typer.Option(help=_ONLY)]
_SHORT = 12  # digits of a digest in tables


class NotVerified(AdrError):
    """Stages have other results here than in the archive."""

    code = "not_verified"


@app.command("export")
def export_(
    benchmark: Annotated[str, typer.Argument(help="Id of a benchmark, finished or not.")],
    file: Annotated[Path, typer.Argument(help="The file to write.")],
    seed: Annotated[list[int] | None, typer.Option(help=_ONLY)] = None,
    method: Annotated[list[str] | None, typer.Option(help=f"{_ONLY} References stay.")] = None,
    variant: Only = None,
    task: Only = None,
    collector: Only = None,
    url: Url = None,
) -> None:
    """Write a benchmark, or a part of it, with all results and policies to one file.

    Parts that differ in one option, as in --method, are one benchmark again when they are
    imported one after the other.
    """
    check_benchmark(benchmark, "an archive is")
    check_new(file)
    part = members(seed=seed, method=method, variant=variant, task=task, collector=collector)
    with connect(url) as client, written_whole(file) as unfinished, unfinished.open("wb") as out:
        client.export_archive(benchmark, out, part)
    console.print(f"{file}: {file.stat().st_size / 1e6:.2f} MB")


@app.command("import")
def import_(files: Files, url: Url = None, as_json: AsJson = False) -> None:
    """Add what the service lacks of benchmarks, file by file; runs that were live can be resumed.

    Stops at the first file that is refused; earlier ones stay imported. --json prints one document
    for each file.
    """
    with connect(url) as client:
        for file in files:
            with _opened(file) as archive, _naming(file):
                added = client.import_archive(archive)
            if as_json:
                console.print_json(data=added)
            else:
                console.print(f"{file}: {_summary(added)}")


@app.command()
def verify(
    file: File,
    sample: Annotated[int, typer.Option(min=1, help="Number of stages.")] = 5,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Repeats a sample; default: another each time.")
    ] = None,
) -> None:
    """Check an archive, and compute some of its stages again; no service is needed."""
    from db.staging import staged
    from workers.cluster import worker_environment

    with (
        tempfile.TemporaryDirectory(prefix="adr-") as folder,
        _opened(file) as archive,
        staged(archive, Path(folder)) as archived,
        # where JAX, unless it is imported already, reads how many threads it may take
        _environment(worker_environment(Path(folder) / "jax")),
    ):
        drawn = secrets.randbelow(2**31) if seed is None else seed
        different, unchecked, computed = list[str](), list[str](), 0
        console.print(f"sample {drawn} (--seed {drawn} repeats it)")
        for verified in _verified(archived, sample, drawn, unchecked):
            share = "" if verified.agreement == "identical" else f", by {verified.deviation:.2g}"
            console.print(
                f"{verified.kind} {verified.digest[:_SHORT]}: {verified.agreement}{share} "
                f"({verified.seconds:.1f} s)"
            )
            computed += 1
            different += [verified.digest] if verified.agreement == "different" else []
    if wrong := "; ".join([*_on_different(different), *_on_unchecked(unchecked)]):
        raise NotVerified(wrong)
    console.print(f"the archive is sound; {computed} of its stages were computed again")


def _on_different(digests: Sequence[str]) -> Iterator[str]:
    if digests:
        yield f"{len(digests)} stages have other results here: {', '.join(digests)}"


def _on_unchecked(runs: Sequence[str]) -> Iterator[str]:
    if runs:
        yield (
            f"{len(runs)} runs cannot be checked, because results are missing from the archive or "
            "are of another version of this program, or their method failed "
            f"({', '.join(runs[:5])})"
        )


def _verified(
    archived: "Staged", sample: int, seed: int, unchecked: list[str]
) -> "Iterator[Verified]":
    """Stages of the archive, drawn at random and computed again.

    Runs that cannot be checked are added to `unchecked`.
    """
    from adr_service.benchmark.verification import sampled, verify
    from adr_service.provenance import has_same_provenance, provenance
    from adr_service.randomness import stream
    from db.archive_checks import replays
    from db.models import StageRow
    from db.stages import find_result, provenance_of

    here = provenance()
    with archived.database.read() as session:

        def is_same(digest: str) -> bool:
            return has_same_provenance(provenance_of(session, digest), here)

        def replayed() -> "Iterator[Replay]":
            for checked in replays(archived):
                unchecked.extend([] if checked.is_verified else [checked.id])
                yield checked.replay

        drawn = sampled(
            replayed(),
            sample,
            stream("verify", str(seed)),
            lambda stage: stage.role != "trainer" or is_same(stage.digest),
        )
        if not drawn and not unchecked:
            raise NotVerified("no stage can be computed again here")
        for stage in drawn:
            stored = find_result(session, stage.digest)
            assert stored is not None, "it was drawn from the stored ones"
            console.print(
                f"{stage.kind} {stage.digest[:_SHORT]}: it took "
                f"{session.get_one(StageRow, stage.digest).seconds:.0f} s when it was stored"
            )
            yield verify(stage, stored, is_same(stage.digest))


@contextmanager
def _environment(variables: dict[str, str]) -> Generator[None]:
    """Set environment variables for a while."""
    before = dict(os.environ)
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


@contextmanager
def _naming(file: Path) -> Generator[None]:
    """Let a refusal by the service begin with the file's name."""
    try:
        yield
    except Refused as error:
        raise Refused(error.status, f"{file}: {error}", error.retry_after_s) from error


def _opened(file: Path) -> IO[bytes]:
    try:
        return file.open("rb")
    except OSError as error:
        raise InvalidInput(f"{file} cannot be read: {error.strerror}") from error


def _summary(added: Json) -> str:
    lines = [
        f"{added['benchmark']}: {added['added']} of {added['runs']} runs are new, "
        f"{added['continued']} go further than before, {added['unchanged']} were here already; "
        f"{added['stages']} new stages",
        f"all events of {added['runs'] - len(added['unverified'])} of {added['runs']} runs were "
        "computed again from their results",
    ]
    if added["resumable"]:
        lines.append(
            f"{added['resumable']} runs stopped before their end: adr resume {added['benchmark']}"
        )
    if added["unverified"]:
        lines.append(
            "these runs have events whose results are not there, or are of another version, or "
            "their method failed: " + ", ".join(added["unverified"])
        )
    if added["left"]:
        why = "left as they are, because they are live here or went on apart"
        lines.append(f"{why}: {', '.join(added['left'])}")
    return "\n".join(lines)
