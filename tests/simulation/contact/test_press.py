"""Pressing a probe into the membrane, against geometry."""

import numpy as np
import pytest
from scipy.ndimage import center_of_mass

from designlab.core.store import digest
from designlab.sensor.contact import KernelContact, LayerContact
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from geometries.elastomer import Elastomer
from geometries.probes import SIZES, from_file, mesh, parse

FLAT = Elastomer(shape="flat", outline="rectangle", width_mm=30, length_mm=30, thickness_mm=3)
SHARP = KernelContact(kernel_length_mm=0.0)


def press(text, depth_mm, **where):
    return Press(probe=parse(text), depth_mm=depth_mm, **where)


def indented(one, *, elastomer=FLAT, contact=SHARP, area_mm=(10.0, 8.0), pitch_mm=0.05):
    return indent(elastomer, contact, one, area_mm=area_mm, pitch_mm=pitch_mm)


def kernel(r_mm, contact):
    """Kernel as published (arXiv 2012.13184), radius in units of its length, cut at 6."""
    r = r_mm / contact.kernel_length_mm
    return np.where(r <= 6, (contact.kernel_m + 1) / (contact.kernel_m + np.exp(np.minimum(r, 6))), 0.0)


def rise_mm(x, z, low=0.1, high=0.9):
    """Distance over which an edge rises from 10 to 90 % of its height."""
    z = (z - z.min()) / (z.max() - z.min())
    return np.interp(high, z, x) - np.interp(low, z, x)


