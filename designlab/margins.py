"""The geometric rules of a design, as signed distances in mm: positive means violated."""

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from geometries import elastomer, gelcore
from geometries.leds import Body, bodies

if TYPE_CHECKING:
    from designlab.design import Design

MINIMUM_WALL_MM = 0.8  # two lines of a 0.4 mm nozzle: the thinnest wall that common printers close reliably
MINIMUM_GEL_MM = 0.5  # thinner gels tear when they are taken out of the mould

RULES: dict[str, str] = {
    "leds_inside_housing": "every LED body lies inside the housing's inner radius",
    "leds_below_plate": "every LED body lies below the camera plate",
    "leds_above_membrane": "every LED body lies above the membrane plane",
    "leds_clear_of_core": "no LED body reaches into gelcore or elastomer",
    "leds_clear_of_each_other": "LED bodies do not overlap",
    "leds_outside_view": "no LED body stands between the camera and the sensing area",
    "core_inside_housing": "gelcore and elastomer fit into the housing",
    "core_below_plate": "the gelcore ends below the camera plate",
    "elastomer_on_core": "the elastomer does not reach beyond the gelcore",
    "dome_radius": "a dome's radius exceeds half its width",
    "dome_core": "gelcore and elastomer of a dome are concentric spheres",
    "sensing_area_on_membrane": "the sensing area lies on the membrane",
    "camera_sees_membrane": "the sensing area lies inside the camera's field of view",
    "camera_above_core": "the camera stands above the gelcore",
    "camera_clears_plate": "the lens fits through the hole of the camera plate",
    "view_through_window": "the camera sees the sensing area through the gelcore's clear window",
    "minimum_wall": f"housing walls are at least {MINIMUM_WALL_MM} mm thick",
    "minimum_gel": f"the gel is at least {MINIMUM_GEL_MM} mm thick",
}


def margins(design: "Design") -> dict[str, float]:
    """Signed distance to every rule in `RULES` that applies to the design, in mm; positive means violated."""
    values = _led_margins(design) | _body_margins(design) | _camera_margins(design)
    return {rule: float(values[rule]) for rule in RULES if math.isfinite(values[rule])}


def _led_margins(design: "Design") -> dict[str, float]:
    boxes = bodies(design.leds)
    corners = np.concatenate([_corners(box) for box in boxes])
    radius = np.hypot(corners[:, 0], corners[:, 1])
    centres = np.array([box.centre_mm for box in boxes])
    spacing = np.inf
    if len(boxes) > 1:
        distance = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
        np.fill_diagonal(distance, np.inf)
        spacing = float(distance.min())
    return {
        "leds_inside_housing": radius.max() - design.housing.inner_radius_mm,
        "leds_below_plate": corners[:, 2].max() - design.housing.top_mm,
        "leds_above_membrane": -corners[:, 2].min(),
        "leds_clear_of_core": _overlap_with_core(design, corners),
        "leds_clear_of_each_other": design.leds.body_width_mm - spacing,
        "leds_outside_view": _intrusion_into_view(design, corners),
    }


def _corners(box: Body) -> NDArray[np.float64]:
    axes = np.array([box.across, box.down, box.normal]) * np.array(box.half_mm)[:, None]
    signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    return np.asarray(np.asarray(box.centre_mm) + signs @ axes)


def _overlap_with_core(design: "Design", corners: NDArray[np.float64]) -> float:
    """How deep LED corners reach into the prism of gelcore and elastomer (light in air: no core, no rule)."""
    if design.optics.light_path == "air":
        return -math.inf
    core, top = design.gelcore, design.elastomer.thickness_mm + design.gelcore.height_mm
    polygon = gelcore.polygon(core)
    edge = np.roll(polygon, -1, axis=0) - polygon
    outward = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.linalg.norm(edge, axis=1, keepdims=True)
    # A drafted side recedes towards the camera, so its lower edge is the nearest.
    side = ((corners[:, None, :2] - polygon[None]) * outward[None]).sum(-1).max(axis=1)
    outside = np.maximum(side, corners[:, 2] - top)
    return float(-outside.min())


