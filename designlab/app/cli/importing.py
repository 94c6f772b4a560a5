"""Commands import and lens: a camera's own files as linear images, its calibration as a design's lens."""

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from designlab.app.cli.console import Result
from designlab.app.cli.shared import as_understood

if TYPE_CHECKING:
    from designlab.measurement.importing.conversion import Conversion
    from designlab.measurement.importing.import_frames import Item
    from designlab.measurement.importing.ladder import Tabulated
    from designlab.measurement.importing.picture_file import PictureFile

NOTED = ("depth_mm", "force_n", "contact_diameter_mm", "contact_diameter_px", "depth_range_mm")
SHOWN = (
    "kind",
    "leds",
    "exposure",
    "probe",
    "probe_unit",
    "probe_side",
    *NOTED,
    "at",
    "yaw_deg",
    "direction",
    "crop_px",
)


def import_pictures(args: Namespace) -> Result:
    """Convert pictures and write them with what is known about them."""
    from designlab.measurement.importing.conversion import response_from
    from designlab.measurement.importing.import_frames import import_frames

    made, top = _items(args)
    conversion = _conversion(args, made, None if top is None else top.get("response"))
    data: dict[str, Any] = {}
    lines = []
    if args.ladder:
        curve = response_from(_ladder(args.ladder), conversion)
        conversion = replace(conversion, response=curve)
        data["response"] = {"known": list(curve.known)}
        lines.append(_save(curve, args.save_response, data))
    if made or args.lens:
        if args.out is None:
            raise ValueError("--out: required, the measurement folder to make or to add to")
        fisheye = True if args.fisheye else None
        done = import_frames(
            made,
            conversion,
            out=args.out,
            top=top,
            sensor=args.sensor,
            lens=args.lens,
            fisheye=fisheye,
            lens_size_px=args.lens_size,
        )
        data |= {
            "measurement": str(done.folder),
            "files": list(done.files),
            "black": list(done.black),
            "notes": list(done.notes),
            "understood": [_as_data(each) for each in done.pictures],
        }
        if done.lens is not None:
            data["understood"].append(done.lens.understood)
            lines.append(str(done.lens))
        level = ", ".join(f"{value:.4g}" for value in done.black)
        lines += _understood(done.pictures)
        lines.append(f"{done.folder}: {len(done.files)} pictures imported")
        lines += [f"level without light taken away (share of full scale): {level}"] if level else []
        lines += [f"note: {note}" for note in done.notes]
        data["understood"] += as_understood(done.meshes).get("understood", [])
        lines += map(str, done.meshes)
    elif not args.ladder:
        raise ValueError("SOURCE: no pictures to import; or give --ladder to estimate a response")
    return Result(data, "\n".join(lines))


def lens(args: Namespace) -> Result:
    """Say what a lens calibration says, and write a design with it."""
    from designlab.measurement.importing.lens_calibration import read_calibration
    from designlab.measurement.importing.lens_file import fields_of
    from designlab.sensor.design import DesignError, load

    if args.out is not None and args.design is None:
        raise ValueError("--design: required with --out, the design that the lens is put into")
    fisheye = True if args.fisheye else None
    found = read_calibration(args.file, fisheye=fisheye, size_px=args.lens_size)
    data: dict[str, Any] = {"understood": [found.understood]}
    lines, notes = [str(found)], found.notes
    if args.design is not None:
        design = load(args.design)
        changes, notes = fields_of(found, design.camera)
        data["fields"] = changes
        lines += [f"{path} = {value}" for path, value in changes.items()]
    if args.out is not None:
        try:
            design = design.replace(changes)
        except DesignError as error:
            raise DesignError(f"{args.file}: cannot be put into {args.design}: {error}") from None
        data |= {"design": str(design.save(args.out)), "name": design.name, "digest": design.digest}
        lines.append(f"{args.out}: {design.name}")
    data["notes"] = list(notes)
    return Result(data, "\n".join([*lines, *(f"note: {note}" for note in notes)]))


def _as_data(file: "PictureFile") -> dict[str, Any]:
    return {
        "file": file.file,
        "as": file.kind,
        "size": list(file.size_px),
        "unit": "px",
        "range": list(file.extremes),
        "full_scale": file.full_scale,
        "orientation": file.orientation,
    }


def _understood(files: Sequence["PictureFile"]) -> list[str]:
    """Make one line for each kind of file: what it was taken for, and the range of its values."""
    kinds: dict[tuple[str, tuple[int, int], float], list[PictureFile]] = {}
    for file in files:
        kinds.setdefault((file.kind, file.size_px, file.full_scale), []).append(file)
    lines = []
    for (kind, (columns, rows), white), same in kinds.items():
        low = min(file.extremes[0] for file in same)
        high = max(file.extremes[1] for file in same)
        more = f" and {len(same) - 1} more" if len(same) > 1 else ""
        lines.append(
            f"{same[0].file}{more}: understood as {kind}, {columns} x {rows} px, values {low:.6g} to "
            f"{high:.6g} of {white:g}"
        )
    return lines


