"""Effects of the contact between object and gel."""

from typing import ClassVar

from designlab.sensor.design import Design
from designlab.simulation.contact.press import Press
from designlab.simulation.effects.base import Effect, EffectParameter, Stage, Values

LEAST_DEPTH_MM = 0.01


class ContactKernel(Effect):
    """The gel smooths an indentation over another length than assumed."""

    name: ClassVar[str] = "contact_kernel"
    stage: ClassVar[Stage] = "contact"
    summary: ClassVar[str] = "the gel's smoothing length differs"
    transferable: ClassVar[bool] = True  # what the gel is made of

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """One ratio; published kernels are tuned by hand, 40 % off is common."""
        if design.contact.model != "kernel":
            return ()
        return (
            EffectParameter(
                "length_ratio", "1", 1.0, 0.4, 0.2, 6.0, "smoothing length over its nominal value"
            ),
        )

    def on_design(self, design: Design, values: Values) -> Design:
        """Scale the kernel's length."""
        if design.contact.model != "kernel":
            return design
        length_mm = design.contact.kernel_length_mm * values["length_ratio"]
        return design.replace({"contact.kernel_length_mm": length_mm})


class ContactProfile(Effect):
    """The gel clings together: it is raised around the probe as well."""

    name: ClassVar[str] = "contact_profile"
    stage: ClassVar[Stage] = "contact"
    summary: ClassVar[str] = "the gel is raised around the contact too"
    transferable: ClassVar[bool] = True  # what the gel is made of

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Tails of 10 to 40 % of the depth that fall over 0.4 to 1 mm have been measured."""
        contact = design.contact
        if contact.model != "kernel":
            return ()
        return (
            EffectParameter(
                "tail_share",
                "1",
                0.0,
                0.2,
                -contact.tail_share,
                0.8,
                "added height at the outline, share of the depth",
            ),
            EffectParameter(
                "tail_mm", "mm", contact.tail_mm, 0.15, 0.1, 3.0, "distance of decay by e", shape=True
            ),
        )

    def on_design(self, design: Design, values: Values) -> Design:
        """Add to the tail."""
        if design.contact.model != "kernel" or not values["tail_share"]:
            return design
        share = min(max(design.contact.tail_share + values["tail_share"], 0.0), 0.99)
        return design.replace({"contact.tail_share": share, "contact.tail_mm": values["tail_mm"]})


class DepthOffset(Effect):
    """The zero of the stage is off: every press is deeper than stated by the same distance."""

    name: ClassVar[str] = "depth_offset"
    stage: ClassVar[Stage] = "contact"
    summary: ClassVar[str] = "every press is deeper or shallower than stated"
    transferable: ClassVar[bool] = False  # how the stage was zeroed

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Touching is judged to 0.05 mm by eye (estimate)."""
        return (EffectParameter("offset_mm", "mm", 0.0, 0.05, -0.5, 0.5, "added to every depth"),)

    def on_press(self, press: Press, values: Values) -> Press:
        """Press deeper."""
        if not values["offset_mm"] or press.depth_mm is None:
            return press
        return press.model_copy(
            update={"depth_mm": max(press.depth_mm + values["offset_mm"], LEAST_DEPTH_MM)}
        )
