"""A sensor design: its parts, optics and camera, and the rules it must obey, as signed margins."""

import hashlib
import json
import math
import tomllib
import warnings
from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator

from designlab.core.store import write_atomic
from designlab.sensor import led_catalogue
from designlab.sensor.camera import Camera, View
from designlab.sensor.contact import Contact, ContactModelAssumed, LayerContact, with_model
from designlab.sensor.core_rules import require_agreement
from designlab.sensor.design_fields import commented, described, nearest
from designlab.sensor.feasibility import RULES, SEEN, margins, shape_margins
from designlab.sensor.field_errors import entries, explain, shown
from designlab.sensor.optical_constants import material
from designlab.sensor.optical_properties import Optics
from designlab.sensor.parts_file import OwnParts, PartsFile, resolved
from designlab.sensor.refraction import Glass, tangents_through
from designlab.sensor.seating import camera_board
from designlab.sensor.sensing_area import SensingArea, Shape
from designlab.sensor.spectra import (
    electrons_per_j,
    emission_rows,
    filter_rows,
    peak_electrons_per_j,
    response,
)
from designlab.sensor.unsayable import UNSAYABLE, refuse_unsayable
from geometries.elastomer import Elastomer, base_mm
from geometries.gelcore import Gelcore
from geometries.housing import Housing
from geometries.leds import LedArray
from geometries.spec import FOLDER, Spec
from geometries.spectrum import Filter, Spectrum

CHANNELS = ("R", "G", "B")
LABELS: Any = {"name": True, "description": True, "parent": True, "parts": True, "leds": {"relative_flux"}}
"""Fields that change neither light nor contact nor any part."""
CHANGED = " with "  # joins the name of a design and what was changed in it
FEW_CHANGES = 2  # so many are listed in a name
EDGE_POINTS = 33  # on each edge of the sensing area, where the lens distorts
PER_GROUP = (
    "membrane_albedo",
    "board_reflectance",
    "housing_reflectance",
    "gelcore_absorption_per_mm",
    "elastomer_absorption_per_mm",
)
"""Fields of `Optics` that take one value for all LED groups, or one for each."""


class DesignError(ValueError):
    """A design file or field that cannot be used; the text names source, field, value and rule."""


class InfeasibleDesign(ValueError):
    """A well-formed design that breaks a geometric rule, or one of what is to be done with it.

    Attributes
    ----------
    broken : mapping of str to float
        Rules that it breaks and by how much (mm), where that is known.
    """

    def __init__(self, text: str, broken: Mapping[str, float] | None = None) -> None:
        super().__init__(text)
        self.broken = dict(broken or {})


