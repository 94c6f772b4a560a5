"""Shear from markers, against presses by finite elements in three dimensions.

    python benchmarks/shear_from_blocks.py            all presses; some minutes on a quiet core
    python benchmarks/shear_from_blocks.py --blocks 2

Balls, discs, squares and stars are pressed into blocks with free sides (`finite_blocks.py`), which the
inverse takes for a layer without an end, and dragged sideways while the gel sticks to them or slides. It sees
what `reconstruct` does: heights with noise of 7 um that is smooth over 0.3 mm and an offset within 10 um, on
points as coarse as there, and markers with noise of 5 um, of which a tenth is lost, in every second press all
that are touched. Poisson's ratio is 0.49 or 0.4999, the inverse takes 0.495. The modulus is known to 10 %.
"""

import argparse
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from finite_blocks import Block, LoadedBlock
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from designlab.mechanics.surface_pressure import NORMAL_95, pressure_under
from designlab.mechanics.surface_shear import SurfaceShear, shear_under

Array = NDArray[np.float64]

PITCH_MM = 0.1
PICTURE_MM = 14.0, 10.5
FRAME_MM = 0.5  # of the block, that the picture leaves out at least
NOISE_MM, SMOOTH_MM, OFFSET_MM = 0.007, 0.3, 0.01
MARKER_NOISE_MM, MARKER_PITCH_MM, LOST = 0.005, (1.0, 1.5), 0.1
MODULUS_SD = 0.1
POISSON = 0.495
WITHIN = 0.2
CLEAR = 0.1  # shear over force, from which the edges of the block matter less
SHEAR_MM, DEPTH_SHARES = (0.05, 0.25), (0.12, 0.3)

# block, place of the probe, and its reach (mm)
BLOCKS = (
    (Block(2.0, 20, 16, 0.49), (0.0, 0.0), 1.8),
    (Block(1.0, 20, 16, 0.4999), (0.5, -0.4), 1.5),
    (Block(4.0, 20, 16, 0.49), (0.0, 0.0), 2.4),
    (Block(3.0, 20, 16, 0.4999), (3.0, 1.5), 2.4),
    (Block(2.0, 18, 18, 0.4999), (1.0, 1.0), 2.4),
    (Block(1.5, 20, 16, 0.49), (-4.5, 2.0), 2.0),
    (Block(4.0, 36, 36, 0.4999), (0.0, 0.5), 2.8),
    (Block(2.5, 20, 16, 0.49), (0.0, 0.0), 3.2),
)
ACROSS = 4  # elements from the middle of the probe to its reach
# a size as a share of the reach; coefficient of friction of those that slide
PROBES = (
    ("ball", 1.6, None),
    ("disc", 0.75, None),
    ("square", 0.6, None),
    ("star", 0.95, None),
    ("ball", 1.2, 0.6),
)


class Press(NamedTuple):
    """A press: heights (mm, rows downwards), markers and how they moved (mm), shear and force (N)."""

    name: str
    thickness_mm: float
    height_mm: Array
    places_mm: Array
    moved_mm: Array
    shear_n: Array
    force_n: float


def gap_of(probe: str, size_mm: float, places_mm: Array, turn: float) -> Array:
    """How far a probe's surface lies above its lowest point (mm); the size is a radius or half a side."""
    x, y = places_mm.T
    away, angle = np.hypot(x, y), np.arctan2(y, x) - turn
    if probe == "ball":
        return size_mm - np.sqrt(np.maximum(size_mm**2 - away**2, 0.0))
    edge = {
        "disc": np.full_like(away, size_mm),
        "square": size_mm / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle))),
        "star": size_mm * (0.7 + 0.3 * np.cos(5 * angle)),
    }[probe]
    return np.where(away <= edge, 0.0, np.inf)


