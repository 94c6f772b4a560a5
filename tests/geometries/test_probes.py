"""Probe profiles against their own meshes, and the text form."""

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.ndimage import grey_opening

from geometries import probes
from geometries.outline import star_polygon
from geometries.probes import LARGEST_EDGE, REACH, SIZES, STAR_INNER, Probe, parse, profile_mm
from geometries.raster import height_map

LIBRARY = [kind for kind in SIZES if kind != "mesh"]
ROUNDED = [
    "triangle:5:r0.2",
    "triangle:0.8:r0.2",
    "star:5:r0.2",
    "star:4:r0.5",
    "cone:5:r0.3",
    "prism:4:r2.5",
]
TOLERANCE_MM = 0.005


def grid(probe: Probe, samples: int = 241) -> tuple[np.ndarray, np.ndarray]:
    reach = 1.7 * probe.size_mm
    x = np.linspace(-reach, reach, samples)
    return np.meshgrid(x, x[::-1])


@pytest.mark.slow
@pytest.mark.parametrize("text", [*(f"{kind}:{size}" for kind in LIBRARY for size in (0.8, 5.0)), *ROUNDED])
def test_profile_is_the_upper_surface_of_the_mesh(text: str) -> None:
    """The mesh may depart by its tolerance along the normal: vertical distance times the normal's z."""
    probe = parse(text)
    x, y = grid(probe)
    profile = profile_mm(probe, x, y)
    meshed = height_map(probes.mesh(probe, tolerance_mm=TOLERANCE_MM), x, y)
    step = 1e-3 * probe.size_mm
    around = np.array(
        [profile_mm(probe, x + i * step, y + j * step) for i, j in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    )
    off_edge = np.isfinite(around).all(axis=0) | np.isinf(around).all(axis=0)
    on_probe = off_edge & np.isfinite(profile)
    assert on_probe.sum() > 500
    np.testing.assert_array_equal(np.isfinite(meshed)[off_edge], np.isfinite(profile)[off_edge])
    right, left, up, down = around[:, on_probe]
    slope = np.hypot(right - left, up - down) / (2 * step)
    distance = np.abs(profile[on_probe] - meshed[on_probe]) / np.sqrt(1 + slope**2)
    assert distance.max() <= TOLERANCE_MM


@pytest.mark.parametrize("kind", LIBRARY)
def test_nothing_of_a_probe_lies_beyond_its_reach_and_something_just_within(kind: str) -> None:
    angle = np.radians(np.arange(0.0, 360.0, 0.05))
    beyond, within = (
        profile_mm(
            parse(f"{kind}:3"),
            share * 3 * REACH[kind] * np.cos(angle),
            share * 3 * REACH[kind] * np.sin(angle),
        )
        for share in (1.0001, 0.999)
    )
    assert np.isinf(beyond).all()
    assert np.isfinite(within).any()


@pytest.mark.parametrize("kind", LIBRARY)
def test_foremost_point_touches_zero(kind: str) -> None:
    probe = parse(f"{kind}:4")
    profile = profile_mm(probe, *grid(probe))
    assert profile.max() == pytest.approx(0.0, abs=1e-15)
    middle = 1.0 if kind == "bars" else 0.0  # of what presses
    assert float(profile_mm(probe, 2.0 * middle, 0.0)) == 0.0


@pytest.mark.parametrize("kind", LIBRARY)
def test_profile_scales_with_size(kind: str) -> None:
    x, y = grid(parse(f"{kind}:2"))
    np.testing.assert_allclose(
        profile_mm(parse(f"{kind}:6"), 3 * x, 3 * y), 3 * profile_mm(parse(f"{kind}:2"), x, y), atol=1e-12
    )


def test_sizes_are_what_they_say() -> None:
    """A few heights by hand: a 3-4-5 triangle in the balls, 45 deg in cone and prism, crest and trough."""
    assert float(profile_mm(probes.sphere(diameter_mm=4), 1.2, 1.6)) == -2.0
    assert float(profile_mm(probes.sphere(diameter_mm=4), 1.2, 0.0)) == pytest.approx(1.6 - 2.0)
    assert float(profile_mm(probes.cylinder(diameter_mm=4), 4.0, 1.2)) == pytest.approx(1.6 - 2.0)
    assert float(profile_mm(probes.cylinder(diameter_mm=4), 4.01, 0.0)) == -np.inf
    assert float(profile_mm(probes.cone(base_mm=4), 0.9, 1.2)) == pytest.approx(-1.5)
    assert float(profile_mm(probes.cone(base_mm=4), 0.0, 2.01)) == -np.inf
    assert float(profile_mm(probes.prism(width_mm=4), -3.0, 1.5)) == -1.5
    assert float(profile_mm(probes.dots(pitch_mm=2), 2.0, -2.0)) == 0.0
    assert float(profile_mm(probes.dots(pitch_mm=2), 1.0, 1.0)) == pytest.approx(-0.6)
    assert float(profile_mm(probes.wave(wavelength_mm=4), 2.0, 5.0)) == pytest.approx(-1.0)
    assert float(profile_mm(probes.wave(wavelength_mm=4), 4.0, -5.0)) == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("probe", "radius_mm", "turn_deg"),
    [(probes.triangle(side_mm=4), 4 / np.sqrt(3), 120.0), (probes.star(diameter_mm=4), 2.0, 72.0)],
)
def test_polygonal_probes_have_a_corner_at_plus_y(probe: Probe, radius_mm: float, turn_deg: float) -> None:
    azimuth = np.deg2rad(90.0 + turn_deg * np.arange(5))
    near = 0.999 * radius_mm
    assert (profile_mm(probe, near * np.cos(azimuth), near * np.sin(azimuth)) == 0).all()
    between = azimuth + np.deg2rad(turn_deg / 2)
    assert np.isneginf(profile_mm(probe, near * np.cos(between), near * np.sin(between))).all()
    assert float(profile_mm(probe, 0.0, 1.001 * radius_mm)) == -np.inf


