"""A study definition holds parameters, objectives, constraints and effort; it is read from TOML."""

import contextlib
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator

from designlab.core.fields import field_at
from designlab.core.store import digest, read_toml, require_version
from designlab.evaluation.press_plan import PressPlan
from designlab.optimization.constraint import Bound
from designlab.optimization.study.defaults import default_parameters
from designlab.optimization.study.parameter import Parameter
from designlab.optimization.study.robust import Robust
from designlab.optimization.tolerance.distributions import require_applicable
from designlab.sensor.design import Design, DesignError, preset, preset_names
from designlab.sensor.field_errors import explain
from geometries.spec import Spec

if TYPE_CHECKING:
    from designlab.simulation.effects.model import SensorModel

FORMAT_VERSION: Literal[1] = 1

Sampler = Literal["auto", "gp", "tpe", "nsga2", "nsga3", "cmaes", "qmc", "random"]

VARIANT = "variant"
"""Name of the choice among variants, beside the parameters of a trial."""

AREA = ("sensing_area_mm", "sensing_area_shape")
"""Fields that say where a design can be pressed."""

THICKNESS = "elastomer.thickness_mm"
"""Field that says how deep."""

BASE = -1
"""Stands for the base design among trials; it need not be a trial of the search."""

DEFAULT_OBJECTIVES: dict[str, Literal["maximise", "minimise"]] = {
    "uniformity_u0": "maximise",
    "normal_error_median_deg": "minimise",
}


DEFAULT_CONSTRAINTS = {"coverage": Bound(least=0.95), "saturation_share": Bound(most=0.0)}
"""The camera sees the gel, and no picture of the untouched one is cut off at white."""


class StudyError(ValueError):
    """A study file, field or folder that cannot be used; the text names it, the value and the rule."""


class Plan(Spec):
    """How the best designs of a search are confirmed: evaluated again, with more effort and fresh seeds."""

    promoted: int = Field(8, ge=0, le=100)
    """Designs of the search that go on to standard fidelity; 0: none."""
    confirmed: int = Field(3, ge=1, le=100)
    """Designs of those that go to the highest fidelity."""
    seeds: int = Field(2, ge=1, le=50)
    """Seeds at the highest fidelity."""
    highest: Literal["standard", "reference"] = "reference"
    """Highest fidelity of the confirmation; reference takes minutes a design."""