class Design(Spec):
    """A design is one sensor: parts, optics, contact and camera.

    It is immutable; equal designs have equal digests.

    Parameters
    ----------
    name : str
        Short name.
    description : str
        What it is and where its figures come from.
    parent : str, optional
        Preset that it was made from.
    parts : PartsFile, optional
        Parts of one's own.
    gelcore : Gelcore
        The rigid clear body.
    elastomer : Elastomer
        The soft clear gel.
    leds : LedArray
        The light sources.
    housing : Housing
        The opaque tube.
    optics : Optics
        Materials and light path.
    contact : KernelContact or LayerContact
        How the gel answers a press.
    camera : Camera
        The camera.
    sensing_area_mm : tuple of two float
        Width and height in mm of the area where scores count, centred on the membrane and measured along x
        and y.
    sensing_area_shape : {"rectangle", "ellipse"}
        Shape of that area; width and height are the full axes of an ellipse.
    mixing : tuple of three rows, optional
        Response of each camera channel to each LED group, shape (3, groups), without unit. It follows from
        LED spectra and camera sensitivities when absent.

    Raises
    ------
    pydantic.ValidationError
        If a field is unknown or out of its bounds, or fields contradict each other.
    """

    name: str = "unnamed"
    """Short name."""
    description: str = ""
    """What it is and where its figures come from."""
    parent: str | None = None
    """Preset that it was made from; absent for presets and for designs without one."""
    parts: PartsFile | None = None
    """Parts of one's own, from a file; their names stand beside those of the catalogue."""
    gelcore: Gelcore = Field(default_factory=lambda: Gelcore())
    """The rigid clear body."""
    elastomer: Elastomer = Field(default_factory=lambda: Elastomer())
    """The soft clear gel."""
    leds: LedArray
    """The light sources."""
    housing: Housing = Field(default_factory=lambda: Housing())
    """The opaque tube."""
    optics: Optics = Field(default_factory=lambda: Optics())
    """Materials and light path."""
    contact: Contact = Field(default_factory=lambda: LayerContact(), discriminator="model")
    """How the gel answers a press."""
    camera: Camera = Field(default_factory=lambda: Camera())
    """The camera."""
    sensing_area_mm: tuple[float, float] = (14.0, 10.5)
    """Width and height of the area where scores count, centred on the membrane (mm)."""
    sensing_area_shape: Shape = "rectangle"
    """Shape of that area; width and height are the full axes of an ellipse, a disc where they are equal."""
    mixing: tuple[tuple[float, ...], ...] | None = None
    """Response of each camera channel (rows R, G, B) to each LED group (columns); when absent, it follows
    from LED spectra and camera.sensitivity, and without that it is the unit matrix."""

    @model_validator(mode="before")
    @classmethod
    def _completed(cls, content: Any, info: ValidationInfo) -> Any:
        """Fill in what the LED library and one's own know of the parts named, and the model of contact."""
        if isinstance(content, Mapping):
            refuse_unsayable(content)
        own = OwnParts()
        if isinstance(content, Mapping) and content.get("parts") is not None:
            try:
                kept = PartsFile.model_validate(content["parts"], context=info.context)
            except ValidationError:
                return content  # the field says what is wrong
            own = kept.parts
            content = {**content, "parts": kept}
        if isinstance(content, Mapping) and isinstance(content.get("leds"), Mapping):
            content = {**content, "leds": led_catalogue.filled(content["leds"], own.leds)}
        if isinstance(content, Mapping):
            content = resolved(content, own)
        if isinstance(content, Mapping) and "contact" in content:
            content = {**content, "contact": with_model(content["contact"])}
        return content

    @field_validator("sensing_area_mm")
    @classmethod
    def _positive_area(cls, area: tuple[float, float]) -> tuple[float, float]:
        if min(area) <= 0.5 or max(area) > 200:
            raise ValueError(f"width and height lie between 0.5 and 200 mm, got {area[0]:g} x {area[1]:g} mm")
        return area

    @model_validator(mode="after")
    def _groups_agree(self) -> Self:
        count = len(self.leds.groups)
        for field in PER_GROUP:
            given = len(getattr(self.optics, field) or (0.0,))
            if given not in (1, count):
                raise ValueError(
                    f"optics.{field}: give one value or one for each of the {count} LED groups, got {given}"
                )
        self._require_spectra()
        if self.mixing is None and self.camera.sensitivity is not None:
            try:
                _ = self.mixing_matrix
            except ValueError as error:
                field = "filter" if "filter" in str(error) else "sensitivity"
                where = "camera" if self.camera.filter or field == "sensitivity" else "leds.groups"
                raise ValueError(f"{where}.{field}: {error}") from None
        elif self.mixing is None:
            if count != len(CHANNELS):
                raise ValueError(
                    f"mixing: required unless there are three LED groups or camera.sensitivity is given, "
                    f"there are {count} groups"
                )
        elif len(self.mixing) != len(CHANNELS) or any(len(row) != count for row in self.mixing):
            raise ValueError(f"mixing: must be 3 rows (R, G, B) of {count} values, one for each LED group")
        if self.camera.exposure_time_ms is not None and self.leds.relative_flux:
            raise ValueError(
                "camera.exposure_time_ms: needs fluxes in mW, leds.relative_flux says that none is known; "
                "give camera.exposure instead"
            )
        if self.leds.coupling != "air_gap" and self.optics.light_path == "air":
            raise ValueError(
                f"leds.coupling: {self.leds.coupling!r} needs optics.light_path = 'core', "
                "light in air meets no core"
            )
        require_agreement(self.gelcore, self.elastomer, self.leds, self.optics)
        if self.housing.seats is not None:
            try:
                camera_board(self.housing.seats.camera)
            except ValueError as error:
                raise ValueError(f"housing.seats.camera: {error}") from None
            if self.camera.mirror is not None:
                raise ValueError(
                    "housing.seats: seats hold a camera that looks straight down, camera.mirror is given; "
                    "take one of both away"
                )
        return self

    def _require_spectra(self) -> None:
        """Refuse spectra and filters that are unknown, or that nothing would see."""
        named: list[tuple[str, Spectrum | Filter | None]] = [("camera.filter", self.camera.filter)]
        for index, group in enumerate(self.leds.groups):
            named += [
                (f"leds.groups.{index}.{name}", getattr(group, name)) for name in ("spectrum", "filter")
            ]
        for field, found in named:
            if found is None:
                continue
            try:
                _ = emission_rows(found) if isinstance(found, Spectrum) else filter_rows(found)
            except ValueError as error:
                raise ValueError(f"{field}.{error}") from None
            if self.mixing is None and self.camera.sensitivity is None:
                raise ValueError(f"{field}: needs camera.sensitivity, or mixing as measured; both are absent")

    @property
    def digest(self) -> str:
        """SHA-256 of the canonical content: all that light, contact or CAD depend on."""
        # What is absent does not count: fields that a later version adds leave old designs as they are.
        content = self.model_dump(mode="json", exclude=LABELS, exclude_none=True)
        if self.contact.model == "kernel":
            del content["contact"]["model"]
        if self.camera.pixel_aspect == 1.0:
            del content["camera"]["pixel_aspect"]
        if self.sensing_area_shape == "rectangle":
            del content["sensing_area_shape"]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def __repr__(self) -> str:
        """The design in a line: name, and what decides most of it."""
        groups = ", ".join(f"{g.name} {g.count * len(g.azimuth_deg)}" for g in self.leds.groups)
        return (
            f"Design({self.name!r}: {self.elastomer.shape} gel {self.elastomer.thickness_mm:g} mm, "
            f"LEDs {groups}, {self.sensing_area})"
        )

    __str__ = __repr__

    @property
    def sensing_area(self) -> SensingArea:
        """The area where scores count."""
        return SensingArea(*self.sensing_area_mm, self.sensing_area_shape)

    @property
    def changes(self) -> dict[str, tuple[Any, Any]]:
        """Fields in which it differs from its parent: dotted path to the parent's value and its own."""
        return {} if self.parent is None else differences(self, preset(self.parent))

    @property
    def lineage(self) -> str:
        """What it was made from and how it differs, in words; empty for a design without parent."""
        if self.parent is None:
            return ""
        told = [f"{path} {shown(old)} -> {shown(new)}" for path, (old, new) in self.changes.items()]
        return f"made from preset {self.parent}: " + ("; ".join(told) or "nothing changed")

    @property
    def not_buildable(self) -> str:
        """Why it cannot be built as it is simulated; empty if it can, as far as is checked."""
        if self.optics.light_path == "core":
            return ""
        published = "published" if self.name in preset_names() else "simulated"
        return (
            f"not buildable as {published}: its light does not see the gelcore "
            '(optics.light_path = "air"), and its LEDs may stand in it'
        )

    @property
    def group_names(self) -> tuple[str, ...]:
        """Names of the LED groups, in order."""
        return tuple(group.name for group in self.leds.groups)

    @property
    def mixing_matrix(self) -> NDArray[np.float64]:
        """Response of camera channels to LED groups, shape (3, groups)."""
        if self.mixing is not None:
            return np.asarray(self.mixing, dtype=float)
        if self.camera.sensitivity is None:
            return np.eye(len(CHANNELS))
        return response(
            self.camera.sensitivity,
            wavelength_nm=[group.wavelength_nm for group in self.leds.groups],
            width_nm=[group.width_nm for group in self.leds.groups],
            spectra=[group.spectrum for group in self.leds.groups],
            filters=[
                tuple(each for each in (group.filter, self.camera.filter) if each is not None)
                for group in self.leds.groups
            ],
        )

    @property
    def fixed_exposure(self) -> float | None:
        """Signal as a share of full scale per unit of mixed radiance; None where the camera chooses it.

        It is `camera.exposure` times gain, or follows from exposure time, lens opening and quantum
        efficiency: the pixel collects radiance x area of the opening x its solid angle x time.
        """
        camera = self.camera
        if camera.exposure is not None:
            return camera.exposure * camera.gain
        if camera.exposure_time_ms is None or camera.opening_mm is None:
            return None
        opening_mm2 = np.pi * camera.opening_mm**2 / 4
        mirrored = 1.0 if camera.mirror is None else camera.mirror.reflectance
        energy_j = mirrored * opening_mm2 * camera.pixel_sr * camera.exposure_time_ms * 1e-6  # mW ms
        return float(energy_j * self._electrons_per_j() * camera.gain / camera.full_well_e)

    def _electrons_per_j(self) -> float:
        """Photo-electrons per joule on a pixel where `mixing_matrix` is 1."""
        efficiency = self.camera.quantum_efficiency or 0.0
        if self.mixing is None and self.camera.sensitivity is not None:
            return efficiency * peak_electrons_per_j(
                self.camera.sensitivity,
                wavelength_nm=[group.wavelength_nm for group in self.leds.groups],
                width_nm=[group.width_nm for group in self.leds.groups],
                spectra=[group.spectrum for group in self.leds.groups],
            )
        best = int(self.mixing_matrix.max(axis=0).argmax())
        return efficiency * electrons_per_j(self.leds.groups[best].wavelength_nm)

    def led_part(self, name: str) -> led_catalogue.LedPart:
        """Figures of an LED that the design names, of the catalogue or of one's own parts."""
        return led_catalogue.part(name, {} if self.parts is None else self.parts.parts.leds)

    @property
    def flux_mw(self) -> NDArray[np.float64]:
        """Flux of each LED group as it is driven (mW), shape (groups,)."""
        return np.array([group.driven_mw for group in self.leds.groups])

    @property
    def transfer_mw(self) -> NDArray[np.float64]:
        """Mixing matrix times flux (mW), shape (3, groups): it turns light at unit flux into channels."""
        return self.mixing_matrix * self.flux_mw

    def per_group(
        self, field: Literal["membrane_albedo", "board_reflectance", "housing_reflectance"]
    ) -> tuple[float, ...]:
        """Reflectance for every LED group."""
        values: tuple[float, ...] = getattr(self.optics, field)
        return values * len(self.leds.groups) if len(values) == 1 else values

    def absorption_per_mm(self, part: Literal["gelcore", "elastomer"]) -> tuple[float, ...]:
        """Absorption coefficient of a clear part for every LED group, the material's unless it is given."""
        given: tuple[float, ...] | None = getattr(self.optics, f"{part}_absorption_per_mm")
        if given is not None:
            return given * len(self.leds.groups) if len(given) == 1 else given
        stuff = material(getattr(self.optics, f"{part}_material"))
        return tuple(stuff.absorption_per_mm(wavelength_nm=group.wavelength_nm) for group in self.leds.groups)

    def replace(self, changes: Mapping[str, Any]) -> "Design":
        """Return a validated copy with fields replaced.

        A copy that differs says so in its name, unless one is given among the changes, and knows the preset
        that it was made from as its `parent`.

        Parameters
        ----------
        changes : mapping
            Dotted path of each field to its new value, for example ``{"leds.tilt_deg": 30}``.

        Raises
        ------
        DesignError
            If a path names no field or a value breaks a rule.
        """
        content = self.model_dump()
        for path, value in changes.items():
            assign(content, path, value)
        for path in changes:
            if path.startswith("leds.") and path.endswith(".part"):
                led_catalogue.forget(content["leds"], path, given=changes)
        found = _validated(content, "replace()")
        if found.digest == self.digest:
            return found
        told = _told_apart(found, self)
        return told.model_copy(update={"name": found.name}) if "name" in changes else told

    def save(self, path: str | Path) -> Path:
        """Write the design as a TOML file, complete, with a comment to each field; `load` reads it.

        Parameters
        ----------
        path : path
            File to write; one that is there already is replaced.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        write_atomic(Path(path), dumps(self))
        return Path(path)

    def view(self, columns: int) -> View:
        """Rectangle of the sensor that shows the sensing area in `columns` columns of square pixels."""
        # Straight edges stay straight in a perspective; a distorted edge may bulge beyond its corners.
        edge = self.sensing_area.outline_mm(2 if self.camera.is_plain else EDGE_POINTS)
        return View.around([self.project_px(float(x), float(y)) for x, y in edge], columns)

    def project_px(self, x_mm: float, y_mm: float) -> tuple[float, float]:
        """Where a point of the undeformed membrane appears on the full sensor.

        Refraction at plane layers between membrane and camera is included; the gel side of a dome core is
        taken as plane there, unless the core is hollow or a wedge.

        Returns
        -------
        column, row : float
            Fractional; pixel centres lie at .5.

        Raises
        ------
        InfeasibleDesign
            If the point lies beyond a dome, or the camera stands below the window.
        """
        z = float(base_mm(self.elastomer, np.float64(x_mm), np.float64(y_mm)))
        if math.isnan(z):
            raise InfeasibleDesign(
                f"sensing_area_mm: ({x_mm:g}, {y_mm:g}) mm lies outside the curved membrane"
            )
        tan_x, tan_y = self.tangents_to(np.array([[x_mm, y_mm, z]]))[0]
        column, row = self.camera.project(tan_x, tan_y)
        return float(column), float(row)

    def tangents_to(
        self, points: NDArray[np.float64], *, camera_mm: float | None = None
    ) -> NDArray[np.float64]:
        """Directions in which the camera, which may be put at another height, sees membrane points.

        Parameters
        ----------
        points : array, shape (n, 3)
            Points of the undeformed membrane (mm).

        Returns
        -------
        array, shape (n, 2)
            Tangents of the angles to the axis, along x and y.

        Raises
        ------
        InfeasibleDesign
            If the camera stands below the window.
        """
        x, y, z = self.camera.eye_mm
        camera = np.array([x, y, z if camera_mm is None else camera_mm])
        layers = [self.layers_to_camera(float(z), camera_mm=camera[2]) for z in points[:, 2]]
        if self.glass is not None and (self.glass.cavity is not None or self.glass.window_slope):
            return self.glass.toward(camera, points)
        return tangents_through(layers, points[:, :2] - camera[:2])

    @property
    def glass(self) -> Glass | None:
        """Core and gel as the camera looks through them; None where light does not see them."""
        return Glass.of(self.gelcore, self.elastomer, self.optics)

    def layers_to_camera(self, z: float, *, camera_mm: float | None = None) -> list[tuple[float, float]]:
        """Thickness (mm) and index of each plane layer from a membrane point at height z (mm) to the camera.

        The first layer touches the membrane, the last one the camera, which may be put at another height.

        Raises
        ------
        InfeasibleDesign
            If the camera stands below the window.
        """
        z_c, glass = self.camera.eye_mm[2] if camera_mm is None else camera_mm, self.glass
        if glass is None:
            return [(z_c - z, 1.0)]
        if z_c <= glass.window_mm:
            raise InfeasibleDesign(
                f"camera.position_mm: z must be above the window at {glass.window_mm:g} mm, is {z_c:g} mm"
            )
        return glass.layers(z, z_c)

    def margins(self) -> dict[str, float]:
        """Signed distance to every geometric rule in mm; positive means violated.

        Returns
        -------
        dict of str to float
            Rule name to margin. `RULES` says what each means.
        """
        return margins(self)

    def broken(self, *, as_built: bool = False) -> dict[str, float]:
        """Return the violated rules with their margins; `as_built`, only those about what can be made."""
        forgiven = SEEN if as_built else ()
        return {rule: m for rule, m in self.margins().items() if m > 0 and rule not in forgiven}

    def require_feasible(self, *, as_built: bool = False) -> None:
        """Raise `InfeasibleDesign` that names every violated rule, see `broken`, and by how much."""
        if broken := self.broken(as_built=as_built):
            raise self._refusal(broken)

    def require_shapes(self) -> None:
        """Raise `InfeasibleDesign` if a part has no shape, whatever else is allowed: a rule of `SHAPED`."""
        found = shape_margins(self.gelcore, self.elastomer)
        if broken := {rule: margin for rule, margin in found.items() if margin > 0}:
            raise self._refusal(broken)

    def _refusal(self, broken: Mapping[str, float]) -> InfeasibleDesign:
        reasons = "; ".join(
            f"{rule}: {RULES[rule]} (violated by {margin:.3g} mm)" for rule, margin in broken.items()
        )
        return InfeasibleDesign(f"design {self.name!r} is infeasible: {reasons}", broken)


Design.__doc__ = f"{Design.__doc__}\n    Notes\n    -----\n    Every field:\n\n{described(Design)}\n"


def _told_apart(changed: Design, original: Design) -> Design:
    """The changed design with a name of its own and the preset that it was made from."""
    parent = original.parent
    if parent is None and original.name in preset_names():
        parent = original.name
    if parent is not None and changed.digest == preset(parent).digest:
        return changed.model_copy(update={"name": parent, "parent": None})
    automatic = parent is not None and original.name.startswith(f"{parent}{CHANGED}")
    base = parent if parent is not None and automatic else original.name
    told = differences(changed, preset(parent) if parent == base else original)
    short = [f"{path} {new:g}" for path, (_, new) in told.items() if isinstance(new, int | float)]
    what = ", ".join(short) if len(short) == len(told) <= FEW_CHANGES else f"{len(told)} changes"
    return changed.model_copy(update={"name": f"{base}{CHANGED}{what}", "parent": parent})


def differences(design: Design, other: Design) -> dict[str, tuple[Any, Any]]:
    """Fields in which a design differs from another: dotted path to the other's value and its own."""
    theirs, own = (_flat(d.model_dump(mode="json", exclude=LABELS)) for d in (other, design))
    paths = dict.fromkeys([*own, *theirs])
    return {p: (theirs.get(p), own.get(p)) for p in paths if theirs.get(p) != own.get(p)}


