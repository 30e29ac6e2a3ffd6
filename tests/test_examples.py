"""The Python examples of the README and the docs run as written."""

from pathlib import Path

import pytest
from sybil import Sybil
from sybil.parsers.markdown import PythonCodeBlockParser

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SYBIL = Sybil(parsers=[PythonCodeBlockParser()], patterns=["*.md"])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_examples_run_as_written(page):
    for example in SYBIL.parse(page).examples():
        example.evaluate()


def test_the_readme_has_examples():
    assert list(SYBIL.parse(ROOT / "README.md").examples())
