"""Options of `adr criticise` that go together."""

import pytest


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give either --data or --dataset"),
        (["--dataset", "data_0"], "--dataset goes with --task"),
        (["--dataset", "data_0", "--task", "arm", "--free", "x=0:1"], "takes no --model or --free"),
    ],
)
def test_options_that_exclude_each_other_are_refused(adr_here, tmp_path, arguments, message):
    status, _, errors = adr_here("criticise", "--out", str(tmp_path), *arguments)
    assert status == 2
    assert message in errors


def test_an_earlier_criticism_and_plan_are_not_overwritten(adr_here, tmp_path):
    found, plan = tmp_path / "found", tmp_path / "next.npz"
    found.mkdir()
    (found / "notes.txt").touch()
    plan.touch()
    judge = ("criticise", "--task", "arm", "--data", "nowhere.npz", "--out", str(found))
    assert "nowhere.npz cannot be read" in adr_here(*judge)[2]
    assert "next.npz is there already" in adr_here(*judge, "--next", str(plan))[2]
    (found / "verdict.json").write_text("earlier")
    status, _, errors = adr_here(*judge)
    assert status == 2
    assert "found/verdict.json is there already; give another name, or delete it" in errors
    assert (found / "verdict.json").read_text() == "earlier"


def test_a_file_in_place_of_the_folder_is_refused_before_the_work(adr_here, tmp_path):
    (tmp_path / "out").touch()
    at = ["--dataset", "data_0", "--out", str(tmp_path / "out")]
    status, _, errors = adr_here("criticise", "--task", "arm", *at)
    assert status == 2
    assert "is a file; --out is a folder" in errors.replace("\n", " ")


@pytest.mark.parametrize(
    ("out", "plan"),
    [
        ("found", "found"),
        ("found/arm", "found"),
        ("found", "found/verdict.json"),
        ("found", "other/../found/effects.json"),
        ("found", "found/report.html/next.npz"),
    ],
)
def test_a_plan_in_the_place_of_the_criticism_is_refused_before_the_work(
    adr_here, tmp_path, monkeypatch, out, plan
):
    monkeypatch.chdir(tmp_path)
    judge = ("criticise", "--task", "arm", "--data", "nowhere.npz", "--out", out)
    status, _, errors = adr_here(*judge, "--next", plan)
    assert status == 2
    assert f"--next {plan} and --out {out} exclude each other" in errors.replace("\n", " ")
    assert not list(tmp_path.iterdir())
    assert "nowhere.npz cannot be read" in adr_here(*judge, "--next", f"{out}/next.npz")[2]


@pytest.mark.parametrize("is_there", [False, True])
def test_a_criticism_that_fails_leaves_no_empty_folder(adr_here, tmp_path, is_there):
    found = tmp_path / "found"
    if is_there:
        found.mkdir()
    judge = ("criticise", "--task", "arm", "--data", "nowhere.npz", "--out", str(found))
    assert adr_here(*judge)[0] == 2
    assert found.exists() == is_there