@pytest.mark.physics
@pytest.mark.parametrize("text", ["triangle:4:r0.5", "star:6:r0.5", "cone:2:r0.5", "prism:3:r1"])
def test_a_rounded_probe_is_what_a_ball_can_fill_of_the_sharp_one(text: str) -> None:
    """Against the morphological opening by the ball, which knows neither fillets nor distances to outlines.

    In a star's notches the roundings of both flanks run on until they meet: the ball reaches a bit higher.
    """
    probe = parse(text)
    radius, steps = probe.edge_radius_mm, 24
    pitch = radius / steps
    side = np.arange(-np.ceil(REACH[probe.kind] * probe.size_mm / pitch) - 3, 0) * pitch
    side = np.concatenate([side, [0.0], -side[::-1]])
    x, y = np.meshgrid(side, side[::-1])
    sharp = profile_mm(parse(f"{probe.kind}:{probe.size_mm}"), x, y)
    offset = np.arange(-steps, steps + 1) * pitch
    square = radius**2 - offset[:, None] ** 2 - offset**2
    ball, reached = np.sqrt(np.maximum(square, 0.0)), square >= -1e-9
    opened = grey_opening(np.where(np.isfinite(sharp), sharp, -100.0), footprint=reached, structure=ball)
    opened -= opened.max()  # the foremost point touches z = 0
    profile = profile_mm(probe, x, y)
    sure = profile > -radius / 2  # steeper flanks turn a step of the grid into height
    if probe.kind == "prism":
        sure &= np.abs(x) < probe.size_mm - radius  # its ends stay sharp
    if probe.kind == "star":
        notches = star_polygon(tips=5, outer_mm=probe.size_mm / 2, inner_mm=STAR_INNER * probe.size_mm / 2)[
            1::2
        ]
        away = np.hypot(x[..., None] - notches[:, 0], y[..., None] - notches[:, 1]).min(axis=-1)
        at_notch = sure & (away < 1.3 * radius)
        sure &= ~at_notch
        assert (opened - profile)[at_notch].max() < 0.1 * radius
    assert sure.sum() > 1000
    np.testing.assert_allclose(opened[sure], profile[sure], atol=1.2 * pitch)


