"""Finite elements against the exact linear contact, and how far linear elasticity holds as strains grow."""

import numpy as np
import pytest
from finite_elements import Pad, PressedPad, RoundProbe

from designlab.mechanics.contact import press
from designlab.mechanics.layer import ElasticLayer
from designlab.validation.synthetic.elastic_contact import ElasticBase, press_ball, press_flat_punch

pytestmark = [pytest.mark.physics, pytest.mark.slow]


def pressed(pad, probe, depths, *, sticks=False, fine=0.1, until=1.5):
    return list(PressedPad(pad, probe, sticks=sticks, fine_mm=fine, until_mm=until).press(depths))


@pytest.mark.parametrize("poisson", [0.3, 0.5])
def test_small_presses_are_linear(poisson):
    """A ball of eight thicknesses radius pressed by 1/500 of one: they come to the exact contact."""
    exact = press_ball(ElasticBase(1.0, poisson, 1.0), ball_radius_mm=8.0, depth_mm=0.002)
    r = np.linspace(0.0, 2.0, 300)
    force, surface = [], []
    for fine in (0.1, 0.05):
        pad = Pad(thickness_mm=1.0, radius_mm=7.0, poisson=poisson)
        found = pressed(pad, RoundProbe(8.0), (0.001, 0.002), fine=fine, until=0.4)[-1]
        force.append(abs(found.force_n / exact.force_n - 1))
        surface.append(np.abs(found.surface_mm(r) - exact.surface_mm(r)).max() / 0.002)
    assert force[0] < 0.05
    assert force[1] < 0.005
    assert surface[0] < 0.06
    assert surface[1] < 0.4 * surface[0]


def test_punch_with_rounded_edge_is_between_sharp_punches():
    """A flat end of radius 0.8 mm with an edge rounded by 0.2 mm is stiffer than one of 0.8 mm without."""
    pad = Pad(thickness_mm=1.0, radius_mm=7.0, poisson=0.49)
    found = pressed(pad, RoundProbe(0.2, flat_mm=0.8), (0.001, 0.002), fine=0.05, until=1.1)[-1]
    base = ElasticBase(1.0, 0.49, 1.0)
    narrow, wide = (
        press_flat_punch(base, punch_radius_mm=radius, depth_mm=0.002).force_n for radius in (0.8, 1.0)
    )
    assert narrow < found.force_n < 0.9 * wide
    assert 0.8 < found.contact_radius_mm < 0.9


def test_force_is_the_slope_of_the_energy():
    """At a depth of half the thickness, on a pad with a near edge; no term of the stress is left out."""
    model = PressedPad(
        Pad(thickness_mm=2.0, radius_mm=6.0, modulus_mpa=0.43),
        RoundProbe(4.0),
        sticks=False,
        fine_mm=0.25,
        until_mm=3.0,
    )
    states, energy = [], []
    for state in model.press([0.1, 0.3, 0.5, 0.7, 0.85, 0.99, 1.0, 1.01]):
        states.append(state)
        energy.append(model.energy_mj)
    assert (energy[-1] - energy[-3]) / 0.02 == pytest.approx(states[-2].force_n, rel=1e-3)


def test_dome_of_huge_radius_is_flat():
    flat, dome = (
        pressed(Pad(1.0, 5.0, dome_mm=bend), RoundProbe(2.0), (0.05, 0.1, 0.2)) for bend in (None, 1e5)
    )
    assert dome[-1].force_n == pytest.approx(flat[-1].force_n, rel=1e-4)


def test_without_friction_the_linear_contact_holds_to_half_the_thickness():
    """Ball of two thicknesses radius: force within 2 %, contact radius 3 %, surface 1 % of depth (RMS)."""
    pad, base = Pad(thickness_mm=1.0, radius_mm=8.0), ElasticBase(1.0, 0.49, 1.0)
    for found in pressed(pad, RoundProbe(2.0), np.arange(0.05, 0.51, 0.05), until=1.7)[3::2]:
        linear = press_ball(base, ball_radius_mm=2.0, depth_mm=found.depth_mm)
        assert linear.force_n == pytest.approx(found.force_n, rel=0.02)
        assert linear.contact_radius_mm == pytest.approx(found.contact_radius_mm, rel=0.03)
        r = np.linspace(0.0, found.contact_radius_mm + 1.5, 300)
        off = linear.surface_mm(r) - found.surface_mm(r)
        assert np.sqrt(np.average(off**2, weights=r)) < 0.01 * found.depth_mm


def test_where_gel_sticks_force_grows_beyond_the_linear_one():
    """Ball of two thicknesses radius: surface within 1 % of depth (RMS); stiffened, the force within 2 %."""
    half, pitch = 45, 0.04
    at = pitch * (np.arange(2 * half + 1) - half)
    square = at[:, None] ** 2 + at**2
    gap = np.where(square < 4.0, 2.0 - np.sqrt(np.maximum(4.0 - square, 0.0)), np.inf)
    excess = {}
    for found in pressed(
        Pad(1.0, 8.0), RoundProbe(2.0), np.arange(0.025, 0.51, 0.025), sticks=True, until=1.7
    )[7::4]:
        linear = press(
            gap, ElasticLayer(1.0, 0.49, 1.0), pitch_mm=pitch, depth_mm=found.depth_mm, friction=np.inf
        )
        excess[round(found.depth_mm, 3)] = found.force_n / (linear.pressure_mpa.sum() * pitch**2) - 1
        assert linear.force_n == pytest.approx(found.force_n, rel=0.02)
        count = int((found.contact_radius_mm + 1.5) / pitch)
        height = linear.displacement((1, count), (-half, -half))[0]
        off = height - found.surface_mm(pitch * np.arange(count))
        assert np.sqrt(np.average(off**2, weights=np.arange(count))) < 0.01 * found.depth_mm
    assert excess[0.2] == pytest.approx(0.015, abs=0.02)
    assert excess[0.5] == pytest.approx(0.165, abs=0.02)
