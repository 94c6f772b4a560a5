"""Measured frames of a real sensor: what is known about each, and what it was taken for."""

import re
import tomllib
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator

from designlab.core.images import ImageError, from_srgb, read_image
from designlab.core.store import digest
from designlab.measurement.depths import cap_depth_mm
from designlab.sensor.camera import View
from designlab.sensor.design import Design, DesignError, load, loads, preset_names
from designlab.sensor.field_errors import explain
from designlab.simulation.contact.press import Direction, Press
from geometries import probes
from geometries.mesh_files import Understood
from geometries.spec import Spec, quantity

FILE_NAME = "measurement.toml"
SPLITS = ("train", "select", "final")
FULL_SCALE = 0.999  # values above are saturated
SAME_PLACE_MM = 0.25  # presses nearer than this share most of their light field, so they share a split
SAME_PLACE_PX = 5.0
CIRCLES = ("contact_radius_px", "contact_diameter_mm", "contact_diameter_px")  # ways to state the contact
MOST_DEPTH_MM = 20.0

MOST_COUNTS = 1024  # different values of a file of ten bits; of more bits rounding is not seen
ENOUGH = 300_000  # values that show all counts
Split = Literal["train", "select", "final"]
Pixels = NDArray[np.float32]


class MeasurementError(ValueError):
    """A measurement folder that breaks a rule; the text names file, frame, field, rule and value."""


def _is_none(value: object) -> bool:
    return value is None


class PoseSigma(Spec):
    """How well the pose of a press and its force are known: one standard deviation each."""

    depth_mm: float | None = quantity(None, unit="mm", ge=0, le=20)
    """Of the depth."""
    centre_mm: float | None = quantity(None, unit="mm", ge=0, le=100)
    """Of each coordinate."""
    yaw_deg: float | None = quantity(None, unit="deg", ge=0, le=360)
    """Of the yaw."""
    force_n: float | None = quantity(None, unit="N", gt=0, le=1000, exclude_if=_is_none)
    """Of the force."""


