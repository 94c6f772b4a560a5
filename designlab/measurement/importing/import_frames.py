"""From a camera's own files to linear images in a measurement folder."""

import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from designlab.core.types import Array, Mask
from designlab.measurement.folder import load_measurement, read_description, write_measurement
from designlab.measurement.frames import FILE_NAME, MeasuredFrame, Measurement, MeasurementError
from designlab.measurement.importing.camera_files import SUFFIXES
from designlab.measurement.importing.conversion import (
    Conversion,
    full_scale,
    linear_picture,
    read,
    uncoloured,
)
from designlab.measurement.importing.lens_calibration import LensCalibration, read_calibration
from designlab.measurement.importing.lens_file import fields_of
from designlab.measurement.importing.lens_formats import LensError
from designlab.measurement.importing.picture_file import PictureFile, odd, several
from designlab.measurement.importing.picture_file import understood as picture_understood
from designlab.sensor.design import DesignError, dumps, load, preset_names
from designlab.sensor.field_errors import explain
from geometries.mesh_files import Understood, files_of
from geometries.probes import is_mesh, mesh_text, parse, understood

Pixels = NDArray[np.float32]

CLIPPED_SHARE = 0.02  # of dark values at zero, above which the camera is taken to cut there
MOST_DARK = 0.2  # of full scale: brighter frames are not dark
FEW_BITS = 0.26  # of 16 bits, which 14 bits would reach
DESIGN_NAME = "design.toml"


class Item(NamedTuple):
    """A camera's file and what is known about it; the frame names the image to write."""

    path: Path
    frame: MeasuredFrame


class Imported(NamedTuple):
    """What an import wrote, and what it took the files for."""

    folder: Path
    files: tuple[str, ...]
    black: tuple[float, ...]
    notes: tuple[str, ...]
    lens: LensCalibration | None = None
    meshes: tuple[Understood, ...] = ()
    pictures: tuple[PictureFile, ...] = ()


def listed(sources: Sequence[str | Path]) -> list[Path]:
    """Find the picture files: each source is a file, or a folder of them."""
    found: list[Path] = []
    for source in map(Path, sources):
        if source.is_dir():
            inside = sorted(each for each in source.iterdir() if each.suffix.lower() in SUFFIXES)
            if not inside:
                raise MeasurementError(f"{source}: holds no pictures (known are {' '.join(SUFFIXES)})")
            found += inside
        elif source.is_file():
            found.append(source)
        else:
            raise MeasurementError(f"{source}: no such file or folder")
    return found


def items(paths: Sequence[Path], **known: Any) -> list[Item]:
    """Make frames of files that share what is known about them; several of them are repeats.

    Raises
    ------
    MeasurementError
        Naming file, field, rule and value.
    """
    made = []
    for number, path in enumerate(paths):
        content = {"file": f"{path.stem}.exr", **known}
        if len(paths) > 1:
            content["repeat"] = number
        try:
            made.append(Item(path, MeasuredFrame.model_validate(content)))
        except ValidationError as error:
            raise MeasurementError(f"{path}: {explain(error)}") from None
    return made


def described(folder: str | Path) -> tuple[list[Item], dict[str, Any]]:
    """Read a folder of camera files with a measurement.toml that says what each of them shows.

    Returns
    -------
    items, top
        The files, and the fields about the whole set.
    """
    file = Path(folder) / FILE_NAME
    frames, content = read_description(file)
    made = []
    for number, frame in enumerate(frames, start=1):
        path = file.parent / frame.file
        if not path.is_file():
            raise MeasurementError(f"{file}: frame {number} ({frame.file}): field file: no such file")
        made.append(Item(path, frame.model_copy(update={"file": str(Path(frame.file).with_suffix(".exr"))})))
    return made, content


