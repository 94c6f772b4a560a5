"""The LED array: emitters on a ring or along the edges, grouped into colour channels."""

from collections.abc import Collection, Iterable, Iterator
from math import cos, radians, sin
from typing import TYPE_CHECKING, Literal, NamedTuple, Self

from pydantic import Field, model_validator

from geometries.emission import AngularProfile
from geometries.spec import Spec, quantity
from geometries.spectrum import Filter, Spectrum

if TYPE_CHECKING:
    import cadquery


Vector = tuple[float, float, float]
SAME_PLACE = 1e-6  # mm, and parts of a unit vector: LEDs that differ by less share one package


class Placement(NamedTuple):
    """Where the rows of a group stand; the fields of `LedArray` say what each means."""

    radius_mm: float
    height_mm: float
    tilt_deg: float
    pitch_mm: float


class LedGroup(Spec):
    """LEDs of one colour, switched together, standing side by side around one azimuth (or several)."""

    name: str = Field(min_length=1, pattern=r"^[A-Za-z][A-Za-z0-9_-]*$")
    """Name of the group, for example red."""
    azimuth_deg: tuple[float, ...] = Field(min_length=1)
    """Directions, counter-clockwise from +x, at which rows of this group stand (deg)."""
    count: int = Field(1, ge=1, le=200)
    """LEDs in each row."""
    flux_mw: float = quantity(10.0, unit="mW", gt=0, le=1e6)
    """Total radiant flux of the group, shared equally by its LEDs."""
    drive: float | None = quantity(None, unit="1", gt=0, le=1)
    """Share of `flux_mw` that the group is driven at, by current or pulse width; full when absent."""
    wavelength_nm: float = quantity(530.0, unit="nm", ge=350, le=1100)
    """Peak wavelength."""
    width_nm: float | None = quantity(None, unit="nm", gt=0.1, le=300)
    """Full width of the spectrum at half maximum; typical of the colour when absent."""
    spectrum: Spectrum | None = None
    """Spectrum of light that is no narrow peak, such as a white LED's: the name of a published one, or a
    table. Camera channels see it; for clear materials `wavelength_nm` still counts."""
    filter: Filter | None = None
    """Colour filter in front of this group's LEDs: the name of a published one, or a table. `flux_mw` is the
    flux before it."""
    profile: AngularProfile | None = None
    """Angular profile of this group's LEDs; the array's when absent."""
    part: str | None = Field(None, min_length=1, max_length=80)
    """Part of the LED library that fills wavelength, width, flux and profile where not given."""
    radius_mm: float | None = quantity(None, unit="mm", gt=0, le=200)
    """Distance of this group's emitting faces from the axis, at the row's middle; the array's when absent."""
    height_mm: float | None = quantity(None, unit="mm", ge=-50, le=200)
    """Height of this group's emitting faces above the membrane plane; the array's when absent."""
    tilt_deg: float | None = quantity(None, unit="deg", ge=-90, le=90)
    """Inclination of this group's emitting direction towards the membrane; the array's when absent."""
    pitch_mm: float | None = quantity(None, unit="mm", gt=0, le=100)
    """Distance between neighbouring LEDs of this group's rows; the array's when absent."""
    offset_mm: tuple[float, float] | None = None
    """Where the emitting strips lie on the front of the package, from their places in leds.emitting_spans_mm:
    (along the row, counter-clockwise; along the height, towards the membrane), mm. Chips of one package may
    lie apart; at their places when absent."""

    @model_validator(mode="after")
    def _one_spectrum(self) -> Self:
        if self.spectrum is not None and self.width_nm is not None:
            raise ValueError(
                f"width_nm: belongs to a peak at wavelength_nm, got {self.width_nm:g} nm beside spectrum; "
                "give one of both"
            )
        return self

    @property
    def driven_mw(self) -> float:
        """Flux of the group as it is driven (mW)."""
        return self.flux_mw if self.drive is None else self.flux_mw * self.drive

    @property
    def colour(self) -> str:
        """Peak wavelength, or name of the spectrum, in words."""
        if self.spectrum is None:
            return f"{self.wavelength_nm:g} nm"
        return f"spectrum {self.spectrum.name or 'of a table'}"


