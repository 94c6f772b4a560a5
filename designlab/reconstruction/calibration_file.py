"""A lab's calibration as one file: the untouched gel, the fitted maps, and what is known of their errors."""

import io
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from designlab.core.store import write_atomic
from designlab.core.types import Array
from designlab.reconstruction.lab import FittedMap, LabCalibration
from designlab.reconstruction.membrane import Membrane
from designlab.reconstruction.methods import ErrorMap, Kernel, LinearMap, LinearMethod, Polynomial
from designlab.reconstruction.setup import Setup

FORMAT, CURVED = 1, 2  # pictures as they are, or laid on a grid of the membrane
_OF_MEMBRANE = ("columns", "rows", "height_mm", "p", "q", "sight_x", "sight_y")
METHODS: dict[str, type[LinearMethod]] = {"kernel": Kernel, "polynomial": Polynomial}


class CalibrationFileError(ValueError):
    """A calibration file that cannot be used; the text names the file and the rule."""


class Kept(NamedTuple):
    """What a calibration file holds.

    Attributes
    ----------
    calibration : LabCalibration
        The maps.
    taught : array, shape (samples, channels)
        Changes of colour that the balls showed, in units of their spread.
    about : mapping
        Plain data: how it was made, its errors on balls left out, how pictures are read.
    membrane : Membrane, optional
        The membrane on whose grid pictures are laid first; None where they are taken as they are.
    """

    calibration: LabCalibration
    taught: Array
    about: Mapping[str, Any]
    membrane: Membrane | None = None


def save_calibration(path: str | Path, kept: Kept) -> Path:
    """Write a calibration whole or not at all.

    Raises
    ------
    ValueError
        If a map is of a method that has no form in a file.
    """
    calibration = kept.calibration
    arrays: dict[str, Array] = {
        "background": calibration.background.astype(np.float32),
        "spread": calibration.spread,
        "taught": kept.taught.astype(np.float32),
    }
    if kept.membrane is not None:
        arrays |= {
            f"membrane-{name}": getattr(kept.membrane, name).astype(np.float32) for name in _OF_MEMBRANE
        }
        arrays["membrane-seen"] = kept.membrane.seen.astype(np.float32)
    maps: dict[str, Any] = {}
    for name, fitted in (("inner", calibration.inner), ("rim", calibration.rim)):
        if fitted is not None:
            maps[name] = _described(name, fitted, arrays)
    head = {
        "format": FORMAT if kept.membrane is None else CURVED,
        "picture_px": None if kept.membrane is None else list(kept.membrane.picture_px),
        "setup": calibration.setup._asdict(),
        "detail_px": calibration.detail_px,
        "maps": maps,
        "about": dict(kept.about),
    }
    written = io.BytesIO()
    np.savez_compressed(written, allow_pickle=False, **{"head": np.array(json.dumps(head)), **arrays})
    return write_atomic(path, written.getvalue())


def load_calibration(path: str | Path) -> Kept:
    """Read a calibration.

    Raises
    ------
    CalibrationFileError
        If the file is absent, is none of these, or of a later version.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        head = json.loads(str(arrays.pop("head")))
        version = head["format"]
    except FileNotFoundError:
        raise CalibrationFileError(
            f"{path}: no such file; `designlab calibrate --balls` writes one"
        ) from None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise CalibrationFileError(f"{path}: is no calibration of `designlab calibrate --balls`") from error
    if version not in (FORMAT, CURVED):
        raise CalibrationFileError(
            f"{path}: format {version}; this version of designlab reads {FORMAT} and {CURVED}"
        )
    maps = {name: _restored(name, text, arrays) for name, text in head["maps"].items()}
    calibration = LabCalibration(
        background=arrays["background"].astype(float),
        setup=Setup(**head["setup"]),
        spread=arrays["spread"],
        inner=maps["inner"],
        rim=maps.get("rim"),
        detail_px=head["detail_px"],
    )
    membrane = None
    if version == CURVED:
        parts = {name: arrays[f"membrane-{name}"].astype(float) for name in _OF_MEMBRANE}
        rows, columns = head["picture_px"]
        membrane = Membrane(
            **parts,
            seen=arrays["membrane-seen"] > 0.5,
            mm_per_px=calibration.setup.mm_per_px,
            picture_px=(rows, columns),
        )
    return Kept(calibration, arrays["taught"].astype(float), head["about"], membrane)


def _described(name: str, fitted: FittedMap, arrays: dict[str, Array]) -> dict[str, Any]:
    """Put the weights of a map among the arrays, and tell the rest."""
    told: dict[str, Any] = {"map": _linear(f"{name}-map", fitted.predictor, arrays)}
    if fitted.expected_error is not None:
        error = fitted.expected_error
        if not isinstance(error, ErrorMap):
            raise ValueError(f"{name}: its expected error has no form in a file")
        told["error"] = _linear(f"{name}-error", error.course, arrays)
        told["level"] = error.level
    return told


def _linear(name: str, fitted: Any, arrays: dict[str, Array]) -> dict[str, Any]:
    kinds = {kind: key for key, kind in METHODS.items()}
    if not isinstance(fitted, LinearMap) or type(fitted.method) not in kinds:
        raise ValueError(f"{name}: this method has no form in a file, only {', '.join(METHODS)} have")
    arrays[name] = fitted.weights
    return {"method": kinds[type(fitted.method)], **vars(fitted.method)}


def _restored(name: str, told: Mapping[str, Any], arrays: Mapping[str, Array]) -> FittedMap:
    def linear(key: str) -> LinearMap:
        settings = dict(told[key])
        kind = METHODS[settings.pop("method")]
        if "position_degrees" in settings:
            settings["position_degrees"] = tuple(settings["position_degrees"])
        return LinearMap(kind(**settings), arrays[f"{name}-{key}"])

    error = ErrorMap(linear("error"), float(told["level"])) if "error" in told else None
    return FittedMap(linear("map"), error)
