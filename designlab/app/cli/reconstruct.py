"""Command reconstruct: pictures of one's own sensor to shapes."""

import re
import sys
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from designlab.app.cli.arguments.options import UsageError
from designlab.app.cli.console import Result
from designlab.app.cli.shared import table
from designlab.core.journal import Journal
from designlab.core.progress import bar
from designlab.core.run_folder import require_writable
from designlab.core.store import digest, remove_partial, write_json

if TYPE_CHECKING:
    from designlab.app.cli.incoming import Incoming
    from designlab.app.cli.shape_source import Used
    from designlab.reconstruction.press_shape import PressShape

RECORD, RESULT, PAGE = "shapes.jsonl", "shapes.json", "report.html"
KINDS = ("height", "tiff", "exr", "normals", "contact", "mesh", "picture")
OF_VIDEO = ("height", "contact")
MANY = 50  # pictures from which only those that matter are drawn
MEASURED_SD, TABLE_SD = 0.1, 0.3  # of a modulus that is stated, or of a table's gel: between batches
SHOWN = 12  # lines of a long table, and of what is refused


class Modulus(NamedTuple):
    """Young's modulus of a gel and its standard deviation (MPa)."""

    mpa: float
    sd_mpa: float


def reconstruct(args: Namespace) -> Result:
    """Find the shape in each picture, and write it; pictures that are done are not done again."""
    from designlab.app.cli.incoming import counted_frames, files_of, pictures_in, watched
    from designlab.app.cli.shape_source import source_of

    out = Path(args.out)
    files, folder = [], None
    if args.watch is None:
        if not args.pictures:
            raise UsageError("PICTURES: name files, folders or patterns, or give --watch FOLDER")
        files = files_of(args.pictures)
    else:
        folder = _watched_folder(args, out)
    counts = counted_frames(files)
    source = source_of(args, files)
    modulus = _modulus(args)
    require_writable(out, made_with=RECORD)
    many = folder is not None or sum(count or 1 for count in counts.values()) > MANY
    kinds = _kinds(args, many or any(counts.values()))
    run = digest(source.content, *map(str, _said(args, modulus)))
    out.mkdir(parents=True, exist_ok=True)
    remove_partial(out)
    refused: list[dict[str, str]] = []
    with Journal(out / RECORD) as journal:
        if journal.rows and journal.rows[0].get("run") != run:
            raise ValueError(
                f"--out: {out} holds shapes by another calibration, background, mode, mesh or gel; choose a "
                "new folder"
            )
        done = {_key(row): row for row in journal.rows[1:]}
        used = source.prepared(out)
        if modulus is None and used.modulus_mpa is not None:
            modulus = Modulus(used.modulus_mpa, TABLE_SD * used.modulus_mpa)

        def known(key: str, content: str) -> bool:
            return bool(done.get(key, {}).get("content") == content)

        with bar("picture", shown=folder is None) as progress:
            if folder is None:
                incoming = pictures_in(files, counts, every=args.every, known=known, progress=progress)
            else:
                print(f"watching {folder}; Ctrl-C ends", file=sys.stderr, flush=True)
                incoming = watched(folder, known=known)
            with _ended_by_interrupt(folder is not None):
                for one in incoming:
                    row = _reconstructed(one, used, out, kinds, args.mesh, modulus, refused)
                    if row is None:
                        continue
                    if not journal.rows:  # a run without a shape leaves the folder free for others
                        journal.append({"run": run})
                    journal.append(row)
                    done[one.key] = row
                    if folder is not None:
                        print("  ".join(_shown(row)), file=sys.stderr, flush=True)
    rows = _asked_for(done, files, counts, args.every, folder)
    if not rows:
        first = f"; the first: {refused[0]['reason']}" if refused else ""
        raise ValueError(f"no picture could be used{first}")
    page = _written(rows, out, used, run, kinds, many)
    lines = [*_table(rows), *(f"note: {note}" for note in used.notes)]
    lines += [*(f"warning: {each}" for each in used.warnings), *_warnings(rows)]
    lines += _gathered("refused: ", [each["reason"] for each in refused])
    lines.append(f"report: {page}")
    data = {
        "out": args.out,
        "mode": args.mode,
        "shapes": rows,
        "refused": refused,
        "notes": [*used.warnings, *used.notes],
        "model": _model_told(used),
        "background_drift": used.background_drift,
        "report": str(page),
    }
    return Result(data, "\n".join(lines), 1 if refused else 0)


