"""Every CAD solid against its closed-form volume and bounding box, and its mesh against the solid."""

from collections.abc import Callable
from math import cos, pi, radians, sin, sqrt, tan
from typing import Any, NamedTuple

import numpy as np
import pytest

from geometries import elastomer, gelcore, housing, leds, mesh, probes
from geometries.elastomer import Elastomer
from geometries.gelcore import Gelcore
from geometries.housing import Housing
from geometries.leds import LedArray, LedGroup
from geometries.probes import Probe


class Case(NamedTuple):
    """A solid's builder, its specification, its volume (mm3) and its bounding box (mm)."""

    build: Callable[[Any], Any]
    spec: Any
    volume_mm3: float
    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]
    bodies: int = 1


def frustum(bottom: float, top: float, height: float) -> float:
    return height / 3 * (bottom + top + sqrt(bottom * top))


def ball_under_plane(radius: float, rim: float) -> float:
    """Volume under a sphere's centre plane and above the sphere, within a cylinder of radius rim."""
    return 2 / 3 * pi * (radius**3 - max(radius**2 - rim**2, 0.0) ** 1.5)


def cap(radius: float, height: float) -> float:
    return pi * height**2 * (3 * radius - height) / 3


HEXAGON = sqrt(3) / 2  # area of a hexagon over the square of its width across flats
LOSS_10, LOSS_5 = 2 * 8.0 * tan(radians(10)), 2 * 8.0 * tan(radians(5))  # width lost to the draft over 8 mm
SAG_20 = 20 - sqrt(20**2 - 12**2)
TRIANGLE_R, STAR_R = 4 / sqrt(3), 2.0

PARTS = {
    "slab core": Case(gelcore.solid, Gelcore(shape="slab"), 24 * 20 * 8, (-12, -10, 0), (12, 10, 8)),
    "drafted slab core": Case(
        gelcore.solid,
        Gelcore(shape="slab", draft_deg=5.0),
        # Simpson's rule is exact for the quadratic cross-section
        8 / 6 * (24 * 20 + 4 * (24 - LOSS_5 / 2) * (20 - LOSS_5 / 2) + (24 - LOSS_5) * (20 - LOSS_5)),
        (-12, -10, 0),
        (12, 10, 8),
    ),
    "hexagonal core": Case(
        gelcore.solid, Gelcore(), HEXAGON * 24**2 * 8, (-24 / sqrt(3), -12, 0), (24 / sqrt(3), 12, 8)
    ),
    "drafted hexagonal core": Case(
        gelcore.solid,
        Gelcore(draft_deg=10.0),
        frustum(HEXAGON * 24**2, HEXAGON * (24 - LOSS_10) ** 2, 8),
        (-24 / sqrt(3), -12, 0),
        (24 / sqrt(3), 12, 8),
    ),
    "dome core": Case(
        gelcore.solid,
        Gelcore(shape="dome", radius_mm=20.0),
        cap(20, SAG_20) + pi * 12**2 * (8 - SAG_20),
        (-12, -12, 0),
        (12, 12, 8),
    ),
    "hemispherical core": Case(
        gelcore.solid,
        Gelcore(shape="dome", radius_mm=12.0, height_mm=15.0),
        cap(12, 12) + pi * 12**2 * 3,
        (-12, -12, 0),
        (12, 12, 15),
    ),
    "rectangular gel": Case(
        elastomer.solid, Elastomer(outline="rectangle"), 24 * 20 * 2, (-12, -10, 0), (12, 10, 2)
    ),
    "hexagonal gel": Case(
        elastomer.solid, Elastomer(), HEXAGON * 24**2 * 2, (-24 / sqrt(3), -12, 0), (24 / sqrt(3), 12, 2)
    ),
    "round gel": Case(
        elastomer.solid, Elastomer(outline="round"), pi * 12**2 * 2, (-12, -12, 0), (12, 12, 2)
    ),
    "housing": Case(
        housing.solid,
        Housing(inner_radius_mm=17, wall_mm=2, bottom_mm=1, top_mm=30, plate_mm=3, camera_hole_mm=8),
        pi * (19**2 - 17**2) * 29 + pi * (19**2 - 4**2) * 3,
        (-19, -19, 1),
        (19, 19, 33),
    ),
    "leds": Case(
        leds.solid,
        LedArray(groups=(LedGroup(name="a", azimuth_deg=(0.0, 180.0), count=2),), radius_mm=14, height_mm=4),
        4 * 3.5 * 2.8 * 1.0,
        (-15, -2 - 3.5 / 2, 4 - 1.4),
        (15, 2 + 3.5 / 2, 4 + 1.4),
        bodies=4,
    ),
    "leaning led": Case(
        leds.solid,
        LedArray(groups=(LedGroup(name="a", azimuth_deg=(0.0,)),), radius_mm=14, height_mm=4, tilt_deg=30.0),
        3.5 * 2.8 * 1.0,
        # a face that leans by 30 deg to the membrane has its lower edge further out than its upper one
        (14 - 1.4 * sin(radians(30)), -1.75, 4 - 1.4 * cos(radians(30))),
        (
            14 + 1.4 * sin(radians(30)) + cos(radians(30)),
            1.75,
            4 + 1.4 * cos(radians(30)) + sin(radians(30)),
        ),
    ),
}

