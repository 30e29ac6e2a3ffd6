"""Results, costs and plans as tables on a terminal."""

import io
import re
from dataclasses import replace

import pytest
from rich.console import Console

from api.cli.tables import (
    candidates_table,
    claims_table,
    comparisons_table,
    cost_table,
    plan_table,
    results_table,
)
from workers.tuning import Candidate, Trial

ROW = {"task": "half_cheetah", "variant": "unmodeled", "method": "simopt", "iteration": 5}
ROW |= {"collector": "simopt", "normalised_return": 0.99, "low": 0.12, "high": 1.03}
ROW |= {"seeds": 3, "episodes": 150, "target_transitions": 1000}
ROW |= {"estimation_error": 0.12, "posterior_std": 0.012}
EMPTY = {"rows": [], "estimates": [], "comparisons": [], "not_compared": [], "note": "a note"}
PLAN = {"runs": 2, "trainings": 3, "environment_steps": 12_000, "target_transitions": 40}
PLAN |= {
    "stored": 0,
    "core_hours": 0.5,
    "hours": 0.25,
    "cores": 2,
    "policies_mb": 1.5,
    "basis": "a guess",
}
COST = {"kinds": [], "utilisation": None, "note": "a note"}
TRIAL = Trial(
    changes={"hidden": [64, 64], "activation": "relu"},
    seed=0,
    steps=1000,
    cpu_seconds=50.0,
    best_return=12.0,
    reached_threshold=True,
    stopped_early=False,
)


def shown(table, width=80):
    Console(file=(output := io.StringIO()), width=width, markup=False).print(table)
    return output.getvalue()


def test_a_results_row_keeps_its_names_and_interval_on_80_columns():
    text = shown(results_table({"rows": [ROW], "note": ""}))
    assert " [0.12, 1.03] " in text
    assert "half_cheetah, unmodeled" in text
    assert "…" not in text


def test_long_names_are_whole_on_80_columns():
    method = {"method": "dropo_smoothed", "collector": "random_matched", "other": "simopt_memory"}
    pair = {"difference": -0.1, "difference_low": -0.2, "difference_high": 0.1, "probability": 0.2}
    estimate = {"seed": 0, "iteration": 5, "parameter": "foot_left_friction", "unit": "kg m2"}
    for text in (
        shown(results_table({"rows": [{**ROW, **method}], "note": ""})),
        shown(comparisons_table({**EMPTY, "comparisons": [{**ROW, **method, **pair}]})),
        shown(results_table({**EMPTY, "estimates": [method | estimate | {"mean": 1, "std": 0.1}]})),
    ):
        words = text.split()
        assert "dropo_smoothed" in words
        assert {"simopt_memory", "0.012", "foot_left_friction"} & set(words)
        assert max(map(len, text.splitlines())) <= 80


def test_a_result_table_has_a_part_for_each_task_and_variant():
    rows = [ROW, {**ROW, "variant": "noisy"}, {**ROW, "method": "dropo"}]
    lines = shown(results_table({"rows": rows, "note": ""})).splitlines()
    titles = [line.strip() for line in lines if "half_cheetah" in line]
    assert titles == ["half_cheetah, unmodeled", "half_cheetah, noisy"]
    assert next(i for i, line in enumerate(lines) if "dropo" in line) < lines.index(
        next(line for line in lines if "noisy" in line)
    )


def test_a_row_names_its_collector_unless_that_is_simopt():
    text = shown(results_table({"rows": [{**ROW, "collector": "random"}], "note": ""}), 200)
    assert "simopt on random" in text
    assert " on simopt" not in shown(results_table({"rows": [ROW], "note": ""}), 200)


def test_results_without_returns_are_the_estimates_and_without_those_a_sentence():
    estimate = {"method": "droid", "seed": 0, "iteration": 0, "parameter": "mass"}
    estimate |= {"mean": 1.25, "std": 0.01, "unit": "kg"}
    text = shown(results_table({**EMPTY, "estimates": [estimate]}))
    assert "1.25" in text
    assert "kg" in text
    assert "no iteration has finished yet" in shown(results_table(EMPTY))


def test_one_method_alone_has_nothing_to_compare_with():
    assert "no two methods to compare" in shown(comparisons_table(EMPTY))


