"""The soft clear gel whose coated outer side, the membrane, is pressed against the world."""

from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import field_validator, model_validator

from geometries.outline import inside_outline, outline_polygon
from geometries.spec import Spec, quantity

if TYPE_CHECKING:
    import cadquery
    from scipy.interpolate import PchipInterpolator

Profile = tuple[tuple[float, float], ...]
STEEPEST_DEG = 80.0  # of a freeform membrane: steeper walls cannot be seen, nor leave a mould


class Elastomer(Spec):
    """Gel slab, dome of uniform thickness, or freeform gel on a plane core.

    Sensor frame: the membrane's centre (apex, for a dome) is the origin, +z points to the camera. A freeform
    gel is plano-convex: its membrane follows a profile turned about z, its other side is the plane of a flat
    core, which is a stock part, so that only the mould of the gel has to be turned.
    """

    shape: Literal["flat", "dome", "freeform"] = "flat"
    """flat: a plane membrane; dome: part of a sphere; freeform: a profile turned about z, on a plane core."""
    outline: Literal["rectangle", "hexagon", "round"] = "hexagon"
    """Outline seen by the camera; a dome or freeform gel is always round."""
    width_mm: float = quantity(24.0, unit="mm", gt=1, le=200)
    """Size along x; across flats of a hexagon; diameter of a round outline."""
    length_mm: float = quantity(20.0, unit="mm", gt=1, le=200)
    """Size along y of a rectangle; others ignore it."""
    thickness_mm: float = quantity(2.0, unit="mm", gt=0.1, le=20)
    """Gel thickness, membrane to core; on the axis, for a freeform gel."""
    radius_mm: float | None = quantity(None, unit="mm", gt=1, le=1e7)
    """Radius of the spherical membrane; a dome only."""
    profile_mm: Profile | None = None
    """Points (distance from the axis, height) in mm of a freeform membrane, from (0, 0) to the rim or beyond.
    A smooth curve that is level on the axis runs through them and stays between them: where they rise, it
    rises."""

    @field_validator("profile_mm")
    @classmethod
    def _a_curve(cls, profile: Profile | None) -> Profile | None:
        if profile is None:
            return None
        r, z = zip(*profile, strict=True) if profile else ((), ())
        if len(r) < 3 or (r[0], z[0]) != (0.0, 0.0):
            raise ValueError(f"needs three points or more from (0, 0) mm on, got {profile}")
        if any(b - a < 1e-3 for a, b in pairwise(r)):
            raise ValueError(f"distances from the axis must ascend by 0.001 mm or more, got {list(r)} mm")
        if min(z) < 0:
            raise ValueError(f"heights start at 0, the membrane's lowest point, got {min(z):g} mm")
        return profile

    @model_validator(mode="after")
    def _freeform_has_profile(self) -> Self:
        if self.shape != "freeform":
            if self.profile_mm is not None:
                raise ValueError(f"profile_mm: only a freeform gel has a profile, shape is {self.shape!r}")
            return self
        if self.profile_mm is None:
            raise ValueError("profile_mm: a freeform gel needs the profile of its membrane")
        if self.outline != "round":
            raise ValueError(f"outline: a freeform gel is round, not {self.outline!r}")
        rim = self.width_mm / 2
        if self.profile_mm[-1][0] < rim:
            raise ValueError(
                f"profile_mm: must reach the rim, {rim:g} mm from the axis, "
                f"ends at {self.profile_mm[-1][0]:g} mm"
            )
        curve = _curve(self.profile_mm)
        r = np.linspace(0.0, rim, 1001)
        highest, steepest = float(curve(r).max()), float(np.abs(curve(r, 1)).max())
        if highest >= self.thickness_mm:
            raise ValueError(
                f"profile_mm: must stay below thickness_mm ({self.thickness_mm:g} mm), "
                f"reaches {highest:.4g} mm"
            )
        if steepest > np.tan(np.radians(STEEPEST_DEG)):
            raise ValueError(
                f"profile_mm: slopes must stay below {STEEPEST_DEG:g} deg, "
                f"the steepest is {np.degrees(np.arctan(steepest)):.4g} deg"
            )
        return self

    @model_validator(mode="after")
    def _dome_has_radius(self) -> Self:
        if self.shape == "dome":
            if self.radius_mm is None:
                raise ValueError("radius_mm: a dome needs the radius of its membrane")
            if self.outline != "round":
                raise ValueError(f"outline: a dome is round, not {self.outline!r}")
            if self.thickness_mm >= self.radius_mm:
                raise ValueError(
                    f"thickness_mm: must be below radius_mm ({self.radius_mm:g} mm), "
                    f"is {self.thickness_mm:g} mm"
                )
        elif self.radius_mm is not None:
            raise ValueError(f"radius_mm: only a dome has a radius, shape is {self.shape!r}")
        return self


