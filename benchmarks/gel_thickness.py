"""Force and imprint of one ball on gels of other thickness and hardness, at equal depth and at equal force.

    python benchmarks/gel_thickness.py

Widths are those of the imprint through the middle: of the contact, at half the height, and where it meets
the level of the untouched gel, outside which it bulges.
"""

import argparse

import numpy as np

from designlab.sensor.design import Design, preset
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from designlab.simulation.contact.surface import Surface
from geometries.probes import parse

DESIGN = "gelsight-2020-flat-elastic"
THICKNESSES_MM = (1.0, 2.0, 3.0, 4.0)
AREA_MM, PITCH_MM = (20.0, 20.0), 0.025
HARDER = 4.0


def pressed(design: Design, thickness_mm: float, *, times: float = 1.0, **strength: float) -> Surface:
    """Press the ball into the gel of a design, of another thickness and so many times as hard."""
    contact = design.contact
    assert contact.model == "layer"
    layer = contact.layer(thickness_mm=thickness_mm)
    content = {"model": "layer", "gel": "custom", "modulus_mpa": times * layer.modulus_mpa}
    content |= {"poisson": layer.poisson, "friction": contact.friction}
    changed = design.replace({"contact": content | {"skin_length_mm": contact.skin_length_mm}})
    gel = design.elastomer.model_copy(update={"thickness_mm": thickness_mm})
    press = Press(probe=parse("sphere:4"), **strength)
    return indent(gel, changed.contact, press, area_mm=AREA_MM, pitch_mm=PITCH_MM)


def width_mm(surface: Surface, share: float) -> float:
    """Width of the imprint at a share of its height."""
    row, x_mm = surface.height_mm[len(surface.y_mm) // 2], surface.x_mm
    level, middle = share * row.max(), len(x_mm) // 2
    first = middle + int(np.argmax(row[middle:] <= level))
    return 2 * float(np.interp(-level, -row[first - 1 : first + 1], x_mm[first - 1 : first + 1]))


def table(design: Design, **strength: float) -> None:
    """Print a line for each thickness."""
    columns = ("h mm", "depth mm", "force N", "contact mm", "half mm", "level mm", "bulge um")
    print(" ".join(f"{title:>10}" for title in columns))
    for thickness_mm in THICKNESSES_MM:
        surface = pressed(design, thickness_mm, **strength)
        found = surface.mechanics
        assert found is not None
        figures = (found.depth_mm, found.force_n, 2 * found.contact_radius_mm)
        widths = (width_mm(surface, 0.5), width_mm(surface, 0.0))
        print(" ".join(f"{figure:10.3f}" for figure in (thickness_mm, *figures, *widths, surface.bulge_um)))


def main() -> None:
    """Print the tables, and what hardness does."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("design", nargs="?", default=DESIGN, help="preset (default: %(default)s)")
    parser.add_argument("--depth-mm", type=float, nargs="+", default=[0.56, 0.8])
    parser.add_argument("--force-n", type=float, default=1.0)
    args = parser.parse_args()
    design = preset(args.design)
    for depth_mm in args.depth_mm:
        print(f"ball of 4 mm, {depth_mm:g} mm deep")
        table(design, depth_mm=depth_mm)
    print(f"ball of 4 mm, {args.force_n:g} N")
    table(design, force_n=args.force_n)
    once, harder = (pressed(design, 2.0, times=times, depth_mm=args.depth_mm[0]) for times in (1.0, HARDER))
    assert once.mechanics is not None
    assert harder.mechanics is not None
    moved = 1000 * float(np.abs(harder.height_mm - once.height_mm).max())
    ratio = harder.mechanics.force_n / once.mechanics.force_n
    print(f"{HARDER:g} times as hard: force {ratio:.4f} times, heights differ by {moved:.2g} um at most")


if __name__ == "__main__":
    main()