def _flat(content: Any, path: str = "") -> dict[str, Any]:
    """Leaves of nested content by dotted path; lists of plain values are leaves."""
    if isinstance(content, Mapping):
        parts = content.items()
    elif isinstance(content, list) and any(isinstance(item, Mapping) for item in content):
        parts = {str(k): item for k, item in enumerate(content)}.items()
    else:
        return {path: content}
    return {
        leaf: value
        for key, part in parts
        for leaf, value in _flat(part, f"{path}.{key}" if path else str(key)).items()
    }


def assign(content: dict[str, Any], path: str, value: Any) -> None:
    """Set a nested entry given by dotted path; list positions are numbers (``leds.groups.0.flux_mw``).

    Raises
    ------
    DesignError
        If there is no such entry.
    """
    node: Any = content
    *parents, last = path.split(".")
    try:
        for key in parents:
            position = int(key) if isinstance(node, list) else key
            if isinstance(node[position], tuple):
                node[position] = list(node[position])
            node = node[position]
        end = int(last) if isinstance(node, list) else last
        _ = node[end]
    except (KeyError, IndexError, ValueError, TypeError):
        meant = nearest(Design, path)
        hint = f"; did you mean {meant!r}?" if meant else ""
        raise DesignError(f"no field {path!r} in a design{hint}") from None
    node[end] = value


