import io

import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.transitions import TransitionDataset, unnamed


def dataset(episodes=(0, 0, 0, 1, 1), **changes):
    n = len(episodes)
    rng = np.random.default_rng(0)
    fields = {
        "observations": rng.normal(size=(n, 3)),
        "actions": rng.normal(size=(n, 2)),
        "next_observations": rng.normal(size=(n, 3)),
        "episodes": np.array(episodes),
        "dt": 0.02,
        "columns": ("a [m]", "b [m]", "c [m/s]"),
        "origin": "test",
    }
    return TransitionDataset(**{**fields, **changes})


def test_npz_gives_the_same_data_and_the_same_bytes_back():
    data = dataset()
    copy = TransitionDataset.from_npz(data.to_npz())
    np.testing.assert_array_equal(copy.observations, data.observations)
    np.testing.assert_array_equal(copy.episodes, data.episodes)
    assert (copy.dt, copy.columns, copy.origin) == (data.dt, data.columns, data.origin)
    assert copy.to_npz() == data.to_npz()


def test_a_written_file_marks_the_last_row_of_each_episode():
    with np.load(io.BytesIO(dataset().to_npz())) as arrays:
        assert arrays["terminals"].tolist() == [False, False, True, False, True]


def test_a_file_with_terminals_alone_has_its_episodes():
    with np.load(io.BytesIO(dataset().to_npz())) as arrays:
        fields = {name: arrays[name] for name in arrays.files if name != "episodes"}
    buffer = io.BytesIO()
    np.savez(buffer, **fields)
    assert TransitionDataset.from_npz(buffer.getvalue()).episodes.tolist() == [0, 0, 0, 1, 1]


def test_windows_never_cross_an_episode_and_do_not_overlap():
    assert dataset().windows(1).tolist() == [0, 1, 2, 3, 4]
    assert dataset().windows(2).tolist() == [0, 3]
    assert dataset().windows(4).tolist() == []


def test_concatenated_episodes_stay_apart():
    both = TransitionDataset.concatenate([dataset(), dataset()])
    assert both.episodes.tolist() == [0, 0, 0, 1, 1, 2, 2, 2, 3, 3]
    assert [len(part) for part in both.split()] == [3, 2, 3, 2]


@pytest.mark.parametrize(
    ("second", "words"),
    [
        ({"dt": 0.05}, r"one control period; part 1 has 0\.02 s, part 2 0\.05 s"),
        ({"columns": ("a [m]", "c [m/s]", "b [m]")}, r"part 2 a \[m\], c \[m/s\], b \[m\]"),
        ({"actions": np.zeros((5, 1))}, r"part 1 has 3 observations and 2 actions, part 2 3 and 1"),
    ],
    ids=["dt", "columns", "width"],
)
def test_parts_of_different_recordings_are_not_concatenated(second, words):
    with pytest.raises(InvalidInput, match=words):
        TransitionDataset.concatenate([dataset(), dataset(**second)])


def test_parts_whose_periods_differ_by_rounding_are_concatenated():
    parts = [dataset(dt=0.02 * (1 + share)) for share in (1e-6, -1e-6)]
    assert TransitionDataset.concatenate(parts).dt == parts[0].dt


def test_parts_without_names_of_columns_go_with_named_ones():
    nameless = dataset(columns=tuple(unnamed(3).tolist()))
    assert TransitionDataset.concatenate([dataset(), nameless]).columns == dataset().columns
    other = dataset(columns=("x", "y", "z"))
    with pytest.raises(InvalidInput, match=r"part 2 has a \[m\], .*, part 3 x, y, z"):
        TransitionDataset.concatenate([nameless, dataset(), other])


def test_many_origins_together_can_still_be_read():
    """A run joins what robots have sent it one by one."""
    parts = [dataset(origin=f"robot {number} " + "x" * 130) for number in range(80)]
    joined = TransitionDataset.concatenate(parts)
    assert joined.origin.endswith(" …")
    assert TransitionDataset.from_npz(joined.to_npz()).origin == joined.origin


def test_arrays_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        dataset().observations[0, 0] = 1.0


def test_a_value_that_is_not_finite_is_refused_with_its_place():
    bad = np.zeros((5, 3))
    bad[3, 1] = np.nan
    with pytest.raises(InvalidInput, match="next_observations is not finite at row 3, column 1"):
        dataset(next_observations=bad)


@pytest.mark.parametrize(
    "changes",
    [
        {"actions": np.zeros((4, 2))},
        {"observations": np.zeros((5, 2))},
        {"episodes": np.array([0, 1, 0, 1, 1])},
        {"columns": ("a [m]",)},
        {"dt": 0.0},
        {"actions": np.zeros(5)},
    ],
    ids=["rows", "width", "order", "columns", "dt", "rank"],
)
def test_arrays_that_do_not_fit_together_are_refused(changes):
    with pytest.raises(InvalidInput):
        dataset(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"origin": "a\nb"}, r"origin has ends of lines .*: 'a\\nb'"),
        ({"columns": ("a", "b\x07", "c")}, "columns has ends of lines or control characters"),
        ({"origin": "a" * 10_001}, "origin has a text of 10001 characters; accepted are 10000"),
        (
            {"columns": ("a", "b" * 201, "c")},
            "columns has a text of 201 characters",
        ),
        (
            {"actions": np.zeros((5, 1001))},
            r"actions has the shape \(5, 1001\); ",
        ),
        ({"episodes": np.array([0, 0.5, 1, 1, 1])}, "episodes must be integers below 2"),
        ({"episodes": np.array([0, 0, 2**63, 2**63, 2**63], np.uint64)}, "integers below 2"),
        ({"episodes": np.array([0, 0, 2.0**63, 2.0**63, 2.0**63])}, "integers below 2"),
        ({"episodes": np.array([0, 0, np.inf, np.inf, np.inf])}, "integers below 2"),
        ({"episodes": np.array([0, 0, np.nan, np.nan, np.nan])}, "integers below 2"),
        ({"episodes": np.array(list("aabbb"))}, "integers below 2"),
    ],
)
def test_what_its_own_file_could_not_give_back_is_refused(changes, message):
    with pytest.raises(InvalidInput, match=message):
        dataset(**changes)


