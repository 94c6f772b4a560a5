"""Effects of the membrane's coating."""

from functools import lru_cache
from itertools import product
from typing import ClassVar

import numpy as np
from numpy.polynomial.chebyshev import chebval2d

from designlab.core.types import Array
from designlab.sensor.design import Design
from designlab.sensor.optical_constants import internal_reflectance
from designlab.simulation.effects.base import Effect, EffectParameter, Light, Part, Sight, Stage, Values

BLOT_WAVES = 6, 5  # half waves over the area's width and height from which none is part of a blot


class AlbedoField(Effect):
    """The coating is uneven: its reflectance varies slowly over the membrane, or in a blot."""

    name: ClassVar[str] = "albedo_field"
    stage: ClassVar[Stage] = "material"
    summary: ClassVar[str] = "the coating's reflectance varies over the membrane"
    changes: ClassVar[tuple[Part, ...]] = ("light",)
    transferable: ClassVar[bool] = False  # how one coating was sprayed

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """A quadratic field; sprayed and brushed coatings vary by some 5 % (estimate)."""
        return tuple(
            EffectParameter(
                term, "1", 0.0, 0.05, -0.5, 0.5, f"relative reflectance, term {term}, at the area's edge"
            )
            for term in ("x", "y", "xx", "xy", "yy")
        )

    def finer_parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Half waves beyond the quadratic, down to some 3 mm of 16: a blot is made of all (estimate)."""
        return tuple(
            EffectParameter(name, "1", 0.0, 0.03, -0.5, 0.5, f"relative reflectance, {k} and {m} half waves")
            for name, k, m in _blot_waves()
        )

    def on_light(self, light: Light, values: Values, sight: Sight) -> Light:
        """Multiply by the field at the membrane point a pixel sees; light that goes round is not changed."""
        return np.asarray(light * (1.0 + albedo_field(values, sight)), dtype=light.dtype)


def albedo_field(values: Values, sight: Sight) -> Light:
    """Relative departure of the reflectance at every pixel, shape (rows, columns)."""
    turn = np.exp(-1j * np.radians(sight.gel_rotation_deg))
    place = turn * (sight.seen_mm[0] + 1j * sight.seen_mm[1])
    width, height = sight.design.sensing_area_mm
    u, v = 2 * place.real / width, 2 * place.imag / height
    terms = {"x": u, "y": v, "xx": u**2 - 1 / 3, "xy": u * v, "yy": v**2 - 1 / 3}
    field: Array = np.asarray(sum(values[name] * term for name, term in terms.items()))
    amplitudes = np.zeros(BLOT_WAVES)
    for name, k, m in _blot_waves():
        amplitudes[k, m] = values.get(name, 0.0)
    if amplitudes.any():  # Chebyshev polynomials of cosines are the waves
        field = field + chebval2d(np.cos(np.pi * (u + 1) / 2), np.cos(np.pi * (v + 1) / 2), amplitudes)
    return field


@lru_cache(maxsize=1)
def _blot_waves() -> tuple[tuple[str, int, int], ...]:
    """Name of each half wave of a blot, and how many of them lie along x and y."""
    most_x, most_y = BLOT_WAVES
    orders = product(range(most_x), range(most_y))
    return tuple(
        (f"wave_{k}_{m}", k, m) for k, m in orders if k + m > 2 and (k / most_x) ** 2 + (m / most_y) ** 2 < 1
    )


class SpecularCoat(Effect):
    """The coating is glossy: part of the light leaves in a lobe."""

    name: ClassVar[str] = "specular_coat"
    stage: ClassVar[Stage] = "material"
    summary: ClassVar[str] = "the coating is glossy"
    changes: ClassVar[tuple[Part, ...]] = ("design",)
    transferable: ClassVar[bool] = True  # what the coating is made of

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Up to 15 % in the lobe for metal flakes; alpha 0.25 to 0.5 are exponents of 30 to 6 (estimate)."""
        rough = design.optics.coating_roughness if design.optics.coating_specular else 0.35
        return (
            EffectParameter(
                "share",
                "1",
                0.0,
                0.075,
                -design.optics.coating_specular,
                0.6,
                "added share of the glossy lobe",
            ),
            EffectParameter("roughness", "1", rough, 0.1, 0.1, 0.8, "GGX alpha of the lobe", shape=True),
        )

    def on_design(self, design: Design, values: Values) -> Design:
        """Add to the glossy share."""
        if not values["share"]:
            return design
        share = min(max(design.optics.coating_specular + values["share"], 0.0), 1.0)
        return design.replace(
            {"optics.coating_specular": share, "optics.coating_roughness": values["roughness"]}
        )


class Translucency(Effect):
    """The coating leaks: the pressed object shines through where it touches."""

    name: ClassVar[str] = "translucency"
    stage: ClassVar[Stage] = "material"
    summary: ClassVar[str] = "the pressed object shines through the coating"
    changes: ClassVar[tuple[Part, ...]] = ("design",)
    transferable: ClassVar[bool] = True  # what the coating is made of
    needs_touch: ClassVar[bool] = True

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Thin coats let up to 20 % pass (estimate); the object's reflectance is seldom known."""
        return (
            _leak(design, sd=0.1),
            EffectParameter(
                "object", "1", 0.5, 0.25, 0.0, 1.0, "diffuse reflectance of the pressed object", shape=True
            ),
        )

    def on_design(self, design: Design, values: Values) -> Design:
        """Let light through the coating, with an object behind it."""
        if not values["transmittance"]:
            return design
        return design.replace(
            {
                "optics.coating_transmittance": design.optics.coating_transmittance + values["transmittance"],
                "optics.object_reflectance": values["object"],
            }
        )


class Wetting(Effect):
    """The coating leaks: it turns darker where a probe touches it.

    Behind an untouched coating the skin ends at air, which sends back most of the diffuse light that got
    through. A dark probe pressed against the skin takes this light.
    """

    name: ClassVar[str] = "wetting"
    stage: ClassVar[Stage] = "material"
    summary: ClassVar[str] = "the coating turns darker where it is touched"
    changes: ClassVar[tuple[Part, ...]] = ("design",)
    transferable: ClassVar[bool] = True  # what the coating is made of
    needs_touch: ClassVar[bool] = True
    by_name: ClassVar[bool] = True  # nothing of several presses was learnt with it

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """As much as the released press of 2020 asks for, see the preset ``gelsight-2020-flat-elastic``."""
        return (_leak(design, sd=0.2),)

    def on_design(self, design: Design, values: Values) -> Design:
        """Let light through, to air and, where it is touched, to the object, black unless stated."""
        if not values["transmittance"]:
            return design
        return design.replace(
            {
                "optics.coating_transmittance": design.optics.coating_transmittance + values["transmittance"],
                "optics.backing_reflectance": design.optics.backing_reflectance
                or internal_reflectance(design.optics.gel_index),
            }
        )


def _leak(design: Design, *, sd: float) -> EffectParameter:
    """What a coating lets through, with reflection no more than all light."""
    room = 1.0 - max(design.per_group("membrane_albedo")) - design.optics.coating_transmittance
    return EffectParameter(
        "transmittance",
        "1",
        0.0,
        sd,
        0.0,
        min(0.4, max(room, 0.01)),
        "added transmittance of the coating",
        squared=True,  # light goes through it and back
    )


EFFECTS: tuple[Effect, ...] = (AlbedoField(), SpecularCoat(), Translucency(), Wetting())
"""In the order in which they act."""
