"""Sensors whose LED groups share packages, and each of these groups alone in the same places."""

from typing import Any

from designlab.sensor.design import Design, preset

AIR, CORE = preset("gelsight-2020-flat"), preset("default")
PLACES_DEG = (90.0, 210.0, 330.0)


def shared(design: Design, changes: dict[str, Any] | None = None) -> Design:
    """Three colours at each of three places; chips of 1 mm where a package holds small ones."""
    places = {f"leds.groups.{group}.azimuth_deg": PLACES_DEG for group in range(3)}
    return design.replace({"mixing": None, **places, **(changes or {})})


def alone(design: Design, group: int) -> Design:
    """One group of a design, nothing of the others."""
    one = {name: (design.per_group(name)[group],) for name in ("membrane_albedo", "board_reflectance")}
    return design.replace(
        {
            "leds.groups": (design.leds.groups[group],),
            "mixing": ((1.0,),) * 3,
            **{f"optics.{name}": value for name, value in one.items()},
        }
    )


APART = {
    "leds.emitting_width_mm": 0.6,
    "leds.emitting_spans_mm": ((-0.3, 0.3),),
    "leds.groups.0.offset_mm": (-0.9, 0.0),
    "leds.groups.1.offset_mm": (0.9, 0.4),
    "leds.groups.2.offset_mm": (0.0, -0.4),
}
"""Chips of `CORE` that lie apart on their package."""
