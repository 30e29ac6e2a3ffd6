"""The pages for browsers."""

import re

import pytest

from tests.api.smoke import SMOKE
from tests.service import until

pytestmark = pytest.mark.ray


def test_the_page_of_a_benchmark_shows_its_figures(http, benchmark):
    page = http.get(f"/benchmarks/{benchmark}").text
    assert "dropo" in page
    for name in ("returns.svg", "spread.png", "cost.csv"):
        assert f"/v1/benchmarks/{benchmark}/figures/{name}" in page
    assert "these numbers mean nothing" in page
    assert benchmark in http.get("/").text


def test_the_page_of_a_run_shows_its_events(http, finished):
    page = http.get(f"/runs/{finished}").text
    assert "iteration_finished" in page
    assert f"/v1/runs/{finished}/figures/returns.svg" in page
    assert f'href="/runs/{finished}"' in http.get("/").text
    assert http.get("/runs/run_0").status_code == 404


def test_the_page_of_a_run_shows_how_its_inference_ended(http, benchmark):
    """The loss, and parameters at their limits."""
    runs = http.get(f"/v1/benchmarks/{benchmark}").json()["runs"]
    run = next(each["id"] for each in runs if each["spec"]["method"]["name"] == "dropo")
    facts = http.get(f"/v1/runs/{run}/distribution").json()["diagnostics"]
    page = http.get(f"/runs/{run}").text
    assert f"{facts['loss_per_window']:.3f}" in page
    inference = page.split("<h2>Inference</h2>")[1].split("<h2>Events</h2>")[0]
    assert all(name in inference for name in facts["at_bound"] + facts["widest"])


def test_a_running_stage_links_to_its_actor_in_rays_dashboard(service, http):
    # there until it is cancelled
    training = {"max_steps": 1_000_000, "stop_at_threshold": False}
    long = {**SMOKE, "method": "prior", "seed": 80, "training": training}
    run = service.client.submit_run(long)["id"]
    link = re.compile(r'href="(http://\S+)/#/actors/\w{32}">adr:run_\w+:trainer:\d+<')
    found = until(lambda: link.search(http.get(f"/runs/{run}").text))
    assert found.group(1) == http.get("/readyz").json()["dashboard"]
    http.post(f"/v1/runs/{run}/cancel")
