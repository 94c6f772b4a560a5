"""Effects of how the parts stand to each other."""

from collections.abc import Iterable
from typing import ClassVar

from designlab.sensor.design import Design
from designlab.simulation.contact import layer
from designlab.simulation.contact.press import Press
from designlab.simulation.effects.base import Effect, EffectParameter, Part, Stage, Values, at_least


class CameraPose(Effect):
    """The camera stands off its place and looks past its axis."""

    name: ClassVar[str] = "camera_pose"
    stage: ClassVar[Stage] = "geometry"
    summary: ClassVar[str] = "the camera stands or looks elsewhere"
    changes: ClassVar[tuple[Part, ...]] = ("design",)
    transferable: ClassVar[bool] = False  # how one camera was screwed on
    warps: ClassVar[bool] = True
    confounded_with: ClassVar[tuple[str, ...]] = ("probe_size",)  # by its height

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Place to 0.3 mm and direction to 1 deg: a camera screwed to a printed holder (estimate)."""
        place = tuple(
            EffectParameter(f"{axis}_mm", "mm", 0.0, 0.3, -3.0, 3.0, f"camera moved along {axis}")
            for axis in "xyz"
        )
        turn = tuple(
            EffectParameter(
                f"tilt_{axis}_deg", "deg", 0.0, 1.0, -10.0, 10.0, f"camera turned, see camera.tilt_deg[{k}]"
            )
            for k, axis in enumerate("xy")
        )
        return place + turn

    def on_design(self, design: Design, values: Values) -> Design:
        """Move and turn the camera."""
        if not any(values.values()):
            return design
        camera = design.camera
        place = tuple(c + values[f"{axis}_mm"] for c, axis in zip(camera.position_mm, "xyz", strict=True))
        tilt = tuple(t + values[f"tilt_{axis}_deg"] for t, axis in zip(camera.tilt_deg, "xy", strict=True))
        return design.replace({"camera.position_mm": place, "camera.tilt_deg": tilt})


class GelThickness(Effect):
    """The gel is thicker or thinner than drawn."""

    name: ClassVar[str] = "gel_thickness"
    stage: ClassVar[Stage] = "geometry"
    summary: ClassVar[str] = "the gel is thicker or thinner than drawn"
    changes: ClassVar[tuple[Part, ...]] = ("design",)
    transferable: ClassVar[bool] = False  # how one gel was cast
    contact_models: ClassVar[tuple[str, ...]] = ("layer",)
    confounded_with: ClassVar[tuple[str, ...]] = ("depth_offset", "friction", "contact.poisson")

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Gels cast in open moulds come out 15 % thicker or thinner (estimate)."""
        if not self.suits(design):
            return ()
        return (
            EffectParameter("thickness_ratio", "1", 1.0, 0.15, 0.5, 2.0, "thickness over its nominal value"),
        )

    def parameters_under(self, design: Design, presses: Iterable[Press]) -> tuple[EffectParameter, ...]:
        """Keep the gel thicker than presses are deep."""
        return at_least(
            self.parameters(design),
            thickness_ratio=layer.least_thickness_mm(presses) / design.elastomer.thickness_mm,
        )

    def on_design(self, design: Design, values: Values) -> Design:
        """Scale the thickness."""
        if not self.suits(design) or values["thickness_ratio"] == 1.0:
            return design
        thickness_mm = design.elastomer.thickness_mm * values["thickness_ratio"]
        return design.replace({"elastomer.thickness_mm": thickness_mm})


EFFECTS: tuple[Effect, ...] = (CameraPose(), GelThickness())
"""In the order in which they act."""
