"""The clear rigid body behind the gel: flat slab, hexagonal prism, or domed block."""

from math import asin, atan2, degrees, radians, sin, sqrt, tan
from typing import TYPE_CHECKING, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from geometries.outline import OutlineName, outline_polygon
from geometries.spec import Spec, quantity

if TYPE_CHECKING:
    import cadquery


THINNEST_MM = 0.5  # of a wedge: thinner edges break
MOST_BULGE = 0.25  # of the height of the sides: flatter than a third of a circle


class Gelcore(Spec):
    """Rigid transparent support of the gel; lies between the gel and the camera.

    Local frame: the gel side touches z = 0 (the apex, for a dome), the camera window is at z = height_mm.
    """

    shape: Literal["slab", "hexagonal", "dome"] = "hexagonal"
    """slab: rectangular block; hexagonal: prism with flats at azimuth 90, 150, 210... deg; dome: round block
    whose gel side is a spherical cap."""
    width_mm: float = quantity(24.0, unit="mm", gt=1, le=200)
    """Size along x; distance across flats of a hexagon; diameter of a dome."""
    length_mm: float = quantity(20.0, unit="mm", gt=1, le=200)
    """Size along y of a slab; others ignore it."""
    height_mm: float = quantity(8.0, unit="mm", gt=0.2, le=100)
    """Thickness along z."""
    radius_mm: float | None = quantity(None, unit="mm", gt=1, le=1000)
    """Radius of the spherical gel side; a dome only."""
    draft_deg: float = quantity(0.0, unit="deg", ge=0, le=30)
    """Inclination of the side faces of a slab or hexagon, which narrows towards the camera."""
    side_bulge_mm: float | None = quantity(None, unit="mm", ge=-20, le=20)
    """How far the side faces bulge outwards midway between gel side and window, along an arc of a circle;
    negative, they are hollow. Straight when absent."""
    wedge_deg: float | None = quantity(None, unit="deg", ge=-60, le=60)
    """Inclination of the window of a slab: a wedge that is thicker towards +y; height_mm holds on the axis.
    Level when absent."""
    window_diameter_mm: float = quantity(12.0, unit="mm", gt=0, le=200)
    """Diameter of the clear area the camera looks through."""
    cavity_radius_mm: float | None = quantity(None, unit="mm", gt=0.5, le=100)
    """Radius, at the window, of a hollow behind it, half a spheroid around the axis: the core is a shell
    then. Solid when absent."""
    cavity_depth_mm: float | None = quantity(None, unit="mm", gt=0.1, le=100)
    """How deep the hollow reaches; its radius when absent."""
    side_finish: Literal["polished", "ground", "painted"] = "painted"
    """Finish of the side faces away from the LEDs."""
    led_side_finish: Literal["polished", "ground", "painted"] | None = None
    """Finish of the side faces that LEDs face; polished when absent. Ground ones diffuse the light as it
    enters; painted ones need bonded LEDs, which shine from within."""
    ground_roughness: float = quantity(0.3, unit="1", ge=0.01, le=1)
    """GGX alpha of ground side faces; 0.3 is what the public scene of the 2020 prototype gives its core
    (arXiv 2012.13184)."""
    paint_reflectance: float = quantity(0.0, unit="1", ge=0, le=0.99)
    """Diffuse reflectance of painted side faces, seen from inside the core: paint wets the face, so that no
    air gap reflects. 0 is black, 0.9 a good white."""

    @model_validator(mode="after")
    def _goes_with_its_shape(self) -> Self:
        if self.shape == "dome" and self.radius_mm is None:
            raise ValueError("radius_mm: a dome needs the radius of its spherical side")
        if self.shape != "dome" and self.radius_mm is not None:
            raise ValueError(f"radius_mm: only a dome has a radius, shape is {self.shape!r}")
        if self.cavity_depth_mm is not None and self.cavity_radius_mm is None:
            raise ValueError("cavity_depth_mm: goes with cavity_radius_mm, which is absent")
        if self.side_bulge_mm is not None:
            if self.draft_deg or self.wedge_deg is not None:
                raise ValueError("side_bulge_mm: curved sides have neither draft_deg nor wedge_deg")
            most_mm = MOST_BULGE * max(side_height_mm(self), 0.0)
            if abs(self.side_bulge_mm) > most_mm:
                raise ValueError(
                    f"side_bulge_mm: may be up to {MOST_BULGE:g} of the height of the sides, "
                    f"{most_mm:.4g} mm, is {self.side_bulge_mm:g} mm"
                )
        if self.wedge_deg is not None:
            if self.shape != "slab" or self.draft_deg or self.cavity_radius_mm is not None:
                raise ValueError("wedge_deg: a wedge is a slab without draft_deg and without a hollow")
            thin_mm = self.height_mm - abs(self.window_slope) * self.length_mm / 2
            if thin_mm < THINNEST_MM:
                raise ValueError(
                    f"wedge_deg: the thin end must be at least {THINNEST_MM:g} mm high, is {thin_mm:.3g} mm "
                    f"at {self.wedge_deg:g} deg; give more height_mm"
                )
        return self

    @property
    def window_slope(self) -> float:
        """Rise of the window along y, mm a mm."""
        return 0.0 if self.wedge_deg is None else tan(radians(self.wedge_deg))

    @property
    def cavity(self) -> tuple[float, float] | None:
        """Radius and depth of the hollow behind the window."""
        if self.cavity_radius_mm is None:
            return None
        return self.cavity_radius_mm, self.cavity_depth_mm or self.cavity_radius_mm


