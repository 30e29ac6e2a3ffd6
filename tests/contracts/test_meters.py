"""No method reads more of the target than its meter shows."""

import pytest

from adr_service.methods.catalogue import methods, names_of
from adr_service.stages.base import StageResult
from adr_service.stages.infer import unpacked
from adr_service.stages.local import LocalStages
from adr_service.transitions import TransitionDataset
from tests.contracts.canned import CannedStages
from tests.programs.smoke import executed, iterations, smoke

LEARNING = [name for name, each in methods().items() if each.learns_from != "nothing"]


class TargetStages(CannedStages):
    """Keeps the stages, and smooths recorded states by leaving them as they are."""

    def __init__(self):
        super().__init__()
        self.executed = []

    def all(self, stages):
        self.executed += [stage for stage in stages if stage.digest not in self.results]
        return (yield from super().all(stages))

    def answer(self, stage):
        found = super().answer(stage)
        if stage.kind == "smooth_states":
            return StageResult(found.values, {"data": stage.data})
        return found


@pytest.mark.parametrize(
    "stages_of", [TargetStages, pytest.param(LocalStages, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize(
    ("name", "collector"),
    [
        *((name, "simopt") for name in LEARNING),
        *((name, "random_matched") for name in names_of("recordings")),
    ],
)
def test_no_method_reads_more_of_the_target_than_its_meter_shows(name, collector, stages_of):
    stages = stages_of()
    spec = smoke(name, variant="noisy", collector=collector, iterations=2)
    events = iterations(spec, stages)
    assert [name for event in events for name in event.inferences]
    for event in events:
        assert unmetered(event, stages) == []


def test_data_beyond_the_meter_are_found():
    stages = TargetStages()
    for name in ("bayrn", "dropo"):
        last = iterations(smoke(name), stages)[-1]
        less = {"target_rollouts": 0, "target_transitions": last.target_transitions - 1}
        assert len(unmetered(last.model_copy(update=less), stages)) == 1


def unmetered(event, stages):
    """Data that an iteration's inferences read beyond its meter."""
    own = {stage.digest: stage for stage in stages.executed}
    read = [own[digest] for digest in event.inferences]
    return [each for stage in read for each in _beyond(stage, event, stages)]


def _beyond(stage, event, stages):
    if stage.kind == "propose":
        shown = [s.read(stages.results[s.digest]).earned for s in executed(stages, "target_return")]
        assert set(stage.returns) <= set(shown)
        return [stage.returns] if len(stage.returns) > event.target_rollouts else []
    data = TransitionDataset.from_npz(stage.data)
    shown = [s.read(stages.results[s.digest]).data for s in executed(stages, "target_rollout")]
    recorded = [TransitionDataset.from_npz(each) for each in shown]
    assert rows(data) <= set().union(*(rows(each) for each in recorded))
    method = stage.inputs.get("method", {"name": "smoothing"})["name"]
    if not method.endswith("_smoothed"):
        states = {tuple(state) for each in recorded for state in each.observations.tolist()}
        assert {tuple(state) for state in data.observations.tolist()} <= states
    before = unpacked(stage.blobs.get("earlier"))
    for _, each in before:
        assert rows(each) <= set().union(*(rows(one) for one in recorded))
    read = len(data) + sum(len(each) for _, each in before)
    return [data] if read > event.target_transitions else []


def rows(data):
    """The transitions as values; of states that may be smoothed, what they led to."""
    pairs = zip(data.actions.tolist(), data.next_observations.tolist(), strict=True)
    return {(*action, *after) for action, after in pairs}
