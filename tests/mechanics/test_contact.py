"""Contact of a rigid probe with a bonded layer against exact solutions, limits and its own rules."""

import numpy as np
import pytest
from ContactMechanics import PeriodicFFTElasticHalfSpace, make_system
from scipy.special import j0
from SurfaceTopography import Topography

from designlab.mechanics.contact import NotConverged, OutOfReach, press
from designlab.mechanics.layer import ElasticLayer
from designlab.validation.synthetic.elastic_contact import ElasticBase, press_ball, press_flat_punch

pytestmark = pytest.mark.physics
BALL_MM = 2.5  # radius


def radii(reach_mm, pitch_mm):
    steps = int(np.ceil(reach_mm / pitch_mm))
    axis = np.arange(-steps, steps + 1) * pitch_mm
    return np.hypot(axis[:, None], axis)


def ball(reach_mm, pitch_mm, radius_mm=BALL_MM):
    r = radii(reach_mm, pitch_mm)
    return np.where(r < radius_mm, radius_mm - np.sqrt(np.maximum(radius_mm**2 - r**2, 0.0)), np.inf)


def around(solution, reach_mm):
    """Surface on a wider grid with the same middle, and distances from it."""
    steps = int(np.ceil(reach_mm / solution.pitch_mm))
    origin = steps - solution.pressure_mpa.shape[0] // 2
    shape = (2 * steps + 1, 2 * steps + 1)
    return solution.displacement(shape, (origin, origin)), radii(reach_mm, solution.pitch_mm)


@pytest.mark.parametrize("poisson", [0.3, 0.45, 0.49, 0.5])
@pytest.mark.parametrize(("thickness", "depth"), [(1.0, 0.1), (1.0, 0.5), (2.0, 0.8), (4.0, 0.4), (4.0, 0.8)])
def test_a_ball_meets_the_exact_force_radius_and_bulge(poisson, thickness, depth):
    exact = press_ball(ElasticBase(0.4, poisson, thickness), ball_radius_mm=BALL_MM, depth_mm=depth)
    edge, layer = exact.contact_radius_mm, ElasticLayer(0.4, poisson, thickness)
    errors = []
    for cells, most in ((40, 0.01), (10, 0.03), (20, 0.01)):
        found = press(ball(1.3 * edge, edge / cells), layer, pitch_mm=edge / cells, depth_mm=depth)
        errors.append(abs(found.force_n / exact.force_n - 1))
        assert errors[-1] < most
        assert found.contact_radius_mm == pytest.approx(edge, rel=most)
    assert errors[0] < errors[1] / 2 + 1e-4
    surface, r = around(found, edge + 2.5 * thickness)
    outside = r > edge
    truth, surface = exact.surface_mm(r[outside][::37]), surface[outside][::37]
    bulge = truth < 0
    np.testing.assert_allclose(surface[bulge], truth[bulge], atol=max(0.5e-3, -0.03 * truth.min()))
    assert np.abs(surface - truth).max() < 3e-3 * depth  # at the rim, where it is steepest


@pytest.mark.parametrize("poisson", [0.3, 0.5])
@pytest.mark.parametrize("ratio", [0.2, 1.0, 2.0])
def test_a_flat_punch_is_as_stiff_as_it_should_be(poisson, ratio):
    """Averaged over how its edge lies to the grid, whose cells it is made of."""
    layer, exact = ElasticLayer(0.4, poisson, 2.0), ElasticBase(0.4, poisson, 2.0)
    truth = press_flat_punch(exact, punch_radius_mm=2.0 * ratio, depth_mm=0.1).force_n
    mean = {}
    for cells in (8, 20):
        found = []
        for part in np.linspace(0.0, 0.8, 5):
            pitch = 2.0 * ratio / (cells + part)
            gap = np.where(radii(2.1 * ratio, pitch) <= 2.0 * ratio, 0.0, np.inf)
            found.append(press(gap, layer, pitch_mm=pitch, depth_mm=0.1).force_n / truth - 1)
        mean[cells] = abs(np.mean(found))
    assert mean[20] < 0.01
    assert mean[8] < 0.03


