"""Where the camera looks: pixel to membrane, with the refraction of what lies between."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from designlab.camera import View
from designlab.design import Design
from designlab.press import Surface
from designlab.refraction import crossing_mm

Array = NDArray[np.float64]
STEEPEST = float(np.tan(np.radians(89.0)))  # tangent of the angle to the axis


@dataclass(frozen=True, eq=False)
class Rays:
    """One viewing ray a pixel, as it runs in the layer that touches the membrane.

    The ray of a pixel passes (x_mm, y_mm) at height z = 0 and moves by `slope_x`, `slope_y` mm a mm of
    height. All arrays have shape (rows, columns). `binned` sensor pixels make one output pixel.
    """

    x_mm: Array
    y_mm: Array
    slope_x: Array
    slope_y: Array
    binned: float

    @property
    def pitch_mm(self) -> tuple[float, float]:
        """Distance of neighbouring pixels on the plane z = 0, along x and y (median)."""
        return (
            float(np.median(np.diff(self.x_mm, axis=1))),
            float(np.median(-np.diff(self.y_mm, axis=0))),
        )

    def hit(self, surface: Surface, *, iterations: int = 8) -> tuple[Array, Array]:
        """Points (x, y) in mm where the rays meet a deformed membrane, by fixed-point iteration.

        Viewing rays are steep, so the iteration contracts wherever a wall does not hide itself.
        """
        z = np.nan_to_num(surface.z_mm)
        x, y, height = self.x_mm.copy(), self.y_mm.copy(), np.zeros_like(self.x_mm)
        # Most rays meet the undeformed plane, where the first look-up changes nothing.
        moving = np.ones(x.shape, dtype=bool)
        for _ in range(iterations):
            met = surface.sample(z, x[moving], y[moving])
            changed = met != height[moving]
            moving[moving] = changed
            height[moving] = met[changed]
            x[moving] = self.x_mm[moving] + self.slope_x[moving] * height[moving]
            y[moving] = self.y_mm[moving] + self.slope_y[moving] * height[moving]
        return x, y


def rays(design: Design, view: View, *, lens_point: tuple[float, float] = (0.0, 0.0)) -> Rays:
    """Viewing rays through the centres of the output pixels of a view.

    Refraction follows Snell's law at the window and at the gel side of the core, plane or dome. A fisheye's
    directions beyond `STEEPEST` from the axis, which meet no membrane, are bent back to that angle.

    Parameters
    ----------
    design : Design
        The sensor.
    view : View
        The part of the camera's sensor.
    lens_point : (float, float)
        Point of the lens opening the rays pass, along x and y in radii of the opening. Away from the centre
        the ray of a pixel meets its central ray in the plane of focus: averages over the opening make the
        picture of a thin lens. It matters only where `camera.focus_mm` is set.
    """
    camera = design.camera
    right, up, forward = camera.unproject(*view.centres())
    tan_x, tan_y = _tangents(right, up, forward)
    u, v = 0.0, 0.0
    if camera.defocus is not None:
        radius_mm, focus_mm = camera.defocus
        u, v = radius_mm * lens_point[0], radius_mm * lens_point[1]
        tan_x, tan_y = tan_x - u / focus_mm, tan_y - v / focus_mm
    scale, slope = crossing_mm(np.hypot(tan_x, tan_y), design.layers_to_camera(0.0))
    x_c, y_c, _ = camera.position_mm
    binned = (view.width_px / view.columns) * (view.height_px / view.rows)
    found = Rays(x_c + u + scale * tan_x, y_c + v + scale * tan_y, -slope * tan_x, -slope * tan_y, binned)
    if design.optics.light_path == "core" and design.elastomer.radius_mm is not None:
        return _through_dome(found, design, x_c + u, y_c + v, tan_x, tan_y)
    return found


def _through_dome(plane: Rays, design: Design, x: float, y: float, tan_x: Array, tan_y: Array) -> Rays:
    """Rays that leave the camera at (x, y), bent at the window and at the dome of the core.

    Rays beside the dome keep the path they have in `plane`, through plane layers.
    """
    (_, gel_index), (_, core_index), (down_mm, _) = design.layers_to_camera(0.0)
    thickness = design.elastomer.thickness_mm
    radius = _dome_radius_mm(design) - thickness
    # In the core: Snell's law keeps what a direction has along the window.
    sine_x, sine_y = (t / np.sqrt(1 + tan_x**2 + tan_y**2) / core_index for t in (tan_x, tan_y))
    direction = np.stack([sine_x, sine_y, -np.sqrt(1 - sine_x**2 - sine_y**2)])
    window_mm = thickness + design.gelcore.height_mm - _dome_radius_mm(design)
    from_centre = np.stack([x + down_mm * tan_x, y + down_mm * tan_y, np.full_like(tan_x, window_mm)])
    along = (from_centre * direction).sum(axis=0)
    inside = radius**2 - (from_centre**2).sum(axis=0) + along**2
    point = from_centre + (np.sqrt(np.maximum(inside, 0.0)) - along) * direction
    # At the dome: Snell's law in vectors; the sphere's radius is the normal, towards the gel.
    normal = point / radius
    ratio = core_index / gel_index
    cosine = (normal * direction).sum(axis=0)
    bent = (
        ratio * direction
        + (np.sqrt(np.maximum(1 - ratio**2 * (1 - cosine**2), 0.0)) - ratio * cosine) * normal
    )
    slope_x, slope_y = bent[0] / bent[2], bent[1] / bent[2]
    height = point[2] + _dome_radius_mm(design)
    reach = min(design.gelcore.width_mm / 2, radius)
    met = (inside > 0) & (point[2] < 0) & (np.hypot(point[0], point[1]) < reach) & (bent[2] < -1 / STEEPEST)
    return Rays(
        np.where(met, point[0] - slope_x * height, plane.x_mm),
        np.where(met, point[1] - slope_y * height, plane.y_mm),
        np.where(met, slope_x, plane.slope_x),
        np.where(met, slope_y, plane.slope_y),
        plane.binned,
    )


def _dome_radius_mm(design: Design) -> float:
    assert design.elastomer.radius_mm is not None
    return design.elastomer.radius_mm


def _tangents(right: Array, up: Array, forward: Array) -> tuple[Array, Array]:
    """Tangents of a direction's angles to the axis, bent back to `STEEPEST` where it is steeper."""
    sideways = np.hypot(right, up)
    forward = np.maximum(forward, sideways / STEEPEST)
    return right / forward, up / forward