def _validated(content: Mapping[str, Any], source: str, folder: Path | None = None) -> Design:
    try:
        return Design.model_validate(content, context={FOLDER: folder or Path()})
    except ValidationError as error:
        raise DesignError(f"{source}: {explain(error)}{_meant(error)}") from None


def _meant(error: ValidationError) -> str:
    """The field of a design that an unknown one may mean."""
    first = error.errors()[0]
    if first["type"] != "extra_forbidden":
        return ""
    meant = nearest(Design, ".".join(entries(first["loc"])))
    return f"; did you mean {meant!r}?" if meant else ""


def loads(text: str, *, source: str = "design", folder: Path | None = None) -> Design:
    """Read a design from TOML text; files it names are relative to `folder`, the current one when absent.

    Raises
    ------
    DesignError
        If the text is not TOML or not a valid design; names `source`, field, rule and value.
    """
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise DesignError(f"{source}: not valid TOML: {error}") from None
    if "kind" in content:
        raise DesignError(
            f"{source}: field kind: must be absent here, where a design is needed; a model of kind "
            f"{content['kind']!r} is for `compare` and `calibrate` alone"
        )
    contact = content.get("contact")
    assumed = isinstance(contact, Mapping) and contact and "model" not in contact
    design = _validated(content, source, folder)
    if assumed and design.contact.model == "kernel":
        warnings.warn(
            f"{source}: field contact.model: not stated; fields of the smoothing kernel mean 'kernel'",
            ContactModelAssumed,
            stacklevel=2,
        )
    return design


