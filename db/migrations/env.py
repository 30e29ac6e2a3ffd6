"""Alembic's entry: migrates the database that the configuration names, all of it or nothing."""

from alembic import context
from sqlalchemy import Connection

from db.models import Base
from db.session import backend_of


def migrate(connection: Connection) -> None:
    """Run the migrations that were asked for in the transaction of the connection."""
    context.configure(
        connection=connection,
        target_metadata=Base.metadata,
        render_as_batch=True,
        on_version_apply=context.config.attributes.get("on_version_apply"),
    )
    context.run_migrations()


given: Connection | None = context.config.attributes.get("connection")
if given is not None:
    migrate(given)
else:
    url = context.config.get_main_option("sqlalchemy.url")
    assert url is not None, "run migrations through db.session"
    backend = backend_of(url)
    with backend.migrating() as connection:
        migrate(connection)
    backend.writer.dispose()
