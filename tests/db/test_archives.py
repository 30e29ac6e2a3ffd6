"""Benchmarks that leave a database as a file and come into another."""

import io
import json
import shutil
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from sqlalchemy import select

from adr_service.benchmark.archive import ArchiveReader
from adr_service.errors import InvalidInput
from adr_service.events import RunFailed, StageFinished, TrainingEvaluated
from adr_service.json_values import canonical_json
from adr_service.programs import online
from adr_service.programs.references import reference_training
from adr_service.specs import BenchmarkExtension, BenchmarkPart
from adr_service.stages.train_policy import TrainPolicy
from db import archives, benchmarks, events, runs, stages, staging
from db.errors import DiskFull, NotFound, NotPossible
from db.models import ArtifactRow, StageArtifactRow, StageRow
from db.runs import resubmit
from db.session import open_database
from db.stages import note_checkpoint, policy_of_training
from db.staging import staged
from tests.archives import rewritten, with_rows, without_results
from tests.contracts.canned import canned
from tests.db.finished import finished_benchmark, go_on, proceed
from tests.db.rows import RESULT, commit, count
from tests.stages.examples import evaluation

COPY = "run_" + 16 * "f"


@pytest.fixture
def other(tmp_path, migrated_file):
    """An empty database on another machine."""
    (tmp_path / "other").mkdir()
    path = shutil.copy(migrated_file, tmp_path / "other")
    with closing(open_database(f"sqlite:///{path}")) as opened:
        yield opened


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """The bytes of a finished benchmark's archive."""
    folder = tmp_path_factory.mktemp("archive")
    with closing(open_database(f"sqlite:///{folder / 'adr.sqlite'}")) as database:
        return exported(database, finished_benchmark(database), folder / "a.adr").read_bytes()


@pytest.fixture
def path(archive, tmp_path):
    """A finished benchmark's archive, to be changed."""
    (tmp_path / "a.adr").write_bytes(archive)
    return tmp_path / "a.adr"


def exported(database, id, path, **members):
    with path.open("wb") as file:
        archives.export_benchmark(database, id, file, BenchmarkPart(**members))
    return path


def imported(database, path):
    with path.open("rb") as file, staged(file, path.parent) as archived:
        return archives.import_benchmark(database, archived)


def content_of(database, id):
    """The specs, states, events and results of a benchmark in a database."""
    runs = benchmarks.runs_of(database, id)
    with database.read() as session:
        stages = [(s.digest, s.document, s.result) for s in session.scalars(select(StageRow))]
        blobs = [(a.sha256, a.content) for a in session.scalars(select(ArtifactRow))]
    return {
        "benchmark": benchmarks.get_benchmark(database, id).spec,
        "runs": [(run.id, run.spec, run.state, run.submission, run.error_code) for run in runs],
        "events": [[e.event for e in events.events_of(database, run.id)] for run in runs],
        "stages": sorted(stages),
        "blobs": sorted(blobs),
    }


def test_an_imported_benchmark_equals_the_exported_one(database, other, tmp_path):
    id = finished_benchmark(database, methods=["simopt", "dropo"], variants=["vanilla", "noisy"])
    report = imported(other, exported(database, id, tmp_path / "a.adr"))
    assert content_of(other, id) == content_of(database, id)
    assert (report.benchmark, report.added, report.unverified) == (id, report.runs, [])
    assert report.stages == count(database, "stages")


def test_both_kinds_of_database_import(database, path):
    report = imported(database, path)
    assert (report.added, report.unverified) == (report.runs, [])
    again = imported(database, path)
    assert (again.unchanged, again.stages) == (report.runs, 0)


def test_a_second_import_changes_nothing(other, file_database, tmp_path):
    path = exported(file_database, finished_benchmark(file_database), tmp_path / "a.adr")
    first = imported(other, path)
    before = content_of(other, first.benchmark)
    again = imported(other, path)
    assert content_of(other, first.benchmark) == before
    assert (again.added, again.continued, again.unchanged, again.stages) == (0, 0, first.runs, 0)


def test_equal_content_gives_equal_bytes(file_database, tmp_path):
    id = finished_benchmark(file_database)
    one, two = (exported(file_database, id, tmp_path / name) for name in ("a.adr", "b.adr"))
    assert one.read_bytes() == two.read_bytes()


def test_a_partial_archive_is_finished_elsewhere_and_comes_back(file_database, other, tmp_path):
    id = finished_benchmark(file_database, most=2)
    report = imported(other, exported(file_database, id, tmp_path / "half.adr"))
    assert report.unverified == []
    go_on(other, id)
    assert {run.state for run in benchmarks.runs_of(other, id)} == {"succeeded"}
    back = imported(file_database, exported(other, id, tmp_path / "whole.adr"))
    assert (back.continued > 0, back.left) == (True, [])
    assert content_of(file_database, id) == content_of(other, id)


