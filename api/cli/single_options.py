"""Commands that refuse a second value of an option that takes one, and numbers without an end."""

import math
from collections import Counter
from typing import Any

from typer import Typer
from typer.core import TyperCommand


class SingleOptionCommand(TyperCommand):
    """A command that refuses a second value of an option that is not a list, and infinity.

    Click keeps the last one: of `--task hopper --task arm`, hopper would be lost without a word.
    It takes infinity for a number of any range, and a robot's longest episode would have no end.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Count the options before Click keeps one of each."""
        _, _, given = self.make_parser(ctx).parse_args(args=list(args))
        for option, times in Counter(given).items():
            has_one_value = not getattr(option, "is_flag", False) and not option.multiple
            if times > 1 and has_one_value:
                ctx.fail(f"Option {option.opts[0]} takes one value; it was given {times} times.")
        left = super().parse_args(ctx, args)
        for name, value in ctx.params.items():
            if isinstance(value, float) and not math.isfinite(value):
                ctx.fail(f"Option --{name.replace('_', '-')} takes a finite number; given {value}.")
        return left


class SingleOptionApp(Typer):
    """An application of such commands."""

    def command(self, name: str | None = None, **settings: Any) -> Any:
        """Register a command, as `Typer.command` does."""
        return super().command(name, cls=SingleOptionCommand, **settings)
