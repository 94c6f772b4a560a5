"""Gel that bulges: heights below the undeformed membrane, as far as the border of the picture."""

from dataclasses import replace

import numpy as np
import pytest

from designlab.sensor.design import preset
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from designlab.simulation.render.landings import FirstLight
from designlab.simulation.render.nodes import STRIDE, WIDE_STRIDE, Choice
from designlab.simulation.scene.membrane import membrane
from designlab.simulation.simulator import Simulator
from geometries.probes import parse
from tests.helpers.closed_forms import block_means
from tests.simulation.render.test_landings import AREA_MM, PITCH_MM, lit, parallel_light
from tests.simulation.render.test_photons import HOLLOW, view_of

pytestmark = [pytest.mark.physics, pytest.mark.llvm, pytest.mark.usefixtures("backend"), pytest.mark.renders]

FLAT, ELASTIC = preset("gelsight-2020-flat"), preset("gelsight-2020-flat-elastic")
DEEP_MM, RADIUS_MM, WIDTH_MM = 0.03, 2.0, 0.7
BALL = Press(probe=parse("sphere:4"), depth_mm=0.5, centre_mm=(0.7, -0.4))
BLOCK = 4


def with_ring(surface, radius_mm=RADIUS_MM):
    """The surface with gel lowered by 30 um on a ring, where nothing touches it."""
    x, y = np.meshgrid(surface.x_mm, surface.y_mm)
    ring = -DEEP_MM * np.exp(-(((np.hypot(x - 0.7, y + 0.4) - radius_mm) / WIDTH_MM) ** 2) / 2)
    beside = np.exp(-np.maximum(surface.height_mm, 0.0) / DEEP_MM)
    return replace(surface, height_mm=surface.height_mm + np.where(surface.contact, 0.0, beside * ring))


def change(simulator, surface, seed=1):
    """A picture of a surface, and what differs from the untouched gel's, relative to the mean of that."""
    pressed, untouched = (simulator.frame(None, seed=seed, surface=s).basis for s in (surface, None))
    mean = untouched.mean(axis=(1, 2), keepdims=True)
    return block_means(pressed, BLOCK), block_means((pressed - untouched) / mean, BLOCK)


def compared(design, surface_of, *, samples, truth):
    """Errors of the mean and of the contrast (RMS over blocks, relative) of each group, and its noise.

    Photons of both pictures of the truth start alike, so that noise of their difference is small. What two
    seeds differ by tells the rest of it.
    """
    fast = Simulator(design, columns=80, samples=64, seed=1)
    surface = surface_of(fast)
    traced = Simulator(design, columns=80, samples=samples, seed=1, estimator=truth)
    picture, contrast = change(fast, surface)
    pictures, contrasts = (
        np.array(one) for one in zip(*(change(traced, surface, s) for s in (1, 2)), strict=True)
    )
    noise = ((contrasts[0] - contrasts[1]) ** 2).mean(axis=(1, 2)) / 4
    error = ((contrast - contrasts.mean(axis=0)) ** 2).mean(axis=(1, 2))
    own = (contrasts.mean(axis=0) ** 2).mean(axis=(1, 2))
    off = (picture.mean(axis=(1, 2)) - pictures.mean(axis=(0, 2, 3))) / pictures.mean(axis=(0, 2, 3))
    print(f"mean {off}, contrast {np.sqrt(own)}, error {np.sqrt(error / own)}, noise {np.sqrt(noise / own)}")
    return off, np.sqrt(np.maximum(error - noise, 0.0) / own), np.sqrt(noise / own)


def elastic(press):
    return lambda simulator: simulator.surface(press)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("design", "surface_of"),
    [
        (FLAT, lambda simulator: with_ring(simulator.surface(None))),
        (FLAT, lambda simulator: with_ring(simulator.surface(BALL))),
        (ELASTIC, elastic(BALL)),
    ],
    ids=["bulge-alone", "ridge-and-bulge", "elastic-layer"],
)
def test_a_bulge_in_air_is_as_the_path_tracer_has_it(design, surface_of):
    off, error, noise = compared(design, surface_of, samples=512, truth="path")
    assert np.abs(off).max() < 0.005
    assert noise.max() < 0.2
    assert error.max() < 0.05