class MeasuredFrame(Spec):
    """One image and what is known about it; a field that is None is unknown, never zero."""

    file: str = Field(min_length=1)
    """Image file, relative to the folder."""
    kind: Literal["background", "press", "light_probe", "dark", "flat_field"]
    """What it shows."""
    probe: str | None = None
    """Probe as kind[:size_mm[:rEDGE]] or mesh file[:size_mm][:unit][:side]."""
    depth_mm: float | None = quantity(None, unit="mm", gt=0, le=MOST_DEPTH_MM)
    """Largest penetration of the probe."""
    # What is absent of these is not dumped: digests of sets from before they were known stay what they were.
    force_n: float | None = quantity(None, unit="N", gt=0, le=1000, exclude_if=_is_none)
    """Force on the probe along z, beside or instead of its depth."""
    shear_mm: tuple[float, float] | None = Field(None, exclude_if=_is_none)
    """How far the probe was then moved sideways: x, y."""
    twist_deg: float | None = quantity(None, unit="deg", ge=-90, le=90, exclude_if=_is_none)
    """How far it was then turned about its axis, counter-clockwise."""
    centre_mm: tuple[float, float] | None = None
    """Where the probe's axis meets the gel."""
    yaw_deg: float | None = quantity(None, unit="deg", ge=-360, le=360)
    """Rotation of the probe, counter-clockwise."""
    direction: Direction | None = Field(None, exclude_if=_is_none)
    """Along which it was pressed: the sensor's axis (when absent), or the normal of the membrane."""
    sigma: PoseSigma | None = None
    """How well the pose is known."""
    leds: tuple[str, ...] | None = None
    """LED groups switched on; all when absent."""
    exposure: float | None = quantity(None, unit="1", gt=0)
    """Relative exposure of the frame."""
    gel_rotation_deg: float | None = quantity(None, unit="deg", ge=-360, le=360)
    """Rotation of the gel about the camera's axis."""
    crop_px: tuple[int, int, int, int] | None = None
    """Rectangle of the full sensor image: x, y, width, height; a smaller file is binned."""
    repeat: int | None = Field(None, ge=0)
    """Number of the repeat; repeats share all other fields."""
    split: Split | None = None
    """Use of the frame; by press position when absent."""
    centre_px: tuple[float, float] | None = None
    """Centre read off the image: column, row."""
    contact_radius_px: float | None = quantity(None, unit="px", gt=0)
    """Radius of the contact read off the image; of a light probe, that of the ball's outline."""
    contact_diameter_mm: float | None = quantity(None, unit="mm", gt=0, le=100, exclude_if=_is_none)
    """Diameter of the contact circle of a ball, which tells its depth."""
    contact_diameter_px: float | None = quantity(None, unit="px", gt=0, exclude_if=_is_none)
    """The same, read off the image."""
    depth_range_mm: tuple[float, float] | None = Field(None, exclude_if=_is_none)
    """Least and greatest depth of a press whose depth is not known."""
    lowest_mm: float | None = quantity(None, unit="mm", ge=-100, le=200)
    """Of a light probe: height of the ball's lowest point above the plane z = 0."""
    immersed: bool | None = None
    """Of a light probe: whether a liquid of the gel's index joins ball and gelcore."""

    @field_validator("probe")
    @classmethod
    def _known_probe(cls, text: str | None, info: ValidationInfo) -> str | None:
        if text is not None and info.data.get("kind") == "light_probe":
            text = re.sub(r"^\s*ball\b", "sphere", text)
        if text is None:
            return None
        if probes.is_mesh(text):
            probes.mesh_text(text)  # its file is looked for when the set is read
        else:
            probes.parse(text)
        return text

    @field_validator("crop_px")
    @classmethod
    def _positive_crop(cls, crop: tuple[int, int, int, int] | None) -> tuple[int, int, int, int] | None:
        if crop is not None and (min(crop[:2]) < 0 or min(crop[2:]) < 1):
            raise ValueError("x and y are at least 0, width and height at least 1")
        return crop

    @field_validator("depth_range_mm")
    @classmethod
    def _rising_range(cls, ends: tuple[float, float] | None) -> tuple[float, float] | None:
        if ends is not None and not 0 < ends[0] < ends[1] <= MOST_DEPTH_MM:
            raise ValueError(f"least and greatest depth, 0 < least < greatest <= {MOST_DEPTH_MM:g} mm")
        return ends

    @model_validator(mode="after")
    def _kind_has_fields(self) -> Self:
        if self.kind == "press" and self.probe is None:
            raise ValueError("probe: a press needs the probe that was pressed")
        if self.kind == "light_probe":
            if self.probe is not None and not re.fullmatch(r"sphere(:.*)?", self.probe.strip()):
                raise ValueError(f"probe: a light probe is a sphere:diameter_mm, got {self.probe!r}")
        else:
            for name in ("lowest_mm", "immersed"):
                if getattr(self, name) is not None:
                    raise ValueError(f"{name}: is for a light_probe frame, this one is a {self.kind}")
        if self.kind != "press":
            for name in ("force_n", "shear_mm", "twist_deg", "direction", *CIRCLES[1:], "depth_range_mm"):
                if getattr(self, name) is not None:
                    raise ValueError(f"{name}: is for a press, this one is a {self.kind}")
        if self.kind == "dark" and self.leds:
            raise ValueError(f"leds: no LED is on in a dark frame, got {list(self.leds)}")
        return self

    @model_validator(mode="after")
    def _one_depth(self) -> Self:
        """Depth, force and circle may stand beside each other, but a circle once and no range beside them."""
        circles = [name for name in CIRCLES if getattr(self, name) is not None]
        if len(circles) > 1:
            raise ValueError(f"{circles[1]}: says the same as {circles[0]}; leave one of them out")
        if circles and circles[0] != CIRCLES[0] and not re.match(r"\s*sphere\b", self.probe or ""):
            raise ValueError(f"{circles[0]}: tells the depth of a sphere alone, the probe is {self.probe!r}")
        known = [name for name in ("depth_mm", "force_n", *circles) if getattr(self, name) is not None]
        if self.depth_range_mm is not None and known:
            raise ValueError(
                f"depth_range_mm: is for a press of unknown depth, {known[0]} tells it; leave one of them "
                "out, and say in sigma how well it is known"
            )
        return self

    @property
    def depth_told(self) -> bool:
        """Whether its depth, its force or a contact circle is stated."""
        return any(getattr(self, name) is not None for name in ("depth_mm", "force_n", *CIRCLES))

    @property
    def lit(self) -> bool:
        """Whether any LED is on."""
        return self.kind != "dark" and self.leds != ()


