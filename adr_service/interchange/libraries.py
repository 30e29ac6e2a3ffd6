"""The libraries of formats, which are an extra."""

import importlib
from typing import Any

from adr_service.errors import InvalidInput


def library(name: str) -> Any:
    """Import a library. Raises InvalidInput with the extra to install if it is absent."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise InvalidInput(
            f"this needs {error.name}: pip install 'adr-service[interchange]'"
        ) from error
