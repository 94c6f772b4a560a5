"""Presses of elastic gels: flat, dome and freeform, by depth and by force, and what is refused."""

import warnings

import numpy as np
import pytest

from designlab.mechanics.contact import OutOfReach
from designlab.sensor.contact import ContactModelAssumed, KernelContact, LayerContact
from designlab.sensor.design import DesignError, loads, preset, preset_text
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from designlab.validation.synthetic.elastic_contact import ElasticBase, press_ball
from geometries.elastomer import Elastomer
from geometries.probes import parse

FLAT = Elastomer(width_mm=26.0, thickness_mm=2.0)
GEL = LayerContact(gel="custom", modulus_mpa=0.4, poisson=0.49, skin_length_mm=0.0)
DOME = Elastomer(shape="dome", outline="round", width_mm=24.0, thickness_mm=2.0, radius_mm=15.0)
AREA = {"area_mm": (10.0, 8.0), "pitch_mm": 0.05}


def pressed(probe="sphere:4", gel=FLAT, contact=GEL, **press):
    return indent(gel, contact, Press(probe=parse(probe), **({"depth_mm": 0.5} | press)), **AREA)


def test_a_ball_on_a_flat_gel_is_the_exact_contact():
    surface = pressed(centre_mm=(0.6, -0.4))
    exact = press_ball(ElasticBase(0.4, 0.49, 2.0), ball_radius_mm=2.0, depth_mm=0.5)
    assert surface.mechanics.force_n == pytest.approx(exact.force_n, rel=0.01)
    assert surface.mechanics.contact_radius_mm == pytest.approx(exact.contact_radius_mm, rel=0.01)
    x, y = np.meshgrid(surface.x_mm, surface.y_mm)
    r = np.hypot(x - 0.6, y + 0.4)
    truth = exact.surface_mm(r.ravel()[::11])
    np.testing.assert_allclose(surface.height_mm.ravel()[::11], truth, atol=3e-3 * 0.5)
    assert surface.mechanics.bulge_um == pytest.approx(-1000 * truth.min(), rel=0.03)
    assert surface.contact.sum() * 0.05**2 == pytest.approx(np.pi * exact.contact_radius_mm**2, rel=0.02)


def test_the_skin_rounds_corners_and_keeps_the_volume():
    sharp, soft = (
        pressed("triangle:3", contact=GEL.model_copy(update={"skin_length_mm": length}))
        for length in (0.0, 0.1)
    )
    assert np.abs(soft.indentation_gradient[0]).max() < 0.7 * np.abs(sharp.indentation_gradient[0]).max()
    assert soft.height_mm.sum() == pytest.approx(sharp.height_mm.sum(), rel=1e-3)


