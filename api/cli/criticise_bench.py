"""`adr criticise-bench`: a blind test of methods that name what a simulator lacks."""

import json
from pathlib import Path
from typing import Annotated

import typer

from adr_service.errors import AdrError, InvalidInput
from api.cli.files import check_absent, check_writable
from api.cli.options import AsJson
from api.cli.single_options import SingleOptionApp
from api.cli.terminal import console, errors

app = SingleOptionApp(
    help="Make a blind test of criticism, and score answers to it.", no_args_is_help=True
)

Folder = Annotated[Path, typer.Option("--out", help="Folder for the cases, one folder each.")]
MadeKey = Annotated[Path, typer.Option("--key", help="File for what they hide.")]
Key = Annotated[Path, typer.Option(help="What the cases hide, as `make` wrote it.")]
Cases = Annotated[int, typer.Option(min=1, max=10_000, help="How many cases.")]
Tasks = Annotated[str, typer.Option(help="Robots, in turn: arm,hopper,half_cheetah,walker2d.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the cases.")]
Answers = Annotated[
    list[Path],
    typer.Argument(help="Folders of answers, one for each method: ours/0000/verdict.json …"),
]


@app.command()
def make(out: Folder, key: MadeKey, seed: Seed, cases: Cases = 80, tasks: Tasks = "arm") -> None:
    """Write cases: simulators, and measurements of robots that differ from them."""
    from adr_service.blind_test.files import make_cases  # imports the simulator

    robots = [name.strip() for name in tasks.split(",")]
    check_absent(out)
    if key.absolute().is_relative_to(out.absolute()):
        raise InvalidInput(f"{key} would lie among the cases; keep the key elsewhere")
    check_writable(key)
    with console.status("simulating"):
        make_cases(out, key, robots, cases, seed)
    console.print(f"{out}: {cases} cases; {key}: what they hide", highlight=False)


@app.command()
def answer(
    cases: Annotated[Path, typer.Argument(help="Folder of cases, as `make` wrote it.")],
    out: Annotated[Path, typer.Option(help="Folder for the answers; existing ones are kept.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of the bootstraps.")] = 0,
) -> None:
    """Answer cases by `adr criticise`, one after the other."""
    from adr_service.blind_test.answering import answer_question, by_criticism
    from adr_service.blind_test.files import has_answer, questions_in

    failed: list[str] = []
    for question in questions_in(cases):
        if has_answer(out / question.name):
            continue
        try:
            with console.status(f"fitting {question.name}"):
                given = answer_question(by_criticism, question, out / question.name, seed)
        except AdrError as error:
            failed.append(question.name)
            errors.print(f"{question.name}: {error}", highlight=False)
            continue
        named = ", ".join(f"{cause.kind} {cause.location}" for cause in given.causes)
        console.print(f"{question.name}: {given.verdict.value} {named}".rstrip(), highlight=False)
    if failed:
        raise typer.Exit(1)


@app.command()
def score(answers: Answers, key: Key, as_json: AsJson = False) -> None:
    """Compare the answers of methods with the key; a case without an answer counts as wrong."""
    from rich.table import Table

    from adr_service.blind_test.files import read_answers, read_key
    from adr_service.blind_test.scoring import marked, score

    known = read_key(key)
    columns = {str(folder): score(marked(known, read_answers(folder, known))) for folder in answers}
    if as_json:
        typer.echo(json.dumps(columns, indent=1))
        return
    console.print(f"{key}: {len(known.cases)} cases of seed {known.seed}", highlight=False)
    table = Table("", *columns)
    for name in columns[str(answers[0])]:
        table.add_row(name, *(column[name] for column in columns.values()))
    console.print(table, highlight=False)
