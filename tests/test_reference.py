"""The docs' reference is what the code says now."""

import runpy
import shutil
import subprocess
import sys

import pytest

from adr_service.specs import BenchmarkExtension, BenchmarkSpec, CriticismSpec, RunSpec
from tests.packages import ROOT

NAMES = ("command-line.md", "methods.md", "effects.md", "rest.md", "specs.md")
OBVIOUS = {"kind", "name", "algorithm"}  # each accepts one value


@pytest.fixture(scope="module")
def pages():
    return runpy.run_path(str(ROOT / "docs/generate.py"))["pages"]()


@pytest.mark.parametrize("name", NAMES)
def test_the_page_is_generated_from_this_code(pages, name):
    written = (ROOT / "docs/reference" / name).read_text()
    assert written == pages[name], "write it again: python docs/generate.py"


def test_commands_are_listed_with_whole_sentences(pages):
    listed = [line for line in pages["command-line.md"].splitlines() if line.startswith("* `")]
    assert any(len(line) > 90 for line in listed)
    assert not [line for line in listed if line.endswith("...")]


def test_no_page_is_forgotten(pages):
    assert set(pages) == set(NAMES)


@pytest.mark.parametrize("model", [RunSpec, BenchmarkSpec, BenchmarkExtension, CriticismSpec])
def test_every_field_of_a_spec_says_what_it_means(model):
    schema = model.model_json_schema()
    for name, each in {**schema.pop("$defs", {}), model.__name__: schema}.items():
        for field, accepted in each.get("properties", {}).items():
            choices = [accepted, *accepted.get("anyOf", ())]
            said = any(choice.get("description") for choice in choices)
            assert said or field in OBVIOUS, f"{name}.{field}"


def test_the_site_is_built_without_a_warning():
    page = ROOT / "build/docs/reference/client"
    shutil.rmtree(page, ignore_errors=True)
    build = [sys.executable, "-m", "zensical", "build", "--config-file", ".zensical.toml"]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "No issues found" in done.stdout + done.stderr
    assert "submit_benchmark" in (page / "index.html").read_text()