def _model_told(used: "Used") -> dict[str, Any] | None:
    """How far the model that pictures were read by agrees with the sensor; None of a calibration on balls."""
    about = used.reconstructor.kept.about
    if not about.get("simulated"):
        return None
    keys = ("model", "normal_error_deg", "height_error_um", "differences", "modulus_mpa")
    return {key: about.get(key) for key in keys} | {"warnings": list(used.warnings)}


@contextmanager
def _ended_by_interrupt(ends: bool) -> Iterator[None]:
    """Let Ctrl-C end what has no end of its own."""
    try:
        yield
    except KeyboardInterrupt:
        if not ends:
            raise


def _watched_folder(args: Namespace, out: Path) -> Path:
    if args.pictures:
        raise UsageError("--watch: takes the place of PICTURES; leave one of them out")
    folder = Path(args.watch)
    if not folder.is_dir():
        raise ValueError(f"--watch: {folder}: no such folder")
    if out.resolve() == folder.resolve():
        raise ValueError(f"--out: {out} is the folder that is watched; choose another")
    return folder


def _kinds(args: Namespace, stream: bool) -> tuple[str, ...]:
    """Kinds of files that are written of each picture."""
    if args.files is not None:
        chosen = tuple(args.files)
    elif args.mode == "video":
        chosen = OF_VIDEO
    else:
        chosen = tuple(kind for kind in KINDS if kind != "picture" or not stream)
    return tuple(kind for kind in chosen if kind != "mesh" or args.mesh != "none")


def _reconstructed(
    one: "Incoming",
    used: "Used",
    out: Path,
    kinds: Sequence[str],
    mesh: str,
    modulus: Modulus | None,
    refused: list[dict[str, str]],
) -> dict[str, Any] | None:
    """Reconstruct and write one picture; None where it is refused."""
    from designlab.core.images import ImageError
    from designlab.report.reconstruction import write_shape

    try:
        image = used.linear(one.read())
        shape = used.reconstructor(image)
    except (ImageError, ValueError) as error:
        text, place = str(error), str(one.file) if one.frame is None else f"{one.file}, frame {one.frame}"
        refused.append(
            {"file": str(one.file), "reason": text if str(one.file) in text else f"{place}: {text}"}
        )
        return None
    pitch = used.reconstructor.calibration.setup.mm_per_px
    write_shape(shape, image, out, one.name, mm_per_px=pitch, mesh=mesh, kinds=kinds)
    return {
        "file": str(one.file),
        "frame": one.frame,
        "name": one.name,
        "content": one.content,
        "depth_mm": float(shape.depth_mm),
        "contact_area_mm2": shape.contact_area_mm2,
        **_force(shape, modulus),
        "drift": shape.drift.plain(),
        **_markers_told(shape, modulus),
        "warnings": list(shape.warnings),
    }


def _force(shape: "PressShape", modulus: Modulus | None) -> dict[str, float | None]:
    """Force on the gel and the ends of its 95 % interval, where the gel's modulus is known."""
    names = ("force_n", "force_low_n", "force_high_n")
    found = (None,) * 3 if modulus is None else shape.force_range(modulus.mpa, modulus.sd_mpa)
    return dict(zip(names, found, strict=True))


def _said(args: Namespace, modulus: Modulus | None) -> tuple[object, ...]:
    """Options that shapes depend on."""
    return args.background, args.mesh, modulus, args.mode, args.files, args.markers, args.camera_mm


def _markers_told(shape: "PressShape", modulus: Modulus | None) -> dict[str, Any]:
    """What the markers of a press show; nothing of a gel without them."""
    if shape.markers is None:
        return {}
    told: dict[str, Any] = {
        "markers": len(shape.markers.places_mm),
        "markers_moved_mm": shape.markers.mean_mm,
        "shear_n": None,
        "shear_error_n": None,
    }
    shear = shape.markers.shear
    if shear is not None and modulus is not None:
        told |= {
            "shear_n": list(shear.force_n(modulus.mpa)),
            "shear_error_n": list(shear.error_n(modulus.mpa, modulus.sd_mpa)),
        }
    return told


def _key(row: dict[str, Any]) -> str:
    return str(row["file"]) if row["frame"] is None else f"{row['file']}#{row['frame']}"


def _asked_for(
    done: dict[str, dict[str, Any]],
    files: list[Path],
    counts: dict[Path, int | None],
    every: int,
    folder: Path | None,
) -> list[dict[str, Any]]:
    """Rows of the pictures that this command names, in their order."""
    if folder is not None:
        return [row for row in done.values() if Path(row["file"]).parent == folder]
    place = {str(path): number for number, path in enumerate(files)}
    rows = [row for row in done.values() if row["file"] in place and (row["frame"] or 0) % every == 0]
    return sorted(rows, key=lambda row: (place[row["file"]], row["frame"] or 0))


