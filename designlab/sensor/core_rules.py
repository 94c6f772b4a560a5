"""What a gelcore must agree on with the other parts of a design for its light to be simulated."""

from designlab.sensor.optical_properties import Optics
from geometries.elastomer import Elastomer
from geometries.gelcore import Gelcore
from geometries.leds import LedArray


def require_agreement(core: Gelcore, gel: Elastomer, leds: LedArray, optics: Optics) -> None:
    """Refuse a gelcore that does not go with gel, LEDs or optics.

    Raises
    ------
    ValueError
        If it does not; the text names field, value and rule.
    """
    _require_finish(core, leds)
    haze, bright = optics.gelcore_scattering_per_mm, max(optics.housing_reflectance)
    if core.cavity is not None and haze:
        raise ValueError("gelcore.cavity_radius_mm: haze is simulated in solid cores only")
    if core.cavity is not None and bright:
        raise ValueError(
            "gelcore.cavity_radius_mm: what a bright housing mirrors in the window is simulated for "
            "plane windows only"
        )
    if core.wedge_deg is not None:
        for name, value in (
            ("optics.gelcore_scattering_per_mm", haze),
            ("optics.housing_reflectance", bright),
        ):
            if value:
                raise ValueError(
                    f"gelcore.wedge_deg: {name} is simulated under level windows only, got {value:g}; give 0"
                )
        if gel.shape == "dome":
            raise ValueError("gelcore.wedge_deg: a wedge carries a flat or freeform gel, got a dome")
    if core.side_bulge_mm is not None:
        if leds.coupling != "air_gap":
            raise ValueError(
                "gelcore.side_bulge_mm: LEDs beside curved sides are simulated behind an air gap only, "
                f"leds.coupling is {leds.coupling!r}; give 'air_gap' or straight sides"
            )
        if bright:
            raise ValueError(
                "gelcore.side_bulge_mm: optics.housing_reflectance is simulated around straight sides only, "
                f"got {bright:g}; give 0"
            )
    if core.shape == "dome" and gel.shape != "dome":
        raise ValueError("elastomer.shape: a dome gelcore carries a dome elastomer")


def _require_finish(core: Gelcore, leds: LedArray) -> None:
    """Refuse a finish of the sides that LEDs face which does not go with their coupling."""
    finish = core.led_side_finish
    if finish is not None and leds.coupling == "embedded":
        raise ValueError(
            f"gelcore.led_side_finish: no side lets light in where LEDs are embedded, got {finish!r}; "
            "give gelcore.side_finish, which holds for all"
        )
    if finish == "painted" and leds.coupling == "air_gap":
        raise ValueError(
            "gelcore.led_side_finish: 'painted' keeps the light of LEDs behind an air gap out; glue them "
            "on (leds.coupling = 'bonded') or give another finish"
        )