def test_rounded_edges_by_hand() -> None:
    """A quarter circle beside the straight side, a ball at the corner, flanks tangent to the circle."""
    probe = probes.triangle(side_mm=6, edge_radius_mm=0.5)
    side, corner = 6 / np.sqrt(12), 6 / np.sqrt(3)
    falls = profile_mm(probe, 0.0, -side + np.array([0.5, 0.2, 0.1, 1e-9]))
    np.testing.assert_allclose(falls, [0.0, -0.1, -0.2, -0.5], atol=1e-4)
    assert float(profile_mm(probe, 0.0, -side - 1e-6)) == -np.inf
    # the ball in the corner has its middle a diameter away from it, and touches the outline half as far
    np.testing.assert_allclose(profile_mm(probe, 0.0, corner - np.array([1.0, 0.7, 0.6])), [0.0, -0.1, -0.2])
    assert float(profile_mm(probe, 0.0, corner - 0.49)) == -np.inf
    for rounded in (probes.cone(base_mm=4, edge_radius_mm=1.0), probes.prism(width_mm=4, edge_radius_mm=1.0)):
        flank = profile_mm(rounded, 0.0, [0.0, 0.6, np.sqrt(0.5), 1.5, 2.0])
        lost = np.sqrt(2) - 1
        np.testing.assert_allclose(
            flank, [0.0, -0.2, lost - np.sqrt(0.5), lost - 1.5, lost - 2.0], atol=1e-12
        )


def test_largest_edges_are_those_of_the_documentation() -> None:
    """The inscribed circle of a triangle; the circle that fills a star's tip; half the size over cos 45."""
    stated = {"triangle": 0.289, "star": 0.143, "cone": 0.707, "prism": 0.707}
    assert pytest.approx(stated, abs=5e-4) == LARGEST_EDGE


@pytest.mark.parametrize("kind", LARGEST_EDGE)
def test_a_fine_edge_tends_to_the_sharp_one(kind: str) -> None:
    x, y = grid(parse(f"{kind}:4"))
    sharp, fine = profile_mm(parse(f"{kind}:4"), x, y), profile_mm(parse(f"{kind}:4:r1e-6"), x, y)
    both = np.isfinite(sharp) & np.isfinite(fine)
    assert (np.isfinite(sharp) == both).mean() > 0.999
    np.testing.assert_allclose(fine[both], sharp[both], atol=1e-6)


def test_a_sharp_probe_is_kept_and_named_as_before() -> None:
    """Files, digests of pictures in the cache and names of parts hold what they held."""
    sharp = parse("triangle:5")
    assert sharp == parse("triangle:5:r0")
    assert sharp.text == "triangle:5"
    assert sharp.model_dump(mode="json") == {"kind": "triangle", "size_mm": 5.0, "file": None}
    rounded = parse("triangle:5:r0.2")
    assert rounded.model_dump()["edge_radius_mm"] == 0.2
    assert Probe.model_validate(rounded.model_dump()) == rounded != sharp


def test_scaling_a_probe_scales_its_edge() -> None:
    probe = parse("star:4:r0.3")
    assert probe.scaled(2.0) == parse("star:8:r0.6")
    x, y = grid(probe)
    np.testing.assert_allclose(profile_mm(probe.scaled(2.0), 2 * x, 2 * y), 2 * profile_mm(probe, x, y))


