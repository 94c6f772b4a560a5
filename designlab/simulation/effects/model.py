"""SensorModel: a design plus the effects its built sensor was found to have; immutable, a TOML file."""

import hashlib
import json
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Self

from pydantic import Field, ValidationError, model_validator

from designlab.core.store import read_toml, write_atomic
from designlab.sensor.design import Design, DesignError, load
from designlab.sensor.field_errors import explain
from designlab.simulation.contact.press import Press
from designlab.simulation.contact.surface import Surface
from designlab.simulation.effects.base import Effect, EffectParameter, Light, Sight, Signal
from designlab.simulation.effects.catalogue import CATALOGUE
from designlab.simulation.effects.known import Covariance, Domain, Provenance
from designlab.simulation.scene.scene import Scene
from geometries.spec import Spec

FORMAT = 2  # version 1 had neither covariance nor domain nor provenance, and is read
DIGITS = 12  # of a digest in a file's name


class ModelError(ValueError):
    """A sensor model file that cannot be used; the text names file, field, value and rule."""


class AppliedEffect(Spec):
    """One effect with fitted values and what is known of them."""

    name: str = Field(description="Name in the catalogue.")
    values: dict[str, float] = Field(description="Value of every parameter.")
    low: dict[str, float] = Field(default_factory=dict, description="Lower end of each 95 % interval.")
    high: dict[str, float] = Field(default_factory=dict, description="Upper end of each 95 % interval.")
    bounds: dict[str, tuple[float, float]] = Field(
        default_factory=dict, description="Hard physical bounds of each parameter when it was fitted."
    )
    coherence_set: tuple[str, ...] = Field(
        (), description="Effects that explain the measurement as well, itself included."
    )
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
    covariance: Covariance | None = Field(None, description="How well the fitted values are known, jointly.")
    domain: Domain | None = Field(None, description="What the values were fitted to.")
    provenance: Provenance | None = Field(None, description="Measurement and diagnosis they come from.")
    parent: str = Field("", description="Digest of the model this one was made from.")

    @model_validator(mode="after")
    def _values_fit(self) -> Self:
        for applied in self.effects:
            finer = {p.name: p for p in effect(applied.name).finer_parameters(self.design)}
            parameters = {p.name: p for p in effect(applied.name).parameters(self.design)}
            if set(applied.values) - set(finer) != set(parameters):
                beside = f"may have {', '.join(finer)} beside, " if finer else ""
                raise ValueError(
                    f"effects.{applied.name}.values: needs exactly {', '.join(parameters)}, {beside}"
                    f"got {', '.join(applied.values)}"
                )
            for name, value in applied.values.items():
                p = (parameters | finer)[name]
                if not p.low <= value <= p.high:
                    raise ValueError(
                        f"effects.{applied.name}.values.{name}: lies between {p.low:g} and {p.high:g} "
                        f"{p.unit}, got {value:g}"
                    )
        if self.covariance is not None:
            known = {f"{applied.name}.{name}" for applied in self.effects for name in applied.values}
            if unknown := [name for name in self.covariance.parameters if name not in known]:
                raise ValueError(f"covariance.parameters: no effect has {', '.join(unknown)}")
        return self

    @classmethod
    def of(cls, design: "Design | SensorModel") -> "SensorModel":
        """Wrap a design without effects; a model is returned as it is."""
        return design if isinstance(design, SensorModel) else cls(design=design)

    @property
    def digest(self) -> str:
        """SHA-256 of all that the model says; neither its date nor its parent counts."""
        content = self.model_dump(
            mode="json", exclude={"design": True, "parent": True, "provenance": {"date"}}
        )
        return hashlib.sha256(json.dumps([self.design.digest, content]).encode()).hexdigest()

    def effective_design(self) -> Design:
        """Return the design after every effect that acts on it."""
        design = self.design
        for applied in self.effects:
            design = effect(applied.name).on_design(design, applied.values)
        return design

    @property
    def curved(self) -> bool:
        """Whether an effect bends the signal, so that noise changes its mean."""
        return any(effect(applied.name).curved for applied in self.effects)

    def on_press(self, press: Press) -> Press:
        """Return what is really pressed when a press is stated."""
        for applied in self.effects:
            press = effect(applied.name).on_press(press, applied.values)
        return press

    def on_surface(self, surface: Surface, press: Press | None) -> Surface:
        """Return the membrane under what is really pressed after every effect that acts on it."""
        design = self.effective_design()
        for applied in self.effects:
            surface = effect(applied.name).on_surface(surface, design, press, applied.values)
        return surface

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
        return self._version(sorted([*others, applied], key=lambda a: order.index(a.name)), replaced=applied)

    def transferable(self) -> "SensorModel":
        """Return the model of the kind: without the effects that belong to the one unit that was measured."""
        return self._version(applied for applied in self.effects if effect(applied.name).transferable)

    def _version(self, effects: Iterable[AppliedEffect], *, replaced: AppliedEffect | None = None) -> Self:
        """Return a version with some of the effects, and what is known of their values."""
        chosen = tuple(effects)
        known = [
            f"{a.name}.{name}"
            for a in chosen
            if replaced is None or a.name != replaced.name
            for name in a.values
        ]
        covariance = None if self.covariance is None else self.covariance.of(known)
        return self._changed(effects=chosen, covariance=covariance)

    def on(self, design: Design) -> "SensorModel":
        """Put the effects on another design.

        Raises
        ------
        DesignError
            If an effect does not fit it.
        """
        try:
            return self._changed(design=design)
        except ValidationError as error:
            raise DesignError(explain(error)) from None

    def replace(self, changes: Mapping[str, Any]) -> "SensorModel":
        """Change fields of the design by dotted path, as `Design.replace` does; the effects stay."""
        return self.on(self.design.replace(dict(changes)))

    def sampled(self, seed: int) -> "SensorModel":
        """Draw the fitted values from what is known of them, within their bounds.

        A result that is computed for several draws shows by its spread what the values not being known
        exactly makes of it.
        """
        if self.covariance is None:
            return self
        parameters = {f"{a.name}.{p.name}": p for a in self.effects for p in self._parameters(a.name)}
        values = {f"{a.name}.{name}": value for a in self.effects for name, value in a.values.items()}
        drawn = values | self.covariance.draw(parameters, values, seed=seed)
        effects = tuple(
            a.model_copy(update={"values": {name: drawn[f"{a.name}.{name}"] for name in a.values}})
            for a in self.effects
        )
        return self._changed(effects=effects, covariance=None)

    def _parameters(self, name: str) -> tuple[EffectParameter, ...]:
        return (*effect(name).parameters(self.design), *effect(name).finer_parameters(self.design))

    def _changed(self, **changes: Any) -> Self:
        content = {name: getattr(self, name) for name in type(self).model_fields}
        return type(self).model_validate(content | changes | {"parent": self.digest})

    def warnings(self, presses: Iterable[Press | None] = ()) -> tuple[str, ...]:
        """Say where a use of the model goes beyond what it was fitted to, and what of it is not simulated.

        Parameters
        ----------
        presses : iterable of Press or None
            What is simulated; None is the untouched gel.
        """
        if not self.effects:
            return ()
        found = [] if self.domain is None else self.domain.left([press for press in presses if press])
        if alone := [a.name for a in self.effects if effect(a.name).drawn]:
            found.append(
                f"{', '.join(alone)}: not in simulated pictures; every unit or picture has its own, of which "
                "the model holds the strength alone"
            )
        if self.provenance is not None:
            if self.provenance.design_digest != self.design.digest:
                found.append(
                    f"effects were fitted to another design, {self.provenance.design}, and are taken to hold "
                    "for this one too"
                )
            if self.provenance.verdict in ("partial", "unexplained"):
                found.append(f"verdict of the diagnosis: {self.provenance.verdict}; part of the gap is left")
        for applied in self.effects:
            if others := [name for name in applied.coherence_set if name != applied.name]:
                found.append(f"{applied.name}: the measurement did not tell it from {', '.join(others)}")
        return tuple(found)

    def dumps(self) -> str:
        """TOML text of the model."""
        import tomli_w

        content: dict[str, Any] = {
            "format": FORMAT,
            "digest": self.digest,
            **self.model_dump(mode="json", exclude_none=True),
        }
        return tomli_w.dumps(content)

    def save(self, path: str | Path) -> Path:
        """Write the model; no other version is lost.

        Another version that lies there is kept as ``<stem>-<its digest>.toml`` beside.

        Raises
        ------
        ModelError
            If something else than a sensor model lies there.
        """
        path = Path(path)
        if path.exists():
            stated = _stated_digest(path)
            if stated == self.digest:
                return path
            path.replace(path.with_name(f"{path.stem}-{stated[:DIGITS]}{path.suffix}"))
        return write_atomic(path, self.dumps())