def _intrusion_into_view(design: "Design", corners: NDArray[np.float64]) -> float:
    """How far LED corners, seen from the camera, reach into the sensing area, on the membrane plane."""
    x_c, y_c, z_c = design.camera.position_mm
    below = corners[corners[:, 2] < z_c - 1e-6]
    if len(below) == 0:
        return -math.inf
    scale = z_c / (z_c - below[:, 2])
    x = x_c + (below[:, 0] - x_c) * scale
    y = y_c + (below[:, 1] - y_c) * scale
    half_w, half_h = design.sensing_area_mm[0] / 2, design.sensing_area_mm[1] / 2
    return float(np.minimum(half_w - np.abs(x), half_h - np.abs(y)).max())


def _body_margins(design: "Design") -> dict[str, float]:
    core, gel, housing = design.gelcore, design.elastomer, design.housing
    core_polygon = gelcore.polygon(core)
    gel_polygon = elastomer.polygon(gel)
    dome_radius, dome_core = -math.inf, -math.inf
    if gel.shape == "dome" and gel.radius_mm is not None:
        dome_radius = gel.width_mm / 2 - gel.radius_mm
        if core.shape == "dome" and core.radius_mm is not None:
            # 10 um is what a mould reproduces; a larger difference means a gel of uneven thickness.
            dome_core = abs(core.radius_mm - (gel.radius_mm - gel.thickness_mm)) - 0.01
        else:
            dome_core = gel.radius_mm  # a flat core under a dome gel: not concentric at all
    reach = max(np.hypot(*core_polygon.T).max(), np.hypot(*gel_polygon.T).max())
    return {
        "core_inside_housing": float(reach) - housing.inner_radius_mm,
        "core_below_plate": gel.thickness_mm + core.height_mm - housing.top_mm,
        "elastomer_on_core": _beyond(gel_polygon, core_polygon),
        "dome_radius": dome_radius,
        "dome_core": dome_core,
        "minimum_wall": MINIMUM_WALL_MM - min(housing.wall_mm, housing.plate_mm),
        "minimum_gel": MINIMUM_GEL_MM - gel.thickness_mm,
    }


def _beyond(points: NDArray[np.float64], polygon: NDArray[np.float64]) -> float:
    """Largest signed distance of points to a convex counter-clockwise polygon, positive outside.

    1 um is forgiven.
    """
    edge = np.roll(polygon, -1, axis=0) - polygon
    outward = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.linalg.norm(edge, axis=1, keepdims=True)
    return float(((points[:, None] - polygon[None]) * outward[None]).sum(-1).max()) - 1e-3


def _camera_margins(design: "Design") -> dict[str, float]:
    camera, housing, core = design.camera, design.housing, design.gelcore
    x_c, y_c, z_c = camera.position_mm
    half_w, half_h = design.sensing_area_mm[0] / 2, design.sensing_area_mm[1] / 2
    gel = design.elastomer
    polygon = elastomer.polygon(gel)
    corners = np.array([(sx * half_w, sy * half_h) for sx in (-1, 1) for sy in (-1, 1)])
    window = gel.thickness_mm + core.height_mm
    depth = z_c  # a dome's edge is nearer to the camera, so the apex plane sets the width of the view
    field_w = depth * math.tan(math.radians(camera.horizontal_fov_deg) / 2)
    field_h = field_w * camera.height_px / camera.width_px
    sees = max(half_w + abs(x_c) - field_w, half_h + abs(y_c) - field_h)
    # Straight lines overestimate the width of the view at the window: refraction bends rays towards the axis.
    share = max(0.0, min(1.0, (z_c - window) / z_c)) if z_c > 0 else 0.0
    at_window = np.hypot(x_c + (corners[:, 0] - x_c) * share, y_c + (corners[:, 1] - y_c) * share)
    through = (
        float(at_window.max()) - core.window_diameter_mm / 2
        if design.optics.light_path == "core"
        else -math.inf
    )
    return {
        "sensing_area_on_membrane": _beyond(corners, polygon),
        "camera_sees_membrane": sees,
        "camera_above_core": window - z_c,
        "camera_clears_plate": 2 * camera.body_radius_mm - housing.camera_hole_mm,
        "view_through_window": through,
    }
