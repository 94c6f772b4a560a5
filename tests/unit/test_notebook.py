"""The notebooks run as a lab would run them, and are kept without their outputs."""

import base64
import shutil
from pathlib import Path

import nbformat
import pytest

import designlab
from designlab.design import preset_text

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
TEMPLATE = Path(designlab.__file__).parent / "templates" / "notebook.ipynb"

SWEPT = "tilts_deg = range(0, 80, 20)"
SHORT = "tilts_deg = [10, 40]"


@pytest.mark.parametrize("path", [*NOTEBOOKS, TEMPLATE], ids=lambda path: path.name)
def test_outputs_are_stripped(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert cell.outputs == []
            assert cell.execution_count is None


@pytest.mark.slow
@pytest.mark.parametrize("path", [*NOTEBOOKS, TEMPLATE], ids=lambda path: path.name)
def test_a_notebook_runs_to_its_end(path, tmp_path, monkeypatch):
    """Every cell runs, with fewer values swept; the last pictures are there and not empty."""
    from nbclient import NotebookClient

    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    shutil.copy(path, tmp_path)
    (tmp_path / "design.toml").write_text(preset_text("gelsight-2020-flat"), encoding="utf-8")
    notebook = nbformat.read(path, as_version=4)
    shortened = [cell for cell in notebook.cells if SWEPT in cell.source]
    assert len(shortened) == 1
    shortened[0].source = shortened[0].source.replace(SWEPT, SHORT)
    NotebookClient(
        notebook, timeout=900, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    ).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    table = next(
        o.data["text/plain"] for o in outputs if "uniformity_u0" in o.get("data", {}).get("text/plain", "")
    )
    assert len(table.splitlines()[0].split()) > 3
    assert [line.split()[1] for line in table.splitlines() if line[:1].isdigit()][:2] == ["10", "40"]
    pictures = [base64.b64decode(o.data["image/png"]) for o in outputs if "image/png" in o.get("data", {})]
    assert len(pictures) == 2
    assert all(len(picture) > 5000 for picture in pictures)
