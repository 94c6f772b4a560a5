"""What a lens calibration says, by the names that OpenCV, ROS, Kalibr, COLMAP and scripts use."""

import re
import reprlib
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from designlab.core.types import Array
from designlab.measurement.importing.lens_formats import COLMAP, LensError, read_documents
from designlab.measurement.importing.lens_names import (
    CENTRE,
    CENTRE_X,
    CENTRE_Y,
    EITHER,
    FISHEYE_ORDER,
    FISHEYES,
    FLAGS,
    FOCAL,
    FOCAL_X,
    FOCAL_Y,
    GROUPS,
    HEIGHTS,
    KNOWN_MODELS,
    LABELS,
    LISTS,
    MATRICES,
    MODELS,
    PINHOLE_COUNTS,
    PINHOLE_ORDER,
    PINHOLES,
    SECOND,
    SHAPES,
    SIZES,
    VECTORS,
    WIDTHS,
    plain,
)
from designlab.sensor.camera import WIDEST_PINHOLE_DEG
from designlab.sensor.field_errors import explain
from designlab.sensor.lens import Distortion, Fisheye

NARROWEST_DEG, WIDEST_DEG = 5.0, 200.0  # beyond, a focal length is not in pixels of this size
MIDDLE = 0.25, 0.75  # of the picture: lenses sit above their sensors to some per cent
SKEW = 1e-6  # of fx, as rounding leaves it
ABSENT = "", "~", "null"  # nothing, as YAML writes it
DEEPEST = 4  # tables within tables, or lists within lists, that are looked into
MOST_NUMBERS = 1000  # of one value: no matrix and no list of coefficients has as many


class LensCalibration(NamedTuple):
    """What a file says of a lens.

    `matrix` (3, 3) has distances in px of the calibrated pictures and counts from the centre of the first
    pixel, as OpenCV does; `coefficients` are by OpenCV's names. `fields` says what was read from which field
    of the file.
    """

    path: Path
    kind: str
    matrix: Array
    coefficients: Mapping[str, float]
    size_px: tuple[int, int]
    fisheye: bool
    model: str
    half_angle: float
    fields: Mapping[str, str]
    notes: tuple[str, ...]

    @property
    def horizontal_fov_deg(self) -> float:
        """Full horizontal field of view as a design states it."""
        return float(np.degrees(2 * self.half_angle))

    @property
    def understood(self) -> dict[str, Any]:
        """What was understood, as plain data."""
        return {
            "file": str(self.path),
            "as": self.kind,
            "size": list(self.size_px),
            "lens": "fisheye" if self.fisheye else "pinhole",
            "model": self.model,
            "fx": float(self.matrix[0, 0]),
            "fy": float(self.matrix[1, 1]),
            "cx": float(self.matrix[0, 2]),
            "cy": float(self.matrix[1, 2]),
            "horizontal_fov_deg": self.horizontal_fov_deg,
            "distortion": dict(self.coefficients),
            "fields": dict(self.fields),
        }

    def __str__(self) -> str:
        """What was understood, in a line."""
        (fx, _, cx), (_, fy, cy) = self.matrix[:2]
        bent = " ".join(f"{name} {value:g}" for name, value in self.coefficients.items() if value)
        return (
            f"{self.path.name}: {self.kind}, {self.size_px[0]} x {self.size_px[1]}, fx {fx:.1f} fy {fy:.1f} "
            f"px, cx {cx:.1f} cy {cy:.1f}, {self.horizontal_fov_deg:.1f} deg wide, {self.model} "
            f"{bent or 'without distortion'}"
        )


def read_calibration(
    path: str | Path, *, fisheye: bool | None = None, size_px: tuple[int, int] | None = None
) -> LensCalibration:
    """Read the calibration of one lens.

    Parameters
    ----------
    path : path
        What `cv2.FileStorage` writes (YAML, XML, JSON), camera_info of ROS, a camchain of Kalibr, cameras.txt
        of COLMAP, or YAML, JSON or an .npz archive with the names that scripts use.
    fisheye : bool, optional
        Whether `cv2.fisheye` was used, where the file does not say.
    size_px : tuple of int, optional
        Width and height of the calibrated pictures, where the file does not say.

    Raises
    ------
    LensError
        Naming the file, the field and what is wrong or cannot be represented.
    """
    path = Path(path)
    documents = read_documents(path)
    found = [(document.kind, *camera) for document in documents for camera in _cameras(document.values)]
    if not found:
        seen = ", ".join(str(name) for document in documents for name in list(document.values)[:12])
        raise LensError(
            f"{path}: field camera_matrix: missing, and there is no fx either; is it a lens calibration? "
            f"It has {seen or 'nothing'}"
        )
    made = [_Reader(path, kind, values).calibration(fisheye, size_px) for kind, _, values in found]
    # A recording repeats one calibration with other times.
    if any(each.understood != made[0].understood for each in made):
        names = [prefix.rstrip(".") or str(number) for number, (_, prefix, _) in enumerate(found, start=1)]
        raise LensError(f"{path}: holds several cameras ({', '.join(names)}); keep that of this sensor alone")
    return made[0]


