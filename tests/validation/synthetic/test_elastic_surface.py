"""The generator's elastic membrane against the simulator's, which is solved otherwise, and geometry."""

import numpy as np
import pytest

from designlab.sensor.design import preset
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from designlab.validation.synthetic import effects
from designlab.validation.synthetic.capture_plan import true_press
from designlab.validation.synthetic.elastic_surface import pressed
from designlab.validation.synthetic.generator_sensor import Rig
from designlab.validation.synthetic.glass import CameraRays
from designlab.validation.synthetic.indenter import Indenter
from designlab.validation.synthetic.raycast import meet
from designlab.validation.synthetic.surface import HeightField, indented
from geometries.probes import parse

pytestmark = pytest.mark.physics

FLAT = preset("gelsight-2020-flat-elastic")
DOME = preset("gelsight-2020-dome-elastic")
AREA_MM = (12.0, 10.0)


def both(design, probe, depth_mm, centre_mm, yaw_deg=0.0):
    """Heights by the generator and by the simulator on the simulator's grid (mm), and its surface."""
    rig = Rig.of(design)
    ours = pressed(rig.elastomer, rig.gel, Indenter(parse(probe), depth_mm, centre_mm, yaw_deg))
    press = Press(probe=parse(probe), depth_mm=depth_mm, centre_mm=centre_mm, yaw_deg=yaw_deg)
    theirs = indent(design.elastomer, design.contact, press, area_mm=AREA_MM, pitch_mm=0.025)
    x, y = np.meshgrid(theirs.x_mm, theirs.y_mm)
    return ours.z(x, y) - theirs.base_mm, theirs.height_mm, theirs


@pytest.mark.slow
@pytest.mark.parametrize(("centre_mm", "depth_mm"), [((1.0, -0.5), 0.6), ((3.0, 2.0), 0.8)])
def test_a_ball_on_a_flat_gel_is_the_simulators_to_half_a_micrometre(centre_mm, depth_mm):
    ours, theirs, surface = both(FLAT, "sphere:4", depth_mm, centre_mm)
    np.testing.assert_allclose(ours, theirs, atol=5e-4)
    assert surface.mechanics.bulge_um > 10


@pytest.mark.slow
def test_a_triangle_is_the_simulators_but_for_its_edge():
    ours, theirs, surface = both(FLAT, "triangle:5", 0.5, (1.0, -0.5), 20.0)
    assert np.sqrt(np.mean((ours - theirs) ** 2)) < 1e-3
    assert ours.min() == pytest.approx(-surface.mechanics.bulge_um / 1000, rel=0.03)


@pytest.mark.slow
def test_a_ball_on_a_dome_is_the_simulators_where_the_dome_is_level_and_near_it_on_its_slope():
    """The simulator goes on from where they touch first; the generator finds the axis of ball and dome."""
    ours, theirs, _ = both(DOME, "sphere:4", 0.6, (1.0, -0.5))
    np.testing.assert_allclose(ours, theirs, atol=2e-3)
    ours, theirs, _ = both(DOME, "sphere:4", 0.8, (4.0, 3.0))
    np.testing.assert_allclose(ours, theirs, atol=0.016)


@pytest.mark.slow
def test_gel_on_a_dome_takes_the_shape_of_the_ball_where_it_is_touched():
    rig = Rig.of(DOME.replace({"contact.skin_length_mm": 0.0}))
    x0, y0, depth, radius = 4.0, 3.0, 0.8, 2.0
    field = pressed(rig.elastomer, rig.gel, Indenter(parse("sphere:4"), depth, (x0, y0)))
    dome = rig.elastomer.radius_mm
    middle = dome - np.sqrt((dome + radius) ** 2 - x0**2 - y0**2) + depth
    x, y = np.meshgrid(x0 + np.linspace(-1.0, 0.6, 30), y0 + np.linspace(-1.0, 0.6, 30))
    ball = middle + np.sqrt(radius**2 - (x - x0) ** 2 - (y - y0) ** 2)
    inside = field.touched(x, y) == 1
    assert inside.sum() > 500
    # The ball's distance from the dome counts along the normal, and the dome as flat beneath it.
    np.testing.assert_allclose(field.z(x, y)[inside], ball[inside], atol=0.02)


