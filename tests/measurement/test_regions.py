"""Regions of a picture are those that someone at the bench would point at."""

import numpy as np
import pytest

from designlab.measurement.regions import regions
from designlab.sensor.design import preset
from designlab.simulation.contact.press import Press
from designlab.simulation.simulator import Frame, Simulator
from geometries.probes import parse

DESIGN = preset("gelsight-2020-flat")
CENTRE_MM = (2.0, 0.0)


@pytest.fixture(scope="module")
def seen():
    """What a ball right of the middle shows, without the light of the picture."""
    simulator = Simulator(DESIGN, columns=80, samples=1, seed=0)
    press = Press(probe=parse("sphere:6"), depth_mm=0.6, centre_mm=CENTRE_MM)
    basis = np.zeros((3, *simulator.rays.x_mm.shape), dtype=np.float32)
    return Frame(press, simulator.surface(press), simulator.rays, basis, DESIGN.transfer_mw)


@pytest.mark.parametrize("channel", range(3))
def test_every_pixel_lies_in_one_region(seen, channel):
    assert (np.sum(list(regions(seen, DESIGN, channel).values()), axis=0) == 1).all()


@pytest.mark.parametrize("channel", range(3))
def test_the_wall_that_faces_leds_is_the_one_next_to_them(seen, channel):
    """From inside an imprint is a hill, on the side of the LEDs of the channel's group bright."""
    atlas, group = regions(seen, DESIGN, channel), DESIGN.leds.groups[channel]
    (azimuth,) = np.radians(group.azimuth_deg)
    x, y = (place - middle for place, middle in zip(seen.seen_mm, CENTRE_MM, strict=True))
    towards = x * np.cos(azimuth) + y * np.sin(azimuth)
    facing = atlas[f"slope of the imprint that faces the {group.name} LEDs"]
    away = atlas[f"slope of the imprint that faces away from the {group.name} LEDs"]
    assert min(facing.sum(), away.sum()) > 50
    assert towards[away].max() < 0 < towards[facing].min()
    assert (np.hypot(x, y)[atlas["around the imprint, 0.5 to 2 mm outside"]] < 3.0 + 2.0).all()