def pressed(
    loaded: LoadedBlock,
    probe: str,
    size_mm: float,
    depth_mm: float,
    shear_mm: tuple[float, float],
    friction: float | None,
    random: np.random.Generator,
    *,
    covered: bool,
) -> Press:
    """Press, and look at it as a sensor does, without noise."""
    block, centre = loaded.block, np.array(loaded.centre_mm)
    gap = gap_of(probe, size_mm, loaded.places_mm, random.uniform(0, np.pi))
    dragged = loaded.drag(gap, depth_mm, shear_mm, friction=friction)
    width, length = (
        min(side, whole - 2 * FRAME_MM)
        for side, whole in zip(PICTURE_MM, (block.width_mm, block.length_mm), strict=True)
    )
    x, y = ((np.arange(round(side / PITCH_MM)) + 0.5) * PITCH_MM - side / 2 for side in (width, length))
    grid = np.stack(np.meshgrid(x, y[::-1]), axis=-1)
    height = loaded.seen(dragged, grid.reshape(-1, 2)).reshape(grid.shape[:2])
    pitch = random.uniform(*MARKER_PITCH_MM)
    lines = [
        np.arange(-side / 2 + random.uniform(0.3, 1) * pitch, side / 2 - 0.2, pitch)
        for side in (width, length)
    ]
    places = np.stack(np.meshgrid(*lines), axis=-1).reshape(-1, 2)
    kept = random.uniform(size=len(places)) > LOST
    if covered:
        touched = loaded.places_mm[dragged.touching] + centre
        nearest = np.hypot(*np.moveaxis(places[:, None] - touched, 2, 0)).min(axis=1)
        kept &= nearest > loaded.spacing_mm
    places = places[kept]
    force = dragged.force_n
    kind = "sticks" if friction is None else "slides"
    name = (
        f"{block.thickness_mm:g} mm, {block.width_mm:g} x {block.length_mm:g}, nu {block.poisson:g}, "
        f"{probe} {size_mm:.1f}, {depth_mm:.2f} deep, {kind}"
    )
    return Press(
        name,
        block.thickness_mm,
        height,
        places,
        loaded.at(dragged, places)[:, :2],
        force[:2],
        float(force[2]),
    )


def found_in(press: Press, random: np.random.Generator) -> SurfaceShear:
    """Shear that `reconstruct` finds in a press, with the noise of a picture."""
    smooth = gaussian_filter(random.normal(size=press.height_mm.shape), SMOOTH_MM / PITCH_MM)
    height = press.height_mm + NOISE_MM * smooth / smooth.std() + random.uniform(-OFFSET_MM, OFFSET_MM)
    pressure = pressure_under(
        height, poisson=POISSON, thickness_mm=press.thickness_mm, pitch_mm=PITCH_MM, noise_mm=NOISE_MM
    )
    moved = press.moved_mm + MARKER_NOISE_MM * random.normal(size=press.moved_mm.shape)
    return shear_under(press.places_mm, moved, pressure)


def presses(blocks: int, seed: int) -> Iterator[Press]:
    """Presses into so many of the blocks."""
    for number, (block, centre, reach) in enumerate(BLOCKS[:blocks]):
        random = np.random.default_rng((seed, number))
        loaded = LoadedBlock(block, centre_mm=centre, reach_mm=reach, fine_mm=reach / ACROSS)
        for probe, share, friction in PROBES:
            size, shear, angle = share * reach, random.uniform(*SHEAR_MM), random.uniform(0, 2 * np.pi)
            depth = random.uniform(*DEPTH_SHARES) * block.thickness_mm
            if probe == "ball":
                # the contact stays within the reach
                depth = min(depth, 0.3 * size)
            yield pressed(
                loaded,
                probe,
                size,
                depth,
                (float(shear * np.cos(angle)), float(shear * np.sin(angle))),
                friction,
                random,
                covered=bool(random.integers(2)),
            )


def _error(found: Array, true: Array) -> float:
    """Length of the error over that of what is true."""
    return float(np.hypot(*(found - true)) / np.hypot(*true))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--blocks", type=int, default=len(BLOCKS))
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    random, began = np.random.default_rng(args.seed), time.process_time()
    errors, held, scores, shares = [], [], [], []
    print("| press | force, true shear, found (N) | error | within its 95 % interval |")
    print("| --- | --- | --- | --- |")
    for press in presses(args.blocks, args.seed):
        shear = found_in(press, random)
        modulus = float(np.exp(MODULUS_SD * random.normal()))
        found = np.array(shear.force_n(modulus))
        error = np.array(shear.error_n(modulus, MODULUS_SD * modulus))
        off = found - press.shear_n
        errors.append(
            float(np.hypot(*(np.array(shear.force_n(1.0)) - press.shear_n)) / np.hypot(*press.shear_n))
        )
        scores.append(off / error)
        shares.append(np.hypot(*press.shear_n) / press.force_n)
        held.append(np.abs(off) < NORMAL_95 * error)
        true, told, sds = (
            ", ".join(f"{part:.3f}" for part in each) for each in (press.shear_n, found, error)
        )
        print(
            f"| {press.name} | {press.force_n:.2f}; {true}; {told} ± {sds} "
            f"| {errors[-1]:.0%} | {held[-1][0]}, {held[-1][1]} |",
            flush=True,
        )
    for least in (0.0, CLEAR):
        some = np.array(shares) > least
        off = np.array(errors)[some]
        print(
            f"shear over force above {least:.0%}: {np.sum(off <= WITHIN)} of {len(off)} within {WITHIN:.0%}, "
            f"median {np.median(off):.1%}, modulus known; {np.mean(np.array(held)[some]):.0%} in intervals"
        )
    rms = np.sqrt(np.mean(np.square(scores)))
    print(f"errors over the stated ones {rms:.2f}; {time.process_time() - began:.0f} s of the processor")


if __name__ == "__main__":
    main()
