"""`adr tune`: a search over settings of trainings, in this process and on its own cluster."""

import os
from collections.abc import Sequence
from dataclasses import asdict
from typing import Annotated, Any

import typer

from adr_service.errors import InvalidInput
from api.cli.options import AsJson
from api.cli.single_options import SingleOptionApp
from api.cli.tables import candidates_table
from api.cli.terminal import console
from api.specs import assign, read_value

_OPTIONS = {"seed": "--first-seed", "preset": "--preset", "method": "--on-prior"}

app = SingleOptionApp()


@app.command()
def tune(
    task: Annotated[str, typer.Argument(help="arm, hopper, half_cheetah, …")],
    over: Annotated[
        list[str], typer.Option(help="Values of a setting to try, learning_rate=[0.0003,0.001].")
    ],
    seeds: Annotated[int, typer.Option(help="Trainings of each combination.", min=1)] = 2,
    first_seed: Annotated[int, typer.Option(help="Take seeds that no result uses.", min=0)] = 1000,
    preset: Annotated[str, typer.Option(help="Preset of the trainings.")] = "fast",
    on_prior: Annotated[
        bool, typer.Option("--on-prior", help="Train on the prior, not on the ground truth.")
    ] = False,
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="A field, training.max_steps=1000.")
    ] = None,
    seconds: Annotated[float, typer.Option(help="CPU seconds of a training.", min=10)] = 600,
    cpus: Annotated[
        int | None, typer.Option(help="Trainings at once; default: all cores.", min=1)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Search the settings that train to the threshold soonest; needs no service."""
    spec: dict[str, Any] = {"task": task}
    assign(spec, setting, fixed=["task"])
    grid = dict(_values(text) for text in over)
    if len(grid) < len(over):
        raise InvalidInput(f"--over has one setting twice: {' '.join(over)}")
    for name, option in _OPTIONS.items():
        if name in spec:
            raise InvalidInput(f"`adr tune` takes {option}, not --set {name}")
    spec |= {"method": "prior" if on_prior else "oracle", "preset": preset}
    from workers.cluster import RayOptions  # imports Ray
    from workers.tuning import candidates
    from workers.tuning import tune as tune_on_ray

    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # Ray reports usage by default
    # Tune's own end of an interrupted search looks like that of a finished one
    os.environ.setdefault("TUNE_DISABLE_SIGINT_HANDLER", "1")
    options = RayOptions(cpus=cpus, dashboard=False)
    tried = range(first_seed, first_seed + seeds)
    trials = tune_on_ray(spec, grid, tried, options, seconds)
    if as_json:
        console.print_json(data=[asdict(trial) for trial in trials])
    else:
        console.print(candidates_table(candidates(trials)))


def _values(text: str) -> tuple[str, Sequence[Any]]:
    """A setting's name and the values to try, of a text `name=[value,…]`."""
    name, _, given = text.partition("=")
    values = read_value(given)
    if not isinstance(values, list) or not values:
        raise InvalidInput(f"--over needs name=[value,…] with JSON values; given {text!r}")
    return name.removeprefix("training."), values
