"""The sensor as one glTF file for three-dimensional viewers: parts, LEDs, membrane and the camera's view."""

from typing import TYPE_CHECKING, Any, cast

import numpy as np

from designlab.core.types import Array
from designlab.fabrication import group_colour
from designlab.sensor.design import Design
from designlab.sensor.mirror import turned
from geometries import elastomer, gelcore, housing, leds
from geometries.elastomer import base_mm
from geometries.leds import emitters
from geometries.mesh import from_solid

if TYPE_CHECKING:
    import trimesh

TOLERANCE_MM, TOLERANCE_DEG = 0.05, 8.0
PART_COLOURS = {
    "housing": (130, 138, 150, 70),
    "gelcore": (150, 205, 235, 70),
    "elastomer": (243, 184, 119, 110),
    "led_array": (70, 74, 82, 255),
}
MIRROR_COLOUR = (200, 214, 226, 255)
CAMERA_COLOUR, SENSING_COLOUR = (89, 97, 111, 255), (194, 24, 91, 255)
LINE_MM = 0.06  # radius of lines
MIRROR_MM = 0.5  # thickness of a mirror, behind its face
WIDE_MM = 1000.0  # of the box that cuts a sensor open


def glb(design: Design, *, section: bool = False) -> bytes:
    """Binary glTF of a design in the sensor frame, in mm; what is clear is translucent.

    Parameters
    ----------
    design : Design
        The sensor.
    section : bool
        Cut it open along y = 0: the half with y > 0 is kept, camera and mirror are whole.

    Raises
    ------
    InfeasibleDesign
        If a part has no shape.
    """
    import trimesh

    design.require_shapes()
    scene = trimesh.Scene()
    core = gelcore.solid(design.gelcore).translate((0, 0, design.elastomer.thickness_mm))
    solids = {
        "led_array": leds.solid(design.leds),
        "elastomer": elastomer.solid(design.elastomer),
        "gelcore": core,
        "housing": housing.solid(design.housing),
    }
    for name, work in solids.items():
        shape = _all_solids(work, rear=section)
        if not shape.size():
            continue
        mesh = from_solid(shape, tolerance_mm=TOLERANCE_MM, angular_tolerance_deg=TOLERANCE_DEG)
        scene.add_geometry(_coloured(mesh, PART_COLOURS[name]), geom_name=name)
    for number, face in enumerate(emitters(design.leds)):
        if section and face.centre_mm[1] < 0:
            continue
        colour = tuple(round(255 * part) for part in group_colour(design.leds.groups[face.group]))
        scene.add_geometry(_face(face, (*colour, 255)), geom_name=f"led {number}")
    camera = design.camera
    place, radius = np.array(camera.position_mm, dtype=float), camera.body_radius_mm
    ahead = turned(camera.tilt_deg)[:, 2] * (1.0, 1.0, -1.0)
    barrel = trimesh.creation.cylinder(
        radius, segment=np.array([place - 2 * radius * ahead, place]), sections=48
    )
    if (mirror := camera.mirror) is not None:
        plate = np.eye(4)
        plate[:3, :3], plate[:3, 3] = mirror.axes.T, mirror.centre_mm
        plate[:3, 3] -= MIRROR_MM / 2 * mirror.axes[2]
        size_mm = (mirror.width_mm, mirror.height_mm, MIRROR_MM)
        box = trimesh.creation.box(size_mm, transform=plate)
        scene.add_geometry(_coloured(box, MIRROR_COLOUR), geom_name="mirror")
    scene.add_geometry(_coloured(barrel, CAMERA_COLOUR), geom_name="camera")
    for number, (start, end) in enumerate(_lines(design)):
        line = trimesh.creation.cylinder(LINE_MM, segment=np.array([start, end]), sections=6)
        scene.add_geometry(_coloured(line, SENSING_COLOUR), geom_name=f"view {number}")
    return bytes(cast(Any, scene).export(file_type="glb"))


def _all_solids(work: Any, *, rear: bool) -> Any:
    """The solids of a part, or what of them has y > 0."""
    import cadquery

    solids = [solid for shape in work.vals() for solid in shape.Solids()]
    if rear:
        half = cadquery.Workplane().box(WIDE_MM, WIDE_MM, WIDE_MM).translate((0, WIDE_MM / 2, 0)).val()
        solids = [part for solid in solids for part in solid.intersect(half).Solids()]
    return cadquery.Workplane().newObject(solids)


def _coloured(mesh: "trimesh.Trimesh", colour: tuple[int, ...]) -> "trimesh.Trimesh":
    from trimesh.visual import material as materials
    from trimesh.visual import texture

    clear = colour[3] < 255
    material = cast(Any, materials).PBRMaterial(
        baseColorFactor=[part / 255 for part in colour],
        alphaMode="BLEND" if clear else "OPAQUE",
        doubleSided=True,
        metallicFactor=0.0,
        roughnessFactor=0.6,
    )
    # Flat sides stay flat: vertices at sharp edges are not shared.
    flat = mesh.copy() if clear else mesh
    flat.unmerge_vertices()
    flat.visual = cast(Any, texture).TextureVisuals(material=material)
    return flat


def _face(face: leds.Emitter, colour: tuple[int, ...]) -> "trimesh.Trimesh":
    import trimesh

    centre = np.asarray(face.centre_mm) + 0.03 * np.asarray(face.normal)
    across = face.half_width_mm * np.asarray(face.across)
    down = face.half_height_mm * np.asarray(face.down)
    corners = np.array([centre + a * across + d * down for a, d in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    return _coloured(trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False), colour)


def _lines(design: Design) -> list[tuple[Array, Array]]:
    """Edges of the sensing area, and rays from the camera to its corners."""
    half_w, half_h = np.array(design.sensing_area_mm) / 2
    corners = []
    for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        x, y = sx * half_w, sy * half_h
        corners.append(np.array([x, y, float(np.nan_to_num(base_mm(design.elastomer, x, y)))]))
    edges = [(corners[k], corners[(k + 1) % 4]) for k in range(4)]
    eye, seen = np.array(design.camera.position_mm, dtype=float), np.array(design.camera.eye_mm)
    for corner in corners:
        turn = eye
        if (mirror := design.camera.mirror) is not None:
            normal, way = mirror.axes[2], corner - seen
            turn = seen + way * (((np.array(mirror.centre_mm) - seen) @ normal) / (way @ normal))
            edges.append((eye, turn))
        edges.append((turn, corner))
    return edges