def test_a_comparison_has_its_interval():
    pair = {"task": "arm", "variant": "noisy", "method": "simopt", "other": "udr", "seeds": 3}
    pair |= {"iteration": 2, "probability": 0.8, "low": 0.5, "high": 1.0}
    pair |= {"difference": 0.25, "difference_low": -0.1, "difference_high": 0.6}
    some = {**EMPTY, "comparisons": [pair], "not_compared": ["bayrn (arm noisy)"]}
    text = shown(comparisons_table(some))
    assert "too few seeds of bayrn (arm noisy)" in " ".join(text.split())
    assert "a note" in text  # that a reader must know, as of the preset smoke
    assert "+0.25" in text
    assert "[-0.10, 0.60]" in text
    assert "0.80" in text


def test_one_seed_has_no_interval():
    text = shown(results_table({"rows": [{**ROW, "low": None, "high": None}], "note": ""}))
    assert "[" not in text
    assert "–" in text


@pytest.mark.parametrize(
    ("hours", "text"),
    [
        (0.001, "less than a minute"),
        (0.25, "15 minutes"),
        (3, "3 hours"),
        (990, "990 hours"),
        (None, "no cores"),
    ],
)
def test_a_plan_has_its_duration_in_words(hours, text):
    assert re.search(
        rf"time, with 2 cores, at most .*{text}", shown(plan_table({**PLAN, "hours": hours}))
    )


def test_a_plan_tells_how_many_stages_cost_nothing():
    assert "have their results already" not in shown(plan_table(PLAN))
    assert "have their results already  12" in shown(plan_table({**PLAN, "stored": 12}))


def test_brackets_in_claims_are_no_styles():
    finding = {"claim": "[bold]", "statement": "s", "verdict": "undecided", "evidence": ["a [b]"]}
    finding["seeds_needed"] = 7
    text = shown(claims_table({"preset": "quick", "changed": {"n": 1}, "findings": [finding]}))
    assert "[bold]" in text
    assert "a [b]" in text
    assert "about 7 seeds" in text
    assert "preset quick, but n = 1" in text


def test_utilisation_is_shown_once_it_is_known():
    assert "other machines computed all" in shown(cost_table(COST))
    used = dict.fromkeys(("computing", "waiting", "orchestration", "starting", "preparing"), 2.0)
    used |= {"useful": 0.9, "overhead": 0.02, "cores": 4, "seconds": 10}
    text = shown(cost_table({**COST, "utilisation": used}))
    assert "useful work 90.0%, orchestration 2.0% of up to 4 cores in 10 s" in text
    assert re.search(r"all +10\.0", text)


def test_kinds_of_stages_are_added_up():
    kind = {"kind": "train", "stages": 2, "seconds": 3.0, "cpu_seconds": 2.5}
    kinds = [{**kind, "preparing_seconds": 0.5}, {**kind, "preparing_seconds": 1.0}]
    text = shown(cost_table({**COST, "kinds": kinds}))
    assert re.search(r"all +4 +6\.0 +5\.0 +1\.5", text)


def test_a_candidate_has_the_median_and_range_of_its_trials():
    reached = [replace(TRIAL, seed=i, cpu_seconds=float(s)) for i, s in enumerate((50, 40, 90))]
    failed = replace(TRIAL, best_return=None, reached_threshold=False, error="it broke [x]")
    text = shown(candidates_table([Candidate([*reached, failed])]), width=120)
    assert 'hidden=[64, 64], activation="relu"' in text
    assert "3 of 4" in text
    assert "50 [40, 90]" in text
    assert "it broke [x]" in text


def test_a_candidate_of_which_nothing_is_known_has_dashes():
    failed = replace(TRIAL, best_return=None, reached_threshold=False)
    assert shown(candidates_table([Candidate([failed])])).count("–") == 2


def test_results_that_no_claim_is_about_are_a_sentence():
    finding = {"claim": "V1", "statement": "s", "verdict": "not measured", "evidence": []}
    finding["seeds_needed"] = None
    text = shown(claims_table({"preset": "demo", "changed": {}, "findings": [finding]}))
    assert text == "preset demo: the paper has no claim on these tasks or methods\n"
