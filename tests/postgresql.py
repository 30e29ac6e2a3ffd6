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

import pytest
from sqlalchemy import NullPool, create_engine

from tests.service import until

_USER = "adr"


@dataclass
class Server:
    """Databases in a folder, reached through its socket alone."""

    folder: Path
    _numbers: count = field(default_factory=count)

    def new_database(self) -> str:
        """The URL of an empty one."""
        name = f"test_{next(self._numbers)}"
        self._execute(self._url("postgres"), f"create database {name}")
        return self._url(name)

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


@contextmanager
def start_server() -> Generator[Server]:
    """Skips the test where PostgreSQL is not installed, or psycopg."""
    pytest.importorskip("psycopg")
    newest = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda p: int(p.parent.name))
    path = os.pathsep.join([*map(str, newest[-1:]), os.environ["PATH"]])
    initdb, pg_ctl = (shutil.which(name, path=path) for name in ("initdb", "pg_ctl"))
    if initdb is None or pg_ctl is None:
        pytest.skip("PostgreSQL is not installed (Debian's package postgresql)")
    # it refuses to run as root
    user = {"user": "postgres"} if getpass.getuser() == "root" else {}
    with tempfile.TemporaryDirectory(prefix="adr-pg-") as name:
        folder = Path(name)  # short, as a socket's path must be
        if user:
            shutil.chown(folder, user["user"])

        def run(*command: object) -> None:
            told = subprocess.DEVNULL  # no pipe, which the server would keep open
            subprocess.run([*map(str, command)], check=True, stdout=told, cwd=folder, **user)

        run(
            initdb,
            "--pgdata",
            folder / "data",
            "--username",
            _USER,
            "--auth",
            "trust",
            "-E",
            "UTF8",
        )
        options = f"-k {folder} -c listen_addresses= -c fsync=off"
        run(pg_ctl, "--pgdata", folder / "data", "--log", folder / "log", "-o", options, "start")
        try:
            yield Server(folder)
        finally:
            run(pg_ctl, "--pgdata", folder / "data", "--mode", "immediate", "stop")