for radius, width in ((20.0, 24.0), (13.0, 24.0), (12.0, 24.0), (12.0, 23.0), (1e3, 24.0), (1e7, 24.0)):
    sag = radius - sqrt(radius**2 - width**2 / 4)
    inner_sag = radius - sqrt(max((radius - 2) ** 2 - width**2 / 4, 0.0))
    # far from the centre the difference of two large spheres has no digits left, but the shell is a plate
    shell = ball_under_plane(radius, width / 2) - ball_under_plane(radius - 2, width / 2)
    PARTS[f"dome gel R {radius:g}, width {width:g}"] = Case(
        elastomer.solid,
        Elastomer(shape="dome", outline="round", radius_mm=radius, width_mm=width),
        shell if radius < 1e6 else pi * width**2 / 4 * 2,
        (-width / 2, -width / 2, 0),
        (width / 2, width / 2, max(sag, inner_sag)),
    )

PROBES = {  # all of size 4 mm, on a shank of 5 mm
    "sphere": (2 / 3 * pi * 8 + pi * 4 * 5, (-2, -2, -7), (2, 2, 0)),
    "triangle": (sqrt(3) / 4 * 16 * 5, (-2, -TRIANGLE_R / 2, -5), (2, TRIANGLE_R, 0)),
    "star": (
        5 * STAR_R * 0.45 * STAR_R * sin(pi / 5) * 5,
        (-STAR_R * cos(radians(18)), -STAR_R * cos(radians(36)), -5),
        (STAR_R * cos(radians(18)), STAR_R, 0),
    ),
    "cylinder": ((pi * 4 / 2 + 4 * 5) * 8, (-4, -2, -7), (4, 2, 0)),
    "cone": (pi * 4 * (2 / 3 + 5), (-2, -2, -7), (2, 2, 0)),
    "prism": ((4 * 2 / 2 + 4 * 5) * 8, (-4, -2, -7), (4, 2, 0)),
    "dots": (9 * 2 / 3 * pi * 1.2**3 + 12**2 * 5, (-6, -6, -6.2), (6, 6, 0)),
    "wave": (12**2 * (7 - 0.5), (-6, -6, -7), (6, 6, 0)),
    "bars": (10 * (2 * 2 * 16 + 6 * 5), (-3, -5, -21), (3, 5, 0)),
}
for name, (volume, low, high) in PROBES.items():
    PARTS[f"probe {name}"] = Case(probes.solid, probes.parse(f"{name}:4"), volume, low, high)


