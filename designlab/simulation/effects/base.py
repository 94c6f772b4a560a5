"""What every effect is: a stage, bounded parameters, and what it changes there."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.sensor.camera import View
from designlab.sensor.contact import CONTACT_MODELS
from designlab.sensor.design import Design
from designlab.simulation.contact.press import Press
from designlab.simulation.contact.surface import Surface
from designlab.simulation.scene.scene import Scene

Stage = Literal["geometry", "emission", "transport", "material", "contact", "camera"]
Values = Mapping[str, float]
Light = NDArray[np.floating]
"""Radiance of every LED group at unit flux, shape (groups, rows, columns), before the camera's colours."""
Signal = NDArray[np.floating]
"""Linear picture of three channels, (rows, columns, 3), as a share of full scale."""


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect.

    Attributes
    ----------
    name, unit : str
        Name with its unit, and the unit alone.
    null : float
        Value at which the effect does nothing (of a shape: its usual value).
    sd : float
        Prior standard deviation: how large the effect usually is in built sensors; of a one-sided range half.
    low, high : float
        Hard physical bounds.
    description : str
        Meaning and source of the prior.
    squared : bool
        Whether the picture changes with the square of the value, as it does with the width of a blur.
    shape : bool
        Whether it only says how another parameter acts, and nothing while that one is at its null.
    group : str
        LED group whose light alone it changes; empty where it changes all.
    """

    name: str
    unit: str
    null: float
    sd: float
    low: float
    high: float
    description: str
    squared: bool = False
    shape: bool = False
    group: str = ""

    @property
    def one_sided(self) -> bool:
        """Whether the null is the end of the range."""
        return self.low == self.null


@dataclass(frozen=True, eq=False)
class Sight:
    """What a picture shows, for effects that act on its light.

    Attributes
    ----------
    design : Design
        The sensor after the effects that act on it.
    view : View
        The part of the camera's sensor.
    seen_mm : tuple of arrays, shape (rows, columns)
        x and y of the membrane point that every pixel sees.
    pitch_mm : tuple of float
        Size of a pixel on the plane z = 0, along x and y.
    gel_rotation_deg : float
        By how much the gel is turned against the rest, counter-clockwise.
    own : mapping of str to array
        What one picture or one camera alone has, by effect: its gain, its phase, its pattern. An effect that
        needs it does nothing where it is absent.
    """

    design: Design
    view: View
    seen_mm: tuple[Array, Array]
    pitch_mm: tuple[float, float]
    gel_rotation_deg: float = 0.0
    own: Mapping[str, Array] = field(default_factory=dict)


class Effect:
    """A named physical effect.

    Subclasses override the hook of the stage they act on; the others change nothing.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    summary: ClassVar[str]
    transferable: ClassVar[bool]
    """Whether it holds for new designs too (True), or belongs to one built unit (False).

    What a part is made of or how it works goes with the part; how one unit was put together does not.
    """
    drawn: ClassVar[bool] = False
    """Whether it acts by what one unit or picture alone has, of which the values hold the strength only."""
    recombines: ClassVar[bool] = False
    """Whether it changes a design only in how light already traced is combined."""
    warps: ClassVar[bool] = False
    """Whether it changes a design only in which point of the membrane each pixel sees."""
    curved: ClassVar[bool] = False
    """Whether it changes a signal otherwise than in proportion, so that a pixel's noise changes its mean."""
    reposes: ClassVar[bool] = False
    """Whether it changes a press only in its pose, by which pictures are rendered for every press anyway."""
    needs_touch: ClassVar[bool] = False
    """Whether it changes the membrane only where something touches it."""
    contact_models: ClassVar[tuple[str, ...]] = CONTACT_MODELS
    """Models of contact it acts on; a design of another has no parameters of it."""
    confounded_with: ClassVar[tuple[str, ...]] = ()
    """What does much the same to usual pictures by its physics, stated in advance: effects, and fields of a
    design with their dotted path."""
    by_name: ClassVar[bool] = False
    """Whether a diagnosis tries it only where it is asked for by name."""

    @property
    def rendered(self) -> bool:
        """Whether light must be traced or shaded anew to see it."""
        kind = type(self)
        hooks = ("on_press", "on_design", "on_surface", "on_scene")
        changes = any(getattr(kind, hook) is not getattr(Effect, hook) for hook in hooks)
        return changes and not (self.recombines or self.warps or self.reposes)

    def suits(self, design: Design) -> bool:
        """Whether it acts on designs with this model of contact."""
        return design.contact.model in self.contact_models

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Return the parameters, some for each LED group; none for a design that the effect cannot change."""
        raise NotImplementedError  # abstract: every effect defines its own

    def parameters_under(self, design: Design, presses: Iterable[Press]) -> tuple[EffectParameter, ...]:
        """Return the parameters with the bounds that presses leave them; none if they leave no range."""
        return self.parameters(design)

    def on_press(self, press: Press, values: Values) -> Press:
        """Change what is pressed."""
        return press

    def on_design(self, design: Design, values: Values) -> Design:
        """Change the design before anything is simulated."""
        return design

    def on_surface(self, surface: Surface, design: Design, press: Press | None, values: Values) -> Surface:
        """Change the membrane under what is pressed; the design is that after every effect on it."""
        return surface

    def on_scene(self, scene: Scene, values: Values) -> Scene:
        """Change the scene before light is traced."""
        return scene

    def on_light(self, light: Light, values: Values, sight: Sight) -> Light:
        """Change the light that reaches the camera, of every LED group; linear in it."""
        return light

    def on_signal(self, signal: Signal, values: Values) -> Signal:
        """Change the signal of the pixels, noise included, before the converter cuts and rounds it."""
        return signal

    def null(self, design: Design) -> dict[str, float]:
        """Values at which the effect is the identity."""
        return {parameter.name: parameter.null for parameter in self.parameters(design)}

    def acts(self, values: Values, design: Design) -> bool:
        """Whether values differ from the identity."""
        return any(values[p.name] != p.null for p in self.parameters(design) if not p.shape)


def at_least(parameters: Sequence[EffectParameter], **least: float) -> tuple[EffectParameter, ...]:
    """Raise the lower bounds of parameters by their names; none are left if a null would be out of bounds."""
    bounded = tuple(replace(p, low=max(p.low, least.get(p.name, p.low))) for p in parameters)
    return bounded if all(p.low <= p.null for p in bounded) else ()
