"""A capture session takes the frames of a set; only what changes from frame to frame is computed anew."""

from typing import Any

import numpy as np

from designlab.core.types import Array
from designlab.sensor.camera import View
from designlab.validation.synthetic import lens
from designlab.validation.synthetic.capture_plan import PlannedShot
from designlab.validation.synthetic.electronics import Converter, flicker, fringes, grain
from designlab.validation.synthetic.generator_sensor import Rig
from designlab.validation.synthetic.indenter import Indenter
from designlab.validation.synthetic.raycast import Caster

BRIGHT = 0.7  # share of full scale that the bright parts of the untouched gel reach
FLAT_FIELD = 0.5  # signal of the flat field in the middle of the picture
DIGITS = 3  # of the fixed pattern, so that the answer holds it as it was used


class CaptureSession:
    """A sensor on the bench.

    Parameters
    ----------
    rig : Rig
        The sensor.
    view : View
        What the frames show.
    gain : array, shape (groups,)
        Flux of every group over its nominal one.
    random : Generator
        Source of what varies by frame: brightness, phase of flicker; and of the fixed pattern.
    grain_seed : int
        Seed of the grain of single frames.
    """

    def __init__(
        self, rig: Rig, view: View, *, gain: Array, random: np.random.Generator, grain_seed: int = 0
    ) -> None:
        self._rig, self.view, self._gain, self._random = rig, view, gain, random
        self._casters = {0.0: Caster(rig, view)}
        self._cast: dict[tuple[float, Indenter | None], Array] = {}
        binned = view.width_px / view.columns * view.height_px / view.rows
        self._converter = Converter(rig.camera, rig.sensor, binned=binned)
        self._drawn: dict[str, dict[str, float]] = {}
        pattern = random.standard_normal((view.rows, view.columns, 3))
        pattern = np.round((pattern - pattern.mean()) / pattern.std(), DIGITS)
        self._pattern = pattern if rig.sensor.pattern_rms else np.zeros_like(pattern)
        self._grain_seed = grain_seed
        self._states: dict[tuple[float, Indenter | None, tuple[float, ...]], int] = {}
        self._fringes = fringes(view, amplitude=rig.sensor.moire)
        brightest = float(np.percentile(self._mixed(None, 0.0, np.ones(len(gain))), 99.5))
        self.exposure = rig.exposure or BRIGHT / brightest
        """Signal per unit of mixed radiance."""

    def take(self, shot: PlannedShot, random: np.random.Generator | None, *, correlated: bool) -> Array:
        """Values of a frame (rows, columns, 3), share of full scale; without noise where `random` is None."""
        rig, sensor, view = self._rig, self._rig.sensor, self.view
        if shot.is_flat_field:
            light = FLAT_FIELD * np.repeat(self._flat_field()[..., None], 3, axis=2)
        else:
            light = self.exposure * self._mixed(shot.indenter, shot.gel_deg, shot.lit)
        light = shot.exposure * lens.with_glare(light, share=rig.lens.glare)
        light = lens.colour_shifted(light, rig.camera, view, shift=rig.lens.colour_shift)
        drift, phase = float(self._random.standard_normal()), float(self._random.uniform())
        light = light * (1 + sensor.drift_rms * drift) * (1 + sensor.pattern_rms * self._pattern)
        if sensor.banding:
            light = light * flicker(
                view, amplitude=sensor.banding, period_rows=sensor.period_rows, phase=phase
            )
        light = light * self._fringes * self._grain(shot, light)
        light = light + sensor.smear * light.mean(axis=0, keepdims=True)
        self._drawn[shot.file] = {"drift": drift, "phase": phase}
        return self._converter.report(light, random, correlated=correlated)

    def hidden(self) -> dict[str, Any]:
        """What was drawn for each frame, as far as it shows, and the fixed pattern."""
        sensor = self._rig.sensor
        shown = [n for n, used in (("drift", sensor.drift_rms), ("phase", sensor.banding)) if used]
        found: dict[str, Any] = {
            "frames": {file: {name: drawn[name] for name in shown} for file, drawn in self._drawn.items()}
        }
        if sensor.pattern_rms:
            found["fixed_pattern_map"] = self._pattern.tolist()
        return found

    def _grain(self, shot: PlannedShot, light: Array) -> Array | float:
        """Grain that frames of one state share: gel, press and lit groups."""
        sensor = self._rig.sensor
        if not (sensor.grain_rms or sensor.sampling_rms) or not light.any():
            return 1.0
        state = (shot.gel_deg, shot.indenter, tuple(shot.lit.tolist()))
        number = self._states.setdefault(state, len(self._states))
        return grain(light, sensor, np.random.default_rng([self._grain_seed, number]))

    def _flat_field(self) -> Array:
        """What uniform light looks like through the lens."""
        camera = self._rig.camera
        return camera.vignette(self.view) * lens.falloff(camera, self._rig.lens, self.view)

    def _mixed(self, indenter: Indenter | None, gel_deg: float, lit: Array) -> Array:
        """Mixed linear radiance, shape (rows, columns, channels)."""
        rig = self._rig
        gel = gel_deg if rig.gel_is_patterned else 0.0
        if gel not in self._casters:
            self._casters[gel] = Caster(rig.turned(gel), self.view)
        if (gel, indenter) not in self._cast:
            self._cast[gel, indenter] = self._casters[gel].radiance(indenter)
        sag = 1 - rig.sensor.sag * (lit.sum() - 1) / max(len(lit) - 1, 1) if lit.any() else 1.0
        strength = rig.flux_mw * self._gain * lit * sag
        return np.asarray(np.einsum("cg,grk->rkc", rig.mixing * strength, self._cast[gel, indenter]))
