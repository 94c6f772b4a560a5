"""Effects of the contact between object and gel."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import ClassVar

from designlab.sensor.contact import KernelContact, LayerContact, require
from designlab.sensor.design import Design
from designlab.simulation.contact import layer
from designlab.simulation.contact.indentation import deform
from designlab.simulation.contact.press import Press
from designlab.simulation.contact.surface import Surface
from designlab.simulation.effects.base import Effect, EffectParameter, Part, Stage, Values, at_least
from geometries.probes import LARGEST_EDGE, Probe

MOST_EDGE = 0.99  # of the radius at which nothing straight is left beside a probe's edge


class ContactKernel(Effect):
    """The gel smooths an indentation over another length than assumed."""

    name: ClassVar[str] = "contact_kernel"
    stage: ClassVar[Stage] = "contact"
    needs_touch: ClassVar[bool] = True
    summary: ClassVar[str] = "the gel's smoothing length differs"
    changes: ClassVar[tuple[Part, ...]] = ("design",)
    transferable: ClassVar[bool] = True  # what the gel is made of
    contact_models: ClassVar[tuple[str, ...]] = ("kernel",)

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """One ratio; published kernels are tuned by hand, 40 % off is common."""
        if not self.suits(design):
            return ()
        return (
            EffectParameter(
                "length_ratio", "1", 1.0, 0.4, 0.2, 6.0, "smoothing length over its nominal value"
            ),
        )

    def on_design(self, design: Design, values: Values) -> Design:
        """Scale the kernel's length."""
        if not self.suits(design):
            return design
        length_mm = require(design.contact, KernelContact).kernel_length_mm * values["length_ratio"]
        return design.replace({"contact.kernel_length_mm": length_mm})


class ContactProfile(Effect):
    """The gel clings together: it is raised around the probe as well."""

    name: ClassVar[str] = "contact_profile"
    stage: ClassVar[Stage] = "contact"
    needs_touch: ClassVar[bool] = True
    summary: ClassVar[str] = "the gel is raised around the contact too"
    changes: ClassVar[tuple[Part, ...]] = ("design",)
    transferable: ClassVar[bool] = True  # what the gel is made of
    contact_models: ClassVar[tuple[str, ...]] = ("kernel",)

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Tails of 10 to 40 % of the depth that fall over 0.4 to 1 mm have been measured."""
        if not self.suits(design):
            return ()
        contact = require(design.contact, KernelContact)
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
        if not self.suits(design) or not values["tail_share"]:
            return design
        share = min(max(require(design.contact, KernelContact).tail_share + values["tail_share"], 0.0), 0.99)
        return design.replace({"contact.tail_share": share, "contact.tail_mm": values["tail_mm"]})


class ContactLayer(Effect):
    """The gel is an elastic layer, bonded to its core, where the design smooths the probe's shape.

    The membrane goes from the kernel's shape to the layer's in proportion to a share: pictures are then
    nearly linear in it, and at 1 the sensor is one whose design states a layer, its skin and no more of it.
    """

    name: ClassVar[str] = "contact_layer"
    stage: ClassVar[Stage] = "contact"
    needs_touch: ClassVar[bool] = True
    summary: ClassVar[str] = "the gel is an elastic layer and no kernel"
    changes: ClassVar[tuple[Part, ...]] = ("surface",)
    transferable: ClassVar[bool] = True  # how gels work
    contact_models: ClassVar[tuple[str, ...]] = ("kernel",)

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Share of the layer; thickness, known to a quarter where nobody measured it; skin (estimates)."""
        if not self.suits(design):
            return ()
        thickness_mm = design.elastomer.thickness_mm
        return (
            EffectParameter(
                "share", "1", 0.0, 0.5, 0.0, 1.0, "share of the layer in the membrane's shape", whole=True
            ),
            EffectParameter(
                "thickness_mm",
                "mm",
                thickness_mm,
                thickness_mm / 4,
                thickness_mm / 2,
                3 * thickness_mm,
                "thickness of the layer as it is pressed",
                shape=True,
            ),
            EffectParameter(
                "skin_length_mm",
                "mm",
                LayerContact().skin_length_mm,
                0.05,
                0.0,
                0.5,
                "smoothing length of its coated skin",
                shape=True,
            ),
        )

    def parameters_under(self, design: Design, presses: Iterable[Press]) -> tuple[EffectParameter, ...]:
        """Keep the layer thicker than presses are deep."""
        return at_least(self.parameters(design), thickness_mm=layer.least_thickness_mm(presses))

    def on_surface(self, surface: Surface, design: Design, press: Press | None, values: Values) -> Surface:
        """Go from the kernel's membrane towards the layer's."""
        share = values.get("share", 0.0)
        if press is None or not share:
            return surface
        gel = design.elastomer.model_copy(update={"thickness_mm": values["thickness_mm"]})
        contact = LayerContact(skin_length_mm=values["skin_length_mm"])
        elastic = deform(surface, gel, contact, press)
        height_mm = (1 - share) * surface.height_mm + share * elastic.height_mm
        return replace(elastic if share == 1 else surface, height_mm=height_mm)


