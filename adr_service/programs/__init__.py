"""A run: the straight-line program that the paper's figure draws, as a generator of events.

    for event in run(spec, LocalStages()):
        print(event)

offline (DROID, DROPO, sysid): data -> estimate -> train once -> evaluate on the target
online (SimOpt):               repeat: train -> visit the target -> update the estimate

Each shape of a run is one module of this package, named by the settings of the methods that have
it. The same program runs in the service, in tests, in a debugger and in a plan: `stages` alone
differs.
"""

from collections.abc import Generator
from importlib import import_module

from adr_service.errors import InvalidInput
from adr_service.events import RunEvent
from adr_service.specs import AnyRun, LostRun
from adr_service.stages.base import Stages

Program = Generator[RunEvent, None, None]


def run(spec: AnyRun | LostRun, stages: Stages, recording: bytes | None = None) -> Program:
    """Everything that happens in a run, in order; ends when the run has succeeded.

    `recording` is the `.npz` of the dataset that a spec names. Raises InvalidInput if the settings
    of the method name a program that is not there.
    """
    try:
        program = import_module(spec.program)
    except ModuleNotFoundError as error:
        raise InvalidInput(f"there is no program {spec.program!r}: {error}") from error
    return program.run(spec, stages, recording)