class Measurement(Spec):
    """A set of frames of one sensor, in the order of its file."""

    name: str = ""
    """Short name of the set."""
    sensor: str = "unknown"
    """Preset, path of a design or model TOML, or unknown."""
    response: str = "unknown"
    """linear, srgb, gamma:2.2 or unknown."""
    source: str = ""
    """Where the set comes from."""
    mm_per_px: float | None = quantity(None, unit="mm/px", gt=0, le=10)
    """Size of a pixel of the files on the membrane."""
    frames: tuple[MeasuredFrame, ...] = Field(min_length=1)
    """The frames."""
    folder: Path | None = Field(None, exclude=True)
    """Folder of the files."""

    @field_validator("response")
    @classmethod
    def _known_response(cls, text: str) -> str:
        match = re.fullmatch(r"gamma:([0-9.]+)", text)
        if text not in ("linear", "srgb", "unknown") and not (match and 0.1 <= float(match[1]) <= 10):
            raise ValueError("one of linear, srgb, gamma:G with G from 0.1 to 10, unknown")
        return text

    def content_digest(self) -> str:
        """Digest of a set: of what it says and of the content of its files."""
        return digest(self, *(self.path(frame.file).read_bytes() for frame in self.frames))

    def image(self, frame: MeasuredFrame) -> Pixels:
        """Values of a frame's file, shape (rows, columns, channels), read-only; see `linear` for radiance."""
        path = self.path(frame.file)
        try:
            return _cached_image(str(path), path.stat().st_mtime_ns)
        except (OSError, ImageError) as error:
            raise MeasurementError(str(error)) from None

    def linear(self, frame: MeasuredFrame) -> Pixels:
        """Values of a frame's file with the response undone, proportional to radiance plus the black level.

        Raises
        ------
        MeasurementError
            If the response is unknown.
        """
        if self.response == "unknown":
            raise MeasurementError(f"{self.folder}: field response: must be known to get linear values")
        return self._linear(self.image(frame))

    def rounding(self, frame: MeasuredFrame) -> Pixels:
        """Standard deviation of the error that rounding to whole counts leaves, in linear values.

        0 where a file has too many different values to be rounded, as 16 bits and floats have.
        """
        values = self.image(frame)
        counts = np.unique(values.ravel()[:: max(1, values.size // ENOUGH)])
        if len(counts) > MOST_COUNTS or len(counts) < 2:
            return np.zeros_like(values)
        half = np.float32(np.diff(counts).min() / 2)
        width = self._linear(values + half) - self._linear(np.maximum(values - half, 0.0))
        return np.asarray(width / np.sqrt(np.float32(12)))

    def _linear(self, values: Pixels) -> Pixels:
        """Undo the response."""
        if self.response == "linear":
            return values
        if self.response == "srgb":
            return from_srgb(values).astype(np.float32)
        return np.asarray(np.clip(values, 0, None) ** float(self.response.removeprefix("gamma:")), np.float32)

    def design(self) -> Design | None:
        """Design the set names, None where the sensor is unknown; of a model file, the design it is built on.

        Raises
        ------
        MeasurementError
            If the file cannot be used.
        """
        if self.sensor == "unknown":
            return None
        try:
            if self.sensor in preset_names():
                return load(self.sensor)
            path = self.path(self.sensor)
            content = tomllib.loads(path.read_text(encoding="utf-8"))
            if isinstance(content.get("design"), dict):
                import tomli_w

                return loads(tomli_w.dumps(content["design"]), source=str(path))
            return load(path)
        except OSError as error:
            raise MeasurementError(
                f"{self.folder}: field sensor: must be a preset (`designlab presets`), unknown, or a file "
                f"that can be read, got {self.sensor!r} ({error.strerror or error})"
            ) from None
        except (DesignError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise MeasurementError(f"{self.folder}: field sensor: {error}") from None

    def view(self, frame: MeasuredFrame, design: Design) -> View:
        """Rectangle of the camera's sensor that a frame shows, with the frame's own columns and rows."""
        rows, columns = self.image(frame).shape[:2]
        x, y, width, height = frame.crop_px or (0, 0, design.camera.width_px, design.camera.height_px)
        return View(float(x), float(y), float(width), float(height), columns, rows)

    def centre_mm(self, frame: MeasuredFrame) -> tuple[float, float] | None:
        """Centre of a press in the sensor frame (mm), None where unknown.

        A centre read off the image is converted with `mm_per_px`, the middle of the image being the origin.
        """
        if frame.centre_mm is not None or frame.centre_px is None or self.mm_per_px is None:
            return frame.centre_mm
        rows, columns = self.image(frame).shape[:2]
        column, row = frame.centre_px
        return (column - columns / 2) * self.mm_per_px, (rows / 2 - row) * self.mm_per_px

    def contact_radius_mm(self, frame: MeasuredFrame) -> float | None:
        """Radius of the contact as measured, or read off the image (mm), None where unknown."""
        if frame.contact_diameter_mm is not None:
            return frame.contact_diameter_mm / 2
        radius_px = frame.contact_radius_px
        if frame.contact_diameter_px is not None:
            radius_px = frame.contact_diameter_px / 2
        return None if radius_px is None or self.mm_per_px is None else radius_px * self.mm_per_px

    def _probe_text(self, probe: str) -> str:
        """Text of a probe, of a mesh with the place of its file."""
        if not probes.is_mesh(probe):
            return probe
        stated = probes.mesh_text(probe)
        return stated._replace(file=str(self.path(stated.file))).text

    def meshes(self) -> list[Understood]:
        """Say what the mesh files of the probes are taken for, each once.

        Raises
        ------
        MeasurementError
            If one holds nothing that can press.
        """
        found: dict[str, Understood | None] = {}
        for frame in self.frames:
            if frame.probe is not None and probes.is_mesh(frame.probe) and frame.probe not in found:
                try:
                    found[frame.probe] = probes.understood(probes.parse(self._probe_text(frame.probe)))
                except ValueError as error:
                    raise self.error(frame, f"probe: {error}", None) from None
        return [mesh for mesh in found.values() if mesh is not None]

    def press(self, frame: MeasuredFrame) -> Press | None:
        """Indentation that a frame shows as far as its metadata tell; None for a frame without contact.

        A frame that states both depth and force is pressed to its depth; one without a depth by its force;
        a ball of which neither is known as deep as it cuts the membrane in the circle that was read off.

        Raises
        ------
        MeasurementError
            If the size of the probe, its centre, or all of depth, force and circle are unknown.
        """
        if frame.probe is None:
            return None
        text = self._probe_text(frame.probe)
        if not probes.is_mesh(text) and ":" not in text:
            raise self.error(frame, "probe: its size is unknown, write kind:size_mm", frame.probe)
        centre = self.centre_mm(frame)
        depth_mm, radius_mm = frame.depth_mm, self.contact_radius_mm(frame)
        known = depth_mm or frame.force_n or radius_mm
        for field, value in (("depth_mm", known), ("centre_mm", centre)):
            if value is None:
                raise self.error(frame, f"{field}: unknown, so the press cannot be simulated", None)
        try:
            probe = probes.parse(text)
            if depth_mm is None and frame.force_n is None and radius_mm is not None:
                depth_mm = cap_depth_mm(probe, radius_mm)
            return Press.model_validate(
                {
                    "probe": probe,
                    "depth_mm": depth_mm,
                    "force_n": frame.force_n if depth_mm is None else None,
                    "centre_mm": centre,
                    # A probe of revolution looks the same at every yaw; for others zero is a start.
                    "yaw_deg": frame.yaw_deg or 0.0,
                    "direction": frame.direction or "axis",
                    "shear_mm": frame.shear_mm or (0.0, 0.0),
                    "twist_deg": frame.twist_deg or 0.0,
                }
            )
        except ValidationError as error:
            raise self.error(frame, explain(error), None) from None
        except ValueError as error:  # a mesh file that holds no usable body
            raise self.error(frame, str(error), None) from None

    def split(self) -> dict[Split, tuple[MeasuredFrame, ...]]:
        """Sort the presses into train, select and final by position, never by pixel.

        Presses at one place (within 0.25 mm or 5 px) share a split. A stated split holds for its whole
        place. The other places are ordered by azimuth about their centre, so that the order of the file does
        not matter, and dealt out train, select, final, train in turn; two places give train and final, one
        gives train.
        Presses whose place is unknown are only trained on, for nothing shows that they are independent.

        Raises
        ------
        MeasurementError
            If the presses at one place state different splits.
        """
        chosen: dict[str, Split] = {}
        places = self._places()
        open_places = []
        for centre, frames in places:
            stated = {frame.split for frame in frames if frame.split is not None}
            if len(stated) > 1:
                raise self.error(frames[0], "split: presses at one place must share it", sorted(stated))
            if stated:
                chosen |= {frame.file: split for frame in frames for split in stated}
            elif centre is None:
                chosen |= {frame.file: "train" for frame in frames}
            else:
                open_places.append((centre, frames))
        dealt: tuple[Split, ...] = ("train", "select", "final", "train")
        if len(open_places) == 2 and len(places) == 2:
            dealt = ("train", "final")
        middle = np.mean([centre for centre, _ in open_places], axis=0) if open_places else np.zeros(2)

        def azimuth(place: tuple[tuple[float, float], list[MeasuredFrame]]) -> tuple[float, float, float]:
            dx, dy = np.round(np.asarray(place[0]) - middle, 6)
            return round(float(np.arctan2(dy, dx)), 6), float(dx), float(dy)

        for number, (_, frames) in enumerate(sorted(open_places, key=azimuth)):
            chosen |= {frame.file: dealt[number % len(dealt)] for frame in frames}
        presses = [frame for frame in self.frames if frame.kind == "press"]
        train, select, final = (tuple(f for f in presses if chosen[f.file] == split) for split in SPLITS)
        return {"train": train, "select": select, "final": final}

    def _places(self) -> list[tuple[tuple[float, float] | None, list[MeasuredFrame]]]:
        """Presses grouped by place; a centre in mm where every press has one, else in px."""
        presses = [frame for frame in self.frames if frame.kind == "press"]
        in_mm = all(frame.centre_mm is not None or frame.centre_px is None for frame in presses)
        known = [f for f in presses if (f.centre_mm if in_mm else f.centre_px) is not None]
        places: list[tuple[tuple[float, float] | None, list[MeasuredFrame]]] = [
            (None, [frame]) for frame in presses if frame not in known
        ]
        if not known:
            return places
        centres = np.array([frame.centre_mm if in_mm else frame.centre_px for frame in known])
        labels = np.zeros(1, dtype=int)
        if len(known) > 1:
            from scipy.cluster.hierarchy import fclusterdata

            # Single linkage: a place grows along a chain of near presses, so no two places touch.
            reach = SAME_PLACE_MM if in_mm else SAME_PLACE_PX
            labels = fclusterdata(centres, t=reach, criterion="distance", method="single")
        for label in np.unique(labels):
            x, y = centres[labels == label].mean(axis=0)
            members = [frame for frame, own in zip(known, labels, strict=True) if own == label]
            places.append(((float(x), float(y)), members))
        return places

    def path(self, file: str) -> Path:
        """Where a file that the set names lies."""
        return Path(file) if self.folder is None else self.folder / file

    def error(self, frame: MeasuredFrame, rule: str, value: Any) -> MeasurementError:
        """Error that names file, frame, field, rule and, unless None, the value."""
        got = "" if value is None else f", got {value!r}"
        where = FILE_NAME if self.folder is None else self.folder / FILE_NAME
        number = self.frames.index(frame) + 1
        return MeasurementError(f"{where}: frame {number} ({frame.file}): field {rule}{got}")


def dark_level(measurement: Measurement, frame: MeasuredFrame) -> NDArray[np.float64] | None:
    """Mean of each channel over the dark frames of a frame's crop; None where there are none."""
    darks = [f for f in measurement.frames if not f.lit and f.crop_px == frame.crop_px]
    levels = [measurement.linear(f).mean(axis=(0, 1), dtype=float) for f in darks]
    return np.asarray(np.mean(levels, axis=0)) if levels else None


def alike(frames: Iterable[MeasuredFrame], *, but: Sequence[str] = ()) -> list[list[MeasuredFrame]]:
    """Groups of frames that differ in their file, the number of the repeat and the fields named alone."""
    differ = {"file": "-", "repeat": None, **dict.fromkeys(but)}
    groups: dict[str, list[MeasuredFrame]] = {}
    for frame in frames:
        groups.setdefault(frame.model_copy(update=differ).model_dump_json(), []).append(frame)
    return list(groups.values())


def mesh_file(probe: str) -> str | None:
    """File of a probe given as mesh, without size, unit and side."""
    return probes.mesh_text(probe).file if probes.is_mesh(probe) else None


@lru_cache(maxsize=32)
def _cached_image(path: str, modified_ns: int) -> Pixels:
    pixels = read_image(path)
    pixels.setflags(write=False)
    return pixels