def load(name_or_path: str | Path) -> Design:
    """Load a preset by name, or a design from a TOML file.

    Parameters
    ----------
    name_or_path : str or Path
        A preset's name goes before a file of the same name.

    Returns
    -------
    Design
        The design; lengths are mm, angles degrees.

    Raises
    ------
    DesignError
        If it is neither, or the file cannot be used.
    """
    if str(name_or_path) in preset_names():
        return preset(str(name_or_path))
    path = Path(name_or_path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        if (reason := UNSAYABLE.get(path.name.lower().removesuffix("-like"))) is not None:
            raise DesignError(f"{name_or_path}: {reason}") from None
        known = ", ".join(preset_names())
        raise DesignError(
            f"{name_or_path}: no such file, and no preset of that name (presets: {known})"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise DesignError(f"{name_or_path}: cannot be read as text: {error}") from None
    design = loads(text, source=str(path), folder=path.parent)
    if (
        design.name in preset_names()
        and design.parent is None
        and design.digest != preset(design.name).digest
    ):
        # An edited copy of a preset must not pass for it.
        return design.model_copy(update={"name": path.stem, "parent": design.name})
    return design


def dumps(design: Design) -> str:
    """Write a design as TOML text, complete, with every default spelled out and a comment to each field."""
    import tomli_w

    return commented(tomli_w.dumps(design.model_dump(mode="json", exclude_none=True)), Design)


def preset_names() -> tuple[str, ...]:
    """Names of the published and built-in sensors."""
    folder = resources.files("designlab.sensor.presets")
    return tuple(
        sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))
    )


