"""Requests that may come twice: an Idempotency-Key creates one thing (IETF draft 06)."""

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from sqlalchemy import delete
from sqlalchemy.orm import Session

from adr_service.errors import InvalidInput
from db.models import RequestRow

_KEPT = timedelta(hours=24)


@dataclass(frozen=True)
class RequestKey:
    """An Idempotency-Key and the request that came with it."""

    key: str  # the client's
    request: str  # SHA-256 of the request


class Replayed(Exception):
    """The request has been carried out before; nothing was done now."""

    def __init__(self, id: str):
        super().__init__(id)
        self.id = id  # of what it created or changed


class KeyReused(InvalidInput):
    """A client sent the same key with another request."""


def once(session: Session, key: RequestKey | None, id: str) -> None:
    """Note that a request created or changed `id`, inside the transaction that does.

    Raises as `check_new`, which undoes the transaction.
    """
    if key is None:
        return
    now = datetime.now(UTC)
    session.execute(delete(RequestRow).where(RequestRow.created_at < now - _KEPT))
    check_new(session, key)
    session.add(RequestRow(key=key.key, request=key.request, made=id, created_at=now))


def check_new(session: Session, key: RequestKey | None) -> None:
    """Raise Replayed if the request was made before, KeyReused if its key came with another one."""
    known = None if key is None else session.get(RequestRow, key.key)
    if key is None or known is None:
        return
    if known.request != key.request:
        raise KeyReused(
            f"the Idempotency-Key {key.key!r} came with another request before; use a new key "
            "for a new request"
        )
    raise Replayed(known.made)
