"""`adr tune`: a search over learning rates, in this process and on its own cluster."""

import os
from collections.abc import Sequence
from dataclasses import asdict
from typing import Annotated, Any

import typer
from pydantic import ValidationError

from adr_service.errors import InvalidInput
from adr_service.json_values import explain
from api.cli.options import AsJson
from api.cli.specs import assign
from api.cli.tables import trials_table
from api.cli.terminal import console

app = typer.Typer()


@app.command()
def tune(
    task: Annotated[str, typer.Argument(help="arm, hopper, half_cheetah, …")],
    rates: Annotated[str, typer.Option(help="Learning rates, with commas between.")],
    seeds: Annotated[int, typer.Option(help="Trainings per rate.", min=1)] = 2,
    preset: Annotated[str, typer.Option(help="Preset of the trainings: quick, …")] = "quick",
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="A field, training.max_steps=1000.")
    ] = None,
    cpus: Annotated[int | None, typer.Option(help="Trainings at once; default: all cores.")] = None,
    as_json: AsJson = False,
) -> None:
    """Search the learning rate that trains best on the ground truth; needs no service."""
    spec: dict[str, Any] = {"task": task, "method": "oracle", "preset": preset}
    assign(spec, setting)
    trials = _search(spec, rates.split(","), seeds, cpus)
    if as_json:
        console.print_json(data=trials)
    else:
        console.print(trials_table(trials))


def _search(
    spec: dict[str, Any], rates: Sequence[str], seeds: int, cpus: int | None
) -> list[dict[str, Any]]:
    """Return the trials for the learning rates as typed, the best first."""
    from adr_service.specs import RunSpec  # imports the simulator

    try:
        valid = RunSpec.model_validate(spec)
        numbers = [float(rate) for rate in rates]
    except ValidationError as error:
        raise InvalidInput(explain(error, "spec")) from error
    except ValueError as error:
        raise InvalidInput(f"learning rates must be numbers: {error}") from error
    from workers.cluster import RayOptions  # imports Ray
    from workers.tuning import tune as tune_on_ray

    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # Ray reports usage by default
    options = RayOptions(cpus=cpus, dashboard=False)
    return [asdict(trial) for trial in tune_on_ray(valid, numbers, range(seeds), options)]
