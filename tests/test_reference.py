"""The docs' reference is what the code says now."""

import runpy
import subprocess

import pytest

from tests.packages import ROOT

PAGES = runpy.run_path(str(ROOT / "docs/generate.py"))["pages"]()


@pytest.mark.parametrize("name", PAGES)
def test_the_page_is_generated_from_this_code(name):
    written = (ROOT / "docs/reference" / name).read_text()
    assert written == PAGES[name], "write it again: python docs/generate.py"


def test_every_field_of_a_spec_says_what_it_means():
    fields = [line for line in PAGES["specs.md"].splitlines() if line.startswith("| `")]
    assert [line for line in fields if line.endswith("|  |") and '| `"' not in line] == []


def test_the_site_is_built_without_a_warning():
    """Of links, pages and headings; `--strict` would write a traceback."""
    build = ["zensical", "build", "--config-file", ".zensical.toml"]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "No issues found" in done.stdout + done.stderr
    assert (ROOT / "build/docs/reference/client/index.html").exists()
