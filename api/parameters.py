"""Parameters in the query of a request."""

from fastapi import Request
from fastapi.dependencies.utils import get_flat_params
from fastapi.exceptions import RequestValidationError
from fastapi.params import Cookie, Header, Path
from fastapi.routing import APIRoute


async def check_parameters(request: Request) -> None:
    """Refuse a parameter that the route does not have: a mistyped `validate_only` would start a
    run."""
    route = request.scope["route"]
    assert isinstance(route, APIRoute)
    fields = get_flat_params(route.dependant)
    elsewhere = (Path, Header, Cookie)  # a model's fields are pydantic's, and no `Query`
    known = {field.alias for field in fields if not isinstance(field.field_info, elsewhere)}
    accepted = f"accepted: {', '.join(sorted(known))}" if known else "there are none here"
    unknown = [(name, value) for name, value in request.query_params.items() if name not in known]
    if unknown:
        raise RequestValidationError(
            [
                {
                    "type": "unknown_parameter",
                    "loc": ("query", name),
                    "msg": f"there is no parameter {name!r}; {accepted}",
                    "input": value,
                }
                for name, value in unknown
            ]
        )
