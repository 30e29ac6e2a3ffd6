import numpy as np
import pytest

from adr_service.benchmark.truth import estimation_error, true_values
from adr_service.tasks.catalogue import catalogue, variant_of

CASES = [(task, variant) for task, entry in catalogue().items() for variant in entry.variants]


@pytest.mark.parametrize(("task", "variant"), CASES)
def test_the_truth_is_no_distance_from_itself(task, variant):
    pair = variant_of(task, variant)
    assert estimation_error(task, variant, pair.truth) == 0
    known = true_values(task, variant)
    assert [known[name] for name in pair.source.space.names] == pair.truth.tolist()


def test_the_distance_is_the_root_mean_square_over_parameters():
    pair = variant_of("arm", "vanilla")
    space = pair.source.space
    moved = space.denormalise(space.normalise(pair.truth) + np.array([2.0, 0, 0, 0]))
    assert estimation_error("arm", "vanilla", moved) == pytest.approx(1.0)
