"""Submit, follow and stop runs from the command line."""

import io
import json
import re
from pathlib import Path

import pytest
from rich.console import Console

from api.cli.runs import runs_table

pytestmark = pytest.mark.ray


def test_a_run_is_submitted_watched_listed_and_its_files_are_written(adr, tmp_path):
    code, shown = adr(
        "submit", "--task", "arm", "--method", "simopt", "--preset", "smoke",
        "--set", "method.samples=10", "--set", "seed=3", "--watch",
    )  # fmt: skip
    assert code == 0
    id = shown.split()[0]
    assert "simopt" in shown
    _, status = adr("status", id)
    assert json.loads(status)["spec"]["method"]["samples"] == 10
    assert json.loads(status)["spec"]["seed"] == 3
    assert adr("watch", id)[0] == 0
    assert "return /" in adr("results", id)[1]
    assert adr("results", id, "--csv")[1].startswith("task,variant,method")
    assert "no two methods to compare" in adr("results", id, "--compare")[1]
    assert adr("results", id, "--figure", "returns.svg")[0] == 0
    assert adr("results", id, "--policy", "policy.safetensors") == (0, "policy.safetensors\n")
    assert (tmp_path / "returns.svg").read_bytes().startswith(b"<?xml")
    assert (tmp_path / "policy.safetensors").stat().st_size > 0
    listed = adr("list", "--task", "arm", "--state", "succeeded")[1]
    assert id in listed
    assert "no such runs" in adr("list", "--task", "humanoid")[1]


def test_what_is_submitted_twice_under_one_key_is_there_once(adr):
    run = ("submit", "--task", "arm", "--method", "prior", "--preset", "smoke", "--seed", "905")
    once, again, other = (adr(*run, "--key", key)[1] for key in ("one", "one", "other"))
    assert once == again != other


def test_runs_are_listed_under_their_benchmark(adr):
    def submitted(*arguments):
        return adr("submit", *arguments, "--watch")[1].split()[0]

    Path("b.json").write_text(
        '{"tasks": ["arm"], "methods": ["udr"], "seeds": [902], "preset": "smoke"}'
    )
    benchmark = submitted("b.json")
    single = submitted("--task", "arm", "--method", "prior", "--preset", "smoke", "--seed", "903")
    code, listed = adr("list")
    assert code == 0
    own = listed.split(benchmark)[1].split("bench_")[0].split("single runs")[0]
    assert re.search(r"run_\w{16} +arm, vanilla +udr +902 +succeeded", own)
    assert single in listed.split("single runs")[1]
    runs = json.loads(adr("list", "--json")[1])["runs"]
    assert benchmark in {run["benchmark_id"] for run in runs}


def test_a_run_is_a_line_of_80_columns_and_its_names_are_whole():
    spec = {"task": "half_cheetah", "variant": "unmodeled", "seed": 3}
    run = {"id": f"run_{'0' * 16}", "state": "succeeded", "created_at": "2026-11-25T13:20:11Z"}
    table = runs_table([{**run, "spec": {**spec, "method": {"name": "dropo_smoothed"}}}])
    Console(file=(output := io.StringIO()), width=78, markup=False).print(table)
    words = output.getvalue().split()
    assert {run["id"], "half_cheetah,", "unmodeled", "dropo_smoothed", "13:20"} <= set(words)


def test_a_dry_run_of_a_file_prints_its_expected_cost(adr, tmp_path):
    (tmp_path / "b.json").write_text(
        json.dumps({"tasks": ["arm"], "methods": ["udr"], "seeds": [901], "preset": "smoke"})
    )
    code, shown = adr("submit", "b.json", "--dry-run")
    assert code == 0
    assert re.search(r"trainings, shared ones once +4", shown)
    assert "less than a minute on a core" in shown
    assert json.loads(adr("submit", "b.json", "--dry-run", "--json")[1])["plan"]["trainings"] == 4


def test_a_preset_beside_a_file_is_the_files(adr, tmp_path):
    spec = {"tasks": ["arm"], "methods": ["udr"], "seeds": [904], "preset": "demo"}
    (tmp_path / "b.json").write_text(json.dumps(spec))
    plan = json.loads(adr("submit", "b.json", "--preset", "smoke", "--dry-run", "--json")[1])
    assert {run["preset"] for run in plan["runs"]} == {"smoke"}


def test_a_benchmark_is_extended_drawn_and_compared_with_the_claims(adr, tmp_path):
    spec = {"tasks": ["arm"], "methods": ["sysid"], "seeds": [0], "preset": "smoke"}
    (tmp_path / "b.json").write_text(json.dumps({**spec, "references": False}))
    id = adr("submit", "b.json", "--watch")[1].split()[0]
    code, shown = adr("extend", id, "--method", "droid", "--watch")
    assert code == 0
    assert "droid" in shown
    assert adr("results", id, "--figures", "figures")[0] == 0
    drawn = {file.name for file in (tmp_path / "figures").iterdir()}
    assert {"returns.svg", "parameters.png", "spread.svg", "cost.csv"} <= drawn
    (tmp_path / "figures/returns.svg").unlink()
    assert "is there already" in adr("results", id, "--figures", "figures")[1]
    assert not (tmp_path / "figures/returns.svg").exists()
    assert "nothing has been measured" in adr("claims", id)[1]  # smoke does not count
    assert "had ended before" in adr("cancel", id)[1]
    assert "has no run that failed or was cancelled" in adr("resume", id)[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["submit", "--task", "arm", "--method", "magic"], "accepted: auto_dr, doraemon, epopt"),
        (["submit"], "either --task and --method, or a JSON file"),
        (["submit", "--task", "arm"], "either --task and --method, or a JSON file"),
        (
            ["submit", "b.json", "--seed", "3"],
            "beside which --preset, --extension and --set change",
        ),
        (["extend", "run_x", "--seed", "3"], "only a benchmark can be extended; given run_x"),
        (["submit", "nothing.json"], "not a readable JSON file"),
        (
            ["submit", "--task", "arm", "--method", "udr", "--set", "seed"],
            "setting is name=value",
        ),
        (["status", "run_x"], "there is no run 'run_x'"),
        (["cancel", "run_x"], "there is no run"),
        (["extend", "bench_x", "--seed", "3"], "there is no benchmark 'bench_x'"),
    ],
)
def test_a_mistake_is_one_message_without_a_traceback(adr, arguments, message):
    code, shown = adr(*arguments)
    assert code == (3 if "there is no" in message else 2)
    assert message in shown
    assert "Traceback" not in shown
