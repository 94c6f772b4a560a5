"""Which part of the camera's sensor sees the ball."""

import numpy as np

from designlab.core.types import Array
from designlab.measurement.light_probe.ball import LightProbe
from designlab.sensor.camera import View
from designlab.sensor.design import Design
from designlab.simulation.optics.viewing_rays import rays

BORDER = 1.08  # the picture reaches this far beyond the ball's outline, in its radii
LEAST_PX = 8  # columns and rows in which a ball can be unwrapped
SEARCH_PX = 96  # columns and rows of the grids in which the ball is looked for


def probe_view(design: Design, probe: LightProbe, *, columns: int) -> View:
    """Part of the camera's sensor that shows the ball and a narrow border, as far as the sensor goes.

    Raises
    ------
    ValueError
        If the camera does not see the ball, or `columns` is too few.
    """
    if columns < 16:
        raise ValueError(f"columns: must be at least 16, got {columns}")
    bare, camera = probe.around(design), design.camera
    full = camera.full_view()
    area = full
    for _ in range(4):
        grid = area._replace(columns=SEARCH_PX, rows=SEARCH_PX)
        miss_mm, px_per_mm = _passes(bare, probe, grid)
        row, column = np.unravel_index(int(miss_mm.argmin()), miss_mm.shape)
        at_column, at_row = (places[row, column] for places in grid.centres())
        half = BORDER * probe.radius_mm * px_per_mm
        left, right = (np.clip(at_column + s * half, 0.0, camera.width_px) for s in (-1, 1))
        top, bottom = (np.clip(at_row + s * half, 0.0, camera.height_px) for s in (-1, 1))
        area = View(float(left), float(top), float(right - left), float(bottom - top), SEARCH_PX, SEARCH_PX)
    if miss_mm.min() >= probe.radius_mm:
        x, y = probe.centre_mm
        raise ValueError(
            "light_probe.centre_mm: the ball must lie in the camera's picture, the nearest viewing ray "
            f"passes ({x:g}, {y:g}) mm at {miss_mm.min():.3g} mm, outside the radius of "
            f"{probe.radius_mm:g} mm"
        )
    rows = max(8, round(columns * area.height_px / area.width_px))
    return area._replace(columns=columns, rows=rows)


def _passes(bare: Design, probe: LightProbe, grid: View) -> tuple[Array, float]:
    """How far from the ball's middle viewing rays pass (mm), and sensor pixels a mm next to it."""
    looks = rays(bare, grid)
    slope = np.stack([looks.slope_x, looks.slope_y, np.ones_like(looks.slope_x)], axis=-1)
    upward = slope / np.linalg.norm(slope, axis=-1, keepdims=True)
    away = np.stack([looks.x_mm, looks.y_mm, np.zeros_like(looks.x_mm)], axis=-1) - np.array(probe.middle_mm)
    miss = np.linalg.norm(away - (away * upward).sum(axis=-1, keepdims=True) * upward, axis=-1)
    z = probe.middle_mm[2]
    x = looks.x_mm + looks.slope_x * z
    row, column = np.unravel_index(int(miss.argmin()), miss.shape)
    pitch_mm = abs(np.gradient(x, axis=1)[row, column])
    return miss, float(grid.width_px / grid.columns / pitch_mm)


def cropped(design: Design, probe: LightProbe, view: View) -> tuple[View, tuple[slice, slice]]:
    """Part of a view that shows the ball and a narrow border, and where it lies in it (rows, columns).

    Raises
    ------
    ValueError
        If the view does not show the ball.
    """
    area = probe_view(design, probe, columns=SEARCH_PX)
    across, down = view.width_px / view.columns, view.height_px / view.rows
    left, right = ((x - view.x_px) / across for x in (area.x_px, area.x_px + area.width_px))
    top, bottom = ((y - view.y_px) / down for y in (area.y_px, area.y_px + area.height_px))
    first, last = max(0, int(np.floor(left))), min(view.columns, int(np.ceil(right)))
    upper, lower = max(0, int(np.floor(top))), min(view.rows, int(np.ceil(bottom)))
    if last - first < LEAST_PX or lower - upper < LEAST_PX:
        x, y = probe.centre_mm
        raise ValueError(
            f"light_probe.centre_mm: the picture must show at least {LEAST_PX} x {LEAST_PX} px of the ball, "
            f"that at ({x:g}, {y:g}) mm covers {max(0, last - first)} x {max(0, lower - upper)} of its "
            f"{view.columns} x {view.rows} px"
        )
    part = View(
        view.x_px + first * across,
        view.y_px + upper * down,
        (last - first) * across,
        (lower - upper) * down,
        last - first,
        lower - upper,
    )
    return part, (slice(upper, lower), slice(first, last))
