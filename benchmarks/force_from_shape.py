"""Force from the shape of a gel, against contacts by finite elements and by other rules of friction.

    python benchmarks/force_from_shape.py              all presses, some ten minutes
    python benchmarks/force_from_shape.py --fine 0.05  elements half as large

Balls are pressed into neo-Hookean pads by finite elements (`finite_elements.py`), which the inverse does not
know: finite strain, an edge of the pad at 3.5 or 9 thicknesses, skin that sticks or slides. Stars and ridges,
which have no axis, are pressed into the linear layer. Each surface gets noise of 7 um that is smooth over
0.3 mm, an offset within 10 um, and a modulus that the lab knows to 10 %. Poisson's ratio is 0.49 or 0.4999,
the inverse takes 0.495.
"""

import argparse
import itertools
import sys
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from finite_strain import states
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from designlab.mechanics.contact import NotConverged, press
from designlab.mechanics.layer import ElasticLayer
from designlab.mechanics.surface_pressure import pressure_under

Array = NDArray[np.float64]

PITCH_MM, WIDTH_MM, HEIGHT_MM = 0.1, 14.0, 10.5
NOISE_MM, SMOOTH_MM, OFFSET_MM = 0.007, 0.3, 0.01
MODULUS_SD = 0.1
POISSON = 0.495
ROOM = 0.8  # thicknesses from the contact to the border of the picture
BALLS, PADS, RATIOS, SHARES = (
    (0.75, 1.0, 1.5, 2.0, 3.0),
    (3.5, 9.0),
    (0.49, 0.4999),
    (0.1, 0.2, 0.3, 0.4, 0.5),
)
THICKNESSES_MM = (1.5, 2.0, 3.0)


class Case(NamedTuple):
    """A press: what it is, thickness of the gel (mm), its surface (mm), and force over modulus (mm2)."""

    probe: str
    sticks: bool
    poisson: float
    share: float
    thickness_mm: float
    height_mm: Array
    force: float


def grid() -> tuple[Array, Array]:
    """Places of a picture's pixels (mm)."""
    x, y = ((np.arange(round(side / PITCH_MM)) + 0.5) * PITCH_MM - side / 2 for side in (WIDTH_MM, HEIGHT_MM))
    across, down = np.meshgrid(x, y)
    return across, down


def balls(fine: float) -> Iterator[Case]:
    """Balls by finite elements, in several thicknesses of gel."""
    away = np.hypot(*grid())
    for poisson, sticks, pad, ball in itertools.product(RATIOS, (True, False), PADS, BALLS):
        for found in states(ball, pad, max(SHARES), fine, sticks=sticks, poisson=poisson):
            if min(abs(found.depth_mm - share) for share in SHARES) > 1e-6:
                continue
            for h in THICKNESSES_MM:
                if (found.contact_radius_mm + ROOM) * h < HEIGHT_MM / 2:
                    height = h * found.surface_mm(away / h)
                    height[away / h > pad] = 0.0
                    share, force = found.depth_mm, found.force_n * h**2
                    yield Case(f"ball, pad {pad:g} h", sticks, poisson, share, h, height, force)


def others() -> Iterator[Case]:
    """Stars and ridges in the linear layer, stiffened as finite elements say."""
    x, y = grid()
    angle, away = np.arctan2(y, x), np.hypot(x, y)
    slope = 1.5
    gaps = {
        "star": np.maximum(away - 1.6 * (1 + 0.35 * np.cos(5 * angle)), 0.0) * slope,
        "ridge": np.maximum(np.abs(x) - 0.1, 0.0) + np.maximum(np.abs(y) - 3.0, 0.0) * slope,
    }
    for (name, gap), h, poisson, sticks, share in itertools.product(
        gaps.items(), (2.0, 3.0), RATIOS, (True, False), SHARES
    ):
        layer = ElasticLayer(1.0, poisson, h)
        friction = np.inf if sticks else 0.0
        try:
            found = press(gap, layer, pitch_mm=PITCH_MM, depth_mm=share * h, friction=friction)
        except NotConverged as error:
            print(f"  {name}, {h:g} mm, {share:g}: {error}")
            continue
        yield Case(name, sticks, poisson, share, h, found.displacement(gap.shape, (0, 0)), found.force_n)


def main() -> None:
    """Print how far the forces are off, and how often the intervals hold them."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--fine", type=float, default=0.1, help="size of an element, in thicknesses")
    fine = parser.parse_args().fine
    random = np.random.default_rng(0)
    rows = []
    for case in itertools.chain(balls(fine), others()):
        smooth = gaussian_filter(random.normal(size=case.height_mm.shape), SMOOTH_MM / PITCH_MM)
        seen = case.height_mm + NOISE_MM * smooth / smooth.std() + random.uniform(-OFFSET_MM, OFFSET_MM)
        found = pressure_under(
            seen,
            poisson=POISSON,
            thickness_mm=case.thickness_mm,
            pitch_mm=PITCH_MM,
            noise_mm=NOISE_MM,
        )
        by_shape = found.force_n(1.0) / case.force
        value, low, high = found.force_range(float(np.exp(MODULUS_SD * random.normal())), MODULUS_SD)
        print(f"{case.probe} {case.sticks} {case.poisson} {case.share:.1f} {by_shape:.3f}", file=sys.stderr)
        rows.append((case, by_shape, low <= case.force <= high, value))
    print(
        "\n| probe | skin | presses | force by shape over force, mean ± sd | within 15 % | in the interval |"
    )
    print("| --- | --- | --- | --- | --- | --- |")
    groups = {(case.probe, case.sticks) for case, *_ in rows}
    for probe, sticks in [*sorted(groups, key=str), ("all", True), ("all", False)]:
        own = [row for row in rows if row[0].sticks == sticks and probe in ("all", row[0].probe)]
        ratio = np.array([row[1] for row in own])
        shares = np.mean(np.abs(ratio - 1) < 0.15), np.mean([row[2] for row in own])
        ends = " | ".join(f"{100 * each:.0f} %" for each in shares)
        print(
            f"| {probe} | {'sticks' if sticks else 'slides'} | {len(own)} "
            f"| {ratio.mean():.3f} ± {ratio.std():.3f} | {ends} |"
        )


if __name__ == "__main__":
    main()
