"""Small scenes by hand, for tests."""

import numpy as np

from designlab.sensor.camera import Camera
from designlab.simulation.scene.scene import Light, Shape

FACES = (  # normals of a cube's faces, inwards, and a direction within each
    ((0, 0, 1), (1, 0, 0)), ((0, 0, -1), (1, 0, 0)), ((1, 0, 0), (0, 1, 0)),
    ((-1, 0, 0), (0, 1, 0)), ((0, 1, 0), (0, 0, 1)), ((0, -1, 0), (0, 0, 1)),
)  # fmt: skip


def box(name, size_mm, material, *, inward):
    """Closed cube about the origin."""
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size_mm / 2
    faces = np.array(
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
         [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    )  # fmt: skip
    a, b, c = (corners[faces[:, k]] for k in range(3))
    outward = (np.cross(b - a, c - a) * a).sum(axis=1) > 0
    flipped = outward if inward else ~outward
    faces[flipped] = faces[flipped][:, ::-1]
    return Shape(name, corners, faces.astype(np.uint32), material)


def sheet_at(name, z_mm, reach_mm, material):
    """Square in the plane z that faces up."""
    corners = np.array([(x * reach_mm, y * reach_mm, z_mm) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    return Shape(name, corners, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32), material)


def rectangle_light(*, half_mm, face=0, x_mm=0.0, z_mm=None, down=False):
    """Square source of 1 mW: a wall of the cube of that half size, or one at a height, facing up or down."""
    normal, across = (np.array(v, dtype=float) for v in FACES[face])
    centre = -half_mm * normal
    if z_mm is not None or down:
        normal, across = np.array([0, 0, -1.0 if down else 1.0]), np.array([1.0, 0, 0])
        centre = np.array([x_mm, 0.0, z_mm])
    radiance = 1 / (np.pi * 4 * half_mm**2)
    vectors = (tuple(float(c) for c in v) for v in (centre, normal, across, np.cross(normal, across)))
    return Light(0, *vectors, half_mm, half_mm, radiance)


def far_camera(*, height_mm, fov_deg):
    return Camera(position_mm=(0.0, 0.0, height_mm), width_px=640, height_px=480, horizontal_fov_deg=fov_deg)


def view_of(camera, columns, rows):
    return camera.full_view()._replace(columns=columns, rows=rows)
