"""File checks read every exported file again and compare it with the CAD solid."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from designlab.fabrication.triangles import read
from designlab.sensor.design import Design
from geometries.mesh import from_solid, open_edges, solids

if TYPE_CHECKING:
    import cadquery
    import trimesh

VOLUME_SHARE = 0.005
BOX_MM = 0.05
STEP_VOLUME_SHARE = 1e-6
OVERLAP_MM3 = 1.0


WALL_SAMPLES, WALL_SEED = 6000, 0
FACING_DEG = 20.0
"""Two faces make a wall where they look away from each other to within this angle."""
WALL_TOLERANCE_MM, WALL_ANGLE_DEG = 0.02, 5.0


class Wall(NamedTuple):
    """Thickness of a wall, and a point on one of its faces (mm)."""

    thickness_mm: float
    at_mm: tuple[float, float, float]


class FileCheck(NamedTuple):
    """One comparison of a figure with its bound; `note` says why a figure beyond it is accepted."""

    part: str
    file: str
    name: str
    value: float
    bound: float
    unit: str
    ok: bool
    note: str = ""


def check_mesh(part: str, path: Path, shape: "cadquery.Shape") -> list[FileCheck]:
    """Read an STL or 3MF file again: closed, outward, volume and bounding box as the CAD solid's."""
    mesh = read(path)
    checks = mesh_checks(part, path.name, mesh, volume_mm3=shape.Volume())
    box = shape.BoundingBox(0.001)
    solid_box = np.array([[box.xmin, box.ymin, box.zmin], [box.xmax, box.ymax, box.zmax]])
    off = float(np.abs(np.asarray(mesh.bounds) - solid_box).max())
    return [*checks, FileCheck(part, path.name, "bounding box", off, BOX_MM, "mm", off <= BOX_MM)]


def mesh_checks(part: str, file: str, mesh: "trimesh.Trimesh", *, volume_mm3: float) -> list[FileCheck]:
    """Check that a mesh is closed, looks outwards and encloses a volume within 0.5 %."""
    gaps, volume = open_edges(mesh), float(mesh.volume)
    off = abs(volume / volume_mm3 - 1)
    return [
        FileCheck(part, file, "open edges", gaps, 0, "1", gaps == 0),
        FileCheck(
            part, file, "signed volume", volume, 0.0, "mm3", volume > 0, "positive: normals look outwards"
        ),
        FileCheck(part, file, "volume error", off, VOLUME_SHARE, "1", off <= VOLUME_SHARE),
    ]


def check_step(part: str, path: Path, shape: "cadquery.Shape") -> list[FileCheck]:
    """Read a STEP file again: valid solids of the same volume."""
    import cadquery

    found = solids(cadquery.importers.importStep(str(path)))
    invalid = sum(1 for solid in found if not solid.isValid())
    off = abs(sum(solid.Volume() for solid in found) / shape.Volume() - 1)
    missing = len(shape.Solids()) - len(found)
    return [
        FileCheck(part, path.name, "missing solids", missing, 0, "1", missing == 0),
        FileCheck(part, path.name, "invalid solids", invalid, 0, "1", invalid == 0),
        FileCheck(part, path.name, "volume error", off, STEP_VOLUME_SHARE, "1", off <= STEP_VOLUME_SHARE),
    ]


def check_overlaps(
    design: Design, shapes: Mapping[str, "cadquery.Shape"], pairs: Iterable[tuple[str, str]]
) -> list[FileCheck]:
    """Find the volume that each pair of parts shares; parts may touch, not overlap.

    A design whose light path is "air" leaves the core out of its optics and its rules, as some published
    scenes do; there LEDs and their boards may reach into the core, and the figure is reported with a note and
    does not fail.
    """
    checks = []
    for first, second in pairs:
        shared = overlap_mm3(shapes[first], shapes[second])
        within, note = shared <= OVERLAP_MM3, ""
        lit = {part for part in (first, second) if part == "led_array" or part.startswith("board_")}
        if not within and lit and design.optics.light_path == "air":
            within = {first, second} <= {*lit, "gelcore", "elastomer"}
            note = "accepted: light_path is air, so no rule of the design forbids it; the core needs pockets"
        checks.append(FileCheck(f"{first}/{second}", "", "overlap", shared, OVERLAP_MM3, "mm3", within, note))
    return checks


def overlap_mm3(first: "cadquery.Shape", second: "cadquery.Shape") -> float:
    """Volume (mm3) that two shapes share, solid by solid."""
    total = 0.0
    for a in first.Solids():
        box = a.BoundingBox()
        for b in second.Solids():
            if not box.wrapped.IsOut(b.BoundingBox().wrapped):
                total += sum(solid.Volume() for solid in a.intersect(b).Solids())
    return total


def thinnest_wall(shape: "cadquery.Shape") -> Wall:
    """Thinnest wall of a solid: the least way through it between two faces that look away from each other.

    Rays start in the middle of every triangle of its surface and at points strewn over it. Edges between
    faces that meet at more than `FACING_DEG` are no walls.
    """
    import cadquery
    import trimesh

    mesh = from_solid(
        cadquery.Workplane().newObject(shape.Solids()),
        tolerance_mm=WALL_TOLERANCE_MM,
        angular_tolerance_deg=WALL_ANGLE_DEG,
    )
    strewn, faces = trimesh.sample.sample_surface(mesh, WALL_SAMPLES, seed=WALL_SEED)
    large = np.flatnonzero(mesh.area_faces > 1e-6)
    points, faces = np.concatenate([mesh.triangles_center[large], strewn]), np.concatenate([large, faces])
    normals = mesh.face_normals[faces]
    hits, rays, met = mesh.ray.intersects_location(points - 1e-4 * normals, -normals, multiple_hits=False)
    through = np.linalg.norm(hits - points[rays], axis=1)
    wall = (normals[rays] * mesh.face_normals[met]).sum(axis=1) < -np.cos(np.radians(FACING_DEG))
    thinnest = int(np.argmin(np.where(wall, through, np.inf)))
    x, y, z = points[rays[thinnest]]
    return Wall(float(through[thinnest]), (float(x), float(y), float(z)))


def require(checks: Iterable[FileCheck]) -> None:
    """Raise RuntimeError with part and figures if a check failed."""
    failed = [check for check in checks if not check.ok]
    if failed:
        lines = "; ".join(
            f"{c.part} {c.file}".rstrip() + f": {c.name} is {c.value:.6g} {c.unit}, bound {c.bound:g}"
            for c in failed
        )
        raise RuntimeError(f"export check failed: {lines}")
