"""What light loses between the ball and the camera."""

import numpy as np

from designlab.core.types import Array
from designlab.sensor.camera import View
from designlab.sensor.design import Design
from designlab.sensor.optical_constants import fresnel_reflectance
from designlab.simulation.optics.viewing_rays import Rays


def passed(design: Design, view: View, rays: Rays, group: int) -> Array:
    """Radiance at the camera over that at the ball, shape (rows, columns).

    Fresnel's transmittance for unpolarised light at both faces of the core, absorption in it, and the
    widening of the beam on leaving a liquid. Light that is reflected back and forth in the core is left out,
    and so is what haze scatters and what the little liquid between core and ball absorbs.

    Parameters
    ----------
    design : Design
        The sensor; its gel's index is that of what surrounds the ball.
    view : View
        The pixels.
    rays : Rays
        Their viewing rays below the core.
    group : int
        LED group whose light it is.

    Raises
    ------
    ValueError
        If the core is a wedge.
    """
    if design.optics.light_path == "air":
        return np.ones_like(rays.x_mm)
    if design.gelcore.wedge_deg is not None:
        raise ValueError("gelcore.wedge_deg: light probes are understood behind level windows only")
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
    around = design.optics.gel_index
    slant = np.sqrt(1 - (1 - at_window**2) / index**2)
    lost = design.absorption_per_mm("gelcore")[group] + design.optics.gelcore_scattering_per_mm
    faces = (1 - fresnel_reflectance(at_window, index)) * (1 - fresnel_reflectance(at_face, index / around))
    return np.asarray(faces * np.exp(-lost * (top - height) / slant) / around**2)
