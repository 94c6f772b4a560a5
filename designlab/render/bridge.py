"""From a `Scene` to Mitsuba objects: the one place where the two meet."""

from typing import TYPE_CHECKING, Any

import numpy as np

from designlab.camera import View
from designlab.render.backend import activate
from designlab.render.surfaces import bsdf
from designlab.scene import Diffuse, Light, Scene, Shape

if TYPE_CHECKING:
    import mitsuba


def load(scene: Scene, *, group: int, integrator: dict[str, Any], samples: int) -> "mitsuba.Scene":
    """Load a scene in which one LED group emits 1 mW.

    Only that group's light sources are there, so that every next-event sample goes to a light that is on.
    """
    activate()
    import mitsuba as mi

    content: dict[str, Any] = {"type": "scene", "integrator": integrator, "sensor": _sensor(scene, samples)}
    for shape in scene.shapes:
        content[shape.name] = _mesh(shape, group)
    for number, light in enumerate(light for light in scene.lights if light.group == group):
        content[f"light-{number}"] = _light(light, scene, group)
    return mi.load_dict(content)


def _mesh(shape: Shape, group: int) -> "mitsuba.Mesh":
    import mitsuba as mi

    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf(shape.material, group))
    if shape.normals is None:
        properties["face_normals"] = True
    mesh = mi.Mesh(
        shape.name,
        vertex_count=len(shape.vertices),
        face_count=len(shape.faces),
        has_vertex_normals=shape.normals is not None,
        props=properties,
    )
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.ascontiguousarray(shape.vertices, dtype=np.float32).ravel()
    parameters["faces"] = np.ascontiguousarray(shape.faces, dtype=np.uint32).ravel()
    if shape.normals is not None:
        parameters["vertex_normals"] = np.ascontiguousarray(shape.normals, dtype=np.float32).ravel()
    parameters.update()
    return mesh


def _light(light: Light, scene: Scene, group: int) -> dict[str, Any]:
    import mitsuba as mi

    # The rectangle plug-in spans [-1, 1]^2 and emits along +z: its columns are the half axes and the normal.
    across, normal = np.asarray(light.across), np.asarray(light.normal)
    up = np.cross(normal, across)
    matrix = np.eye(4)
    matrix[:3, 0] = light.half_width_mm * across
    matrix[:3, 1] = light.half_height_mm * up
    matrix[:3, 2] = normal
    matrix[:3, 3] = light.centre_mm
    board = next((s for s in scene.shapes if s.name.startswith("board")), None)
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f(matrix),
        "bsdf": bsdf(board.material if board is not None else Diffuse((0.0,) * scene.groups), group),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [float(light.radiance)] * 3}},
    }


def _sensor(scene: Scene, samples: int) -> dict[str, Any]:
    import mitsuba as mi

    view: View = scene.view
    width_px, height_px = scene.sensor_px
    origin = np.asarray(scene.camera_mm)
    return {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f().look_at(
            origin=list(origin), target=list(origin - (0.0, 0.0, 1.0)), up=[0.0, 1.0, 0.0]
        ),
        "fov_axis": "x",
        "fov": float(np.degrees(2 * np.arctan(view.width_px / 2 / scene.focal_px))),
        "principal_point_offset_x": float((view.x_px + view.width_px / 2 - width_px / 2) / view.width_px),
        "principal_point_offset_y": float((view.y_px + view.height_px / 2 - height_px / 2) / view.height_px),
        "near_clip": 0.05,
        "far_clip": 1e4,
        "sampler": {"type": "ldsampler", "sample_count": int(samples)},
        "film": {
            "type": "hdrfilm",
            "width": view.columns,
            "height": view.rows,
            "pixel_format": "luminance",
            "component_format": "float32",
            # Box: the Gaussian default would correlate the noise of neighbouring pixels.
            "rfilter": {"type": "box"},
        },
    }