def test_a_thin_compressible_layer_is_a_bed_of_springs():
    """Force pi M R d2 / h with the modulus M of even compression, contact radius sqrt(2 R d)."""
    layer, depth, radius = ElasticLayer(1.0, 0.2, 0.02), 0.005, 100.0
    edge = np.sqrt(2 * radius * depth)
    found = press(ball(1.2 * edge, edge / 60, radius), layer, pitch_mm=edge / 60, depth_mm=depth)
    modulus = (1 - 0.2) / (1.2 * 0.6)
    assert found.force_n == pytest.approx(np.pi * modulus * radius * depth**2 / 0.02, rel=0.03)
    assert found.contact_radius_mm == pytest.approx(edge, rel=0.02)


def test_a_thick_layer_is_the_half_space_of_hertz():
    depth, layer = 0.005, ElasticLayer(0.4, 0.3, 20.0)
    edge = np.sqrt(BALL_MM * depth)
    found = press(ball(1.5 * edge, edge / 30), layer, pitch_mm=edge / 30, depth_mm=depth)
    assert found.force_n == pytest.approx(4 / 3 * 0.4 / (1 - 0.09) * np.sqrt(BALL_MM) * depth**1.5, rel=0.01)


def test_an_incompressible_gel_bulges_by_as_much_as_is_pressed_in():
    layer = ElasticLayer(0.4, 0.5, 1.0)
    found = press(ball(1.6, 0.05), layer, pitch_mm=0.05, depth_mm=0.4)
    surface, _ = around(found, 9.0)
    assert abs(surface.sum()) < 5e-3 * surface[surface > 0].sum()


def test_where_it_presses_the_surface_is_the_probe_and_nowhere_above():
    """Two balls, one of them higher, and a ridge: a contact that is not round and not in one piece."""
    pitch = 0.05
    axis = np.arange(-60, 61) * pitch
    x, y = np.meshgrid(axis, axis)
    first, second = (1.5 - np.sqrt(np.maximum(2.25 - (x - s) ** 2 - y**2, 0.0)) for s in (-1.6, 1.6))
    gap = np.minimum(np.minimum(first, second + 0.15), np.abs(x + y) * 0.8 + 0.1)
    found = press(gap, ElasticLayer(0.4, 0.49, 1.5), pitch_mm=pitch, depth_mm=0.35)
    surface = found.displacement(gap.shape, (0, 0))
    assert found.pressure_mpa.min() >= 0
    np.testing.assert_allclose(surface[found.touched], (0.35 - gap)[found.touched], atol=1e-3 * 0.35)
    assert (surface - (0.35 - gap)).min() > -1e-3 * 0.35


def test_the_modulus_scales_force_and_changes_no_shape():
    soft, hard = (
        press(ball(1.5, 0.05), ElasticLayer(modulus, 0.49, 2.0), pitch_mm=0.05, depth_mm=0.5)
        for modulus in (0.1, 1.0)
    )
    assert hard.force_n == pytest.approx(10 * soft.force_n, rel=1e-9)
    np.testing.assert_allclose(around(hard, 4.0)[0], around(soft, 4.0)[0], atol=1e-12)


def test_a_force_is_met_by_its_depth_and_one_out_of_reach_is_refused():
    layer, gap = ElasticLayer(0.4, 0.49, 2.0), ball(2.0, 0.05)
    found = press(gap, layer, pitch_mm=0.05, force_n=1.0)
    assert found.force_n == pytest.approx(1.0, rel=2e-4)
    again = press(gap, layer, pitch_mm=0.05, depth_mm=found.depth_mm)
    assert again.force_n == pytest.approx(1.0, rel=3e-4)
    with pytest.raises(OutOfReach, match=r"force_n: 1e-09 N is too little for a grid of 0.05 mm"):
        press(gap + 0.01, layer, pitch_mm=0.05, force_n=1e-9)
    with pytest.raises(OutOfReach, match=r"force_n: 50 N is not reached; the deepest press of 0\.6 mm takes"):
        press(gap, layer, pitch_mm=0.05, force_n=50.0, deepest_mm=0.6)


