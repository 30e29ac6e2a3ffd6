"""Uploaded `.npz` files: recordings of transitions, and measurements of states and commands.

    upload = Upload.parse(content)      # InvalidInput unless it is one of the two
    upload.check_task("hopper")         # InvalidInput unless that robot could have made it

An upload is parsed once. The parsed data and the bytes go along together from then on.
"""

from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Header, HTTPException, Request, status
from pydantic import Field

from adr_service.criticism.compatibility import check_columns, check_measurement
from adr_service.criticism.measurements import Measurement, is_measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.recordings import read_measurement
from adr_service.json_values import Line
from adr_service.simulation.model import compiled
from adr_service.simulation.replay import check_recorded
from adr_service.specs import AnyRun, CriticismSpec
from adr_service.target import Recording
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.transitions import TransitionDataset

LARGEST = 64_000_000  # bytes of an upload
OCTETS = "application/octet-stream"
FileName = Annotated[Line, Field(max_length=255)]


@dataclass(frozen=True)
class Upload:
    """The bytes of a file, and the data in it."""

    content: bytes
    data: TransitionDataset | Measurement

    @classmethod
    def parse(cls, content: bytes) -> "Upload":
        """Read a measurement, or else a recording; raises InvalidInput."""
        if is_measurement(content):
            return cls(content, Measurement.from_npz(content))
        return cls(content, TransitionDataset.from_npz(content))

    def check_task(self, task_name: str) -> None:
        """Raise InvalidInput unless the data are of this task's robot; a run asks for more."""
        task = get_task(task_name)
        if isinstance(self.data, Measurement):
            check_columns(compiled(task.xml), self.data)
        else:
            check_recorded(task, self.data)


def check_dataset(spec: AnyRun, content: bytes) -> None:
    """Raise InvalidInput unless a run can learn from these bytes, or criticise with them."""
    if isinstance(spec, CriticismSpec):
        task = get_task(spec.task)
        nominal = Nominal.of_task(task, source_of(spec.task, spec.variant))
        check_measurement(nominal, read_measurement(task, content))
    else:
        Recording(spec, content)


def octets(content_type: Annotated[str, Header(include_in_schema=False)] = "") -> None:
    """Refuse forms and texts, which a page elsewhere could make a browser send."""
    if content_type.partition(";")[0].strip().lower() != OCTETS:
        detail = f"the body must be {OCTETS}; given {content_type or 'no type'!r}"
        raise HTTPException(status.HTTP_415_UNSUPPORTED_MEDIA_TYPE, detail)


async def _content(request: Request, _: Annotated[None, Depends(octets)]) -> bytes:
    return await request.body()


# a body of FastAPI's would be read as JSON, where it is labelled so, before `octets` refuses it
Content = Annotated[bytes, Depends(_content)]


def content_described(**more: str) -> dict[str, Any]:
    """Return what a route that takes `Content` adds to its description."""
    schema = {"type": "string", "contentMediaType": OCTETS, "title": "Content", **more}
    return {"requestBody": {"required": True, "content": {OCTETS: {"schema": schema}}}}
