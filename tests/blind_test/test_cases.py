"""Cases are drawn at random, and the same for the same seed."""

import numpy as np

from adr_service.blind_test.cases import draw_blind

SEEDS = (0, 2, 3, 18)  # one of each kind


def test_a_case_is_the_same_for_the_same_seed_and_says_what_it_hides():
    (one, first), (other, second) = (
        draw_blind("arm", np.random.default_rng([5, 0])) for _ in range(2)
    )
    assert one == other
    np.testing.assert_array_equal(first.measurement.qpos, second.measurement.qpos)
    assert (one.kind, one.effects, one.ratio) == ("one", first.effects, first.ratio)


def test_what_a_case_hides_fits_its_kind():
    counts = {"none": 0, "outside": 0, "one": 1, "two": 2}
    drawn = [draw_blind("arm", np.random.default_rng(seed))[0] for seed in SEEDS]
    assert {hidden.kind for hidden in drawn} == set(counts)
    for hidden in drawn:
        assert len(hidden.effects) == counts[hidden.kind]
        assert (hidden.outside is not None) == (hidden.kind == "outside")
        assert (hidden.ratio == 0) == (hidden.kind == "none")