@pytest.mark.parametrize("poisson", [0.3, 0.49, 0.5])
def test_friction_holds_the_skin_and_stiffens(poisson):
    """Sticking is 0.6 to 18 % stiffer, by the ratio of the layer; friction lies between."""
    layer, gap = ElasticLayer(0.4, poisson, 2.0), ball(2.0, 0.08)
    free, some, stuck = (
        press(gap, layer, pitch_mm=0.08, depth_mm=0.8, friction=mu) for mu in (0.0, 0.2, np.inf)
    )
    assert free.force_n < some.force_n < stuck.force_n < 1.2 * free.force_n
    sideways = stuck.tangential_displacement(gap.shape, (0, 0))
    inner = stuck.touched & (radii(2.0, 0.08) < 0.9 * stuck.contact_radius_mm)
    assert np.abs(sideways[:, inner]).max() < 2e-3 * 0.8
    assert np.abs(free.tangential_displacement(gap.shape, (0, 0))).max() > 0.02
    assert some.needed_friction(1.0) == pytest.approx(0.2, rel=2e-3)
    assert stuck.needed_friction() > 0.2


@pytest.mark.slow
def test_a_half_space_without_poisson_effect_needs_no_friction():
    """At nu 1/2 a half space does not move sideways under pressure, so sticking changes nothing (Spence)."""
    layer, gap = ElasticLayer(0.4, 0.5, 20.0), ball(0.4, 0.02)
    free, stuck = (press(gap, layer, pitch_mm=0.02, depth_mm=0.05, friction=mu) for mu in (0.0, np.inf))
    assert stuck.force_n == pytest.approx(free.force_n, rel=1e-3)


@pytest.mark.slow
def test_a_flat_punch_that_sticks_is_sheared_and_twisted_as_mindlin_and_reissner_say():
    """Half space: shear 16 G a s / (2 - nu) at nu 1/2, torque 16 G a3 angle / 3."""
    layer, edge, pitch = ElasticLayer(0.4, 0.5, 40.0), 1.0, 1.0 / 24.3
    gap = np.where(radii(1.1, pitch) <= edge, 0.0, np.inf)
    middle = (gap.shape[0] - 1) / 2
    shear = layer.shear_modulus_mpa
    settings = {"pitch_mm": pitch, "depth_mm": 0.05, "friction": np.inf, "axis": (middle, middle)}
    pushed = press(gap, layer, shift_mm=(0.01, 0.0), **settings)
    assert pushed.tangential_force_n[0] == pytest.approx(8 * shear * edge * 0.01 / (2 - 0.5), rel=0.02)
    assert abs(pushed.tangential_force_n[1]) < 1e-4 * pushed.tangential_force_n[0]
    turned = press(gap, layer, twist_deg=1.0, **settings)
    y, x = (np.indices(gap.shape) - middle) * pitch
    torque = (x * turned.traction_mpa[1] - y * turned.traction_mpa[0]).sum() * pitch**2
    assert torque == pytest.approx(16 / 3 * shear * edge**3 * np.radians(1.0), rel=0.03)