def test_ids_may_be_as_far_apart_as_they_can_be():
    lowest, highest = -(2**63), 2**63 - 1
    data = dataset(episodes=(lowest, lowest, 0, highest, highest))
    assert data.episode_count == 3


def test_bytes_that_are_no_npz_are_refused():
    with pytest.raises(InvalidInput, match="not a readable"):
        TransitionDataset.from_npz(b"not a zip")


GOOD = {
    "observations": np.zeros((4, 2)),
    "actions": np.zeros((4, 1)),
    "next_observations": np.ones((4, 2)),
    "episodes": np.array([0, 0, 1, 1]),
    "dt": np.float64(0.02),
}


def npz(**changes):
    buffer = io.BytesIO()
    np.savez(buffer, **{k: v for k, v in (GOOD | changes).items() if v is not None})
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"actions": None}, r"lacks \['actions'\]"),
        ({"episodes": None}, r"lacks \['episodes \(or terminals\)'\]"),
        ({"rewards": np.zeros(4)}, r"has \['rewards\.npy'\]; accepted: actions\.npy"),
        ({name: value[:0] for name, value in GOOD.items() if name != "dt"}, "at least one"),
        ({"dt": np.float64(np.inf)}, "must be positive"),
        ({"terminals": np.array([0, 0, 1, 1])}, "disagree about where episodes end"),
        ({"terminals": np.array([0, 2, 0, 1])}, "terminals must be 0 or 1"),
        ({"terminals": np.array(list("abcd"))}, "terminals must be"),
        ({"observations": np.array([["a", "b"]] * 4)}, "observations must hold numbers"),
        ({"episodes": np.array([0, 0, 0.5, 1])}, "episodes must be .* integers"),
        ({"dt": np.array([0.02, 0.02])}, "dt must be one number"),
        ({"observations": np.float64(1)}, "observations must be a matrix"),
        ({"observations": np.zeros((4, 1001))}, "accepted are 1 to 1000 columns"),
        ({"observations": np.zeros((4, 0))}, r"the shape \(4, 0\); accepted are 1 to 1000 columns"),
        ({"columns": np.array([1.0, 2.0])}, "columns must be a list of texts; given float64"),
        ({"columns": np.array([["a", "b"]])}, r"columns must be a list of texts; given <U1 \(1, 2"),
        ({"columns": np.array(["a", "b" * 201])}, "columns has a text of 201 characters"),
        ({"origin": np.array(["a", "b"])}, "origin must be one text"),
        ({"origin": np.zeros((0,))}, "origin must be one text; given float64"),
        ({"origin": np.array("x" * 10_001)}, "origin has a text of 10001 characters"),
    ],
    ids=lambda given: next(iter(given)) if isinstance(given, dict) else "",
)
def test_a_file_that_is_no_recording_is_refused_with_the_reason(changes, message):
    with pytest.raises(InvalidInput, match=message):
        TransitionDataset.from_npz(npz(**changes))


@pytest.mark.parametrize("kind", ["U8", "complex128"])
def test_arrays_that_are_no_real_numbers_are_refused(kind):
    given = {name: np.asarray(GOOD[name]) for name in ("actions", "next_observations", "episodes")}
    with pytest.raises(InvalidInput, match="observations must hold numbers; given"):
        TransitionDataset(
            observations=np.asarray(GOOD["observations"]).astype(kind),
            **given,
            dt=0.02,
            columns=("a", "b"),
            origin="a test",
        )


def test_episodes_are_read_from_the_ends_that_terminals_mark():
    terminals = np.array([False, True, False, False])
    data = TransitionDataset.from_npz(npz(episodes=None, terminals=terminals))
    assert data.episodes.tolist() == [0, 0, 1, 1]


def test_the_first_episodes_are_whole():
    data = TransitionDataset.from_npz(npz())
    assert data.first_episodes(1).episodes.tolist() == [0, 0]
    assert len(data.first_episodes(5)) == 4


def test_dropos_own_files_are_read(tmp_path):
    names = {"observations": "observations", "nextobservations": "next_observations"}
    for name in ("observations", "actions", "nextobservations"):
        np.save(tmp_path / f"x_{name}.npy", GOOD[names.get(name, name)])
    np.save(tmp_path / "x_terminals.npy", np.array([0, 1, 0, 1]))
    columns = ("a [m]", "b [m]")
    data = TransitionDataset.from_npy(tmp_path / "x", dt=0.1, columns=columns, origin="here")
    assert (len(data), data.dt, data.columns, data.origin) == (4, 0.1, columns, "here")
    for name in ("observations", "actions", "next_observations"):
        np.testing.assert_array_equal(getattr(data, name), GOOD[name])
    assert not np.array_equal(data.observations, data.next_observations)
    assert data.episodes.tolist() == [0, 0, 1, 1]
    (tmp_path / "x_actions.npy").write_bytes(b"")  # as on a full disk
    with pytest.raises(InvalidInput, match="cannot be read"):
        TransitionDataset.from_npy(tmp_path / "x", dt=0.1, columns=columns, origin="here")
    with pytest.raises(InvalidInput, match="cannot be read"):
        TransitionDataset.from_npy(tmp_path / "y", dt=0.1, columns=columns, origin="here")
