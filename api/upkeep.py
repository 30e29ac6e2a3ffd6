"""`adr db`: looking after the service's database."""

from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from adr_service.errors import AdrError, InvalidInput
from api.settings import read_settings
from db import maintenance
from db.backends import file_of
from db.errors import DatabaseInUse
from db.session import Database, open_database

app = typer.Typer(help="Look after the service's database.", no_args_is_help=True)
console = Console()
DataDir = Annotated[Path | None, typer.Option(help="Where results are kept.")]


class Damaged(AdrError):
    """The database has something wrong."""

    code = "damaged"


@app.command()
def check(data_dir: DataDir = None) -> None:
    """Read everything, and say what is wrong; also beside a running service."""
    path = _path(data_dir)
    if wrong := maintenance.check(path):
        advice = "restore a backup: adr db restore COPY"
        raise Damaged("\n".join([f"{path} is damaged; {advice}", *wrong]))
    if open_ends := maintenance.unfinished(path):
        advice = "an upgrade that was cut short goes on with `adr db upgrade`"
        raise Damaged("\n".join([f"{path} has other tables than expected; {advice}", *open_ends]))
    found = ", ".join(f"{count} {table}" for table, count in maintenance.counts(path).items())
    console.print(escape(f"{path} is sound: {found}; revision {maintenance.revision_of(path)}"))


@app.command()
def backup(
    copy: Annotated[Path, typer.Argument(help="The file to write.")], data_dir: DataDir = None
) -> None:
    """Copy the database as it is at one moment; also beside a running service."""
    maintenance.backup(_path(data_dir), copy)
    console.print(escape(f"{copy}: {copy.stat().st_size / 1e6:.1f} MB"))


@app.command()
def restore(
    copy: Annotated[Path, typer.Argument(help="A backup, or a copy from before an upgrade.")],
    data_dir: DataDir = None,
) -> None:
    """Put a backup in the place of the database, while no service runs; the old file stays."""
    from workers.sessions import is_in_use  # imports Ray

    path = _path(data_dir)
    folder = read_settings(**({} if data_dir is None else {"data_dir": data_dir})).data_dir
    if is_in_use(folder):
        raise DatabaseInUse(
            f"a service runs in {folder}, perhaps on a database that was deleted meanwhile; stop "
            "it first"
        )
    with closing(Database(_url(data_dir))):
        aside = maintenance.restore(path, copy)
    console.print(
        escape(f"{path} is {copy} now" + (f"; what was there is {aside}" if aside else ""))
    )


@app.command()
def upgrade(data_dir: DataDir = None) -> None:
    """Bring an older database to the present tables, as `adr serve` does; a backup stays."""
    path, url = _path(data_dir), _url(data_dir)
    before = maintenance.revision_of(path)
    open_database(url).close()
    console.print(escape(f"{path}: revision {before} -> {maintenance.revision_of(path)}"))


def _path(data_dir: Path | None) -> Path:
    url = _url(data_dir)
    if url.startswith("postgresql"):
        raise InvalidInput(
            "`adr db` looks after SQLite files. PostgreSQL has pg_amcheck and pg_dump, and "
            "`adr serve` upgrades its tables when it starts"
        )
    return file_of(url)


def _url(data_dir: Path | None) -> str:
    return read_settings(**({} if data_dir is None else {"data_dir": data_dir})).database