def _items(args: Namespace) -> tuple[list["Item"], dict[str, Any] | None]:
    """Files to import with what they show, and what a folder states about the whole set."""
    from designlab.measurement.frames import FILE_NAME
    from designlab.measurement.importing.import_frames import described, items, listed

    part = {} if args.crop_px is None else {"crop_px": args.crop_px}
    darks = items(listed(args.dark or []), kind="dark", leds=(), **part)
    first = Path(args.sources[0]) if len(args.sources) == 1 else None
    if first is not None and (first / FILE_NAME).is_file():
        given = [f"--{name.replace('_', '-')}" for name in SHOWN if getattr(args, name) is not None]
        if given:
            raise ValueError(f"{given[0]}: {first / FILE_NAME} says what the pictures show; write it there")
        if args.out is not None and Path(args.out).resolve() == first.resolve():
            raise ValueError(f"--out: must be another folder than {first}, the originals are kept")
        made, top = described(first)
        return [*made, *darks], top
    if args.sources and args.kind is None:
        raise ValueError("--kind: required, what the pictures show")
    leds = None if args.leds is None else tuple(name.strip() for name in args.leds.split(",") if name.strip())
    same = ("kind", "exposure", *NOTED, "yaw_deg", "direction", "crop_px")
    known = {name: getattr(args, name) for name in same}
    known |= {"leds": leds, "centre_mm": args.at, "probe": _probe(args)}
    made = items(listed(args.sources), **{name: value for name, value in known.items() if value is not None})
    return [*made, *darks], None


def _probe(args: Namespace) -> str | None:
    """Text of the probe, of a mesh with its unit and side."""
    from geometries.probes import is_mesh, mesh_text

    probe: str | None = args.probe
    if probe is not None and is_mesh(probe):
        return mesh_text(probe, unit=args.probe_unit, side=args.probe_side).text
    for option in ("unit", "side"):
        if getattr(args, f"probe_{option}") is not None:
            raise ValueError(f"--probe-{option}: is for mesh files, --probe names none; leave it out")
    return probe


def _conversion(args: Namespace, made: list["Item"], declared: str | None) -> "Conversion":
    from designlab.measurement.importing.camera_files import is_linear_format
    from designlab.measurement.importing.conversion import Conversion, response_named
    from designlab.sensor.response_curve import Response

    named = args.response or declared
    if args.ladder:
        if args.response:
            raise ValueError("--response: is what --ladder estimates, give only one of them")
        response: Response | Tabulated = Response()
    elif named is not None and named != "unknown":
        response = response_named(named)
    else:
        unsure = [item.path for item in made if not args.bayer and not is_linear_format(item.path)]
        if unsure:
            raise ValueError(
                f"--response: required for {unsure[0]}; srgb for pictures that a camera or a program made "
                "for eyes, linear for raw values"
            )
        response = Response()
    return Conversion(
        response=response,
        black=args.black,
        white=args.white,
        bayer=args.bayer,
        matrix=None if args.colour_matrix is None else _matrix(args.colour_matrix),
    )


def _matrix(text: str) -> Any:
    import numpy as np

    source = Path(text).read_text(encoding="utf-8") if Path(text).is_file() else text
    try:
        values = [float(part) for part in source.replace(",", " ").split()]
    except ValueError:
        raise ValueError(f"--colour-matrix: must be nine numbers or a file of them, got {text!r}") from None
    if len(values) != 9:
        raise ValueError(f"--colour-matrix: must be nine numbers, row by row, got {len(values)}")
    return np.array(values).reshape(3, 3)


def _ladder(entries: list[str]) -> dict[Path, float]:
    found = {}
    for entry in entries:
        file, equals, value = entry.rpartition("=")
        try:
            found[Path(file)] = float(value)
        except ValueError:
            equals = ""
        if not equals or not file:
            raise ValueError(f"--ladder: must be FILE=EXPOSURE, got {entry!r}")
    return found


def _save(curve: "Tabulated", file: str | None, data: dict[str, Any]) -> str:
    """Write the estimated curve where asked for, and say what is known of it."""
    from designlab.core.store import write_atomic
    from designlab.measurement.importing.ladder import table_text

    low, high = curve.known
    text = f"response estimated between {low:.3g} and {high:.3g} of full scale"
    if file is None:
        return text
    write_atomic(file, table_text(curve).encode())
    data["response"]["file"] = file
    return f"{text}: {file}"
