"""Pages from templates, and the links at the top of each."""

from pathlib import Path
from typing import Any

from fastapi import Request, Response
from fastapi.templating import Jinja2Templates
from jinja2 import StrictUndefined

from adr_service.client.connection import DEFAULT_URL
from api.guard import COOKIE
from api.page.names import apart_of

STATIC = Path(__file__).parent / "static"
SEE_OTHER = 303  # the status that sends a browser from a form to the page that shows its effect
UNPROCESSABLE = 422
_PAGES = {
    "/": "Overview",
    "/submit": "Submit",
    "/compare": "Compare",
    "/criticisms": "Criticisms",
    "/robots": "Robots",
    "/datasets": "Datasets",
    "/claims": "Claims",
    "/docs": "API",
}


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


_templates = Jinja2Templates(Path(__file__).parent / "templates")
_templates.env.undefined = StrictUndefined
_templates.env.filters["sentence"] = _sentence
_templates.env.filters["apart"] = apart_of


def show(
    request: Request,
    template: str,
    *,
    live: bool = False,
    status_code: int = 200,
    **content: Any,
) -> Response:
    """A page; without scripts, one that is `live` is loaded again every minute.

    Its commands take `to_here`, the option that sends them to the service at which it was read.
    """
    address = str(request.base_url).rstrip("/")
    known = {
        "address": address,
        "to_here": "" if address == DEFAULT_URL else f" --url {address}",
        "pages": _PAGES,
        "here": request.url.path,
        "live": live,
        "logged_in": COOKIE in request.cookies,
    }
    return _templates.TemplateResponse(request, template, known | content, status_code=status_code)
