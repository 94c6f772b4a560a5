"""Where the camera looks: pixel to membrane, with the refraction of plane layers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from designlab.camera import View
from designlab.design import Design
from designlab.press import Surface
from designlab.refraction import crossing_mm

Array = NDArray[np.float64]


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
        x, y = self.x_mm, self.y_mm
        for _ in range(iterations):
            height = surface.sample(z, x, y)
            x, y = self.x_mm + self.slope_x * height, self.y_mm + self.slope_y * height
        return x, y


def rays(design: Design, view: View) -> Rays:
    """Viewing rays through the centres of the output pixels of a view.

    Refraction follows Snell's law at plane layers; the gel side of a dome core is taken as plane.
    """
    camera = design.camera
    columns = view.x_px + (np.arange(view.columns) + 0.5) * view.width_px / view.columns
    rows = view.y_px + (np.arange(view.rows) + 0.5) * view.height_px / view.rows
    tan_x, tan_y = np.meshgrid(
        (columns - camera.width_px / 2) / camera.focal_px, (camera.height_px / 2 - rows) / camera.focal_px
    )
    scale, slope = crossing_mm(np.hypot(tan_x, tan_y), design.layers_to_camera(0.0))
    x_c, y_c, _ = camera.position_mm
    binned = (view.width_px / view.columns) * (view.height_px / view.rows)
    return Rays(x_c + scale * tan_x, y_c + scale * tan_y, -slope * tan_x, -slope * tan_y, binned)
