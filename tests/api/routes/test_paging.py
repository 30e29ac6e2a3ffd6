"""Pages of lists."""

import pytest

from api.routes.paging import page_of


def query(after, limit):
    """Numbers above `after`, as a table of seven rows answers."""
    return list(range(1, 8))[after : after + limit]


@pytest.mark.parametrize("size", [1, 2, 3, 7, 8])
def test_pages_one_after_the_other_are_the_whole_list(size):
    token, items = 0, []
    while token is not None:
        page = page_of(query(int(token), size + 1), size, str, lambda number: number)
        assert len(page.items) <= size
        items += page.items
        token = page.next_page_token
    assert items == list("1234567")


def test_a_list_that_just_fills_a_page_has_no_other():
    assert not page_of([1, 2], 2, str, int).next_page_token
    assert page_of([1, 2, 3], 2, str, int).next_page_token


def test_an_empty_list_is_one_empty_page():
    assert page_of([], 5, str, int).model_dump() == {"items": [], "next_page_token": None}
