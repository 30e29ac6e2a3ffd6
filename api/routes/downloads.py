"""Answers that are files: stored bytes, figures and tables."""

from collections.abc import Sequence
from typing import Any

from fastapi import Response

from adr_service.benchmark.citing import bibtex, papers_of
from adr_service.benchmark.comparison import Outcome, table, to_csv
from adr_service.benchmark.figures import Format, draw
from adr_service.json_values import sha256
from api.service import Service
from db import stages as stage_store
from db.errors import NotFound
from db.runs import RunRecord

CSV: dict[int | str, Any] = {200: {"content": {"text/csv": {"schema": {"type": "string"}}}}}
_FIGURE_TYPES = {"svg": "image/svg+xml", "png": "image/png", "csv": "text/csv"}


def bytes_response(
    content: bytes, filename: str, media_type: str = "application/octet-stream"
) -> Response:
    """A file that browsers save, with the digest of its bytes as ETag."""
    return Response(
        content,
        media_type=media_type,
        headers={"ETag": f'"{sha256(content)}"', **attachment(filename)},
    )


def attachment(filename: str) -> dict[str, str]:
    """The header of a file that browsers save."""
    return {"Content-Disposition": f'attachment; filename="{filename}"'}


def artifact_response(service: Service, digest: str, filename: str) -> Response:
    """A stored artifact as a file; raises NotFound."""
    content = stage_store.artifact(service.database, digest)
    if content is None:
        raise NotFound("artifact", digest)
    return bytes_response(content, filename)


def figure_response(
    id: str, name: str, outcomes: Sequence[Outcome], file_format: Format
) -> Response:
    """A figure of a run or a benchmark, or its numbers as CSV."""
    content, type = draw(name, outcomes, file_format), _FIGURE_TYPES[file_format]
    # browsers show pictures, and save tables
    headers = attachment(f"{id}-{name}.csv") if file_format == "csv" else None
    return Response(content, media_type=type, headers=headers)


def csv_response(id: str, outcomes: Sequence[Outcome]) -> Response:
    """The result table of a run or a benchmark as CSV."""
    headers = attachment(f"{id}-results.csv")
    return Response(to_csv(table(outcomes)), media_type="text/csv", headers=headers)


def bibtex_response(records: Sequence[RunRecord]) -> Response:
    """The papers of what was run, as BibTeX."""
    papers = papers_of(record.spec for record in records)
    return Response(bibtex(papers), media_type="application/x-bibtex")
