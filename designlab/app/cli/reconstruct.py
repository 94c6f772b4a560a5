"""Command reconstruct: pictures of one's own sensor to shapes."""

import glob
import os
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from designlab.app.cli.console import Result
from designlab.app.cli.shared import table
from designlab.core.progress import bar
from designlab.core.run_folder import require_writable
from designlab.core.store import digest, read_json, write_json

if TYPE_CHECKING:
    from designlab.reconstruction.reconstructor import PressShape

RESULT, PAGE = "shapes.json", "report.html"
PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".npy", ".bmp", ".webp")


def reconstruct(args: Namespace) -> Result:
    """Find the shape in each picture, and write it; pictures that are done are not done again."""
    import numpy as np

    from designlab.core.images import ImageError, read_picture
    from designlab.reconstruction.reconstructor import Reconstructor
    from designlab.report.reconstruction import reconstruction_report, write_shape

    files = _pictures(args.pictures)
    reconstructor = Reconstructor.load(args.calibration)
    notes: list[str] = []
    out = Path(args.out)
    require_writable(out, made_with=RESULT)
    if args.background is not None:
        background = np.asarray(read_picture(args.background), dtype=float)
        used = reconstructor.on(background)
        notes += reconstructor.drift(background)
        reconstructor = used
    modulus = _modulus(args)
    run = digest(Path(args.calibration).read_bytes(), *map(str, (args.background, args.mesh, modulus)))
    known: dict[str, Any] = {"run": run, "shapes": []}
    if (out / RESULT).is_file():
        known = read_json(out / RESULT)
    if known["run"] != run:
        raise ValueError(
            f"--out: {out} holds shapes by another calibration, background, mesh or gel; choose a new folder"
        )
    done = {row["file"]: row for row in known["shapes"]}
    names = _names(files)
    out.mkdir(parents=True, exist_ok=True)
    refused: list[dict[str, str]] = []
    with bar("picture") as progress:
        for number, path in enumerate(files):
            progress(path.name, number, len(files))
            content = digest(path.read_bytes())
            if done.get(str(path), {}).get("content") == content:
                continue
            try:
                image = np.asarray(read_picture(path), dtype=float)
                shape = reconstructor(image)
            except (ImageError, ValueError) as error:
                text = str(error)
                refused.append(
                    {"file": str(path), "reason": text if str(path) in text else f"{path}: {text}"}
                )
                continue
            name = names[path]
            pitch = reconstructor.calibration.setup.mm_per_px
            write_shape(shape, image, out, name, mm_per_px=pitch, mesh=args.mesh)
            done[str(path)] = _row(path, name, content, shape, modulus)
            write_json(out / RESULT, {"run": run, "shapes": list(done.values())})
        progress("page", len(files), len(files))
    rows = [done[str(path)] for path in files if str(path) in done]
    if not rows:
        raise ValueError(f"no picture could be used; the first: {refused[0]['reason']}")
    page = reconstruction_report(rows, out, out / PAGE, about=reconstructor.kept.about)
    lines = [table(("picture", "depth mm", "contact mm2", "force N"), [_shown(row) for row in rows])]
    lines += [f"warning: {note}" for note in notes]
    lines += [f"warning: {row['file']}: {text}" for row in rows for text in row["warnings"]]
    lines += [f"refused: {each['reason']}" for each in refused]
    lines.append(f"report: {page}")
    data = {"out": args.out, "shapes": rows, "refused": refused, "notes": notes, "report": str(page)}
    return Result(data, "\n".join(lines), 1 if refused else 0)


def _pictures(wanted: list[str]) -> list[Path]:
    """Files that are named, in folders, or that a pattern fits, each once."""
    found: list[Path] = []
    for text in wanted:
        path = Path(text)
        if path.is_dir():
            found += sorted(each for each in path.iterdir() if each.suffix.lower() in PICTURES)
        elif path.is_file():
            found.append(path)
        else:
            matches = sorted(Path(each) for each in glob.glob(text) if os.path.isfile(each))
            if not matches:
                raise ValueError(f"PICTURES: {text}: no such file or folder, and no file fits the pattern")
            found += matches
    if not found:
        raise ValueError(f"PICTURES: no picture in {', '.join(wanted)} ({', '.join(PICTURES)})")
    return list(dict.fromkeys(found))


def _names(files: list[Path]) -> dict[Path, str]:
    """A name for the files of each picture; pictures of one name in several folders are numbered."""
    names: dict[Path, str] = {}
    for path in files:
        name, number = path.stem, 2
        while name in names.values():
            name, number = f"{path.stem}-{number}", number + 1
        names[path] = name
    return names


def _modulus(args: Namespace) -> float | None:
    """Young's modulus of the gel in MPa, where a gel or a figure is given."""
    from designlab.sensor.gel_materials import gel_material

    if args.modulus_mpa is not None:
        if not args.modulus_mpa > 0:
            raise ValueError(f"--modulus-mpa: must be above 0 MPa, got {args.modulus_mpa:g}")
        if args.gel is not None:
            raise ValueError("--modulus-mpa: is stated beside --gel; leave one of them out")
        return float(args.modulus_mpa)
    return None if args.gel is None else gel_material(args.gel).modulus_mpa


def _row(path: Path, name: str, content: str, shape: "PressShape", modulus: float | None) -> dict[str, Any]:
    return {
        "file": str(path),
        "name": name,
        "content": content,
        "depth_mm": shape.depth_mm,
        "contact_area_mm2": shape.contact_area_mm2,
        "force_n": None if modulus is None else shape.force_n(modulus),
        "warnings": list(shape.warnings),
    }


def _shown(row: dict[str, Any]) -> tuple[str, ...]:
    force = "-" if row["force_n"] is None else f"{row['force_n']:.3g}"
    return row["file"], f"{row['depth_mm']:.3f}", f"{row['contact_area_mm2']:.3g}", force
