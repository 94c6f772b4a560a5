"""Default parameters of a study vary the light of a sensor, as far as its drawing leaves room.

What is pressed (the gel and its shape), the camera, and what comes with an LED (its beam, its colour) stay.
"""

import math
from collections.abc import Iterator, Mapping, Sequence

from designlab.optimization.study.parameter import Parameter, Tied
from designlab.sensor.design import Design, DesignError
from geometries.leds import LedArray

STEPS = 64  # of each half of a range that are looked at for the last one that can be built
FINISHES = ("ground", "painted", "polished")
LEAST_ROOM = 0.05  # of the range looked at; where less can be built, a field is not worth a dimension

# Reaches to either side of the base.
HEIGHT_MM, RADIUS_MM, TILT_DEG = 6.0, 4.0, 40.0
# Whole ranges: emitting width of panels, spacing of rows over that of the base, and reflectances.
PANEL_MM, SPACING, PAINT, BOARD, COATING = (4.0, 15.0), (0.5, 2.0), (0.0, 0.9), (0.05, 0.9), (0.1, 0.9)


def default_parameters(base: Design) -> dict[str, Parameter]:
    """Parameters that a study of a design varies by default.

    Where the LEDs stand and how they lean (of bonded ones, how far up the core's side), the width of panels
    or the spacing of rows, finish and paint of a core that light passes through, reflectance of the boards
    and of the membrane's coating. Each range reaches as far as the geometric rules allow with all else as in
    the base, which it holds.

    Parameters
    ----------
    base : Design
        A feasible design.

    Returns
    -------
    dict of str to Parameter
        By dotted path; empty if the design breaks a rule.
    """
    if base.broken():
        return {}
    found = {}
    for path, value, reach, also in _candidates(base):
        low, high = (_furthest(base, path, value, end, also) for end in reach)
        if high - low >= LEAST_ROOM * (reach[1] - reach[0]):
            found[path] = Parameter(low=low, high=high, also=also)
    if base.optics.light_path == "core":
        finishes = tuple(f for f in FINISHES if _can_be_built(base, {"gelcore.side_finish": f}))
        if len(finishes) > 1:
            found["gelcore.side_finish"] = Parameter(choices=finishes)
    return found


def _candidates(
    base: Design,
) -> Iterator[tuple[str, float, tuple[float, float], dict[str, float | Tied]]]:
    """Path, value in the base, ends of the range to look at, and fields that move along."""
    leds, optics = base.leds, base.optics
    bonded = leds.coupling == "bonded"
    lean = math.tan(math.radians(base.gelcore.draft_deg)) if base.gelcore.shape != "dome" else 0.0
    along = _apart(leds, "height_mm")
    if bonded and lean:
        sunk = lean * leds.height_mm
        along["leds.radius_mm"] = Tied(times=-lean, plus=leds.radius_mm + sunk)
        for group, radius_mm in leds.own("radius_mm").items():
            along[f"leds.groups.{group}.radius_mm"] = Tied(times=-lean, plus=radius_mm + sunk)
    yield "leds.height_mm", leds.height_mm, _around(leds.height_mm, HEIGHT_MM), along
    if not bonded:
        yield "leds.radius_mm", leds.radius_mm, _around(leds.radius_mm, RADIUS_MM), _apart(leds, "radius_mm")
        yield "leds.tilt_deg", leds.tilt_deg, _around(leds.tilt_deg, TILT_DEG), _apart(leds, "tilt_deg")
    if leds.package == "panel":
        width = leds.emitting_width_mm
        wider: dict[str, float | Tied] = {
            "leds.body_width_mm": leds.body_width_mm - width,
            "leds.pitch_mm": leds.pitch_mm - width,
            **{f"leds.groups.{k}.pitch_mm": pitch_mm - width for k, pitch_mm in leds.own("pitch_mm").items()},
        }
        yield "leds.emitting_width_mm", width, PANEL_MM, wider
    elif any(group.count > 1 for group in leds.groups):
        own: dict[str, float | Tied] = {
            f"leds.groups.{k}.pitch_mm": Tied(times=pitch_mm / leds.pitch_mm, plus=0.0)
            for k, pitch_mm in leds.own("pitch_mm").items()
        }
        yield "leds.pitch_mm", leds.pitch_mm, (SPACING[0] * leds.pitch_mm, SPACING[1] * leds.pitch_mm), own
    if optics.light_path == "core":
        yield "gelcore.paint_reflectance", base.gelcore.paint_reflectance, PAINT, {}
    yield _together("optics.board_reflectance", optics.board_reflectance, BOARD)
    yield _together("optics.membrane_albedo", optics.membrane_albedo, COATING)


def _apart(leds: LedArray, field: str) -> dict[str, float | Tied]:
    """Groups that have a field of their own: they move along, as far apart as they are."""
    return {
        f"leds.groups.{group}.{field}": value - getattr(leds, field)
        for group, value in leds.own(field).items()
    }


def _around(value: float, reach: float) -> tuple[float, float]:
    return value - reach, value + reach


def _together(
    path: str, values: Sequence[float], reach: tuple[float, float]
) -> tuple[str, float, tuple[float, float], dict[str, float | Tied]]:
    """Values of the LED groups, in proportion: the largest leads."""
    first = max(range(len(values)), key=lambda k: values[k])
    largest = values[first]
    also: dict[str, float | Tied] = {
        f"{path}.{k}": Tied(times=value / largest if largest else 1.0, plus=0.0)
        for k, value in enumerate(values)
        if k != first
    }
    return f"{path}.{first}", largest, reach, also


def _furthest(base: Design, path: str, value: float, end: float, also: Mapping[str, float | Tied]) -> float:
    """Value furthest towards an end of the range up to which the design can be built."""
    moved = Parameter(low=min(value, end) - 1, high=max(value, end) + 1, also=dict(also))

    def at(step: int) -> float:
        return round(value + (end - value) * step / STEPS, 2) if step else value

    # Rules are met on one stretch around the base.
    good, bad = 0, STEPS + 1
    while bad - good > 1:
        middle = (good + bad) // 2
        if _can_be_built(base, moved.fields(path, at(middle))):
            good = middle
        else:
            bad = middle
    return at(good)


def _can_be_built(base: Design, changes: Mapping[str, object]) -> bool:
    try:
        return not base.replace(dict(changes)).broken()
    except DesignError:
        return False