@pytest.mark.slow
def test_surface_follows_from_the_pressure_by_a_sum_over_cells():
    """A second method: the layer's response summed in space, from a transform of the closed form by rings."""
    layer, pitch = ElasticLayer(0.4, 0.45, 1.0), 0.1
    found = press(ball(0.9, pitch, 1.5), layer, pitch_mm=pitch, depth_mm=0.2)
    q = np.linspace(0.0, 400.0, 400_001)
    smooth = layer.normal(q) - 2 * (1 - 0.45**2) / (0.4 * np.where(q > 0, q, np.inf))  # half space taken out
    smooth[0] = 0.0
    steps = 40
    origin = steps - found.pressure_mpa.shape[0] // 2
    surface = found.displacement((2 * steps + 1, 2 * steps + 1), (origin, origin))
    y, x = np.indices(found.pressure_mpa.shape) - found.pressure_mpa.shape[0] // 2
    loads, r = found.pressure_mpa[found.touched], np.hypot(x * pitch - 3.0, y * pitch)[found.touched]
    fine = np.linspace(2.0, 4.0, 81)
    table = [np.trapezoid(smooth * q * j0(q * s), q) / (2 * np.pi) for s in fine]
    expected = (loads * (np.interp(r, fine, table) + (1 - 0.45**2) / (np.pi * 0.4 * r))).sum() * pitch**2
    assert surface[steps, steps + 30] == pytest.approx(expected, rel=0.02, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("probe", ["cone", "plateau", "waves"])
def test_other_shapes_agree_with_contact_mechanics(probe):
    """ContactMechanics has the same closed form, but a solver and a discretisation of its own."""
    pitch, points, layer = 0.025, 480, ElasticLayer(0.4, 0.45, 1.0)
    side = points * pitch
    axis = (np.arange(points) - points // 2) * pitch
    x, y = np.meshgrid(axis, axis)
    near = np.maximum(np.abs(x), np.abs(y)) < 1.2
    shape = {
        "cone": np.hypot(x, y),
        "plateau": np.maximum(np.maximum(np.abs(x), np.abs(y)) - 0.8, 0.0) * 3,
        "waves": 0.2 * (1 - np.cos(2 * np.pi * (x + 0.5 * y) / 0.9)) + 0.1 * (x**2 + y**2),
    }[probe]
    used = slice(points // 2 - 48, points // 2 + 49)
    found = press(np.where(near, shape, np.inf)[used, used], layer, pitch_mm=pitch, depth_mm=0.25)
    substrate = PeriodicFFTElasticHalfSpace(
        (points, points), layer.modulus_mpa, (side, side), thickness=1.0, poisson=layer.poisson
    )
    topography = Topography(-np.where(near, shape, 10.0), (side, side), periodic=True)
    system = make_system(substrate=substrate, surface=topography)
    assert system.minimize_proxy(offset=0.25, pentol=1e-5).success
    assert found.force_n == pytest.approx(system.compute_normal_force(), rel=0.005)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "depth_mm, force_n: state one of them"),
        ({"depth_mm": 0.1, "force_n": 1.0}, "depth_mm, force_n: state one of them"),
        ({"depth_mm": 0.0}, "depth_mm: must be above 0 mm and finite, got 0"),
        ({"force_n": -1.0}, "force_n: must be above 0 N and finite, got -1"),
        ({"depth_mm": 2.0}, "depth_mm: must be below the thickness of the layer, 2 mm, got 2"),
        ({"depth_mm": 0.1, "pitch_mm": 0.0}, "pitch_mm: must be above 0 mm and finite, got 0"),
        ({"depth_mm": 0.1, "friction": -0.1}, "friction: must be at least 0, got -0.1"),
    ],
)
def test_bad_presses_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        press(ball(0.5, 0.1), ElasticLayer(0.4, 0.49, 2.0), **({"pitch_mm": 0.1} | arguments))


def test_what_does_not_settle_gives_no_surface(monkeypatch):
    monkeypatch.setattr("designlab.mechanics.contact.MOST_ITERATIONS", 3)
    with pytest.raises(NotConverged, match="did not settle in 3 iterations"):
        press(ball(1.5, 0.05), ElasticLayer(0.4, 0.49, 2.0), pitch_mm=0.05, depth_mm=0.5)


def test_a_press_repeats_to_the_last_digit():
    first, second = (
        press(ball(1.5, 0.05), ElasticLayer(0.4, 0.49, 2.0), pitch_mm=0.05, depth_mm=0.5) for _ in range(2)
    )
    assert (first.pressure_mpa == second.pressure_mpa).all()
