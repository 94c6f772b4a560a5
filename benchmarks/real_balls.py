"""Reconstruction of real presses, calibrated on real balls.

    python benchmarks/real_balls.py --measured FOLDER [--quick]

FOLDER is a measurement folder: a background, ball presses with `centre_px` and `contact_radius_px` (they
calibrate), and presses of known depth (they judge; nothing is chosen on them). Each method is judged first
on balls left out of its calibration in turn, then on the presses of known depth:

- spheres: height of the cap above the undeformed gel, and normals, both within 0.85 of the contact radius
  sqrt(d (2 R - d)) of the stated depth d;
- prism: height of its flat face, 71 x 107 px, against the stated depth.

Height errors are given as labelled, and after one offset of the zero of depth, common to all presses.

The prism stands inclined. Its slopes in the middle of its face, by colour alone, say how far its first edge
is ahead of its middle. If depth counts from the touch of that edge, its face is lower than labelled by as
much at the first press, and as much at all others. What is expected so stands beside what is found.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rival_methods import LookupTable, Perceptron

from designlab.core.metrics import normal_error_deg
from designlab.measurement import Measurement, load_measurement
from designlab.reconstruction import normals
from designlab.reconstruction.ball_samples import known_gel
from designlab.reconstruction.ball_surface import BallSurface
from designlab.reconstruction.balls import BallPress, ball_gradients
from designlab.reconstruction.centres import refine_centres
from designlab.reconstruction.lab import LabCalibration, calibrate
from designlab.reconstruction.left_out import LeftOut, left_out_errors
from designlab.reconstruction.methods import Kernel, Method, Polynomial
from designlab.reconstruction.setup import Setup

Array = NDArray[np.float64]
JUDGED = 0.85
FACE_PX = (71, 107)
MIDDLE = 0.6  # share of the face beyond which its edges show
DEGREES = ((2,), (2, 1, 1), (2, 2, 2, 1))
COARSE = Kernel(ridge=3e-3, colour_scale=1.5, features=300)


class Press(NamedTuple):
    """Errors of one press of known depth."""

    name: str
    height_error_mm: Array
    normal_deg: float | None


class Figures(NamedTuple):
    """Means over the presses of known depth."""

    rmse_mm: float
    offset_mm: float
    rmse_after_mm: float
    normal_deg: float


def balls_of(measurement: Measurement) -> tuple[list[BallPress], Array, Setup]:
    """Ball presses, background and scale of a measurement folder."""
    if measurement.mm_per_px is None:
        raise ValueError("mm_per_px: must be stated")
    balls, radius_mm = [], 0.0
    for frame in measurement.frames:
        if frame.centre_px is not None and frame.contact_radius_px is not None and frame.probe:
            radius_mm = float(frame.probe.split(":")[1]) / 2
            balls.append(
                BallPress(
                    np.asarray(measurement.image(frame), float), frame.centre_px, frame.contact_radius_px
                )
            )
    background = next(f for f in measurement.frames if f.kind == "background")
    return balls, np.asarray(measurement.image(background), float), Setup(radius_mm, measurement.mm_per_px)


def judge(calibration: LabCalibration, measurement: Measurement, *, robust: bool = False) -> list[Press]:
    """Errors on the presses of known depth."""
    setup, presses = calibration.setup, []
    for frame in measurement.frames:
        if frame.depth_mm is None or frame.centre_px is None or frame.probe is None:
            continue
        shape = calibration.reconstruct(measurement.image(frame), robust=robust)
        rows, columns = np.indices(shape.height_mm.shape)
        if frame.probe.startswith("sphere"):
            radius_mm = float(frame.probe.split(":")[1]) / 2
            p, q, r_px = ball_gradients(
                shape.height_mm.shape, frame.centre_px, ball_radius_mm=radius_mm, mm_per_px=setup.mm_per_px
            )
            inside = r_px * setup.mm_per_px < JUDGED * np.sqrt(
                frame.depth_mm * (2 * radius_mm - frame.depth_mm)
            )
            down = np.sqrt(np.maximum(radius_mm**2 - (r_px * setup.mm_per_px) ** 2, 0))
            truth = down - (radius_mm - frame.depth_mm)
            angle = float(normal_error_deg(shape.normals(), normals(p, q))[inside].mean())
        else:
            inside = (np.abs(columns - frame.centre_px[0]) <= FACE_PX[0] / 2) & (
                np.abs(rows - frame.centre_px[1]) <= FACE_PX[1] / 2
            )
            truth, angle = np.full(shape.height_mm.shape, frame.depth_mm), None
        presses.append(Press(frame.file, (shape.height_mm - truth)[inside], angle))
    return presses


def inclined_prism(
    calibration: LabCalibration, measurement: Measurement
) -> list[tuple[str, float, Array, float]]:
    """Of each press of a prism: file, depth, slopes in the middle of its face, its mean height (mm)."""
    found = []
    for frame in measurement.frames:
        if frame.depth_mm is None or frame.centre_px is None or frame.probe is None:
            continue
        if frame.probe.startswith("sphere"):
            continue
        image = measurement.image(frame)
        rows, columns = np.indices(image.shape[:2])
        across, down = np.abs(columns - frame.centre_px[0]), np.abs(rows - frame.centre_px[1])
        face, middle = (
            (across <= share * FACE_PX[0] / 2) & (down <= share * FACE_PX[1] / 2) for share in (1.0, MIDDLE)
        )
        slopes = np.array([np.median(part[middle]) for part in calibration.gradients(image)])
        height_mm = calibration.reconstruct(image).height_mm
        found.append((frame.file, frame.depth_mm, slopes, float(height_mm[face].mean())))
    return sorted(found, key=lambda press: press[1])


def depth_errors_by_contact(
    balls: Sequence[BallPress], background: Array, setup: Setup, measurement: Measurement
) -> dict[str, float]:
    """Depth of each sphere by its contact radius, less the stated depth (mm): no slope is integrated."""
    assert setup.thickness_mm is not None
    assert setup.label_bias is not None
    surface = BallSurface(setup.ball_radius_mm, setup.thickness_mm, setup.poisson)
    radii = np.linspace(0.05, 0.85, 400) * setup.ball_radius_mm
    depths = [surface.depth_mm(radius) for radius in radii]
    stated, spheres = {}, []
    for frame in measurement.frames:
        if frame.depth_mm is None or frame.centre_px is None or not (frame.probe or "").startswith("sphere"):
            continue
        stated[frame.file] = frame.depth_mm
        circle = float(np.interp(frame.depth_mm, depths, radii)) * (1 + setup.label_bias)
        image = np.asarray(measurement.image(frame), float)
        spheres.append(BallPress(image, frame.centre_px, circle / setup.mm_per_px))
    known = known_gel([*balls, *spheres], background, setup._replace(label_bias=None))
    assert known.fit is not None
    found = known.fit.contact_radii_px[len(balls) :] * setup.mm_per_px
    return {
        file: surface.depth_mm(float(radius)) - depth
        for (file, depth), radius in zip(stated.items(), found, strict=True)
    }


def summary(presses: Sequence[Press]) -> Figures:
    """Mean figures, and the common offset of depth that leaves the least mean error."""

    def rmse(offset: float) -> float:
        return float(np.mean([np.sqrt(((p.height_error_mm - offset) ** 2).mean()) for p in presses]))

    offset = float(min(np.arange(-0.2, 0.2, 0.0005), key=rmse))
    angles = [p.normal_deg for p in presses if p.normal_deg is not None]
    return Figures(rmse(0.0), offset, rmse(offset), float(np.mean(angles)))


def line(method: Method, left: LeftOut, found: Figures) -> str:
    """One line of the table."""
    return (
        f"{method.name:44s} {left.contact_deg:8.2f} {left.circle_deg:7.2f} {1000 * left.height_mm:7.1f}"
        f" {1000 * left.combined:8.2f}  |"
        f"{1000 * found.rmse_mm:7.1f} {1000 * found.offset_mm:+7.1f} {1000 * found.rmse_after_mm:7.1f}"
        f" {found.normal_deg:8.2f}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--measured", required=True, type=Path, help="measurement folder")
    parser.add_argument("--quick", action="store_true", help="without the perceptron")
    options = parser.parse_args()
    measurement = load_measurement(options.measured)
    balls, background, setup = balls_of(measurement)
    refined = refine_centres(balls, background, setup)
    # a finer map moves them a little further
    refined = refine_centres(refined, background, setup, method=COARSE, rounds=2)
    refined, setup, gel = known_gel(refined, background, setup)
    assert gel is not None
    assert setup.thickness_mm is not None
    for name, fitted in (("thickness (mm)", gel.thickness_mm), ("bias of the circles", gel.label_bias)):
        print(f"{name}: {fitted.value:.3g}, 95 % from {fitted.low:.3g} to {fitted.high:.3g}")
    surface = BallSurface(setup.ball_radius_mm, setup.thickness_mm, setup.poisson)
    shares = [surface.contact_share(setup.contact_radius_px(b) * setup.mm_per_px) for b in refined]
    print(f"contact over geometric circle: {min(shares):.3f} to {max(shares):.3f}")
    for name, beside in depth_errors_by_contact(refined, background, setup, measurement).items():
        print(f"  {name}: its contact says a depth {1000 * beside:+.0f} um beside the stated")
    shift = np.subtract([b.centre_px for b in refined], [b.centre_px for b in balls])
    rms, mean = np.sqrt((shift**2).mean(axis=0)), shift.mean(axis=0)
    print(f"{len(balls)} balls; centres moved by {rms.round(2)} px RMS, mean {mean.round(2)} px")
    methods: list[Method] = [Polynomial(position_degrees=degrees) for degrees in DEGREES]
    methods += [LookupTable(), Kernel(), Kernel(ridge=1e-3)]
    # twice the features at twice the ridge: the same kernel, with less of the noise of its random features
    methods += [Kernel(ridge=6e-3, features=1200)]
    if not options.quick:
        methods.append(Perceptron())
    print(f"{'':44s} balls left out: deg, deg, um, deg um | presses: RMSE, offset, after (um), deg")
    print(f"{'':44s}  contact  circle  height  product  |")
    chosen, least = methods[0], np.inf
    for method in methods:
        left = left_out_errors(refined, background, setup, method=method)
        calibration = calibrate(refined, background, setup, method=method)
        print(line(method, left, summary(judge(calibration, measurement))), flush=True)
        if left.combined < least:
            chosen, least = method, left.combined
    print(f"chosen on the balls: {chosen.name}")
    calibration = calibrate(refined, background, setup, method=chosen)
    for robust in (False, True):
        presses = judge(calibration, measurement, robust=robust)
        found = summary(presses)
        print(
            f"{'robust' if robust else 'least squares'}: height RMSE {found.rmse_mm:.4f} mm as labelled, "
            f"{found.rmse_after_mm:.4f} mm after a common offset of {found.offset_mm:+.4f} mm, "
            f"normals {found.normal_deg:.2f} deg"
        )
        for press in presses:
            error = 1000 * press.height_error_mm
            angle = "" if press.normal_deg is None else f", normals {press.normal_deg:.2f} deg"
            rmse = np.sqrt((error**2).mean())
            print(f"  {press.name:24s} RMSE {rmse:5.1f} um, mean {error.mean():+6.1f} um{angle}")
    prism = inclined_prism(calibration, measurement)
    ahead_mm = float(np.abs(prism[0][2]) @ FACE_PX) / 2 * calibration.setup.mm_per_px if prism else 0.0
    for file, depth_mm, slopes, height_mm in prism:
        across, up = np.degrees(np.arctan(slopes))
        print(
            f"  {file:24s} inclined by {across:+.2f}, {up:+.2f} deg; mean height {height_mm:.3f} mm, "
            f"expected {depth_mm - ahead_mm:.3f} mm if its first edge touched at 0"
        )


if __name__ == "__main__":
    main()
