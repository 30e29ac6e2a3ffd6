"""`adr archive`: benchmarks to files and back."""

import json
import re

import pytest

from tests.archives import rewritten, with_rows, without_results

pytestmark = pytest.mark.ray


@pytest.fixture
def file(adr, benchmark, tmp_path):
    """A benchmark's archive."""
    code, out = adr("archive", "export", benchmark, "a.adr")
    assert (code, out.split(":")[0]) == (0, "a.adr")
    return tmp_path / "a.adr"


def test_an_export_overwrites_nothing(adr, benchmark, file):
    before = file.read_bytes()
    code, out = adr("archive", "export", benchmark, "a.adr")
    assert (code, "a.adr is there already" in out) == (2, True)
    assert file.read_bytes() == before


def test_an_export_that_fails_leaves_no_file(adr, tmp_path):
    assert adr("archive", "export", "bench_nothing", "b.adr")[0] == 3
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("option", "name"),
    [
        ("method", "udr"),
        ("task", "hopper"),
        ("variant", "noisy"),
        ("collector", "prior"),
        ("seed", "5"),
    ],
)
def test_a_part_is_chosen_by_members_that_are_there(option, name, adr, benchmark, tmp_path):
    code, out = adr("archive", "export", benchmark, "part.adr", f"--{option}", name)
    assert (code, f"the benchmark has no {option}s {name}; it has " in out) == (2, True)
    assert list(tmp_path.iterdir()) == []


def test_a_part_that_is_all_of_it_has_the_same_bytes(adr, benchmark, file, tmp_path):
    chosen = ("--seed", "0", "--method", "dropo", "--task", "arm", "--variant", "vanilla")
    assert adr("archive", "export", benchmark, "part.adr", *chosen)[0] == 0
    assert (tmp_path / "part.adr").read_bytes() == file.read_bytes()


def test_an_import_says_what_it_added(adr, benchmark, file):
    code, out = adr("archive", "import", str(file))
    assert code == 0
    assert f"{benchmark}: 0 of 3 runs are new" in out
    code, out = adr("archive", "import", str(file), "--json")
    assert json.loads(out)["unchanged"] == 3


def test_files_are_imported_one_after_the_other(adr, benchmark, file, tmp_path):
    broken = tmp_path / "broken.adr"
    broken.write_bytes(b"no archive")
    code, out = adr("archive", "import", str(file), str(broken), str(file))
    assert (code, out.count("0 of 3 runs are new")) == (2, 1)
    code, out = adr("archive", "import", str(broken))
    assert (code, "broken.adr: not a readable archive" in out.replace("\n", "")) == (2, True)
    code, out = adr("archive", "import", str(file), str(file))
    assert (code, out.count(f"a.adr: {benchmark}: 0 of 3 runs are new")) == (0, 2)


def test_every_stage_of_an_archive_is_verified(adr, file):
    code, out = adr("archive", "verify", str(file), "--sample", "100")
    assert code == 0
    seed, *lines, summary = out.strip().splitlines()
    announced, lines = lines[::2], lines[1::2]
    assert "--seed" in seed
    assert f"{len(lines)} of its stages were computed again" in summary
    assert all(": it took " in line for line in announced)
    assert {line.split()[0] for line in lines} >= {"train_policy", "target_rollout", "evaluate"}
    assert all("identical" in line for line in lines)


def test_another_result_is_named_beside_runs_that_cannot_be_checked(adr_here, file):
    """These alone were named at the end, and the other result scrolled by."""

    def with_other_trainings_without_an_evaluation(rows):
        for row in rows:
            if row["kind"] == "train_policy":
                row["result"] = row["result"].replace('"adjusted_draws":', '"adjusted_draws":1')
        lost = next(row for row in rows if row["kind"] == "evaluate")
        return [row for row in rows if row is not lost]

    rewritten(file, with_rows("stages", with_other_trainings_without_an_evaluation))
    code, out, errors = adr_here("archive", "verify", str(file), "--sample", "100")
    told = " ".join(errors.split())
    assert code == 1
    assert re.search(r"stages have other results here: [0-9a-f]{64}.*; \d runs cannot be", told)
    assert f"error: {out.count('different')} stages" in told


def test_another_result_is_named_and_fails(adr, file):
    digests = []

    def with_another_training(rows):
        changed = next(row for row in rows if row["kind"] == "train_policy")
        # a number that no event repeats
        changed["result"] = changed["result"].replace('"adjusted_draws":', '"adjusted_draws":1')
        digests.append(changed["digest"])
        return rows

    rewritten(file, with_rows("stages", with_another_training))
    code, out = adr("archive", "verify", str(file), "--sample", "100")
    assert (code, out.count("different")) == (1, 1)
    assert f"train_policy {digests[0][:12]}: different, by " in out


def test_a_sample_repeats_with_its_seed(adr, file):
    verify = ("archive", "verify", str(file), "--sample", "2", "--seed", "7")
    samples = [[line.split(":")[0] for line in adr(*verify)[1].splitlines()] for _ in range(2)]
    assert samples[0] == samples[1]
    assert len(samples[0]) == 6


def test_an_archive_whose_results_are_gone_is_not_verified(adr_here, file):
    rewritten(file, without_results)
    code, out, errors = adr_here("archive", "verify", str(file))
    # the seed of the sample is printed, and no stage
    assert (code, len(out.splitlines())) == (1, 1)
    assert "3 runs cannot be checked, because results are missing" in " ".join(errors.split())


def test_a_dry_run_of_an_extension_starts_nothing(adr, benchmark, service):
    runs = service.client.get(benchmark)["runs"]
    code, out = adr("extend", benchmark, "--seed", "3", "--dry-run")
    assert (code, "runs" in out, "trainings" in out) == (0, True, True)
    assert service.client.get(benchmark)["runs"] == runs
