"""Follow a run, a benchmark or a criticism to its end, and print the results."""

import typer

from adr_service.client import AdrClient, Json
from api.cli.progress import failures, live
from api.cli.tables import results_table
from api.cli.terminal import console, errors
from api.cli.verdict_table import verdict_table


def follow(client: AdrClient, id: str, as_json: bool = False) -> None:
    """Show progress to the end, then the results; exit with status 1 unless all succeeded.

    As JSON, the output has the final state alone, and progress goes where errors go.
    """
    final = live(errors if as_json else console, client, id)
    if as_json:
        console.print_json(data=final)
    else:
        show_results(client, final)
    must_have_succeeded(final)


def must_have_succeeded(final: Json) -> None:
    """Exit with status 1 unless all runs succeeded, and print why they did not."""
    states = final["states"] if "states" in final else {final["state"]: 1}
    for line in failures(final):
        errors.print(line, highlight=False, soft_wrap=True)
    if set(states) != {"succeeded"}:
        raise typer.Exit(1)


def is_criticism(seen: Json) -> bool:
    """True for a criticism, false for another run or a benchmark."""
    return bool(seen["spec"].get("kind") == "criticism")


def show_results(client: AdrClient, seen: Json) -> None:
    """Print the result table of a run or a benchmark, or the verdict of a criticism."""
    if not is_criticism(seen):
        console.print(results_table(client.results(seen["id"])))
        return
    verdict = client.criticism(seen["id"])["verdict"]
    error = (seen["error"] or {}).get("message", "no verdict yet")
    console.print(f"{seen['state']}: {error}" if verdict is None else verdict_table(verdict))