def test_the_skin_of_an_incompressible_gel_is_squeezed_out_and_comes_back_with_the_distance():
    x, _ = pressed(depth_mm=0.5).sideways_mm
    row = x[x.shape[0] // 2]
    middle = len(row) // 2
    np.testing.assert_allclose(row, -row[::-1], atol=1e-9)
    assert 0.02 < row[middle:].max() < 0.2
    assert row[-1] < row[middle:].max() / 3


def test_a_dome_without_curvature_is_a_flat_gel():
    dome = Elastomer(shape="dome", outline="round", width_mm=26.0, thickness_mm=2.0, radius_mm=1e5)
    flat, curved = pressed(), pressed(gel=dome)
    np.testing.assert_allclose(curved.height_mm, flat.height_mm, atol=2e-4)
    assert curved.mechanics.force_n == pytest.approx(flat.mechanics.force_n, rel=2e-3)
    np.testing.assert_allclose(curved.sideways_mm[0], flat.sideways_mm[0], atol=2e-3)


def test_on_the_side_of_a_dome_the_probe_is_met_and_the_force_has_a_side():
    dome = Elastomer(shape="dome", outline="round", width_mm=24.0, thickness_mm=2.0, radius_mm=15.0)
    top, side = pressed(gel=dome, depth_mm=0.4), pressed(gel=dome, depth_mm=0.4, centre_mm=(2.5, 1.5))
    x, y = np.meshgrid(side.x_mm, side.y_mm)
    r2 = (x - 2.5) ** 2 + (y - 1.5) ** 2
    ball = 2.0 - np.sqrt(np.maximum(4.0 - r2, 0.0))
    over = ball + side.z_mm
    inner = side.contact & (r2 < 0.4)
    assert np.ptp(over[inner]) < 4e-3  # the membrane there is the ball, shifted along z
    assert 0.9 < side.mechanics.force_n / top.mechanics.force_n < 1.0
    assert side.mechanics.shear_force_n[0] < 0  # pushed towards the apex' side, down the slope outwards
    assert top.mechanics.shear_force_n == pytest.approx((0.0, 0.0), abs=2e-3 * top.mechanics.force_n)


def test_turned_on_a_dome_everything_turns_along():
    dome = Elastomer(shape="dome", outline="round", width_mm=24.0, thickness_mm=2.0, radius_mm=15.0)
    area = {"area_mm": (8.0, 8.0), "pitch_mm": 0.05}
    first, second = (
        indent(dome, GEL, Press(probe=parse("sphere:4"), depth_mm=0.4, centre_mm=at), **area)
        for at in ((2.0, 0.0), (0.0, 2.0))
    )
    np.testing.assert_allclose(np.rot90(first.height_mm), second.height_mm, atol=2e-3)
    assert first.mechanics.force_n == pytest.approx(second.mechanics.force_n, rel=3e-3)


def test_a_freeform_gel_is_as_thick_as_it_is_where_it_is_pressed():
    points = tuple((r, r**2 / 60.0) for r in np.linspace(0.0, 13.0, 14))
    gel = Elastomer(shape="freeform", outline="round", width_mm=24.0, thickness_mm=4.0, profile_mm=points)
    away = pressed(gel=gel, depth_mm=0.3, centre_mm=(3.0, 0.0))
    # There it is 3.85 mm thick and curved with a radius of 30 mm: as if a ball of
    # 1/R = 1/2 + 1/30 met it flat; its slope of 6 deg is not in that.
    there, middle = (
        pressed("sphere:3.75", gel=FLAT.model_copy(update={"thickness_mm": t}), depth_mm=0.3).mechanics
        for t in (3.85, 4.0)
    )
    assert away.mechanics.force_n == pytest.approx(there.force_n, rel=0.02)
    assert there.force_n > middle.force_n


def test_a_press_by_force_is_the_press_by_the_depth_it_finds():
    by_force = pressed(depth_mm=None, force_n=1.2)
    assert by_force.mechanics.force_n == pytest.approx(1.2, rel=1e-3)
    again = pressed(depth_mm=by_force.mechanics.depth_mm)
    np.testing.assert_allclose(again.height_mm, by_force.height_mm, atol=1e-3)


@pytest.mark.slow
def test_near_the_first_slip_of_a_point_every_force_is_met():
    """The force jumps by up to 0.1 % where points begin to slip; these lie beside or within such jumps."""
    curved = Elastomer(shape="dome", outline="round", width_mm=24.8, thickness_mm=2.0, radius_mm=12.5)
    pad = Elastomer(width_mm=26.0, thickness_mm=2.0)
    tried = [(curved, 0.49, 0.5, 1 + step * 1e-5, {}) for step in range(18, 70, 4)]
    tried += [
        (pad, 0.49, 1.0, 2.629520416645876, {}),
        (curved, 0.45, 0.5, 3.6762450446387533, {"centre_mm": (3.044632865575994, 0.0)}),
    ]
    for gel, poisson, friction, force_n, place in tried:
        grip = LayerContact(
            gel="custom", modulus_mpa=0.4, poisson=poisson, skin_length_mm=0.05, friction=friction
        )
        surface = pressed("sphere:4", gel, grip, depth_mm=None, force_n=force_n, **place)
        assert surface.mechanics.force_n == pytest.approx(force_n, rel=1e-3)


def test_a_sticking_probe_carries_the_skin_along():
    grip = GEL.model_copy(update={"friction": 10.0})
    surface = pressed(contact=grip, shear_mm=(0.1, 0.05), twist_deg=3.0)
    x, y = surface.sideways_mm
    middle = tuple(size // 2 for size in x.shape)
    assert (x[middle], y[middle]) == pytest.approx((0.1, 0.05), abs=2e-3)
    turned = x[middle[0] - 8, middle[1]] - x[middle[0] + 8, middle[1]]  # upper minus lower row
    assert turned == pytest.approx(-2 * 8 * 0.05 * np.sin(np.radians(3.0)), rel=0.1)
    force_x, force_y = surface.mechanics.shear_force_n
    assert force_x == pytest.approx(2 * force_y, rel=0.05)
    assert force_x > 0


def test_published_forces_of_a_pad_are_met():
    """GelSight Mini pad of 20.75 x 25.25 x 4 mm, ball of R 7.5 mm: feats-ai/feats, read in the repository."""
    pad = Elastomer(outline="rectangle", width_mm=25.25, length_mm=20.75, thickness_mm=4.0)
    depths, forces = (0.5, 1.0, 1.5, 2.0), np.array([1.6503, 5.9641, 13.5257, 23.2532])
    area = {"area_mm": (12.0, 12.0), "pitch_mm": 0.1}
    unit = [
        indent(pad, GEL, Press(probe=parse("sphere:15"), depth_mm=d), **area).mechanics.force_n
        for d in depths
    ]
    found = np.array(unit) / GEL.modulus_mpa
    modulus = (found[:2] * forces[:2]).sum() / (found[:2] ** 2).sum()
    assert 0.42 < modulus < 0.48
    error = modulus * found / forces - 1
    assert abs(error[2]) < 0.05
    assert abs(error[3]) < 0.07
    mini = preset("gelsight-mini-like")
    shipped = [
        indent(mini.elastomer, mini.contact, Press(probe=parse("sphere:15"), depth_mm=d), **area).mechanics
        for d in depths
    ]
    np.testing.assert_allclose([one.force_n for one in shipped], forces, rtol=0.1)


@pytest.mark.parametrize(
    ("press", "message"),
    [
        ({"depth_mm": 2.0}, "press.depth_mm: must be less than the gel is thick there, 2 mm along z"),
        (
            {"centre_mm": (30.0, 0.0)},
            "press: the sphere at .30, 0. mm touches the edge of the gel, 26 mm wide",
        ),
        pytest.param(
            {"probe": "sphere:90", "depth_mm": 1.9},
            "press: the sphere .* touches the edge of the gel",
            marks=pytest.mark.slow,
        ),
        ({"shear_mm": (0.1, 0.0)}, "contact.friction: must be above 0 where a press has shear_mm"),
        ({"gel": DOME, "centre_mm": (50.0, 0.0)}, "press.centre_mm: the sphere at .50, 0. mm lies beside"),
        ({"centre_mm": (9.0, 0.0)}, "press.centre_mm: the sphere at .9, 0. mm does not touch the membrane"),
    ],
)
def test_impossible_presses_are_refused(press, message):
    with pytest.raises(ValueError, match=message):
        pressed(**press)


def test_a_force_beyond_reach_and_a_slope_beyond_the_model_are_refused():
    with pytest.raises(
        OutOfReach, match=r"force_n: 900 N is not reached; the deepest press of 1\.9 mm takes"
    ):
        pressed(depth_mm=None, force_n=900.0)
    dome = Elastomer(shape="dome", outline="round", width_mm=26.0, thickness_mm=2.0, radius_mm=14.0)
    with pytest.raises(ValueError, match=r"press.centre_mm: the membrane is .* deg steep .* 30 deg or less"):
        pressed(gel=dome, depth_mm=0.3, centre_mm=(9.5, 0.0))


@pytest.mark.slow
def test_a_force_on_a_slope_with_friction_and_beside_an_edge_is_met():
    dome = Elastomer(shape="dome", outline="round", width_mm=22.0, thickness_mm=2.0, radius_mm=12.0)
    grip = GEL.model_copy(update={"friction": 0.5})
    press = {"depth_mm": None, "force_n": 1.0, "centre_mm": (4.0, 0.0)}
    assert pressed(gel=dome, contact=grip, **press).mechanics.force_n == pytest.approx(1.0, rel=1e-3)
    narrow = FLAT.model_copy(update={"width_mm": 12.0})
    assert pressed(gel=narrow, **press).mechanics.force_n == pytest.approx(1.0, rel=1e-3)


def test_no_press_goes_through_the_core_of_a_freeform_gel():
    points = tuple((r, 3.0 * (r / 12.0) ** 2) for r in np.linspace(0.0, 13.0, 14))
    gel = Elastomer(shape="freeform", outline="round", width_mm=24.0, thickness_mm=5.0, profile_mm=points)
    with pytest.raises(ValueError, match="or the probe meets the core"):
        pressed(gel=gel, depth_mm=4.1, centre_mm=(7.0, 0.0))
    deepest = pressed(gel=gel, depth_mm=4.0, centre_mm=(7.0, 0.0))
    assert deepest.z_mm.max() < 5.0


@pytest.mark.parametrize(("probe", "depth"), [("cone:4", 0.04), ("sphere:0.1", 0.02)])
def test_a_contact_of_a_few_cells_is_solved_and_flagged(probe, depth):
    surface = pressed(probe, depth_mm=depth)
    assert surface.mechanics.force_n > 0
    assert any("its force may err" in warning for warning in surface.warnings)


@pytest.mark.slow
def test_a_mesh_that_was_written_anew_is_pressed_anew(tmp_path):
    import os

    import trimesh

    file, forces = tmp_path / "probe.stl", []
    for number, mesh in enumerate(
        (trimesh.creation.icosphere(4, 2.0), trimesh.creation.box((4.0, 4.0, 4.0)))
    ):
        mesh.export(file)
        os.utime(file, ns=(number, number))
        forces.append(pressed(str(file), depth_mm=0.3).mechanics.force_n)
    assert forces[1] > 2 * forces[0]


def test_presses_beyond_the_model_are_flagged():
    assert any("deep in a gel of 2 mm" in warning for warning in pressed(depth_mm=1.2).warnings)
    assert any(
        "edge of the gel" in w
        for w in pressed(centre_mm=(4.5, 0.0), gel=FLAT.model_copy(update={"width_mm": 14.0})).warnings
    )
    assert pressed().warnings == ()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"force_n": 1.0}, "press.force_n: contact.model = 'kernel' knows no force"),
        ({"depth_mm": 0.5, "twist_deg": 3.0}, "press.shear_mm, press.twist_deg: contact.model = 'kernel'"),
    ],
)
def test_the_kernel_knows_neither_force_nor_shear(change, message):
    with pytest.raises(ValueError, match=message):
        indent(FLAT, KernelContact(), Press(probe=parse("sphere:4"), **change), **AREA)


