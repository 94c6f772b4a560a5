"""How far the linear elastic layer holds: a ball pressed into a neo-Hookean pad by finite elements.

    python benchmarks/finite_strain.py                 all tables, some ten minutes
    python benchmarks/finite_strain.py --table edge    one of them: slides, sticks, edge or mini
    python benchmarks/finite_strain.py --fine 0.1      elements twice as large

Lengths are in thicknesses of the gel, forces in modulus times thickness squared. Errors are those of the
linear contact against finite elements: without friction the exact one of
`validation.synthetic.elastic_contact`, where gel sticks the one of `designlab.mechanics`. The surface's is
the root mean square over all within 1.5 thicknesses of the contact, in percent of the depth.

The last table is a real GelSight Mini: ball of 7.5 mm radius, pad of 20.75 x 25.25 x 4 mm, taken as round of
equal area. Its forces are those of the FEATS project (arXiv 2411.03315), file
src/calculix/src/hyperelasticity_identification/bayesian-optimization.py.
"""

import argparse
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from finite_elements import Pad, Pressed, PressedPad, RoundProbe
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import fsolve

from designlab.mechanics.contact import STIFFENING, NotConverged, press
from designlab.mechanics.layer import ElasticLayer
from designlab.validation.synthetic.elastic_contact import ElasticBase, press_ball

Array = NDArray[np.float64]

POISSON = 0.49
DECAY = 0.748  # of a load's effect with distance (1/thickness), at that Poisson's ratio
WIDE = 9.0  # radius of a pad whose edge is not felt
STEP = 0.025
EDGE_FORCE, EDGE_BULGE = 0.45, 2.0  # of the free side, see `with_edge`
MINI_THICKNESS, MINI_BALL = 4.0, 7.5
MINI_PAD = float(np.sqrt(20.75 * 25.25 / np.pi))
MINI_DEPTHS = np.array([0.5, 1.0, 1.5, 2.0])
MINI_FORCES = np.array([1.6503, 5.9641, 13.5257, 23.2532])


def states(
    ball: float, pad: float, deepest: float, fine: float, *, sticks: bool, poisson: float = POISSON
) -> Iterator[Pressed]:
    """Press a ball into a pad of thickness and modulus 1 in small steps, as deep as it converges."""
    base = ElasticBase(1.0, poisson, 1.0)
    until = press_ball(base, ball_radius_mm=ball, depth_mm=deepest).contact_radius_mm + 0.35
    model = PressedPad(
        Pad(1.0, pad, poisson=poisson),
        RoundProbe(ball),
        sticks=sticks,
        fine_mm=fine,
        until_mm=min(until, pad),
    )
    try:
        yield from model.press(np.arange(1, round(deepest / STEP) + 1) * STEP)
    except RuntimeError as error:
        print(f"  {error}")


def linear(ball: float, depth: float, *, sticks: bool) -> tuple[float, float, Callable[[Array], Array]]:
    """Force, contact radius and surface of the linear layer."""
    exact = press_ball(ElasticBase(1.0, POISSON, 1.0), ball_radius_mm=ball, depth_mm=depth)
    if not sticks:
        return exact.force_n, exact.contact_radius_mm, exact.surface_mm
    pitch = max(exact.contact_radius_mm / 40, 0.01)
    half = int(1.3 * exact.contact_radius_mm / pitch)
    at = pitch * (np.arange(2 * half + 1) - half)
    square = at[:, None] ** 2 + at**2
    gap = np.where(square < ball**2, ball - np.sqrt(np.maximum(ball**2 - square, 0.0)), np.inf)
    found = press(gap, ElasticLayer(1.0, POISSON, 1.0), pitch_mm=pitch, depth_mm=depth, friction=np.inf)
    count = int((exact.contact_radius_mm + 2.5) / pitch)
    height = found.displacement((1, count), (-half, -half))[0]
    return (
        float(found.pressure_mpa.sum()) * pitch**2,
        found.contact_radius_mm,
        lambda r: np.asarray(CubicSpline(pitch * np.arange(count), height)(r)),
    )


def reported(depth: float, every: float) -> bool:
    """Whether a depth is a multiple of `every`."""
    return round(depth / STEP) % round(every / STEP) == 0


def percent(ratio: float) -> str:
    """How far a ratio is from 1."""
    return f"{100 * (ratio - 1):+.1f}"


def off_surface(found: Pressed, surface: Callable[[Array], Array], end: float) -> float:
    """Root mean square difference of surfaces over a disc, as a share of the depth."""
    r = np.linspace(0.0, end, 600)
    difference = surface(r) - found.surface_mm(r)
    return float(np.sqrt(np.average(difference**2, weights=r)) / found.depth_mm)


def with_edge(
    pad: float, radius: float, surface: Callable[[Array], Array]
) -> tuple[float, Callable[[Array], Array]]:
    """Share of the force that a free side leaves, and the surface with the bulge that it throws back."""
    at_edge = float(surface(np.array([pad]))[0])

    def corrected(r: Array) -> Array:
        height = surface(r)
        back = EDGE_BULGE * at_edge * np.exp(-DECAY * (pad - r))
        return np.where(height < 0, height - back, height)

    return 1 - EDGE_FORCE * float(np.exp(-2 * DECAY * (pad - radius))), corrected