def test_live_runs_of_an_archive_are_stopped_and_can_be_resumed(file_database, other, tmp_path):
    id = finished_benchmark(file_database, most=2)
    live = [run.id for run in benchmarks.resubmit_all(file_database, id)]
    report = imported(other, exported(file_database, id, tmp_path / "a.adr"))
    assert live
    assert {runs.get_run(other, id).state for id in live} == {"cancelled"}
    assert imported(other, tmp_path / "a.adr").unchanged == report.runs
    go_on(other, id)
    assert {run.state for run in benchmarks.runs_of(other, id)} == {"succeeded"}


def test_runs_that_went_on_by_themselves_are_left_as_they_are(file_database, other, tmp_path):
    id = finished_benchmark(file_database, most=2)
    path = exported(file_database, id, tmp_path / "a.adr")
    go_on(file_database, id)  # further than the archive
    before = content_of(file_database, id)
    assert imported(file_database, path).left == []
    assert content_of(file_database, id) == before
    imported(other, path)
    [first, *_] = benchmarks.runs_of(other, id)
    list(benchmarks.resubmit_all(other, id))  # they are live
    report = imported(other, exported(file_database, id, tmp_path / "b.adr"))
    assert first.id in report.left
    assert content_of(file_database, id) == before


def test_an_extension_travels_in_both_directions(file_database, other, tmp_path):
    id = finished_benchmark(file_database)
    path = exported(file_database, id, tmp_path / "a.adr")
    imported(other, path)
    for record in benchmarks.extend_benchmark(other, id, BenchmarkExtension(seeds=[7])):
        proceed(other, record)
    imported(other, path)  # an older archive takes nothing away
    assert 7 in benchmarks.get_benchmark(other, id).spec.seeds
    imported(file_database, exported(other, id, tmp_path / "b.adr"))
    assert content_of(file_database, id) == content_of(other, id)


@pytest.mark.parametrize("order", [1, -1])
def test_parts_are_one_benchmark_again_in_any_order(order, file_database, other, tmp_path):
    id = finished_benchmark(file_database, methods=["udr", "simopt", "dropo"])
    chosen = [{"methods": ["simopt", "dropo"]}, {"methods": ["udr"]}]
    for number, members in list(enumerate(chosen))[::order]:
        report = imported(other, exported(file_database, id, tmp_path / f"{number}.adr", **members))
        assert (report.unverified, report.resumable) == ([], 0)
    for number, members in enumerate(chosen):
        again = exported(other, id, tmp_path / "again.adr", **members)
        assert again.read_bytes() == (tmp_path / f"{number}.adr").read_bytes()
    here, there = content_of(other, id), content_of(file_database, id)
    assert set(here["benchmark"].methods) == set(there["benchmark"].methods)
    assert (here["stages"], here["blobs"]) == (there["stages"], there["blobs"])
    assert sorted(here["runs"], key=str) == sorted(there["runs"], key=str)


def test_a_part_has_the_runs_of_its_members_and_the_references(file_database, other, tmp_path):
    id = finished_benchmark(file_database, methods=["udr", "simopt"], seeds=[0, 1])
    members = {"methods": ["udr"], "seeds": ["1"]}
    imported(other, exported(file_database, id, tmp_path / "a.adr", **members))
    runs = [run.spec for run in benchmarks.runs_of(other, id)]
    assert {(run.method.name, run.seed) for run in runs} == {
        (method, 1) for method in ("udr", "prior", "oracle")
    }
    assert benchmarks.get_benchmark(other, id).spec.seeds == [1]
    assert 0 < count(other, "stages") < count(file_database, "stages")


def test_a_part_of_what_is_no_member_is_refused(file_database, tmp_path):
    id = finished_benchmark(file_database)
    with pytest.raises(InvalidInput, match="has no methods bayrn; it has "):
        exported(file_database, id, tmp_path / "a.adr", methods=["bayrn"])


def test_parts_that_leave_a_gap_together_are_refused(file_database, other, tmp_path):
    id = finished_benchmark(file_database, methods=["udr", "simopt"], seeds=[0, 1])
    for name, method, seed in (("a", "udr", "0"), ("b", "simopt", "1")):
        members = {"methods": [method], "seeds": [seed]}
        exported(file_database, id, tmp_path / f"{name}.adr", **members)
    imported(other, tmp_path / "a.adr")
    before = content_of(other, id)
    with pytest.raises(NotPossible, match="together they lack 2 runs"):
        imported(other, tmp_path / "b.adr")
    assert content_of(other, id) == before


