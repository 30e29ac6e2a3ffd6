"""/v1/datasets: recordings of real machines, or of anything else, to learn from."""

from typing import Annotated

from fastapi import APIRouter, Body, Depends, Header, HTTPException, Query, Response, status

from adr_service.criticism.compatibility import check_measurement
from adr_service.criticism.measurements import Measurement, is_measurement
from adr_service.criticism.nominal import Nominal
from adr_service.simulation.replay import check_recorded
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.transitions import TransitionDataset
from api.routes.runs import PageSize
from api.service import ServiceDependency
from api.views import DatasetView, Page, dataset_view, page_of
from db import datasets as store

router = APIRouter(prefix="/v1/datasets", tags=["datasets"])
LARGEST = 64_000_000  # bytes of an upload
NPZ = "application/octet-stream"


def octets(content_type: Annotated[str, Header(include_in_schema=False)] = "") -> None:
    """Refuses what a page elsewhere could make a browser send: forms and texts."""
    if content_type.partition(";")[0].strip().lower() != NPZ:
        detail = f"the body must be {NPZ}; given {content_type or 'no type'!r}"
        raise HTTPException(status.HTTP_415_UNSUPPORTED_MEDIA_TYPE, detail)


@router.post(
    "",
    status_code=status.HTTP_201_CREATED,
    max_body_size=LARGEST,
    dependencies=[Depends(octets)],
)
def upload(
    content: Annotated[
        bytes, Body(media_type=NPZ, description="an .npz of transitions, or a measurement")
    ],
    service: ServiceDependency,
    response: Response,
    task: Annotated[str | None, Query(description="also check that it is of this task")] = None,
) -> DatasetView:
    """Store an `.npz` (docs/recordings.md, docs/criticism.md); equal bytes are one dataset."""
    if task is not None and is_measurement(content):
        nominal = Nominal.of_task(get_task(task), source_of(task, "vanilla"))
        check_measurement(nominal, Measurement.from_npz(content))
    elif task is not None:
        check_recorded(get_task(task), TransitionDataset.from_npz(content))
    service.check_disk()
    record, is_new = store.store_dataset(service.database, content)
    if not is_new:
        response.status_code = status.HTTP_200_OK
    response.headers["Location"] = f"/v1/datasets/{record.id}"
    return dataset_view(record)


@router.get("")
def list_datasets(
    service: ServiceDependency,
    page_size: PageSize = 100,
    page_token: Annotated[int, Query(ge=0, lt=2**63)] = 0,
) -> Page[DatasetView]:
    """Datasets in order of upload."""
    found = store.list_datasets(service.database, after=page_token, limit=page_size + 1)
    return page_of(found, page_size, dataset_view, lambda record: record.number)


@router.get("/{dataset_id}")
def get_dataset(dataset_id: str, service: ServiceDependency) -> DatasetView:
    """What it holds."""
    return dataset_view(store.describe_dataset(service.database, dataset_id))


@router.get("/{dataset_id}/content", response_class=Response)
def content(dataset_id: str, service: ServiceDependency) -> Response:
    """The bytes as they were uploaded."""
    record, found = store.load_dataset(service.database, dataset_id)
    headers = {
        "ETag": f'"{record.sha256}"',
        "Content-Disposition": f'attachment; filename="{record.id}.npz"',
    }
    return Response(found, media_type=NPZ, headers=headers)


@router.delete("/{dataset_id}", status_code=status.HTTP_204_NO_CONTENT)
def delete(dataset_id: str, service: ServiceDependency) -> None:
    """Delete a dataset from which no run learns."""
    store.delete_dataset(service.database, dataset_id)
