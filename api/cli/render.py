"""`adr render`: films of policies and of recordings."""

from pathlib import Path
from typing import Annotated

import typer

from adr_service.errors import InvalidInput
from api.cli.files import check_absent
from api.cli.single_options import SingleOptionApp
from api.cli.terminal import console
from api.specs import named_values

app = SingleOptionApp()

Out = Annotated[Path, typer.Argument(help="The film to write, .gif or .mp4.")]
Policy = Annotated[Path | None, typer.Option(help="Film an episode of this policy.")]
Distribution = Annotated[
    Path | None,
    typer.Option(
        help="With --policy: the source with the mean of this distribution, as `adr results "
        "--distribution` writes it, beside the target."
    ),
]
Data = Annotated[Path | None, typer.Option(help="Film a recorded episode (.npz) and its replay.")]
Parameters = Annotated[
    list[str] | None,
    typer.Option("--set", help="A parameter, torso_mass=4.2; all others have their true values."),
]


@app.command()
def render(
    out: Out,
    task: Annotated[str, typer.Option(help="arm, hopper, half_cheetah, …")],
    policy: Policy = None,
    distribution: Distribution = None,
    data: Data = None,
    variant: Annotated[str, typer.Option(help="One of the task's variants.")] = "vanilla",
    setting: Parameters = None,
    episode: Annotated[
        int | None, typer.Option(help="With --data: the episode to film; default: 0, the first.")
    ] = None,
    steps: Annotated[int | None, typer.Option(help="Steps at most; default: all.", min=1)] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            help="With --policy: seed of the initial state and the noise; default: 0.", min=0
        ),
    ] = None,
    fps: Annotated[
        float | None, typer.Option(help="Pictures a second of an .mp4, at most.", min=1)
    ] = None,
) -> None:
    """Film a policy, or a recording beside its simulation; needs no service and no display."""
    from api.cli import films  # imports the simulator

    check_absent(out)
    dynamics = named_values(setting)
    if (policy and episode is not None) or (data and seed is not None):
        raise InvalidInput("--episode goes with --data, and --seed with --policy")
    scene = films.Scene(task, variant, dynamics, steps, seed or 0, fps)
    if distribution is not None and (policy is None or setting):
        raise InvalidInput("--distribution goes with --policy, and without --set")
    if policy is not None and data is None and distribution is not None:
        count = films.film_beside_target(scene, policy, distribution, out)
    elif policy is not None and data is None:
        count = films.film_policy(scene, policy, out)
    elif data is not None and policy is None:
        count = films.film_recording(scene, data, episode or 0, out)
    else:
        raise InvalidInput("give either --policy or --data")
    console.print(f"{out}: {count} pictures", highlight=False)
