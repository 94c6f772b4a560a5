"""Random feasible designs: what checks that must hold for any sensor are run on.

One sampler for all of them, so that their figures speak of the same population. Independent numbers are drawn
uniformly from `RANGES`, kinds by `SHARES`; what follows from others (the core's sphere from the membrane's,
the place of LEDs from the core's sides, the camera's height from its field of view) is computed, and a draw
that breaks a rule of `margins` is thrown away and drawn anew.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.sensor.design import Design
from geometries.elastomer import base_mm
from geometries.leds import bodies

MOST_DRAWS = 2000
CORNERS = [(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]


class Range(NamedTuple):
    """Bounds of one number and where they come from."""

    low: float
    high: float
    unit: str
    source: str


PAPER = "2020 prototype, arXiv 2012.13184"
ASSUMED = "assumption"
RANGES: dict[str, Range] = {
    "sensing_width": Range(10.0, 20.0, "mm", f"{PAPER}: 16 x 12; GelSight Mini: 18.6 x 14.3; DIGIT: 19 x 16"),
    "gel_thickness": Range(1.0, 4.0, "mm", "GelSight Mini: 4.25; thinner ones: assumption"),
    "dome_radius": Range(
        12.0, 40.0, "mm", f"fingertips such as OmniTact (arXiv 2003.06965): 15; {PAPER}: 35 assumed there"
    ),
    "core_side": Range(4.0, 15.0, "mm", f"height of the core's sides; {PAPER}: 11.5; others: assumption"),
    "core_margin": Range(1.0, 5.0, "mm", f"core beyond the corners of the sensing area; {ASSUMED}"),
    "draft": Range(0.0, 20.0, "deg", f"{PAPER}: 19"),
    "window_share": Range(0.55, 0.95, "1", f"of the core's width; {PAPER}: 17.8 of 31.4 mm; else {ASSUMED}"),
    "ground_roughness": Range(0.1, 0.5, "1", f"{PAPER}: 0.3"),
    "paint_reflectance": Range(0.0, 0.9, "1", f"from black to a good white; {ASSUMED}"),
    "panel_width": Range(5.0, 12.0, "mm", f"{PAPER}: 9"),
    "panel_strip": Range(1.0, 2.5, "mm", f"{PAPER}: two strips of 2.23"),
    "smd_size": Range(0.6, 3.0, "mm", "emitting faces of common packages, from 0603 to 3528"),
    "smd_gap": Range(0.3, 3.0, "mm", f"between packages of a row; {ASSUMED}"),
    "tilt": Range(0.0, 45.0, "deg", f"{PAPER}: 19"),
    "air_gap": Range(0.2, 2.0, "mm", f"between LED and core; {ASSUMED}"),
    "radius_in_air": Range(9.0, 20.0, "mm", f"{PAPER}: 12.59"),
    "height_in_air": Range(2.0, 14.0, "mm", f"above the membrane below the LEDs; {PAPER}: 8.79"),
    "profile_exponent": Range(1.0, 3.0, "1", "from Lambert's cosine to a beam of 75 deg, as domed packages"),
    "albedo": Range(0.2, 0.8, "1", f"{PAPER}: 0.22 to 0.51; grey and aluminium paints: {ASSUMED}"),
    "board_reflectance": Range(0.0, 0.8, "1", f"{PAPER}: 0.1 to 0.8"),
    "housing_reflectance": Range(0.0, 0.3, "1", f"dark print; {ASSUMED}"),
    "field_of_view": Range(45.0, 85.0, "deg", f"{PAPER}: 53.3; Raspberry Pi camera v2: 62.2"),
    "picture_share": Range(1.05, 1.4, "1", f"picture over sensing area, in width; {ASSUMED}"),
    "camera_offset": Range(-1.5, 1.5, "mm", f"along x and y; {PAPER}: 1.1 and 1.3"),
    "camera_hole": Range(8.0, 20.0, "mm", ASSUMED),
    "housing_gap": Range(0.3, 4.0, "mm", f"around the widest part and above the highest one; {ASSUMED}"),
}
SHARES: dict[str, dict[str, float]] = {
    "shape": {"flat": 1 / 2, "dome": 1 / 2},
    "light_path": {"core": 2 / 3, "air": 1 / 3},
    "package": {"panel": 1 / 2, "smd": 1 / 2},
    "coupling": {"air_gap": 1 / 2, "bonded": 1 / 2},  # of LEDs that shine into a core, where they fit
    "core": {"hexagonal": 2 / 3, "slab": 1 / 3},  # of flat gels
    "side_finish": {"polished": 1 / 3, "ground": 1 / 3, "painted": 1 / 3},
    "gelcore_material": {"acrylic": 1 / 2, "resin-2020": 1 / 2},
    "drafted": {"yes": 1 / 3, "no": 2 / 3},
    "strips": {"1": 1 / 2, "2": 1 / 2},
    "count": {"1": 1 / 4, "2": 1 / 4, "3": 1 / 4, "4": 1 / 4},  # SMDs in a row
    "white_housing": {"yes": 1 / 3, "no": 2 / 3},
}
PATH_LENGTH = {"core": 16, "air": 4}
CLEAR_OF_MEMBRANE_MM = 0.5  # light in air: least distance of an LED from the membrane below it


def random_design(seed: int) -> Design:
    """Draw a feasible design: all its margins are negative or zero.

    Shape, light path and the dome's radius are drawn once, before anything can be thrown away, so that their
    shares hold among feasible designs; other numbers shift towards those that fit together more often.

    Parameters
    ----------
    seed : int
        Same seed, same design.

    Raises
    ------
    RuntimeError
        If no draw is feasible.
    """
    draw = _Draw(np.random.default_rng([seed, 20]))
    shape, light_path, radius = draw.kind("shape"), draw.kind("light_path"), draw.number("dome_radius")
    for _ in range(MOST_DRAWS):
        try:
            design = Design.model_validate(
                _content(draw, shape, light_path, radius) | {"name": f"random-{seed}"}
            )
            if max(design.margins().values()) <= 0 and _clears_membrane(design):
                design.view(160)
                return design
        except ValueError:  # includes InfeasibleDesign: parts that cannot be put together at all
            continue
    raise RuntimeError(f"seed {seed}: none of {MOST_DRAWS} draws of a {shape} sensor is feasible")


class _Draw:
    def __init__(self, random: np.random.Generator) -> None:
        self._random = random

    def number(self, name: str) -> float:
        return float(self._random.uniform(*RANGES[name][:2]))

    def kind(self, name: str) -> str:
        shares = SHARES[name]
        return str(self._random.choice(list(shares), p=list(shares.values())))

    def between(self, low: float, high: float) -> float:
        if high < low:
            raise ValueError(f"nothing lies between {low:g} and {high:g}")
        return float(self._random.uniform(low, high))


def _content(draw: _Draw, shape: str, light_path: str, radius: float) -> dict[str, Any]:
    """Fields of a design that may break rules."""
    thickness = draw.number("gel_thickness")
    width = draw.number("sensing_width")
    if shape == "dome":
        width = min(width, 0.96 * radius)  # corners lie within 37 deg of the apex
    height = 0.75 * width
    across = math.hypot(width, height) + 2 * draw.number("core_margin")
    if shape == "dome":
        across = min(across, 1.9 * (radius - thickness))
        core, gel = _dome(draw, across, thickness, radius)
    else:
        core, gel = _flat(draw, across, thickness)
    core |= {
        "window_diameter_mm": draw.number("window_share") * across,
        "side_finish": draw.kind("side_finish"),
        "ground_roughness": draw.number("ground_roughness"),
        "paint_reflectance": draw.number("paint_reflectance"),
    }
    leds = _leds(draw, core, gel, light_path)
    content: dict[str, Any] = {
        "description": "Drawn by benchmarks/random_designs.py.",
        "sensing_area_mm": (width, height),
        "gelcore": core,
        "elastomer": gel,
        "leds": leds,
        "optics": {
            "light_path": light_path,
            "gelcore_material": draw.kind("gelcore_material"),
            "membrane_albedo": [draw.number("albedo") for _ in range(3)],
            "board_reflectance": [draw.number("board_reflectance")],
            "housing_reflectance": [
                draw.number("housing_reflectance") if draw.kind("white_housing") == "yes" else 0.0
            ],
            "path_length": PATH_LENGTH[light_path],
        },
    }
    design = Design.model_validate(content)
    return content | {"housing": _housing(draw, design), "camera": _camera(draw, design)}


def _flat(draw: _Draw, across: float, thickness: float) -> tuple[dict[str, Any], dict[str, Any]]:
    kind = draw.kind("core")
    draft = draw.number("draft") if draw.kind("drafted") == "yes" else 0.0
    core = {
        "shape": kind,
        "width_mm": across,
        "length_mm": across,
        "height_mm": draw.number("core_side"),
        "draft_deg": draft,
    }
    outline = "hexagon" if kind == "hexagonal" else "rectangle"
    gel = {"shape": "flat", "outline": outline, "thickness_mm": thickness}
    return core, gel | {"width_mm": across, "length_mm": across}


def _dome(
    draw: _Draw, across: float, thickness: float, radius: float
) -> tuple[dict[str, Any], dict[str, Any]]:
    inner, rim = radius - thickness, across / 2
    cap = inner - math.sqrt(inner**2 - rim**2)
    core = {
        "shape": "dome",
        "width_mm": across,
        "height_mm": cap + draw.number("core_side"),
        "radius_mm": inner,
    }
    gel = {"shape": "dome", "outline": "round", "thickness_mm": thickness, "radius_mm": radius}
    return core, gel | {"width_mm": across - 0.2}


def _leds(draw: _Draw, core: dict[str, Any], gel: dict[str, Any], light_path: str) -> dict[str, Any]:
    panel, domed = draw.kind("package") == "panel", core["shape"] == "dome"
    coupling = draw.kind("coupling") if light_path == "core" else "air_gap"
    if domed and panel:
        coupling = "air_gap"  # a flat panel cannot be glued to a round side
    leds = (_panel(draw) if panel else _smd(draw)) | {
        "layout": "ring" if domed and not panel else "edge",
        "coupling": coupling,
        "profile": {"exponent": draw.number("profile_exponent")},
        "groups": [
            {"name": colour, "azimuth_deg": [azimuth], "count": draw_count, "flux_mw": 30.0}
            | {"wavelength_nm": wavelength}
            for (colour, wavelength), azimuth, draw_count in zip(
                (("red", 625.0), ("green", 525.0), ("blue", 465.0)),
                (0.0, 90.0, 180.0) if core["shape"] == "slab" else (90.0, 210.0, 330.0),
                [1 if panel else int(draw.kind("count"))] * 3,
                strict=True,
            )
        ],
    }
    draft = math.radians(core.get("draft_deg", 0.0))
    tilt = draft if coupling == "bonded" else math.radians(draw.number("tilt"))
    leds["tilt_deg"] = math.degrees(tilt)
    if light_path == "air":
        radius = draw.number("radius_in_air")
        below = 0.0
        if domed:  # beside the gel, they shine over its rim
            reach = min(radius, gel["width_mm"] / 2)
            below = gel["radius_mm"] - math.sqrt(gel["radius_mm"] ** 2 - reach**2)
        return leds | {"radius_mm": radius, "height_mm": below + draw.number("height_in_air")}
    # Emitting faces stand beside the core's sides, over their full height.
    reach = max(abs(end) for span in leds["emitting_spans_mm"] for end in span) * math.cos(tilt)
    window = gel["thickness_mm"] + core["height_mm"]
    lowest = window - _side_mm(core)
    height = draw.between(lowest + reach, window - reach)
    apothem = core["width_mm"] / 2
    if coupling == "bonded":
        leds["glue_mm"] = 0.3 if domed else 0.1
        return leds | {"height_mm": height, "radius_mm": apothem - (height - lowest) * math.tan(draft) + 0.01}
    front = apothem + draw.number("air_gap") + leds["body_height_mm"] / 2 * math.sin(tilt)
    return leds | {"height_mm": height, "radius_mm": front}


def _side_mm(core: dict[str, Any]) -> float:
    """Height of the core's sides."""
    if core["shape"] != "dome":
        return float(core["height_mm"])
    inner, rim = core["radius_mm"], core["width_mm"] / 2
    return float(core["height_mm"] - inner + math.sqrt(inner**2 - rim**2))


