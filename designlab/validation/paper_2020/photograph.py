"""Pictures of a true sensor: the unbiased estimator, a fine mesh, the camera's noise."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from designlab.measurement import MeasuredFrame
from designlab.measurement.light_probe.ball import LightProbe
from designlab.measurement.light_probe.picture import light_probe
from designlab.sensor.camera import View
from designlab.sensor.design import Design
from designlab.simulation.contact.press import Press
from designlab.simulation.effects.model import SensorModel
from designlab.simulation.imaging import Capture, mixed, reported
from designlab.simulation.simulator import Simulator
from geometries.probes import parse

Pixels = NDArray[np.float32]
PITCH_MM = 0.0125  # of the membrane; a simulator on its own takes 0.025 to 0.05 mm
MIRRORED = 0.6  # share of full scale for the brightest of a light probe, whose exposure is set by it


def photograph(
    true: SensorModel,
    frames: Sequence[MeasuredFrame],
    *,
    samples: int,
    seed: int,
    binned: int = 1,
    averaged: int = 1,
) -> tuple[list[MeasuredFrame], dict[str, Pixels]]:
    """Take pictures at the true poses of the frames.

    Parameters
    ----------
    true : SensorModel
        The sensor, with a stated exposure.
    frames : sequence of MeasuredFrame
        What to photograph.
    samples : int
        Samples per pixel and LED group.
    seed : int
        Seed of light transport and noise.
    binned : int
        Side of the squares of sensor pixels that are averaged.
    averaged : int
        Exposures whose mean a picture is.

    Returns
    -------
    frames, pictures
        Frames with the exposure they were taken at, and the image of each file.
    """
    design = true.effective_design()
    taken, pictures = [], {}
    for number, frame in enumerate(frames):
        radiance = _radiance(true, frame, samples, 1000 * seed + number, binned)
        if frame.kind == "light_probe":
            brightest = float(np.percentile(radiance, 99.9)) * (design.fixed_exposure or 1.0)
            frame = frame.model_copy(update={"exposure": round(MIRRORED / brightest, 4)})
        scale = (design.fixed_exposure or 1.0) * (frame.exposure or 1.0)
        capture = Capture(design.camera, true, exposure=scale, binned=float(binned**2))
        exposures = [
            reported(radiance, replace(capture, seed=averaged * (1000 * seed + number) + k))
            for k in range(averaged)
        ]
        pictures[frame.file] = np.asarray(np.mean(exposures, axis=0), dtype=np.float32)
        taken.append(frame)
    return taken, pictures


def view_of(design: Design, frame: MeasuredFrame, binned: int) -> View:
    """Part of the camera's sensor that a frame shows."""
    x, y, width, height = frame.crop_px or (0, 0, design.camera.width_px, design.camera.height_px)
    columns, rows = width // binned, height // binned
    return View(float(x), float(y), float(columns * binned), float(rows * binned), columns, rows)


def _radiance(
    true: SensorModel, frame: MeasuredFrame, samples: int, seed: int, binned: int
) -> NDArray[np.floating]:
    design = true.effective_design()
    view = view_of(design, frame, binned)
    if not frame.lit:
        return np.zeros((view.rows, view.columns, 3))
    if frame.kind == "light_probe":
        probe = LightProbe(
            diameter_mm=float((frame.probe or "").partition(":")[2]),
            centre_mm=frame.centre_mm or (0.0, 0.0),
            lowest_mm=frame.lowest_mm or 0.0,
        )
        return light_probe(true, probe, view=view, samples=samples, seed=seed).mixed
    press = None
    if frame.probe is not None:
        assert frame.depth_mm is not None
        assert frame.centre_mm is not None
        press = Press(
            probe=parse(frame.probe),
            depth_mm=frame.depth_mm,
            centre_mm=frame.centre_mm,
            yaw_deg=frame.yaw_deg or 0.0,
        )
    simulator = Simulator(
        true, view=view, samples=samples, seed=seed, estimator="reference", pitch_mm=PITCH_MM
    )
    picture = simulator.frame(press)
    lit = [frame.leds is None or name in frame.leds for name in design.group_names]
    return mixed(picture.basis, picture.weights * lit)