class LedArray(Spec):
    """Where the LEDs stand, what they look like, and which belong together."""

    package: Literal["panel", "smd", "spot"] = "smd"
    """panel: a flat board whose strips emit; smd: a small package with one emitting face; spot: a small
    source with a narrow beam, see profile.beam_deg."""
    part: str | None = Field(None, min_length=1, max_length=80)
    """Part of the LED library that fills package, sizes, profile and, by group name, wavelength, width and
    flux where not given."""
    profile: AngularProfile = Field(default_factory=lambda: AngularProfile())
    """Angular profile of the light that leaves each emitting face: in air, or within the core where the LEDs
    are bonded or embedded."""
    coupling: Literal["air_gap", "bonded", "embedded"] = "air_gap"
    """air_gap: the LEDs stand apart and light refracts into the core; bonded: clear glue of the core's index
    joins emitting face and core side; embedded: the LEDs are cast into the core."""
    glue_mm: float = quantity(0.1, unit="mm", gt=0, le=2)
    """Thickest layer of glue under a bonded LED."""
    layout: Literal["edge", "ring"] = "edge"
    """edge: the LEDs of a row stand on a straight line perpendicular to the azimuth; ring: they stand on the
    circle, each facing the axis."""
    groups: tuple[LedGroup, ...] = Field(min_length=1)
    """Colour groups."""
    radius_mm: float = quantity(14.0, unit="mm", gt=0, le=200)
    """Distance of the emitting faces from the axis, at the row's middle."""
    height_mm: float = quantity(4.0, unit="mm", ge=-50, le=200)
    """Height of the emitting faces' centre above the membrane plane z = 0."""
    tilt_deg: float = quantity(0.0, unit="deg", ge=-90, le=90)
    """Inclination of the emitting direction from horizontal towards the membrane."""
    pitch_mm: float = quantity(4.0, unit="mm", gt=0, le=100)
    """Distance between neighbouring LEDs of a row (along the arc on a ring)."""
    emitting_width_mm: float = quantity(3.0, unit="mm", gt=0, le=200)
    """Width of the emitting face, along the row."""
    emitting_spans_mm: tuple[tuple[float, float], ...] = Field(((-1.0, 1.0),), min_length=1)
    """Emitting strips of an LED, (from, to) along its height, positive to the membrane (mm)."""
    body_width_mm: float = quantity(3.5, unit="mm", gt=0, le=200)
    """Width of the package or board."""
    body_height_mm: float = quantity(2.8, unit="mm", gt=0, le=200)
    """Height of the package or board."""
    body_thickness_mm: float = quantity(1.0, unit="mm", gt=0, le=50)
    """Thickness of the package or board, behind the emitting face."""
    relative_flux: bool = False
    """Whether fluxes are relative to each other, with no electrical power behind them."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names = [group.name for group in self.groups]
        if len(set(names)) != len(names):
            raise ValueError(f"groups: names must differ, got {names}")
        spans = self.emitting_spans_mm
        for low, high in spans:
            if not low < high:
                raise ValueError(
                    f"emitting_spans_mm: each strip runs from low to high, got ({low:g}, {high:g}) mm"
                )
            if max(-low, high) > self.body_height_mm / 2 + 1e-9:
                raise ValueError(
                    f"emitting_spans_mm: strip ({low:g}, {high:g}) mm reaches beyond the body, "
                    f"body_height_mm is {self.body_height_mm:g} mm"
                )
        if self.emitting_width_mm > self.body_width_mm + 1e-9:
            raise ValueError(
                f"emitting_width_mm: must not exceed body_width_mm ({self.body_width_mm:g} mm), "
                f"is {self.emitting_width_mm:g} mm"
            )
        for index, group in enumerate(self.groups):
            along, down = group.offset_mm or (0.0, 0.0)
            ends = [abs(end + down) for span in self.emitting_spans_mm for end in span]
            if (
                abs(along) + self.emitting_width_mm / 2 > self.body_width_mm / 2 + 1e-9
                or max(ends) > self.body_height_mm / 2 + 1e-9
            ):
                raise ValueError(
                    f"groups.{index}.offset_mm: the strips of group {group.name!r} must stay on the body of "
                    f"{self.body_width_mm:g} x {self.body_height_mm:g} mm, got ({along:g}, {down:g}) mm"
                )
        if self.package == "spot":
            for index, group in enumerate(self.groups):
                power = self.profile_of(index).power
                if power is not None and power <= 1.0 + 1e-9:
                    raise ValueError(
                        f"package: a spot has a beam narrower than 120 deg, group {group.name!r} has not; "
                        "give profile.beam_deg"
                    )
        return self

    def profile_of(self, group: int) -> AngularProfile:
        """Angular profile of the LEDs of a group, given by its index."""
        own = self.groups[group].profile
        return self.profile if own is None else own

    def placement_of(self, group: int) -> Placement:
        """Where the rows of a group, given by its index, stand: its own figures, else the array's."""
        own = self.groups[group]
        return Placement(
            *(
                getattr(self, name) if getattr(own, name) is None else getattr(own, name)
                for name in Placement._fields
            )
        )

    def own(self, field: str) -> dict[int, float]:
        """Figures of a field of `Placement` that groups have of their own, by index of the group."""
        found = ((index, getattr(group, field)) for index, group in enumerate(self.groups))
        return {index: value for index, value in found if value is not None}