def test_a_part_keeps_the_simopt_from_which_its_methods_learn(file_database, tmp_path):
    own = {"name": "simopt", "updates": 7}
    id = finished_benchmark(file_database, methods=["udr", own, "dropo"])
    with pytest.raises(InvalidInput, match="dropo learns from this benchmark's own SimOpt"):
        exported(file_database, id, tmp_path / "a.adr", methods=["dropo"])
    exported(file_database, id, tmp_path / "b.adr", methods=["simopt", "dropo"])


@pytest.mark.parametrize(
    ("there", "seed"),
    [
        ({"name": "dropo", "epsilon": 1e-3}, "1"),  # would be another seed of the same method
        ({"name": "simopt", "updates": 7}, "0"),  # DROPO would seem to learn from this SimOpt
    ],
)
def test_settings_of_both_sides_are_not_mixed(there, seed, file_database, other, tmp_path):
    id = finished_benchmark(file_database, methods=["udr"], seeds=[0, 1])
    exported(file_database, id, tmp_path / "0.adr", seeds=["0"])
    imported(other, tmp_path / "0.adr")
    for database, method in ((other, "dropo"), (file_database, there)):
        extension = BenchmarkExtension.model_validate({"methods": [method]})
        benchmarks.extend_benchmark(database, id, extension)
    before = content_of(other, id)
    with pytest.raises(NotPossible, match="other settings here than in the archive"):
        imported(other, exported(file_database, id, tmp_path / "b.adr", seeds=[seed]))
    assert content_of(other, id) == before


def test_a_benchmark_has_the_same_bytes_on_every_machine(file_database, other, tmp_path):
    id = finished_benchmark(file_database)
    path = exported(file_database, id, tmp_path / "a.adr")
    imported(other, path)
    assert exported(other, id, tmp_path / "b.adr").read_bytes() == path.read_bytes()


def test_a_benchmark_that_was_extended_on_both_sides_is_refused(file_database, other, tmp_path):
    id = finished_benchmark(file_database)
    imported(other, exported(file_database, id, tmp_path / "a.adr"))
    for database in (file_database, other):
        benchmarks.extend_benchmark(database, id, BenchmarkExtension(seeds=[7]))
    before = content_of(other, id)
    with pytest.raises(NotPossible, match="extended both here and in the archive"):
        imported(other, exported(file_database, id, tmp_path / "b.adr"))
    assert content_of(other, id) == before


def test_a_stage_with_another_result_here_refuses_the_import(file_database, other, tmp_path):
    id = finished_benchmark(file_database)
    path = exported(file_database, id, tmp_path / "a.adr")
    finished_benchmark(other)
    with other.write("test") as session:
        row = session.scalars(select(StageRow).where(StageRow.kind == "evaluate")).first()
        row.result = row.result.replace("1", "2")
    rows = count(other, "runs"), count(other, "events"), count(other, "stages")
    with pytest.raises(NotPossible, match="another result here than in the archive"):
        imported(other, path)
    assert rows == (count(other, "runs"), count(other, "events"), count(other, "stages"))


def test_deleting_an_imported_benchmark_leaves_nothing(file_database, other, tmp_path):
    id = finished_benchmark(file_database)
    imported(other, exported(file_database, id, tmp_path / "a.adr"))
    benchmarks.delete_benchmark(other, id)
    tables = ("benchmarks", "runs", "events", "stages", "stage_artifacts", "artifacts")
    assert [count(other, table) for table in tables] == [0] * len(tables)


def test_a_checkpoint_gives_way_to_an_imported_training(file_database, other, tmp_path):
    id = finished_benchmark(file_database)
    with file_database.read() as session:
        trainings = select(StageRow.digest).where(StageRow.kind == "train_policy")
        digest = session.scalars(trainings).first()
    with other.write("test") as session:
        note_checkpoint(session, digest, 10, b"half trained")
    imported(other, exported(file_database, id, tmp_path / "a.adr"))
    assert policy_of_training(other, digest) == policy_of_training(file_database, digest)
    assert count(other, "checkpoints") == 0
    assert b"half trained" not in {content for _, content in content_of(other, id)["blobs"]}


def test_a_training_that_was_interrupted_and_repeated_elsewhere_comes_back(
    file_database, other, tmp_path
):
    """Points of both learning curves stay in the record, and the result has its own."""
    id = finished_benchmark(file_database, most=0)
    run = next(r for r in benchmarks.runs_of(file_database, id) if r.spec.method.name == "oracle")
    training = reference_training(run.spec)
    curve = training.read(canned(training)).curve
    there = [point.model_copy(update={"mean_return": -1.0}) for point in curve]
    extra = there[0].model_copy(update={"steps": 77})
    for point in [*there, extra]:
        event = TrainingEvaluated(digest=training.digest, **point.model_dump())
        events.append_event(file_database, run.id, event)
    imported(other, exported(file_database, id, tmp_path / "a.adr"))
    go_on(other, id)
    back = imported(file_database, exported(other, id, tmp_path / "b.adr"))
    assert (back.left, back.unverified) == ([], [])
    assert content_of(file_database, id) == content_of(other, id)


