"""Ports of this machine."""

import socket

from adr_service.errors import InvalidInput


def check_port(host: str, port: int) -> None:
    """Raise InvalidInput if this port cannot be listened on, as where another service does."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise InvalidInput(
                f"cannot listen on {host} port {port} ({error.strerror}); choose another port with "
                "--port, and name it to the other commands with ADR_URL"
            ) from error


def free_port() -> int:
    """A port of this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
