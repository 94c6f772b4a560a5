"""Distant light on a diffuse or Phong surface: the shading models that rendering is compared with.

Each LED group is one light of one direction. The membrane, and the point of it that every pixel sees, are
those of the simulator. Of the rest there is a factor for each component and channel, a floor and vignetting:
no shadow cast, no light from wall to wall, no fall-off with distance, no refraction of light, no defocus.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from math import atan2, cos, degrees, hypot, radians, sin
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import ValidationError, field_validator, model_validator

from designlab.core.store import read_toml
from designlab.core.types import Array
from designlab.sensor.camera import View
from designlab.sensor.design import CHANNELS, Design, DesignError, assign
from designlab.sensor.field_errors import explain
from designlab.simulation.contact.press import Press
from designlab.simulation.effects.model import ModelError, SensorModel, load_model
from designlab.simulation.simulator import TARGET_SIGNAL, Simulator
from geometries.elastomer import inside
from geometries.leds import emitters
from geometries.spec import Spec, quantity

Reflection = Literal["diffuse", "phong"]

KIND, VERSION = "directional_light", 1
LOWEST_DEG, HIGHEST_DEG = 1.0, 89.0
START_EXPONENT = 5.0  # a broad lobe: a narrow one may miss every pixel and then cannot be moved
INSIDE = "design."  # prefix of the paths of the design's own fields


class Direction(Spec):
    """Where a distant light stands, as seen from the membrane."""

    azimuth_deg: float = quantity(unit="deg")
    """Counter-clockwise from +x."""
    elevation_deg: float = quantity(unit="deg", ge=LOWEST_DEG, le=HIGHEST_DEG)
    """Above the plane of the undeformed membrane."""

    @property
    def vector(self) -> tuple[float, float, float]:
        """Unit vector towards the light."""
        azimuth, elevation = radians(self.azimuth_deg), radians(self.elevation_deg)
        return cos(elevation) * cos(azimuth), cos(elevation) * sin(azimuth), sin(elevation)


class DirectionalLight(Spec):
    """A sensor lit by one distant light for each LED group; `compare` takes it in place of a design.

    A component is a picture of one light at unit strength: max(0, n.l) with the normal n and the direction l
    to the light, and for Phong after these max(0, r.v)^exponent where n.l > 0, with the mirrored direction
    r = 2 (n.l) n - l and v the direction to the camera (Phong 1975, doi:10.1145/360825.360839). The signal
    is factors x components + floor.
    """

    reflection: Reflection
    """diffuse, or phong: a specular lobe for each light besides."""
    exponent: float | None = quantity(None, unit="1", ge=1, le=200)
    """Exponent of the specular lobes, of phong only."""
    lights: tuple[Direction, ...]
    """Direction to the light of each LED group."""
    factors: tuple[tuple[float, ...], ...]
    """Signal (share of full scale) of each channel (rows R, G, B) at 1 of each component (columns: diffuse of
    each LED group, then specular of each)."""
    floor: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Signal of each channel without light, above the camera's black level."""
    design: Design
    """The sensor: its membrane, camera and LED groups."""
    found_in: str = ""
    """Measurement the values were fitted to."""

    @field_validator("factors")
    @classmethod
    def _not_negative(cls, factors: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
        for channel, row in zip(CHANNELS, factors, strict=False):
            if min(row, default=0.0) < 0:
                raise ValueError(f"must not be negative, got {min(row):g} for channel {channel}")
        return factors

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        groups, components = len(self.design.leds.groups), len(self.names)
        if (self.exponent is None) == (self.reflection == "phong"):
            raise ValueError(
                f"exponent: a number for reflection 'phong', absent for 'diffuse'; got {self.exponent} "
                f"for {self.reflection!r}"
            )
        if len(self.lights) != groups:
            raise ValueError(f"lights: one for each of the {groups} LED groups, got {len(self.lights)}")
        if len(self.factors) != len(CHANNELS) or any(len(row) != components for row in self.factors):
            shape = " + ".join(str(len(row)) for row in self.factors)
            raise ValueError(
                f"factors: 3 rows (R, G, B) of {components} values ({', '.join(self.names)}), "
                f"got {len(self.factors)} rows of {shape}"
            )
        return self

    @classmethod
    def of(cls, design: Design, reflection: Reflection) -> "DirectionalLight":
        """Start from a design: light from where its LEDs stand, seen from the origin, mean of a group.

        Factors are the mixing matrix times flux, without a specular part, scaled so that the brightest
        channel of the flat gel stands where automatic exposure puts it.
        """
        lights = _directions(design)
        diffuse = design.transfer_mw
        flat = (diffuse * [light.vector[2] for light in lights]).sum(axis=1)
        diffuse = diffuse * TARGET_SIGNAL / flat.max()
        factors = np.hstack([diffuse, np.zeros_like(diffuse)]) if reflection == "phong" else diffuse
        return cls(
            reflection=reflection,
            exponent=START_EXPONENT if reflection == "phong" else None,
            lights=lights,
            factors=tuple(tuple(float(value) for value in row) for row in factors),
            design=design,
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the components."""
        groups = self.design.group_names
        if self.reflection == "diffuse":
            return groups
        return (*groups, *(f"{name} specular" for name in groups))

    @property
    def digest(self) -> str:
        """SHA-256 of the content, without names and source."""
        content = self.model_dump(mode="json", exclude={"design", "found_in"})
        text = json.dumps([self.design.digest, content], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def components(self, press: Press | None, view: View, *, fine: bool = False) -> Array:
        """Picture of every component, (components, rows, columns); zero beside the gel.

        Parameters
        ----------
        press : Press or None
            None for the untouched gel.
        view : View
            Part of the camera's sensor.
        fine : bool
            On a mesh of half the pitch.
        """
        seen = _seen(self.design, press, view, fine)
        lights = np.array([light.vector for light in self.lights])
        facing = np.einsum("gi,rki->grk", lights, seen.normal)
        found = np.maximum(facing, 0.0)
        if self.exponent is not None:
            level = (seen.normal * seen.camera).sum(axis=-1)
            mirrored = 2 * facing * level - np.einsum("gi,rki->grk", lights, seen.camera)
            lobes = np.where(facing > 0, np.maximum(mirrored, 0.0) ** self.exponent, 0.0)
            found = np.concatenate([found, lobes])
        return np.asarray(found * seen.weight)

    def signal(
        self,
        press: Press | None,
        view: View,
        *,
        lit: Sequence[float] | Array | None = None,
        exposure: float = 1.0,
    ) -> Array:
        """Signal of the camera as a share of full scale, (rows, columns, 3).

        Parameters
        ----------
        press : Press or None
            None for the untouched gel.
        view : View
            Part of the camera's sensor.
        lit : sequence of float, optional
            Relative strength of each LED group; 1 when absent.
        exposure : float
            Relative exposure; the floor does not depend on it.
        """
        each = self.each(np.ones(len(self.lights)) if lit is None else np.asarray(lit, dtype=float))
        mixed = np.tensordot(np.array(self.factors) * each, self.components(press, view), axes=1)
        return np.asarray(np.moveaxis(mixed, 0, -1) * exposure + np.array(self.floor))

    def each(self, lit: Array) -> Array:
        """Strength of every component from that of every LED group."""
        return np.tile(lit, len(self.names) // len(self.lights))

    def replace(self, changes: Mapping[str, Any]) -> "DirectionalLight":
        """Return a validated copy with fields replaced, by dotted path; ``design.`` leads into the design.

        Raises
        ------
        DesignError
            If a path names no field or a value breaks a rule.
        """
        within = {path.removeprefix(INSIDE): v for path, v in changes.items() if path.startswith(INSIDE)}
        design = self.design.replace(within) if within else self.design
        content = self.model_dump(exclude={"design"})
        for path in changes.keys() - {INSIDE + path for path in within}:
            assign(content, path, changes[path])
        try:
            return DirectionalLight.model_validate({**content, "design": design})
        except ValidationError as error:
            raise DesignError(f"replace(): {explain(error)}") from None

    def dumps(self) -> str:
        """TOML text of the model."""
        import tomli_w

        head = {"kind": KIND, "version": VERSION, "digest": self.digest}
        return tomli_w.dumps({**head, **self.model_dump(mode="json", exclude_none=True)})


def load_any_model(name_or_path: str | Path) -> SensorModel | DirectionalLight:
    """Load whatever predicts pictures: a model of directional light, a sensor model, or a design.

    Raises
    ------
    ModelError, DesignError
        If the file cannot be used; names file, field and rule.
    """
    path = Path(name_or_path)
    if path.is_file():
        content = read_toml(path, error=ModelError)
        if content.get("kind") == KIND:
            return _from_content(content, str(path))
    return load_model(name_or_path)


def design_of(model: Design | SensorModel | DirectionalLight) -> Design:
    """Design of whatever predicts pictures, changes by effects included."""
    return model.design if isinstance(model, DirectionalLight) else SensorModel.of(model).effective_design()


def _from_content(content: dict[str, Any], source: str) -> DirectionalLight:
    del content["kind"]
    version, stated = content.pop("version", None), content.pop("digest", None)
    if version != VERSION:
        raise ModelError(f"{source}: field version: must be {VERSION}, got {version!r}")
    try:
        model = DirectionalLight.model_validate(content)
    except ValidationError as error:
        raise ModelError(f"{source}: {explain(error)}") from None
    if stated is not None and stated != model.digest:
        raise ModelError(f"{source}: field digest: does not match the content; the file was edited by hand")
    return model


def _directions(design: Design) -> tuple[Direction, ...]:
    """Mean direction from the origin to the emitting faces of each LED group, weighed by their area."""
    total = np.zeros((len(design.leds.groups), 3))
    for emitter in emitters(design.leds):
        centre = np.array(emitter.centre_mm)
        total[emitter.group] += emitter.area_mm2 * centre / np.linalg.norm(centre)
    return tuple(
        Direction(
            azimuth_deg=degrees(atan2(y, x)) % 360.0,
            elevation_deg=min(max(degrees(atan2(z, hypot(x, y))), LOWEST_DEG), HIGHEST_DEG),
        )
        for x, y, z in total.tolist()
    )


class _Seen(NamedTuple):
    """What every pixel sees: unit normal and unit vector to the camera, (rows, columns, 3), and its weight.

    The weight is vignetting, and zero beside the gel.
    """

    normal: Array
    camera: Array
    weight: Array


@lru_cache(maxsize=16)
def _seen(design: Design, press: Press | None, view: View, fine: bool) -> _Seen:
    simulator = Simulator(design, view=view, seed=0)
    if fine:
        simulator = Simulator(design, view=view, seed=0, pitch_mm=simulator.pitch_mm / 2)
    rays, surface = simulator.rays, simulator.surface(press)
    x, y = rays.hit(surface)
    p, q = (surface.sample(slope, x, y) for slope in surface.gradient)
    met = inside(design.elastomer, x, y) & np.isfinite(p) & np.isfinite(q)
    p, q = np.where(met, p, 0.0), np.where(met, q, 0.0)
    weight = np.where(met, design.camera.vignette(view), 0.0)
    return _Seen(_unit(-p, -q), _unit(rays.slope_x, rays.slope_y), weight)


def _unit(x: Array, y: Array) -> Array:
    """Unit vectors along (x, y, 1)."""
    vectors = np.stack([x, y, np.ones_like(x)], axis=-1)
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