def preset_text(name: str) -> str:
    """TOML text of a preset, with the source of each figure in its comments."""
    if name.lower().removesuffix("-like") in UNSAYABLE:
        raise DesignError(f"preset {name!r}: {UNSAYABLE[name.lower().removesuffix('-like')]}")
    if name not in preset_names():
        raise DesignError(f"preset {name!r} is unknown; known are {', '.join(preset_names())}")
    return resources.files("designlab.sensor.presets").joinpath(f"{name}.toml").read_text(encoding="utf-8")


@cache
def assumptions(name: str) -> tuple[str, ...]:
    """Fields of a preset whose figures are assumed, as dotted paths; a table stands for all its fields."""
    found, table = [], ""
    places: dict[str, int] = {}
    for line in preset_text(name).splitlines():
        code, _, comment = line.partition("#")
        assumed = "assumption" in comment
        if code.startswith("["):
            table = code.strip().strip("[]")
            if code.startswith("[["):
                places[table] = places.get(table, -1) + 1
                table += f".{places[table]}"
            if assumed:
                found.append(table)
        elif assumed and "=" in code:
            found.append(f"{table}.{code.split('=')[0].strip()}".lstrip("."))
    return tuple(found)


def assumed_fields(design: Design) -> tuple[str, ...]:
    """Fields that a design has from its preset, which assumed them for want of a published figure."""
    name = design.parent or design.name
    if name not in preset_names():
        return ()
    changed = differences(design, preset(name))
    return tuple(
        path
        for path in assumptions(name)
        if not any(own == path or own.startswith(f"{path}.") for own in changed)
    )


@cache
def preset(name: str) -> Design:
    """Load a published or built-in sensor by name.

    Parameters
    ----------
    name : str
        One of those that ``designlab presets`` lists.

    Returns
    -------
    Design
        The design; lengths are mm, angles degrees.

    Raises
    ------
    DesignError
        If there is no preset of that name.
    """
    return loads(preset_text(name), source=f"preset {name}")