@pytest.mark.parametrize("elevation_deg", [20.0, 45.0])
def test_photons_on_a_bulge_follow_the_cosine_around_a_press(elevation_deg):
    elevation, azimuth = np.radians([elevation_deg, 25.0])
    level = np.cos(elevation)
    towards = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    flat = indent(FLAT.elastomer, FLAT.contact, None, area_mm=AREA_MM, pitch_mm=PITCH_MM)
    ball = indent(FLAT.elastomer, FLAT.contact, BALL, area_mm=AREA_MM, pitch_mm=PITCH_MM)
    bulging = with_ring(ball)
    found = FirstLight(parallel_light(flat, towards), flat).change(bulging)
    closed = np.where(lit(bulging, towards), np.maximum(bulging.normals @ towards, 0.0) / towards[2], 0.0)
    at = found.told > 0.999
    assert at.sum() > 2000
    assert (at & (bulging.height_mm < -0.003)).sum() > 300  # gel in the shadow, and around it
    # Blocks of 0.25 mm all of which is lit and told of.
    cut = np.s_[: 180 // 5 * 5, : 240 // 5 * 5]
    sure = block_means((at & lit(bulging, towards))[cut][None].astype(float), 5)[0] > 0.999
    error = block_means((1 + found.light - closed)[cut][None], 5)[0][sure]
    effect = block_means((closed - 1)[cut][None], 5)[0][sure]
    assert np.sqrt(np.mean(error**2)) < 0.05 * np.sqrt(np.mean(effect**2))


def test_pure_bulges_have_nothing_to_learn_from_photons():
    flat = indent(FLAT.elastomer, FLAT.contact, None, area_mm=AREA_MM, pitch_mm=PITCH_MM)
    found = FirstLight(parallel_light(flat, (0.6, 0.0, 0.8)), flat).change(with_ring(flat))
    assert not found.told.any()
    assert not found.light.any()


def test_nodes_cover_a_bulge_and_spread_what_is_linear():
    flat = indent(FLAT.elastomer, FLAT.contact, None, area_mm=AREA_MM, pitch_mm=PITCH_MM)
    assert Choice.near(flat, 1.0) is None
    for surface in (
        with_ring(flat),
        with_ring(indent(FLAT.elastomer, FLAT.contact, BALL, area_mm=AREA_MM, pitch_mm=PITCH_MM)),
    ):
        choice = Choice.near(surface, 1.0)
        x, y = np.meshgrid(surface.x_mm, surface.y_mm)
        plane = 0.3 * x - 0.2 * y + 1.0
        spread = choice.spread(plane[choice.nodes], 0.0)
        rows, columns = ((n - 1) // WIDE_STRIDE * WIDE_STRIDE + 1 for n in plane.shape)
        np.testing.assert_allclose(spread[:rows, :columns], plane[:rows, :columns], atol=1e-5)
    few = (plane.size / STRIDE**2) * 0.5
    assert Choice.near(with_ring(flat), 1.0).nodes.sum() < few


@pytest.mark.slow
@pytest.mark.parametrize("probe", ["sphere:4", "triangle:5"])
def test_nodes_near_the_contact_are_enough_where_gel_bulges(probe, monkeypatch):
    simulator = Simulator(ELASTIC, columns=160, samples=16, seed=1)
    surface = simulator.surface(Press(probe=parse(probe), depth_mm=0.5, centre_mm=(0.7, -0.4)))
    pressed, untouched = (simulator.frame(None, surface=s).basis for s in (surface, None))
    few = Choice.near(surface, 1.0).nodes.sum()
    monkeypatch.setattr("designlab.simulation.render.nodes.RIM_MM", np.inf)
    assert few < 0.8 * Choice.near(surface, 1.0).nodes.sum()
    everywhere = simulator.frame(None, surface=surface).basis
    off = np.sqrt(np.mean((pressed - everywhere) ** 2) / np.mean((everywhere - untouched) ** 2))
    print(f"{probe}: {100 * off:.2f} %")
    assert off < 0.01


@pytest.mark.slow
def test_a_bulge_that_reaches_the_outline_of_the_gel_is_a_picture():
    simulator = Simulator(HOLLOW, view=view_of(HOLLOW, 24, 18), samples=4, seed=1)
    pressed = simulator.surface(BALL)
    beside = ~np.isfinite(pressed.base_mm)
    assert pressed.bulges
    assert beside.any()
    basis = simulator.frame(BALL, surface=pressed).basis
    assert (basis > 0).all()


def test_kernel_contact_has_no_nodes_for_bulges():
    pressed = indent(FLAT.elastomer, FLAT.contact, BALL, area_mm=AREA_MM, pitch_mm=PITCH_MM)
    assert not pressed.bulges
    assert not Choice.near(pressed, 1.0).wide.any()
    flat = indent(FLAT.elastomer, FLAT.contact, None, area_mm=AREA_MM, pitch_mm=PITCH_MM)
    assert FirstLight(parallel_light(flat, (0.6, 0.0, 0.8)), flat).change(pressed).told is None


@pytest.mark.slow
@pytest.mark.parametrize("probe", ["sphere:4", "triangle:5"])
def test_tails_of_a_contact_are_shaded_from_few_nodes(monkeypatch, probe):
    """What a tail changes is as near to what it changes on a finer mesh as by every node of its own."""
    press = BALL.model_copy(update={"probe": parse(probe)})
    tailed = FLAT.replace({"contact.tail_share": 0.2})

    def change(**how):
        with_tail, plain = (
            Simulator(design, columns=75, samples=64, seed=1, **how).frame(press).basis
            for design in (tailed, FLAT)
        )
        return with_tail - plain

    surfaces = [Simulator(design, columns=75, seed=1).surface(press) for design in (tailed, FLAT)]
    few, untailed = (Choice.near(surface, 1.0).nodes.sum() for surface in surfaces)
    coarse = change()
    monkeypatch.setattr("designlab.simulation.render.nodes.TAIL_RIM_MM", np.inf)
    every, same = (Choice.near(surface, 1.0).nodes.sum() for surface in surfaces)
    assert few < 0.5 * every
    assert untailed == same
    truth = change(pitch_mm=surfaces[0].pitch_mm / 2)
    off, least = (np.sqrt(np.mean((c - truth) ** 2) / np.mean(truth**2)) for c in (coarse, change()))
    print(f"{probe}: {100 * off:.2f} %, by every node {100 * least:.2f} %")
    assert off < 1.05 * least


def test_the_mesh_follows_a_bulge_beyond_the_surface_to_the_outline():
    simulator = Simulator(FLAT, columns=16, seed=1)
    untouched = simulator.surface(None)
    lowered = replace(untouched, height_mm=np.full_like(untouched.height_mm, -DEEP_MM))
    shape = membrane(FLAT, lowered)
    x, y, z = shape.vertices.T
    within = (np.abs(x) <= untouched.x_mm.max()) & (np.abs(y) <= untouched.y_mm.max())
    np.testing.assert_allclose(z[within], -DEEP_MM, atol=1e-9)
    used = np.unique(shape.faces)
    beside = used[~within[used]]
    assert beside.size > 0
    assert (z[beside] <= 1e-12).all()
    # No step: neighbours along an edge differ by far less than the bulge is deep.
    edges = shape.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert np.abs(np.diff(z[edges], axis=1)).max() < 0.5 * DEEP_MM
