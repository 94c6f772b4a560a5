"""Both modes of `designlab reconstruct`: their errors and times, in one table.

    python benchmarks/video_mode.py [--measured FOLDER] [--frames 1000]

- Made pictures, 640 x 480, 8 bits with grain: calibrated on nine balls, judged on eight presses of balls, of
  two balls at once among them, whose surface is known exactly.
- With `--measured`, real balls: each is left out of the calibration by which it is reconstructed; normals
  and height in the contact, of which the mean is free, since the depth of a ball is not known.
- The same presses with printed dots, which cover a twelfth of the picture and move with the skin.
- Contact: share of the true contact and of that found which both have in common.
- Times of a picture of 640 x 480, from the picture to height, normals, contact and force: median wall clock,
  and processor time. What else runs on the machine lengthens the first.
- Memory that the process holds after some frames in mode video, and after all.
"""

import argparse
import resource
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from designlab.core.metrics import normal_error_deg
from designlab.inference.calibration.ball_set import BallSet, load_balls
from designlab.inference.calibration.balls import COARSE, calibrate_balls, kept_of
from designlab.reconstruction import normals
from designlab.reconstruction.ball_samples import known_gel
from designlab.reconstruction.ball_surface import BallSurface
from designlab.reconstruction.ball_view import ball_view
from designlab.reconstruction.balls import BallPress
from designlab.reconstruction.calibration_file import Kept
from designlab.reconstruction.centres import refine_centres
from designlab.reconstruction.contact_pressure import Mode
from designlab.reconstruction.lab import calibrations_without_each
from designlab.reconstruction.markers import Markers, without
from designlab.reconstruction.reconstructor import Reconstructor
from designlab.reconstruction.setup import Setup

Array = NDArray[np.float64]
MODES: tuple[Mode, ...] = ("accurate", "video")
CORES = 2
SHAPE, MM_PER_PX = (480, 640), 0.03
RADIUS_MM, THICKNESS_MM, POISSON = 3.0, 2.5, 0.49
FULL, GRAIN = 1.4, 0.01
DOTS_PX, DOT_RADIUS_PX, DOTS_MOVE_PX = 40, 6.5, 3.0
PLACES = [(column, row) for column in (110, 320, 530) for row in (100, 240, 380)]
PRESSES = [
    [((250, 200), 42)],
    [((420, 300), 47)],
    [((180, 330), 44)],
    [((330, 150), 30)],
    [((480, 220), 52)],
    [((300, 260), 36)],
    [((200, 240), 40), ((430, 250), 40)],
    [((320, 140), 34), ((300, 350), 46)],
]


class Errors(NamedTuple):
    """Errors of one picture."""

    normal_deg: float
    height_um: float
    contact: float


class Made:
    """Pictures of presses by Lambert's law for three lights, with printed dots or without."""

    def __init__(self, *, dots: bool = False) -> None:
        self.dots = dots
        self.rows, self.columns = np.indices(SHAPE)
        azimuth, slant = np.radians([90.0, 210.0, 330.0]), np.radians(50)
        across, down = self.columns / SHAPE[1], self.rows / SHAPE[0]
        self.level = np.stack(
            [1 + 0.3 * np.cos(a) * across + 0.3 * np.sin(a) * down for a in azimuth], axis=-1
        )
        self.toward = np.stack(
            [np.sin(slant) * np.cos(azimuth), np.sin(slant) * np.sin(azimuth), np.full(3, np.cos(slant))]
        )
        self.surface = BallSurface(RADIUS_MM, THICKNESS_MM, POISSON)
        self.random = np.random.default_rng(0)

    def slopes(self, contacts: Sequence[tuple[tuple[int, int], float]]) -> tuple[Array, Array]:
        """Slopes of the gel under balls far enough from each other to add up."""
        p, q = np.zeros(SHAPE), np.zeros(SHAPE)
        for (column, row), radius_px in contacts:
            x, y = (self.columns - column) * MM_PER_PX, (row - self.rows) * MM_PER_PX
            more_p, more_q = self.surface.gradient(x, y, radius_px * MM_PER_PX)
            p, q = p + more_p, q + more_q
        return p, q

    def picture(self, p: Array, q: Array, grain: float = GRAIN) -> Array:
        """What the camera sees."""
        light = self.level * np.maximum(normals(p, q) @ self.toward, 0)
        if self.dots:
            # the skin moves against the slope, as that of a gel which is pushed aside does
            across, down = self.columns + DOTS_MOVE_PX * p, self.rows - DOTS_MOVE_PX * q
            r = np.hypot(*((at + DOTS_PX / 2) % DOTS_PX - DOTS_PX / 2 for at in (across, down)))
            light *= (1 - 0.9 * np.clip(DOT_RADIUS_PX + 0.5 - r, 0, 1))[..., None]
        light += grain * self.random.normal(size=light.shape)
        return np.asarray(np.round(255 * np.clip(light / FULL, 0, 1)) / 255)

    def kept(self) -> Kept:
        """A calibration on nine balls."""
        flat = np.zeros(SHAPE)
        background = self.picture(flat, flat, grain=0.2 * GRAIN)
        balls = [
            BallPress(self.picture(*self.slopes([(place, radius)])), place, radius)
            for place, radius in zip(
                PLACES, [40.0, 45.0, 50.0, 45.0, 50.0, 40.0, 50.0, 40.0, 45.0], strict=True
            )
        ]
        names = tuple(map(str, PLACES))
        markers = Markers.found_in(background) if self.dots else None
        if markers is not None:
            background = without(background, markers.covered)
            hidden = [markers.followed(ball.image).covered for ball in balls]
            balls = [
                replace(ball, image=without(ball.image, covered), covered=covered)
                for ball, covered in zip(balls, hidden, strict=True)
            ]
        given = BallSet(names, balls, background, RADIUS_MM, MM_PER_PX, markers=markers)
        return calibrate_balls(given, thickness_mm=THICKNESS_MM, poisson=POISSON).kept

    def judged(self, reconstructor: Reconstructor) -> Iterator[Errors]:
        """Errors on each press."""
        for contacts in PRESSES:
            p, q = self.slopes(contacts)
            shape = reconstructor(self.picture(p, q))
            truth, height = np.zeros(SHAPE, dtype=bool), np.zeros(SHAPE)
            for (column, row), radius_px in contacts:
                away_px = np.hypot(self.columns - column, self.rows - row)
                truth |= away_px < radius_px
                height += self.surface.height_of(radius_px * MM_PER_PX)(away_px * MM_PER_PX)
            angle = normal_error_deg(shape.normals.astype(float), normals(p, q))
            off = 1000 * (shape.height_mm - height)
            yield Errors(
                float(angle[truth].mean()),
                float(np.sqrt((off[truth] ** 2).mean())),
                common(shape.contact, truth),
            )


