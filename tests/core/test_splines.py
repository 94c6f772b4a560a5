"""Compiled cubic splines, against those of SciPy and a cubic, which they repeat."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from designlab.core.splines import coefficients, look_up

RANDOM = np.random.default_rng(2)


@pytest.mark.parametrize("pad", [0, 3])
def test_values_are_those_of_scipy(pad: int) -> None:
    layers = RANDOM.standard_normal((3, 9, 14)).astype(np.float32)
    place = RANDOM.uniform(-6, 18, (2, 11, 7))
    found = look_up(coefficients(layers, pad), place, pad)
    assert found.shape == (3, 11, 7)
    for layer, own in zip(layers.astype(float), found, strict=True):
        wide = np.pad(layer, pad, mode="reflect", reflect_type="odd")
        expected = map_coordinates(wide, place + pad, order=3, mode="nearest")
        assert own == pytest.approx(expected, abs=1e-12)


def test_pixels_keep_their_values_and_cubics_their_shape() -> None:
    x = np.arange(40.0)
    cubic = 0.001 * (x - 20) ** 3 - 0.02 * (x - 20) ** 2 + x
    layers = np.broadcast_to(cubic, (1, 30, 40))
    found = coefficients(layers, 4)
    pixels = np.stack(np.meshgrid(np.arange(30.0), x, indexing="ij"))
    assert look_up(found, pixels, 4)[0] == pytest.approx(layers[0], abs=1e-10)
    between = np.array([[15.0, 15.2], [18.5, 22.25]])
    expected = 0.001 * (between[1] - 20) ** 3 - 0.02 * (between[1] - 20) ** 2 + between[1]
    assert look_up(found, between, 4)[0] == pytest.approx(expected, abs=1e-6)