def step(contact, pitch_mm):
    """Profile across the straight side of a wide flat punch, which lies on the x axis; upwards to -y."""
    punch = press("triangle:60", 0.4, yaw_deg=180.0, centre_mm=(0.0, -60 / np.sqrt(12)))
    surface = indented(punch, contact=contact, area_mm=(2.0, 4.0), pitch_mm=pitch_mm)
    return -surface.y_mm, surface.height_mm[:, surface.height_mm.shape[1] // 2]


def test_a_ball_leaves_a_cap_of_its_own_radius():
    diameter, depth = 4.0, 0.6
    surface = indented(press("sphere:4", depth))
    x, y = np.meshgrid(surface.x_mm, surface.y_mm)
    cap = np.maximum(np.sqrt(np.maximum((diameter / 2) ** 2 - x**2 - y**2, 0)) - diameter / 2 + depth, 0)
    # heights are averages over a cell: off the cap by the pitch squared over its radius at most
    inside = np.hypot(x, y) < 1.3
    np.testing.assert_allclose(surface.height_mm[inside], cap[inside], atol=0.05**2)
    assert surface.height_mm.max() == pytest.approx(depth, abs=1e-3)


@pytest.mark.parametrize(("diameter", "depth"), [(4.0, 0.6), (6.0, 0.3), (2.0, 0.9)])
def test_contact_of_a_ball_is_a_disc_of_the_chord_radius(diameter, depth):
    surface = indented(press(f"sphere:{diameter:g}", depth), pitch_mm=0.02)
    radius = np.sqrt(surface.contact.sum() * surface.pitch_mm**2 / np.pi)
    # a cell counts when its part of it touches, which adds up to half a pitch
    assert radius == pytest.approx(np.sqrt(diameter * depth - depth**2), abs=0.02)


@pytest.mark.parametrize("pitch_mm", [0.05, 0.08])
def test_smoothing_conserves_the_displaced_volume(pitch_mm):
    one = press("sphere:4", 0.6, centre_mm=(0.7, -0.4))
    volumes = [
        indented(one, contact=contact, pitch_mm=pitch_mm).height_mm.sum() * pitch_mm**2
        for contact in (SHARP, KernelContact(kernel_length_mm=0.1))
    ]
    assert volumes[1] == pytest.approx(volumes[0], rel=1e-6)
    # volume of a spherical cap
    assert volumes[0] == pytest.approx(np.pi * 0.6**2 * (3 * 2.0 - 0.6) / 3, rel=2e-3)


@pytest.mark.parametrize("length_mm", [0.05, 0.1])
def test_an_edge_rises_as_the_published_kernel_says(length_mm):
    contact = KernelContact(kernel_length_mm=length_mm, kernel_m=200)
    # the edge response of a round kernel is the integral of its line spread
    t = np.linspace(-6.2, 6.2, 1241) * length_mm
    line = kernel(np.hypot(t[:, None], t[None]), contact).sum(axis=1)
    expected = rise_mm(t, np.cumsum(line))
    assert rise_mm(*step(contact, 0.02)) == pytest.approx(expected, abs=0.005)


def test_smoothing_does_not_depend_on_the_grid():
    contact = KernelContact(kernel_length_mm=0.1)
    (fine_y, fine_z), (coarse_y, coarse_z) = step(contact, 0.02), step(contact, 0.1)
    np.testing.assert_allclose(np.interp(coarse_y, fine_y, fine_z), coarse_z, atol=0.02 * 0.4)


def test_heights_do_not_depend_on_the_grid():
    one = press("star:5", 0.5, yaw_deg=17.0)
    contact = KernelContact(kernel_length_mm=0.08)
    fine, coarse = (indented(one, contact=contact, pitch_mm=pitch) for pitch in (0.025, 0.075))
    x, y = np.meshgrid(coarse.x_mm[5:-5], coarse.y_mm[5:-5])
    difference = fine.sample(fine.height_mm, x, y) - coarse.height_mm[5:-5, 5:-5]
    assert np.sqrt(np.mean(difference**2)) < 0.01 * 0.5


def test_a_kernel_of_no_length_smooths_nothing():
    y, z = step(SHARP, 0.02)
    # an edge fills one cell in part; 10 to 90 % of the way over its two neighbours is 1.6 pitches at most
    assert rise_mm(y, z) <= 1.6 * 0.02 + 1e-9


@pytest.mark.parametrize("text", ["sphere:4", "triangle:5", "star:6", "cone:4", "dots:1.5", "wave:2"])
def test_the_depth_is_the_largest_penetration(text):
    surface = indented(press(text, 0.5, yaw_deg=11.0), pitch_mm=0.02)
    assert surface.height_mm.max() == pytest.approx(0.5, abs=0.012)
    assert surface.height_mm.min() == 0.0


def test_the_centre_is_right_and_up_in_the_image():
    surface = indented(press("sphere:3", 0.4, centre_mm=(2.0, 1.5)))
    row, column = center_of_mass(surface.height_mm)
    rows, columns = surface.height_mm.shape
    assert column > columns / 2
    assert row < rows / 2
    assert np.interp(column, np.arange(columns), surface.x_mm) == pytest.approx(2.0, abs=1e-3)
    assert np.interp(row, np.arange(rows), surface.y_mm) == pytest.approx(1.5, abs=1e-3)


@pytest.mark.parametrize("yaw_deg", [0.0, 40.0, -75.0])
def test_yaw_turns_counter_clockwise_from_a_vertex_at_plus_y(yaw_deg):
    side = 4.0
    surface = indented(press("triangle:4", 0.4, yaw_deg=yaw_deg))
    for corner in range(3):
        angle = np.radians(90.0 + yaw_deg + 120.0 * corner)
        for share, touched in ((0.9, True), (1.1, False)):
            radius = share * side / np.sqrt(3)
            at = surface.sample(
                surface.contact.astype(float),
                np.array([radius * np.cos(angle)]),
                np.array([radius * np.sin(angle)]),
            )
            assert (at[0] > 0.5) == touched


def test_slopes_are_those_of_a_ball():
    surface = indented(press("sphere:6", 0.6), pitch_mm=0.04)
    x, y = np.meshgrid(surface.x_mm, surface.y_mm)
    inside = np.hypot(x, y) < 1.4
    down = np.sqrt(9.0 - x**2 - y**2, where=np.hypot(x, y) < 3, out=np.ones_like(x))
    p, q = surface.gradient
    np.testing.assert_allclose(p[inside], -(x / down)[inside], atol=2e-3)
    np.testing.assert_allclose(q[inside], -(y / down)[inside], atol=2e-3)
    # on a ball the normal points away from its centre, 3 mm below the tip
    towards = np.stack([x, y, down], axis=-1) / 3.0
    np.testing.assert_allclose(surface.normals[inside], towards[inside], atol=2e-3)


def test_an_untouched_gel_is_its_base():
    dome = Elastomer(shape="dome", outline="round", width_mm=24, thickness_mm=2, radius_mm=30)
    surface = indented(None, elastomer=dome)
    x, y = np.meshgrid(surface.x_mm, surface.y_mm)
    np.testing.assert_allclose(surface.z_mm, 30 - np.sqrt(900 - x**2 - y**2), atol=1e-12)
    np.testing.assert_allclose(surface.gradient[0], x / np.sqrt(900 - x**2 - y**2), atol=1e-12)
    assert not surface.contact.any()


def test_a_dome_of_huge_radius_is_flat():
    one = press("star:5", 0.5, centre_mm=(1.0, 0.5), yaw_deg=20.0)
    contact = KernelContact(kernel_length_mm=0.05)
    flat = indented(one, contact=contact)
    dome = indented(
        one,
        contact=contact,
        elastomer=Elastomer(shape="dome", outline="round", width_mm=30, thickness_mm=3, radius_mm=1e7),
    )
    np.testing.assert_allclose(dome.height_mm, flat.height_mm, atol=1e-5)
    np.testing.assert_allclose(dome.z_mm, flat.z_mm, atol=1e-5)


def test_a_ball_meets_a_dome_in_the_lens_of_two_spheres():
    # Two spheres of radii R and r overlap by d, their centres D apart: the cosine rule gives the rim.
    R, r, d = 20.0, 3.0, 0.5
    D = R + r - d
    dome = Elastomer(shape="dome", outline="round", width_mm=30, thickness_mm=3, radius_mm=R)
    surface = indented(press("sphere:6", d), elastomer=dome, pitch_mm=0.02)
    along = (D**2 + R**2 - r**2) / (2 * D)
    expected = np.sqrt(R**2 - along**2)
    found = np.sqrt(surface.contact.sum() * surface.pitch_mm**2 / np.pi)
    assert found == pytest.approx(expected, abs=0.02)
    assert surface.height_mm.max() == pytest.approx(d, abs=1e-3)


@pytest.mark.parametrize("text", ["sphere:3", "triangle:4", "cylinder:2", "dots:1"])
def test_nothing_is_raised_beyond_the_reach_of_a_probe(text, monkeypatch):
    one = press(text, 0.4, centre_mm=(1.2, -0.7), yaw_deg=33.0)
    near = indented(one)
    monkeypatch.setattr("designlab.simulation.contact.approach.REACH", dict.fromkeys(SIZES, 20.0))
    np.testing.assert_array_equal(near.height_mm, indented(one).height_mm)


@pytest.mark.slow
def test_a_mesh_presses_like_the_shape_it_was_made_of(tmp_path):
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=5, radius=2.0)
    file = tmp_path / "ball.stl"
    ball.export(file)
    of_mesh = indented(Press(probe=from_file(file), depth_mm=0.5), pitch_mm=0.1, area_mm=(6, 6))
    of_ball = indented(press("sphere:4", 0.5), pitch_mm=0.1, area_mm=(6, 6))
    np.testing.assert_allclose(of_mesh.height_mm, of_ball.height_mm, atol=0.005)


