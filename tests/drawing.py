"""A fixture that skips tests which draw, with the reason, on machines that cannot."""

import pytest

from adr_service.errors import InvalidInput
from adr_service.simulation.model import compiled
from adr_service.simulation.rendering import Camera
from adr_service.tasks.catalogue import get_task


@pytest.fixture(scope="session")
def drawing():
    try:
        Camera(compiled(get_task("arm").xml)).close()
    except InvalidInput as error:
        pytest.skip(str(error))
