"""Photons on a pressed membrane against the closed form of parallel light on a curved surface."""

import numpy as np
import pytest

from designlab.sensor.design import preset
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from designlab.simulation.render import baking, lightfield, shading
from designlab.simulation.render.landings import FirstLight
from designlab.simulation.simulator import RenderFailed, Simulator
from geometries.probes import parse
from tests.helpers.closed_forms import block_means

pytestmark = [pytest.mark.physics, pytest.mark.llvm, pytest.mark.usefixtures("backend"), pytest.mark.renders]

FLAT, DOME = preset("gelsight-2020-flat"), preset("gelsight-2020-dome")
AREA_MM, PITCH_MM, BLOCK = (12.0, 9.0), 0.05, 5  # blocks of 0.25 mm


def surface_of(design, press):
    return indent(design.elastomer, design.contact, press, area_mm=AREA_MM, pitch_mm=PITCH_MM)


def parallel_light(surface, towards, side=2400):
    """Evenly spaced photons, on a level plane one in each square, that carry 1 mW/mm2 of its area."""
    half = np.array(AREA_MM) / 2
    x, y = np.meshgrid(*(np.linspace(-h, h, side, endpoint=False) + h / side for h in half))
    power = np.full(x.size, np.prod(AREA_MM) / x.size)
    ways = np.repeat(np.array(towards)[:, None], x.size, axis=1)
    z = surface.sample(np.nan_to_num(surface.z_mm), x, y)
    return np.concatenate([[x.ravel(), y.ravel(), z.ravel()], ways, [power]]).astype(np.float32)


def lit(surface, towards):
    """Whether light from a direction reaches each grid node, by marching over the heights themselves."""
    dx, dy, dz = towards
    x, y = np.meshgrid(surface.x_mm, surface.y_mm)
    free = np.ones(x.shape, dtype=bool)
    for s in np.arange(0.05, 8.0, 0.02):
        free &= surface.sample(surface.z_mm, x + s * dx, y + s * dy) <= surface.z_mm + s * dz + 1e-3
    return free


@pytest.mark.parametrize("elevation_deg", [20.0, 45.0, 80.0])
def test_parallel_light_on_a_press_follows_the_cosine_and_leaves_a_shadow(elevation_deg):
    elevation, azimuth = np.radians([elevation_deg, 25.0])
    towards = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    flat = surface_of(FLAT, None)
    pressed = surface_of(FLAT, Press(probe=parse("sphere:4"), depth_mm=0.6, centre_mm=(0.5, -0.3)))
    found = 1 + FirstLight(parallel_light(flat, towards), flat).change(pressed).light
    cosine = np.maximum(pressed.normals @ towards, 0.0)
    closed = np.where(lit(pressed, towards), cosine / towards[2], 0.0)
    assert (closed.min() == 0) == (elevation_deg == 20)  # steeper light casts no shadow here
    middle = slice(20, 160), slice(20, 220)
    error = block_means((found - closed)[middle][None], BLOCK)[0]
    lights = block_means(lit(pressed, towards)[middle][None].astype(float), BLOCK)[0]
    edge = (lights > 0) & (lights < 1)
    assert np.abs(error[~edge]).max() < 0.01
    assert np.abs(error).max() < 0.1  # where a block is half in the shadow
    assert np.sqrt(np.mean(error**2)) < 0.005
    assert abs(error.mean()) < 1e-3


def test_no_light_is_lost_or_made_on_a_dome():
    rest = surface_of(DOME, None)
    pressed = surface_of(DOME, Press(probe=parse("triangle:4"), depth_mm=0.5, centre_mm=(1.0, 0.6)))
    towards = np.array([0.8, 0.1, np.sqrt(1 - 0.65)])
    change = FirstLight(parallel_light(rest, towards), rest).change(pressed).light
    area, before = (1 / s.normals[..., 2] for s in (pressed, rest))  # of the membrane above a level square
    light = np.nansum((1 / before + change) * area) * PITCH_MM**2
    assert np.abs(change).max() > 0.5
    assert light == pytest.approx(np.isfinite(before).sum() * PITCH_MM**2, rel=2e-3)


def test_a_press_that_is_not_there_changes_nothing():
    flat = surface_of(FLAT, None)
    assert not FirstLight(parallel_light(flat, (0.6, 0.0, 0.8), side=50), flat).change(flat).light.any()


BEHIND_GLASS = preset("default").replace({"optics.path_length": 8})


