"""Answers that have not changed."""

import pytest

pytestmark = pytest.mark.ray


def test_an_unchanged_answer_is_not_sent_again(http, finished):
    first = http.get(f"/v1/runs/{finished}/results")
    tag = first.headers["ETag"]
    same = http.get(f"/v1/runs/{finished}/results", headers={"If-None-Match": f'"x", W/{tag}'})
    assert (same.status_code, same.content, same.headers["ETag"]) == (304, b"", tag)
    other = http.get(f"/v1/runs/{finished}/results", headers={"If-None-Match": '"x"'})
    assert other.content == first.content