def test_sampling_interpolates_linearly_and_holds_the_edge():
    surface = indented(None, area_mm=(2, 2), pitch_mm=0.1)
    x, y = np.meshgrid(surface.x_mm, surface.y_mm)
    plane = 2 * x - 3 * y
    at_x, at_y = np.array([0.33, -0.71]), np.array([-0.56, 0.12])
    np.testing.assert_allclose(surface.sample(plane, at_x, at_y), 2 * at_x - 3 * at_y, atol=1e-12)
    assert surface.sample(plane, np.array([5.0]), np.array([0.0]))[0] == pytest.approx(2 * surface.x_mm[-1])


@pytest.mark.parametrize("radius_mm", [None, 40.0])
def test_a_press_cut_by_the_border_is_as_deep_as_a_whole_one(radius_mm):
    if radius_mm is None:
        gel = FLAT
    else:
        gel = Elastomer(shape="dome", outline="round", width_mm=30, thickness_mm=3, radius_mm=radius_mm)
    one = press("sphere:6", 0.6, centre_mm=(5.5, 1.0))
    cut, whole = (indented(one, elastomer=gel, area_mm=(size, 8.0)) for size in (10.0, 20.0))
    x, y = np.meshgrid(cut.x_mm, cut.y_mm)
    np.testing.assert_allclose(cut.height_mm, whole.sample(whole.height_mm, x, y), atol=1e-9)


