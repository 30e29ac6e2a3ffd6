"""A kind of stage of our own, in this file alone: it runs, is priced, stored and read again."""

import pickle
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest

from adr_service.benchmark.plan import MeasuredSpeed
from adr_service.distributions import Uniform
from adr_service.errors import InvalidInput
from adr_service.parameters import ParameterSpace
from adr_service.plugins import TASKS
from adr_service.stages.base import (
    Belief,
    CoreSpeed,
    Cost,
    Result,
    Role,
    Stage,
    StageResult,
    compute,
)
from adr_service.stages.local import LocalStages, drained
from adr_service.tasks.catalogue import source_of
from db import runs
from tests.db.rows import EXECUTION, SPEC
from tests.packages import add_entry_point
from workers.results import DatabaseResults, Outcome


class Dice(Result):
    numbers: list[int]
    picture: bytes
    belief: Belief
    remark: str | None = None


@dataclass(frozen=True, kw_only=True)
class ThrowDice(Stage[Dice]):
    """Throw some dice."""

    kind: ClassVar = "throw_dice"
    version: ClassVar = 1
    role: ClassVar[Role] = "inference"
    result: ClassVar = Dice

    count: int
    table: bytes | None = None

    @property
    def space(self) -> ParameterSpace:
        return source_of(self.task, "vanilla").space

    def compute(self, rng, progress) -> Dice:
        progress(0.5, thrown=self.count)
        space = self.space
        return Dice(
            numbers=rng.integers(1, 7, self.count).tolist(),
            picture=b"dots",
            belief=Uniform(space, space.low, space.high),
        )

    def events(self, result: Dice) -> list[Any]:
        return []

    def cost(self, speed: CoreSpeed) -> Cost:
        return Cost(self.count / speed.steps_per_second(self.task))

    def stand_in(self) -> Dice:
        space = self.space
        return Dice(numbers=[], picture=b"", belief=Uniform(space, space.low, space.high))


STAGE = ThrowDice(task="arm", count=5)


def test_a_kind_of_stage_needs_its_file_alone_to_run():
    stages = LocalStages()
    first, again = drained(stages.all([STAGE, STAGE]))
    assert first.numbers == again.numbers
    assert len(stages.executed) == 1
    assert isinstance(first.belief, Uniform)


def test_a_kind_of_stage_needs_its_file_alone_to_be_priced():
    assert STAGE.cost(MeasuredSpeed()).seconds > 0


def test_a_kind_of_stage_needs_its_file_alone_to_be_stored(file_database):
    results, run_id = DatabaseResults(file_database), runs.create_run(file_database, SPEC).id
    result = compute(STAGE)
    results.commit([Outcome(STAGE, result, EXECUTION, None, [run_id])])
    found = results.find(STAGE, run_id)
    assert found == result
    assert STAGE.read(found).picture == b"dots"


def test_a_stage_of_another_version_than_this_process_has_is_not_computed(tmp_path, monkeypatch):
    add_entry_point(tmp_path, TASKS, "math:pi", "newer_here")
    monkeypatch.syspath_prepend(tmp_path)
    stage = ThrowDice(task="newer_here", package="broken 0.9", count=5)
    message = "this process has broken 1.0, the stage is of broken 0.9: install one version"
    with pytest.raises(InvalidInput, match=message):
        compute(stage)


def test_a_stage_of_another_version_of_its_kind_is_not_computed(monkeypatch):
    """A node that was forgotten in an upgrade answered under the digest of the new version."""
    stage = ThrowDice(task="arm", count=5)
    assert stage.digest == STAGE.digest  # it is pickled with the stage
    there = pickle.loads(pickle.dumps(stage))  # noqa: S301 - our own
    monkeypatch.setattr(ThrowDice, "version", 7)
    with pytest.raises(InvalidInput, match="computes version 7 of throw_dice, and was asked for"):
        compute(there)


def test_random_numbers_come_from_the_digest():
    more = replace(STAGE, table=b"felt")
    assert compute(STAGE) == compute(STAGE)
    assert compute(more).values["numbers"] != compute(STAGE).values["numbers"]


def test_bytes_are_blobs_and_what_has_no_value_is_left_out():
    assert STAGE.inputs == {"task": "arm", "count": 5}
    assert STAGE.blobs == {}
    assert compute(STAGE).blobs == {"picture": b"dots"}
    assert "remark" not in compute(STAGE).values


def test_a_digest_does_not_depend_on_the_order_of_inputs():
    assert ThrowDice(count=5, task="arm").digest == STAGE.digest


def test_a_stored_result_with_fields_of_another_kind_is_refused():
    wrong = StageResult({"numbers": [1], "colour": "red"}, {"picture": b""})
    with pytest.raises(ValueError, match="colour"):
        STAGE.read(wrong)


def test_numbers_that_are_not_finite_cannot_be_stored():
    class Heat(Result):
        degrees: float

    with pytest.raises(ValueError, match="finite"):
        Heat(degrees=np.inf)