def wide_table(fine: float, *, sticks: bool) -> None:
    """Balls on a wide pad."""
    print(f"\nWide pad, {'gel sticks' if sticks else 'no friction'}; errors of the linear contact (%)")
    print("| R | depth | force | error of force | corrected | of contact radius | of bulge | surface |")
    for ball in (1.0, 2.0, 4.0):
        for found in states(ball, WIDE, 0.6, fine, sticks=sticks):
            depth, reach = found.depth_mm, found.contact_radius_mm
            if not reported(depth, 0.1):
                continue
            try:
                force, radius, surface = linear(ball, depth, sticks=sticks)
            except NotConverged as error:
                print(f"| {ball:.0f} | {depth:.1f} | {found.force_n:.4f} | {error} |")
                continue
            raised = force / (1 - STIFFENING * depth**2) if sticks else force
            bulge = surface(reach + np.linspace(0.0, 2.0, 400)).min() / found.height_mm.min()
            off = off_surface(found, surface, reach + 1.5)
            print(
                f"| {ball:.0f} | {depth:.1f} | {found.force_n:.4f} | {percent(force / found.force_n)} "
                f"| {percent(raised / found.force_n)} | {percent(radius / reach)} | {percent(bulge)} "
                f"| {100 * off:.2f} |",
                flush=True,
            )


def edge_table(fine: float) -> None:
    """The ball of the GelSight Mini on pads of several radii, no friction."""
    ball = MINI_BALL / MINI_THICKNESS
    wide = {round(s.depth_mm, 3): s.force_n for s in states(ball, WIDE, 0.5, fine, sticks=False)}
    print("\nFree side, no friction, R 1.875; force against a wide pad, and surface of the linear layer (%)")
    print("| radius of the pad | depth | force | by formula | surface | corrected |")
    for pad in (2.0, 2.6, MINI_PAD / MINI_THICKNESS, 4.0):
        for found in states(ball, pad, 0.5, fine, sticks=False):
            depth = round(found.depth_mm, 3)
            if not reported(depth, 0.125):
                continue
            _, radius, surface = linear(ball, depth, sticks=False)
            share, corrected = with_edge(pad, radius, surface)
            end = min(found.contact_radius_mm + 1.5, pad)
            off = [100 * off_surface(found, one, end) for one in (surface, corrected)]
            print(
                f"| {pad:.2f} | {depth:.3f} | {percent(found.force_n / wide[depth])} | {percent(share)} "
                f"| {off[0]:.2f} | {off[1]:.2f} |",
                flush=True,
            )


def mini_curves(fine: float) -> Iterator[tuple[str, Callable[[Array], Array]]]:
    """Names of models of the GelSight Mini, and their force (N) per modulus (MPa) at depths (mm)."""
    ball = MINI_BALL / MINI_THICKNESS

    def of_linear(poisson: float) -> Callable[[Array], Array]:
        base = ElasticBase(1.0, poisson, MINI_THICKNESS)
        return lambda depth: np.array(
            [press_ball(base, ball_radius_mm=MINI_BALL, depth_mm=float(d)).force_n for d in depth]
        )

    for poisson in (0.475, 0.49, 0.5):
        yield f"linear, no friction, nu {poisson}", of_linear(poisson)
    for sticks, pad, poisson in (
        (False, WIDE, 0.49),
        (False, MINI_PAD / MINI_THICKNESS, 0.475),
        (False, MINI_PAD / MINI_THICKNESS, 0.49),
        (False, MINI_PAD / MINI_THICKNESS, 0.499),
        (True, MINI_PAD / MINI_THICKNESS, 0.475),
        (True, MINI_PAD / MINI_THICKNESS, 0.49),
    ):
        found = list(states(ball, pad, 0.55, fine, sticks=sticks, poisson=poisson))
        depth = np.array([s.depth_mm for s in found]) * MINI_THICKNESS
        curve = CubicSpline(np.log(depth), np.log([s.force_n * MINI_THICKNESS**2 for s in found]))
        name = f"finite elements, {'sticks' if sticks else 'no friction'}, nu {poisson}"
        yield (
            name + (", wide pad" if pad == WIDE else ", its pad"),
            lambda d, curve=curve: np.exp(curve(np.log(d))),
        )


def mini_table(fine: float) -> None:
    """What modulus the real press needs, and how far one from 0.5 and 1 mm alone predicts 1.5 and 2 mm."""
    print(
        "\nGelSight Mini: modulus (MPa) that meets each depth; from 0.5 and 1 mm alone, errors (%) at others"
    )
    print("| model | 0.5, 1, 1.5, 2 mm | modulus | errors | with an offset of depth (um): modulus | errors |")
    first, last = MINI_DEPTHS[:2], MINI_DEPTHS[2:]
    for name, force in mini_curves(fine):
        each = MINI_FORCES / force(MINI_DEPTHS)
        start = force(first)
        modulus = float(MINI_FORCES[:2] @ start / (start @ start))

        def missed(x: Array, force: Callable[[Array], Array] = force) -> Array:
            return x[0] * force(first + x[1]) / MINI_FORCES[:2] - 1

        fitted, offset = fsolve(missed, [0.9 * modulus, 0.03])
        error = 100 * (modulus * force(last) / MINI_FORCES[2:] - 1)
        left = 100 * (fitted * force(last + offset) / MINI_FORCES[2:] - 1)
        print(
            f"| {name} | {' '.join(f'{e:.3f}' for e in each)} | {modulus:.3f} "
            f"| {error[0]:+.1f} {error[1]:+.1f} "
            f"| {1e3 * offset:.0f}: {fitted:.3f} | {left[0]:+.1f} {left[1]:+.1f} |",
            flush=True,
        )


TABLES: dict[str, Callable[[float], None]] = {
    "slides": partial(wide_table, sticks=False),
    "sticks": partial(wide_table, sticks=True),
    "edge": edge_table,
    "mini": mini_table,
}


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--table", choices=TABLES, action="append", help="one of the tables; all if absent")
    parser.add_argument("--fine", type=float, default=0.05, help="side of the elements (thicknesses)")
    arguments = parser.parse_args()
    for name in arguments.table or TABLES:
        TABLES[name](arguments.fine)


if __name__ == "__main__":
    main()
