"""Fixtures: the published data, a database, and a service of our own."""

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest
from xdist.scheduler import LoadFileScheduling

from adr_service.transitions import TransitionDataset
from api.cli import main
from api.cli.terminal import console
from db.session import Database, open_database
from tests.postgresql import Server, start_server
from tests.recordings import load_hopper
from tests.service import RunningService, start_service

# tests that share what is slow to make run in one process: a service, a benchmark, fits
_TOGETHER = {
    "tests/api/": "service",
    "tests/browser/": "service",
    "tests/client/": "service",
    "tests/acceptance/test_lease_history": "service",
    "tests/test_docstring_examples": "service",
    "tests/benchmark/": "benchmark",
    "tests/programs/": "programs",
    "tests/criticism/": "fits",
}


class _ByFile(LoadFileScheduling):
    """The tests of a file run in one process, and so do those that share something."""

    def _split_scope(self, nodeid: str) -> str:
        path = super()._split_scope(nodeid)
        shared = (name for start, name in _TOGETHER.items() if path.startswith(start))
        return next(shared, path)


def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> LoadFileScheduling:
    return _ByFile(config, log)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the figures that tests have recorded, in whichever process they ran."""
    for report in terminalreporter.getreports("passed"):
        for name, figures in report.user_properties:
            if name == "figures":
                terminalreporter.write_line(f"{report.nodeid}: {figures}")


@pytest.fixture(scope="session")
def datasets() -> Path:
    """The folder of published data sets; see docs/datasets.md."""
    folder = Path(os.environ.get("ADR_DATASETS", ""))
    if not os.environ.get("ADR_DATASETS") or not folder.is_dir():
        pytest.skip("ADR_DATASETS names no folder with the published data sets (docs/datasets.md)")
    return folder


@pytest.fixture(scope="session")
def hopper_clean(datasets: Path) -> TransitionDataset:
    return load_hopper(datasets / "dropo_hopper/hopper10000", "hoppermass_n10000")


@pytest.fixture(scope="session")
def hopper_noisy(datasets: Path) -> TransitionDataset:
    return load_hopper(datasets / "dropo_hopper/hoppernoisy1e-510000", "hopper_n10000")


@pytest.fixture(scope="session")
def postgresql() -> Iterator[Server]:
    with start_server() as server:
        yield server


@pytest.fixture(scope="session")
def migrated_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of SQLite with all tables, to be copied: its migrations take longer than a test."""
    path = tmp_path_factory.mktemp("migrated") / "adr.sqlite"
    open_database(f"sqlite:///{path}").close()
    return path


@pytest.fixture(scope="session")
def migrated_database(postgresql: Server) -> str:
    """URL of a database of PostgreSQL with all tables, which are empty before every test."""
    url = postgresql.new_database()
    open_database(url).close()
    return url


@pytest.fixture(params=["sqlite", "postgresql"])
def database_kind(request: pytest.FixtureRequest) -> str:
    """Each kind of database."""
    return request.param


@pytest.fixture
def database_url(database_kind: str, request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """URL of a database without tables."""
    if database_kind == "sqlite":
        return f"sqlite:///{tmp_path / 'adr.sqlite'}"
    return request.getfixturevalue("postgresql").new_database()


@pytest.fixture
def database(database_kind: str, request: pytest.FixtureRequest) -> Iterator[Database]:
    """A database with all tables, which a test must leave as they are."""
    if database_kind == "sqlite":
        yield request.getfixturevalue("file_database")
        return
    url = request.getfixturevalue("migrated_database")
    with closing(open_database(url)) as opened:
        yield opened
    request.getfixturevalue("postgresql").empty(url)


@pytest.fixture
def file_database(migrated_file: Path, tmp_path: Path) -> Iterator[Database]:
    """A database in SQLite, adr.sqlite, for tests that look at the file."""
    path = tmp_path / "adr.sqlite"
    shutil.copy(migrated_file, path)
    with closing(open_database(f"sqlite:///{path}")) as opened:
        yield opened


@pytest.fixture
def adr_here(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """Runs `adr` with these arguments in this process: exit status, output and errors."""
    monkeypatch.setattr(console, "width", 200)

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["adr", *arguments])
        with pytest.raises(SystemExit) as end:
            main()
        return end.value.code or 0, *capsys.readouterr()

    return run


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    """One service with Ray on two cores for all tests that only add to it."""
    folder = tmp_path_factory.mktemp("service")
    with start_service(folder, cpus=2, dashboard=True) as running:
        yield running
