"""The notebooks run as a lab would run them, and are kept with what they print and draw."""

import base64
import re
import shutil
from pathlib import Path

import nbformat
import pytest

import designlab
from designlab.sensor.design import preset_text
from tests import ROOT

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
TEMPLATE = Path(designlab.__file__).parent / "app" / "templates" / "notebook.ipynb"

SHORT = {
    "led_tilt_sweep.ipynb": {"tilts_deg = range(0, 80, 20)": "tilts_deg = [10, 40]"},
    TEMPLATE.name: {"heights_mm = [2.5, 4.0, 5.5, 7.0]": "heights_mm = [4, 6]"},
}
STORY = ROOT / "notebooks" / "corrected_model.ipynb"
GEL = ROOT / "notebooks" / "gel.ipynb"
FIRST = ROOT / "notebooks" / "my_first_sensor.ipynb"
SWEEPS = [path for path in NOTEBOOKS if path not in (STORY, GEL, FIRST)]
NAMES = [path.name for path in [*SWEEPS, TEMPLATE]]
SMALLER = {
    "columns, samples, seed = 64, 128, 3": "columns, samples, seed = 24, 32, 3",
    'tried = ["led_profile", "led_position", "vignetting", "albedo_field", "colour_mixing", "black_level"]': (
        'tried = ["led_profile", "black_level"]'
    ),
    "heights_mm = [9.0, 11.0, 13.0, 15.0]": "heights_mm = [9.0, 15.0]",
}


@pytest.mark.parametrize("path", [*NOTEBOOKS, TEMPLATE], ids=lambda path: path.name)
def test_notebooks_are_kept_with_outputs_and_the_starter_without(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    if path == TEMPLATE:
        assert all(cell.outputs == [] and cell.execution_count is None for cell in cells)
        return
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [output for cell in cells for output in cell.outputs]
    assert {output.output_type for output in outputs} <= {"execute_result", "display_data", "stream"}
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert path.stat().st_size < 1_500_000


def executed(path: Path, changes: dict[str, str], folder: Path) -> list:
    """Run a notebook with some texts changed, each of which it holds once; its outputs."""
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    for before, after in changes.items():
        (cell,) = (cell for cell in notebook.cells if before in cell.source)
        cell.source = cell.source.replace(before, after)
    NotebookClient(
        notebook, timeout=900, kernel_name="python3", resources={"metadata": {"path": folder}}
    ).execute()
    return [output for cell in notebook.cells for output in cell.get("outputs", [])]


@pytest.mark.renders
@pytest.mark.slow
@pytest.mark.parametrize("path", [*SWEEPS, TEMPLATE], ids=NAMES)
def test_a_notebook_runs_to_its_end(path, tmp_path, monkeypatch):
    """Every cell runs, with fewer values swept; the last pictures are there and not empty."""
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    shutil.copy(path, tmp_path)
    (tmp_path / "design.toml").write_text(preset_text("default"), encoding="utf-8")
    outputs = executed(path, SHORT[path.name], tmp_path)
    swept = re.findall(r"\d+", *SHORT[path.name].values())
    table = next(
        o.data["text/plain"] for o in outputs if "uniformity_u0" in o.get("data", {}).get("text/plain", "")
    )
    assert len(table.splitlines()[0].split()) > 3
    assert [line.split()[1] for line in table.splitlines() if line[:1].isdigit()][:2] == swept
    pictures = [base64.b64decode(o.data["image/png"]) for o in outputs if "image/png" in o.get("data", {})]
    assert len(pictures) == 2
    assert all(len(picture) > 5000 for picture in pictures)


@pytest.mark.renders
@pytest.mark.slow
def test_the_story_of_a_corrected_model_runs_to_its_end(tmp_path, monkeypatch):
    """The hidden effect is named, and the corrected model predicts the light as what was hidden does."""
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    outputs = executed(STORY, SMALLER, tmp_path)
    said = "".join(o.text for o in outputs if o.output_type == "stream" and o.name == "stdout")
    assert "The model lacks led_profile" in said
    assert "warning: effects were fitted to another design, gelsight-2020-flat" in said
    pictures = [o for o in outputs if "image/png" in o.get("data", {})]
    assert len(pictures) == 4  # where, a press, the untouched gel, the sweep


@pytest.mark.renders
@pytest.mark.slow
def test_the_notebook_of_the_gel_shows_what_it_says(tmp_path, monkeypatch):
    """Equally deep, the thin gel takes most force on the widest contact; equally hard, it gives way least."""
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    outputs = executed(GEL, {}, tmp_path)
    texts = [o.data["text/plain"] for o in outputs if "text/plain" in o.get("data", {})]
    table = next(text for text in texts if "bulge_um" in text)
    rows = [[float(cell) for cell in line.split()[-4:]] for line in table.splitlines()[1:]]
    deep, hard = rows[:3], rows[3:]  # thin to thick
    for column in (1, 2, 3):  # force, radius of contact, bulge
        assert deep[0][column] > deep[1][column] > deep[2][column] > 0
    assert hard[0][0] < hard[1][0] < hard[2][0]
    assert hard[0][2] < hard[1][2] < hard[2][2]
    said = "".join(o.text for o in outputs if o.output_type == "stream" and o.name == "stdout")
    times = [float(each) for each in re.findall(r"([\d.]+) times Hertz", said)]
    assert times[0] > times[1] > times[2] > 1
    pictures = [o for o in outputs if "image/png" in o.get("data", {})]
    assert len(pictures) == 4  # profiles, forces, the way of the skin, the camera's


@pytest.mark.renders
@pytest.mark.slow
def test_the_first_sensor_goes_from_an_idea_to_parts_and_a_plan(tmp_path, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    fewer = {"heights_mm = [4.0, 5.0, 6.0, 7.0]": "heights_mm = [5.0]"}
    outputs = executed(FIRST, fewer, tmp_path)
    texts = [o.data["text/plain"] for o in outputs if "text/plain" in o.get("data", {})]
    assert "'made from preset default: elastomer.thickness_mm 2 -> 1.5'" in texts
    assert any("leds.height_mm 6 -> 5" in text for text in texts)
    said = "".join(o.text for o in outputs if o.output_type == "stream" and o.name == "stdout")
    assert "checks passed" in said
    assert re.search(r"led_red +3 x .*, 1.6 x 1.6 x 0.7 mm, lit in red", said)
    assert any("sphere:3.5" in text for text in texts)
    assert (tmp_path / "parts" / "assembly.step").is_file()