def polygon(spec: Gelcore, *, segments: int = 360) -> NDArray[np.float64]:
    """Corners (mm) of the gel side's outline, counter-clockwise, (n, 2); `segments` stand for a circle."""
    outlines: dict[str, OutlineName] = {"slab": "rectangle", "hexagonal": "hexagon", "dome": "round"}
    return outline_polygon(
        outlines[spec.shape], width_mm=spec.width_mm, length_mm=spec.length_mm, segments=segments
    )


def polygon_at(spec: Gelcore, height_mm: float, *, segments: int = 360) -> NDArray[np.float64]:
    """Corners (mm) of the outline `height_mm` over the gel side, smaller with a draft; see `polygon`."""
    outline = polygon(spec, segments=segments)
    lean_mm = tan(radians(spec.draft_deg)) * height_mm
    if spec.shape == "hexagonal":
        return outline * (1 - lean_mm / (spec.width_mm / 2))
    return outline - lean_mm * np.sign(outline)


def side_height_mm(spec: Gelcore) -> float:
    """Height of the side faces (mm), of a dome above its spherical cap."""
    if spec.radius_mm is None:
        return spec.height_mm
    rim = min(spec.width_mm / 2, spec.radius_mm)
    return spec.height_mm - (spec.radius_mm - sqrt(spec.radius_mm**2 - rim**2))


