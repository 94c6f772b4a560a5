"""Pictures of a sensor with an effect: by the simulator, combined from a bank, and by the generator.

All are signals of one untouched frame and one press, without noise, shape (2, rows, columns, 3).
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from designlab.inference.diagnosis.emulator.forward import Forward
from designlab.inference.diagnosis.emulator.rendering import fill
from designlab.inference.diagnosis.emulator.state import State
from designlab.measurement.shots import Shot
from designlab.sensor.design import preset
from designlab.simulation.contact.press import Press
from designlab.simulation.effects import AppliedEffect, SensorModel, effect
from designlab.simulation.render_cache import Renders
from designlab.simulation.simulator import Simulator, exposure
from designlab.validation.synthetic import capture_plan, effects, generate
from designlab.validation.synthetic.capture import CaptureSession
from designlab.validation.synthetic.generator_sensor import Rig
from geometries.probes import parse

PRESS = {"probe": "sphere:4", "depth_mm": 0.6, "centre_mm": [1.0, 0.5], "yaw_deg": 0.0}
FILES = ("background-0.exr", "press-01.exr")
GENERATOR_SEED = 5


def values_at(name, design, strength, *, seed=None):
    """Values with every parameter so many prior standard deviations off; signs by chance with a seed."""
    random = np.random.default_rng([seed or 0, *name.encode()])
    found = {}
    for p in effect(name).parameters(design):
        sign = 1.0 if seed is None else random.choice([-1.0, 1.0])
        if p.one_sided:
            sign = 1.0
        found[p.name] = float(np.clip(p.null + sign * strength * p.sd, p.low, p.high))
    return found


class Nothing:
    """Source of errors that are all zero."""

    def standard_normal(self, count):
        return np.zeros(count)


@dataclass
class Sensor:
    """One design in one view, with what its pictures share."""

    name: str
    columns: int
    samples: int = 16
    seed: int = 3
    changes: dict = field(default_factory=dict)

    @cached_property
    def design(self):
        """The preset with an exposure that leaves room above."""
        plain = preset(self.name).replace({"camera.exposure": None, **self.changes})
        frame = Simulator(plain, view=self.view, samples=self.samples, seed=self.seed).frame(None)
        return plain.replace({"camera.exposure": exposure(plain, frame)})

    @cached_property
    def view(self):
        """Whole pixels of the camera's sensor, as the generator takes them."""
        return generate.cropped_view(preset(self.name), self.columns)[1]

    @property
    def presses(self):
        """The untouched gel and one press."""
        one = Press(**{**PRESS, "probe": parse(PRESS["probe"]), "centre_mm": tuple(PRESS["centre_mm"])})
        return None, one

    def model(self, name, values):
        """The sensor with an effect; without for no values."""
        applied = (AppliedEffect(name=name, values=values),) if values else ()
        return SensorModel(design=self.design, effects=applied)

    def simulated(self, name="", values=None, *, own=None):
        """Signals by the simulator; `own` is what each picture drew, as the generator tells it."""
        return self._untouched_by_effects if not name else self._simulated(name, values, own)

    @cached_property
    def _untouched_by_effects(self):
        return self._simulated("", None, None)

    @cached_property
    def _generated_without(self):
        return self._generated("", None)

    def _simulated(self, name, values, own):
        model = self.model(name, values)
        simulator = Simulator(model, view=self.view, samples=self.samples, seed=self.seed)
        found = []
        for number, press in enumerate(self.presses):
            frame = simulator.frame(press)
            light = frame.basis.astype(float)
            if own is not None:
                sight = replace(simulator.sight(frame.surface), own=own[number])
                light = model.on_light(light, sight)
            mixed = np.einsum("cg,grk->rkc", frame.weights, light) * self.design.camera.exposure
            if name == "fixed_pattern":
                mixed = mixed * (1 + values["rms"] * own[number]["map"])
            found.append(model.on_signal(mixed + self.design.camera.black_level))
        return np.array(found)

    @cached_property
    def shots(self):
        """What a measurement of the same pictures would be, without its counts."""
        rows, columns = self.view.rows, self.view.columns
        none = np.zeros((rows, columns, 3))
        return tuple(
            Shot(
                files=("made.exr",), use="train", press=press, pose_sigma=np.zeros(4),
                lit=np.ones(len(self.design.group_names)), view=self.view, signal=none, variance=none,
                valid=none == 0, dark_sigma=np.zeros(3),
            )
            for press in self.presses
        )  # fmt: skip

    def combined(self, name, values, *, folder):
        """Signals combined from pictures at other values."""
        if not hasattr(self, "_renders"):
            self._renders = Renders(folder, samples=self.samples, seed=self.seed)
        bank = fill(self._renders, self.model("", None), self.shots, [name] if name else [])
        gains = np.full(len(self.design.group_names), self.design.camera.exposure)
        state = State(gains, values={name: values} if name else {})
        return np.array([Forward(bank).predict(state, number) for number in range(2)])

    def generated(self, name="", values=None):
        """Signals by the generator, and what each picture drew."""
        return self._generated_without if not name else self._generated(name, values)

    def _generated(self, name, values):
        rig, _ = effects.apply(Rig.of(self.design), {name: values} if name else {})
        press = capture_plan.true_press(rig, PRESS, Nothing())
        taken = capture_plan.shots(rig, "small", [PRESS], [press], flat_field=False)
        random = np.random.default_rng(GENERATOR_SEED)
        session = CaptureSession(rig, self.view, gain=np.ones(len(rig.flux_mw)), random=random)
        by_file = {shot.file: shot for shot in taken}
        signals = [session.take(by_file[file], None, correlated=False) for file in FILES]
        hidden = session.hidden()
        own = []
        for file in FILES:
            drawn = hidden["frames"][file]
            mine = {"exposure_drift": drawn.get("drift"), "banding": drawn.get("phase")}
            mine = {key: np.array(value) for key, value in mine.items() if value is not None}
            if "fixed_pattern_map" in hidden:
                mine["map"] = np.array(hidden["fixed_pattern_map"])
            own.append(mine)
        return np.array(signals), own


def rms(values):
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