def import_frames(
    made: Sequence[Item],
    conversion: Conversion,
    *,
    out: str | Path,
    top: Mapping[str, Any] | None = None,
    sensor: str | None = None,
    lens: str | Path | None = None,
    fisheye: bool | None = None,
    lens_size_px: tuple[int, int] | None = None,
) -> Imported:
    """Convert files to linear float EXR images and write them with their metadata, or add them to a set.

    The level without light is subtracted, and full scale stays 1. A pixel with a saturated value is set to
    full scale in all channels, so that no later step takes it for light. Dark frames that are in the set
    already may be given again, for their level.

    Parameters
    ----------
    made : sequence of Item
        Files and what they show.
    conversion : Conversion
        What is undone.
    out : path
        Measurement folder; frames are added to one that exists.
    top : mapping, optional
        Fields of a new set: name, sensor, source, mm_per_px.
    sensor : str, optional
        Preset or design file, instead of the set's own.
    lens : path, optional
        Calibration that is put into a copy of the design, see `read_calibration`.
    fisheye : bool, optional
        Whether it was made by cv2.fisheye, where the file does not say.
    lens_size_px : tuple of int, optional
        Width and height of the pictures that it was made from, where the file does not say.

    Raises
    ------
    MeasurementError
        Naming file, field, rule and value. Nothing is written then.
    """
    out = Path(out)
    calibration = None if lens is None else _calibration(lens, fisheye, lens_size_px)
    earlier = load_measurement(out) if (out / FILE_NAME).is_file() else None
    if earlier is not None and earlier.response != "linear":
        raise MeasurementError(
            f"{out / FILE_NAME}: field response: must be linear to add images, got {earlier.response!r}"
        )
    if not made and (earlier is None or lens is None):
        raise MeasurementError(f"{out}: no pictures to import")
    taken = {} if earlier is None else {frame.file: earlier.image(frame) for frame in earlier.frames}
    known_dark = set() if earlier is None else {frame.file for frame in earlier.frames if not frame.lit}
    added = []
    for item in made:
        if item.frame.file in known_dark and not item.frame.lit:
            continue  # named again for its level
        if item.frame.file in taken:
            raise MeasurementError(f"{item.path}: {item.frame.file} is there already; rename it")
        taken[item.frame.file] = np.zeros(0, dtype=np.float32)
        added.append(item)
    notes: list[str] = []
    meshes: dict[str, Understood] = {}
    black, images, pictures = _converted(made, conversion, earlier, notes) if made else ((), {}, ())
    content: dict[str, Any] = dict(top or {}) if earlier is None else earlier.model_dump(exclude={"frames"})
    content["response"] = "linear"
    if sensor is not None:
        content["sensor"] = sensor
    images = taken | {item.frame.file: images[item.frame.file] for item in added}
    with tempfile.TemporaryDirectory() as staged:
        home = Path(staged)
        origin = (
            earlier.folder if earlier is not None else (_described_in(made[0]) if top is not None else None)
        )
        content["sensor"] = _sensor(content.get("sensor", "unknown"), sensor, origin, home, notes)
        if calibration is not None:
            content["sensor"] = _with_lens(content["sensor"], calibration, home, notes)
        frames = [] if earlier is None else list(earlier.frames)
        if earlier is not None and earlier.folder is not None:
            frames = _with_meshes(frames, earlier.folder, home, {})
        there = Path() if top is None else _described_in(made[0])
        frames += _with_meshes([item.frame for item in added], there, home, meshes)
        try:
            measurement = Measurement.model_validate({**content, "frames": frames, "folder": home})
        except ValidationError as error:
            raise MeasurementError(f"{out}: {explain(error)}") from None
        write_measurement(measurement, images, out)
    files = tuple(item.frame.file for item in added)
    said = tuple(dict.fromkeys(notes))
    return Imported(out, files, black, said, calibration, tuple(meshes.values()), pictures)


def _described_in(item: Item) -> Path:
    """Folder of the description that names a file."""
    return item.path.parents[len(Path(item.frame.file).parts) - 1]


def _converted(
    made: Sequence[Item], conversion: Conversion, earlier: Measurement | None, notes: list[str]
) -> tuple[tuple[float, ...], dict[str, Pixels], tuple[PictureFile, ...]]:
    """Linear images of all files, the level that was taken from them, and what the files are."""
    pictures, stated, brightest, deep = {}, None, 0.0, False
    told: dict[str, list[str]] = {}
    files = []
    for item in made:
        file = read(item.path)
        files.append(picture_understood(file, conversion))
        pictures[item.frame.file] = linear_picture(file, conversion)
        for text in (*file.notes, *odd(file, item.frame, conversion, *pictures[item.frame.file])):
            told.setdefault(text, []).append(item.path.name)
        if file.black is not None:
            stated = conversion.response.decode(file.black / full_scale(file, conversion))
        deep |= file.white == 65535 and conversion.white is None
        brightest = max(brightest, file.extremes[1])
    notes += [f"{several(names)}: {text}" for text, names in told.items()]
    if deep and 0 < brightest < FEW_BITS * 65535:
        notes.append(
            f"no value exceeds {brightest:g} in files of 16 bits: if the camera has 10, 12 or 14 bits, state "
            "its full scale as --white, or saturation cannot be seen"
        )
    level = _level(made, conversion, pictures, stated, earlier, notes)
    if np.any(level):
        notes.append(
            "the level without light is taken away: designs compared with these files need "
            "camera.black_level = 0"
        )
    images = {}
    for name, (picture, saturated) in pictures.items():
        found = (picture - level) / (1.0 - level) if picture.shape[-1] == 3 else picture - level.mean()
        if conversion.matrix is not None:
            if found.shape[-1] != 3:
                raise MeasurementError(f"{name}: a colour matrix needs three channels, the file has one")
            found = uncoloured(found, conversion.matrix)
        images[name] = np.where(saturated[..., None], 1.0, found).astype(np.float32)
    return tuple(float(value) for value in level), images, tuple(files)