def test_runs_with_policies_of_an_earlier_version_come_in_unverified(
    file_database, other, tmp_path, monkeypatch
):
    """One had ended. The others were resumed, which was not refused, and trained anew."""
    monkeypatch.setattr("db.runs.check_versions", lambda *given: None)
    id = finished_benchmark(file_database, most=1)
    before = benchmarks.runs_of(file_database, id)
    assert {run.state for run in before} == {"succeeded", "cancelled"}
    monkeypatch.setattr(TrainPolicy, "version", TrainPolicy.version + 1)
    go_on(file_database, id)
    report = imported(other, exported(file_database, id, tmp_path / "a.adr"))
    assert set(report.unverified) == {run.id for run in before}
    assert content_of(other, id) == content_of(file_database, id)


def test_runs_that_could_not_go_on_with_a_later_version_come_in_unverified(
    file_database, other, tmp_path, monkeypatch
):
    """Their first iteration follows from the policy before, and a later one is there too."""
    id = finished_benchmark(file_database, most=4)
    monkeypatch.setattr(TrainPolicy, "version", TrainPolicy.version + 1)
    [begun] = [r for r in benchmarks.runs_of(file_database, id) if r.state.is_resumable]
    record = resubmit(file_database, begun.id)
    with pytest.raises(InvalidInput, match="iteration 0 came out otherwise"):
        proceed(file_database, record)
    failed = RunFailed(submission=record.submission, code="invalid_input", message="otherwise")
    events.append_event(file_database, record.id, failed)
    report = imported(other, exported(file_database, id, tmp_path / "a.adr"))
    assert record.id in report.unverified
    assert content_of(other, id) == content_of(file_database, id)


def test_packages_are_named_in_the_manifest_and_where_they_are_missing(
    file_database, other, tmp_path
):
    """The refusal did not say which package a reader has to install."""
    id = finished_benchmark(file_database, most=0)
    run, *_ = benchmarks.runs_of(file_database, id)
    commit(file_database, replace(evaluation(7), package="adr-random 0.2.0"), RESULT, run.id)
    path = exported(file_database, id, tmp_path / "a.adr")
    with path.open("rb") as file, ArchiveReader(file) as archive:
        assert archive.manifest.computed_with[1:] == [{"adr-random": "0.2.0"}]
    gone = with_rows(
        "benchmarks",
        lambda rows: [{**row, "spec": row["spec"].replace('"simopt"', '"random"')} for row in rows],
    )
    message = "'random' is not installed here: .*; its stages are of adr-random 0.2.0$"
    with pytest.raises(InvalidInput, match=message):
        imported(other, rewritten(path, gone))


def worsened(body):
    """An event with other returns of the target, if it has some."""
    event = json.loads(body)
    if event.get("returns"):
        event["returns"] = [[-1.0 for _ in policy] for policy in event["returns"]]
    return json.dumps(event)


def test_runs_whose_method_broke_come_in_unverified(file_database, other, tmp_path, monkeypatch):
    """An archive was lost to its owner where a method of his own had raised in one run."""
    id = finished_benchmark(file_database, most=0)
    [learning] = [
        run for run in benchmarks.runs_of(file_database, id) if run.spec.method.name == "simopt"
    ]

    def broken(visits):
        raise ZeroDivisionError("as a method does")

    monkeypatch.setattr(online, "joined", broken)  # after the first evaluation
    record = resubmit(file_database, learning.id)
    with pytest.raises(ZeroDivisionError):
        proceed(file_database, record)
    failed = RunFailed(submission=record.submission, code="internal", message="it divided")
    events.append_event(file_database, record.id, failed)
    path = exported(file_database, id, tmp_path / "a.adr")
    assert imported(other, path).unverified == [learning.id]
    assert content_of(other, id) == content_of(file_database, id)
    untrue = with_rows(
        "events", lambda rows: [{**row, "body": worsened(row["body"])} for row in rows]
    )
    with pytest.raises(InvalidInput, match="does not follow from the stored results"):
        imported(other, rewritten(path, untrue))
    monkeypatch.undo()
    go_on(file_database, id)
    path = exported(file_database, id, tmp_path / "b.adr")
    monkeypatch.setattr(online, "joined", broken)
    with pytest.raises(InvalidInput, match=f"{learning.id} cannot use its stored results, after"):
        imported(other, path)