@pytest.mark.parametrize("kind", LIBRARY)
def test_an_edge_that_the_shape_does_not_have_or_cannot_carry_is_refused(kind: str) -> None:
    if kind not in LARGEST_EDGE:
        with pytest.raises(ValidationError, match="edge_radius_mm: only triangle, star, cone, prism have"):
            Probe(kind=kind, size_mm=4, edge_radius_mm=0.1)
        return
    largest = 4 * LARGEST_EDGE[kind]
    assert Probe(kind=kind, size_mm=4, edge_radius_mm=0.999 * largest).edge_radius_mm < largest
    with pytest.raises(
        ValidationError, match=rf"edge_radius_mm: must be below {largest:.4g} mm on a {kind} of"
    ):
        Probe(kind=kind, size_mm=4, edge_radius_mm=largest)


def test_profile_takes_any_shape_of_points() -> None:
    probe = probes.sphere(diameter_mm=4)
    assert profile_mm(probe, 0.0, 0.0).shape == ()
    assert profile_mm(probe, [0.0, 1.0], 0.0).shape == (2,)
    assert profile_mm(probe, np.zeros((3, 1)), np.zeros(4)).shape == (3, 4)


def test_a_shallow_sphere_keeps_its_digits() -> None:
    assert float(profile_mm(probes.sphere(diameter_mm=100), 1e-6, 0.0)) == pytest.approx(-1e-14, rel=1e-12)


@pytest.mark.parametrize("kind", LIBRARY)
def test_text_round_trip(kind: str) -> None:
    assert parse(f"{kind}:3.25") == Probe(kind=kind, size_mm=3.25)
    assert parse(parse(f"{kind}:3.25").text) == parse(f"{kind}:3.25")
    assert parse(kind).size_mm == 4.0


@pytest.mark.parametrize("text", ROUNDED)
def test_text_round_trip_of_a_rounded_probe(text: str) -> None:
    assert parse(text).text == text
    assert parse(parse(text).text) == parse(text)
    assert parse("triangle:5:r0.2") == probes.triangle(side_mm=5, edge_radius_mm=0.2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cube", "unknown 'cube' in 'cube'; known are sphere, triangle, star"),
        ("", "unknown ''"),
        ("mesh:4", "unknown 'mesh'"),
        ("sphere:", "the size must be a number in mm, is '' in 'sphere:'"),
        ("sphere:4mm", "is '4mm' in 'sphere:4mm'"),
        ("sphere:4:5", "comes the edge radius in mm, such as r0.2, is '5' in 'sphere:4:5'"),
        ("sphere:4:r0.1", "'sphere:4:r0.1': edge_radius_mm: only triangle, star, cone, prism have"),
        ("triangle:r0.2", "the size must be a number in mm, is 'r0.2'"),
        ("triangle:5:r", "the edge radius must be a number in mm, is '' in 'triangle:5:r'"),
        ("triangle:5:r-1", "edge_radius_mm in 'triangle:5:r-1': Input should be greater than or equal to 0"),
        (
            "triangle:5:r2",
            "'triangle:5:r2': edge_radius_mm: must be below 1.443 mm on a triangle of 5 mm, is 2 mm",
        ),
        ("part.stl:5:r0.2", "a mesh has the edges of its file, leave out the radius in 'part.stl:5:r0.2'"),
        ("sphere:nan", "size_mm in 'sphere:nan'"),
        ("star:-1", "size_mm in 'star:-1': Input should be greater than 0.05"),
        ("star:101", "size_mm in 'star:101': Input should be less than or equal to 100"),
        ("missing.stl", "missing.stl: cannot be read"),
        ("part.stl:big", "the size must be a number in mm, is 'big' in 'part.stl:big'"),
    ],
)
def test_bad_text_is_refused_by_name(text: str, message: str) -> None:
    with pytest.raises(ValueError) as refusal:  # noqa: PT011 (the text is compared below, brackets and all)
        parse(text)
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)