@pytest.mark.slow
def test_a_skin_smooths_and_keeps_the_volume():
    rigs = [Rig.of(FLAT.replace({"contact.skin_length_mm": length})) for length in (0.0, 0.15)]
    sharp, soft = (pressed(r.elastomer, r.gel, Indenter(parse("sphere:4"), 0.6, (0.0, 0.0))) for r in rigs)
    assert soft.height_mm.sum() == pytest.approx(sharp.height_mm.sum(), rel=1e-3)
    # A normal distribution lowers the top of a ball by its variance over the ball's radius.
    assert sharp.peak_mm - soft.peak_mm == pytest.approx(0.15**2 / 2.0, rel=0.05)


@pytest.mark.slow
def test_other_objects_and_second_contacts_take_their_share():
    rig = Rig.of(FLAT)
    one = Indenter(parse("sphere:4"), 0.5, (0.0, 0.0))
    far = Indenter(parse("sphere:2"), 0.3, (5.0, 0.0))
    plain, small = (pressed(rig.elastomer, rig.gel, press) for press in (one, far))
    together = pressed(rig.elastomer, rig.gel, one._replace(beside=far))
    x, y = np.meshgrid(np.linspace(-3, 7, 50), np.linspace(-3, 3, 30))
    np.testing.assert_allclose(together.z(x, y), plain.z(x, y) + small.z(x, y), atol=1e-4)
    wrong = one._replace(other=parse("cone:4"), wrong=0.25)
    cone = pressed(rig.elastomer, rig.gel, one._replace(probe=parse("cone:4")))
    mixed = pressed(rig.elastomer, rig.gel, wrong)
    np.testing.assert_allclose(mixed.z(x, y), 0.75 * plain.z(x, y) + 0.25 * cone.z(x, y), atol=1e-4)


def test_rays_meet_gel_that_bulges_away():
    field = HeightField(None, -5.0, -5.0, 0.1, height_mm=np.full((101, 101), -0.03))
    rays = CameraRays((0.0, 0.0, 30.0), np.array([0.0, 0.1]), np.array([0.0, -0.05]))
    np.testing.assert_allclose(meet(rays, field), 30.03, atol=1e-5)
    assert field.bulge_mm == pytest.approx(0.03)
    assert field.changed.left == pytest.approx(-5.0)


def test_nothing_of_a_kernel_bulges():
    rig = Rig.of(preset("gelsight-2020-flat"))
    press = Indenter(parse("sphere:4"), 0.6, (0.0, 0.0))
    field = indented(rig.elastomer, press, kernel_length_mm=rig.kernel_length_mm, kernel_m=rig.kernel_m)
    assert rig.gel.share == 0
    assert field.bulge_mm == 0
    assert field.changed == field.bump


def test_what_elastic_sets_cannot_have_is_refused_by_name():
    with pytest.raises(ValueError, match=r"contact\.friction: .* without friction, got 0\.3"):
        Rig.of(FLAT.replace({"contact.friction": 0.3}))
    rig = Rig.of(FLAT)
    with pytest.raises(ValueError, match="depth_mm: must be less than the gel is thick"):
        pressed(rig.elastomer, rig.gel, Indenter(parse("sphere:4"), rig.gel.thickness_mm, (0.0, 0.0)))
    with pytest.raises(ValueError, match="contact_kernel: unknown parameter 'length_ratio'"):
        effects.apply(rig, {"contact_kernel": {"length_ratio": 2.0}})
    with pytest.raises(ValueError, match="contact_profile: has no parameters on this sensor"):
        effects.draw("contact_profile", rig, strength=1.0, seed=0)
    changed, truth = effects.apply(rig, {"gel_thickness": {"thickness_ratio": 0.8}, "skin_length": {}})
    assert truth["skin_length"] == {"added_mm": 0.0}
    assert changed.gel.thickness_mm == pytest.approx(0.8 * rig.gel.thickness_mm)
    assert changed.gel.skin_mm == rig.gel.skin_mm


def test_probes_are_rounded_and_scaled_together():
    rig, _ = effects.apply(
        Rig.of(FLAT), {"probe_edge": {"radius_mm": 0.2}, "probe_size": {"size_ratio": 1.1}}
    )
    press = {"probe": "triangle:4:r0.1", "depth_mm": 0.4, "centre_mm": (0.0, 0.0)}
    found = true_press(rig, press, np.random.default_rng(0)).probe
    assert (found.size_mm, found.edge_radius_mm) == pytest.approx((4.4, 0.31))
    ball = true_press(rig, press | {"probe": "sphere:4"}, np.random.default_rng(0)).probe
    assert ball.text == "sphere:4.4"
