"""Answers that have not changed."""

import pytest
from fastapi import FastAPI
from fastapi.responses import FileResponse
from fastapi.testclient import TestClient

from api.etags import Etags


def test_a_file_that_comes_in_parts_is_known_by_its_tag(tmp_path):
    path = tmp_path / "film.mp4"
    path.write_bytes(b"x" * 200_000)  # more than a part
    app = FastAPI()
    app.add_middleware(Etags)
    app.get("/film", response_model=None)(lambda: FileResponse(path))
    client = TestClient(app)
    first = client.get("/film")
    assert len(first.content) == 200_000
    assert first.headers["Cache-Control"] == "no-cache"
    same = client.get("/film", headers={"If-None-Match": first.headers["ETag"]})
    assert (same.status_code, same.content) == (304, b"")


@pytest.mark.ray
def test_an_unchanged_answer_is_not_sent_again(http, finished):
    first = http.get(f"/v1/runs/{finished}/results")
    tag = first.headers["ETag"]
    same = http.get(f"/v1/runs/{finished}/results", headers={"If-None-Match": f'"x", W/{tag}'})
    assert (same.status_code, same.content, same.headers["ETag"]) == (304, b"", tag)
    other = http.get(f"/v1/runs/{finished}/results", headers={"If-None-Match": '"x"'})
    assert other.content == first.content
