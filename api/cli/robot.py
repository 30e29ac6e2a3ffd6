"""`adr robot`: the client of a robot."""

from functools import partial
from typing import Annotated

import typer

from api.cli.options import Url
from api.cli.terminal import console
from api.client import connect
from api.settings import DEFAULT_URL

app = typer.Typer()

MaxSeconds = Annotated[float | None, typer.Option(help="Longest episode, in s.", min=0.1)]
MaxResetSeconds = Annotated[
    float, typer.Option(help="Longest reset, in s; then the environment hangs.", min=0.1)
]
MaxAction = Annotated[
    list[float] | None,
    typer.Option(help="Limit each action to ± this; once for all, or once for each."),
]


@app.command()
def robot(
    env: Annotated[str, typer.Option(help="module:factory of a Gymnasium environment.")],
    task: Annotated[str, typer.Option(help="Task that the robot has: hopper, …")],
    name: Annotated[str, typer.Option(help="Name of the robot, shown on the page.")] = "robot",
    max_seconds: MaxSeconds = None,
    max_reset_seconds: MaxResetSeconds = 120.0,
    max_action: MaxAction = None,
    episodes: Annotated[int | None, typer.Option(help="Stop after as many.", min=1)] = None,
    url: Url = DEFAULT_URL,
) -> None:
    """Run the episodes that runs with an external target ask for; see docs/robots.md."""
    from api.robot import Limits, Robot  # imports Gymnasium

    limits = Limits(max_seconds, max_reset_seconds, tuple(max_action or ()))
    worker = Robot(partial(connect, url), task, env, name, limits, console.print)
    worker.work(episodes)