class Friction(Effect):
    """The probe slips less or more easily over the membrane."""

    name: ClassVar[str] = "friction"
    stage: ClassVar[Stage] = "contact"
    needs_touch: ClassVar[bool] = True
    summary: ClassVar[str] = "probe and membrane rub more or less"
    changes: ClassVar[tuple[Part, ...]] = ("design",)
    transferable: ClassVar[bool] = True  # what the skin is made of
    contact_models: ClassVar[tuple[str, ...]] = ("layer",)
    confounded_with: ClassVar[tuple[str, ...]] = ("gel_thickness", "contact.poisson")

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Silicone on plastics and metals rubs with coefficients of 0.3 to 1.5 (estimate)."""
        if not self.suits(design):
            return ()
        friction = require(design.contact, LayerContact).friction
        return (
            EffectParameter("added", "1", 0.0, 0.5, -friction, 3.0, "added to the coefficient of friction"),
        )

    def on_design(self, design: Design, values: Values) -> Design:
        """Add to the coefficient."""
        if not self.suits(design) or not values["added"]:
            return design
        friction = max(require(design.contact, LayerContact).friction + values["added"], 0.0)
        return design.replace({"contact.friction": friction})


class SkinLength(Effect):
    """The coated skin follows corners less or more closely."""

    name: ClassVar[str] = "skin_length"
    stage: ClassVar[Stage] = "contact"
    needs_touch: ClassVar[bool] = True
    summary: ClassVar[str] = "the coated skin smooths corners less or more"
    changes: ClassVar[tuple[Part, ...]] = ("design",)
    transferable: ClassVar[bool] = True  # how gels of the kind are coated
    contact_models: ClassVar[tuple[str, ...]] = ("layer",)

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Paints are 0.02 to 0.1 mm thick and smooth over about as much (estimate)."""
        if not self.suits(design):
            return ()
        length_mm = require(design.contact, LayerContact).skin_length_mm
        return (
            EffectParameter(
                "added_mm",
                "mm",
                0.0,
                0.03,
                -length_mm,
                0.5,
                "added to the skin's smoothing length",
                squared=length_mm == 0,
            ),
        )

    def on_design(self, design: Design, values: Values) -> Design:
        """Add to the skin's length."""
        if not self.suits(design) or not values["added_mm"]:
            return design
        length_mm = max(require(design.contact, LayerContact).skin_length_mm + values["added_mm"], 0.0)
        return design.replace({"contact.skin_length_mm": length_mm})


class ProbeEdge(Effect):
    """Edges of probes are rounder than stated, as a printer leaves them."""

    name: ClassVar[str] = "probe_edge"
    stage: ClassVar[Stage] = "contact"
    needs_touch: ClassVar[bool] = True
    summary: ClassVar[str] = "edges of probes are rounder than stated"
    changes: ClassVar[tuple[Part, ...]] = ("press",)
    transferable: ClassVar[bool] = False  # how these probes were made
    by_name: ClassVar[bool] = True  # nothing of several presses was learnt with it

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """A bead of a 0.4 mm nozzle leaves 0.1 to 0.3 mm (estimate)."""
        return (EffectParameter("radius_mm", "mm", 0.0, 0.15, 0.0, 1.0, "added to the radius of edges"),)

    def on_press(self, press: Press, values: Values) -> Press:
        """Round the edges of probes that have any."""
        probe = press.probe
        if not values["radius_mm"] or probe.kind not in LARGEST_EDGE:
            return press
        most_mm = MOST_EDGE * LARGEST_EDGE[probe.kind] * probe.size_mm
        edge_mm = min(probe.edge_radius_mm + values["radius_mm"], most_mm)
        return _pressed_by(press, probe.model_copy(update={"edge_radius_mm": edge_mm}))


class ProbeSize(Effect):
    """All probes are larger or smaller than stated, by one ratio."""

    name: ClassVar[str] = "probe_size"
    stage: ClassVar[Stage] = "contact"
    needs_touch: ClassVar[bool] = True
    summary: ClassVar[str] = "probes are larger or smaller than stated"
    changes: ClassVar[tuple[Part, ...]] = ("press",)
    transferable: ClassVar[bool] = False  # how these probes were made
    confounded_with: ClassVar[tuple[str, ...]] = (
        "lens_distortion",
        "camera_pose",
        "camera.horizontal_fov_deg",
    )
    by_name: ClassVar[bool] = True  # a size of its own is fitted for every probe anyway

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Prints shrink by up to some percent (estimate)."""
        return (
            EffectParameter("size_ratio", "1", 1.0, 0.03, 0.7, 1.4, "size of probes over the stated one"),
        )

    def on_press(self, press: Press, values: Values) -> Press:
        """Scale the probe with its edges."""
        if values["size_ratio"] == 1.0:
            return press
        return _pressed_by(press, press.probe.scaled(values["size_ratio"]))


def _pressed_by(press: Press, probe: Probe) -> Press:
    return press.model_copy(update={"probe": probe})


class DepthOffset(Effect):
    """The zero of the stage is off: every press is deeper than stated by the same distance."""

    name: ClassVar[str] = "depth_offset"
    stage: ClassVar[Stage] = "contact"
    needs_touch: ClassVar[bool] = True
    summary: ClassVar[str] = "every press is deeper or shallower than stated"
    changes: ClassVar[tuple[Part, ...]] = ("press",)
    transferable: ClassVar[bool] = False  # how the stage was zeroed
    reposes: ClassVar[Mapping[str, str]] = {"offset_mm": "depth_mm"}
    unseen_alone: ClassVar[str] = "one press: the same as its own depth"
    confounded_with: ClassVar[tuple[str, ...]] = ("gel_thickness",)

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Touching is judged to 0.05 mm by eye (estimate)."""
        return (EffectParameter("offset_mm", "mm", 0.0, 0.05, -0.5, 0.5, "added to every depth"),)

    def on_press(self, press: Press, values: Values) -> Press:
        """Press deeper."""
        if not values["offset_mm"] or press.depth_mm is None:
            return press
        return press.moved(0.0, 0.0, values["offset_mm"], 0.0)


EFFECTS: tuple[Effect, ...] = (
    ContactKernel(),
    ContactProfile(),
    ContactLayer(),
    Friction(),
    SkinLength(),
    ProbeEdge(),
    ProbeSize(),
    DepthOffset(),
)
"""In the order in which they act."""
