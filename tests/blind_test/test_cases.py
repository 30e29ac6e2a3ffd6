"""Cases are drawn at random, and the same for the same seed."""

import numpy as np

from adr_service.blind_test.cases import draw_blind


def test_a_case_is_the_same_for_the_same_seed_and_says_what_it_hides():
    (one, first), (other, second) = (
        draw_blind("arm", np.random.default_rng([5, 0])) for _ in range(2)
    )
    assert one == other
    np.testing.assert_array_equal(first.measurement.qpos, second.measurement.qpos)
    assert (one.kind, one.effects, one.ratio) == ("one", first.effects, first.ratio)


def test_what_a_case_hides_fits_its_kind():
    counts = {"none": 0, "outside": 0, "one": 1, "two": 2}
    for seed in range(12):
        hidden, _ = draw_blind("arm", np.random.default_rng(seed))
        assert len(hidden.effects) == counts[hidden.kind]
        assert (hidden.outside is not None) == (hidden.kind == "outside")
        assert (hidden.ratio == 0) == (hidden.kind == "none")
