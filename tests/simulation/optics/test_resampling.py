"""Resampled pictures against another program's."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from designlab.sensor.design import Design, preset
from designlab.simulation.optics.resampling import MOST_PX, SeenPoints, Warp, seen_mm

DESIGN = preset("gelsight-2020-flat")
VIEW = DESIGN.view(40)


def aside(**moved: float) -> Design:
    x, y, z = DESIGN.camera.position_mm
    place = (x + moved.get("x", 0.0), y + moved.get("y", 0.0), z + moved.get("z", 0.0))
    return DESIGN.replace({"camera.position_mm": place, "camera.tilt_deg": (moved.get("tilt", 0.0), 0.0)})


@pytest.mark.parametrize("moved", [{"x": 0.7, "y": -0.4}, {"z": 6.0}, {"z": -4.0, "tilt": 3.0}])
def test_lines_between_pixels_are_those_of_scipy_also_beyond_the_edges(moved) -> None:
    warp = Warp(SeenPoints(DESIGN, VIEW), SeenPoints(aside(**moved), VIEW))
    light = np.random.default_rng(1).random((5, VIEW.rows, VIEW.columns)).astype(np.float32)
    pad = min(MOST_PX, VIEW.rows - 1, VIEW.columns - 1)
    expected = [
        map_coordinates(
            np.pad(layer, pad, mode="reflect", reflect_type="odd"), warp._place + pad, order=1, mode="nearest"
        )
        for layer in light
    ]
    np.testing.assert_allclose(warp.straight(light), expected, atol=1e-5)


def test_a_camera_moved_aside_sees_a_pattern_on_the_membrane_moved() -> None:
    warp = Warp(SeenPoints(DESIGN, VIEW), SeenPoints(aside(x=0.5), VIEW))
    x, there = (seen_mm(design, VIEW)[0] for design in (DESIGN, aside(x=0.5)))
    assert np.median(there - x) == pytest.approx(0.5, abs=1e-6)
    light = np.sin(0.6 * x)[None]
    within = there < x.max()  # beyond the edge the picture can only be continued
    np.testing.assert_allclose(warp(light)[0][within], np.sin(0.6 * there)[within], atol=4e-3)
    np.testing.assert_allclose(warp.straight(light)[0][within], np.sin(0.6 * there)[within], atol=0.02)


@pytest.mark.parametrize("name", ["gelsight-2020-flat", "gelsight-2020-dome"])
def test_places_are_found_to_a_hundred_thousandth_of_a_pixel_though_the_search_ends_early(name) -> None:
    nominal = preset(name)
    x, y, z = nominal.camera.position_mm
    changed = nominal.replace({"camera.position_mm": (x + 0.3, y - 0.2, z), "camera.tilt_deg": (0.6, 0.0)})
    view = nominal.view(40)
    seen, wanted = (np.stack(seen_mm(design, view)) for design in (nominal, changed))
    off = np.abs(Warp(SeenPoints(nominal, view), SeenPoints(changed, view))(seen) - wanted)
    pixel_mm = np.abs(np.diff(seen[0], axis=1)).min()
    assert off[:, 5:-5, 5:-5].max() < 1e-5 * pixel_mm
