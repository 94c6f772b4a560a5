"""From a `Scene` to Mitsuba objects: the one place where the two meet."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from designlab.core.backend import activate
from designlab.simulation.render.emitters import emitter
from designlab.simulation.render.engine import mi
from designlab.simulation.render.sensors import sensor
from designlab.simulation.render.surfaces import bsdf, media, metal, texture_coordinates
from designlab.simulation.scene.scene import Scene, Shape

if TYPE_CHECKING:
    import mitsuba


def load(scene: Scene, *, group: int, integrator: dict[str, Any], samples: int) -> "mitsuba.Scene":
    """Load a scene in which one LED group emits 1 mW.

    Only that group's light sources are there, so that every next-event sample goes to a light that is on.
    """
    activate()
    content: dict[str, Any] = {"type": "scene", "integrator": integrator, "sensor": sensor(scene, samples)}
    for shape in scene.shapes:
        content[shape.name] = _mesh(shape, group)
    for ball in scene.balls:
        content[ball.name] = {
            "type": "sphere",
            "center": list(ball.centre_mm),
            "radius": float(ball.radius_mm),
            "bsdf": metal(ball.material, group),
        }
    for number, light in enumerate(light for light in scene.lights if light.group == group):
        content[f"light-{number}"] = emitter(light, scene, group)
    return mi.load_dict(content)


def load_shapes(shapes: Iterable[Shape]) -> "mitsuba.Scene":
    """Load shapes alone, without light or camera, to be hit by rays."""
    activate()
    return mi.load_dict({"type": "scene", **{shape.name: _mesh(shape, 0) for shape in shapes}})


def _mesh(shape: Shape, group: int) -> "mitsuba.Mesh":
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf(shape.material, group))
    for side, medium in media(shape.material, group).items():
        properties[side] = mi.load_dict(medium)
    uv = texture_coordinates(shape)
    if shape.normals is None:
        properties["face_normals"] = True
    mesh = mi.Mesh(
        shape.name,
        vertex_count=len(shape.vertices),
        face_count=len(shape.faces),
        has_vertex_normals=shape.normals is not None,
        has_vertex_texcoords=uv is not None,
        props=properties,
    )
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.ascontiguousarray(shape.vertices, dtype=np.float32).ravel()
    parameters["faces"] = np.ascontiguousarray(shape.faces, dtype=np.uint32).ravel()
    if shape.normals is not None:
        parameters["vertex_normals"] = np.ascontiguousarray(shape.normals, dtype=np.float32).ravel()
    if uv is not None:
        parameters["vertex_texcoords"] = uv.ravel()
    parameters.update()
    return mesh
