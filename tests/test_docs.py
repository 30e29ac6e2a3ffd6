"""The docs say what the code does."""

import json
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adr_service.blind_test import planting
from adr_service.effects.catalogue import MECHANISMS
from adr_service.logs.mapping import ActuatorMap, JointMap, LogMap, RowsMap
from adr_service.methods.catalogue import methods
from adr_service.simulation.batch import control_period
from adr_service.specs import BenchmarkSpec
from adr_service.tasks.catalogue import BUILT_IN
from adr_service.tasks.check import check_task
from adr_service.training.policy import Policy

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs/tasks.md").read_text()


@pytest.mark.parametrize("name", BUILT_IN)
def test_the_table_of_tasks_is_right(name):
    task, variants = BUILT_IN[name].task, BUILT_IN[name].variants
    seen = str(len(task.columns))
    if task.measured < len(task.columns):
        seen += f", of which {task.measured} measured"
    cells = [
        f"`{name}`",
        seen,
        str(len(task.action_low)),
        f"{len(variants['vanilla'].source.space)} ({len(variants['unmodeled'].source.space)})",
        f"{variants['noisy'].hidden.noise_variance:.0e}".replace("e-0", "e-"),
        f"{1000 * control_period(task):g} ms",
        f"{task.reward_threshold:g}",
        f"{task.learning_rate:.0e}".replace("e-0", "e-"),
    ]
    assert f"| {' | '.join(cells)} |" in PAGE


def test_nothing_is_left_to_fill_in():
    for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        text = page.read_text()
        assert not re.search(r"@[A-Z]+@|\b[A-Z]+_(TABLE|HOURS)\b|TODO|TBD|(?m:^[A-Z]{4,}$)", text)
        for path in re.findall(r"\]\(([^)#]+)\)", text):
            assert path.startswith("http") or (page.parent / path).exists(), (page, path)


@pytest.mark.parametrize("name", BUILT_IN)
def test_the_table_of_a_tasks_parameters_is_right(name):
    hidden = BUILT_IN[name].variants["vanilla"].hidden
    wrong = {p.name: p for p in BUILT_IN[name].variants["unmodeled"].source.space.parameters}
    section = PAGE.split(f"\n## {name}\n")[1].split("\n## ")[0]
    for parameter, value in zip(hidden.source.space.parameters, hidden.values, strict=True):
        unit = "" if parameter.unit == "1" else f" {parameter.unit}"
        other = wrong.get(parameter.name)
        if other is None:
            unmodeled = f"frozen at {0.8 * value:.4g}"
        elif (other.low, other.feasible_low) == (parameter.low, parameter.feasible_low):
            unmodeled = "same"
        else:
            unmodeled = f"{other.low:g} – {other.high:g}, from {other.feasible_low:g}"
        bounds = f"{parameter.low:g} – {parameter.high:g}"
        cells = [parameter.name, f"{value:.5g}{unit}", bounds, f"{parameter.feasible_low:g}"]
        assert f"| {' | '.join(cells)} | {unmodeled} |" in section
    assert section.count("\n| ") - 1 == len(hidden.values)


