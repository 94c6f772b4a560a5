"""A comparison holds a simulation against two image files, or a sensor model against a measurement folder."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.core import metrics
from designlab.core.images import ImageError, read_image
from designlab.core.progress import silent
from designlab.core.types import Array, Progress, Single
from designlab.measurement import MeasuredFrame, Measurement, MeasurementError
from designlab.measurement.shots import press_of
from designlab.measurement.sizes import check_leds, check_size
from designlab.mechanics.contact import NotConverged
from designlab.sensor.camera import View
from designlab.sensor.design import Design, InfeasibleDesign
from designlab.simulation.contact.press import Press
from designlab.simulation.directional_light import DirectionalLight, design_of
from designlab.simulation.effects.model import SensorModel

Predict = Callable[[MeasuredFrame, View], NDArray[np.floating]]

FIGURES = ("mse", "snr_db", "smape", "ssim", "structure_corr", "structure_snr_db")


@dataclass(frozen=True, eq=False)
class Pair:
    """One measured frame, what the model predicts for it, and how alike they are (see `metrics.compare`)."""

    file: str
    simulated: Single
    real: Single
    figures: dict[str, Any]


@dataclass(frozen=True)
class Comparison:
    """All presses that could be compared, pictures of the untouched gel, and why others could not."""

    pairs: Sequence[Pair]
    skipped: dict[str, str]
    untouched: Sequence[Pair] = ()

    def to_json(self) -> dict[str, Any]:
        """Return plain data: means over the presses at the top, the figures of each under ``frames``.

        Those of the untouched gel stand under ``backgrounds``; at the top too where nothing was pressed.
        """
        each = [pair.figures for pair in self.pairs or self.untouched]
        names = list(each[0]["channels"])
        channels = {name: _means([figures["channels"][name] for figures in each]) for name in names}
        frames = [{"file": pair.file, **pair.figures} for pair in self.pairs]
        skipped = [{"file": file, "reason": reason} for file, reason in self.skipped.items()]
        gel = [{"file": pair.file, **pair.figures} for pair in self.untouched]
        found = {**_means(each), "channels": channels, "frames": frames, "skipped": skipped}
        return found | ({"backgrounds": gel} if gel else {})

    @property
    def brightness(self) -> float:
        """Mean of what was measured over that of what is simulated, which no figure of structure sees."""
        every = [*self.pairs, *self.untouched]
        means = np.array([[pair.real.mean(), pair.simulated.mean()] for pair in every], dtype=float)
        real, simulated = means.mean(axis=0)
        return float(real / simulated) if simulated > 0 else float("inf")


def compare_files(simulated: str | Path, real: str | Path) -> dict[str, Any]:
    """Compare two linear image files of the same size; `real` is the reference. See `metrics.compare`.

    Raises
    ------
    ImageError
        If a file is not an image, or the two do not fit together; names the files.
    """
    images = read_image(simulated), read_image(real)
    try:
        return metrics.compare(*images)
    except ValueError as error:
        raise ImageError(f"{simulated}, {real}: {error}") from None


def compare_model(
    model: Design | SensorModel | DirectionalLight,
    measurement: Measurement,
    *,
    samples: int = 64,
    seed: int = 0,
    backgrounds: bool = False,
    progress: Progress = silent,
) -> Comparison:
    """Predict every press of a measurement at its stated pose, and compare in linear radiance.

    Nothing is fitted: pose, lights, reflectance and exposure are those of the model and the frame's metadata.
    Where the design leaves its exposure to the camera, the exposure that `simulator.exposure` chooses on the
    simulated untouched gel holds, times the frame's relative exposure (1 where it is unknown). Directional
    light has its own factors in place of exposure.

    Parameters
    ----------
    model : Design, SensorModel or DirectionalLight
        The sensor as it is believed to be.
    measurement : Measurement
        Frames with a known response. Frames other than presses, and presses without size, depth or place,
        are skipped.
    samples : int
        Samples per pixel and LED group.
    seed : int
        Seed of the light transport.
    backgrounds : bool
        Whether pictures of the untouched gel are compared too; they are skipped otherwise.
    progress : callable, optional
        Called with the name of a frame, the number done and the number of all.

    Raises
    ------
    MeasurementError
        If no frame can be compared, or one does not fit the model's camera.
    """
    design = design_of(model)
    skipped, known, untouched = _sorted_out(measurement, design, backgrounds=backgrounds)
    if not known and not untouched:
        reasons = "; ".join(f"{file}: {reason}" for file, reason in skipped.items())
        raise MeasurementError(f"{measurement.folder}: no press can be simulated ({reasons})")
    if isinstance(model, DirectionalLight):
        predict = _shaded(model, measurement)
    else:
        predict = _rendered(SensorModel.of(model), design, measurement, samples=samples, seed=seed)
    pairs = []
    for number, frame in enumerate([*known, *untouched]):
        progress(frame.file, number, len(known) + len(untouched))
        check_size(measurement, frame, design)
        check_leds(measurement, frame, design)
        real = measurement.linear(frame)
        view = measurement.view(frame, design)
        try:
            simulated = predict(frame, view).astype(np.float32)
            figures = metrics.compare(simulated, real)
        except InfeasibleDesign:  # is no fault of the frame
            raise
        except ValueError as error:
            raise MeasurementError(f"{measurement.folder}: frame {frame.file}: {error}") from None
        pairs.append(Pair(frame.file, simulated, real, figures))
    return Comparison(pairs[: len(known)], skipped, pairs[len(known) :])


def rendered(
    model: SensorModel, press: Press | None, factors: Array, *, view: View, samples: int, seed: int
) -> Array:
    """Signal of a model under a press, (rows, columns, 3), each LED group brighter by a factor, (groups,)."""
    from designlab.simulation.imaging import Capture, expected, mixed
    from designlab.simulation.simulator import Simulator

    frame = Simulator(model, view=view, samples=samples, seed=seed).frame(press)
    capture = Capture(model.effective_design().camera, model)
    return expected(mixed(frame.basis.astype(float), frame.weights * factors), capture)


def _rendered(
    sensor: SensorModel, design: Design, measurement: Measurement, *, samples: int, seed: int
) -> Predict:
    """Signal of a frame by light transport; a picture that frames share is rendered once."""
    from designlab.simulation.imaging import Capture, expected, mixed
    from designlab.simulation.simulator import Frame, Simulator, exposure

    # Only a design that leaves its exposure to the camera needs a picture of the untouched gel.
    scale = design.fixed_exposure or exposure(
        design, Simulator(sensor, samples=samples, seed=seed).frame(None)
    )

    capture = Capture(design.camera, sensor)
    known: dict[object, Frame] = {}

    def predict(frame: MeasuredFrame, view: View) -> NDArray[np.floating]:
        factors = scale * (frame.exposure or 1.0) * np.array(_lit(frame, design), dtype=float)
        press, _ = press_of(measurement, frame, design)
        if (press, view) not in known:
            known.clear()  # pictures are large, and those that share one follow each other
            known[press, view] = Simulator(sensor, view=view, samples=samples, seed=seed).frame(press)
        shown = known[press, view]
        return expected(mixed(shown.basis.astype(float), shown.weights * factors), capture)

    return predict


def _shaded(model: DirectionalLight, measurement: Measurement) -> Predict:
    """Signal of a frame under directional light."""

    def predict(frame: MeasuredFrame, view: View) -> NDArray[np.floating]:
        lit = _lit(frame, model.design)
        press, _ = press_of(measurement, frame, model.design)
        signal = model.signal(press, view, lit=lit, exposure=frame.exposure or 1.0)
        return signal + model.design.camera.black_level

    return predict


def _lit(frame: MeasuredFrame, design: Design) -> list[bool]:
    """Which LED groups are on."""
    return [frame.leds is None or name in frame.leds for name in design.group_names]


def _sorted_out(
    measurement: Measurement, design: Design, *, backgrounds: bool
) -> tuple[dict[str, str], list[MeasuredFrame], list[MeasuredFrame]]:
    """Why frames cannot be compared, and the presses and pictures of the untouched gel that can."""
    skipped: dict[str, str] = {}
    known, untouched = [], []
    for frame in measurement.frames:
        if backgrounds and frame.kind == "background" and frame.lit and not frame.gel_rotation_deg:
            untouched.append(frame)
            continue
        if frame.kind != "press":
            skipped[frame.file] = f"a {frame.kind} frame, not a press"
            continue
        try:
            press, _ = press_of(measurement, frame, design)
        except (ValueError, NotConverged) as error:
            skipped[frame.file] = str(error).rpartition("field ")[2]
        else:
            if press and press.depth_mm is None and design.contact.model == "kernel":
                skipped[frame.file] = "states force_n alone, and contact.model = 'kernel' knows no force"
            else:
                known.append(frame)
    return skipped, known, untouched


def _means(figures: Sequence[dict[str, Any]]) -> dict[str, float]:
    return {name: float(np.mean([entry[name] for entry in figures])) for name in FIGURES}