class Study(Spec):
    """One optimisation: a base design, the fields to vary, the scores to improve, and the effort."""

    version: Literal[1] = 1
    """Version of this format."""
    name: str = Field("study", min_length=1)
    """Short name."""
    base: Design
    """The design to start from: a preset, a design or model file, or a table."""
    effects: tuple[dict[str, Any], ...] = ()
    """Effects that every design has; of a model file, those that hold for other designs too."""
    model: dict[str, Any] = Field({})
    """What else is known of these effects: covariance, domain, provenance, parent."""
    variants: dict[str, dict[str, Any]] = Field({})
    """Alternatives of the base design, each design being one: name to fields and values."""
    parameters: dict[str, Parameter] = Field(
        default_factory=lambda given: _usual(given), validate_default=True
    )
    """Fields of the design by dotted path, and the values they may take; if absent, where the LEDs stand,
    their size or spacing, the core's sides, boards and coating, as far as the rules allow."""
    objectives: dict[str, Literal["maximise", "minimise"]] = Field(DEFAULT_OBJECTIVES, min_length=1)
    """Scores, and which way each is better."""
    constraints: dict[str, Bound] = DEFAULT_CONSTRAINTS
    """Scores, and what each must at least or at most be."""
    trials: int = Field(40, ge=1, le=100_000)
    """Designs to evaluate, infeasible ones not counted."""
    fidelity: Literal["fast", "standard", "reference"] = "fast"
    """Effort of an evaluation."""
    presses: PressPlan = Field(default_factory=lambda given: _usual_presses(given))
    """How deep, or with which force, and in which area every design is pressed; 0.8 mm deep, less where the
    area is small, in the smallest sensing area that a design may have, if absent."""
    robust: Robust | None = None
    """How copies as they would be built decide; the drawing alone does if absent."""
    plan: Plan = Plan()
    """How the best are confirmed after the search."""
    seed: int = Field(0, ge=0, lt=2**31)
    """Seed of the search and of every evaluation."""
    sampler: Sampler = "auto"
    """Search method, by its name in Optuna; cmaes takes a single objective. auto is gp where PyTorch is
    installed, else tpe."""

    @model_validator(mode="before")
    @classmethod
    def _loaded(cls, content: Any) -> Any:
        if not isinstance(content, Mapping) or not isinstance(content.get("base"), str | Path):
            return content
        base = content["base"]
        if str(base) in preset_names():
            return {**content, "base": preset(str(base))}
        from designlab.simulation.effects.model import load_model

        try:
            model = load_model(base)
        except ValueError as error:
            raise ValueError(f"base: {error}") from None
        # Effects that the study states itself have nothing to do with those of the model.
        stated = {} if "effects" in content else carried(model)
        return {**stated, **content, "base": model.design}

    @field_validator("parameters", mode="before")
    @classmethod
    def _flat(cls, parameters: Any) -> Any:
        return _flattened(parameters) if isinstance(parameters, Mapping) else parameters

    @field_validator("variants", mode="before")
    @classmethod
    def _flat_variants(cls, variants: Any) -> Any:
        if not isinstance(variants, Mapping):
            return variants
        return {
            name: _flattened(fields, keep=()) if isinstance(fields, Mapping) else fields
            for name, fields in variants.items()
        }

    @field_validator("variants")
    @classmethod
    def _are_designs(
        cls, variants: dict[str, dict[str, Any]], info: ValidationInfo
    ) -> dict[str, dict[str, Any]]:
        base = info.data.get("base")
        if len(variants) == 1:
            raise ValueError("give two variants or more, or none")
        for name, fields in variants.items():
            if base is not None:
                try:
                    base.replace(fields)
                except DesignError as error:
                    raise ValueError(f"{name}: {str(error).removeprefix('replace(): ')}") from None
        return variants

    @field_validator("parameters")
    @classmethod
    def _fit_the_design(cls, parameters: dict[str, Parameter], info: ValidationInfo) -> dict[str, Parameter]:
        base, variants = info.data.get("base"), info.data.get("variants")
        if base is None or variants is None:  # their own error is reported
            return parameters
        if not parameters:
            rules = ", ".join(base.broken())
            why = f"; none can be had from the base, which breaks {rules}" if rules else ""
            raise ValueError(f"give at least one{why}")
        for path, parameter in parameters.items():
            if parameter.variant is not None and parameter.variant not in variants:
                known = ", ".join(variants) or "there are none"
                raise ValueError(f"{path}: variant must be one of the variants ({known})")
            home = base.replace(variants.get(parameter.variant or "", {}))
            for value in parameter.extremes:
                for field, its in parameter.fields(path, value).items():
                    _require_allowed(home, field, its)
            if parameter.step is not None and _is_integer(home, path) and parameter.step % 1:
                raise ValueError(f"{path}: takes whole numbers, so must its step, got {parameter.step:g}")
        return parameters

    @field_validator("presses", mode="before")
    @classmethod
    def _of_all_designs(cls, presses: Any, info: ValidationInfo) -> Any:
        if not isinstance(presses, Mapping):
            return presses
        usual = _usual_presses(info.data)
        return {"area_mm": usual.area_mm, "area_shape": usual.area_shape, **presses}

    @field_validator("robust")
    @classmethod
    def _spreads_apply(cls, robust: Robust | None, info: ValidationInfo) -> Robust | None:
        base, variants = info.data.get("base"), info.data.get("variants")
        if robust is None or robust.spread is None or base is None or variants is None:
            return robust
        designs = [base.replace(fields) for fields in variants.values()] or [base]
        require_applicable(designs, robust.spread)
        return robust

    @model_validator(mode="after")
    def _a_search_for_its_objectives(self) -> Self:
        if self.sampler == "cmaes" and len(self.objectives) > 1:
            raise ValueError(
                f"sampler: cmaes takes a single objective, got {', '.join(self.objectives)}; "
                "tpe, nsga2, nsga3, gp, qmc and random take several"
            )
        return self

    @property
    def varied(self) -> tuple[str, ...]:
        """What tells designs apart in a table of trials: parameters, and the variant if there are some."""
        return (*([VARIANT] if self.variants else ()), *self.parameters)

    @property
    def digest(self) -> str:
        """SHA-256 of all that decides the search: everything but names, the number of trials and the plan.

        Usual presses do not count: studies that do not state any are what they were.
        """
        free = {"name", "trials", "base", "plan"}
        free |= {"presses"} if self.presses == _usual_presses(dict(self)) else set()
        content = self.model_dump(mode="json", exclude=free, exclude_none=True)
        return digest(content, self.base.digest)

    def corners(self) -> Iterator[Design]:
        """Designs among which are those of the smallest sensing area and of the thinnest gel."""
        return _corners(self.base, self.variants, self.parameters)

    def design(self, values: Mapping[str, Any]) -> Design:
        """Return the design of parameter values and, where there are variants, of the one named.

        Raises
        ------
        DesignError
            If they do not fit together.
        """
        variant = values.get(VARIANT)
        changes = dict(self.variants.get(variant, {}) if variant is not None else {})
        for path in self.active(variant):
            changes |= self.parameters[path].fields(path, values[path])
        return self.base.replace(changes)

    def pressed(self, *, depth_mm: float | None = None, force_n: float | None = None) -> Self:
        """Return the study with presses of another depth or force, in the same area.

        Raises
        ------
        ValueError
            If depth or force is out of its bounds, or both are given.
        """
        own = self.presses
        presses = PressPlan.on(
            own.area_mm,
            area_shape=own.area_shape,
            direction=own.direction,
            depth_mm=depth_mm,
            force_n=force_n,
        )
        return self.model_copy(update={"presses": presses})

    def active(self, variant: str | None) -> tuple[str, ...]:
        """Parameters that decide a design of a variant."""
        return tuple(path for path, p in self.parameters.items() if p.variant in (None, variant))

    def subject(self, design: Design) -> "Design | SensorModel":
        """Return what is evaluated: a design, or the model that it makes with the effects of the study.

        Raises
        ------
        DesignError
            If an effect does not fit the design.
        """
        if not self.effects:
            return design
        from designlab.simulation.effects.model import SensorModel

        try:
            return SensorModel.model_validate({"design": design, "effects": self.effects, **self.model})
        except ValidationError as error:
            raise DesignError(explain(error)) from None

    def start(self) -> dict[str, Any] | None:
        """Return the base design's own parameter values; None if the ranges do not hold it."""
        own = [v for v, fields in self.variants.items() if self.base.replace(fields) == self.base]
        if self.variants and not own:
            return None
        variant = own[0] if own else None
        values = {path: field_at(self.base, path).value for path in self.active(variant)}
        if not all(self.parameters[path].holds(value) for path, value in values.items()):
            return None
        if self.design({VARIANT: variant, **values}) != self.base:
            return None  # fields that go together are set apart in the base
        return values if variant is None else {VARIANT: variant, **values}

    def is_integer(self, path: str) -> bool:
        """Whether a parameter's field takes whole numbers only."""
        variant = self.parameters[path].variant
        return _is_integer(self.base.replace(self.variants.get(variant or "", {})), path)

    def called(self, score: str) -> str:
        """Return what a value of a score is: of a robust study, one over the copies of a design."""
        if self.robust is None:
            return score
        if score not in self.objectives:
            return f"mean of {score}"
        if self.robust.aim == "worst":
            return f"worst of {score}"
        sign = "-" if self.objectives[score] == "maximise" else "+"
        return f"mean {sign} {self.robust.sigmas:g} sigma of {score}"

    def require_scores(self, known: Collection[str]) -> None:
        """Refuse objectives and bounds of what is no score.

        Raises
        ------
        StudyError
            That names the field and the scores there are.
        """
        for field in ("objectives", "constraints"):
            for name in getattr(self, field):
                if name not in known:
                    unasked = field == "constraints" and self.constraints == DEFAULT_CONSTRAINTS
                    why = "; these constraints hold unless others are given, {} for none" if unasked else ""
                    scores = ", ".join(known)
                    raise StudyError(f"field {field}: no score is called {name!r}, only {scores}{why}")

    def differences(self, other: "Study") -> list[str]:
        """Names of the fields that decide the search in which two studies differ."""
        free = ("name", "trials", "base", "plan")
        fields = [field for field in type(self).model_fields if field not in free]
        differing = [field for field in fields if getattr(self, field) != getattr(other, field)]
        return differing + (["base"] if self.base.digest != other.base.digest else [])