def _panel(draw: _Draw) -> dict[str, Any]:
    width, strip = draw.number("panel_width"), draw.number("panel_strip")
    spans = (
        [(-strip / 2, strip / 2)]
        if draw.kind("strips") == "1"
        else [(-strip - 0.5, -0.5), (0.5, strip + 0.5)]
    )
    return {
        "package": "panel",
        "emitting_width_mm": width,
        "emitting_spans_mm": spans,
        "body_width_mm": width,
        "body_height_mm": 2 * spans[-1][1] + 0.1,
        "body_thickness_mm": 1.6,
    }


def _smd(draw: _Draw) -> dict[str, Any]:
    width, height = draw.number("smd_size"), draw.number("smd_size")
    return {
        "package": "smd",
        "emitting_width_mm": width,
        "emitting_spans_mm": [(-height / 2, height / 2)],
        "body_width_mm": width + 0.6,
        "body_height_mm": height + 0.6,
        "body_thickness_mm": 1.0,
        "pitch_mm": width + 0.6 + draw.number("smd_gap"),
    }


def _housing(draw: _Draw, design: Design) -> dict[str, Any]:
    corners = _corners(design)
    width = design.gelcore.width_mm / 2
    corner = {"hexagonal": 2 / math.sqrt(3), "slab": math.sqrt(2), "dome": 1.0}[design.gelcore.shape]
    highest = max(float(corners[:, 2].max()), design.elastomer.thickness_mm + design.gelcore.height_mm)
    widest = max(float(np.hypot(corners[:, 0], corners[:, 1]).max()), width * corner)
    return {
        "inner_radius_mm": widest + draw.number("housing_gap"),
        "top_mm": highest + draw.number("housing_gap"),
        "camera_hole_mm": draw.number("camera_hole"),
    }


