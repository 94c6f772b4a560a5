"""Files to make a design: STL, STEP, 3MF, LED boards, bill of materials, and checks of them all."""

import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from designlab.core.backend import installed_version
from designlab.core.progress import silent
from designlab.core.store import atomic_folder
from designlab.core.types import Progress
from designlab.fabrication import assembly
from designlab.fabrication import boards as led_boards
from designlab.fabrication.boards import SUPPLY_V, BoardError, Boards
from designlab.fabrication.boards.circuit import channels
from designlab.fabrication.boards.files import bill_row, write_board
from designlab.fabrication.boards.orders import solid as board_solid
from designlab.fabrication.checks import (
    FileCheck,
    check_mesh,
    check_overlaps,
    check_step,
    mesh_checks,
    require,
)
from designlab.fabrication.folder import KIND, MANIFEST, require_replaceable
from designlab.fabrication.parts import (
    CASTING_PARTS,
    MOULD_FLOOR_MM,
    MOULD_WALL_MM,
    SEATED_PARTS,
    SENSOR_PARTS,
    Led,
    built_leds,
    parts,
    probe_name,
)
from designlab.fabrication.seating import BOUGHT, PRINTED, SeatError, thin_walls, walls
from designlab.fabrication.tables import bill, led_rows, numbered, readme, write_csv
from designlab.fabrication.triangles import OPTICAL_THINNING_MM, THINNING_MM, printable, read, write_3mf
from designlab.sensor.design import Design, InfeasibleDesign, assumed_fields, dumps
from designlab.sensor.feasibility import MINIMUM_WALL_MM
from designlab.sensor.optical_constants import material
from designlab.sensor.seating import assumed_figures
from designlab.simulation.effects.model import SensorModel
from geometries import probes as probe_library
from geometries.leds import LedGroup, bodies
from geometries.mesh_files import closed
from geometries.probes import Probe

if TYPE_CHECKING:
    import cadquery

__all__ = [
    "BOARD_COLOUR",
    "PART_COLOURS",
    "Built",
    "FileCheck",
    "export",
    "led_colour",
    "package_colour",
    "parts",
]

PROGRAMS = ("designlab", "cadquery", "cadquery-ocp", "trimesh", "pymeshlab", "gerbonara", "shapely")
"""Distributions that make the files, whose versions the manifest states."""

PART_COLOURS: dict[str, tuple[float, float, float, float]] = {
    "gelcore": (0.75, 0.87, 0.95, 0.4),
    "elastomer": (0.95, 0.80, 0.60, 0.5),
    "housing": (0.25, 0.26, 0.29, 1.0),
    "lid": (0.36, 0.38, 0.42, 1.0),
    "core_ring": (0.42, 0.36, 0.30, 1.0),
    "gel_ring": (0.42, 0.36, 0.30, 1.0),
    "camera": (0.10, 0.45, 0.20, 1.0),
    "inserts": (0.80, 0.62, 0.25, 1.0),
    "screws": (0.62, 0.64, 0.67, 1.0),
}
"""Display colours of parts (sRGB and opacity, 0..1)."""
BOARD_COLOUR = (0.08, 0.09, 0.1, 1.0)


class Built(NamedTuple):
    """What an export made, for who describes it.

    Solids and steps of assembly lie in the sensor frame (mm); `carried` are the numbers of each board's LEDs
    in `leds`.
    """

    design: Design
    shapes: Mapping[str, "cadquery.Shape"]
    leds: Sequence[Led]
    order: Sequence[assembly.Step]
    carried: Mapping[str, Sequence[int]]
    boards: Boards | None
    manifest: Mapping[str, Any]


Describe = Callable[[Built, Path], Sequence[str]]
"""Writes files about what was built into the folder of an export, and returns warnings."""


