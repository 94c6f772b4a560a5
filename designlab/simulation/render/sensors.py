"""Mitsuba sensors of a camera: its own perspective, or a lens of our own that shoots rays by a table.

The table holds the directions of the camera's `unproject` at the corners of all output pixels, or denser, and
is bilinear in between, so that samples anywhere in a pixel look where the lens does. It needs a just-in-time
back end; ``scalar_rgb`` renders a finer perspective picture instead, which is resampled.
"""

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from designlab.core.backend import activate
from designlab.sensor.camera import Camera, View
from designlab.sensor.lens import Distortion
from designlab.simulation.render.engine import dr, mi
from designlab.simulation.scene.scene import Scene

if TYPE_CHECKING:
    import mitsuba

TABLE_PX = 8.0  # spacing of the table of directions, in pixels of the full sensor, at most
FINER = 2  # resolution of the perspective picture over that of the one resampled from it
STEEPEST = float(np.tan(np.radians(80.0)))  # tangent of the angle to which a perspective stands in for a lens


def sensor(scene: Scene, samples: int) -> "dict[str, Any] | mitsuba.Sensor":
    """What `mi.load_dict` makes the camera of a scene from; vignetting is not part of it."""
    camera = scene.camera
    if camera.is_plain and (camera.defocus is None or not activate().is_jit):
        return _perspective(scene, samples)
    return _lens(scene, samples)


def _perspective(scene: Scene, samples: int) -> dict[str, Any]:
    view, camera = scene.view, scene.camera
    origin = np.asarray(camera.eye_mm)
    x_c, y_c = camera.centre_px
    off_x = (view.x_px + view.width_px / 2 - x_c) / view.width_px
    off_y = (view.y_px + view.height_px / 2 - y_c) / view.height_px
    return {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f().look_at(
            origin=list(origin), target=list(origin - (0.0, 0.0, 1.0)), up=[0.0, 1.0, 0.0]
        ),
        "fov_axis": "x",
        "fov": float(np.degrees(2 * np.arctan(view.width_px / 2 / camera.focal_px))),
        "principal_point_offset_x": float(off_x),
        "principal_point_offset_y": float(off_y),
        "near_clip": 0.05,
        "far_clip": 1e4,
        "sampler": _sampler(samples),
        "film": _film(view),
    }


def _sampler(samples: int) -> dict[str, Any]:
    # Not Mitsuba's ldsampler, whose numbers repeat from bounce to bounce of a compiled loop: light that a
    # dome throws on itself comes out 1.3 % too weak with it, at any number of samples.
    return {"type": "multijitter", "sample_count": int(samples)}


def _film(view: View) -> dict[str, Any]:
    return {
        "type": "hdrfilm",
        "width": view.columns,
        "height": view.rows,
        "pixel_format": "luminance",
        "component_format": "float32",
        # Box: the Gaussian default would correlate the noise of neighbouring pixels.
        "rfilter": {"type": "box"},
    }


def directions(camera: Camera, view: View) -> NDArray[np.float64]:
    """Directions (right, up, forward) on an even grid over a view, its edges included, shape (n, m, 3)."""
    counts = [
        pixels * max(1, int(np.ceil(size_px / pixels / TABLE_PX)))
        for pixels, size_px in ((view.rows, view.height_px), (view.columns, view.width_px))
    ]
    rows = view.y_px + np.linspace(0.0, view.height_px, counts[0] + 1)
    columns = view.x_px + np.linspace(0.0, view.width_px, counts[1] + 1)
    grid_columns, grid_rows = np.meshgrid(columns, rows)
    return np.stack(camera.unproject(grid_columns, grid_rows), axis=-1)


def _lens(scene: Scene, samples: int) -> "mitsuba.Sensor":
    properties = mi.Properties()
    properties["film"] = mi.load_dict(_film(scene.view))
    properties["sampler"] = mi.load_dict(_sampler(samples))
    made: mitsuba.Sensor = _lens_class()(properties)
    made.look(scene.camera, scene.view)
    return made


