"""The picture of the sensor: drawn, or a reason in words, and never a crash or a wait without end."""

import stat
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from designlab.fabrication import led_colour
from designlab.report.view3d import render_view
from designlab.report.view3d.labels import labels, spread_rows
from designlab.report.view3d.space import side_by_side
from designlab.sensor.design import preset
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from geometries.leds import emitters
from geometries.probes import parse
from tests.helpers.shared_packages import APART, CORE, shared


@pytest.fixture
def false_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A script in the place of the interpreter that draws."""
    script = tmp_path / "python"
    script.touch(stat.S_IRWXU)
    monkeypatch.setattr(sys, "executable", str(script))
    return script


@pytest.mark.slow
def test_picture_shows_every_led_colour(tmp_path: Path) -> None:
    design = preset("gelsight-2020-dome")
    press = Press(probe=parse("sphere:8"), depth_mm=1.0)
    surface = indent(design.elastomer, design.contact, press, area_mm=design.sensing_area_mm, pitch_mm=0.2)
    drawn = render_view(design, tmp_path / "new" / "view.png", surface=surface)
    if drawn.path is None:
        pytest.skip(drawn.reason)
    assert [path.name for path in drawn.path.parent.iterdir()] == ["view.png"]
    pixels = np.asarray(Image.open(drawn.path).convert("RGB")).astype(float) / 255
    assert pixels.shape == (1300, 1800, 3)
    middle = pixels[:, 500:1300]  # beside it the labels are written in these colours too
    for group in design.leds.groups:
        strongest = int(np.argmax(led_colour(group.wavelength_nm)))
        others = np.delete(middle, strongest, axis=-1).max(axis=-1)
        assert (middle[..., strongest] - others > 0.15).sum() > 500, group.name
    assert (pixels.min(axis=-1) > 0.99).mean() > 0.3  # white around it
    assert np.abs(pixels - pixels.mean(axis=-1, keepdims=True)).max(axis=-1).mean() > 0.005


def test_crash_gives_a_reason(tmp_path: Path, false_python: Path) -> None:
    false_python.write_text("#!/bin/sh\necho 'bad X server connection' >&2\nkill -SEGV $$\n")
    drawn = render_view(preset("default"), tmp_path / "view.png")
    assert drawn.path is None
    assert drawn.reason == "no picture: the drawing process ended with code -11: bad X server connection"
    assert not (tmp_path / "view.png").exists()


def test_hanging_process_is_given_up(tmp_path: Path, false_python: Path) -> None:
    false_python.write_text("#!/bin/sh\nexec sleep 60\n")
    drawn = render_view(preset("default"), tmp_path / "view.png", timeout_s=0.5)
    assert drawn == (None, "no picture: drawing took longer than 0.5 s")


def test_success_without_a_picture_is_no_success(tmp_path: Path, false_python: Path) -> None:
    false_python.write_text("#!/bin/sh\nexit 0\n")
    drawn = render_view(preset("default"), tmp_path / "view.png")
    assert drawn == (None, "no picture: the drawing process ended with code 0: it said nothing")


@pytest.mark.parametrize("name", ["default", "gelsight-2020-flat", "gelsight-2020-dome"])
def test_labels_name_every_part(name: str) -> None:
    design = preset(name)
    titles = [label.text.splitlines()[0] for label in labels(design, deepest_mm=None)]
    assert titles[:6] == ["camera", "housing", "gelcore", "gel", "membrane", "sensing area"]
    assert len(titles) == 6 + len(design.leds.groups)
    assert all(np.isfinite(label.anchor_mm).all() for label in labels(design, deepest_mm=0.5))


def test_rows_keep_their_distance() -> None:
    rows = spread_rows([100.0, 110.0, 120.0, 900.0], low=50, high=950)
    assert np.diff(rows).min() >= 100
    assert rows[0] == 100
    assert rows[-1] == 900
    low = spread_rows([930.0, 940.0, 949.0], low=50, high=950)
    assert low == [750, 850, 950]


@pytest.mark.parametrize(("changes", "width"), [(None, 2.5 / 3), (APART, 0.6)])
def test_faces_that_groups_share_are_drawn_side_by_side(changes, width) -> None:
    leds = shared(CORE, changes).leds
    drawn = side_by_side(emitters(leds))
    assert sorted(face.group for face in drawn) == [0] * 9 + [1] * 9 + [2] * 9
    assert all(2 * face.half_width_mm == pytest.approx(width) for face in drawn)
    first = [face for face in drawn if face.body == 0]
    along = sorted(np.dot(np.subtract(face.centre_mm, first[0].centre_mm), face.across) for face in first)
    assert np.diff(along).min() >= width - 1e-9
    alone = emitters(CORE.leds)
    assert side_by_side(alone) == list(alone)
