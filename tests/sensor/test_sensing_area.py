"""The area where scores count: a rectangle or an ellipse."""

import math

import numpy as np
import pytest

from designlab.app import cli
from designlab.sensor.design import DesignError, dumps, loads, preset
from designlab.sensor.sensing_area import SensingArea

SIZES = ((16.0, 12.0), (9.0, 9.0), (7.0, 18.0))
FLAT, DOME = preset("gelsight-2020-flat-core"), preset("gelsight-2020-dome-core")


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(("shape", "share"), [("rectangle", 1.0), ("ellipse", math.pi / 4)])
def test_an_area_holds_what_its_formula_says(size, shape, share):
    area = SensingArea(*size, shape)
    x, y = np.random.default_rng(3).uniform(-0.5, 0.5, (2, 200_000)) * np.reshape(size, (2, 1))
    assert area.holds(x, y).mean() == pytest.approx(share, abs=0.005)
    outline = area.outline_mm(per_side=7)
    assert area.holds(*(0.999 * outline.T)).all()
    assert not area.holds(*(1.001 * outline.T)).any()
    across, along = outline.T  # counter-clockwise: the shoelace formula gives a positive area
    enclosed = (across * np.roll(along, -1) - np.roll(across, -1) * along).sum() / 2
    assert enclosed == pytest.approx(share * size[0] * size[1], rel=3e-4)
    assert np.abs(area.ends_mm).max(axis=0) == pytest.approx(np.array(size) / 2)


def test_a_rectangle_is_the_default_and_does_not_count_in_the_digest():
    assert FLAT.sensing_area_shape == "rectangle"
    stated = loads(dumps(FLAT))
    assert stated.digest == FLAT.digest
    assert FLAT.replace({"sensing_area_shape": "rectangle"}).digest == FLAT.digest
    assert FLAT.replace({"sensing_area_shape": "ellipse"}).digest != FLAT.digest
    # of the design as it stood before there were shapes
    plain = preset("default").replace({"housing.seats": None})
    assert plain.digest.startswith("6c6d46216796")


@pytest.mark.faults
def test_another_shape_is_refused_with_its_field(tmp_path, capfd):
    path = tmp_path / "own.toml"
    path.write_text(dumps(FLAT).replace('sensing_area_shape = "rectangle"', 'sensing_area_shape = "disc"'))
    assert cli.main(["evaluate", str(path)]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert "own.toml: field sensing_area_shape: Input should be 'rectangle' or 'ellipse'" in line
    with pytest.raises(DesignError, match="sensing_area_mm: width and height lie between"):
        FLAT.replace({"sensing_area_shape": "ellipse", "sensing_area_mm": (0.2, 5.0)})


@pytest.mark.parametrize(
    ("design", "size"), [(FLAT, (18.0, 18.0)), (DOME, (20.0, 18.0)), (FLAT, (21.0, 8.0))]
)
def test_rules_count_points_of_the_ellipse_alone(design, size):
    """Corners of the rectangle around it may lie beside the gel or out of view."""
    rectangle = design.replace({"sensing_area_mm": size})
    ellipse = rectangle.replace({"sensing_area_shape": "ellipse"})
    for rule in ("sensing_area_on_membrane", "camera_sees_membrane", "view_through_window"):
        assert ellipse.margins()[rule] <= rectangle.margins()[rule] + 1e-9


def test_a_disc_ends_where_the_round_gel_does():
    """Closed form: a disc of diameter d on a gel of width w lies (d - w) / 2 beyond it."""
    for diameter_mm in (29.0, 31.5, 34.0):
        design = DOME.replace(
            {"sensing_area_mm": (diameter_mm, diameter_mm), "sensing_area_shape": "ellipse"}
        )
        beyond = (diameter_mm - DOME.elastomer.width_mm) / 2
        assert design.margins()["sensing_area_on_membrane"] == pytest.approx(beyond, abs=3e-3)


@pytest.mark.parametrize("size", [(12.0, 9.0), (10.0, 10.0), (6.0, 11.0)])
def test_a_view_fits_the_ellipse(size):
    """Straight from above through no glass its box is that of the rectangle; else it holds the outline."""
    changes = {"sensing_area_mm": size, "sensing_area_shape": "ellipse"}
    plain = preset("gelsight-2020-flat").replace({"sensing_area_mm": size})
    view, same = plain.replace({"sensing_area_shape": "ellipse"}).view(160), plain.view(160)
    assert np.array(view[:4]) == pytest.approx(np.array(same[:4]), rel=1e-3)
    for design in (FLAT.replace(changes), DOME.replace(changes)):
        view = design.view(160)
        turns = np.linspace(0.0, 2 * np.pi, 77)
        seen = [design.project_px(size[0] / 2 * np.cos(turn), size[1] / 2 * np.sin(turn)) for turn in turns]
        column, row = np.array(seen).T
        pixel = view.width_px / view.columns
        assert column.min() == pytest.approx(view.x_px, abs=pixel)
        assert column.max() == pytest.approx(view.x_px + view.width_px, abs=pixel)
        assert row.min() == pytest.approx(view.y_px, abs=pixel)
        assert row.max() == pytest.approx(view.y_px + view.height_px, abs=pixel)
