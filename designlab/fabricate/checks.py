"""Proof that what was written can be made: every file is read again and compared with the CAD solid."""

from collections.abc import Iterable, Mapping
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from designlab.design import Design
from designlab.fabricate.triangles import open_edges, read_3mf

if TYPE_CHECKING:
    import cadquery
    import trimesh

VOLUME_SHARE = 0.005
BOX_MM = 0.05
STEP_VOLUME_SHARE = 1e-6
OVERLAP_MM3 = 1.0


class Check(NamedTuple):
    """One comparison of a figure with its bound; `note` says why a figure beyond it is accepted."""

    part: str
    file: str
    name: str
    value: float
    bound: float
    unit: str
    ok: bool
    note: str = ""


def check_mesh(part: str, path: Path, shape: "cadquery.Shape") -> list[Check]:
    """Read an STL or 3MF file again: closed, outward, volume and bounding box as the CAD solid's."""
    import trimesh

    mesh = read_3mf(path) if path.suffix == ".3mf" else trimesh.load_mesh(path)
    checks = mesh_checks(part, path.name, mesh, volume_mm3=shape.Volume())
    box = shape.BoundingBox(0.001)
    solid_box = np.array([[box.xmin, box.ymin, box.zmin], [box.xmax, box.ymax, box.zmax]])
    off = float(np.abs(np.asarray(mesh.bounds) - solid_box).max())
    return [*checks, Check(part, path.name, "bounding box", off, BOX_MM, "mm", off <= BOX_MM)]


def mesh_checks(part: str, file: str, mesh: "trimesh.Trimesh", *, volume_mm3: float) -> list[Check]:
    """Check that a mesh is closed, looks outwards and encloses a volume within 0.5 %."""
    gaps, volume = open_edges(mesh), float(mesh.volume)
    off = abs(volume / volume_mm3 - 1)
    return [
        Check(part, file, "open edges", gaps, 0, "1", gaps == 0),
        Check(part, file, "signed volume", volume, 0.0, "mm3", volume > 0, "positive: normals look outwards"),
        Check(part, file, "volume error", off, VOLUME_SHARE, "1", off <= VOLUME_SHARE),
    ]


def check_step(part: str, path: Path, shape: "cadquery.Shape") -> list[Check]:
    """Read a STEP file again: valid solids of the same volume."""
    import cadquery

    solids = cadquery.importers.importStep(str(path)).solids().vals()
    invalid = sum(not solid.isValid() for solid in solids)
    off = abs(sum(solid.Volume() for solid in solids) / shape.Volume() - 1)
    missing = len(shape.Solids()) - len(solids)
    return [
        Check(part, path.name, "missing solids", missing, 0, "1", missing == 0),
        Check(part, path.name, "invalid solids", invalid, 0, "1", invalid == 0),
        Check(part, path.name, "volume error", off, STEP_VOLUME_SHARE, "1", off <= STEP_VOLUME_SHARE),
    ]


def check_overlaps(design: Design, shapes: Mapping[str, "cadquery.Shape"], names: Iterable[str]) -> list[Check]:
    """Volume that each pair of parts shares; parts may touch, not overlap.

    A design whose light path is "air" leaves the core out of its optics and its rules, as some published scenes
    do; there the LEDs may reach into the core, and the figure is reported with a note instead of failing.
    """
    checks = []
    for first, second in combinations(names, 2):
        shared = overlap_mm3(shapes[first], shapes[second])
        within, note = shared <= OVERLAP_MM3, ""
        if not within and "led_array" in (first, second) and design.optics.light_path == "air":
            within = {first, second} <= {"led_array", "gelcore", "elastomer"}
            note = "accepted: light_path is air, so the design has no rule for it; cut pockets into the core or move the LEDs"
        checks.append(Check(f"{first}/{second}", "", "overlap", shared, OVERLAP_MM3, "mm3", within, note))
    return checks


def overlap_mm3(first: "cadquery.Shape", second: "cadquery.Shape") -> float:
    """Volume (mm3) that two shapes share, solid by solid."""
    total = 0.0
    for a in first.Solids():
        box_a = a.BoundingBox()
        for b in second.Solids():
            box_b = b.BoundingBox()
            apart = (
                box_a.xmin > box_b.xmax or box_b.xmin > box_a.xmax
                or box_a.ymin > box_b.ymax or box_b.ymin > box_a.ymax
                or box_a.zmin > box_b.zmax or box_b.zmin > box_a.zmax
            )
            if not apart:
                total += sum(solid.Volume() for solid in a.intersect(b).Solids())
    return total


def require(checks: Iterable[Check]) -> None:
    """Raise RuntimeError with part and figures if a check failed."""
    failed = [check for check in checks if not check.ok]
    if failed:
        lines = "; ".join(
            f"{check.part} {check.file}".rstrip() + f": {check.name} is {check.value:.6g} {check.unit}, bound {check.bound:g}"
            for check in failed
        )
        raise RuntimeError(f"export check failed: {lines}")
