"""Probe profiles against their own meshes, and the text form."""

import numpy as np
import pytest

from geometries import probes
from geometries.mesh import height_map
from geometries.probes import REACH, SIZES, Probe, parse, profile_mm

LIBRARY = [kind for kind in SIZES if kind != "mesh"]
TOLERANCE_MM = 0.005


def grid(probe: Probe, samples: int = 241) -> tuple[np.ndarray, np.ndarray]:
    reach = 1.7 * probe.size_mm
    x = np.linspace(-reach, reach, samples)
    return np.meshgrid(x, x[::-1])


@pytest.mark.slow
@pytest.mark.parametrize("kind", LIBRARY)
@pytest.mark.parametrize("size_mm", [0.8, 5.0])
def test_profile_is_the_upper_surface_of_the_mesh(kind: str, size_mm: float) -> None:
    """The mesh may depart by its tolerance along the normal: vertical distance times the normal's z."""
    probe = parse(f"{kind}:{size_mm}")
    x, y = grid(probe)
    profile = profile_mm(probe, x, y)
    meshed = height_map(probes.mesh(probe, tolerance_mm=TOLERANCE_MM), x, y)
    step = 1e-3 * size_mm
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
    assert float(profile_mm(probe, 0.0, 0.0)) == 0.0


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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cube", "unknown 'cube' in 'cube'; known are sphere, triangle, star"),
        ("", "unknown ''"),
        ("mesh:4", "unknown 'mesh'"),
        ("sphere:", "the size must be a number in mm, is '' in 'sphere:'"),
        ("sphere:4mm", "is '4mm' in 'sphere:4mm'"),
        ("sphere:4:5", "is '4:5' in 'sphere:4:5'"),
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
