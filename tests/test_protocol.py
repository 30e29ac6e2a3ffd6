"""The whole protocol on Hopper over REST, with trainings and searches too short to mean anything.

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
        {"name": "simopt", "samples": 50},
        {"name": "simopt_1", "samples": 20},
        {"name": "droid", "budget": 100},
        {"name": "dropo", "budget": 200, "epsilon": 1e-4},
        {"name": "sysid", "starts": 1, "iterations": 10},
    ],
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
STUDY = {
    **BENCHMARK,
    "variants": ["noisy"],
    "methods": BENCHMARK["methods"][2:6],
    "collectors": ["simopt", "prior", "random"],
}


def test_all_methods_run_through_the_protocol_on_hopper(tmp_path):
    keep = Path(os.environ.get("ADR_KEEP", tmp_path))
    keep.mkdir(parents=True, exist_ok=True)

    def finished(client, spec, figures):
        id = client.submit_benchmark(spec)["id"]
        final = wait_until_finished(client, id, 3 * 3600)
        assert final["states"] == {"succeeded": len(final["runs"])}
        assert client.figures(id) == figures
        for name in figures:
            for kind in ("svg", "png", "csv"):
                (keep / f"{name}.{kind}").write_bytes(client.figure(id, f"{name}.{kind}"))
        return id

    with start_service(tmp_path, cpus=2) as service:
        client = service.client
        returns = [f"returns-{variant}" for variant in BENCHMARK["variants"]]
        id = finished(client, BENCHMARK, [*returns, "parameters", "spread", "cost"])
        rows = client.results(id)["rows"]
        for method in ("simopt", "simopt_1", "droid", "dropo", "sysid"):
            mine = [r for r in rows if r["method"] == method]
            for variant in BENCHMARK["variants"]:
                seen = [r["target_rollouts"] for r in mine if r["variant"] == variant]
                assert seen == [0, 1, 2, 3, 4, 5]
            assert all(r["target_transitions"] <= 200 * r["iteration"] for r in mine)
        (keep / "results.csv").write_text(client.results_csv(id))
        (report,) = client.claims(id)
        assert [finding["claim"] for finding in report["findings"]] == [c.name for c in CLAIMS]
        assert report["changed"]["training.max_steps"] == 2000
        assert all(cost["inference_seconds"] > 0 for cost in client.results(id)["costs"])
        before = len(service.started_stages)
        finished(client, STUDY, ["returns", "collection", "parameters", "spread", "cost"])
        # SimOpt's trajectories are there, and the prior's are SimOpt-1's; random ones are new.
        # Each answer is inferred, trained on and evaluated; that to the prior's first is known.
        assert len(service.started_stages) - before == 5 + 2 * (4 + 5) * 3