def _usual(given: Mapping[str, Any]) -> dict[str, Parameter]:
    """Default parameters of the base, but for fields that variants set."""
    if "base" not in given or "variants" not in given:  # their own error is reported
        return {}
    held = {field for fields in given["variants"].values() for field in fields}
    return {
        path: parameter
        for path, parameter in default_parameters(given["base"]).items()
        if not any(_overlap(field, other) for field in (path, *parameter.also) for other in held)
    }


def _usual_presses(given: Mapping[str, Any]) -> PressPlan:
    """Presses that all designs of a study can share."""
    if not {"base", "variants", "parameters"} <= set(given):  # their own error is reported
        return PressPlan(area_mm=(1.0, 1.0))
    return PressPlan.of(*_corners(given["base"], given["variants"], given["parameters"]))


def _corners(
    base: Design, variants: Mapping[str, Mapping[str, Any]], parameters: Mapping[str, Parameter]
) -> Iterator[Design]:
    """See `Study.corners`: base and variants, with the ends of ranges."""
    for fields in ({}, *variants.values()):
        start = base.replace(fields)
        yield start
        for path, parameter in parameters.items():
            for value in parameter.extremes:
                changes = parameter.fields(path, value)
                if any(_overlap(field, own) for field in changes for own in (*AREA, THICKNESS)):
                    with contextlib.suppress(DesignError):  # not every variant has every field
                        yield start.replace(changes)