@cache
def _lens_class() -> Any:
    class LensRays(mi.Sensor):  # type: ignore[misc]
        """Rays through the points of a lens opening, in directions from a table."""

        def look(self, camera: Camera, view: View) -> None:
            table = directions(camera, view)
            self.shape = table.shape[:2]
            self.table = mi.Float(np.ascontiguousarray(table, dtype=np.float32).ravel())
            self.origin = [float(value) for value in camera.eye_mm]
            self.radius_mm, self.focus_mm = camera.defocus or (0.0, 1.0)
            self.m_needs_sample_3 = camera.defocus is not None

        def _direction(self, place: Any, active: Any) -> Any:
            rows, columns = self.shape
            u = dr.clip(place.x, 0.0, 1.0) * (columns - 1)
            v = dr.clip(place.y, 0.0, 1.0) * (rows - 1)
            column = dr.minimum(mi.UInt32(u), columns - 2)
            row = dr.minimum(mi.UInt32(v), rows - 2)
            a, b = u - mi.Float(column), v - mi.Float(row)
            node = row * columns + column

            def at(offset: int) -> Any:
                return dr.gather(mi.Vector3f, self.table, node + offset, active)

            top, bottom = dr.lerp(at(0), at(1), a), dr.lerp(at(columns), at(columns + 1), a)
            return dr.lerp(top, bottom, b)

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            seen = self._direction(sample2, active)
            point = self.radius_mm * mi.warp.square_to_uniform_disk_concentric(sample3)
            # The ray meets the central one in the plane of focus.
            away = dr.maximum(seen.z, 0.0) / self.focus_mm
            towards = mi.Vector3f(seen.x - point.x * away, seen.y - point.y * away, -seen.z)
            x, y, z = self.origin
            ray = mi.Ray3f(mi.Point3f(x + point.x, y + point.y, z), dr.normalize(towards))
            ray.time = time
            return ray, mi.Color3f(1.0)

        def sample_ray_differential(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            ray, weight = self.sample_ray(time, sample1, sample2, sample3, active)
            return mi.RayDifferential3f(ray), weight

    return LensRays


def must_resample(camera: Camera) -> bool:
    """Whether the back end cannot render the lens itself, only a perspective to resample from."""
    return not camera.is_plain and not activate().is_jit


def perspective_of(scene: Scene) -> Scene:
    """Return the scene before a perspective camera whose picture covers the lens's and is finer.

    Raises
    ------
    ValueError
        If the picture reaches too far from the axis for a perspective.
    """
    camera, view = scene.camera.unfolded, scene.view
    seen = directions(camera, view)
    steepness = np.hypot(seen[..., 0], seen[..., 1]) / np.maximum(seen[..., 2], 1e-12)
    if steepness.max() > STEEPEST:
        raise ValueError(
            "camera.lens: on the back end scalar_rgb the picture must stay within 80 deg of the axis, it "
            f"reaches {np.degrees(np.arctan(steepness.max())):.3g} deg"
        )
    tangents = seen[..., :2] / seen[..., 2:]
    focal, fov_deg = camera.focal_px, 2 * np.degrees(np.arctan(camera.width_px / 2 / camera.focal_px))
    changes = {
        "lens": "pinhole",
        "distortion": Distortion(),
        "tilt_deg": (0.0, 0.0),
        "pixel_aspect": 1.0,
        "horizontal_fov_deg": float(fov_deg),
    }
    pixel = view.width_px / view.columns / FINER
    left, right = focal * tangents[..., 0].min(), focal * tangents[..., 0].max()
    top, bottom = -focal * tangents[..., 1].max(), -focal * tangents[..., 1].min()
    columns, rows = int(np.ceil((right - left) / pixel)), int(np.ceil((bottom - top) / pixel))
    wide = View(
        camera.centre_px[0] + left,
        camera.centre_px[1] + top,
        columns * pixel,
        rows * pixel,
        columns,
        rows,
    )
    return replace(scene, camera=camera.model_copy(update=changes), view=wide)


def resampled(image: NDArray[np.float32], flat: Scene, scene: Scene) -> NDArray[np.float32]:
    """Picture (groups, rows, columns) of a lens from that of `perspective_of`, averaged over its pixels."""
    from scipy.ndimage import map_coordinates

    split = 2 * FINER
    view, wide = scene.view, flat.view
    fine = view._replace(columns=view.columns * split, rows=view.rows * split)
    right, up, forward = scene.camera.unproject(*fine.centres())
    column, row = flat.camera.project(right, up, forward)
    places = [
        (row - wide.y_px) / wide.height_px * wide.rows - 0.5,
        (column - wide.x_px) / wide.width_px * wide.columns - 0.5,
    ]
    shape = view.rows, split, view.columns, split
    groups = [
        map_coordinates(group, places, order=1, mode="nearest").reshape(shape).mean(axis=(1, 3))
        for group in image
    ]
    return np.stack(groups).astype(np.float32)