def test_a_press_beside_the_area_names_field_and_place():
    with pytest.raises(ValueError, match=r"press\.centre_mm: the sphere at \(12, 0\) mm does not touch"):
        indented(press("sphere:2", 0.5, centre_mm=(12.0, 0.0)))


@pytest.mark.parametrize("away_mm", [0.1, 0.6, 1.2])
def test_a_tail_falls_by_e_over_its_length_around_any_outline(away_mm):
    tail = KernelContact(kernel_length_mm=0.0, tail_share=0.25, tail_mm=0.5)
    surface = indented(press("triangle:5", 0.4, yaw_deg=90.0), contact=tail, pitch_mm=0.02)
    corner, side = 5 / np.sqrt(3), 5 / np.sqrt(12)
    # Turned by 90 deg a corner points to -x and a side lies opposite, at +x.
    for x in (-corner - away_mm, side + away_mm):
        found = surface.sample(surface.height_mm, np.array([x]), np.array([0.0]))[0]
        assert found == pytest.approx(0.25 * 0.4 * np.exp(-away_mm / 0.5), rel=0.05)
    inside = surface.contact & (surface.height_mm > 0.399)
    assert inside.sum() * 0.02**2 == pytest.approx(np.sqrt(3) / 4 * 25, rel=0.02)


def test_a_tail_changes_nothing_inside_and_is_smoothed_by_the_kernel():
    sharp, tail = (KernelContact(kernel_length_mm=0.0, tail_share=share) for share in (0.0, 0.3))
    plain, raised = (indented(press("sphere:4", 0.6), contact=c) for c in (sharp, tail))
    high = plain.height_mm > 0.3 * 0.6 + 1e-3
    np.testing.assert_array_equal(raised.height_mm[high], plain.height_mm[high])
    assert (raised.height_mm >= plain.height_mm).all()
    np.testing.assert_array_equal(raised.contact, plain.contact)
    soft = indented(press("sphere:4", 0.6), contact=tail.model_copy(update={"kernel_length_mm": 0.08}))
    # The kernel keeps volume; over the edge of the area a little is lost.
    assert soft.height_mm.sum() == pytest.approx(raised.height_mm.sum(), rel=2e-3)


def test_a_sharp_probe_has_the_digest_it_had_before_edges_could_be_rounded():
    """Recorded at commit 0989b7f; pictures in a cache are found by it."""
    known = "35bb3896df57f1372b4e199628a111f28fd0f8f96393d549f30b64147bea443b"
    assert digest(parse("triangle:5")) == known != digest(parse("triangle:5:r0.2"))


