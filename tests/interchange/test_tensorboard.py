"""Learning curves, read by TensorBoard."""

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from adr_service.errors import InvalidInput
from adr_service.interchange.tensorboard import write_events

CURVES = [
    {
        "training": 0,
        "steps": 100,
        "mean_return": 1.0,
        "standard_error": 0.1,
        "time": "2026-01-01T00:00:00Z",
    },
    {
        "training": 0,
        "steps": 200,
        "mean_return": 2.0,
        "standard_error": 0.2,
        "time": "2026-01-01T00:00:05Z",
    },
    {"training": 1, "steps": 100, "mean_return": 3.0, "standard_error": 0.3},
]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_tensorboard_reads_each_training_as_a_run(tmp_path):
    write_events(tmp_path / "run", CURVES)
    found = EventAccumulator(str(tmp_path / "run/training_0")).Reload().Scalars("eval/mean_reward")
    assert [(each.step, each.value, each.wall_time) for each in found] == [
        (100, 1.0, 1767225600.0),
        (200, 2.0, 1767225605.0),
    ]
    other = EventAccumulator(str(tmp_path / "run/training_1")).Reload()
    (error,) = other.Scalars("eval/standard_error")
    assert error.value == pytest.approx(0.3)
    with pytest.raises(InvalidInput, match="is there already"):
        write_events(tmp_path / "run", CURVES)
