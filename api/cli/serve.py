"""`adr serve`: the service itself."""

import logging
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from api.cli.ports import check_port
from api.cli.single_options import SingleOptionApp
from api.settings import Settings, read_settings, too_many_cores, unknown_variables

log = logging.getLogger(__name__)
app = SingleOptionApp()


@app.command()
def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen on.")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on.", min=0, max=65535)] = None,
    data_dir: Annotated[Path | None, typer.Option(help="Folder for results.")] = None,
    cpus: Annotated[int | None, typer.Option(help="Cores of a local cluster.", min=1)] = None,
    dashboard: Annotated[bool | None, typer.Option(help="Start the Ray dashboard.")] = None,
) -> None:
    """Start the service and continue unfinished runs."""
    # other commands need neither the database's modules nor a log
    from api.data_folder import prepare_folder
    from api.logs import configure

    given = {"host": host, "port": port, "data_dir": data_dir, "cpus": cpus, "dashboard": dashboard}
    settings = read_settings(**{name: v for name, v in given.items() if v is not None})
    check_port(settings.host, settings.port)  # before Ray starts, which takes seconds
    configure(settings.log_format)
    for doubt in (*unknown_variables(os.environ), *too_many_cores(settings)):
        log.warning("%s", doubt)
    prepare_folder(settings.data_dir)
    _prepare_process(settings)
    _listen(settings)


def _prepare_process(settings: Settings) -> None:
    """Set what Ray and the interpreter read once, before they are used."""
    if settings.ray_address == "local":
        # Ray reads this on import and ends together with the process that it names. Without it,
        # and with process 1 as our parent, Ray takes us for an orphan and ends us together with
        # the raylet, which we could otherwise start again. A raylet of another cluster cannot be
        # started again from here: there the service may end, and its supervisor restarts it.
        os.environ["RAY_RAYLET_PID"] = str(os.getpid())
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # Ray reports usage by default
    sys.setswitchinterval(0.0005)  # many threads: a request should not wait 5 ms for each of them


def _listen(settings: Settings) -> None:
    # only the service needs Ray, MuJoCo and PyTorch, whose imports take seconds
    import uvicorn

    from api.app import create_app
    from api.connections import bounded, connections_allowed

    has_died = False

    def end() -> None:
        nonlocal has_died
        has_died = server.should_exit = True

    server = uvicorn.Server(
        uvicorn.Config(
            create_app(settings, on_death=end),
            host=settings.host,
            port=settings.port,
            # on h11: httptools, which is faster, keeps headers of any size in memory
            http=bounded(connections_allowed(settings.max_connections)),
            proxy_headers=bool(settings.proxies),  # uvicorn believes everyone on this machine
            forwarded_allow_ips=settings.proxies,
            log_config=None,  # `configure` has set up logging
            timeout_keep_alive=30,  # longer than clients keep one, so that they meet no closed one
            timeout_graceful_shutdown=5,  # for clients that follow a stream
        )
    )
    with suppress(KeyboardInterrupt, SystemExit):  # uvicorn's own statuses mean other things here
        server.run()
    if not server.started:  # the reason is in the log
        raise typer.Exit(2)
    if has_died:
        raise typer.Exit(1)
