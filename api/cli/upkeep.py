"""`adr db`: upkeep of the service's database."""

from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from adr_service.errors import AdrError, InvalidInput
from api.cli.single_options import SingleOptionApp
from api.cli.terminal import console
from api.settings import Settings, read_settings

app = SingleOptionApp(help="Look after the service's database.", no_args_is_help=True)
DataDir = Annotated[Path | None, typer.Option(help="Folder for results.")]


class Damaged(AdrError):
    """The database is damaged or unfinished."""

    code = "damaged"


@app.command()
def check(data_dir: DataDir = None) -> None:
    """Read the whole database and list damage; also beside a running service."""
    from db import maintenance

    path = _file(_settings(data_dir))
    if damage := maintenance.check(path):
        advice = "restore a backup: adr db restore COPY"
        raise Damaged("\n".join([f"{path} is damaged; {advice}", *damage]))
    if open_ends := maintenance.unfinished(path):
        heading = f"{path} has other tables than this version expects"
        raise Damaged(
            "\n".join([heading, *open_ends, "or else restore a backup: adr db restore COPY"])
        )
    rows = ", ".join(f"{count} {table}" for table, count in maintenance.counts(path).items())
    console.print(f"{path} is sound: {rows}; revision {maintenance.revision_of(path)}")


@app.command()
def backup(
    copy: Annotated[Path, typer.Argument(help="The file to write.")], data_dir: DataDir = None
) -> None:
    """Copy the database as it is at one moment; also beside a running service."""
    from db import maintenance

    maintenance.backup(_file(_settings(data_dir)), copy)
    console.print(f"{copy}: {copy.stat().st_size / 1e6:.1f} MB")


@app.command()
def restore(
    copy: Annotated[Path, typer.Argument(help="A backup, or a copy from before an upgrade.")],
    data_dir: DataDir = None,
) -> None:
    """Replace the database by a backup while no service runs; the old file stays."""
    from db import maintenance
    from db.session import Database

    settings = _settings(data_dir)
    path = _file(settings)
    _refuse_a_running_service(settings.data_dir)
    was_there = path.exists()
    with closing(Database(settings.database)):  # its lock makes the file
        try:
            aside = maintenance.restore(path, copy)
        except BaseException:
            if not was_there:
                path.unlink(missing_ok=True)
            raise
    kept = f"; the file that was there is {aside} now" if aside else ""
    console.print(f"{path} is {copy} now{kept}")


def _refuse_a_running_service(folder: Path) -> None:
    from db.errors import DatabaseInUse
    from workers.sessions import is_in_use  # imports Ray

    if is_in_use(folder):
        raise DatabaseInUse(
            f"a service runs in {folder}, perhaps on a database that was deleted meanwhile; stop "
            "it first"
        )


@app.command()
def upgrade(data_dir: DataDir = None) -> None:
    """Bring an older database to the present tables, as `adr serve` does; a backup stays."""
    from db import maintenance
    from db.session import open_database

    settings = _settings(data_dir)
    path = _file(settings)
    before = maintenance.revision_of(path)
    open_database(settings.database).close()
    console.print(f"{path}: revision {before} -> {maintenance.revision_of(path)}")


def _settings(data_dir: Path | None) -> Settings:
    return read_settings(**({} if data_dir is None else {"data_dir": data_dir}))


def _file(settings: Settings) -> Path:
    """Path of the SQLite database; raises InvalidInput for PostgreSQL."""
    from db.backends import file_of  # imports SQLAlchemy

    if settings.database.startswith("postgresql"):
        raise InvalidInput(
            "`adr db` looks after SQLite files. PostgreSQL has pg_amcheck and pg_dump, and "
            "`adr serve` upgrades its tables when it starts"
        )
    return file_of(settings.database)
