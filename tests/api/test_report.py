"""The static report of a benchmark: links, markup, and what a browser makes of it."""

import io
import re
import shutil
import subprocess
from html.parser import HTMLParser

import pytest

from adr_service.benchmark.archive import ArchiveReader
from adr_service.client import AdrClient, Refused
from api.report import write_report

pytestmark = pytest.mark.ray
CHROMIUM = shutil.which("chromium")


@pytest.fixture(scope="module")
def page(service, benchmark, tmp_path_factory):
    """The page of a benchmark's report."""
    return write_report(service.client, benchmark, tmp_path_factory.mktemp("report"))


@pytest.fixture
def one_figure(monkeypatch):
    """A report draws this one alone: the others cost seconds, and `page` has them."""
    monkeypatch.setattr(AdrClient, "figures", lambda client, id: ["cost"])


class References(HTMLParser):
    """Collects what a page links to or loads, and its scripts."""

    def __init__(self, text):
        super().__init__()
        self.found, self.scripts = [], 0
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.scripts += tag == "script" or any(name.startswith("on") for name, _ in attrs)
        self.found += [value for name, value in attrs if name in ("href", "src")]


def test_every_link_is_relative_and_leads_to_a_file(page):
    found = [link for link in References(page.read_text()).found if link != "data:,"]
    assert len(found) > 10
    for link in found:
        assert not re.match(r"[a-z]+:|/", link), link
        assert (page.parent / link).stat().st_size > 0, link


def test_nothing_in_the_folder_is_linked_from_nowhere(page):
    linked = set(References(page.read_text()).found)
    files = {str(p.relative_to(page.parent)) for p in page.parent.rglob("*") if p.is_file()}
    assert files - {"index.html"} == linked - {"data:,"}


def test_the_page_has_no_scripts(page):
    assert References(page.read_text()).scripts == 0


def test_the_report_has_the_results_costs_versions_and_spec(service, benchmark, page):
    text = page.read_text()
    for row in service.client.results(benchmark)["rows"]:
        assert f"{row['normalised_return']:.2f}" in text
    assert "train_policy" in text
    assert "mujoco 4" in text
    assert f"adr extend {benchmark} --seed 1" in text
    assert "these numbers mean nothing" in text
    assert "Fewer than three seeds have no interval." in text
    assert "would exclude zero" not in text
    assert "had not finished" not in text
    assert "were cancelled" not in text
    with ArchiveReader(io.BytesIO((page.parent / "study.adr").read_bytes())) as archive:
        assert archive.manifest.benchmark == benchmark


@pytest.mark.usefixtures("one_figure")
def test_the_report_of_a_cancelled_benchmark_says_that_it_is_not_whole(
    service, benchmark, tmp_path, monkeypatch
):
    cancelled = {**service.client.get(benchmark), "states": {"succeeded": 3, "cancelled": 1}}
    assert cancelled["is_finished"]
    monkeypatch.setattr(AdrClient, "get", lambda client, id: cancelled)
    text = write_report(service.client, benchmark, tmp_path).read_text()
    assert "1 of its runs were cancelled: their results, or some of them, are missing." in text


@pytest.mark.usefixtures("one_figure")
def test_archives_of_parts_are_linked_and_listed(service, benchmark, tmp_path):
    parts = {"study.adr": {"seeds": ["0"]}, "study-dropo.adr": {"methods": ["dropo"]}}
    text = write_report(service.client, benchmark, tmp_path, parts).read_text()
    for name in parts:
        assert (tmp_path / name).exists()
        assert f'<a href="{name}">' in text
        assert f"adr archive verify {name} " in text
    assert "\nadr archive import study.adr study-dropo.adr " in text
    assert text.count("mujoco 4") == 1  # equal versions are listed once
    with pytest.raises(Refused, match="has no seeds 5"):
        write_report(service.client, benchmark, tmp_path / "other", {"a.adr": {"seeds": ["5"]}})
    assert not list((tmp_path / "other").iterdir())  # the next one is not refused


class WithFailure:
    """The client of a service in whose benchmark one run has failed."""

    def __init__(self, client):
        self._client = client

    def __getattr__(self, name):
        return getattr(self._client, name)

    def get(self, id):
        found = self._client.get(id)
        found["runs"][0]["error"] = {"code": "worker_lost", "message": "the node is gone"}
        return found


@pytest.mark.usefixtures("one_figure")
def test_the_report_names_a_run_that_failed(service, benchmark, tmp_path):
    text = write_report(WithFailure(service.client), benchmark, tmp_path / "report").read_text()
    spec = service.client.get(benchmark)["runs"][0]["spec"]
    place = f"{spec['method']['name']} on {spec['task']} {spec['variant']}, seed {spec['seed']}"
    assert f"{place}, failed:</strong> the node is gone" in text


@pytest.mark.usefixtures("one_figure")
def test_the_report_says_what_its_results_lack(service, benchmark, tmp_path, monkeypatch):
    found = {**service.client.results(benchmark), "cautions": ["rows may mix versions: a 1 and 2"]}
    monkeypatch.setattr(AdrClient, "results", lambda client, id: found)
    text = write_report(service.client, benchmark, tmp_path / "report").read_text()
    assert "rows may mix versions: a 1 and 2.</strong>" in text


@pytest.mark.usefixtures("one_figure")
def test_the_report_lists_methods_by_their_means(service, benchmark, tmp_path, monkeypatch):
    found = service.client.results(benchmark)
    means = {"dropo": 0.5, "prior": 0.1, "oracle": 0.9}
    found["aggregates"] = [
        {**each, "cells": 2, "mean": means[each["method"]]} for each in found["aggregates"]
    ]
    monkeypatch.setattr(AdrClient, "results", lambda client, id: found)
    text = write_report(service.client, benchmark, tmp_path / "report").read_text()
    listed = re.findall(r"<tr><td>(\w+)</td>\s*<td class=\"number\">0\.[159]0", text)
    assert listed[:3] == ["oracle", "dropo", "prior"]


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium in the path")
@pytest.mark.parametrize("width", [1440, 390])
def test_a_browser_shows_the_page_from_disk_without_errors(page, width, tmp_path):
    shown = subprocess.run(
        [
            str(CHROMIUM),
            *("--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr"),
            *(f"--window-size={width},2000", f"--screenshot={tmp_path / 'page.png'}"),
            page.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert "CONSOLE" not in shown.stderr
    assert (tmp_path / "page.png").stat().st_size > 10_000


@pytest.mark.usefixtures("one_figure")
def test_a_report_overwrites_nothing_and_is_of_a_benchmark(adr_here, service, benchmark, page):
    def report(id, out):
        return adr_here("report", id, "--out", str(out), "--url", service.client.url)

    code, _, errors = report(benchmark, page.parent)
    assert (code, "overwrites nothing" in errors) == (2, True)
    code, _, errors = report("run_0", page.parent / "new")
    assert (code, "a report is of a benchmark" in errors) == (2, True)
    code, out, _ = report(benchmark, page.parent.parent / "again")
    assert (code, out.strip()) == (0, str(page.parent.parent / "again" / "index.html"))