def export(
    design: Design | SensorModel,
    out: str | Path,
    *,
    probes: Sequence[Probe | str] = (),
    boards: bool = True,
    supply_v: float = SUPPLY_V,
    allow_infeasible: bool = False,
    describe: Describe | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Write everything needed to make a design into a folder, and check what was written.

    Parameters
    ----------
    design : Design or SensorModel
        The sensor; of a model, see `to_make`.
    out : str or Path
        Folder that appears whole or not at all. It may be absent or empty, or an
        earlier export, which it replaces.
    probes : sequence of Probe or str
        Indenters to add, as `Probe` or in the form that `geometries.probes.parse` reads (``"sphere:4"``).
    boards : bool
        Whether to make LED boards too.
    supply_v : float
        Supply of the LED boards (V), from which series resistors follow.
    allow_infeasible : bool
        Export a design that breaks its rules, and overlapping parts, with a warning for each; LED boards that
        cannot be made are left out.
    describe : callable, optional
        Called with what was built and the folder, where it may write a guide; not before all checks passed.
    progress : callable, optional
        Called with the name of the next step, steps done and steps in all.

    Returns
    -------
    dict
        The manifest, JSON-able: ``parts``, ``boards``, ``drive`` (part, current and resistor of each LED
        group), ``bom``, ``checks``, ``margins_mm``, ``walls``, ``warnings`` and ``files``, each with its
        SHA-256.

    Raises
    ------
    InfeasibleDesign
        If the design breaks a rule or cannot be built as it is simulated, and `allow_infeasible` is false.
    ValueError
        If `out` holds something else, or a probe is unknown; names path or probe and rule. `BoardError` if an
        LED board cannot be made; names part, value and rule.
    RuntimeError
        If a check fails; names the part and the figures. Nothing is left in `out` then.
    """
    design, notes = to_make(design)
    if not allow_infeasible:
        design.require_feasible()
        if design.not_buildable:
            raise InfeasibleDesign(
                f"design {design.name!r} is {design.not_buildable}; remedy: start from a sensor with "
                'optics.light_path = "core", such as the preset default, or --allow-infeasible'
            )
    chosen = list(dict.fromkeys(probe_library.parse(p) if isinstance(p, str) else p for p in probes))
    names = [probe_name(probe) for probe in chosen]
    if len(set(names)) < len(names):
        raise ValueError(f"probes: their names must differ, got {', '.join(names)}")
    require_replaceable(Path(out))
    made, left_out = _boards(design, supply_v, allow_infeasible) if boards else (None, [])
    describe = describe if design.housing.seats is not None else None
    with atomic_folder(out, replace=True) as folder:
        told = [*notes, *left_out]
        more = 1 if describe is not None else 0
        built, steps = _write(design, folder, chosen, made, allow_infeasible, progress, told, more)
        manifest = dict(built.manifest)
        require(FileCheck(**check) for check in manifest["checks"])
        if describe is not None:
            progress("guide", steps - 1, steps)
            manifest["warnings"] = [*manifest["warnings"], *describe(built, folder)]
        _close(design, folder, manifest)
        progress("done", steps, steps)
        require_replaceable(Path(out))  # somebody may have written there meanwhile
    return manifest


def to_make(design: Design | SensorModel) -> tuple[Design, list[str]]:
    """Return the design that is made, and what of a sensor model went into it or was left out.

    Effects of a kind of part go in; what one unit was built wrong is not built again.
    """
    if isinstance(design, Design):
        return design, []
    model, notes = design.transferable(), []
    if left := [applied.name for applied in design.effects if applied not in model.effects]:
        notes.append(f"left out, since they belong to one built unit: {', '.join(left)}")
    if model.effects:
        notes.append(f"with effects of a sensor model: {', '.join(a.name for a in model.effects)}")
    return model.effective_design(), notes


def _boards(design: Design, supply_v: float, allow_infeasible: bool) -> tuple[Boards | None, list[str]]:
    """LED boards of a design, or none and why; what cannot be driven is refused, whatever is allowed."""
    if design.leds.coupling == "embedded":
        return None, ["no LED boards: the LEDs are cast into the gelcore; wire them by leds.csv"]
    driven = False
    try:
        channels(design, supply_v=supply_v)
        driven = True
        return led_boards.boards(design, supply_v=supply_v), []
    except led_boards.NoPartError as error:
        return None, [f"no LED boards: {error}"]
    except BoardError as error:
        if allow_infeasible and driven:
            return None, [f"no LED boards: {error}"]
        raise BoardError(f"{error}; or --no-boards for all but the LED boards") from None


def _write(
    design: Design,
    folder: Path,
    chosen: Sequence[Probe],
    made: Boards | None,
    allow_infeasible: bool,
    progress: Progress,
    notes: Sequence[str],
    more: int,
) -> tuple[Built, int]:
    """Write all files of parts and return what was built, failed checks included, and the steps in all.

    `more` are steps that follow.
    """
    meshed = [probe for probe in chosen if probe.file is not None]
    boards = () if made is None else made.boards
    shapes = parts(design, probe_list=[probe for probe in chosen if probe.file is None], boards=boards)
    thickness = walls(design, shapes)
    thin = thin_walls(thickness)
    if thin and design.housing.seats is not None and not allow_infeasible:
        raise SeatError("; ".join(thin))
    thinnest = min(thickness, key=lambda name: thickness[name].thickness_mm)
    order: list[assembly.Step] = []
    carried: dict[str, list[int]] = {}
    steps = len(shapes) + len(meshed) + len(boards) + 2 + more
    described: dict[str, Any] = {}
    checks: list[FileCheck] = []
    for done, (name, shape) in enumerate(shapes.items()):
        progress(name, done, steps)
        described[name], found = _write_part(design, folder, name, shape)
        checks += found
    for done, probe in enumerate(meshed, start=len(shapes)):
        progress(probe_name(probe), done, steps)
        described[probe_name(probe)], found = _write_mesh_probe(folder, probe)
        checks += found
    board_shapes = {board.name: board_solid(board) for board in boards}
    described_boards = []
    for done, board in enumerate(boards, start=len(shapes) + len(meshed)):
        progress(board.name, done, steps)
        assert made is not None
        colours = [group_colour(group) for group in design.leds.groups]
        entry, found = write_board(
            board, folder, channels=made.channels, colours=colours, project=design.name
        )
        described_boards.append(entry)
        step = _path(folder, "step", f"{board.name}.step")
        _write_step(board_shapes[board.name], step)
        checks += [*found, *check_step(board.name, step, board_shapes[board.name])]
    progress("assembly", steps - 2 - more, steps)
    sensor = [name for name in shapes if name in (*SENSOR_PARTS, *SEATED_PARTS)]
    leds = built_leds(design, boards)
    checks += _write_assembly(design, folder, {name: shapes[name] for name in sensor}, board_shapes, leds)
    progress("checks", steps - 1 - more, steps)
    pairs = [*combinations(sensor, 2), *combinations(CASTING_PARTS, 2), *combinations(board_shapes, 2)]
    pairs += [(name, part) for name in board_shapes for part in sensor]
    note = "accepted: allow_infeasible"
    overlaps = check_overlaps(design, {**shapes, **board_shapes}, pairs)
    if allow_infeasible:
        overlaps = [check if check.ok else check._replace(ok=True, note=note) for check in overlaps]
    _require_boards_apart(overlaps)
    checks += overlaps
    if design.housing.seats is not None:
        together = {**shapes, **board_shapes}
        order = assembly.steps(design, together, boards)
        carried = assembly.leds_on(boards, design)
        fitted = assembly.check_contacts(design, together, boards)
        fitted += assembly.check_order(design, together, order, carried)
        fitted += assembly.check_wires(design, together, boards)
        if allow_infeasible:
            fitted = [check if check.ok else check._replace(ok=True, note=note) for check in fitted]
        checks += fitted
    bought = numbered([*bill(design, shapes, made), *map(bill_row, boards)])
    broken = {rule: margin for rule, margin in design.margins().items() if margin > 0}
    manifest: dict[str, Any] = {
        "kind": KIND,
        "format": 1,
        "design": design.name,
        "made_from": design.lineage,
        "digest": design.digest,
        "versions": {package: installed_version(package) for package in PROGRAMS},
        "assumed": [
            *assumed_fields(design),
            *(() if made is None else made.assumed),
            *assumed_figures(design),
        ],
        "parts": described,
        "boards": described_boards,
        "drive": [] if made is None else [channel.told() for channel in made.channels],
        "bom": bought,
        "led_count": len(bodies(design.leds)),
        "margins_mm": design.margins(),
        "walls": {
            "thinnest_mm": round(thickness[thinnest].thickness_mm, 2),
            "thinnest_part": thinnest,
            "each_mm": {name: round(wall.thickness_mm, 2) for name, wall in thickness.items()},
            "least_mm": MINIMUM_WALL_MM,
            "mould_mm": min(MOULD_WALL_MM, MOULD_FLOOR_MM),
        },
        "warnings": [
            *notes,
            *(() if made is None else made.notes),
            *(f"{probe_name(p)}: {note}" for p in meshed for note in described[probe_name(p)]["notes"]),
            *_unseated(design, made),
            *(thin if design.housing.seats is not None else ()),
            *([design.not_buildable] if design.not_buildable else []),
            *(f"rule {rule} is violated by {margin:.3g} mm" for rule, margin in broken.items()),
            *(f"{c.part} overlap by {c.value:.3g} mm3 ({c.note})" for c in overlaps if c.note),
        ],
        "checks": [check._asdict() for check in checks],
    }
    write_csv(led_rows(design, {row["item"]: row["part"] for row in bought}), folder / "leds.csv")
    write_csv(manifest["bom"], folder / "bom.csv")
    (folder / "design.toml").write_text(dumps(design), encoding="utf-8")
    _write_json(manifest["checks"], folder / "checks.json")
    return Built(design, {**shapes, **board_shapes}, leds, order, carried, made, manifest), steps


def _close(design: Design, folder: Path, manifest: dict[str, Any]) -> None:
    """Write README and manifest, which tell of all other files."""
    (folder / "README.txt").write_text(readme(design, manifest), encoding="utf-8")
    written = sorted(path for path in folder.rglob("*") if path.is_file())
    manifest["files"] = {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in written
    }
    _write_json(manifest, folder / MANIFEST)


def _unseated(design: Design, made: Boards | None) -> list[str]:
    """Say what a housing with seats does not hold."""
    if design.housing.seats is None or made is not None or design.leds.coupling == "embedded":
        return []
    return ["the housing has no pockets for LEDs, since no LED boards are made"]


def _require_boards_apart(overlaps: Sequence[FileCheck]) -> None:
    """Refuse a board that reaches into another part: the design's LEDs leave it no room."""
    for check in overlaps:
        board, _, other = check.part.partition("/")
        if not check.ok and board.startswith("board_"):
            raise BoardError(
                f"{board}: reaches {check.value:.3g} {check.unit} into {other}, at most {check.bound:g} "
                f"{check.unit} may be; move its LEDs (leds.radius_mm, leds.height_mm), or --no-boards for "
                "all but the LED boards"
            )


def _write_part(
    design: Design, folder: Path, name: str, shape: "cadquery.Shape"
) -> tuple[dict[str, Any], list[FileCheck]]:
    """Write STEP, STL and, for a part to print, 3MF; return its description and the checks of its files."""
    step = _path(folder, "step", f"{name}.step")
    _write_step(shape, step)
    box = shape.BoundingBox()
    described: dict[str, Any] = {
        "solids": len(shape.Solids()),
        "volume_mm3": shape.Volume(),
        "area_mm2": shape.Area(),
        "size_mm": [box.xlen, box.ylen, box.zlen],
    }
    if name in BOUGHT:
        return described, check_step(name, step, shape)
    stl = _path(folder, "stl", f"{name}.stl")
    optical = name in ("gelcore", "elastomer") or name.startswith(("mould", "probe"))
    mesh, report = printable(shape, bound_mm=OPTICAL_THINNING_MM if optical else THINNING_MM)
    mesh.export(stl, file_type="stl")
    checks = [*check_step(name, step, shape), *check_mesh(name, stl, shape)]
    if report["hausdorff_mm"] > 0:
        distance, bound = report["hausdorff_mm"], report["hausdorff_bound_mm"]
        checks.append(
            FileCheck(name, stl.name, "Hausdorff distance", distance, bound, "mm", distance <= bound)
        )
    if _printed(design, name):
        package = _path(folder, "3mf", f"{name}.3mf")
        laid = shape
        if design.housing.seats is not None and name in SEATED_PARTS:
            laid = assembly.print_pose(name, shape)
            mesh.apply_transform(assembly.print_turn(name, shape))
        write_3mf(mesh, package, name=name)
        checks += check_mesh(name, package, laid)
    return described | {"mesh": report}, checks


def _write_step(shape: "cadquery.Shape", path: Path) -> None:
    import cadquery

    cadquery.exporters.export(cadquery.Workplane(shape), str(path))


def _write_mesh_probe(folder: Path, probe: Probe) -> tuple[dict[str, Any], list[FileCheck]]:
    """Write a user's mesh, scaled and placed, as STL, and compare the file with it."""
    name = probe_name(probe)
    mesh, repairs = closed(probe_library.mesh(probe))
    path = _path(folder, "stl", f"{name}.stl")
    mesh.export(path, file_type="stl")
    described = {"size_mm": mesh.extents.tolist(), "source": probe.file, "notes": list(repairs)}
    if not mesh.is_watertight:
        described["notes"].append("its surface is open, so it cannot be printed as it is; close it before")
        return described, []
    checks = mesh_checks(name, path.name, read(path), volume_mm3=float(mesh.volume))
    return described | {"volume_mm3": float(mesh.volume)}, checks


def _write_assembly(
    design: Design,
    folder: Path,
    shapes: Mapping[str, "cadquery.Shape"],
    boards: Mapping[str, "cadquery.Shape"],
    leds: Sequence[Led],
) -> list[FileCheck]:
    """Write the sensor's parts in place, named and coloured, into one STEP file."""
    import cadquery

    assembly = cadquery.Assembly(name=re.sub(r"[^A-Za-z0-9_.-]+", "_", design.name) or "sensor")
    for name, rgba in PART_COLOURS.items():
        solids = shapes[name].Solids() if name in shapes else []
        for number, solid in enumerate(solids, start=1):
            named = name if len(solids) == 1 else f"{name.rstrip('s')}_{number}"
            assembly.add(solid, name=named, color=cadquery.Color(*rgba))
    array = cadquery.Assembly(name="led_array")
    for led in leds:
        groups = [design.leds.groups[index] for index in led.groups]
        array.add(led.solid, name=led.name, color=cadquery.Color(*package_colour(groups), 1.0))
    assembly.add(array)
    for name, shape in boards.items():
        assembly.add(shape, name=name, color=cadquery.Color(*BOARD_COLOUR))
    path = folder / "assembly.step"
    assembly.export(str(path))
    solids = [solid for shape in shapes.values() for solid in shape.Solids()]
    solids += [solid for shape in boards.values() for solid in shape.Solids()]
    return check_step("assembly", path, cadquery.Compound.makeCompound(solids))


def led_colour(wavelength_nm: float) -> tuple[float, float, float]:
    """Display colour (sRGB, 0..1) of a narrow-band LED, for pictures and CAD only.

    Linear between hand-set hues of the visible range; infrared is dark red, ultraviolet violet.
    """
    stops = (
        (380.0, (0.5, 0.0, 0.9)),
        (440.0, (0.15, 0.1, 1.0)),
        (490.0, (0.0, 0.85, 1.0)),
        (515.0, (0.0, 0.9, 0.25)),
        (560.0, (0.7, 0.95, 0.0)),
        (590.0, (1.0, 0.75, 0.0)),
        (620.0, (1.0, 0.12, 0.08)),
        (780.0, (0.55, 0.0, 0.0)),
    )
    wavelengths, colours = zip(*stops, strict=True)
    r, g, b = (float(np.interp(wavelength_nm, wavelengths, part)) for part in zip(*colours, strict=True))
    return r, g, b


def group_colour(group: LedGroup) -> tuple[float, float, float]:
    """Display colour (sRGB, 0..1) of an LED group: white where its spectrum is no narrow peak."""
    return (1.0, 1.0, 1.0) if group.spectrum is not None else led_colour(group.wavelength_nm)


def package_colour(groups: Sequence[LedGroup]) -> tuple[float, float, float]:
    """Display colour (sRGB, 0..1) of a package: the mean of the colours it holds."""
    r, g, b = np.mean([group_colour(group) for group in groups], axis=0).tolist()
    return r, g, b


def _printed(design: Design, name: str) -> bool:
    """Whether a part comes from a 3D printer: housing, mould, probes, and a core of resin."""
    if name == "gelcore":
        return material(design.optics.gelcore_material).name.startswith("resin")
    return name in PRINTED or name.startswith(("mould", "probe"))


def _path(folder: Path, kind: str, name: str) -> Path:
    (folder / kind).mkdir(exist_ok=True)
    return folder / kind / name


def _write_json(content: Any, path: Path) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