@pytest.mark.slow
def test_the_sample_of_the_docs_has_the_cause_that_they_tell(tmp_path, monkeypatch, adr_here):
    page = (ROOT / "docs/criticism.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(code.replace("range(20)", "range(8)"), {})  # noqa: S102 - our own page, in less time
    (command,) = re.findall(r"^adr (.* robot.xml --data measured.npz.*?) +#", page, re.MULTILINE)
    status, shown, _ = adr_here(*command.split())
    assert status == 0
    (told,) = re.findall(r"```\n(cause .*?)```", page, re.DOTALL)
    headings, cause, verdict = told.splitlines()
    assert shown.split()[: len(headings.split())] == headings.split()
    assert verdict in shown
    (found,) = json.loads((tmp_path / "found/verdict.json").read_text())["causes"]
    assert [found["kind"], found["location"]] == cause.split()[:2]
    assert found["parameters"]["stiffness"]["value"] == pytest.approx(1.5, rel=0.01)


@pytest.mark.slow
def test_the_log_of_the_docs_becomes_the_verdict_that_they_tell(tmp_path, monkeypatch, adr_here):
    page = (ROOT / "docs/logs.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(code, {})  # noqa: S102 - our own page
    block = re.findall(r"```sh\n(adr measure run1.csv --model.*?)```", page, re.DOTALL)[-1]
    draft, *edits, measure, criticise = block.strip().splitlines()
    status, shown, _ = adr_here(*draft.split()[1:-2])
    assert status == 0
    Path("map.toml").write_text(shown)
    for edit in edits:
        subprocess.run(edit, shell=True, check=True)  # noqa: S602 - our own page
    assert adr_here(*measure.split()[1:])[0] == 0
    status, shown, _ = adr_here(*criticise.split()[1:])
    assert status == 0
    (told,) = re.findall(r"```\n(cause .*?)```", page, re.DOTALL)
    assert told.splitlines()[2] in shown
    (found,) = json.loads((tmp_path / "found/verdict.json").read_text())["causes"]
    assert [found["kind"], found["location"]] == told.splitlines()[1].split()[:2]
    assert found["parameters"]["stiffness"]["value"] == pytest.approx(1.5, rel=0.01)
    assert "joint_spring joint:shoulder" in (tmp_path / "measured.html").read_text()


@pytest.mark.slow
def test_the_blind_test_of_the_docs_is_made_answered_and_scored(tmp_path, monkeypatch, adr_here):
    page = (ROOT / "docs/blind-test.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    monkeypatch.setattr(planting, "EPISODES", 8)
    make, answer, score = re.findall(r"^adr (criticise-bench .*)$", page, re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    assert adr_here(*make.replace("--cases 60", "--cases 1").split())[0] == 0
    exec(code, {})  # noqa: S102 - our own page
    assert adr_here(*answer.split())[0] == 0
    status, shown, _ = adr_here(*score.split())
    assert status == 0
    for words in ("ours", "mine", "nothing hidden: none", "1 of 1"):
        assert words in shown


def test_the_docs_narrow_the_actions_of_a_task_and_nothing_else():
    page = (ROOT / "docs/own-task.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    namespace: dict = {}
    exec(code, namespace)  # noqa: S102 - our own page
    entry, arm = namespace["ENTRY"], BUILT_IN["arm"]
    check_task(entry)
    assert entry.task.action_high.tolist() == (-entry.task.action_low).tolist() == [0.5, 0.5]
    names = ("action_low", "action_high")
    assert replace(entry.task, name="arm", **{n: getattr(arm.task, n) for n in names}) == arm.task


def test_the_map_of_the_docs_has_every_setting():
    page = (ROOT / "docs/logs.md").read_text()
    (text,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    found = LogMap.from_toml(text)
    joint, actuator = found.joints["shoulder"], found.actuators["motor"]
    assert joint.model_fields_set == set(JointMap.model_fields) - {"derive_velocity"}
    assert actuator.model_fields_set == set(ActuatorMap.model_fields) - {"constant"}
    assert found.rows.model_fields_set == set(RowsMap.model_fields)


def test_the_loader_of_the_docs_acts_as_the_policy_does(tmp_path):
    page = (ROOT / "docs/recordings.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert "adr" not in code
    namespace: dict = {}
    exec(code, namespace)  # noqa: S102 - our own page
    rng = np.random.default_rng(0)
    ways = [("relu", "tanh", 2), ("tanh", "tanh", 2), ("tanh", "clip", 2), ("tanh", "bins", 10)]
    for activation, squash, outputs in ways:
        shapes = ((8, 3), (5, 8), (outputs, 5))
        layers = tuple(
            (
                rng.normal(size=shape).astype(np.float32),
                rng.normal(size=shape[0]).astype(np.float32),
            )
            for shape in shapes
        )
        bounds = np.array([-1.0, -3.0]), np.array([1.0, 2.0])
        policy = Policy(layers, activation, *bounds, squash)
        file = tmp_path / f"{activation}-{squash}.safetensors"
        file.write_bytes(policy.to_bytes())
        observations = rng.normal(size=(20, 3))
        found = namespace["load_policy"](file)(observations)
        np.testing.assert_array_equal(found, policy.act(observations))


@pytest.mark.parametrize("file", sorted((ROOT / "docs/examples").glob("*.json")), ids=str)
def test_the_examples_are_valid_benchmarks(file):
    assert list(BenchmarkSpec.model_validate_json(file.read_text()).runs())


def test_the_readme_counts_the_kinds_of_effects():
    assert f"one of {len(MECHANISMS)} kinds" in (ROOT / "README.md").read_text()


def test_every_method_stands_in_the_page_that_compares_them():
    page = (ROOT / "docs/methods.md").read_text()
    (table,) = re.findall(r"\| method \| target data .*?\n\n", page, re.DOTALL)
    named = re.findall(r"`(\w+)`", "".join(row.split("|")[1] for row in table.split("\n") if row))
    assert sorted(named) == sorted(methods())
