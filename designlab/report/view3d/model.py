"""The sensor as one glTF file for three-dimensional viewers: parts, LEDs, membrane and the camera's view."""

from typing import TYPE_CHECKING, Any, cast

import numpy as np

from designlab.core.types import Array
from designlab.fabrication import group_colour
from designlab.sensor.design import Design
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
CAMERA_COLOUR, SENSING_COLOUR = (89, 97, 111, 255), (194, 24, 91, 255)
LINE_MM = 0.06  # radius of lines


def glb(design: Design) -> bytes:
    """Binary glTF of a design in the sensor frame, in mm; what is clear is translucent.

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
        mesh = from_solid(_all_solids(work), tolerance_mm=TOLERANCE_MM, angular_tolerance_deg=TOLERANCE_DEG)
        scene.add_geometry(_coloured(mesh, PART_COLOURS[name]), geom_name=name)
    for number, face in enumerate(emitters(design.leds)):
        colour = tuple(round(255 * part) for part in group_colour(design.leds.groups[face.group]))
        scene.add_geometry(_face(face, (*colour, 255)), geom_name=f"led {number}")
    x, y, z = design.camera.position_mm
    radius = design.camera.body_radius_mm
    barrel = trimesh.creation.cylinder(radius, 2 * radius, sections=48)
    barrel.apply_translation((x, y, z + radius))
    scene.add_geometry(_coloured(barrel, CAMERA_COLOUR), geom_name="camera")
    for number, (start, end) in enumerate(_lines(design)):
        line = trimesh.creation.cylinder(LINE_MM, segment=np.array([start, end]), sections=6)
        scene.add_geometry(_coloured(line, SENSING_COLOUR), geom_name=f"view {number}")
    return bytes(cast(Any, scene).export(file_type="glb"))


def _all_solids(work: Any) -> Any:
    import cadquery

    return cadquery.Workplane().newObject([s for shape in work.vals() for s in shape.Solids()])


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
    if design.camera.mirror is None:
        eye = np.array(design.camera.position_mm, dtype=float)
        edges += [(eye, corner) for corner in corners]
    return edges
