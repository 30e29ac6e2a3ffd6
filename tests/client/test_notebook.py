"""The notebook of the docs, from its first cell to its last."""

import nbformat
import pytest
from nbclient import NotebookClient

from tests.packages import ROOT

PATH = ROOT / "docs/examples/first-study.ipynb"


def said(notebook):
    """Everything that its cells print or show as text."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    return "".join(o.get("text", "") or o.get("data", {}).get("text/plain", "") for o in outputs)


@pytest.mark.slow
@pytest.mark.ray
def test_the_notebook_runs_to_its_end(service, monkeypatch, tmp_path):
    monkeypatch.setenv("ADR_URL", service.client.url)
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    notebook = nbformat.read(PATH, as_version=4)
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": tmp_path}}).execute()
    assert "{'succeeded': 9}" in said(notebook)
    assert "9/9 runs done" in said(notebook)  # the bar


def test_the_notebook_is_kept_with_what_it_showed():
    notebook = nbformat.read(PATH, as_version=4)
    assert all(cell.outputs for cell in notebook.cells if cell.cell_type == "code")
    assert "{'succeeded': 9}" in said(notebook)
