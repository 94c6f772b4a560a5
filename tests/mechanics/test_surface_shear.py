"""Shear found from how far points of the surface have moved, against contacts that were solved."""

import numpy as np
import pytest

from designlab.mechanics.layer import ElasticLayer
from designlab.mechanics.surface_pressure import SurfacePressure, pressure_under
from designlab.mechanics.surface_shear import SurfaceShear, shear_under
from designlab.reconstruction.reconstructor import _rough
from designlab.sensor.design import preset
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press

PITCH_MM, EVERY = 0.05, 3
PLACES = np.stack(np.meshgrid(np.arange(-6, 6.1, 1.1), np.arange(-4, 4.1, 1.1)), axis=-1).reshape(-1, 2)


def pressed(probe, depth_mm, centre_mm, shear_mm, friction):
    """Displacements of points, the pressure that follows from the shape, and the solved shear."""
    design = preset("default").replace({"contact.friction": friction})
    surface = indent(
        design.elastomer,
        design.contact,
        Press(probe=probe, depth_mm=depth_mm, centre_mm=centre_mm, shear_mm=shear_mm),
        area_mm=(14.0, 10.5),
        pitch_mm=PITCH_MM,
    )
    layer = design.contact.layer(thickness_mm=design.elastomer.thickness_mm)
    rows, columns = (side // (2 * EVERY) * EVERY for side in surface.height_mm.shape)
    middle = [side // 2 for side in surface.height_mm.shape]
    height = surface.height_mm[
        middle[0] - rows : middle[0] + rows + 1 : EVERY, middle[1] - columns : middle[1] + columns + 1 : EVERY
    ]
    pressure = pressure_under(
        height, poisson=layer.poisson, thickness_mm=layer.thickness_mm, pitch_mm=EVERY * PITCH_MM
    )
    moved = np.stack([surface.sample(field, *PLACES.T) for field in surface.sideways_mm], axis=1)
    return moved, pressure, np.array(surface.mechanics.shear_force_n), layer.modulus_mpa


@pytest.mark.slow
@pytest.mark.parametrize(
    ("probe", "depth_mm", "centre_mm", "shear_mm", "friction"),
    [
        ("sphere:4", 0.5, (1.0, 0.5), (0.1, 0.0), 0.8),
        ("sphere:6", 0.8, (-1.0, 0.7), (0.05, 0.15), 0.5),
        ("sphere:4", 0.5, (1.0, 0.5), (0.4, 0.0), 0.3),  # slides
        ("cylinder:4", 0.3, (0.0, 0.0), (-0.1, 0.1), 0.8),
        ("star:6", 0.4, (1.0, 1.0), (0.1, -0.05), 1.0),
        ("triangle:5", 0.4, (-2.0, -1.0), (0.0, 0.12), 0.8),
    ],
)
def test_shear_of_a_solved_contact_is_found(probe, depth_mm, centre_mm, shear_mm, friction):
    moved, pressure, true, modulus = pressed(probe, depth_mm, centre_mm, shear_mm, friction)
    noise = np.random.default_rng(1).normal(0, 0.005, moved.shape)
    found = shear_under(PLACES, moved + noise, pressure)
    off = np.array(found.force_n(modulus)) - true
    assert np.hypot(*off) < 0.12 * np.hypot(*true)
    assert np.hypot(*off) < 5 * np.hypot(*found.error_n(modulus))
    assert found.rest_mm < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("probe", ["sphere:4", "cylinder:4", "star:6"])
def test_a_straight_press_has_no_shear(probe):
    moved, pressure, _, modulus = pressed(probe, 0.4, (0.5, -0.5), (0.0, 0.0), 0.8)
    found = shear_under(PLACES, moved, pressure)
    force = pressure.force_n(modulus)
    assert np.hypot(*found.force_n(modulus)) < 0.02 * force


@pytest.mark.faults
@pytest.mark.parametrize("count", [0, 1, 3])
def test_too_few_markers_are_refused(count):
    flat = np.zeros((20, 20))
    pressure = SurfacePressure(flat, 0.0, 0.0, 0.1, flat, ElasticLayer(1.0, 0.49, 2.0), 0.005)
    with pytest.raises(ValueError, match=f"4 or more are needed, got {count}"):
        shear_under(PLACES[:count], PLACES[:count], pressure)


@pytest.mark.parametrize(
    ("force", "error", "modulus", "sd", "expected"),
    [
        ((3.0, 4.0), (0.3, 0.3), 1.0, 0.0, (0.3, 0.3)),
        ((3.0, 4.0), (0.0, 0.0), 2.0, 0.2, (0.6, 0.8)),
        ((-3.0, 0.0), (0.4, 0.4), 1.0, 0.1, (0.5, 0.4)),
    ],
)
def test_the_error_includes_that_of_the_modulus(force, error, modulus, sd, expected):
    assert SurfaceShear(force, error, 0.0).error_n(modulus, sd) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("force", "error", "warned"),
    [
        ((3.0, 4.0), (0.3, 0.3), False),
        ((3.0, 4.0), (0.7, 1.0), True),
        ((0.3, 0.0), (0.3, 0.3), False),  # there may be none
        ((0.0, 0.0), (0.3, 0.3), False),
    ],
)
def test_a_rough_shear_is_said(force, error, warned):
    shear = SurfaceShear(force, error, 0.0)
    told = _rough(shear)
    assert bool(told) == warned
    assert not warned or f"known to {shear.relative_error:.0%} only" in told[0]
