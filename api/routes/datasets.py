"""/v1/datasets: recordings and measurements of robots."""

from typing import Annotated

from fastapi import APIRouter, Query, Response, status

from adr_service.specs.names import TaskName
from api.parameters import DatasetId
from api.routes.downloads import bytes_response
from api.routes.paging import Page, PageSize, PageToken, page_of
from api.service import ServiceDependency
from api.uploads import LARGEST, Content, FileName, Upload, content_described
from db import datasets as store
from db.datasets import DatasetRecord

router = APIRouter(prefix="/v1/datasets", tags=["datasets"])


class DatasetView(DatasetRecord):
    """A stored recording, with its links."""

    links: dict[str, str]


def dataset_view(record: DatasetRecord) -> DatasetView:
    here = f"/v1/datasets/{record.id}"
    return DatasetView(**dict(record), links={"self": here, "content": f"{here}/content"})


@router.post(
    "",
    status_code=status.HTTP_201_CREATED,
    max_body_size=LARGEST,
    openapi_extra=content_described(description="an .npz of transitions, or a measurement"),
)
def upload(
    content: Content,
    service: ServiceDependency,
    response: Response,
    task: Annotated[
        TaskName | None, Query(description="also check that it is of this task")
    ] = None,
    name: Annotated[FileName | None, Query(description="of the file")] = None,
) -> DatasetView:
    """Store an `.npz` (docs/recordings.md, docs/criticism.md); equal bytes are one dataset.

    Its `origin` is the one in the file, or else the file's `name`.
    """
    parsed = Upload.parse(content)
    if task is not None:
        parsed.check_task(task)
    service.check_disk()
    record, is_new = store.store_dataset(service.database, content, parsed.data, name)
    if not is_new:
        response.status_code = status.HTTP_200_OK
    response.headers["Location"] = f"/v1/datasets/{record.id}"
    return dataset_view(record)


@router.get("")
def list_datasets(
    service: ServiceDependency, page_size: PageSize = 100, page_token: PageToken = 0
) -> Page[DatasetView]:
    """Datasets in order of upload."""
    records = store.list_datasets(service.database, after=page_token, limit=page_size + 1)
    return page_of(records, page_size, dataset_view, lambda record: record.number)


@router.get("/{dataset_id}")
def get_dataset(dataset_id: DatasetId, service: ServiceDependency) -> DatasetView:
    """Description of a dataset."""
    return dataset_view(store.describe_dataset(service.database, dataset_id))


@router.get("/{dataset_id}/content", response_class=Response)
def content(dataset_id: DatasetId, service: ServiceDependency) -> Response:
    """The uploaded bytes."""
    record, stored = store.load_dataset(service.database, dataset_id)
    return bytes_response(stored, f"{record.id}.npz")


@router.delete("/{dataset_id}", status_code=status.HTTP_204_NO_CONTENT)
def delete(dataset_id: DatasetId, service: ServiceDependency) -> None:
    """Delete a dataset from which no run learns."""
    store.delete_dataset(service.database, dataset_id)
