"""The data sets are the paper's two sets of presses, and the frames that a calibration needs."""

from collections.abc import Sequence

import numpy as np

from designlab.measurement import MeasuredFrame, PoseSigma
from designlab.measurement.frames import Split
from designlab.measurement.shots import ROUND
from designlab.sensor.design import Design
from designlab.simulation.optics.viewing_rays import rays
from designlab.validation.paper_2020.sizes import CROP_PX
from geometries.probes import parse

PROBE_CROP_PX = 320
SHAPES, DEPTHS_MM = ("sphere:4", "triangle:4", "star:5"), (0.5, 1.0)
SIGMA = PoseSigma(depth_mm=0.03, centre_mm=0.1, yaw_deg=1.0)  # how well a hand-guided stage places a probe
SPREAD_MM = (3.0, 2.2)  # of the places from the centre, in x and y
INNER = 0.4  # of that, where presses lie that are fitted to
BALL = "sphere:4"  # of the light probe


def dataset_1(design: Design, *, seed: int, shapes: int = 3, places: int = 4) -> list[MeasuredFrame]:
    """Up to three shapes at some places, each at two depths."""
    random = np.random.default_rng([seed, 1])
    frames = []
    for probe in SHAPES[:shapes]:
        kind = probe.partition(":")[0]
        for place in range(places):
            centre, yaw_deg = _quarter(random, place), float(random.uniform(-60.0, 60.0))
            for depth_mm in DEPTHS_MM:
                name = f"{kind}-{place + 1}-{depth_mm:g}mm.exr"
                frames.append(_press(design, name, probe, depth_mm, centre, yaw_deg, "final"))
    return frames


def dataset_2(design: Design, *, seed: int, balls: int = 10, triangles: int = 6) -> list[MeasuredFrame]:
    """A ball and a triangle at places and depths of their own; the first of each is to fit to."""
    random = np.random.default_rng([seed, 2])
    frames = []
    # The two that are fitted to lie further in, where no other is, in opposite quarters.
    for probe, count, first in ((SHAPES[0], balls, 0), (SHAPES[1], triangles, 3)):
        for number in range(count):
            centre = _quarter(random, first + number, INNER if number == 0 else 1.0)
            yaw_deg = float(random.uniform(-60.0, 60.0))
            depth_mm = float(random.uniform(*DEPTHS_MM))
            name = f"{probe.partition(':')[0]}-at-{number + 1}.exr"
            split: Split = "train" if number == 0 else "final"
            frames.append(_press(design, name, probe, depth_mm, centre, yaw_deg, split))
    return frames


def around(design: Design, *, light_probe: bool) -> list[MeasuredFrame]:
    """Frames without a press: two with the LEDs off, two of the untouched gel, and the light probe."""
    crop = crop_around(design, (0.0, 0.0), CROP_PX)
    frames = [
        MeasuredFrame(file=f"dark-{n}.exr", kind="dark", leds=(), crop_px=crop, repeat=n) for n in range(2)
    ]
    frames += [
        MeasuredFrame(file=f"background-{n}.exr", kind="background", crop_px=crop, repeat=n) for n in range(2)
    ]
    if light_probe:
        at = crop_around(design, (0.0, 0.0), PROBE_CROP_PX)
        sigma = PoseSigma(centre_mm=SIGMA.centre_mm)
        frames.append(
            MeasuredFrame(
                file="light-probe.exr",
                kind="light_probe",
                probe=BALL,
                centre_mm=(0.0, 0.0),
                lowest_mm=0.0,
                sigma=sigma,
                crop_px=at,
            )
        )
    return frames


def stated(frames: Sequence[MeasuredFrame], *, seed: int) -> list[MeasuredFrame]:
    """What a lab writes down: poses that are off by their stated doubt."""
    random = np.random.default_rng([seed, 3])
    found = []
    for frame in frames:
        if frame.centre_mm is None or frame.sigma is None:
            found.append(frame)
            continue
        x, y, depth, yaw = random.standard_normal(4)
        centre_sigma = frame.sigma.centre_mm or 0.0
        off = {"centre_mm": (frame.centre_mm[0] + centre_sigma * x, frame.centre_mm[1] + centre_sigma * y)}
        if frame.depth_mm is not None:
            off["depth_mm"] = frame.depth_mm + (frame.sigma.depth_mm or 0.0) * depth
        if frame.yaw_deg is not None:
            off["yaw_deg"] = frame.yaw_deg + (frame.sigma.yaw_deg or 0.0) * yaw
        found.append(frame.model_copy(update=off))
    return found


def crop_around(design: Design, centre_mm: tuple[float, float], side_px: int) -> tuple[int, int, int, int]:
    """Square of the camera's sensor about a point of the plane z = 0, moved onto the sensor."""
    full = design.camera.full_view()
    grid = full._replace(columns=full.columns // 16, rows=full.rows // 16)
    looks = rays(design, grid)
    nearest = np.argmin((looks.x_mm - centre_mm[0]) ** 2 + (looks.y_mm - centre_mm[1]) ** 2)
    column, row = (float(places.flat[nearest]) for places in grid.centres())
    x = int(np.clip(round(column - side_px / 2), 0, design.camera.width_px - side_px))
    y = int(np.clip(round(row - side_px / 2), 0, design.camera.height_px - side_px))
    return x, y, side_px, side_px


def _quarter(random: np.random.Generator, number: int, share: float = 1.0) -> tuple[float, float]:
    """Point in one of the four quarters of the gel's middle, in turn; nearer to its centre by a share."""
    x, y = (-1, 1)[number % 2], (-1, 1)[number // 2 % 2]
    dx, dy = random.uniform(-0.6, 0.6, size=2)
    return float(share * (x * SPREAD_MM[0] + dx)), float(share * (y * SPREAD_MM[1] + dy))


def _press(
    design: Design,
    file: str,
    probe: str,
    depth_mm: float,
    centre_mm: tuple[float, float],
    yaw_deg: float,
    split: Split,
) -> MeasuredFrame:
    return MeasuredFrame(
        file=file,
        kind="press",
        probe=probe,
        depth_mm=depth_mm,
        centre_mm=centre_mm,
        yaw_deg=0.0 if parse(probe).kind in ROUND else yaw_deg,
        sigma=SIGMA,
        crop_px=crop_around(design, centre_mm, CROP_PX),
        split=split,
    )