def polygon(spec: Elastomer, *, segments: int = 360) -> NDArray[np.float64]:
    """Corners (mm) of the gel's outline, counter-clockwise, shape (n, 2); `segments` stand for a circle."""
    return outline_polygon(spec.outline, width_mm=spec.width_mm, length_mm=spec.length_mm, segments=segments)


def inside(spec: Elastomer, x: ArrayLike, y: ArrayLike) -> NDArray[np.bool_]:
    """Which points (mm, sensor frame) lie within the gel's outline, its border included."""
    return inside_outline(spec.outline, x, y, width_mm=spec.width_mm, length_mm=spec.length_mm)


def base_mm(spec: Elastomer, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
    """Height of the undeformed membrane over the plane z = 0.

    Parameters
    ----------
    spec : Elastomer
        The gel.
    x, y : array_like
        Points in the sensor frame (mm), broadcast against each other.

    Returns
    -------
    ndarray
        Height in mm: zero on a flat gel; on a dome of radius R, R - sqrt(R^2 - x^2 - y^2), and NaN beyond
        the sphere; on a freeform gel its profile's, straight on beyond its last point. The outline is not
        applied, see `inside`.
    """
    x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
    if spec.profile_mm is not None:
        r, curve, end = np.hypot(x, y), _curve(spec.profile_mm), spec.profile_mm[-1][0]
        return np.asarray(curve(np.minimum(r, end)) + curve(end, 1) * np.maximum(r - end, 0.0))
    if spec.radius_mm is None:
        return np.zeros(x.shape)
    # R - sqrt(R^2 - r^2) rewritten without the difference, which would cancel on a nearly flat dome.
    return np.asarray((x**2 + y**2) / (spec.radius_mm + _depth_below_centre_mm(spec.radius_mm, x, y)))


def base_gradient(
    spec: Elastomer, x: ArrayLike, y: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Slope (dz/dx, dz/dy) of the undeformed membrane, pure numbers; arguments and NaN as in `base_mm`."""
    x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
    if spec.profile_mm is not None:
        r = np.hypot(x, y)
        slope = _curve(spec.profile_mm)(np.minimum(r, spec.profile_mm[-1][0]), 1)
        outward = slope / np.where(r > 0, r, 1.0)
        return np.asarray(outward * x), np.asarray(outward * y)
    if spec.radius_mm is None:
        return np.zeros(x.shape), np.zeros(x.shape)
    depth = _depth_below_centre_mm(spec.radius_mm, x, y)
    with np.errstate(divide="ignore", invalid="ignore"):  # the membrane is vertical on the sphere's equator
        return np.asarray(x / depth), np.asarray(y / depth)


def interface_mm(spec: Elastomer, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
    """Height of the boundary to the gelcore; arguments as in `base_mm`.

    A plane, or under a dome the concentric sphere; beyond that sphere its equator's height.
    """
    x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
    if spec.radius_mm is None:
        return np.full(x.shape, spec.thickness_mm)
    inner = spec.radius_mm - spec.thickness_mm
    return np.asarray(spec.radius_mm - np.sqrt(np.maximum(inner**2 - x**2 - y**2, 0.0)))


def thinnest_mm(spec: Elastomer) -> float:
    """Least thickness of the gel."""
    if spec.profile_mm is None:
        return spec.thickness_mm
    r = np.linspace(0.0, spec.width_mm / 2, 1001)
    return spec.thickness_mm - float(_curve(spec.profile_mm)(r).max())


@lru_cache(maxsize=64)
def _curve(profile: Profile) -> "PchipInterpolator":
    """Piecewise cubic curve through a profile, without kinks, which stays between its points.

    Fritsch and Butland (1984), SIAM J. Sci. Stat. Comput. 5, 300. Mirrored points make it level on the axis.
    """
    from scipy.interpolate import PchipInterpolator

    r, z = np.array(profile).T
    return PchipInterpolator(np.concatenate([-r[:0:-1], r]), np.concatenate([z[:0:-1], z]))


def _depth_below_centre_mm(
    radius_mm: float, x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Vertical distance from the sphere's centre plane to its surface, NaN beyond the sphere."""
    square = radius_mm**2 - x**2 - y**2
    return np.sqrt(np.where(square >= 0, square, np.nan))


def solid(spec: Elastomer) -> "cadquery.Workplane":
    """Build the gel as one closed CadQuery solid in the sensor frame (mm).

    A flat gel fills its outline from z = 0 to its thickness. A dome is the shell between the membrane's
    sphere and the concentric sphere of the core, inside the cylinder of its outline and below the centre. A
    freeform gel fills the space between its profile and the plane of the core.

    Raises
    ------
    ValueError
        If a dome is wider than its sphere.
    """
    import cadquery

    if spec.profile_mm is not None:
        return _freeform(spec, spec.profile_mm)
    if spec.radius_mm is None:
        if spec.outline == "round":
            return cadquery.Workplane("XY").circle(spec.width_mm / 2).extrude(spec.thickness_mm)
        return cadquery.Workplane("XY").polyline(polygon(spec).tolist()).close().extrude(spec.thickness_mm)
    outer, inner, rim = spec.radius_mm, spec.radius_mm - spec.thickness_mm, spec.width_mm / 2
    if rim > outer:
        raise ValueError(
            f"width_mm: must not exceed the diameter of the dome's sphere ({2 * outer:g} mm), "
            f"is {spec.width_mm:g} mm"
        )
    sketch = cadquery.Workplane("XZ").threePointArc(*_arc(outer, rim, lowest_mm=0.0))
    if rim > inner:  # the core's sphere ends at its equator, inside the gel's outline
        if rim < outer:
            sketch = sketch.lineTo(rim, outer)
        sketch = sketch.lineTo(inner, outer)
    middle, end = _arc(inner, min(rim, inner), lowest_mm=spec.thickness_mm)
    if rim <= inner:
        sketch = sketch.lineTo(*end)
    sketch = sketch.threePointArc(middle, (0, spec.thickness_mm)).close()
    return sketch.revolve(360, (0, 0, 0), (0, 1, 0))


def _freeform(spec: Elastomer, profile: Profile) -> "cadquery.Workplane":
    """Profile and plane, turned about z; each piece of the profile is a cubic: exactly a Bezier curve."""
    import cadquery

    curve, rim = _curve(profile), spec.width_mm / 2
    ends = [r for r, _ in profile if r < rim - 1e-6] + [rim]
    sketch = cadquery.Workplane("XZ")
    for start, end in pairwise(ends):
        third = (end - start) / 3
        low, high = float(curve(start)), float(curve(end))
        first, second = low + third * float(curve(start, 1)), high - third * float(curve(end, 1))
        control = [(start, low), (start + third, first), (end - third, second), (end, high)]
        sketch = sketch.bezier(control if start == 0 else control[1:], includeCurrent=start > 0)
    sketch = sketch.lineTo(rim, spec.thickness_mm).lineTo(0, spec.thickness_mm).close()
    return sketch.revolve(360, (0, 0, 0), (0, 1, 0))


def _arc(
    radius_mm: float, rim_mm: float, *, lowest_mm: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Middle and end, as (distance from the axis, z), of an arc from its apex on the axis to the rim."""
    half_angle = np.arcsin(min(rim_mm / radius_mm, 1.0)) / 2
    middle, end = (
        (float(radius_mm * np.sin(a)), float(lowest_mm + 2 * radius_mm * np.sin(a / 2) ** 2))
        for a in (half_angle, 2 * half_angle)
    )
    return middle, end
