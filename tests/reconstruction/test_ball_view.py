"""What pixels see of a ball on a dome, against presses of the simulator along the dome's normal."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from designlab.core.metrics import normal_error_deg
from designlab.mechanics.contact import press as press_layer
from designlab.mechanics.layer import ElasticLayer
from designlab.reconstruction.ball_samples import known_gel
from designlab.reconstruction.ball_surface import BallSurface
from designlab.reconstruction.ball_view import ball_view, touched_px
from designlab.reconstruction.balls import BallPress
from designlab.reconstruction.centres import placed_by_circle
from designlab.reconstruction.height import normals
from designlab.reconstruction.membrane import Membrane
from designlab.reconstruction.setup import Setup
from designlab.sensor.contact import LayerContact
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from geometries.elastomer import Elastomer, base_gradient, base_mm
from geometries.probes import parse

DOME_MM, THICKNESS_MM, POISSON = 30.0, 2.0, 0.49
DOME = Elastomer(shape="dome", outline="round", width_mm=24.0, thickness_mm=THICKNESS_MM, radius_mm=DOME_MM)
PITCH_MM, HALF = 0.05, 160
EYE_MM = 25.0
RINGS = (0.3, 0.6, 0.8, 0.9, 1.0, 1.1, 1.2, 1.4, 1.7, 2.0, 2.5)  # in contact radii


def membrane():
    """The dome as a pinhole over its apex sees it, on a grid of 321 x 321 points."""
    axis = PITCH_MM * np.arange(-HALF, HALF + 1)
    x, y = np.meshgrid(axis, -axis)
    height, (p, q) = base_mm(DOME, x, y), base_gradient(DOME, x, y)
    columns, rows = np.meshgrid(np.arange(x.shape[1], dtype=float), np.arange(x.shape[0], dtype=float))
    sight = [-each / (EYE_MM - height) for each in (x, y)]
    whole = np.ones(x.shape, dtype=bool)
    return Membrane(columns, rows, whole, height, p, q, *sight, PITCH_MM, x.shape), x, y


def met(surface, on, x, y):
    """Places where the ray of each pixel meets the membrane."""
    lifted = np.zeros_like(x)
    for _ in range(40):
        places = x + on.sight_x * lifted, y + on.sight_y * lifted
        above = surface.sample(surface.z_mm, *places) - on.height_mm - lifted
        lifted = lifted + 0.7 * above
    assert np.abs(above).max() < 1e-4
    return places


def seen(surface, on, x, y):
    """Slopes of the whole membrane that pixels see."""
    places = met(surface, on, x, y)
    return tuple(surface.sample(slope, *places) for slope in surface.gradient)


@pytest.mark.physics
@pytest.mark.parametrize("skin_mm", [0.0, 0.15])
@pytest.mark.parametrize(("x_mm", "y_mm"), [(0.0, 0.0), (3.0, -2.0), (-1.5, 4.5)])
@pytest.mark.parametrize(("ball_mm", "depth_mm"), [(3.0, 0.7), (6.0, 0.5)])
def test_a_press_along_the_normal_of_a_dome_looks_as_simulated(skin_mm, x_mm, y_mm, ball_mm, depth_mm):
    contact = LayerContact(
        gel="custom", modulus_mpa=0.3, poisson=POISSON, skin_length_mm=skin_mm, friction=0.0
    )
    press = Press(
        probe=parse(f"sphere:{ball_mm}"), depth_mm=depth_mm, centre_mm=(x_mm, y_mm), direction="normal"
    )
    surface = indent(DOME, contact, press, area_mm=(20.0, 20.0), pitch_mm=0.025)
    on, x, y = membrane()
    truth = seen(surface, on, x, y)

    bulge = round(1 / DOME_MM, 3)
    gel = BallSurface(ball_mm / 2, THICKNESS_MM, POISSON, bulge)
    radii = np.linspace(0.2, 0.85, 400) * ball_mm / 2
    radius_mm = float(np.interp(depth_mm, [gel.depth_mm(each) for each in radii], radii))
    assert surface.mechanics.contact_radius_mm == pytest.approx(radius_mm, rel=0.01)

    touched = HALF + x_mm / PITCH_MM, HALF - y_mm / PITCH_MM
    axis = on.axis_of(touched, (ball_mm / 2 - depth_mm) / PITCH_MM)
    setup = Setup(
        ball_mm / 2, PITCH_MM, thickness_mm=THICKNESS_MM, poisson=POISSON, label_bias=0.0, skin_mm=skin_mm
    )
    ball = BallPress(np.zeros((*x.shape, 3)), axis, radius_mm / PITCH_MM)
    assert touched_px(ball, setup, on) == pytest.approx(touched, abs=0.05)
    view = ball_view(ball, setup, on)
    share = view.r_px * PITCH_MM / radius_mm
    p, q = view.gel_slopes()
    error = normal_error_deg(normals(p + on.p, q + on.q), normals(*truth))
    rings = np.digitize(share, RINGS)
    means = np.array([error[rings == ring].mean() for ring in range(len(RINGS))])
    print(f"rings to {RINGS}: {means.round(2)} deg")
    # across the rim of a bare gel slopes fall within a cell of the simulator's grid
    assert means.max() < (0.1 if skin_mm else 0.6)
    assert error[share < 2.5].mean() < 0.1
    if not skin_mm:
        ball_error = normal_error_deg(normals(*view.ball_slopes), normals(*truth))
        assert np.quantile(ball_error[share < 0.9], 0.99) < 0.5


@pytest.mark.physics
@pytest.mark.parametrize(("x_mm", "y_mm"), [(0.5, 0.0), (3.0, -2.0), (-1.5, 4.5)])
def test_a_ball_is_placed_by_where_its_contact_is_seen(x_mm, y_mm):
    """The rim is seen further out than where it lies; pixels that see the simulated contact show it."""
    contact = LayerContact(gel="custom", modulus_mpa=0.3, poisson=POISSON, skin_length_mm=0.0, friction=0.0)
    press = Press(probe=parse("sphere:4"), depth_mm=0.6, centre_mm=(x_mm, y_mm), direction="normal")
    surface = indent(DOME, contact, press, area_mm=(20.0, 20.0), pitch_mm=0.025)
    on, x, y = membrane()
    rows, columns = np.nonzero(surface.sample(surface.contact.astype(float), *met(surface, on, x, y)) > 0.5)
    circle = float(columns.mean()), float(rows.mean())
    touched = HALF + x_mm / PITCH_MM, HALF - y_mm / PITCH_MM
    axis = np.array(on.axis_of(touched, (2.0 - 0.6) / PITCH_MM))
    radius_px = surface.mechanics.contact_radius_mm / PITCH_MM
    setup = Setup(2.0, PITCH_MM, thickness_mm=THICKNESS_MM, poisson=POISSON, label_bias=0.0)
    first = BallPress(np.zeros((*x.shape, 3)), on.axis_of(circle, 2.0 / PITCH_MM), radius_px)
    placed = placed_by_circle(first, circle, setup, on)
    off, before = (np.hypot(*(np.array(ball.centre_px) - axis)) for ball in (placed, first))
    assert off < 0.3
    assert before > 2 * off or math.hypot(x_mm, y_mm) < 1.0


def test_a_circle_that_the_border_cuts_places_its_ball_as_well():
    """The picture ends within the contact; what is left of it must not draw the ball inwards."""
    on, x, _ = membrane()
    setup = Setup(2.0, PITCH_MM, thickness_mm=THICKNESS_MM, poisson=POISSON, label_bias=0.0)
    axis = (HALF + 40.0, HALF - 20.0)
    ball = BallPress(np.zeros((*x.shape, 3)), axis, 24.0)
    rows, columns = np.nonzero(ball_view(ball, setup, on).r_px < 24.0)
    circle = float(columns.mean()), float(rows.mean())
    first = ball.moved(on.axis_of(circle, 2.0 / PITCH_MM))
    cut = on._replace(seen=np.broadcast_to(np.arange(x.shape[1]) < axis[0] + 8.0, x.shape))
    for each in (on, cut):
        assert np.hypot(*np.subtract(placed_by_circle(first, circle, setup, each).centre_px, axis)) < 0.3


@pytest.mark.faults
@pytest.mark.parametrize(("file", "named"), [("set/ball-1.png", "set/ball-1.png: "), ("", r"balls\[1\]\.")])
def test_a_ball_beside_the_gel_that_is_seen_is_refused_by_its_name(file, named):
    on, x, _ = membrane()
    half = on._replace(seen=np.broadcast_to(np.arange(x.shape[1]) < HALF, x.shape))
    image = np.random.default_rng(0).uniform(0.5, 1.0, (*x.shape, 3))
    balls = [BallPress(image, place, 20.0) for place in ((100.0, 150.0), (220.0, 150.0), (80.0, 90.0))]
    balls[1] = replace(balls[1], file=file)
    setup = Setup(2.0, PITCH_MM, thickness_mm=THICKNESS_MM)
    with pytest.raises(ValueError, match=f"{named}centre_px: the contact lies outside the picture"):
        known_gel(balls, np.ones_like(image), setup, half)


@pytest.mark.parametrize("bulge_per_mm", [0.0, 0.1, -0.1])
@pytest.mark.parametrize("thickness_mm", [2.0, 6.0])
def test_contact_on_a_bulging_layer_is_that_of_the_solver_on_a_grid(bulge_per_mm, thickness_mm):
    radius_mm, pitch_mm, depth_mm = 3.0, 0.04, 0.6
    y, x = np.mgrid[-75:76, -75:76] * pitch_mm
    r = np.hypot(x, y)
    gap = radius_mm - np.sqrt(np.maximum(radius_mm**2 - r**2, 0.0)) + bulge_per_mm * r**2 / 2
    solved = press_layer(gap, ElasticLayer(1.0, POISSON, thickness_mm), pitch_mm=pitch_mm, depth_mm=depth_mm)
    surface = BallSurface(radius_mm, thickness_mm, POISSON, bulge_per_mm)
    assert surface.depth_mm(solved.contact_radius_mm) == pytest.approx(depth_mm, rel=0.02)
    moved = solved.displacement(x.shape, (0, 0))
    slope_y, slope_x = np.gradient(moved, pitch_mm)
    radial = (x * slope_x + y * slope_y) / np.maximum(r, 1e-9)
    told = surface.slope(r, solved.contact_radius_mm)
    away = (np.abs(r / solved.contact_radius_mm - 1) > 0.1) & (r < 2.0 * solved.contact_radius_mm)
    assert np.abs(told - radial)[away].max() < 0.02


@pytest.mark.parametrize("bulge_per_mm", [0.02, 0.2])
def test_a_shallow_contact_on_a_thick_layer_has_the_curvatures_added(bulge_per_mm):
    """Hertz: the depth is the contact radius squared times the sum of both curvatures."""
    surface = BallSurface(3.0, 300.0, POISSON, bulge_per_mm)
    assert surface.depth_mm(0.2) == pytest.approx(0.04 * (1 / 3.0 + bulge_per_mm), rel=2e-3)
    depth = surface.depth_mm(0.6)
    cut = 0.6 / surface.contact_share(0.6)
    ball = 3.0 - math.sqrt(9.0 - cut**2)
    assert ball + bulge_per_mm * cut**2 / 2 == pytest.approx(depth)


@pytest.mark.parametrize("contact_mm", [0.5, 1.0, 1.5])
def test_a_coating_rounds_as_a_gaussian_in_the_plane(contact_mm):
    pitch_mm, skin_mm = 0.02, 0.3
    axis = pitch_mm * np.arange(-350, 351)
    x, y = np.meshgrid(axis, axis)
    bare, coated = (BallSurface(3.0, 2.0, POISSON, 0.03, skin_mm=skin) for skin in (0.0, skin_mm))
    rounded = [gaussian_filter(slope, skin_mm / pitch_mm) for slope in bare.gradient(x, y, contact_mm)]
    found = coated.gradient(x, y, contact_mm)
    near = np.hypot(x, y) < 4.0
    for one, other in zip(found, rounded, strict=True):
        assert np.abs(one - other)[near].max() < 1e-3


@pytest.mark.parametrize("skin_mm", [0.001, 0.005, 0.02])
def test_a_thin_coating_changes_little(skin_mm):
    """Also one that is thinner than the steps in which the surface is known."""
    r = np.linspace(0.0, 5.0, 300)
    bare, coated = (BallSurface(3.0, 2.0, POISSON, 0.03, skin_mm=skin) for skin in (0.0, skin_mm))
    off = np.abs(coated.slope(r, 1.5) - bare.slope(r, 1.5))
    assert off[r < 1.4].max() < 2e-3
    assert off.max() < 0.1  # at the rim, where slopes of a bare gel fall by a root of the distance


def test_a_hollow_tighter_than_the_ball_is_refused():
    with pytest.raises(ValueError, match="hollow must be wider than the ball of 6 mm"):
        BallSurface(3.0, 2.0, POISSON, -0.35)
