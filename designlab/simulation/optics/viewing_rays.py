"""Where the camera looks: pixel to membrane, with the refraction of what lies between."""

from dataclasses import dataclass

import numpy as np

from designlab.core.types import Array
from designlab.sensor.camera import View
from designlab.sensor.design import Design
from designlab.sensor.refraction import Glass, crossing_mm
from designlab.simulation.contact.surface import Surface

STEPS_FLAT, STEPS_CURVED = 8, 60  # from the plane z = 0 to the membrane
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

    def hit(self, surface: Surface) -> tuple[Array, Array]:
        """Points (x, y) in mm where the rays meet a deformed membrane, by fixed-point iteration.

        Viewing rays are steep, so the iteration contracts wherever a wall does not hide itself; slowly on the
        flank of a dome that is seen along it.
        """
        z = np.nan_to_num(surface.z_mm)
        iterations = STEPS_FLAT if np.nanmax(surface.base_mm, initial=0.0) == 0 else STEPS_CURVED
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

    Refraction follows Snell's law at the window, plane or hollow, and at the gel side of the core, plane or
    dome. A fisheye's directions beyond `STEEPEST` from the axis, which meet no membrane, are bent back to
    that angle.

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
    x_c, y_c, _ = camera.eye_mm
    binned = (view.width_px / view.columns) * (view.height_px / view.rows)
    found = Rays(x_c + u + scale * tan_x, y_c + v + scale * tan_y, -slope * tan_x, -slope * tan_y, binned)
    glass = design.glass
    if glass is None or not glass.bends:
        return found
    return _through_curves(found, glass, camera.eye_mm[2], x_c + u, y_c + v, tan_x, tan_y)


def _through_curves(
    plane: Rays, glass: Glass, height_mm: float, x: float, y: float, tan_x: Array, tan_y: Array
) -> Rays:
    """Rays that leave the camera at (x, y), bent at a hollow of the core and at its dome.

    Rays beside a dome keep the path they have in `plane`, through plane layers.
    """
    direction = np.stack([tan_x, tan_y, -np.ones_like(tan_x)])
    direction = direction / np.linalg.norm(direction, axis=0)
    start = np.stack([np.full_like(tan_x, value) for value in (x, y, height_mm)])
    point, bent, met = glass.follow(start, direction)
    slope_x, slope_y = bent[0] / bent[2], bent[1] / bent[2]
    met = met & (bent[2] < -1 / STEEPEST)
    return Rays(
        np.where(met, point[0] - slope_x * point[2], plane.x_mm),
        np.where(met, point[1] - slope_y * point[2], plane.y_mm),
        np.where(met, slope_x, plane.slope_x),
        np.where(met, slope_y, plane.slope_y),
        plane.binned,
    )


def _tangents(right: Array, up: Array, forward: Array) -> tuple[Array, Array]:
    """Tangents of a direction's angles to the axis, bent back to `STEEPEST` where it is steeper."""
    sideways = np.hypot(right, up)
    forward = np.maximum(forward, sideways / STEEPEST)
    return right / forward, up / forward