def load_model(name_or_path: str | Path) -> SensorModel:
    """Load a sensor model, or a design (preset name or TOML file) as a model without effects.

    Raises
    ------
    ModelError, DesignError
        If the file cannot be used.
    """
    path = Path(name_or_path)
    if path.is_file():
        content = read_toml(path, error=ModelError)
        if "format" in content:
            return _from_content(content, str(path))
    return SensorModel(design=load(name_or_path))


def _stated_digest(path: Path) -> str:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ModelError(f"{path}: is no sensor model and not overwritten: {error}") from None
    if "format" not in content or not isinstance(content.get("digest"), str):
        raise ModelError(f"{path}: is no sensor model and not overwritten")
    return str(content["digest"])


def _from_content(content: dict[str, Any], source: str) -> SensorModel:
    version = content.pop("format")
    if version not in (1, FORMAT):
        raise ModelError(
            f"{source}: field format: this version reads formats 1 and {FORMAT}, got {version!r}"
        )
    stated = content.pop("digest", None)
    try:
        model = SensorModel.model_validate(content)
    except ValidationError as error:
        raise ModelError(f"{source}: {explain(error)}") from None
    except DesignError as error:
        raise ModelError(f"{source}: {error}") from None
    found = model.digest if version == FORMAT else _digest_of_format_1(model)
    if stated is not None and stated != found:
        raise ModelError(f"{source}: field digest: does not match the content; the file was edited by hand")
    return model


def _digest_of_format_1(model: SensorModel) -> str:
    content = [model.design.digest, [(a.name, sorted(a.values.items())) for a in model.effects]]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()
