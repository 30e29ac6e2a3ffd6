"""Answers that are files."""

import pytest

from adr_service.json_values import sha256
from api.routes.downloads import artifact_response, bytes_response
from db import stages
from db.errors import NotFound
from tests.api.standins import Service


def test_a_file_has_its_name_its_type_and_the_digest_of_its_bytes():
    response = bytes_response(b"weights", "policy.safetensors")
    assert response.body == b"weights"
    assert response.media_type == "application/octet-stream"
    assert response.headers["ETag"] == f'"{sha256(b"weights")}"'
    disposition = response.headers["Content-Disposition"]
    assert disposition == 'attachment; filename="policy.safetensors"'


def test_other_bytes_have_another_etag():
    tags = {bytes_response(content, "x").headers["ETag"] for content in (b"a", b"b", b"a")}
    assert len(tags) == 2


def test_a_stored_artifact_is_a_file(file_database):
    with file_database.write("test") as session:
        digest = stages.add_artifact(session, b"weights")
    assert artifact_response(Service(file_database), digest, "x").body == b"weights"


def test_an_artifact_that_is_not_stored_is_not_found(file_database):
    with pytest.raises(NotFound, match="artifact"):
        artifact_response(Service(file_database), "0" * 64, "x")