class Emitter(NamedTuple):
    """One flat emitting rectangle in the sensor frame.

    `centre_mm`, unit vectors `normal` (emitting direction), `across` (along the row) and `down` (along the
    package's height, towards the membrane), half sizes in mm along `across` and `down`, the index of its
    group, and that of the body that carries it. (across, down, normal) is right-handed: across x down =
    normal; `across` points counter-clockwise around the axis.
    """

    group: int
    centre_mm: Vector
    normal: Vector
    across: Vector
    down: Vector
    half_width_mm: float
    half_height_mm: float
    body: int

    @property
    def area_mm2(self) -> float:
        """Emitting area in mm2."""
        return 4.0 * self.half_width_mm * self.half_height_mm


class Body(NamedTuple):
    """Box of one package or board in the sensor frame; its front face carries the emitting strips.

    `centre_mm` is the centre of the box, `half_mm` its half sizes along `across`, `down` and `normal`, which
    are the axes of its emitters; `groups` are the indices of the groups whose LEDs it holds.
    """

    groups: tuple[int, ...]
    centre_mm: Vector
    normal: Vector
    across: Vector
    down: Vector
    half_mm: Vector


def emitters(array: LedArray) -> tuple[Emitter, ...]:
    """Every emitting rectangle of the array in the sensor frame.

    The order is: groups, their azimuths, the LEDs of a row counter-clockwise, the strips of an LED.
    """
    found = []
    for group, body, seat in _leds(array):
        along_mm, down_mm = array.groups[group].offset_mm or (0.0, 0.0)
        face = _shifted(seat.face, seat.across, along_mm) if along_mm else seat.face
        for low, high in array.emitting_spans_mm:
            centre = _shifted(face, seat.down, (low + high) / 2 + down_mm)
            half = array.emitting_width_mm / 2, (high - low) / 2
            found.append(Emitter(group, centre, seat.normal, seat.across, seat.down, *half, body))
    return tuple(found)


def bodies(array: LedArray) -> tuple[Body, ...]:
    """Box of every package in the sensor frame, in the order of the first of its `emitters`.

    LEDs of different groups at the same place, turned alike, share one package.
    """
    half = array.body_width_mm / 2, array.body_height_mm / 2, array.body_thickness_mm / 2
    seats: list[_Seat] = []
    groups: list[list[int]] = []
    for group, body, seat in _leds(array):
        if body == len(seats):
            seats.append(seat)
            groups.append([])
        groups[body].append(group)
    return tuple(
        Body(
            tuple(held),
            _shifted(seat.face, seat.normal, -array.body_thickness_mm / 2),
            seat.normal,
            seat.across,
            seat.down,
            half,
        )
        for held, seat in zip(groups, seats, strict=True)
    )


