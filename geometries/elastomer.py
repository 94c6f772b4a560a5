"""The soft clear gel whose coated outer side, the membrane, is pressed against the world: flat or dome."""

from typing import TYPE_CHECKING, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from geometries.outline import inside_outline, outline_polygon
from geometries.spec import Spec, quantity

if TYPE_CHECKING:
    import cadquery


class Elastomer(Spec):
    """Gel slab or dome of uniform thickness.

    Sensor frame: the membrane's centre (apex, for a dome) is the origin, +z points to the camera.
    """

    shape: Literal["flat", "dome"] = Field(
        "flat", description="flat: a plane membrane; dome: part of a sphere."
    )
    outline: Literal["rectangle", "hexagon", "round"] = Field(
        "hexagon", description="Outline seen by the camera; a dome is always round."
    )
    width_mm: float = quantity(
        24.0,
        unit="mm",
        gt=1,
        le=200,
        description="Size along x; across flats of a hexagon; diameter of a round outline.",
    )
    length_mm: float = quantity(
        20.0, unit="mm", gt=1, le=200, description="Size along y of a rectangle; others ignore it."
    )
    thickness_mm: float = quantity(
        2.0, unit="mm", gt=0.1, le=20, description="Gel thickness, membrane to core."
    )
    radius_mm: float | None = quantity(
        None, unit="mm", gt=1, le=1e7, description="Radius of the spherical membrane; a dome only."
    )

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
        the sphere. The outline is not applied, see `inside`.
    """
    x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
    if spec.radius_mm is None:
        return np.zeros(x.shape)
    # R - sqrt(R^2 - r^2) rewritten without the difference, which would cancel on a nearly flat dome.
    return np.asarray((x**2 + y**2) / (spec.radius_mm + _depth_below_centre_mm(spec.radius_mm, x, y)))


def base_gradient(
    spec: Elastomer, x: ArrayLike, y: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Slope (dz/dx, dz/dy) of the undeformed membrane, pure numbers; arguments and NaN as in `base_mm`."""
    x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
    if spec.radius_mm is None:
        return np.zeros(x.shape), np.zeros(x.shape)
    depth = _depth_below_centre_mm(spec.radius_mm, x, y)
    with np.errstate(divide="ignore", invalid="ignore"):  # the membrane is vertical on the sphere's equator
        return np.asarray(x / depth), np.asarray(y / depth)


def _depth_below_centre_mm(
    radius_mm: float, x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Vertical distance from the sphere's centre plane to its surface, NaN beyond the sphere."""
    square = radius_mm**2 - x**2 - y**2
    return np.sqrt(np.where(square >= 0, square, np.nan))


def solid(spec: Elastomer) -> "cadquery.Workplane":
    """Build the gel as one closed CadQuery solid in the sensor frame (mm).

    A flat gel fills its outline from z = 0 to its thickness. A dome is the shell between the membrane's
    sphere and the concentric sphere of the core, inside the cylinder of its outline and below the centre.

    Raises
    ------
    ValueError
        If a dome is wider than its sphere.
    """
    import cadquery

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
