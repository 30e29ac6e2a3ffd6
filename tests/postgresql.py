"""A PostgreSQL server of our own, from Debian's package, for the tests of the database."""

import getpass
import os
import shutil
import subprocess
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

import psutil
import pytest
from sqlalchemy import NullPool, create_engine

from db.models import Base
from tests.service import until

_USER = "adr"


@dataclass
class Server:
    """Databases in a folder, reached through its socket alone."""

    folder: Path
    pg_ctl: str
    _numbers: count = field(default_factory=count)

    @property
    def data(self) -> Path:
        return self.folder / "data"

    def start(self) -> None:
        """Start it, or start it again after it was killed."""
        options = f"-k {self.folder} -c listen_addresses= -c fsync=off"
        log = self.folder / "log"
        self.run(self.pg_ctl, "--pgdata", self.data, "--log", log, "-o", options, "start")

    def stop(self) -> None:
        self.run(self.pg_ctl, "--pgdata", self.data, "--mode", "immediate", "stop")

    def kill(self) -> None:
        """SIGKILL; its processes notice that their parent has died, and end."""
        pid = int((self.data / "postmaster.pid").read_text().split()[0])
        processes = [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]
        processes[0].kill()
        _, alive = psutil.wait_procs(processes, timeout=30)
        assert not alive

    def run(self, *command: object) -> None:
        """Run one of PostgreSQL's commands, which refuse to run as root."""
        user = "postgres" if _is_root() else None
        told = subprocess.DEVNULL  # no pipe, which the server would keep open
        subprocess.run([*map(str, command)], check=True, stdout=told, cwd=self.folder, user=user)

    def new_database(self) -> str:
        """The URL of a new, empty database (300 files: share one where you can)."""
        name = f"test_{next(self._numbers)}"
        self._execute(self._url("postgres"), f"create database {name}")
        return self._url(name)

    def empty(self, url: str) -> None:
        """Delete all rows of a database, as if it were new."""
        self.cut(url)
        tables = ", ".join(Base.metadata.tables)
        self._execute(url, f"truncate {tables} restart identity")

    def cut(self, url: str) -> None:
        """End all connections to a database, as a failing network would."""
        self._execute(
            url,
            "select pg_terminate_backend(pid, 5000) from pg_stat_activity "
            "where datname = current_database() and pid <> pg_backend_pid()",
        )

    @contextmanager
    def read_only(self) -> Generator[None]:
        """It takes no writes, as after a failover: transactions that begin can only read."""
        self._set_read_only("on")
        try:
            yield
        finally:
            self._set_read_only("off")

    def _set_read_only(self, value: str) -> None:
        postgres = self._url("postgres")
        self._execute(postgres, f"alter system set default_transaction_read_only = {value}")
        self._execute(postgres, "select pg_reload_conf()")
        until(lambda: self._execute(postgres, "show default_transaction_read_only") == value)

    def _url(self, name: str) -> str:
        return f"postgresql+psycopg://{_USER}@/{name}?host={self.folder}"

    def _execute(self, url: str, statement: str) -> object:
        engine = create_engine(url, isolation_level="AUTOCOMMIT", poolclass=NullPool)
        with engine.connect() as connection:
            done = connection.exec_driver_sql(statement)
            return done.scalar() if done.returns_rows else None


def _is_root() -> bool:
    return getpass.getuser() == "root"


@contextmanager
def start_server() -> Generator[Server]:
    """Skips the test where PostgreSQL is not installed, or psycopg."""
    pytest.importorskip("psycopg")
    newest = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda p: int(p.parent.name))
    path = os.pathsep.join([*map(str, newest[-1:]), os.environ["PATH"]])
    initdb, pg_ctl = (shutil.which(name, path=path) for name in ("initdb", "pg_ctl"))
    if initdb is None or pg_ctl is None:
        pytest.skip("PostgreSQL is not installed (Debian's package postgresql)")
    with tempfile.TemporaryDirectory(prefix="adr-pg-") as name:
        server = Server(Path(name), pg_ctl)  # short, as a socket's path must be
        if _is_root():
            shutil.chown(name, "postgres")
        initial = ("--username", _USER, "--auth", "trust", "-E", "UTF8")
        server.run(initdb, "--pgdata", server.data, *initial)
        server.start()
        try:
            yield server
        finally:
            server.stop()
