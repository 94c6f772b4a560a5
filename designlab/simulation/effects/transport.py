"""Effects of what light meets between the LEDs and the camera."""

from typing import ClassVar

from designlab.sensor.design import Design
from designlab.simulation.effects.base import Effect, EffectParameter, Part, Stage, Values


class Interreflection(Effect):
    """More or less light goes round: boards or membrane reflect otherwise than assumed."""

    name: ClassVar[str] = "interreflection"
    stage: ClassVar[Stage] = "transport"
    summary: ClassVar[str] = "boards or membrane send more or less light round"
    changes: ClassVar[tuple[Part, ...]] = ("design",)
    transferable: ClassVar[bool] = True  # materials

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Reflectance of white and black solder mask differs by far more than 0.15 (estimate)."""
        return (
            EffectParameter(
                "boards", "1", 0.0, 0.15, -1.0, 1.0, "added to the reflectance of the LED boards"
            ),
            EffectParameter(
                "albedo_ratio",
                "1",
                1.0,
                0.15,
                0.3,
                2.5,
                "albedo of the membrane over its nominal value, the flux divided by it: the first reflection "
                "stays, later ones change",
            ),
        )

    def on_design(self, design: Design, values: Values) -> Design:
        """Change the reflectances, each kept within 0 and 1."""
        ratio = values["albedo_ratio"]
        changes: dict[str, object] = {}
        if values["boards"]:
            added = [min(max(r + values["boards"], 0.0), 1.0) for r in design.per_group("board_reflectance")]
            changes["optics.board_reflectance"] = tuple(added)
        if ratio != 1.0:
            room = 1.0 - design.optics.coating_transmittance
            albedo = [min(a * ratio, room) for a in design.per_group("membrane_albedo")]
            changes["optics.membrane_albedo"] = tuple(albedo)
            for number, group in enumerate(design.leds.groups):
                own = albedo[number] / design.per_group("membrane_albedo")[number]
                changes[f"leds.groups.{number}.flux_mw"] = group.flux_mw / own
        return design.replace(changes) if changes else design


class GelcoreIndex(Effect):
    """Gelcore or elastomer refract otherwise than assumed."""

    name: ClassVar[str] = "gelcore_index"
    stage: ClassVar[Stage] = "transport"
    summary: ClassVar[str] = "gelcore or elastomer refract otherwise"
    changes: ClassVar[tuple[Part, ...]] = ("design",)
    transferable: ClassVar[bool] = True  # material

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Clear resins have 1.505 to 1.533 over the visible (Opt. Mater. Express 11, 2021, 3392)."""
        if design.optics.light_path != "core":
            return ()
        return tuple(
            EffectParameter(part, "1", 0.0, 0.02, -0.3, 0.3, f"added to the refractive index of the {part}")
            for part in ("gelcore", "elastomer")
        )

    def on_design(self, design: Design, values: Values) -> Design:
        """Add to the indices."""
        nominal = {"gelcore": design.optics.core_index, "elastomer": design.optics.gel_index}
        changes = {
            f"optics.{part}_index": max(nominal[part] + added, 1.0) for part, added in values.items() if added
        }
        return design.replace(changes) if changes else design


class Absorption(Effect):
    """The gelcore swallows light on its way."""

    name: ClassVar[str] = "absorption"
    stage: ClassVar[Stage] = "transport"
    summary: ClassVar[str] = "the gelcore absorbs light"
    changes: ClassVar[tuple[Part, ...]] = ("design",)
    transferable: ClassVar[bool] = True  # material

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """One coefficient a group; printed resins have up to 0.01 per mm (Appl. Opt. 60, 2021, 6573)."""
        if design.optics.light_path != "core":
            return ()
        return tuple(
            EffectParameter(
                f"{group}_per_mm",
                "1/mm",
                0.0,
                0.005,
                0.0,
                0.2,
                "added to the absorption coefficient",
                group=group,
            )
            for group in design.group_names
        )

    def on_design(self, design: Design, values: Values) -> Design:
        """Add to the coefficients of the gelcore."""
        if not any(values.values()):
            return design
        added = [values[f"{group}_per_mm"] for group in design.group_names]
        found = [a + b for a, b in zip(design.absorption_per_mm("gelcore"), added, strict=True)]
        return design.replace({"optics.gelcore_absorption_per_mm": tuple(found)})


class CoreScatter(Effect):
    """The gelcore is hazy."""

    name: ClassVar[str] = "core_scatter"
    stage: ClassVar[Stage] = "transport"
    summary: ClassVar[str] = "the gelcore scatters light"
    changes: ClassVar[tuple[Part, ...]] = ("design",)
    transferable: ClassVar[bool] = True  # material

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """One coefficient; printed clear parts have up to 0.02 per mm (Appl. Opt. 60, 2021, 6573)."""
        if (
            design.optics.light_path != "core"
            or design.gelcore.cavity is not None
            or design.gelcore.wedge_deg
        ):
            return ()
        return (
            EffectParameter("per_mm", "1/mm", 0.0, 0.01, 0.0, 0.5, "added to the scattering coefficient"),
        )

    def on_design(self, design: Design, values: Values) -> Design:
        """Add to the coefficient of the gelcore."""
        if not any(values.values()):
            return design
        found = design.optics.gelcore_scattering_per_mm + values["per_mm"]
        return design.replace({"optics.gelcore_scattering_per_mm": found})


class Delamination(Effect):
    """Gel and core have come apart over a patch: light that arrives flat is reflected there."""

    name: ClassVar[str] = "delamination"
    stage: ClassVar[Stage] = "transport"
    summary: ClassVar[str] = "gel and core have come apart over a patch"
    changes: ClassVar[tuple[Part, ...]] = ("design",)
    transferable: ClassVar[bool] = False  # a flaw of one unit

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """A round patch anywhere under the camera, up to some millimetres (estimate)."""
        if design.optics.light_path != "core":
            return ()
        width, height = design.sensing_area_mm
        return (
            EffectParameter(
                "x_mm", "mm", 0.0, width / 4, -width / 2, width / 2, "centre of the patch", shape=True
            ),
            EffectParameter(
                "y_mm", "mm", 0.0, height / 4, -height / 2, height / 2, "centre of the patch", shape=True
            ),
            EffectParameter("radius_mm", "mm", 0.0, 1.5, 0.0, 6.0, "radius of the patch"),
        )

    def on_design(self, design: Design, values: Values) -> Design:
        """Put air between gel and core."""
        if not values.get("radius_mm"):
            return design
        return design.replace(
            {
                "optics.gap_centre_mm": (values["x_mm"], values["y_mm"]),
                "optics.gap_radius_mm": values["radius_mm"],
            }
        )


EFFECTS: tuple[Effect, ...] = (Interreflection(), GelcoreIndex(), Delamination(), Absorption(), CoreScatter())
"""In the order in which they act."""
