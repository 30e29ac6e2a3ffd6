"""A long benchmark goes on where it was interrupted."""

import json

import pytest

from benchmarks.ended_cases import all_cases, without_words


def squared(job):
    return {"number": job, "square": job**2}


def run(path, jobs, one=squared, **origin):
    return all_cases(path, origin, jobs, one, lambda case: case["number"], str)


def never(job):
    raise AssertionError(f"{job} was computed again")


def test_cases_that_ended_are_not_computed_again(tmp_path, capsys):
    path = tmp_path / "new" / "squares.json"
    assert run(path, [2, 3], seed=1) == [squared(2), squared(3)]
    written = json.loads(path.read_text())
    assert written["seed"] == 1
    assert sorted(written["cases"], key=str) == [squared(2), squared(3)]  # written as they end
    assert run(path, [3], never, seed=1) == [squared(3)]
    capsys.readouterr()
    assert run(path, [2, 3, 4], seed=1) == [squared(2), squared(3), squared(4)]
    assert capsys.readouterr().out == f"{squared(4)}\n"


def test_cases_of_another_origin_are_set_aside(tmp_path):
    path = tmp_path / "squares.json"
    run(path, [2], seed=1)
    before = path.read_bytes()
    assert run(path, [3], seed=2) == [squared(3)]
    (aside,) = set(tmp_path.iterdir()) - {path}
    assert aside.read_bytes() == before
    assert json.loads(path.read_text())["seed"] == 2


def broken(job):
    if job == 3:
        raise ValueError("this one fails")
    return squared(job)


def test_a_case_that_fails_is_raised_when_the_others_have_ended(tmp_path):
    path = tmp_path / "squares.json"
    others = list(range(4, 60))
    with pytest.raises(ValueError, match="this one fails"):
        run(path, [3, *others], broken, seed=1)
    assert run(path, others, never, seed=1) == [squared(job) for job in others]


def test_words_do_not_make_a_method_another_one():
    said = '"""A module."""\ndef f(x):\n    """Twice x."""\n    return 2 * x  # exact\n'
    unsaid = "def f(x):\n    return 2 * x\n"
    assert without_words(said) == without_words(unsaid)
    assert without_words(said) != without_words(said.replace("2 * x ", "3 * x "))
    assert without_words("def f(x):\n    '''Only said.'''\n") != without_words("def g(x): pass\n")
