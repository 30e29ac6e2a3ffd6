"""`adr robot`: the client of a robot."""

import os
from collections import Counter
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from adr_service.client import connect
from adr_service.errors import InvalidInput
from adr_service.whole_files import written_whole
from api.cli.files import check_writable, naming, read
from api.cli.options import Url, is_url_given
from api.cli.signals import end_as_by_ctrl_c
from api.cli.single_options import SingleOptionApp
from api.cli.terminal import console

if TYPE_CHECKING:
    from adr_service.client.robot import Limits
    from adr_service.client.robot.playback import Playback

app = SingleOptionApp()

MaxSeconds = Annotated[float | None, typer.Option(help="Longest episode, in s.", min=0.1)]
MaxResetSeconds = Annotated[
    float, typer.Option(help="Longest reset, in s; then the environment hangs.", min=0.1)
]
MaxAction = Annotated[
    list[float] | None,
    typer.Option(help="Limit each action to ± this; once for all, or once for each."),
]


Play = Annotated[
    Path | None, typer.Option(help="Commands to send, as `adr criticise --next` plans them.")
]
Out = Annotated[Path | None, typer.Option(help="Measurement that --play makes, .npz.")]


@app.command()
def robot(
    ctx: typer.Context,
    env: Annotated[str, typer.Option(help="module:factory of a Gymnasium environment.")],
    task: Annotated[str, typer.Option(help="Task that the robot has: hopper, …")],
    name: Annotated[
        str | None, typer.Option(help="Name of the robot, shown on the page; default: robot.")
    ] = None,
    play: Play = None,
    out: Out = None,
    max_seconds: MaxSeconds = None,
    max_reset_seconds: MaxResetSeconds = 120.0,
    max_action: MaxAction = None,
    episodes: Annotated[int | None, typer.Option(help="Stop after as many.", min=1)] = None,
    url: Url = None,
) -> None:
    """Run the episodes that runs with an external target ask for; see docs/robots.md.

    With --play, send the commands of a plan instead, without a service.
    """
    from adr_service.client.robot import Limits, Robot  # imports Gymnasium

    end_as_by_ctrl_c()
    limits = Limits(max_seconds, max_reset_seconds, tuple(max_action or ()))
    if (play is None) != (out is None):
        alone = "--out" if play is None else "--play"
        raise InvalidInput(f"--play goes with --out; given is {alone} alone")
    if play is not None and (episodes is not None or name is not None or is_url_given(ctx)):
        raise InvalidInput(
            "--episodes, --name and --url go without --play, which sends all episodes of the plan, "
            "and tells no service"
        )
    if play is not None and out is not None:
        _play(env, task, limits, play, out)
        return
    worker = Robot(partial(connect, url), task, env, name or "robot", limits, console.print)
    worker.work(episodes)


def _play(env: str, task: str, limits: "Limits", plan: Path, out: Path) -> None:
    from adr_service.client.robot.environment import (
        check_environment,
        closing_in_time,
        load_environment,
    )
    from adr_service.client.robot.playback import Player, about, check_commands
    from adr_service.criticism.plans import read_plan
    from adr_service.simulation.batch import control_period
    from adr_service.tasks.catalogue import get_task

    known = get_task(task)
    content = read(plan)
    with naming(plan):
        commands, start = read_plan(content, len(known.action_low), control_period(known))
    check_commands(known, commands)
    if out.suffix != ".npz":
        raise InvalidInput(f"--out is a file that ends on .npz; given {out}")
    check_writable(out)  # before anything moves
    robot = load_environment(env)
    with closing_in_time(robot, limits.reset_seconds, _abandon):
        every = np.concatenate(commands)
        check_environment(robot, about(known), limits, (every.min(axis=0), every.max(axis=0)))

        def keep(played: "Playback") -> None:
            with written_whole(out) as part:
                part.write_bytes(played.measurement.to_npz())

        player = Player(robot, known, limits, keep)

        def tell() -> None:
            _tell(player.played, len(commands), out)

        def give_up(why: str) -> None:
            try:
                tell()
            finally:
                _abandon(why)

        try:
            player.play(commands, give_up, start)
        finally:  # whatever ended it
            tell()


def _abandon(why: str) -> None:
    """End the process: nothing else ends the call that hangs."""
    try:
        console.print(f"{why}; see to the robot")
    finally:
        os._exit(1)


def _tell(played: "Playback | None", planned: int, out: Path) -> None:
    """Say what was played; without any, there is no file."""
    if played is None:
        return
    data = played.measurement
    console.print(f"{out}: {len(data.spans())} of {planned} episodes, {len(data.time)} rows")
    if played.limited:
        console.print(f"{played.limited} commands were beyond your limit, and were sent at it")
    for why, count in Counter(played.shortened).items():
        console.print(f"{count} episodes ended early: {why}")
    if played.slow:
        console.print(played.slow)