@pytest.fixture(scope="module", params=list(PARTS))
def built(request: pytest.FixtureRequest) -> tuple[Case, Any]:
    """A part and its solid."""
    case = PARTS[request.param]
    return case, case.build(case.spec)


def test_solid_is_valid_closed_and_of_the_right_size(built: tuple[Case, Any]) -> None:
    case, workplane = built
    shape = workplane.val()
    solids = shape.Solids()
    assert shape.isValid()
    assert len(workplane.vals()) == 1
    assert len(solids) == case.bodies
    assert all(shell.Closed() for solid in solids for shell in solid.Shells())
    assert shape.Volume() == pytest.approx(case.volume_mm3, rel=1e-6)
    box = shape.BoundingBox()
    assert (box.xmin, box.ymin, box.zmin) == pytest.approx(case.low_mm, abs=2e-6)
    assert (box.xmax, box.ymax, box.zmax) == pytest.approx(case.high_mm, abs=2e-6)


def test_mesh_is_watertight_outward_and_as_large_as_the_solid(built: tuple[Case, Any]) -> None:
    case, workplane = built
    triangles = mesh.from_solid(workplane)
    assert triangles.is_watertight
    assert triangles.is_winding_consistent
    assert triangles.body_count == case.bodies
    assert triangles.volume == pytest.approx(case.volume_mm3, rel=0.005)
    np.testing.assert_allclose(triangles.bounds, [case.low_mm, case.high_mm], atol=0.02)


def test_a_hexagonal_core_has_its_faces_towards_the_led_rows() -> None:
    normals = [face.normalAt() for face in gelcore.solid(Gelcore(draft_deg=10.0)).val().Faces()]
    sides = [normal for normal in normals if abs(normal.z) < 0.9]
    azimuth = sorted(round(np.rad2deg(np.arctan2(n.y, n.x)) % 360, 6) for n in sides)
    assert azimuth == [30, 90, 150, 210, 270, 330]
    for normal in sides:  # a body that narrows upwards has sides that look up
        assert normal.z == pytest.approx(sin(radians(10)))


def test_a_dome_gel_meets_its_core() -> None:
    """Gel of radius 15 and thickness 2 over a core of radius 13: no gap and no overlap."""
    gel = elastomer.solid(Elastomer(shape="dome", outline="round", radius_mm=15.0, width_mm=20.0)).val()
    core = gelcore.solid(Gelcore(shape="dome", radius_mm=13.0, width_mm=20.0)).val().moved((0, 0, 2))
    assert gel.intersect(core).Volume() == pytest.approx(0.0, abs=1e-6)
    assert gel.fuse(core).clean().Volume() == pytest.approx(gel.Volume() + core.Volume(), rel=1e-9)
    assert len(gel.fuse(core).Solids()) == 1


@pytest.mark.parametrize(
    ("build", "spec", "text"),
    [
        (
            gelcore.solid,
            Gelcore(shape="dome", radius_mm=11.0),
            "radius_mm: must be at least half of width_mm",
        ),
        (
            gelcore.solid,
            Gelcore(shape="dome", radius_mm=12.0, height_mm=8.0),
            "height_mm: must exceed the height of the dome's cap (12 mm), is 8 mm",
        ),
        (
            gelcore.solid,
            Gelcore(width_mm=10.0, height_mm=20.0, draft_deg=15.0),
            "draft_deg: must be below 14.04",
        ),
        (
            elastomer.solid,
            Elastomer(shape="dome", outline="round", radius_mm=11.0),
            "width_mm: must not exceed the diameter of the dome's sphere (22 mm), is 24 mm",
        ),
        (probes.solid, Probe(kind="mesh", size_mm=4.0, file="part.stl"), "part.stl"),
    ],
)
def test_what_cannot_be_built_is_refused_by_name(build: Callable[[Any], Any], spec: Any, text: str) -> None:
    with pytest.raises(ValueError) as refusal:  # noqa: PT011 (the text is compared below, brackets and all)
        build(spec)
    assert text in str(refusal.value)
