"""The whole protocol on Hopper over REST, with trainings too short to mean anything.

`ADR_KEEP=build/protocol` keeps the figures, to be looked at.
"""

import os
from pathlib import Path

import pytest

from adr_service.benchmark.claims import CLAIMS
from tests.service import start_service, wait_until_finished

pytestmark = [pytest.mark.ray, pytest.mark.slow]

BENCHMARK = {
    "tasks": ["hopper"],
    "variants": ["vanilla", "noisy", "unmodeled"],
    "methods": [
        "udr",
        "bayrn",
        {"name": "simopt", "samples": 200},
        {"name": "simopt_1", "samples": 100},
        "droid",
        {"name": "dropo", "budget": 500, "epsilon": [1e-5, 1e-4, 1e-3]},
        "sysid",
    ],
    "collectors": ["simopt", "prior", "random"],
    "seeds": [0],
    "preset": "paper",
    "evaluation_episodes": 10,
    "training": {
        "backend": "sb3",
        "max_steps": 2000,
        "hidden": [32, 32],
        "batch_size": 32,
        "evaluate_every": 2000,
        "evaluation_episodes": 4,
    },
}
FIGURES = ["returns-vanilla", "returns-noisy", "returns-unmodeled"]
FIGURES += ["collection", "parameters", "spread", "cost"]


def test_all_methods_run_through_the_protocol_on_hopper(tmp_path):
    keep = Path(os.environ.get("ADR_KEEP", tmp_path))
    keep.mkdir(parents=True, exist_ok=True)
    with start_service(tmp_path, cpus=2) as service:
        client = service.client
        id = client.submit_benchmark(BENCHMARK)["id"]
        final = wait_until_finished(client, id, 3 * 3600)
        failed = [run["error"] for run in final["runs"] if run["state"] != "succeeded"]
        assert not failed
        rows = client.results(id)["rows"]
        for method in ("simopt", "simopt_1", "droid", "dropo", "sysid"):
            mine = [r for r in rows if r["method"] == method and r["collector"] == "simopt"]
            for variant in BENCHMARK["variants"]:
                seen = [r["target_rollouts"] for r in mine if r["variant"] == variant]
                assert seen == [0, 1, 2, 3, 4, 5]
        assert all(r["target_transitions"] <= 200 * r["iteration"] for r in mine)
        assert client.figures(id) == FIGURES
        for name in FIGURES:
            for kind in ("svg", "png", "csv"):
                (keep / f"{name}.{kind}").write_bytes(client.figure(id, f"{name}.{kind}"))
        (keep / "results.csv").write_text(client.results_csv(id))
        (report,) = client.claims(id)
        assert [finding["claim"] for finding in report["findings"]] == [c.name for c in CLAIMS]
        assert report["changed"]["training.max_steps"] == 2000
        assert all(cost["inference_seconds"] > 0 for cost in client.results(id)["costs"])