def joined_groups(packages: Iterable[Collection[int]]) -> list[tuple[int, ...]]:
    """Groups that cannot move apart, since packages hold LEDs of several: sets of their indices, ascending.

    Parameters
    ----------
    packages : iterable of collection of int
        Groups that each package holds, see `Body`.
    """
    joined: list[set[int]] = []
    for held in packages:
        touched = [each for each in joined if each & set(held)]
        joined = [each for each in joined if each not in touched]
        joined.append(set(held).union(*touched))
    return sorted(tuple(sorted(each)) for each in joined)


def solids(array: LedArray) -> "list[cadquery.Solid]":
    """Build every package as a CadQuery solid in the sensor frame (mm), in the order of `bodies`."""
    import cadquery

    boxes = []
    for body in bodies(array):
        width, height, thickness = (2 * half for half in body.half_mm)
        plane = cadquery.Plane(origin=body.centre_mm, xDir=body.across, normal=body.normal)
        boxes.append(
            cadquery.Solid.makeBox(
                width, height, thickness, (-width / 2, -height / 2, -thickness / 2)
            ).locate(cadquery.Location(plane))
        )
    return boxes


def solid(array: LedArray) -> "cadquery.Workplane":
    """Build all LED boxes as one CadQuery compound in the sensor frame (mm)."""
    import cadquery

    return cadquery.Workplane(obj=cadquery.Compound.makeCompound(solids(array)))


class _Seat(NamedTuple):
    """Centre of a package's front face (mm), and its axes."""

    face: Vector
    normal: Vector
    across: Vector
    down: Vector

    @property
    def key(self) -> tuple[int, ...]:
        """Equal for seats that are the same to `SAME_PLACE`."""
        return tuple(round(c / SAME_PLACE) for axis in (self.face, self.normal, self.across) for c in axis)


def _leds(array: LedArray) -> Iterator[tuple[int, int, _Seat]]:
    """Yield every LED: index of its group, number of the package that holds it, where that sits."""
    there: dict[tuple[int, ...], list[tuple[int, set[int]]]] = {}
    count = 0
    for group, seat in _seats(array):
        packages = there.setdefault(seat.key, [])
        # Two LEDs of one group are two packages, which then overlap.
        number = next((n for n, held in packages if group not in held), None)
        if number is None:
            number, count = count, count + 1
            packages.append((number, set()))
        next(held for n, held in packages if n == number).add(group)
        yield group, number, seat


def _seats(array: LedArray) -> Iterator[tuple[int, _Seat]]:
    """Yield the index of the group of every LED, and where the LED sits."""
    for index, group in enumerate(array.groups):
        radius_mm, height_mm, tilt_deg, pitch_mm = array.placement_of(index)
        c, s = cos(radians(tilt_deg)), sin(radians(tilt_deg))
        for azimuth_deg in group.azimuth_deg:
            for place in range(group.count):
                along_mm = (place - (group.count - 1) / 2) * pitch_mm
                azimuth = radians(azimuth_deg)
                if array.layout == "ring":
                    azimuth += along_mm / radius_mm
                    along_mm = 0.0
                radial, across = (cos(azimuth), sin(azimuth), 0.0), (-sin(azimuth), cos(azimuth), 0.0)
                normal, down = (-c * radial[0], -c * radial[1], -s), (s * radial[0], s * radial[1], -c)
                face = (radius_mm * radial[0], radius_mm * radial[1], height_mm)
                yield index, _Seat(_shifted(face, across, along_mm), normal, across, down)


def _shifted(point: Vector, direction: Vector, distance_mm: float) -> Vector:
    x, y, z = (p + distance_mm * d for p, d in zip(point, direction, strict=True))
    return x, y, z
