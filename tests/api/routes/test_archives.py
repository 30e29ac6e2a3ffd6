"""Benchmarks as files over HTTP."""

import io
import zipfile

import pytest

from adr_service.client import Refused
from db.staging import PREFIX
from tests.archives import rewritten, without_results

pytestmark = pytest.mark.ray
OCTETS = {"Content-Type": "application/octet-stream"}


@pytest.fixture(scope="module")
def archive(service, benchmark):
    file = io.BytesIO()
    service.client.export_archive(benchmark, file)
    return file.getvalue()


def test_a_benchmark_is_downloaded_as_one_zip(http, benchmark, archive):
    answer = http.get(f"/v1/benchmarks/{benchmark}/archive")
    assert answer.content == archive
    assert answer.headers["Content-Length"] == str(len(archive))
    assert answer.headers["Content-Disposition"] == f'attachment; filename="{benchmark}.adr"'
    assert "manifest.json" in zipfile.ZipFile(io.BytesIO(archive)).namelist()


def test_a_mistyped_parameter_does_not_export_the_whole(http, benchmark):
    answer = http.get(f"/v1/benchmarks/{benchmark}/archive", params={"method": "dropo"})
    assert answer.status_code == 422
    assert "accepted: collectors, methods, seeds, tasks, variants" in answer.text


def test_importing_what_is_there_changes_nothing(service, http, benchmark, archive):
    before = service.client.results(benchmark)
    added = service.client.import_archive(io.BytesIO(archive))
    assert (added["runs"], added["unchanged"], added["stages"]) == (3, 3, 0)
    assert http.get(added["links"]["benchmark"]).json()["id"] == benchmark
    assert service.client.results(benchmark) == before


def test_a_deleted_benchmark_comes_back_from_its_archive(service, benchmark, archive):
    before, figure = service.client.results(benchmark), service.client.figure(benchmark, "cost.csv")
    service.client.delete(benchmark)
    added = service.client.import_archive(io.BytesIO(archive))
    assert (added["added"], added["unverified"]) == (3, [])
    assert service.client.results(benchmark) == before
    assert service.client.figure(benchmark, "cost.csv") == figure
    assert not list(service.data_dir.glob(f"{PREFIX}*"))


def test_results_without_their_stages_are_shown(service, http, benchmark, archive, tmp_path):
    """Whoever wrote them left the stages out, so nobody knows how long they took."""
    (path := tmp_path / "a.adr").write_bytes(archive)
    before = service.client.results(benchmark)
    service.client.delete(benchmark)
    with rewritten(path, without_results).open("rb") as file:
        assert len(service.client.import_archive(file)["unverified"]) == 3
    try:
        assert service.client.results(benchmark)["rows"] == before["rows"]
        pages = ("/", "/claims", f"/benchmarks/{benchmark}", f"/v1/benchmarks/{benchmark}/cost")
        assert [http.get(page).status_code for page in pages] == [200] * 4
    finally:
        service.client.delete(benchmark)
        service.client.import_archive(io.BytesIO(archive))


def test_an_extension_of_an_import_prices_only_what_is_new(service, benchmark):
    answer = service.client.extend_benchmark(benchmark, {"methods": ["sysid"]}, dry_run=True)
    assert [run["method"]["name"] for run in answer["runs"]] == ["sysid"]
    # the trajectory and the policy of SimOpt's first iteration are DROPO's too
    assert answer["plan"]["stored"] > 0
    everything = service.client.submit_benchmark({**answer["spec"], "seeds": [0, 77]}, dry_run=True)
    assert answer["plan"]["trainings"] < everything["plan"]["trainings"]
    assert {run["id"] for run in service.client.get(benchmark)["runs"]} == {
        run["id"] for run in service.client.list_all("runs", benchmark_id=benchmark)
    }


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "not a readable archive"), (b"PK\x05\x06" + bytes(18), "no manifest")],
)
def test_what_is_no_archive_is_refused(service, content, message):
    with pytest.raises(Refused, match=message) as refused:
        service.client.import_archive(io.BytesIO(content))
    assert refused.value.status == 422


def test_forms_of_other_pages_are_refused(http, archive):
    assert http.post("/v1/archives", content=archive).status_code == 415
    elsewhere = {**OCTETS, "Origin": "http://evil.example"}
    assert http.post("/v1/archives", content=archive, headers=elsewhere).status_code == 403


def test_an_unknown_benchmark_has_no_archive(service):
    with pytest.raises(Refused, match="no benchmark 'bench_nothing'"):
        service.client.export_archive("bench_nothing", io.BytesIO())
