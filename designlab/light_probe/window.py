"""What light loses between the ball and the camera."""

import numpy as np
from numpy.typing import NDArray

from designlab.camera import View
from designlab.design import Design
from designlab.viewing import Rays

Array = NDArray[np.float64]


def passed(design: Design, view: View, rays: Rays, group: int) -> Array:
    """Share of radiance that passes gelcore and window towards the camera, shape (rows, columns).

    Fresnel's transmittance for unpolarised light at both faces and absorption in between; light that is
    reflected back and forth in the core is left out, and so is what haze scatters.

    Parameters
    ----------
    design : Design
        The sensor without its gel.
    view : View
        The pixels.
    rays : Rays
        Their viewing rays, in the air below the core.
    group : int
        LED group whose light it is.
    """
    if design.optics.light_path == "air":
        return np.ones_like(rays.x_mm)
    right, up, forward = design.camera.unproject(*view.centres())
    at_window = np.maximum(forward, 1e-9) / np.sqrt(right**2 + up**2 + forward**2)
    slope = np.stack([rays.slope_x, rays.slope_y, np.ones_like(rays.slope_x)])
    upward = slope / np.linalg.norm(slope, axis=0)
    at_face, height = upward[2], np.full_like(upward[2], design.elastomer.thickness_mm)
    if (radius := design.elastomer.radius_mm) is not None:
        # The dome's face: a sphere about (0, 0, radius), met on its lower side.
        inner = radius - design.elastomer.thickness_mm
        from_centre = np.stack([rays.x_mm, rays.y_mm, np.full_like(rays.x_mm, -radius)])
        along = (from_centre * upward).sum(axis=0)
        inside = np.maximum(inner**2 - (from_centre**2).sum(axis=0) + along**2, 0.0)
        normal = (from_centre + (-along - np.sqrt(inside)) * upward) / inner
        at_face, height = np.abs((normal * upward).sum(axis=0)), radius + inner * normal[2]
    index = design.optics.core_index
    top = design.elastomer.thickness_mm + design.gelcore.height_mm
    slant = np.sqrt(1 - (1 - at_window**2) / index**2)
    lost = design.absorption_per_mm("gelcore")[group] + design.optics.gelcore_scattering_per_mm
    return np.asarray(
        _through(at_window, index) * _through(at_face, index) * np.exp(-lost * (top - height) / slant)
    )


def _through(cosine: Array, index: float) -> Array:
    """Fresnel's transmittance of a face for unpolarised light, by the cosine of the angle in air."""
    inside = np.sqrt(1 - (1 - cosine**2) / index**2)
    across = (cosine - index * inside) / (cosine + index * inside)
    along = (index * cosine - inside) / (index * cosine + inside)
    return np.asarray(1 - (across**2 + along**2) / 2)