TEXT = preset_text("default").split("[contact]")[0]
CAMERA = "[camera]" + preset_text("default").split("[camera]")[1]


@pytest.mark.parametrize(
    ("lines", "model"),
    [
        ("", "layer"),
        ("kernel_length_mm = 0.1", "kernel"),
        ("gel = 'solaris'", "layer"),
        ("model = 'kernel'", "kernel"),
    ],
)
def test_a_file_says_which_model_or_leaves_it_to_its_fields(lines, model):
    assert loads(f"{TEXT}\n[contact]\n{lines}\n{CAMERA}").contact.model == model
    assert loads(f"{TEXT}\n{CAMERA}").contact.model == "layer"


def test_a_file_that_means_the_kernel_without_saying_so_is_told_once():
    text = f"{TEXT}\n[contact]\nkernel_length_mm = 0.1\n{CAMERA}"
    with pytest.warns(
        ContactModelAssumed, match=r"mine.toml: field contact.model: not stated; fields of the"
    ):
        loads(text, source="mine.toml")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loads(text.replace("[contact]", "[contact]\nmodel = 'kernel'"))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("model = 'layer'\nkernel_length_mm = 0.1", "contact.*kernel_length_mm: belongs to model = 'kernel'"),
        (
            "kernel_length_mm = 0.1\nfriction = 0.4",
            "field contact.kernel_length_mm: belongs to model = 'kernel', contact.friction to 'layer'",
        ),
        ("model = 'kernel'\npoisson = 0.4", r"field contact.poisson: unknown field"),
        ("gel = 'custom'\npoisson = 0.4", "contact.*modulus_mpa: needed where gel is 'custom'"),
        ("poisson = 0.6", r"field contact.poisson: .*less than or equal to 0.5, got 0.6"),
        ("poisson = 0.0", r"field contact.poisson: .*greater than 0, got 0.0"),
        ("modulus_mpa = 0", r"field contact.modulus_mpa: .*greater than 0, got 0"),
        ("gel = 'jelly'", r"field contact.gel: .*unknown 'jelly'; known are"),
        ("model = 'spring'", r"field contact.*'spring'"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(lines, message):
    with pytest.raises(DesignError, match=message):
        loads(f"{TEXT}\n[contact]\n{lines}\n{CAMERA}")
