"""Logging in by a browser: a cookie that scripts and pages of other sites cannot use.

Cookies cross ports: other programs on the same machine, under the same name, are sent it too. So it
is no token, and opens the service as a cookie alone (docs/security.md).
"""

import hmac
from typing import Annotated

from fastapi import APIRouter, Form, Request, Response
from fastapi.responses import RedirectResponse

from api.guard import COOKIE, cookie_of
from api.page.problems import problem_page
from api.page.rendering import SEE_OTHER
from api.service import ServiceDependency

router = APIRouter(include_in_schema=False)
_LONGEST_ADDRESS = 16_384  # bytes that a request may have in all its headers


@router.post("/login")
def login(
    request: Request,
    service: ServiceDependency,
    token: Annotated[str, Form(max_length=1000)],
    next: Annotated[str, Form(max_length=_LONGEST_ADDRESS)] = "/",
) -> Response:
    """Keep the token for this browser session, and go on to the page that asked for it."""
    known = service.settings.token.get_secret_value()
    if not hmac.compare_digest(token.encode(), known.encode()):
        wrong = {"status": 401, "title": "unauthorised", "detail": "this is not the token"}
        return problem_page(request.scope, wrong, next)
    is_ours = next.startswith("/") and not next.startswith("//") and "\\" not in next
    response = RedirectResponse(next if is_ours else "/", SEE_OTHER)
    is_encrypted = request.url.scheme == "https"
    response.set_cookie(
        COOKIE, cookie_of(token), httponly=True, samesite="strict", secure=is_encrypted
    )
    return response


@router.get("/login")
def asked_for_login() -> Response:
    """The form is shown at this address after a wrong token; it has no page of its own."""
    return RedirectResponse("/", SEE_OTHER)


@router.post("/logout")
def logout() -> Response:
    response = RedirectResponse("/", SEE_OTHER)
    response.delete_cookie(COOKIE, httponly=True, samesite="strict")
    return response
