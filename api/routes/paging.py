"""Pages of lists: how many items one has, and the token that asks for the next."""

from collections.abc import Callable, Sequence
from typing import Annotated, Generic, TypeVar

from fastapi import Query
from pydantic import BaseModel

MOST_NUMBERS = 2**31  # of rows: PostgreSQL refuses to compare with larger integers
Item = TypeVar("Item")
Record = TypeVar("Record")
PageSize = Annotated[int, Query(ge=1, le=1000, description="most items of the answer")]
PageToken = Annotated[
    int, Query(ge=0, lt=MOST_NUMBERS, description="`next_page_token` of the answer before")
]


class Page(BaseModel, Generic[Item]):
    """A page of a list; `next_page_token` is null on the last."""

    items: list[Item]
    next_page_token: str | None


def page_of(
    records: Sequence[Record],
    size: int,
    render: Callable[[Record], Item],
    position: Callable[[Record], int],
) -> Page[Item]:
    """Return a page of `size` items, from a query that asked for one more."""
    shown = records[:size]
    token = str(position(shown[-1])) if len(records) > size else None
    return Page(items=[render(record) for record in shown], next_page_token=token)
