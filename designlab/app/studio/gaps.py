"""What the gap view shows: a frame of a measurement beside the model, before and after its effects."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from designlab.app.studio.confinement import files_below
from designlab.app.studio.messages import GapJob
from designlab.core.images import png_bytes, resize_area, to_srgb
from designlab.core.store import read_json
from designlab.core.types import Array
from designlab.measurement import MeasuredFrame, Measurement, load_measurement
from designlab.measurement.shots import press_of
from designlab.report.live_maps import residual_colours
from designlab.simulation.effects.model import AppliedEffect, SensorModel, effect, load_model
from designlab.simulation.imaging import Capture, expected, mixed
from designlab.simulation.simulator import Simulator

COLUMNS, SAMPLES, SEED = 160, 32, 0
BRIGHTEST, LARGEST = 99.5, 99.5  # percentiles that end the scales
LEAST_LIMIT = 0.005
REPORT, MODEL = "report.json", "model.toml"
SIMULATORS_KEPT = 6


class Knob(NamedTuple):
    """A parameter of an effect, to be moved within its interval."""

    key: str
    effect: str
    parameter: str
    unit: str
    value: float
    low: float
    high: float
    summary: str


class GapState(NamedTuple):
    """A diagnosis: its verdict, its effects, and the frames that can be shown."""

    verdict: str
    knobs: list[Knob]
    frames: list[str]


class GapPictures(NamedTuple):
    """A frame beside the model: PNG files by name, all pictures on one scale and all residuals on another.

    Names are measured, before, after, residual before, residual after; `rms` has the residuals' root mean
    square as a share of the frame's mean, by before and after.
    """

    frame: int
    pictures: Mapping[str, bytes]
    rms: Mapping[str, float]
    limit: float


def measurements(root: Path, named: str) -> list[Path]:
    """Folders of measurements under a folder, those whose name a diagnosis states first."""
    found = [path.parent for path in files_below(root, "measurement.toml")]

    def other(folder: Path) -> bool:
        try:
            return f'name = "{named}"' not in (folder / "measurement.toml").read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError):
            return True

    return sorted(found, key=other)


def report_of(folder: Path) -> dict[str, Any]:
    """Report of a diagnosis."""
    return read_json(folder / REPORT)


class Gaps:
    """Measurement and simulators of the frames that are looked at."""

    def __init__(self) -> None:
        self._measurement: tuple[Path, Measurement] | None = None
        self._simulated: dict[Any, Any] = {}

    def steps(self, job: GapJob) -> Iterator[GapState | GapPictures]:
        """The diagnosis, then the frame with the model as given, then with its effects too."""
        updated = load_model(job.folder / MODEL)
        named = [str(found["name"]) for found in report_of(job.folder)["effects"]]
        measurement = self._read(job.measurement)
        design = updated.effective_design()
        frames = [frame for frame in measurement.frames if _shows(measurement, frame, design)]
        if not frames:
            raise ValueError(f"{job.measurement.name}: no frame can be simulated; poses or sizes are missing")
        yield GapState(
            str(report_of(job.folder)["verdict"]), _knobs(updated, named), [frame.file for frame in frames]
        )
        number = min(max(job.frame, 0), len(frames) - 1)
        frame = frames[number]
        given = updated.model_copy(
            update={"effects": tuple(e for e in updated.effects if e.name not in named), "covariance": None}
        )
        chosen = _with_values(updated, named, job)
        real = measurement.linear(frame)
        if real.shape[-1] == 1:
            real = np.repeat(real, 3, axis=-1)
        rows = max(1, round(real.shape[0] * COLUMNS / real.shape[1]))
        shown = np.asarray(resize_area(real, rows, COLUMNS), dtype=np.float64)
        before = self._simulated_as(given, measurement, frame, shown)
        yield _pictures(number, shown, before, before)
        yield _pictures(number, shown, before, self._simulated_as(chosen, measurement, frame, shown))

    def _read(self, folder: Path) -> Measurement:
        if self._measurement is None or self._measurement[0] != folder:
            self._measurement = folder, load_measurement(folder)
        return self._measurement[1]

    def _simulated_as(
        self, model: SensorModel, measurement: Measurement, frame: MeasuredFrame, real: Array
    ) -> Array:
        """Signal of a model, the brightness of each LED group fitted to the frame."""
        design = model.effective_design()
        key = model.digest, str(measurement.folder), frame.file
        if key not in self._simulated:
            while len(self._simulated) >= SIMULATORS_KEPT:
                del self._simulated[next(iter(self._simulated))]
            view = measurement.view(frame, design)._replace(columns=real.shape[1], rows=real.shape[0])
            press, _ = press_of(measurement, frame, design)
            simulator = Simulator(model, view=view, samples=SAMPLES, seed=SEED)
            self._simulated[key] = simulator.frame(press)
        shown = self._simulated[key]
        lit = [frame.leds is None or name in frame.leds for name in design.group_names]
        parts = [
            mixed(shown.basis.astype(float), shown.weights * (np.arange(len(lit)) == group) * lit[group])
            for group in range(len(lit))
        ]
        matrix = np.stack([part.ravel() for part in parts], axis=1)
        black = design.camera.black_level
        factors, *_ = np.linalg.lstsq(matrix, (real - black).ravel(), rcond=None)
        radiance = np.asarray(matrix @ np.maximum(factors, 0.0)).reshape(real.shape)
        return np.asarray(expected(radiance, Capture(design.camera, model)))


def _shows(measurement: Measurement, frame: MeasuredFrame, design: Any) -> bool:
    if frame.kind == "background":
        return frame.lit and not frame.gel_rotation_deg
    if frame.kind != "press":
        return False
    try:
        return press_of(measurement, frame, design)[0] is not None
    except (ValueError, RuntimeError):
        return False


def _knobs(model: SensorModel, named: list[str]) -> list[Knob]:
    """Parameters of the effects that were named, with the ends of their intervals."""
    found = []
    for applied in model.effects:
        if applied.name not in named:
            continue
        known = effect(applied.name)
        units = {p.name: p for p in (*known.parameters(model.design), *known.finer_parameters(model.design))}
        for name, value in applied.values.items():
            parameter = units[name]
            low = applied.low.get(name, parameter.low)
            high = applied.high.get(name, parameter.high)
            unit = "" if parameter.unit == "1" else parameter.unit
            found.append(
                Knob(f"{applied.name}.{name}", applied.name, name, unit, value, low, high, known.summary)
            )
    return found


def _with_values(model: SensorModel, named: list[str], job: GapJob) -> SensorModel:
    """The model with the effects that are on, at the values that are chosen within their intervals."""
    kept: list[AppliedEffect] = []
    for applied in model.effects:
        if applied.name in named and applied.name in job.off:
            continue
        values = {}
        for name, value in applied.values.items():
            wanted = job.values.get(f"{applied.name}.{name}", value)
            low, high = applied.low.get(name, wanted), applied.high.get(name, wanted)
            values[name] = min(max(wanted, min(low, value)), max(high, value))
        kept.append(applied.model_copy(update={"values": values}))
    return model.model_copy(update={"effects": tuple(kept), "covariance": None})


def _pictures(number: int, real: Array, before: Array, after: Array) -> GapPictures:
    level = max(float(np.percentile(real, BRIGHTEST)), 1e-9)
    mean = max(float(real.mean()), 1e-9)
    residuals = {
        "residual before": (real - before).mean(axis=-1) / mean,
        "residual after": (real - after).mean(axis=-1) / mean,
    }
    limit = max(float(np.percentile(np.abs(residuals["residual before"]), LARGEST)), LEAST_LIMIT)
    shown = {"measured": real, "before": before, "after": after}
    pictures = {
        name: png_bytes(np.asarray(np.round(255 * to_srgb(np.clip(image / level, 0, 1))), dtype=np.uint8))
        for name, image in shown.items()
    }
    pictures |= {name: png_bytes(residual_colours(image, limit)) for name, image in residuals.items()}
    rms = {
        name: float(np.sqrt(np.mean((real - image) ** 2))) / mean
        for name, image in (("before", before), ("after", after))
    }
    return GapPictures(number, pictures, rms, limit)