def _level(
    made: Sequence[Item],
    conversion: Conversion,
    pictures: Mapping[str, tuple[Array, Mask]],
    stated: Array | None,
    earlier: Measurement | None,
    notes: list[str],
) -> Array:
    """Linear level without light of each channel: as stated, from dark frames, or as raw files say."""
    darks = [item for item in made if not item.frame.lit]
    if conversion.black is not None:
        white = full_scale(read(made[0].path), conversion) if made else 1.0
        return np.full(3, float(conversion.response.decode(np.array(conversion.black / white))))
    if darks:
        dark = [pictures[item.frame.file][0] for item in darks]
        if len({picture.shape[-1] for picture in dark}) > 1:
            raise MeasurementError(f"{darks[0].path}: dark frames must all be in colour, or none")
        values = np.concatenate([picture.reshape(-1, picture.shape[-1]) for picture in dark])
        clipped = (values <= 0).mean() > CLIPPED_SHARE
        level = np.median(values, axis=0) if clipped else values.mean(axis=0)
        if level.max() > MOST_DARK:
            raise MeasurementError(
                f"{darks[0].path}: field kind: dark, but its level is {level.max():.0%} of full scale; "
                "suspected cause: LEDs were on, or light came in; remedy: take it again in the dark, or "
                "correct kind"
            )
        return np.broadcast_to(level, 3).copy()
    if stated is not None:
        return np.asarray(stated, dtype=float)
    if made and earlier is not None and any(not frame.lit for frame in earlier.frames):
        raise MeasurementError(
            f"{earlier.folder}: has dark frames whose level was subtracted; state the same for new pictures, "
            "by --dark or --black"
        )
    notes.append("no black level stated and no dark frame: values are taken to be zero without light")
    return np.zeros(3)


def _sensor(named: str, given: str | None, origin: Path | None, home: Path, notes: list[str]) -> str:
    """Name of the sensor in the new set; a design file is copied into it."""
    if named in (*preset_names(), "unknown"):
        return named
    file = Path(named) if given is not None or origin is None else origin / named
    if not file.is_file():
        raise MeasurementError(
            f"field sensor: a preset, a design file or unknown, got {named!r}: no such file"
        )
    if Path(named).name != named:
        notes.append(f"{file}: copied into the measurement as {DESIGN_NAME}")
        named = DESIGN_NAME
    shutil.copyfile(file, home / named)
    return named


def _calibration(lens: str | Path, fisheye: bool | None, size_px: tuple[int, int] | None) -> LensCalibration:
    try:
        return read_calibration(lens, fisheye=fisheye, size_px=size_px)
    except LensError as error:
        raise MeasurementError(str(error)) from None


def _with_lens(sensor: str, calibration: LensCalibration, home: Path, notes: list[str]) -> str:
    """Write the design with a calibrated lens beside the measurement."""
    lens = calibration.path
    if sensor == "unknown":
        raise MeasurementError(f"{lens}: a lens is put into a design, so the sensor must be known: --sensor")
    try:
        design = load(sensor if sensor in preset_names() else home / sensor)
        changes, said = fields_of(calibration, design.camera)
        changed = design.replace(changes)
    except LensError as error:
        raise MeasurementError(str(error)) from None
    except DesignError as error:
        raise MeasurementError(f"{lens}: cannot be put into {sensor}: {error}") from None
    notes.extend(said)
    notes.append(f"{lens}: put into {DESIGN_NAME} of the measurement; use it as the model")
    (home / DESIGN_NAME).write_text(dumps(changed), encoding="utf-8")
    return DESIGN_NAME


def _with_meshes(
    frames: Sequence[MeasuredFrame], origin: Path, home: Path, found: dict[str, Understood]
) -> list[MeasuredFrame]:
    """Copy the meshes that frames name into the measurement, and name them there."""
    changed = []
    for frame in frames:
        if frame.probe is None or not is_mesh(frame.probe):
            changed.append(frame)
            continue
        stated = mesh_text(frame.probe)
        source = origin / stated.file  # or the file itself, where its path is absolute
        within = not Path(stated.file).is_absolute() and ".." not in Path(stated.file).parts
        name = Path(stated.file if within else source.name)
        for file in files_of(source):
            target = home / name.parent / file.relative_to(source.parent)
            if target.is_file() and target.read_bytes() != file.read_bytes():
                raise MeasurementError(f"{file}: the measurement has another {target.name}; rename it")
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, target)
        text = stated._replace(file=str(name)).text
        if text not in found:
            try:
                mesh = understood(parse(stated._replace(file=str(source)).text))
            except ValueError as error:
                raise MeasurementError(f"{frame.file}: field probe: {error}") from None
            assert mesh is not None  # its text names a mesh
            found[text] = mesh
        changed.append(frame.model_copy(update={"probe": text}))
    return changed