def bulge_mm(spec: Gelcore, share: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far sides stand out at a share of their height, from 0 at the gel side to 1 at the window (mm)."""
    sagitta = spec.side_bulge_mm or 0.0
    if not sagitta:
        return np.zeros_like(share)
    up = side_height_mm(spec) * (share - 0.5)
    radius = _arc_radius_mm(spec)
    return np.asarray(np.sign(sagitta) * (np.sqrt(radius**2 - up**2) - radius + abs(sagitta)))


def bulge_slope(spec: Gelcore, share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Change of `bulge_mm` a mm of height."""
    sagitta = spec.side_bulge_mm or 0.0
    if not sagitta:
        return np.zeros_like(share)
    up = side_height_mm(spec) * (share - 0.5)
    return np.asarray(-np.sign(sagitta) * up / np.sqrt(_arc_radius_mm(spec) ** 2 - up**2))


def _arc_radius_mm(spec: Gelcore) -> float:
    """Radius of the arc that curved sides follow."""
    sagitta = abs(spec.side_bulge_mm or 0.0)
    return (side_height_mm(spec) ** 2 / 4 + sagitta**2) / (2 * sagitta)


def outset(outline: NDArray[np.float64], by_mm: float) -> NDArray[np.float64]:
    """Convex counter-clockwise polygon (n, 2) whose sides lie further out (mm)."""
    edge = np.roll(outline, -1, axis=0) - outline
    level = np.column_stack([edge[:, 1], -edge[:, 0]]) / np.linalg.norm(edge, axis=1, keepdims=True)
    before = np.roll(level, 1, axis=0)
    both = (level + before) / (1 + (level * before).sum(axis=1, keepdims=True))
    return np.asarray(outline + by_mm * both)


def solid(spec: Gelcore) -> "cadquery.Workplane":
    """Build the gelcore as one closed CadQuery solid in its local frame (mm).

    Raises
    ------
    ValueError
        If the sides meet before the window, or the dome's sphere does not fit the block.
    """
    if spec.cavity is None:
        return _block(spec)
    return _block(spec).cut(_hollow(spec, *spec.cavity)).solids()


def _hollow(spec: Gelcore, radius_mm: float, depth_mm: float) -> "cadquery.Workplane":
    """Half a spheroid below the window."""
    import cadquery

    quarter = cadquery.Workplane("XZ").moveTo(0, spec.height_mm).lineTo(radius_mm, spec.height_mm)
    across, down = cadquery.Vector(1, 0, 0), cadquery.Vector(0, -1, 0)  # the sketch is drawn in its own plane
    if np.isclose(radius_mm, depth_mm):
        middle = (radius_mm * np.sqrt(0.5), spec.height_mm - depth_mm * np.sqrt(0.5))
        quarter = quarter.threePointArc(middle, (0, spec.height_mm - depth_mm))
    else:
        turn = np.radians(np.linspace(0.0, 90.0, 46))[1:]
        points = [(radius_mm * np.cos(t), spec.height_mm - depth_mm * np.sin(t)) for t in turn]
        quarter = quarter.spline(points, tangents=[down, -across], includeCurrent=True)
    return quarter.close().revolve(360, (0, 0, 0), (0, 1, 0))


def _block(spec: Gelcore) -> "cadquery.Workplane":
    """Build the core without its hollow."""
    import cadquery

    if spec.radius_mm is not None:
        return _dome(spec, radius_mm=spec.radius_mm)
    if spec.wedge_deg is not None:
        half, rise = spec.length_mm / 2, spec.window_slope * spec.length_mm / 2
        corners = [(-half, 0), (half, 0), (half, spec.height_mm + rise), (-half, spec.height_mm - rise)]
        return cadquery.Workplane("YZ").polyline(corners).close().extrude(spec.width_mm / 2, both=True)
    if spec.side_bulge_mm:
        return _bulged(spec)
    narrowest = spec.width_mm if spec.shape == "hexagonal" else min(spec.width_mm, spec.length_mm)
    steepest_deg = degrees(atan2(narrowest / 2, spec.height_mm))
    if spec.draft_deg >= steepest_deg:
        raise ValueError(
            f"draft_deg: must be below {steepest_deg:.4g} deg, where the sides meet at the window, "
            f"is {spec.draft_deg:g} deg"
        )
    sketch = cadquery.Workplane("XY").polyline(polygon(spec).tolist()).close()
    return sketch.extrude(spec.height_mm, taper=spec.draft_deg)


def _bulged(spec: Gelcore) -> "cadquery.Workplane":
    """Block or prism with curved sides: what bodies that are curved across each pair of sides share."""
    import cadquery

    bulge = spec.side_bulge_mm or 0.0
    far = spec.width_mm + spec.length_mm + 4 * abs(bulge)
    pairs = {0.0: spec.width_mm, 90.0: spec.length_mm}
    if spec.shape == "hexagonal":
        pairs = dict.fromkeys((30.0, 90.0, 150.0), spec.width_mm)
    found: cadquery.Workplane | None = None
    for azimuth_deg, across_mm in pairs.items():
        half, middle = across_mm / 2, spec.height_mm / 2
        profile = cadquery.Workplane("XZ").moveTo(-half, 0).lineTo(half, 0)
        profile = profile.threePointArc((half + bulge, middle), (half, spec.height_mm))
        profile = profile.lineTo(-half, spec.height_mm).threePointArc((-half - bulge, middle), (-half, 0))
        body = profile.close().extrude(far, both=True).rotate((0, 0, 0), (0, 0, 1), azimuth_deg)
        found = body if found is None else found.intersect(body)
    assert found is not None  # of two pairs or three
    return found.solids()


def _dome(spec: Gelcore, *, radius_mm: float) -> "cadquery.Workplane":
    """Round block with a spherical cap towards the gel."""
    import cadquery

    rim = spec.width_mm / 2
    if rim > radius_mm:
        raise ValueError(f"radius_mm: must be at least half of width_mm ({rim:g} mm), is {radius_mm:g} mm")
    half_angle = asin(rim / radius_mm) / 2
    cap_mm = 2 * radius_mm * sin(half_angle) ** 2
    if cap_mm >= spec.height_mm:
        raise ValueError(
            f"height_mm: must exceed the height of the dome's cap ({cap_mm:.4g} mm), is {spec.height_mm:g} mm"
        )
    middle = (radius_mm * sin(half_angle), 2 * radius_mm * sin(half_angle / 2) ** 2)
    sketch = cadquery.Workplane("XZ").threePointArc(middle, (rim, cap_mm))
    if spec.side_bulge_mm:
        waist = (rim + spec.side_bulge_mm, (cap_mm + spec.height_mm) / 2)
        sketch = sketch.threePointArc(waist, (rim, spec.height_mm))
    else:
        sketch = sketch.lineTo(rim, spec.height_mm)
    sketch = sketch.lineTo(0, spec.height_mm).close()
    return sketch.revolve(360, (0, 0, 0), (0, 1, 0))
