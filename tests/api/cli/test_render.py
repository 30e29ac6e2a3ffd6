"""Options of `adr render` that go together."""

import pytest


@pytest.mark.parametrize("given", [[], ["--policy", "p.bin", "--data", "d.npz"]], ids=str)
def test_a_film_needs_either_a_policy_or_a_recording(adr_here, tmp_path, given):
    code, _, errors = adr_here("render", str(tmp_path / "film.gif"), "--task", "arm", *given)
    assert code == 2
    assert "give either --policy or --data" in errors


@pytest.mark.parametrize(
    "given", [["--policy", "p.bin", "--episode", "2"], ["--data", "d.npz", "--seed", "0"]], ids=str
)
def test_options_of_the_other_kind_of_film_are_refused(adr_here, tmp_path, given):
    code, _, errors = adr_here("render", str(tmp_path / "film.gif"), "--task", "arm", *given)
    assert code == 2
    assert "--episode goes with --data, and --seed with --policy" in errors


def test_a_film_overwrites_nothing(adr_here, tmp_path):
    (film := tmp_path / "film.gif").write_text("earlier")
    code, _, errors = adr_here("render", str(film), "--task", "arm", "--data", "d.npz")
    assert code == 2
    assert "film.gif is there already; give another name, or delete it first" in errors
    assert film.read_text() == "earlier"


def test_a_parameter_needs_a_value(adr_here, tmp_path):
    given = ["--task", "arm", "--data", "d.npz", "--set", "torso_mass"]
    code, _, errors = adr_here("render", str(tmp_path / "film.gif"), *given)
    assert code == 2
    assert "torso_mass" in errors
