"""Turns of pictures and of the places in them are the same turns."""

import numpy as np
import pytest

from designlab.measurement.quality.turns import TURNS, UPRIGHT

DONE = {
    "": lambda image: image,
    "left-right": np.fliplr,
    "up-down": np.flipud,
    "half": lambda image: np.rot90(image, 2),
    "left": lambda image: np.rot90(image, 1),
    "right": lambda image: np.rot90(image, 3),
    "diagonal": lambda image: image.swapaxes(0, 1),
    "other diagonal": lambda image: np.rot90(image, 2).swapaxes(0, 1),
}


@pytest.mark.parametrize("name", TURNS)
def test_a_picture_is_turned_back(name):
    image = np.random.default_rng(1).uniform(size=(4, 6, 3))
    done = DONE[name](image)
    np.testing.assert_array_equal(TURNS[name].undone(done), image)
    assert (name in UPRIGHT) == (done.shape == image.shape)


@pytest.mark.parametrize("name", TURNS)
def test_a_place_goes_where_its_picture_goes(name):
    """One bright pixel 3 to the right of the middle and 1 above it."""
    image = np.zeros((9, 9))
    image[4 - 1, 4 + 3] = 1.0
    row, column = np.argwhere(DONE[name](image))[0]
    assert TURNS[name].placed(3, 1) == (column - 4, 4 - row)


def test_places_are_written_as_in_a_measurement():
    written = {turn.place: turn.placed(3, 1) for turn in TURNS.values()}
    for text, place in written.items():
        assert tuple(eval(text, {"x": 3, "y": 1})) == place
    assert "[x, -y]" in written
