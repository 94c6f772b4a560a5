"""What every effect is: a stage, bounded parameters, and what it changes there."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
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

Part = Literal["press", "design", "surface", "scene", "light", "signal"]
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
    whole : bool
        Whether at its upper bound the effect is there in full, so that a value there raises no doubt.
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
    whole: bool = False

    @property
    def one_sided(self) -> bool:
        """Whether the null is the end of the range."""
        return self.low == self.null

    def coordinate(self, value: float) -> float:
        """Distance of a value from null in prior standard deviations; of a squared parameter its square.

        Coordinates have priors of unit variance, and pictures are nearly linear in them.
        """
        t = (value - self.null) / self.sd
        return t * t if self.squared else t

    def value_at(self, t: float) -> float:
        """Value at a coordinate, within its bounds."""
        away = max(t, 0.0) ** 0.5 if self.squared else t
        return float(min(max(self.null + away * self.sd, self.low), self.high))


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


@dataclass(frozen=True)
class Scan:
    """A parameter that is found by trying values, since nothing near its null tells it.

    Attributes
    ----------
    parameter : str
        Its name.
    values : tuple of float
        Values to try, in even steps of the logarithm.
    most_heights : float
        Largest value that is tried, in heights of a picture.
    """

    parameter: str
    values: tuple[float, ...]
    most_heights: float


@dataclass(frozen=True)
class Draws:
    """What every picture has of an effect alone: its own amounts of waves on its light.

    Attributes
    ----------
    strength : str
        Parameter that is the root mean square of the amounts of one picture.
    sd : float
        Prior standard deviation of each amount.
    count : int
        Amounts of one picture.
    steady : bool
        Whether all pictures have as much and differ in phase alone; else amounts scatter about zero.
    scan : Scan or None
        How the parameter that shapes the waves is found.
    """

    strength: str
    sd: float
    count: int = 1
    steady: bool = False
    scan: Scan | None = None


class Effect:
    """A named physical effect.

    Subclasses override the hooks of what they change, and say so; the others change nothing. What else a
    diagnosis needs to know of an effect is an attribute here, so that no other place names it.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    summary: ClassVar[str]
    changes: ClassVar[tuple[Part, ...]]
    """What it changes: the hooks that it overrides, without their `on_`."""
    transferable: ClassVar[bool]
    """Whether it holds for new designs too (True), or belongs to one built unit (False).

    What a part is made of or how it works goes with the part; how one unit was put together does not.
    """
    draws: ClassVar[Draws | None] = None
    """What every picture has alone, where it acts by that; see `waves`."""
    per_pixel: ClassVar[str] = ""
    """Parameter that is the strength of a pattern of one number a pixel which all pictures share, if any."""
    recombines: ClassVar[bool] = False
    """Whether it changes a design only in how light already traced is combined; see `on_mixing`."""
    warps: ClassVar[bool] = False
    """Whether it changes a design only in which point of the membrane each pixel sees."""
    curved: ClassVar[bool] = False
    """Whether it changes a signal otherwise than in proportion, so that a pixel's noise changes its mean."""
    reposes: ClassVar[Mapping[str, str]] = MappingProxyType({})
    """Coordinate of a press's pose that each parameter is added to, where it changes nothing else.

    Pictures by pose are rendered for every press anyway.
    """
    step_sd: ClassVar[float] = 1.0
    """How far from null its pictures are rendered, between which others are combined (prior standard
    deviations)."""
    needs_touch: ClassVar[bool] = False
    """Whether it changes nothing where nothing is pressed."""
    constant: ClassVar[bool] = False
    """Whether it adds the same to the signal of every picture."""
    told_by: ClassVar[Literal["", "dark", "single_group"]] = ""
    """Kind of frame (without light, or lit by one group) without which others of these kinds look like it."""
    scales: ClassVar[str] = ""
    """Parameter that is the scale of a picture, if any."""
    unseen_alone: ClassVar[str] = ""
    """Why a single picture of a single press cannot show it, in words; empty where it can."""
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
        return not (
            {"light", "signal"}.issuperset(self.changes) or self.recombines or self.warps or self.reposes
        )

    @property
    def exact(self) -> bool:
        """Whether it acts on finished pictures alone, as in the simulation: nothing is seen anew or moved."""
        return not (self.rendered or self.warps or self.reposes)

    @property
    def drawn(self) -> bool:
        """Whether it acts by what one unit or picture alone has, whose strength alone its values hold."""
        return self.draws is not None or bool(self.per_pixel)

    def suits(self, design: Design) -> bool:
        """Whether it acts on designs with this model of contact."""
        return design.contact.model in self.contact_models

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Return the parameters, some for each LED group; none for a design that the effect cannot change."""
        raise NotImplementedError  # abstract: every effect defines its own

    def finer_parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Return parameters of a finer form, which few sensors need.

        A diagnosis fits them only where that is worth their freedom; values that lack them stand for their
        nulls.
        """
        return ()

    def parameters_under(self, design: Design, presses: Iterable[Press]) -> tuple[EffectParameter, ...]:
        """Return the parameters with the bounds that presses leave them; none if they leave no range."""
        return self.parameters(design)

    def on_press(self, press: Press, values: Values) -> Press:
        """Change what is pressed."""
        return press

    def on_design(self, design: Design, values: Values) -> Design:
        """Change the design before anything is simulated."""
        return design

    def on_mixing(self, mixing: Array, design: Design, values: Values) -> Array:
        """Change the mixing matrix (3, groups) of a design, as `on_design` does, if it recombines light."""
        return mixing

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

    def waves(self, view: View, values: Values) -> Array:
        """Return the relative changes of light of which every picture has its own amounts.

        Their shape is (amounts, rows, 1): they run along the rows, or (amounts, 1, 1).
        """
        raise NotImplementedError  # abstract: every effect that draws has its own

    def null(self, design: Design) -> dict[str, float]:
        """Values at which the effect is the identity."""
        return {parameter.name: parameter.null for parameter in self.parameters(design)}

    def acts(self, values: Values, design: Design) -> bool:
        """Whether values differ from the identity."""
        return any(
            values.get(p.name, p.null) != p.null
            for p in (*self.parameters(design), *self.finer_parameters(design))
            if not p.shape
        )


def at_least(parameters: Sequence[EffectParameter], **least: float) -> tuple[EffectParameter, ...]:
    """Raise the lower bounds of parameters by their names; none are left if a null would be out of bounds."""
    bounded = tuple(replace(p, low=max(p.low, least.get(p.name, p.low))) for p in parameters)
    return bounded if all(p.low <= p.null for p in bounded) else ()
