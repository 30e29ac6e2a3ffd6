"""The Python examples of the README and the docs run as written."""

from pathlib import Path

import pytest
from sybil import Sybil
from sybil.parsers.markdown import PythonCodeBlockParser

from tests.methods.test_own_method import block

ROOT = Path(__file__).parent.parent
# python.md needs a service: tests/acceptance/test_getting_started.py
DOCS = sorted(set((ROOT / "docs").glob("*.md")) - {ROOT / "docs/python.md"})
PAGES = [ROOT / "README.md", *DOCS]
SYBIL = Sybil(parsers=[PythonCodeBlockParser()], patterns=["*.md"])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_examples_run_as_written(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where samples write their files
    if page.name == "add-a-method.md":  # whose second example imports the first, a file
        (tmp_path / "random_search.py").write_text(block("python", "class RandomSearch:"))
        monkeypatch.syspath_prepend(tmp_path)
    for example in SYBIL.parse(page).examples():
        example.evaluate()


def test_the_readme_has_examples():
    assert list(SYBIL.parse(ROOT / "README.md").examples())