def test_a_later_archive_of_a_live_benchmark_goes_further(file_database, other, tmp_path):
    """An import stops what had not finished, and the next one brings the rest."""
    id = finished_benchmark(file_database, most=2)
    live = [run.id for run in benchmarks.resubmit_all(file_database, id)]
    half = exported(file_database, id, tmp_path / "half.adr")
    for run_id in live:
        proceed(file_database, runs.get_run(file_database, run_id))
    full = exported(file_database, id, tmp_path / "full.adr")
    first = imported(other, half)
    assert first.resumable == len(live)
    report = imported(other, full)
    assert (report.continued, report.left, report.resumable) == (len(live), [], 0)
    assert {run.state for run in benchmarks.runs_of(other, id)} == {"succeeded"}
    again = imported(other, half)  # an older one takes nothing away
    assert (again.unchanged, again.left) == (again.runs, [])
    back = imported(file_database, exported(other, id, tmp_path / "back.adr"))
    assert (back.unchanged, back.left) == (back.runs, [])


def test_events_without_results_are_named(path, other):
    """Nobody can tell whether they are true: an earlier version's results look the same."""
    report = imported(other, rewritten(path, without_results))
    assert (len(report.unverified), report.stages) == (report.runs, 0)


def test_an_import_is_kept_from_the_day_on_which_it_came(path, other):
    long_ago = with_rows(
        "runs", lambda rows: [{**row, "updated_at": "2020-01-01T00:00:00+00:00"} for row in rows]
    )
    id = imported(other, rewritten(path, long_ago)).benchmark
    a_day_ago = datetime.now(UTC) - timedelta(days=1)
    assert benchmarks.finished_before(other, a_day_ago) == []
    assert [deleted for _, deleted in benchmarks.finished_before(other, datetime.now(UTC))] == [id]


def test_a_benchmark_whose_runs_are_still_to_be_imported_is_kept(path, other):
    with path.open("rb") as file, staged(file, path.parent) as archived:
        id = archived.manifest.benchmark
        archives._add_benchmark(other, archived.database, id)
    assert benchmarks.finished_before(other, datetime.now(UTC)) == []


def test_a_benchmark_whose_import_was_interrupted_is_not_extended_before_it_is_whole(path, other):
    with path.open("rb") as file, staged(file, path.parent) as archived:
        id = archived.manifest.benchmark
        archives._add_benchmark(other, archived.database, id)
    with pytest.raises(NotPossible, match=r"lacks 3 of its own runs.* import it again"):
        benchmarks.extend_benchmark(other, id, BenchmarkExtension(seeds=[77]))
    assert imported(other, path).added == 3
    assert len(benchmarks.extend_benchmark(other, id, BenchmarkExtension(seeds=[77]))) == 3


def test_a_full_disk_refuses_an_archive_before_it_is_unpacked(path, tmp_path):
    with (
        path.open("rb") as file,
        pytest.raises(DiskFull, match="to read the archive takes"),
        staged(file, tmp_path, floor=1e18),
    ):
        pass
    assert not list(tmp_path.glob(f"{staging.PREFIX}*"))


def test_what_a_killed_service_left_is_cleared(tmp_path):
    left = tmp_path / f"{staging.PREFIX}abc"
    for folder in (left, tmp_path / "archive-2026"):
        folder.mkdir()
        (folder / "archive.sqlite").write_bytes(b"x")
    staging.clear(tmp_path)
    assert [str(file.relative_to(tmp_path)) for file in tmp_path.rglob("*.sqlite")] == [
        "archive-2026/archive.sqlite"
    ]


def test_an_export_ends_where_the_disk_fills_up(file_database):
    def fills_up():
        raise DiskFull("the disk is full")

    id = finished_benchmark(file_database)
    with pytest.raises(DiskFull):
        archives.export_benchmark(file_database, id, io.BytesIO(), check=fills_up)


def test_an_unknown_benchmark_cannot_be_exported(file_database, tmp_path):
    with pytest.raises(NotFound, match="bench_nothing"):
        exported(file_database, "bench_nothing", tmp_path / "a.adr")


def _first(**changes):
    return lambda rows: [{**rows[0], **changes}, *rows[1:]]


def _unlabelled(rows):
    return [{name: row[name] for name in row if name != "kind"} for row in rows]


def _iterations(**changes):
    """All iterations with other lists."""

    def change(rows):
        for row in rows:
            if row["type"] == "iteration_finished":
                row["body"] = json.dumps(json.loads(row["body"]) | changes)
        return rows

    return change


