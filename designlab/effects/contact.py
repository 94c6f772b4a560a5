"""Effects of the contact between object and gel."""

from typing import ClassVar

from designlab.design import Design
from designlab.effects.base import Effect, Parameter, Stage, Values


class ContactKernel(Effect):
    """The gel smooths an indentation over another length than assumed."""

    name: ClassVar[str] = "contact_kernel"
    stage: ClassVar[Stage] = "contact"
    summary: ClassVar[str] = "the gel's smoothing length differs"
    transferable: ClassVar[bool] = True

    def parameters(self, design: Design) -> tuple[Parameter, ...]:
        """One ratio; published kernels are tuned by hand, 40 % off is common."""
        return (
            Parameter("length_ratio", "1", 1.0, 0.4, 0.2, 6.0, "smoothing length over its nominal value"),
        )

    def on_design(self, design: Design, values: Values) -> Design:
        """Scale the kernel's length."""
        ratio = values["length_ratio"]
        if ratio == 1.0:
            return design
        return design.replace({"contact.kernel_length_mm": design.contact.kernel_length_mm * ratio})
