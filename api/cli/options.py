"""Options and arguments that several commands have."""

from typing import Annotated, Any

import typer

from adr_service.errors import InvalidInput

Url = Annotated[
    str | None,
    typer.Option(
        envvar="ADR_URL",
        help="Address of the service; without it, this machine's at ADR_PORT, or else 8000.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def _check_id(given: str) -> str:
    if given.startswith("data_"):
        raise InvalidInput(f"accepted are ids of runs and benchmarks; {given} is of a recording")
    return given


Id = Annotated[str, typer.Argument(help="Id of a run or a benchmark.", callback=_check_id)]
Watch = Annotated[bool, typer.Option(help="Follow it to its end.")]


def check_watch(dry_run: bool, watch: bool, key: str | None = None) -> None:
    """Raise InvalidInput where there would be nothing to follow, or to start once."""
    if dry_run and watch:
        raise InvalidInput("--dry-run starts nothing that --watch could follow; leave one out")
    if dry_run and key is not None:
        raise InvalidInput("--dry-run starts nothing that needs a --key; leave one out")


def is_url_given(context: typer.Context) -> bool:
    """True if --url stands on the command line; it may come from ADR_URL, too."""
    source = context.get_parameter_source("url")
    return source is not None and source.name == "COMMANDLINE"


def members(**given: list[Any] | None) -> dict[str, list[Any]]:
    """Members of a benchmark from repeated options: `method` gives `methods`, if there are any."""
    return {f"{name}s": value for name, value in given.items() if value}