def _written(
    rows: list[dict[str, Any]],
    out: Path,
    used: "Used",
    run: str,
    kinds: Sequence[str],
    many: bool,
) -> Path:
    """Write the record of all shapes and the page; draw what matters where not all are drawn."""
    from designlab.app.cli.incoming import frame_again
    from designlab.core.images import ImageError, read_picture
    from designlab.report.reconstruction import draw_shape, reconstruction_report, that_matter

    matter = that_matter(rows) if many or "picture" not in kinds else rows
    for row in matter:
        if not (out / f"{row['name']}.png").is_file():
            path = Path(row["file"])
            try:
                image = used.linear(
                    read_picture(path) if row["frame"] is None else frame_again(path, row["frame"])
                ).astype(float)
                shape = used.reconstructor(image)
            except (ImageError, ValueError):  # gone or overwritten since: the page does without
                continue
            draw_shape(shape, image, out, row["name"], used.reconstructor.calibration.setup.mm_per_px)
    write_json(out / RESULT, {"run": run, "shapes": rows})
    return reconstruction_report(rows, out, out / PAGE, about=used.reconstructor.kept.about, matter=matter)


def _modulus(args: Namespace) -> Modulus | None:
    """Young's modulus of the gel, where a gel or a figure is given."""
    from designlab.sensor.gel_materials import gel_material

    if args.modulus_sd_mpa is not None and args.modulus_mpa is None:
        raise ValueError("--modulus-sd-mpa: belongs to --modulus-mpa, which is not given")
    if args.modulus_mpa is not None:
        if not args.modulus_mpa > 0:
            raise ValueError(f"--modulus-mpa: must be above 0 MPa, got {args.modulus_mpa:g}")
        if args.gel is not None:
            raise ValueError("--modulus-mpa: is stated beside --gel; leave one of them out")
        usual = MEASURED_SD * args.modulus_mpa
        sd = usual if args.modulus_sd_mpa is None else args.modulus_sd_mpa
        if not sd >= 0:
            raise ValueError(f"--modulus-sd-mpa: must be at least 0 MPa, got {sd:g}")
        return Modulus(float(args.modulus_mpa), float(sd))
    if args.gel is None:
        return None
    gel = gel_material(args.gel)
    if gel.range_mpa is None:
        return Modulus(gel.modulus_mpa, TABLE_SD * gel.modulus_mpa)
    low, high = gel.range_mpa
    return Modulus(gel.modulus_mpa, (high - low) / 4)


def _table(rows: list[dict[str, Any]]) -> list[str]:
    """All pictures, or of many those that matter and how many there are."""
    from designlab.report.reconstruction import that_matter

    head = ("picture", "depth mm", "contact mm2", "force N (95 %)", "shear N")
    if len(rows) <= MANY:
        return [table(head, [_shown(row) for row in rows])]
    few = table(head, [_shown(row) for row in that_matter(rows)])
    return [f"{len(rows)} pictures; those that matter:", few]


def _warnings(rows: list[dict[str, Any]]) -> list[str]:
    if len(rows) <= MANY:
        return [f"warning: {_place(row)}: {text}" for row in rows for text in row["warnings"]]
    return _gathered("warning: ", [text for row in rows for text in row["warnings"]])


def _gathered(head: str, texts: list[str]) -> list[str]:
    """Texts line by line; of many, those that differ in more than numbers, and how often each occurs."""
    if len(texts) <= SHOWN:
        return [f"{head}{text}" for text in texts]
    kinds: dict[str, list[str]] = {}
    for text in texts:
        kinds.setdefault(re.sub(r"[\d.+-]+", "#", text), []).append(text)
    return [f"{head}{len(same)} times, the first: {same[0]}" for same in kinds.values()]


def _place(row: Mapping[str, Any]) -> str:
    return str(row["file"]) if row["frame"] is None else f"{row['file']}, frame {row['frame']}"


def _shown(row: Mapping[str, Any]) -> tuple[str, ...]:
    force = "-"
    if row["force_n"] is not None:
        force = f"{row['force_n']:.3g} ({row['force_low_n']:.2g} to {row['force_high_n']:.2g})"
    shear = "-" if row.get("shear_n") is None else ", ".join(f"{part:.3g}" for part in row["shear_n"])
    return _place(row), f"{row['depth_mm']:.3f}", f"{row['contact_area_mm2']:.3g}", force, shear