def baked(seed=4, photons=200_000):
    simulator = Simulator(BEHIND_GLASS, columns=16, samples=1, seed=1)
    area_mm = BEHIND_GLASS.sensing_area_mm
    return baking.bake(simulator.undeformed, area_mm=area_mm, photons=photons, seeds=(seed, seed + 1))


def test_landings_are_the_light_of_the_field():
    halves = baked()
    for field in (*halves, lightfield.mean(halves)):
        for lot, light in zip(field.landings, field.first.irradiance, strict=True):
            # some photons land beside the cells' outermost centres, where a cell counts as half filled
            assert lot[6].sum() == pytest.approx(light.sum() * lightfield.FINE_CELL_MM**2, rel=0.01)
            np.testing.assert_allclose(np.linalg.norm(lot[3:6], axis=0), 1, atol=1e-5)


def test_landings_that_are_kept_stand_for_all(monkeypatch):
    every = baked()[0]
    monkeypatch.setattr(baking, "MOST_LANDINGS", 40_000)  # of 150,000
    for some, lot in zip(baked()[0].landings, every.landings, strict=True):
        assert some.shape[1] < 0.3 * lot.shape[1]
        for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
            whole, part = (values[6, sign * values[axis] > 0] for values in (lot, some))
            error = np.sqrt((part**2).sum())  # of a sum of independent powers
            assert abs(part.sum() - whole.sum()) < 4 * error


def test_a_field_survives_the_cache():
    halves = baked(photons=2_000)
    again = lightfield.unpacked(lightfield.packed(halves))
    for old, new in zip(halves, again, strict=True):
        np.testing.assert_array_equal(new.first.power, old.first.power)
        np.testing.assert_array_equal(new.again.irradiance, old.again.irradiance)
        assert (new.again.x_mm, new.again.y_mm) == (old.again.x_mm, old.again.y_mm)
        for a, b in zip(new.landings, old.landings, strict=True):
            np.testing.assert_array_equal(a, b)


def test_a_cell_is_filled_as_far_as_the_gel_reaches():
    design = FLAT.replace({"elastomer.outline": "rectangle", "elastomer.width_mm": 31.0})
    design = design.replace({"elastomer.length_mm": 24.6})
    scene = Simulator(design, columns=16, samples=1, seed=1).undeformed
    low, high = scene.membrane.vertices.min(axis=0), scene.membrane.vertices.max(axis=0)
    cell_mm = lightfield.FINE_CELL_MM
    shares = []
    for k in (1, 0):
        centre = low[k] + cell_mm * np.arange(int(np.ceil((high[k] - low[k]) / cell_mm)) + 1)
        ends = np.clip([centre - cell_mm / 2, centre + cell_mm / 2], low[k], high[k])
        shares.append((ends[1] - ends[0]) / cell_mm)
    found = baking.share_filled(scene, low, cell_mm, (shares[0].size, shares[1].size))
    np.testing.assert_allclose(found, np.maximum(np.outer(*shares), 0.5), atol=1 / 8)
    assert found[shares[0].size // 2, 0] == 0.5


def test_a_group_without_light_is_named_and_nothing_else_breaks():
    dark = preset("default").replace({"optics.path_length": 3})
    press = Press(probe=parse("sphere:4"), depth_mm=0.4)
    with pytest.raises(RenderFailed, match=r"red.*black"):
        Simulator(dark, columns=16, samples=1, seed=1).frame(press)


def test_grain_of_photons_is_taken_out_and_shadows_stay():
    """A few photons against many others that the narrow kernel takes as they are."""
    press = Press(probe=parse("cylinder:4"), depth_mm=0.7)

    def change(samples, seed, significant):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(shading, "SIGNIFICANT", significant)
            simulator = Simulator(BEHIND_GLASS, columns=80, samples=samples, seed=seed)
            pressed = simulator.frame(press)
            return pressed.basis / simulator.frame(None).basis - 1, pressed.contact

    truth, contact = change(96, 5, 0.0)
    plain, smooth = (change(8, 1, significant)[0] - truth for significant in (0.0, shading.SIGNIFICANT))
    shadow = truth < -0.5
    assert shadow.sum() > 300
    assert smooth[:, contact].std() < 0.65 * plain[:, contact].std()
    assert abs(smooth[:, contact].mean()) < 0.02
    assert abs(smooth[shadow].mean()) < 0.02