@pytest.mark.slow
def test_a_probe_with_fine_edges_from_a_file_presses_like_the_library_one(tmp_path):
    """Written as STL, whose box is centred anew, read back, pressed."""
    probe, path = parse("triangle:5:r0.3"), tmp_path / "fine.stl"
    body = mesh(probe)
    body.export(path)
    x, y = body.bounds.mean(axis=0)[:2]
    yaw = np.radians(7.0)  # no side lies along the grid, whose points would fall on the upright wall
    middle = np.cos(yaw) * x - np.sin(yaw) * y, np.sin(yaw) * x + np.cos(yaw) * y
    own = indented(Press(probe=probe, depth_mm=0.5, yaw_deg=7.0))
    read = indented(Press(probe=parse(str(path)), depth_mm=0.5, centre_mm=middle, yaw_deg=7.0))
    np.testing.assert_allclose(read.height_mm, own.height_mm, atol=0.005)
    assert (read.contact == own.contact).mean() > 0.999
    sharp = indented(press("triangle:5", 0.5, yaw_deg=7.0))
    assert np.abs(own.height_mm - sharp.height_mm).max() > 0.25  # the edge is seen


DOME = Elastomer(shape="dome", outline="round", width_mm=24, thickness_mm=2, radius_mm=30)


@pytest.mark.faults
@pytest.mark.parametrize(
    ("gel", "probe", "depth_mm", "refused"),
    [
        (FLAT, "sphere:8", 2.9, False),
        (FLAT, "sphere:8", 3.0, True),
        (FLAT, "triangle:5", 3.5, True),
        (DOME, "sphere:6", 1.9, False),
        (DOME, "cone:8", 2.5, True),
    ],
)
def test_a_press_deeper_than_the_gel_is_refused(gel, probe, depth_mm, refused):
    if not refused:
        assert indented(press(probe, depth_mm), elastomer=gel, pitch_mm=0.1).contact.any()
        return
    with pytest.raises(
        ValueError, match=r"press\.depth_mm: must be less than the gel is thick there, [23] mm"
    ):
        indented(press(probe, depth_mm), elastomer=gel, pitch_mm=0.1)


@pytest.mark.parametrize(("depth_mm", "warned"), [(0.5, False), (1.4, False), (1.6, True), (2.9, True)])
def test_a_press_beyond_half_of_the_gel_warns(depth_mm, warned):
    surface = indented(press("sphere:8", depth_mm), pitch_mm=0.1)
    assert any("beyond half of the thickness" in text for text in surface.warnings) == warned


def plate_with_ball(path, *, plate_mm, turn=None):
    """A plate of 20 mm with half a ball of 8 mm on it."""
    import trimesh

    plate = trimesh.creation.box((plate_mm, plate_mm, 20.0))
    plate.apply_translation((0, 0, -10))
    body = trimesh.util.concatenate([plate, trimesh.creation.icosphere(subdivisions=5, radius=4)])
    if turn is not None:
        body.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, turn))
    body.export(path)
    return path


@pytest.mark.parametrize("plate_mm", [20.0, 60.0, 150.0, 900.0])
@pytest.mark.parametrize("gel", [FLAT, DOME], ids=["flat", "dome"])
@pytest.mark.parametrize("elastic", [False, True])
def test_of_a_large_plate_what_touches_counts(plate_mm, gel, elastic, tmp_path):
    file = plate_with_ball(tmp_path / "knob.ply", plate_mm=plate_mm)
    contact = LayerContact() if elastic else SHARP
    probes = [from_file(file, unit="mm"), parse("sphere:8")]
    knob, ball = (
        indented(Press(probe=p, depth_mm=0.5), elastomer=gel, contact=contact, pitch_mm=0.1) for p in probes
    )
    np.testing.assert_allclose(knob.height_mm, ball.height_mm, atol=0.01)


@pytest.mark.faults
@pytest.mark.parametrize(("side", "scale"), [("+z", 0.02), ("-z", 0.015), ("+x", 0.001)])
def test_a_mesh_thinner_than_the_press_is_refused(side, scale, tmp_path):
    import trimesh

    body = trimesh.creation.box((60, 60, 20) if side[1] == "z" else (20, 60, 60))
    body.apply_scale(scale)
    body.export(tmp_path / "thin.stl")
    probe = parse(f"{tmp_path / 'thin.stl'}:mm:{side}")
    with pytest.raises(
        ValueError, match=r"thin\.stl is .* mm thick, less than the press is deep \(0\.5 mm\)"
    ):
        indented(Press(probe=probe, depth_mm=0.5))