def _cameras(values: Any, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Tables that state a camera, with the path to them."""
    if isinstance(values, list | tuple):
        values = {str(number): each for number, each in enumerate(values[:100])}
    if not isinstance(values, Mapping) or "data" in values:
        return
    names = {plain(name) for name in values}
    if names & {*MATRICES, *FOCAL_X, *FOCAL_Y, *FOCAL, "projectionparameters"}:
        yield prefix, values
    elif depth < DEEPEST:
        for name, value in values.items():
            yield from _cameras(value, f"{prefix}{name}.", depth + 1)


class _Entry(NamedTuple):
    name: str  # as the file has it
    value: Any


class _Reader:
    """Finds the values of one camera by their names."""

    def __init__(self, path: Path, kind: str, values: Mapping[str, Any]) -> None:
        self.path, self.kind = path, kind
        self.read: dict[str, str] = {}
        self.notes: list[str] = []
        self.entries: dict[str, _Entry] = {}
        groups: list[tuple[str, Mapping[str, Any]]] = []
        for name, value in values.items():
            if plain(name) in GROUPS and isinstance(value, Mapping) and "data" not in value:
                groups.append((str(name), value))
            elif value is not None and not (isinstance(value, str) and value.strip() in ABSENT):
                self.entries.setdefault(plain(name), _Entry(str(name), value))
        for group, inner in groups:
            for name, value in inner.items():
                self.entries.setdefault(plain(name), _Entry(f"{group}.{name}", value))

    def calibration(self, fisheye: bool | None, size_px: tuple[int, int] | None) -> LensCalibration:
        """Put together what the file says, and refuse what cannot be."""
        if any(name in self.entries and self._count(name) == 9 for name in SECOND):
            raise LensError(f"{self.path}: holds two cameras; keep that of this sensor alone")
        matrix = self._matrix()
        size = self._size(size_px)
        model, fish = self._model(fisheye)
        coefficients = self._coefficients(model, fish)
        half_angle = self._checked(matrix, size, fish, coefficients)
        return LensCalibration(
            self.path,
            self.kind,
            matrix,
            coefficients,
            size,
            fish,
            model or ("fisheye" if fish else "pinhole"),
            half_angle,
            self.read,
            tuple(self.notes),
        )

    def _refused(self, field: str, rule: str) -> LensError:
        return LensError(f"{self.path}: field {field}: {rule}")

    def _one(self, names: Sequence[str]) -> _Entry | None:
        return next((self.entries[name] for name in names if name in self.entries), None)

    def _count(self, name: str) -> int:
        try:
            return len(self._numbers(self.entries[name]))
        except LensError:
            return 0

    def _numbers(self, entry: _Entry) -> list[float]:
        """All numbers of a value, row by row."""
        value = entry.value
        field = entry.name
        if isinstance(value, Mapping) and "data" in value:
            value, field = value["data"], f"{field}.data"
            if entry.value.keys() >= {"rows", "cols"}:
                sides = [self._number(_Entry(f"{entry.name}.{s}", entry.value[s])) for s in ("rows", "cols")]
                data = self._numbers(_Entry(field, value))
                if sides[0] * sides[1] != len(data):
                    rule = f"must hold rows x cols = {sides[0]:g} x {sides[1]:g} numbers, has {len(data)}"
                    raise self._refused(field, rule)
                return data
        try:
            numbers = list(islice(_flat(value), MOST_NUMBERS))
        except (TypeError, ValueError, OverflowError):
            raise self._refused(field, f"must be numbers, got {_shown(value)}") from None
        if not np.isfinite(numbers).all():
            raise self._refused(field, f"must be finite numbers, got {_shown(value)}")
        return numbers

    def _number(self, entry: _Entry) -> float:
        numbers = self._numbers(entry)
        if len(numbers) != 1:
            raise self._refused(entry.name, f"must be one number, got {_shown(entry.value)}")
        return numbers[0]

    def _matrix(self) -> Array:
        """Camera matrix, from a matrix or from its four values."""
        scalars = self._scalars()
        entry = self._one([name for name in MATRICES if name in self.entries])
        if entry is None:
            for name in ("fx", "fy", "cx", "cy"):
                if name not in scalars:
                    raise self._refused(
                        name, f"missing; has {', '.join(e.name for e in self.entries.values())}"
                    )
            values = scalars
            self.read["matrix"] = "fx, fy, cx, cy"
        else:
            values = self._of_matrix(entry)
            self.read["matrix"] = entry.name
            for name, value in scalars.items():
                if abs(value - values[name]) > 1e-6 * max(1.0, abs(value)):
                    rule = f"says {name} {values[name]:g}, the file also says {value:g}; keep the right one"
                    raise self._refused(entry.name, rule)
        if not (values["fx"] > 0 and values["fy"] > 0):
            rule = f"fx and fy must be positive, got {values['fx']:g} and {values['fy']:g}"
            raise self._refused(self.read["matrix"], rule)
        from_corner = 0.0
        if self.kind == COLMAP:
            from_corner = 0.5
            self.notes.append(
                f"{self.path}: COLMAP counts from the edge of the first pixel, OpenCV from its centre: cx "
                f"{values['cx']:g} of the file is {values['cx'] - from_corner:g} here"
            )
        return np.array(
            [
                [values["fx"], 0.0, values["cx"] - from_corner],
                [0.0, values["fy"], values["cy"] - from_corner],
                [0.0, 0.0, 1.0],
            ]
        )

    def _scalars(self) -> dict[str, float]:
        found: dict[str, float] = {}
        for pair, single, names in (
            (("fx", "fy"), FOCAL, (FOCAL_X, FOCAL_Y)),
            (("cx", "cy"), CENTRE, (CENTRE_X, CENTRE_Y)),
        ):
            if (entry := self._one(single)) is not None:
                numbers = self._numbers(entry)
                if len(numbers) not in (1, 2) or (len(numbers) == 1 and single is CENTRE):
                    raise self._refused(entry.name, f"must be two numbers, got {_shown(entry.value)}")
                found |= dict(zip(pair, numbers * (3 - len(numbers)), strict=False))
            for name, known in zip(pair, names, strict=True):
                if (entry := self._one(known)) is not None:
                    found[name] = self._number(entry)
        return found

    def _of_matrix(self, entry: _Entry) -> dict[str, float]:
        numbers = self._numbers(entry)
        if len(numbers) == 4 and plain(entry.name.rpartition(".")[2]) in VECTORS:
            return dict(zip(("fx", "fy", "cx", "cy"), numbers, strict=True))
        if len(numbers) != 9:
            raise self._refused(entry.name, f"must be 3 x 3, got {len(numbers)} numbers")
        (fx, skew, cx), (low, fy, cy), last = np.array(numbers).reshape(3, 3)
        if (fx, fy) == (0.0, 0.0):
            raise self._refused(entry.name, "fx and fy must be positive, got 0 and 0; was it calibrated?")
        if tuple(last) != (0.0, 0.0, 1.0) or low != 0:
            raise self._refused(
                entry.name,
                f"must be fx 0 cx, 0 fy cy, 0 0 1 row by row (is it transposed?), got {_shown(numbers)}",
            )
        if abs(skew) > SKEW * abs(fx):
            raise self._refused(entry.name, f"a design has no skew, must be 0, got {skew:g}")
        return {"fx": float(fx), "fy": float(fy), "cx": float(cx), "cy": float(cy)}

    def _size(self, given: tuple[int, int] | None) -> tuple[int, int]:
        """Width and height of the calibrated pictures."""
        stated = self._stated_size()
        if stated is not None:
            if given not in (None, stated):
                rule = f"says {stated[0]} x {stated[1]}, but --lens-size differs; leave --lens-size away"
                raise self._refused(self.read["size"], rule)
            return stated
        if given is None:
            raise LensError(
                f"{self.path}: states no picture size; give that of the calibrated pictures, such as "
                "--lens-size 640x480"
            )
        self.read["size"] = "--lens-size"
        return self._side("--lens-size", given[0]), self._side("--lens-size", given[1])

    def _stated_size(self) -> tuple[int, int] | None:
        width, height = self._one(WIDTHS), self._one(HEIGHTS)
        if width is not None and height is not None:
            self.read["size"] = f"{width.name}, {height.name}"
            return self._side(width.name, self._number(width)), self._side(height.name, self._number(height))
        for missing, there in (("image_height", width), ("image_width", height)):
            if there is not None:
                raise self._refused(missing, f"missing, there is only {there.name}")
        for names in (SIZES, SHAPES):
            entry = self._one(names)
            if entry is None:
                continue
            if isinstance(entry.value, str):  # 640x480
                entry = entry._replace(value=re.sub(r"(?<=\d)\s*[xX*×]\s*(?=\d)", " ", entry.value))
            numbers = self._numbers(entry)
            if names is SHAPES:
                numbers = numbers[1::-1]
            if len(numbers) != 2:
                raise self._refused(entry.name, f"must be two numbers, got {_shown(entry.value)}")
            self.read["size"] = entry.name
            return self._side(entry.name, numbers[0]), self._side(entry.name, numbers[1])
        return None

    def _side(self, name: str, value: float) -> int:
        if value != int(value) or not 16 <= value <= 100_000:
            raise self._refused(name, f"must be a whole number of pixels, 16 to 100000, got {value:g}")
        return int(value)

    def _model(self, given: bool | None) -> tuple[str, bool]:
        """Name of the model as the file has it, or none, and whether it is a fisheye."""
        stated: dict[str, bool] = {}
        names = []
        for name in (*MODELS, "distortion"):
            entry = self.entries.get(name)
            if entry is None or (name == "distortion" and not _is_word(entry.value)):
                continue
            shown = str(entry.value).strip()
            model = plain(shown.rpartition(".")[2])
            if model not in (*EITHER, *PINHOLES, *FISHEYES):
                raise self._refused(entry.name, f"{shown!r} is not known; known are {KNOWN_MODELS}")
            self.read.setdefault("model", entry.name)
            if model in EITHER:
                names.append(shown)
                continue
            names.insert(0, shown)
            stated[f"{entry.name} {shown}"] = model in FISHEYES
        for name, entry in self.entries.items():  # a fisheye by any other field is no pinhole
            if name in MODELS or name.endswith(LABELS) or not _is_word(entry.value):
                continue
            if plain(entry.value) in FISHEYES:
                self.read.setdefault("model", entry.name)
                names.append(str(entry.value).strip())
                stated[f"{entry.name} {entry.value}"] = True
        if (flag := self._one(FLAGS)) is not None:
            words = {"true": 1.0, "yes": 1.0, "false": 0.0, "no": 0.0}
            value = words.get(str(flag.value).strip().lower())
            stated[flag.name] = bool(self._number(flag) if value is None else value)
        if given is not None:
            stated["--fisheye"] = given
        if len(set(stated.values())) > 1:
            raise LensError(
                f"{self.path}: contradicts itself about the lens: "
                + ", ".join(
                    f"{name} says {'fisheye' if fish else 'pinhole'}" for name, fish in stated.items()
                )
            )
        if stated:
            return names[0] if names else "", next(iter(stated.values()))
        count = 0 if (entry := self._list()) is None else len(self._numbers(entry))
        if count == len(FISHEYE_ORDER) and not names:
            if plain(self.read.get("size", "")) == "dim":
                # K, D and DIM are the names in the usual script for cv2.fisheye.
                self.notes.append(
                    f"{self.path}: states no model; K, D of 4 and DIM are names that go with cv2.fisheye, "
                    "so it is taken for a fisheye; a pinhole states 5 coefficients"
                )
                return "", True
            self.notes.append(
                f"{self.path}: states no model; 4 coefficients are taken for k1 k2 p1 p2 of a pinhole; give "
                "--fisheye if cv2.fisheye made them"
            )
        return names[0] if names else "", False

    def _list(self) -> _Entry | None:
        """Distortion coefficients as a list."""
        there = [self.entries[name] for name in LISTS if name in self.entries]
        return next((entry for entry in there if not _is_word(entry.value)), None)

    def _coefficients(self, model: str, fisheye: bool) -> dict[str, float]:
        order = FISHEYE_ORDER if fisheye else PINHOLE_ORDER
        single = {n: e for n, e in self.entries.items() if n in PINHOLE_ORDER and n not in ("k", "d")}
        entry = self._list()
        if entry is not None and single:
            name = next(iter(single.values())).name
            raise self._refused(entry.name, f"states distortion that {name} states too; keep one of them")
        field = "distortion_coefficients"
        if entry is not None:
            field, numbers = entry.name, self._numbers(entry)
            allowed = (0, len(FISHEYE_ORDER)) if fisheye else PINHOLE_COUNTS
            if len(numbers) not in allowed:
                raise self._refused(
                    field,
                    f"a {'fisheye' if fisheye else 'pinhole'} lens has {' or '.join(map(str, allowed[1:]))} "
                    f"coefficients ({' '.join(order[:5])}), got {len(numbers)}",
                )
            named = dict(zip(order, numbers, strict=False))
        elif single:
            field = ", ".join(each.name for each in single.values())
            for name, other in (("k1", "k2"), ("k2", "k3"), ("p1", "p2"), ("p2", "p1")):
                if other in single and name not in single:
                    raise self._refused(name, f"missing, there is {single[other].name}")
            named = {name: self._number(each) for name, each in single.items()}
        else:
            named = {}
            self._require_no_other_distortion(model)
        self.read["distortion"] = field if named else ""
        known = FISHEYE_ORDER if fisheye else ("k1", "k2", "p1", "p2", "k3")
        foreign = {name: value for name, value in named.items() if name not in known and value != 0}
        if foreign:
            shown = ", ".join(f"{name} = {value:g}" for name, value in foreign.items())
            lens, own = ("fisheye", "k1 k2 k3 k4") if fisheye else ("pinhole", "k1 k2 p1 p2 k3")
            advice = "calibrate without the rational, thin prism and tilted models, or as a fisheye"
            also = f"got also {shown}" if fisheye else f"got also {shown}; {advice}"
            raise self._refused(field, f"a design's {lens} lens has {own} alone, {also}")
        if plain(model) == "none" and any(named.values()):
            raise self._refused(field, f"must be 0 for the model {model!r}")
        return {name: named.get(name, 0.0) for name in known}

    def _require_no_other_distortion(self, model: str) -> None:
        """Refuse names that may mean a distortion; note that there is none."""
        meant = re.compile(r"dist|coef|radial|tangential")
        for name, entry in self.entries.items():
            if meant.search(name) and name not in (*MODELS, "distortion"):
                raise self._refused(
                    entry.name, "is not known; state the distortion as distortion_coefficients"
                )
        if plain(model) not in ("none", "pinhole", "simplepinhole"):
            self.notes.append(f"{self.path}: states no distortion, so it is taken for none")

    def _checked(
        self, matrix: Array, size: tuple[int, int], fisheye: bool, coefficients: Mapping[str, float]
    ) -> float:
        """Half the field of view in radians, of a lens that may be."""
        field = self.read["matrix"]
        for axis, (name, side) in enumerate(zip(("cx", "cy"), size, strict=True)):
            value, low, high = matrix[axis, 2], MIDDLE[0] * side - 0.5, MIDDLE[1] * side - 0.5
            if not low <= value <= high:
                raise self._refused(
                    field,
                    f"{name} must lie in the middle half of the picture, {low:g} to {high:g} px of {side}, "
                    f"got {value:g}; is {size[0]} x {size[1]} the size of the calibrated pictures?",
                )
        half = size[0] / 2 / matrix[0, 0]
        try:
            distortion = Distortion(**coefficients)
            half_angle = float(np.arctan(half))
            if fisheye and half < np.pi:
                right, _, forward = Fisheye(distortion).direction(np.array([half]), np.zeros(1))
                half_angle = float(np.arctan2(right[0], forward[0]))
        except ValidationError as error:
            raise self._refused(self.read["distortion"], explain(error)) from None
        except ValueError as error:
            raise LensError(f"{self.path}: is no lens a design can have: {error}") from None
        wide = np.degrees(2 * (half if fisheye and half >= np.pi else half_angle))
        most = WIDEST_DEG if fisheye else WIDEST_PINHOLE_DEG
        if not NARROWEST_DEG <= wide < most:
            raise self._refused(
                field,
                f"fx {matrix[0, 0]:g} px in a picture {size[0]} px wide is a field of view of {wide:.4g} "
                f"deg, must be {NARROWEST_DEG:g} to {most:g} deg; fx and fy are in pixels",
            )
        return half_angle


def _flat(value: Any, depth: int = 0) -> Iterator[float]:
    """All numbers in a value; text may hold several.

    Raises
    ------
    TypeError, ValueError, OverflowError
        If something else is among them.
    """
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple) and depth < DEEPEST:
        for each in value:
            yield from _flat(each, depth + 1)
    elif isinstance(value, str):
        words = re.sub(r"[\[\]();,]", " ", value).split()
        if not words:
            raise ValueError("no number")
        yield from map(float, words)
    elif isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError("no number")
    else:
        yield float(value)


def _is_word(value: Any) -> bool:
    """Whether a value is a name, such as that of a model."""
    return isinstance(value, str) and re.match(r"[A-Za-z]", value.strip()) is not None


def _shown(value: Any) -> str:
    return " ".join(reprlib.repr(value).split())