def _overlap(field: str, other: str) -> bool:
    """Whether one dotted path is the other, or part of what it names."""
    return f"{field}.".startswith(f"{other}.") or f"{other}.".startswith(f"{field}.")


def carried(model: "SensorModel") -> dict[str, Any]:
    """Effects of a built sensor that hold for other designs too, and what is known of them, for a study.

    The others belong to that one unit.
    """
    content = model.transferable().model_dump(mode="json", exclude={"design"}, exclude_none=True)
    effects = tuple(content.pop("effects"))
    return {"effects": effects, "model": content if effects else {}}


def _flattened(
    content: Mapping[str, Any], prefix: str = "", *, keep: Collection[str] = frozenset(Parameter.model_fields)
) -> dict[str, Any]:
    """Turn nested tables into dotted paths: ``[parameters.leds.tilt_deg]`` needs no quotes then.

    Tables with one of the keys to keep stay.
    """
    flat: dict[str, Any] = {}
    for key, value in content.items():
        path = f"{prefix}{key}"
        nested = isinstance(value, Mapping) and value and not set(value) & set(keep)
        flat |= _flattened(value, f"{path}.", keep=keep) if nested else {path: value}
    return flat


def _is_integer(design: Design, path: str) -> bool:
    value = field_at(design, path).value
    return isinstance(value, int) and not isinstance(value, bool)


def _require_allowed(base: Design, path: str, value: Any) -> None:
    """Refuse a value that the field itself does not take, whatever the rest of the design."""
    try:
        base.replace({path: value})
    except DesignError as error:
        text = str(error).removeprefix("replace(): ")
        if text.startswith("no field"):
            raise ValueError(text) from None
        # Other texts are about several fields together: some designs are infeasible, the range is not wrong.
        parent, _, last = path.rpartition(".")
        field, _, rule = text.removeprefix("field ").partition(": ")
        if field == path or (last.isdigit() and field == parent):
            got = "" if repr(value) in rule else f", got {value!r}"
            raise ValueError(f"{path}: {rule}{got}") from None


def load_study(path: str | Path) -> Study:
    """Read a study from a TOML file.

    Parameters
    ----------
    path : str or Path
        TOML file; a design named in it is a preset, or a file relative to this one.

    Raises
    ------
    StudyError
        If the file cannot be read, is of another format version, or breaks a rule.
    """
    file = Path(path)
    content = read_toml(file, error=StudyError)
    require_version(content, file, FORMAT_VERSION, error=StudyError)
    beside = file.parent / str(content.get("base"))
    if isinstance(content.get("base"), str) and beside.is_file():
        content["base"] = beside
    try:
        return Study.model_validate(content)
    except ValidationError as error:
        raise StudyError(f"{file}: {explain(error)}") from None


def dumps_study(study: Study) -> str:
    """Write a study as TOML text, complete, with the base design spelled out."""
    import tomli_w

    return tomli_w.dumps(study.model_dump(mode="json", exclude_none=True))