def _invented(rows):
    """An iteration that never was."""
    last = next(row for row in rows if row["type"] == "iteration_finished")
    body = json.dumps({**json.loads(last["body"]), "iteration": 99})
    mine = [row for row in rows if row["run_id"] == last["run_id"]]
    extra = {**last, "seq": len(mine) + 1, "key": "iteration_finished:99", "body": body}
    return [*rows, extra]


def _without(key):
    """The first run that has an event that begins like this comes without it."""

    def change(rows):
        left_out = next(row for row in rows if row["key"].startswith(key))
        mine = [row for row in rows if row["run_id"] == left_out["run_id"] and row != left_out]
        others = [row for row in rows if row["run_id"] != left_out["run_id"]]
        return [*({**row, "seq": seq} for seq, row in enumerate(mine, 1)), *others]

    return change


def _denied(rows):
    """Returns that no evaluation has, in a run that does not name a stage whose result is there."""
    return _iterations(returns=[[1e9]])(_without("stage_finished:")(rows))


def _moved(rows):
    """A document under a digest that is not its own."""
    changed = {**json.loads(rows[0]["document"]), "version": 99}
    return [{**rows[0], "document": json.dumps(changed)}, *rows[1:]]


def _lives(*ends):
    """The first run ends with these events, whose submissions may be of none that was queued."""

    def change(rows):
        first = rows[0]["run_id"]
        mine = [r for r in rows if r["run_id"] == first and r["type"] != "run_succeeded"]
        for type, submission in ends:
            body = {"type": type, "submission": submission}
            body |= {"code": "x", "message": "y"} if type == "run_failed" else {}
            key = f"{type}:{submission}"
            new = {"seq": len(mine) + 1, "key": key, "type": type, "body": json.dumps(body)}
            mine.append({**mine[-1], **new})
        return [*mine, *(row for row in rows if row["run_id"] != first)]

    return change


def _timed(**changes):
    def change(rows):
        return [{**row, "timing": json.dumps(json.loads(row["timing"]) | changes)} for row in rows]

    return change


def _evaluated(*returns):
    """All evaluations have other returns."""

    def change(rows):
        for row in rows:
            if row["kind"] == "evaluate":
                row["result"] = json.dumps(json.loads(row["result"]) | {"returns": returns})
        return rows

    return change


