"""Emitting faces of the engine are Lambertian or narrower; their beam may lean off their normal."""

from functools import cache
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from designlab.core.types import Array

GRAZING = 0.02  # least cosine to a face's normal by which its radiance is the intensity over the seen area


class Face(NamedTuple):
    """Rectangle in place: centre, half axes and normal (3,), axis of the beam (3,), exponent, radiance (3,).

    The radiance, one for each colour channel, is that of a Lambertian face of the same flux.
    """

    centre: Array
    half_across: Array
    half_down: Array
    normal: Array
    axis: Array
    exponent: float
    radiance: Array

    @property
    def is_plain(self) -> bool:
        """Whether the face is Lambertian, its beam along its normal."""
        return self.exponent == 1.0 and bool(np.allclose(self.axis, self.normal, atol=1e-9))

    def entry(self, paint: dict[str, Any]) -> dict[str, Any]:
        """Entry for the engine's dictionary of a scene; `paint` is the surface of the face."""
        matrix = np.eye(4)
        matrix[:3] = np.column_stack([self.half_across, self.half_down, self.normal, self.centre])
        if self.is_plain:
            light: Any = {"type": "area", "radiance": {"type": "rgb", "value": self.radiance.tolist()}}
        else:
            light = _beam_class(mi.variant())(self)
        shape = {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix), "bsdf": paint}
        return shape | {"emitter": light}


@cache
def _beam_class(variant: str) -> Any:
    """Class of an emitter whose intensity is a power of the cosine about an axis, for one variant."""

    class Beam(mi.Emitter):  # type: ignore[misc]
        """Face that sends cos^m about an axis: its radiance is that intensity over the area seen."""

        def __init__(self, face: Face) -> None:
            mi.Emitter.__init__(self, mi.Properties())
            self.m_flags = int(mi.EmitterFlags.Surface)
            self.m_needs_sample_2 = self.m_needs_sample_3 = True
            self.face = face
            self.area = 4.0 * float(np.linalg.norm(np.cross(face.half_across, face.half_down)))

        def _sent(self, towards: Any, active: Any) -> Any:
            face = self.face
            seen = dr.dot(mi.Vector3f(*face.normal.tolist()), towards)
            cosine = dr.dot(mi.Vector3f(*face.axis.tolist()), towards)
            # pi (m + 1) / (2 pi): a Lambertian face of unit radiance has the flux pi times its area.
            share = 0.5 * (face.exponent + 1.0) * dr.power(dr.maximum(cosine, 1e-6), face.exponent)
            share = dr.select(active & (seen > 0) & (cosine > 0), share / dr.maximum(seen, GRAZING), 0.0)
            return mi.Spectrum(mi.Color3f(*face.radiance.tolist()) * share)

        def eval(self, si: Any, active: Any = True) -> Any:
            return self._sent(si.to_world(si.wi), active)

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            face, ds = self.face, dr.zeros(mi.DirectionSample3f)
            across, down = (mi.Vector3f(*v.tolist()) for v in (face.half_across, face.half_down))
            centre = mi.Point3f(*face.centre.tolist())
            ds.p = centre + across * (2 * sample.x - 1) + down * (2 * sample.y - 1)
            ds.n = mi.Normal3f(*face.normal.tolist())
            ds.uv, ds.time, ds.delta, ds.emitter = sample, it.time, False, mi.EmitterPtr(self)
            ds.d = ds.p - it.p
            ds.dist = dr.norm(ds.d)
            ds.d /= ds.dist
            ds.pdf = self.pdf_direction(it, ds, active)
            lit = active & (ds.pdf > 0)
            return ds, dr.select(lit, self._sent(-ds.d, lit) / dr.maximum(ds.pdf, 1e-20), 0.0)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            facing = -dr.dot(ds.d, ds.n)
            return dr.select(active & (facing > 0), ds.dist * ds.dist / (facing * self.area), 0.0)

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return self._sent(-ds.d, active)

        def to_string(self) -> str:
            return f"Beam[{self.face}]"

    return Beam
