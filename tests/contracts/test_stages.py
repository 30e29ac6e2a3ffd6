"""Promises of every kind of stage."""

import math
import pickle
from dataclasses import FrozenInstanceError, fields, replace

import pytest

from adr_service.json_values import canonical_json
from adr_service.programs import run
from adr_service.specs import CriticismSpec, RunSpec
from adr_service.stages.base import PRIORITY, Stage, events_of
from tests.contracts.canned import CannedStages, canned
from tests.stages.examples import Speed

SMALL = {"task": "arm", "preset": "smoke", "training": {"backend": "sb3"}}


class _Listed(CannedStages):
    """Keeps the stages themselves."""

    def __init__(self):
        super().__init__()
        self.stages = []

    def all(self, stages):
        self.stages += stages
        return (yield from super().all(stages))


def examples():
    """A stage of every kind, of online and offline methods, by a name."""
    listed = _Listed()
    for method in ("bayrn", "simopt", "dropo", "sysid_smoothed"):
        list(run(RunSpec.model_validate({**SMALL, "method": method}), listed))
    robots = {**SMALL, "method": "bayrn", "target": {"kind": "external"}}
    list(run(RunSpec.model_validate(robots), listed))
    criticism = CriticismSpec.model_validate({"task": "arm", "dataset": "data_0"})
    list(run(criticism, listed, b"measured"))
    return {(stage.kind, "state" in stage.inputs): stage for stage in listed.stages}


EXAMPLES = examples()


def kinds(stage: type[Stage] = Stage):
    """All kinds of stages that are imported, without pydantic's parametrised bases."""
    for each in stage.__subclasses__():
        if hasattr(each, "kind") and each.__module__.startswith("adr_service"):
            yield each
        yield from kinds(each)


def test_every_kind_has_an_example_and_a_name_of_its_own():
    names = [each.kind for each in kinds()]
    assert len(names) == len(set(names))
    assert {kind for kind, _ in EXAMPLES} == set(names)


@pytest.mark.parametrize("stage", EXAMPLES.values(), ids=lambda stage: stage.kind)
class TestEveryKind:
    def test_it_has_a_docstring_of_its_own_and_a_known_role(self, stage):
        """Of a class without one, `dataclass` writes the signature."""
        assert not type(stage).__doc__.startswith(f"{type(stage).__name__}(")
        assert stage.role in {*PRIORITY, "robot"}

    def test_a_stored_result_is_read_as_it_was_written(self, stage):
        stored = canned(stage)
        assert stage.read(stored).to_stored() == stored

    def test_a_stand_in_has_the_form_of_a_result(self, stage):
        stored = stage.stand_in().to_stored()
        canonical_json(stored.values)
        assert stage.read(stored).to_stored() == stored

    def test_stand_ins_repeat(self, stage):
        assert stage.stand_in().to_stored() == stage.stand_in().to_stored()

    def test_the_digest_survives_a_process_border(self, stage):
        copied = pickle.loads(pickle.dumps(stage))  # noqa: S301 - our own, as Ray does
        assert copied.digest == stage.digest

    def test_the_digest_depends_on_every_input(self, stage):
        for field in fields(stage):
            other = replace(stage, **{field.name: changed(getattr(stage, field.name))})
            assert other.digest != stage.digest, field.name

    def test_another_version_has_another_digest(self, stage, monkeypatch):
        before = stage.digest
        monkeypatch.setattr(type(stage), "version", stage.version + 1)
        assert replace(stage).digest != before

    def test_the_cost_is_finite_and_no_more_on_a_faster_core(self, stage):
        slow, fast = (stage.cost(Speed(rate)).seconds for rate in (1e3, 1e6))
        assert 0 <= fast <= slow < math.inf

    def test_a_result_puts_stage_finished_on_the_record_last(self, stage):
        events = events_of(stage, stage.read(canned(stage)))
        assert events[-1].key == f"stage_finished:{stage.digest}"
        assert len({event.key for event in events}) == len(events)

    def test_inputs_are_immutable(self, stage):
        with pytest.raises(FrozenInstanceError):
            stage.task = "hopper"

    def test_an_unknown_input_is_refused(self, stage):
        with pytest.raises(TypeError, match="speed"):
            replace(stage, speed=1)


def changed(value):
    """Another value of the same type."""
    if value is None:
        return "another"
    if hasattr(value, "model_copy"):  # settings of a training or of a method
        field = "hidden" if hasattr(value, "hidden") else "name"
        return value.model_copy(update={field: changed(getattr(value, field))})
    changes = {
        bytes: lambda: value + b"x",
        str: lambda: value + "x",
        int: lambda: value + 1,
        dict: lambda: {**value, "another": 1},
        list: lambda: value[:-1],
    }
    return changes.get(type(value), lambda: _wider(value))()


def _wider(belief):
    """Another distribution of the same kind."""
    if hasattr(belief, "covariance"):
        return type(belief)(belief.space, belief.location, 2 * belief.covariance)
    return type(belief)(belief.space, belief.low, belief.low)