HOSTILE = {
    "an end of the far future": ("stages", _timed(ended=1e12), "unreadable execution"),
    "an execution of no time": ("stages", _timed(cpu=-1.0), "unreadable execution"),
    "half a core": ("stages", _timed(cores=1.5), "unreadable execution"),
    "no returns": ("stages", _evaluated(), "has 0 returns"),
    "returns without end": ("stages", _evaluated(1.7e308, 1.0), "less than or equal to"),
    "a column more": ("runs", _first(evil=1), "has the columns"),
    "a column less": ("stages", _unlabelled, "has the columns"),
    "a list in a column": ("runs", _first(task=["arm"]), "nested values"),
    "a text for a number": ("runs", _first(seed="0"), "must be an integer"),
    "a huge number": ("runs", _first(seed=2**70), "must be an integer"),
    "a huge share": ("stages", _first(seconds=10**400), "must be a number"),
    "a wrong time": ("runs", _first(created_at="yesterday"), "must be a time"),
    "a time without zone": ("runs", _first(created_at="2026-01-01T00:00:00"), "must be a time"),
    "a zero byte": ("stages", _first(started_by="a\0b"), "zero byte"),
    "no run": ("runs", lambda rows: [], "contradicts itself|this one has none"),
    "a timing of other things": ("stages", _first(timing='{"evil":1}'), "unreadable execution"),
    "a provenance of numbers": ("stages", _first(provenance='{"cpu":5}'), "unreadable execution"),
    "a result of no number": ("stages", _first(result='{"a":NaN}'), "no JSON object"),
    "a result without end": ("stages", _first(result='{"a":1e999}'), "no JSON object"),
    "half a character": ("runs", _first(spec="\ud800"), "surrogates"),
    "a long id": ("runs", _first(id="run_" + "0" * 100), "characters at most"),
    "an id of a path": ("runs", _first(id="../../etc/passwd"), "contradicts itself"),
    "another state": ("runs", _first(state="failed", error_code="x"), "contradicts its spec"),
    "an impossible state": ("runs", _first(state="sleeping"), "contradicts itself"),
    "another seed": ("runs", _first(seed=5), "contradicts its spec"),
    "a run twice": ("runs", lambda rows: [rows[0], *rows], "contradicts itself"),
    "no spec": ("runs", _first(spec="{}"), "cannot be used here"),
    "an unknown run": ("events", _first(run_id="run_0000000000000000"), "contradicts itself"),
    "a gap in the events": ("events", lambda rows: rows[1:], "has another's columns"),
    "an unknown event": ("events", _first(body='{"type":"rm"}'), "event 1"),
    "another event's key": ("events", _first(key="run_started:1"), "contradicts itself|columns"),
    "returns that no evaluation has": ("events", _iterations(returns=[[1e9]]), "does not follow"),
    "returns of two lengths": ("events", _iterations(returns=[[1, 2], [1]]), "one length"),
    "returns of no policy": ("events", _iterations(policies=[], returns=[]), "as policies"),
    "no distribution": ("events", _iterations(distributions=[]), "as many distributions"),
    "an iteration that never was": ("events", _invented, "does not follow"),
    "returns of a stage that is not named": ("events", _denied, "does not follow"),
    "no first iteration": ("events", _without("iteration_finished:0"), "has no event"),
    "no last iteration": ("events", _without("iteration_finished:1"), "has no event"),
    "another stage's document": ("stages", _moved, "document of another"),
    "another kind of stage": ("stages", _first(kind="evil"), "document of another"),
    "a result of another form": (
        "stages",
        _first(result='{"evil":1}'),
        "cannot use a stored result",
    ),
    "a result that is a list": ("stages", _first(result="[1]"), "no JSON object"),
    "a result nested without end": ("stages", _first(result="[" * 100_000), "no JSON object"),
    "no attempt": ("stages", _first(attempt=0), "contradicts itself"),
    "a benchmark less": ("benchmarks", lambda rows: [], "contradicts itself|one benchmark"),
    "artifacts less": ("stage_artifacts", lambda rows: rows[1:], "cannot use|of no stage"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_an_archive_that_contradicts_itself_is_refused(name, path, other, tmp_path):
    table, change, message = HOSTILE[name]
    with pytest.raises(InvalidInput, match=message):
        imported(other, rewritten(path, with_rows(table, change)))
    assert count(other, "runs") == count(other, "benchmarks") == count(other, "stages") == 0
    assert not list(tmp_path.glob(f"{staging.PREFIX}*"))


def test_a_stage_of_today_that_no_program_asks_for_is_refused(path, other):
    """Whoever runs it later would get its result."""
    stage = evaluation(77)
    finished = StageFinished(kind=stage.kind, digest=stage.digest)

    def with_stage(rows):
        document = canonical_json(stage.document)
        return [
            *rows,
            {**rows[0], "digest": stage.digest, "kind": stage.kind, "document": document},
        ]

    def with_event(rows):
        mine = [row for row in rows if row["run_id"] == rows[0]["run_id"]]
        body = {"key": finished.key, "type": finished.type, "body": finished.model_dump_json()}
        return [*rows, {**mine[-1], "seq": len(mine) + 1, **body}]

    rewritten(path, with_rows("stages", with_stage))
    with pytest.raises(InvalidInput, match=f"{finished.key} .* does not follow"):
        imported(other, rewritten(path, with_rows("events", with_event)))


@pytest.mark.parametrize(
    ("ends", "submission", "is_possible"),
    [
        ([("run_stopped", 1)], 1, True),
        ([("run_queued", 2), ("run_stopped", 2)], 2, True),
        ([("run_queued", 2), ("run_stopped", 1)], 2, False),
        ([("run_failed", 2), ("run_stopped", 2)], 1, False),
    ],
    ids=str,
)
def test_a_run_ends_in_the_submission_that_was_queued_last(
    ends, submission, is_possible, path, other
):
    """Otherwise a run that is resumed could neither end nor be deleted."""
    rewritten(path, with_rows("events", _lives(*ends)))
    rewritten(path, with_rows("runs", _first(state="cancelled", submission=submission)))
    if is_possible:
        assert imported(other, path).resumable == 1
        return
    with pytest.raises(InvalidInput, match="contradicts its spec or events"):
        imported(other, path)


def test_more_runs_than_a_benchmark_may_have_are_refused(path, other, monkeypatch):
    monkeypatch.setattr("db.archive_checks.MAX_RUNS", 1)
    with pytest.raises(InvalidInput, match="1 to 1 runs; this one has more"):
        imported(other, path)


@pytest.mark.parametrize(
    ("limit", "message"),
    [
        ("db.archive_checks._LONGEST_EVENTS", "in the archive have more than 1000 characters"),
        ("adr_service.benchmark.archive._LONGEST_LINE", "is cut short or too long"),
    ],
)
def test_more_than_fits_in_memory_at_once_is_refused(limit, message, path, other, monkeypatch):
    monkeypatch.setattr(limit, 1_000)
    with pytest.raises(InvalidInput, match=message):
        imported(other, path)


def test_an_archive_of_a_later_version_is_refused(path, other):
    def later(members):
        manifest = {**json.loads(members["manifest.json"]), "revision": "9999"}
        return {**members, "manifest.json": json.dumps(manifest).encode()}

    with pytest.raises(InvalidInput, match="later version of the service wrote"):
        imported(other, rewritten(path, later))


def test_an_archive_with_other_tables_is_refused(path, other):
    more = {"tables/requests.jsonl": b""}
    with pytest.raises(InvalidInput, match="has the tables"):
        imported(other, rewritten(path, lambda members: {**members, **more}))


def test_a_blob_of_no_stage_is_refused(path, other):
    empty = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    with pytest.raises(InvalidInput, match="blobs of no stage"):
        imported(other, rewritten(path, lambda members: {**members, f"blobs/{empty}": b""}))


def test_an_archive_of_an_earlier_version_is_upgraded_as_its_database_would_be(
    file_database, other, tmp_path
):
    """Revision 0009 names the budget that DROID had by default before it."""
    id = finished_benchmark(file_database, methods=["droid"])
    path = exported(file_database, id, tmp_path / "a.adr")

    def as_then(row):
        spec = json.loads(row["spec"])
        if spec["method"]["name"] == "droid":
            spec["method"]["budget"] = 30  # of the preset smoke
        return {**row, "spec": json.dumps(spec)}

    def earlier(members):
        manifest = {**json.loads(members["manifest.json"]), "revision": "0008"}
        members = with_rows("runs", lambda rows: [as_then(row) for row in rows])(members)
        return {**members, "manifest.json": json.dumps(manifest).encode()}

    report = imported(other, rewritten(path, earlier))
    assert report.added == report.runs
    [droid] = benchmarks.get_benchmark(other, id).spec.methods
    assert (droid.name, droid.budget) == ("droid", 30)


def test_imported_results_take_no_core_of_this_service(file_database, other, tmp_path):
    """Both machines were busy at the same time: their cores would have been counted as one's."""
    id = finished_benchmark(file_database)
    assert stages.executions_between(file_database, 0.0, 4e9)
    imported(other, exported(file_database, id, tmp_path / "a.adr"))
    assert count(other, "stages") == count(file_database, "stages")
    assert stages.executions_between(other, 0.0, 4e9) == []
    ids = [run.id for run in benchmarks.runs_of(other, id)]
    whole = stages.executions_of(file_database, ids)
    assert stages.executions_of(file_database, ids, only_here=True) == whole
    assert stages.executions_of(other, ids) == whole
    assert stages.executions_of(other, ids, only_here=True) == []


def test_times_are_of_the_zone_that_an_archive_gives_them(path, other):
    at_noon = _first(created_at="2026-01-01T12:00:00+12:00")
    imported(other, rewritten(path, with_rows("runs", at_noon)))
    times = {run.created_at for run in runs.list_runs(other, limit=None)}
    assert datetime(2026, 1, 1, tzinfo=UTC) in times


@pytest.mark.parametrize("spec", ["{", "[]"])
def test_a_spec_that_cannot_be_upgraded_refuses_the_archive(spec, path, other):
    def earlier(members):
        manifest = {**json.loads(members["manifest.json"]), "revision": "0005"}
        members = with_rows("runs", lambda rows: [{**row, "spec": spec} for row in rows])(members)
        return {**members, "manifest.json": json.dumps(manifest).encode()}

    with pytest.raises(InvalidInput, match="is of revision 0005, and its specs cannot be brought"):
        imported(other, rewritten(path, earlier))


def test_a_stage_with_other_bytes_here_refuses_the_import(file_database, other, tmp_path):
    path = exported(file_database, finished_benchmark(file_database), tmp_path / "a.adr")
    finished_benchmark(other)
    of_a_rollout = StageArtifactRow.digest.in_(
        select(StageRow.digest).where(StageRow.kind == "target_rollout")
    )
    with other.write("test") as session:
        row = session.scalars(select(StageArtifactRow).where(of_a_rollout)).first()
        row.sha256 = stages.add_artifact(session, b"other bytes")
    with pytest.raises(NotPossible, match="another result here than in the archive"):
        imported(other, path)


def test_a_run_of_an_archive_comes_once_and_not_under_a_second_id(path, other):
    first = []

    def copied_runs(rows):
        first.append(rows[0]["id"])
        return [*rows, {**rows[0], "id": COPY}]

    def copied_events(rows):
        return [*rows, *({**row, "run_id": COPY} for row in rows if row["run_id"] == first[0])]

    rewritten(path, with_rows("runs", copied_runs))
    rewritten(path, with_rows("events", copied_events))
    with pytest.raises(InvalidInput, match="in the archive is no run of its benchmark"):
        imported(other, path)
