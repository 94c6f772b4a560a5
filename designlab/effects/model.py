"""SensorModel: a design plus the effects its built sensor was found to have; immutable, a TOML file."""

import hashlib
import json
import tomllib
from pathlib import Path
from typing import Any, Self

from pydantic import Field, ValidationError, model_validator

from designlab.design import Design, DesignError, explain, load
from designlab.effects.base import Effect, Light, Sight, Signal
from designlab.effects.catalogue import CATALOGUE
from designlab.press import Press
from designlab.scene import Scene
from geometries.spec import Spec

FORMAT = 1


class ModelError(ValueError):
    """A sensor model file that cannot be used; the text names file, field, value and rule."""


class AppliedEffect(Spec):
    """One effect with fitted values and what is known of them."""

    name: str = Field(description="Name in the catalogue.")
    values: dict[str, float] = Field(description="Value of every parameter.")
    low: dict[str, float] = Field(default_factory=dict, description="Lower end of each 95 % interval.")
    high: dict[str, float] = Field(default_factory=dict, description="Upper end of each 95 % interval.")
    found_in: str = Field("", description="Measurement the values were fitted to.")

    @model_validator(mode="after")
    def _known(self) -> Self:
        effect(self.name)
        return self


def effect(name: str) -> Effect:
    """Look up an effect of the catalogue.

    Raises
    ------
    ValueError
        If there is none of that name.
    """
    for candidate in CATALOGUE:
        if candidate.name == name:
            return candidate
    raise ValueError(f"effect {name!r} is unknown; known are {', '.join(e.name for e in CATALOGUE)}")


class SensorModel(Spec):
    """A design and its effects, in pipeline order; accepted wherever a design is simulated."""

    design: Design = Field(description="The nominal design.")
    effects: tuple[AppliedEffect, ...] = Field((), description="Effects found, in pipeline order.")
    parent: str = Field("", description="Digest of the model this one was made from.")

    @model_validator(mode="after")
    def _values_fit(self) -> Self:
        for applied in self.effects:
            parameters = {p.name: p for p in effect(applied.name).parameters(self.design)}
            if set(applied.values) != set(parameters):
                raise ValueError(
                    f"effects.{applied.name}.values: needs exactly {', '.join(parameters)}, "
                    f"got {', '.join(applied.values)}"
                )
            for name, value in applied.values.items():
                p = parameters[name]
                if not p.low <= value <= p.high:
                    raise ValueError(
                        f"effects.{applied.name}.values.{name}: lies between {p.low:g} and {p.high:g} "
                        f"{p.unit}, got {value:g}"
                    )
        return self

    @classmethod
    def of(cls, design: "Design | SensorModel") -> "SensorModel":
        """Wrap a design without effects; a model is returned as it is."""
        return design if isinstance(design, SensorModel) else cls(design=design)

    @property
    def digest(self) -> str:
        """SHA-256 of design and effect values."""
        content = [self.design.digest, [(a.name, sorted(a.values.items())) for a in self.effects]]
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()

    def effective_design(self) -> Design:
        """Return the design after every effect that acts on it."""
        design = self.design
        for applied in self.effects:
            design = effect(applied.name).on_design(design, applied.values)
        return design

    def on_press(self, press: Press) -> Press:
        """Return what is really pressed when a press is stated."""
        for applied in self.effects:
            press = effect(applied.name).on_press(press, applied.values)
        return press

    def on_scene(self, scene: Scene) -> Scene:
        """Return the scene after every effect that acts on it."""
        for applied in self.effects:
            scene = effect(applied.name).on_scene(scene, applied.values)
        return scene

    def on_light(self, light: Light, sight: Sight) -> Light:
        """Return the light that reaches the camera (groups, rows, columns) after every effect on it."""
        for applied in self.effects:
            light = effect(applied.name).on_light(light, applied.values, sight)
        return light

    def on_signal(self, signal: Signal) -> Signal:
        """Return the camera's signal (rows, columns, 3) after every effect that acts on it."""
        for applied in self.effects:
            signal = effect(applied.name).on_signal(signal, applied.values)
        return signal

    def with_effect(self, applied: AppliedEffect) -> "SensorModel":
        """Return a new version with one effect more (or replaced), kept in pipeline order."""
        order = [e.name for e in CATALOGUE]
        others = [a for a in self.effects if a.name != applied.name]
        effects = tuple(sorted([*others, applied], key=lambda a: order.index(a.name)))
        return SensorModel(design=self.design, effects=effects, parent=self.digest)

    def dumps(self) -> str:
        """TOML text of the model."""
        import tomli_w

        content: dict[str, Any] = {
            "format": FORMAT,
            "digest": self.digest,
            **self.model_dump(mode="json", exclude_none=True),
        }
        return tomli_w.dumps(content)


def load_model(name_or_path: str | Path) -> SensorModel:
    """Load a sensor model, or a design (preset name or TOML file) as a model without effects.

    Raises
    ------
    ModelError, DesignError
        If the file cannot be used.
    """
    path = Path(name_or_path)
    if path.is_file():
        try:
            content = tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise ModelError(f"{path}: not valid TOML: {error}") from None
        if "format" in content:
            return _from_content(content, str(path))
    return SensorModel(design=load(name_or_path))


def _from_content(content: dict[str, Any], source: str) -> SensorModel:
    version = content.pop("format")
    if version != FORMAT:
        raise ModelError(f"{source}: field format: this version reads format {FORMAT}, got {version!r}")
    stated = content.pop("digest", None)
    try:
        model = SensorModel.model_validate(content)
    except ValidationError as error:
        raise ModelError(f"{source}: {explain(error)}") from None
    except DesignError as error:
        raise ModelError(f"{source}: {error}") from None
    if stated is not None and stated != model.digest:
        raise ModelError(f"{source}: field digest: does not match the content; the file was edited by hand")
    return model