def _camera(draw: _Draw, design: Design) -> dict[str, Any]:
    view = draw.number("field_of_view")
    width = design.sensing_area_mm[0] * draw.number("picture_share")
    distance = width / 2 / math.tan(math.radians(view / 2))
    if design.optics.light_path == "core":
        # Glass brings the membrane nearer, by 1 - 1/n of its thickness.
        distance += design.elastomer.thickness_mm * (1 - 1 / design.optics.gel_index)
        distance += design.gelcore.height_mm * (1 - 1 / design.optics.core_index)
    position = (draw.number("camera_offset"), draw.number("camera_offset"), distance)
    return {
        "position_mm": position,
        "horizontal_fov_deg": view,
        "width_px": 1640,
        "height_px": 1232,
        "body_radius_mm": 4.0,
    }


def _corners(design: Design) -> NDArray[np.float64]:
    """Corners of all LED bodies, shape (n, 3), mm."""
    found = []
    for body in bodies(design.leds):
        axes = np.array([body.across, body.down, body.normal]) * np.array(body.half_mm)[:, None]
        found.append(np.asarray(body.centre_mm) + np.array(CORNERS) @ axes)
    return np.concatenate(found)


def _clears_membrane(design: Design) -> bool:
    """Whether LEDs in air stand off the membrane below them, or its rim; no rule of a design asks for it."""
    if design.optics.light_path == "core":
        return True
    x, y, z = _corners(design).T
    inward = np.minimum(1.0, design.elastomer.width_mm / 2 / np.hypot(x, y))
    base = base_mm(design.elastomer, inward * x, inward * y)
    return bool((z >= base + CLEAR_OF_MEMBRANE_MM).all())
