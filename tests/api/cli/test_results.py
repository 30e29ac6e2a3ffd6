"""Results from the command line."""

import pytest


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["results", "bench_x", "--policy", "p"], "bench_x is no run, and has no single policy"),
        (["results", "bench_x", "--distribution", "d"], "no single policy or distribution"),
        (["results", "bench_x", "--csv", "--json"], "--json goes without --csv"),
        (["results", "bench_x", "--compare", "--csv"], "give one of --compare, --csv; --json has"),
    ],
)
def test_what_results_cannot_do_is_refused(adr_here, arguments, message):
    status, _, errors = adr_here(*arguments)
    assert status == 2
    assert message in errors


@pytest.mark.parametrize("option", ["--distribution", "--policy", "--figure"])
def test_results_overwrite_no_file(adr_here, tmp_path, option):
    (tmp_path / "returns.svg").write_text("earlier")
    status, _, errors = adr_here("results", "run_x", option, str(tmp_path / "returns.svg"))
    assert status == 2
    assert "returns.svg is there already; give another name, or delete it first" in errors
    assert (tmp_path / "returns.svg").read_text() == "earlier"


@pytest.mark.ray
@pytest.mark.parametrize("command", ["results", "claims", "cite"])
def test_an_unknown_benchmark_is_refused(adr, command):
    status, shown = adr(command, "bench_x")
    assert status == 3
    assert "there is no benchmark 'bench_x'" in shown
    assert "Traceback" not in shown
