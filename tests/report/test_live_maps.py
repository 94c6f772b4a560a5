"""Maps as pixels, and the sensor as a model, for pages that change."""

import io

import numpy as np
import pytest
import trimesh

from designlab.report.live_maps import height_colours, normal_pixels, residual_colours, scale_css
from designlab.report.view3d.model import glb
from designlab.sensor.design import preset
from geometries.leds import emitters


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-0.2, 0.5), (3.0, 3.0)])
def test_heights_run_over_the_colours_of_reports(low, high):
    from matplotlib import colormaps

    ends = height_colours(np.array([[low - 1, high + 1, np.nan]]), (low, high))[0]
    dark, light = (np.round(255 * np.array(colormaps["viridis"](end))[:3]) for end in (0, 255))
    assert (ends[0] == dark).all()
    assert (ends[1] == light).all()


def test_no_residual_is_white_and_signs_differ():
    low, none, high = residual_colours(np.array([[-1.0, 0.0, 1.0]]), 1.0)[0].astype(int)
    assert none.min() > 240
    assert low[2] > low[0]
    assert high[0] > high[2]


def test_a_level_normal_has_the_colour_of_reports():
    assert (normal_pixels(np.array([[[0.0, 0.0, 1.0]]])) == [[[128, 128, 255]]]).all()
    assert scale_css().startswith("linear-gradient(90deg, rgb(68 1 84)")


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["default", "gelsight-2020-dome", "gelsight-wedge-like", "rainbowsight-like"]
)
def test_a_model_holds_every_part_and_every_led(name):
    design = preset(name)
    scene = trimesh.load(io.BytesIO(glb(design)), file_type="glb")
    names = set(scene.geometry)
    assert {"gelcore", "elastomer", "housing", "led_array", "camera"} <= names
    assert sum(each.startswith("led ") for each in names) == len(emitters(design.leds))
    assert scene.extents[2] > design.camera.position_mm[2]
