"""The folder of a measurement: reading with all checks, and writing whole or not at all."""

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray
from pydantic import ValidationError

from designlab.core.images import write_image
from designlab.core.store import atomic_folder, read_toml
from designlab.measurement.frames import FILE_NAME, MeasuredFrame, Measurement, MeasurementError, mesh_file
from designlab.measurement.sizes import check_leds, check_size, size
from designlab.sensor.design import preset_names
from designlab.sensor.field_errors import explain
from geometries.mesh_files import files_of


def load_measurement(path: str | Path) -> Measurement:
    """Read and check a measurement folder.

    Parameters
    ----------
    path : str or Path
        The folder, or its ``measurement.toml``.

    Returns
    -------
    Measurement
        With every file found to be an image that agrees with its metadata.

    Raises
    ------
    MeasurementError
        Naming file, frame, field, rule and value.
    """
    file = Path(path)
    if file.is_dir():
        file = file / FILE_NAME
    if not file.exists():
        raise MeasurementError(f"{path}: no measurement there, {FILE_NAME} is missing")
    frames, content = read_description(file)
    for reserved in ("frames", "folder"):
        if reserved in content:
            raise MeasurementError(f"{file}: field {reserved}: unknown field")
    try:
        measurement = Measurement.model_validate({**content, "frames": frames, "folder": file.parent})
    except ValidationError as error:
        raise MeasurementError(f"{file}: {explain(error)}") from None
    _check(measurement)
    return measurement


def read_description(file: Path) -> tuple[list[MeasuredFrame], dict[str, Any]]:
    """Read a ``measurement.toml``: its frames, each by itself, and the fields about the whole set.

    Raises
    ------
    MeasurementError
        Naming file, frame, field, rule and value.
    """
    content = read_toml(file, error=MeasurementError)
    raw = content.pop("frame", None)
    if not isinstance(raw, list) or not raw:
        raise MeasurementError(f"{file}: field frame: at least one [[frame]] is needed")
    frames = []
    for number, entry in enumerate(raw, start=1):
        try:
            frames.append(MeasuredFrame.model_validate(entry))
        except ValidationError as error:
            name = entry.get("file", "no file") if isinstance(entry, dict) else "not a table"
            raise MeasurementError(f"{file}: frame {number} ({name}): {explain(error)}") from None
    return frames, content


def write_measurement(
    measurement: Measurement, arrays: Mapping[str, NDArray[Any]], folder: str | Path
) -> Path:
    """Write a measurement folder; it appears complete and checked, or not at all.

    Parameters
    ----------
    measurement : Measurement
        The frames. Design and mesh files that it names relative to its own folder are copied along.
    arrays : mapping of str to array
        Image of every file.
    folder : str or Path
        Where to; may exist if it is empty or itself a measurement, which is then replaced.

    Raises
    ------
    MeasurementError
        If the folder holds something else, an array is missing, or the result breaks a rule of
        `load_measurement`.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise MeasurementError(f"{folder}: exists and is not a folder")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / FILE_NAME).is_file():
        raise MeasurementError(f"{folder}: is neither empty nor a measurement, so it is not overwritten")
    names = [frame.file for frame in measurement.frames] + sorted(_attached(measurement))
    outside = [name for name in names if Path(name).is_absolute() or ".." in Path(name).parts]
    if outside:
        raise MeasurementError(f"{folder}: file: lies in the folder, got {', '.join(outside)}")
    missing = [frame.file for frame in measurement.frames if frame.file not in arrays]
    if missing:
        raise MeasurementError(f"{folder}: arrays: no image for {', '.join(missing)}")
    import tomli_w

    content = measurement.model_dump(mode="json", exclude_none=True)
    content["frame"] = content.pop("frames")
    with atomic_folder(folder, replace=True) as temporary:
        for frame in measurement.frames:
            (temporary / frame.file).parent.mkdir(parents=True, exist_ok=True)
            write_image(temporary / frame.file, arrays[frame.file])
        for name in _attached(measurement):
            (temporary / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(measurement.path(name), temporary / name)
        (temporary / FILE_NAME).write_text(tomli_w.dumps(content), encoding="utf-8")
        load_measurement(temporary)
    return folder


def _attached(measurement: Measurement) -> set[str]:
    """Files besides the images that a set names relative to its folder."""
    meshes = {mesh_file(frame.probe or "") for frame in measurement.frames}
    named = {name for name in meshes if name and not Path(name).is_absolute()}
    for mesh in tuple(named):
        beside = measurement.path(mesh).parent
        named |= {
            str(Path(mesh).parent / file.relative_to(beside)) for file in files_of(beside / Path(mesh).name)
        }
    if measurement.sensor not in (*preset_names(), "unknown"):
        named.add(measurement.sensor)
    return {name for name in named if not Path(name).is_absolute()}


def _check(measurement: Measurement) -> None:
    """Rules that need the files, or several frames at once."""
    design = measurement.design()
    files = [frame.file for frame in measurement.frames]
    sizes: dict[Any, tuple[int, ...]] = {}
    for frame in measurement.frames:
        if files.count(frame.file) > 1:
            raise measurement.error(frame, "file: each frame has its own", frame.file)
        try:
            shape = measurement.image(frame).shape
        except MeasurementError as error:
            raise measurement.error(frame, f"file: {error}", None) from None
        first = sizes.setdefault(frame.crop_px, shape)
        if shape != first:
            rule = (
                f"file: frames of one crop agree in size, others have {size(first)}, got {size(shape)}; "
                "suspected cause: saved in another mode of the camera, cut or resized; remedy: save all "
                "alike, or state crop_px of the odd one"
            )
            raise measurement.error(frame, rule, None)
        mesh = mesh_file(frame.probe or "")
        if mesh is not None and not measurement.path(mesh).is_file():
            raise measurement.error(frame, "probe: no such mesh file", mesh)
        check_size(measurement, frame, design)
        if design is not None:
            check_leds(measurement, frame, design, of=measurement.sensor)
    measurement.split()