def common(found: NDArray[np.bool_], truth: NDArray[np.bool_]) -> float:
    """Pixels that both hold, over those that either does."""
    return float((found & truth).sum() / (found | truth).sum())


def real(folder: Path) -> dict[Mode, list[Errors]]:
    """Errors of both modes on real balls left out."""
    balls = load_balls(folder)
    setup = Setup(balls.radius_mm, balls.mm_per_px)
    refined = refine_centres(balls.balls, balls.background, setup)
    refined = refine_centres(refined, balls.background, setup, method=COARSE, rounds=2)
    known, setup, _ = known_gel(refined, balls.background, setup)
    found: dict[Mode, list[Errors]] = {mode: [] for mode in MODES}
    for number, calibration in enumerate(calibrations_without_each(known, balls.background, setup)):
        ball = known[number]
        kept = kept_of(calibration, [*known[:number], *known[number + 1 :]], {})
        view = ball_view(ball, setup)
        (p, q), r_px = view.ball_slopes, view.r_px
        contact = r_px < setup.contact_radius_px(ball)
        cap = np.sqrt(np.maximum(setup.ball_radius_mm**2 - (r_px * setup.mm_per_px) ** 2, 0.0))
        for mode in MODES:
            shape = Reconstructor(kept, mode)(ball.image)
            angle = normal_error_deg(shape.normals.astype(float), normals(p, q))
            height = 1000 * (shape.height_mm - cap)[contact]
            found[mode].append(
                Errors(float(angle[contact].mean()), float(height.std()), common(shape.contact, contact))
            )
    return found


def timed(reconstructor: Reconstructor, image: Array, frames: int) -> tuple[float, float]:
    """Median milliseconds of a frame by the clock, and of processor time."""
    times = []
    for _ in range(frames):
        clock, processor = time.perf_counter(), time.process_time()
        reconstructor(image)
        times.append((time.perf_counter() - clock, time.process_time() - processor))
    wall, used = 1000 * np.median(times, axis=0)
    return float(wall), float(used)


def row(name: str, by_mode: dict[Mode, list[Errors]]) -> None:
    """Print errors of both modes, and those of video over those of accurate."""
    means = {mode: np.mean(errors, axis=0) for mode, errors in by_mode.items()}
    for mode in MODES:
        degrees, height, contact = means[mode]
        print(f"{name:28} {mode:9} {degrees:6.2f} deg {height:6.1f} um   contact {contact:.2f}")
    more = means["video"][:2] / means["accurate"][:2] - 1
    print(f"{'':28} {'video':9} {more[0]:+6.0%}     {more[1]:+6.0%}", flush=True)


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--measured", type=Path, help="measurement folder of real balls")
    parser.add_argument("--frames", type=int, default=1000, help="frames over which memory is watched")
    args = parser.parse_args()
    with threadpool_limits(CORES):
        for name, made in (("made, 640 x 480", Made()), ("... with dots", Made(dots=True))):
            kept = made.kept()
            both = {mode: Reconstructor(kept, mode) for mode in MODES}
            row(name, {mode: list(made.judged(each)) for mode, each in both.items()})
            image = made.picture(*made.slopes(PRESSES[0])).astype(np.float32)
            for mode, frames in (("accurate", 3), ("video", 50)):
                wall, used = timed(both[mode], image, frames)
                print(f"{name:28} {mode:9} {wall:6.0f} ms, {used:.0f} ms of processor", flush=True)
        if args.measured:
            row("real balls left out", real(args.measured))
        held = []
        for number in range(args.frames):
            both["video"](image)
            if number in (args.frames // 10, args.frames - 1):
                held.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
        print(
            f"most memory after {args.frames // 10} and {args.frames} frames: {held[0]:.0f}, {held[1]:.0f} MB"
        )


if __name__ == "__main__":
    main()
