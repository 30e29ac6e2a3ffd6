"""Results, figures and claims of a benchmark."""

import csv
import io

import pytest

pytestmark = pytest.mark.ray


def test_results_come_as_json_csv_and_figures(service, http, benchmark):
    rows = service.client.results(benchmark)["rows"]
    assert [row["method"] for row in rows] == ["dropo", "dropo", "prior", "oracle"]
    table = list(csv.DictReader(io.StringIO(service.client.results_csv(benchmark))))
    assert [float(r["normalised_return"]) for r in table] == [
        row["normalised_return"] for row in rows
    ]
    names = service.client.figures(benchmark)
    assert names == ["returns", "profile", "parameters", "spread", "cost"]
    for name in names:
        assert service.client.figure(benchmark, f"{name}.png").startswith(b"\x89PNG")
        assert b"<svg" in service.client.figure(benchmark, f"{name}.svg")
    drawn = csv.DictReader(io.StringIO(service.client.figure(benchmark, "cost.csv").decode()))
    assert all(float(row["inference_seconds"]) > 0 for row in drawn)


@pytest.mark.parametrize("name", ["results?format=csv", "figures/cost.csv"])
def test_a_table_that_is_saved_has_the_name_of_its_benchmark(http, benchmark, name):
    headers = http.get(f"/v1/benchmarks/{benchmark}/{name}").headers
    table = "cost" if "cost" in name else "results"
    assert headers["Content-Disposition"] == f'attachment; filename="{benchmark}-{table}.csv"'


def test_smoke_runs_bear_on_no_claim(service, benchmark):
    assert service.client.claims(benchmark) == []  # smoke runs mean nothing
    assert service.client.claims() == []
