"""A browser of the machine, driven by Playwright."""

import shutil

import pytest
from playwright.sync_api import sync_playwright

from tests.api.conftest import benchmark, finished, http  # noqa: F401 - fixtures

_EXPECTED = ("status of 422", "status of 503")  # refusals that tests bring about


@pytest.fixture(scope="session")
def chromium():
    """The distribution's own Chromium without a window."""
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.skip("there is no chromium on this machine")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def opened(chromium, service):
    """Opens an address of the service in a new window; everything that the console says fails."""
    contexts, said = [], []

    def open_page(address, width=1440, scheme="light", **more):
        context = chromium.new_context(
            base_url=service.client.url,
            viewport={"width": width, "height": 1000},
            color_scheme=scheme,
            **more,
        )
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: said.append(_line(message)))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto(address)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert [text for text in said if not any(each in text for each in _EXPECTED)] == []


def _line(message):
    return f"{message.type}: {message.text} ({message.location['url']})"
