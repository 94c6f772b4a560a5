"""Thickness and hardness of a flat gel, height of its LEDs: what touch and light gain and lose.

A thin gel takes the shape of small things and is stiff; a thick one carries deep presses. What it is cast of
says how much force that takes. LEDs at the side of the core light thin and thick gel differently. The study
presses every design equally deep and asks of each:

- which bars are told apart (lateral resolution), and how well normals come out;
- how much force it takes: that of a ball of 4 mm at the depth from which on slopes saturate the picture, or
  at half the thickness where that is less, beyond which the forces of the linear layer no longer hold;
- how evenly the gel is lit.

Hardness scales forces and changes no shape at equal depth: gels of one Poisson's ratio give the same
pictures. So one gel is simulated, and the forces of the others follow from their moduli.

    python studies/gel_thickness.py --out gel-thickness-out

Some five minutes on a quiet machine, with ``--full`` a quarter of an hour; the same command again goes on
where it ended. Results: ``designs.csv``, ``trade.png``.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from designlab.evaluation.press_plan import PressPlan
from designlab.optimization.outcome import Evaluator, Simulated
from designlab.optimization.study import sweep
from designlab.report.figures import new_figure, write_figure
from designlab.sensor.design import Design, preset
from designlab.sensor.gel_materials import gel_material
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from geometries.probes import parse

BASE = "default"
GELS = ("ecoflex-00-30", "dragon-skin-10", "solaris")  # soft to hard, of one Poisson's ratio
THICKNESS_MM = (1.0, 2.0, 4.0)
LED_HEIGHT_MM = (4.5, 6.0)  # of the LEDs' centre above the membrane
FULL_THICKNESS_MM, FULL_LED_HEIGHT_MM = (1.0, 1.5, 2.0, 3.0, 4.0), (3.0, 4.5, 6.0, 7.0)
DEPTH_MM = 0.5  # of the deepest press on every design: half of the thinnest gel
FORCE_N = 2.0  # that the sensor is to take
BALL = "sphere:4"
SMALL_STRAIN = 0.5  # of the thickness, up to which forces hold
PITCH_MM = 0.05
SEED = 1
SCALED = ("force_range_n", "force_resolution_mn", "force_at_depth_n")  # with the modulus of the gel
FIELDS = ("elastomer.thickness_mm", "leds.height_mm")
SCORES = (
    "lateral_resolution_mm",
    "normal_error_median_deg",
    "saturation_depth_mm",
    "force_at_depth_n",
    "force_resolution_mn",
    "uniformity_u0",
)
SURE = 2.0  # standard errors from which on a difference counts
MARKERS = "osD^vPX"


class Trade(NamedTuple):
    """Every design with every gel, and what follows from them in words."""

    table: pd.DataFrame
    conclusions: tuple[str, ...]


def run(
    out: Path,
    *,
    thickness_mm: Sequence[float] = THICKNESS_MM,
    led_height_mm: Sequence[float] = LED_HEIGHT_MM,
    gels: Sequence[str] = GELS,
    force_n: float = FORCE_N,
    workers: int = 1,
    evaluator: Evaluator | None = None,
) -> Trade:
    """Evaluate the designs, or go on where an earlier run ended; write the table and the figure."""
    base = preset(BASE).replace({"contact.gel": gels[0]})
    presses = PressPlan.of(base, depth_mm=DEPTH_MM)
    rendered = sweep(
        base,
        dict(zip(FIELDS, (thickness_mm, led_height_mm), strict=True)),
        seed=SEED,
        depth_mm=DEPTH_MM,
        workers=workers,
        evaluator=evaluator or Simulated(presses=presses, all_scores=True),
        out=out,
    )
    possible = rendered[rendered["reason"] == ""]
    if possible.empty:
        raise ValueError(f"no design of the study is possible: {rendered['reason'].iloc[0]}")
    table = of_every_gel(with_force_range(possible, base), gels)
    table.to_csv(out / "designs.csv", index=False)
    picture(table, out / "trade.png")
    return Trade(table, conclusions(table, force_n))


def with_force_range(rendered: pd.DataFrame, base: Design) -> pd.DataFrame:
    """Add depth and force that a ball may go to: nothing is rendered for it, a contact is solved."""
    thickness, unsure = rendered["elastomer.thickness_mm"], rendered["saturation_depth_mm_se"]
    depth = np.minimum(rendered["saturation_depth_mm"], SMALL_STRAIN * thickness)
    forces, lower = (
        np.array([ball_force_n(base, h, d) for h, d in zip(thickness, depths, strict=True)])
        for depths in (depth, depth - np.where(depth < SMALL_STRAIN * thickness, unsure, 0.0))
    )
    kept = [name for score in SCORES for name in (score, f"{score}_se") if name in rendered]
    return rendered[[*FIELDS, *kept]].assign(
        depth_range_mm=depth, force_range_n=forces, force_range_n_se=forces - lower
    )


def ball_force_n(base: Design, thickness_mm: float, depth_mm: float) -> float:
    """Force of a ball at a depth, on a gel of a thickness."""
    probe = parse(BALL)
    surface = indent(
        base.replace({"elastomer.thickness_mm": thickness_mm}).elastomer,
        base.contact,
        Press(probe=probe, depth_mm=depth_mm),
        area_mm=(2 * probe.size_mm, 2 * probe.size_mm),
        pitch_mm=PITCH_MM,
    )
    assert surface.mechanics is not None  # the gel is elastic
    return surface.mechanics.force_n


def of_every_gel(rendered: pd.DataFrame, gels: Sequence[str]) -> pd.DataFrame:
    """Rows of the gel that was simulated, and of the others by the ratio of moduli."""
    first = gel_material(gels[0])
    tables = []
    for name in gels:
        material = gel_material(name)
        if material.poisson != first.poisson:
            raise ValueError(
                f"gels: must have one Poisson's ratio for equal pictures, {name!r} has {material.poisson:g}, "
                f"{gels[0]!r} {first.poisson:g}"
            )
        table = rendered.assign(gel=name)
        for score in (f"{each}{end}" for each in SCALED for end in ("", "_se")):
            if score in table:
                table[score] *= material.modulus_mpa / first.modulus_mpa
        tables.append(table)
    return pd.concat(tables, ignore_index=True)


def conclusions(table: pd.DataFrame, force_n: float) -> tuple[str, ...]:
    """What the designs show, in words."""
    one = table[table["gel"] == table["gel"].iloc[0]]
    return (
        along(one, "elastomer.thickness_mm", "Thicker gel"),
        along(one, "leds.height_mm", "Higher LEDs"),
        light_of(one),
        hardness(table),
        choice(table, force_n),
    )


def along(table: pd.DataFrame, field: str, subject: str) -> str:
    """What changes from the least to the largest value of a field, in the mean over the rest."""
    low, high = table[field].min(), table[field].max()
    if low == high:
        return f"{subject}: one value alone, {low:g} mm."
    ends = [table[table[field] == value] for value in (low, high)]
    told = [
        change(ends, score, words, unit)
        for score, words, unit in (
            ("lateral_resolution_mm", "lateral resolution", "mm"),
            ("normal_error_median_deg", "normal error", "deg"),
            ("force_range_n", f"force range of {table['gel'].iloc[0]}", "N"),
            ("uniformity_u0", "evenness of light U0", ""),
        )
    ]
    return f"{subject} ({low:g} to {high:g} mm): {'; '.join(told)}."


def change(ends: Sequence[pd.DataFrame], score: str, words: str, unit: str) -> str:
    """How a score differs between two groups of designs, and whether by more than its error."""
    before, after = (float(end[score].mean()) for end in ends)
    errors = [end[f"{score}_se"].to_numpy() for end in ends if f"{score}_se" in end]
    error = float(np.sqrt(sum(np.sum(se**2) / len(se) ** 2 for se in errors)))
    unsure = "" if abs(after - before) > SURE * error else ", within its error"
    return f"{words} {before:.3g} to {after:.3g} {unit}".rstrip() + unsure


def light_of(table: pd.DataFrame) -> str:
    """Which of the LED heights lights a gel of each thickness most evenly."""
    best = table.loc[table.groupby("elastomer.thickness_mm")["uniformity_u0"].idxmax()]
    told = (
        f"{row['elastomer.thickness_mm']:g} mm: LEDs at {row['leds.height_mm']:g} mm, U0 "
        f"{row['uniformity_u0']:.2f}"
        for _, row in best.iterrows()
    )
    return f"Evenest light by thickness: {'; '.join(told)}."


def hardness(table: pd.DataFrame) -> str:
    """What hardness changes: forces alone."""
    gels = table["gel"].drop_duplicates().tolist()
    if len(gels) == 1:
        return f"Hardness: one gel alone, {gels[0]}."
    mean = table.groupby("gel")["force_range_n"].mean()
    steps = 1000 * table["force_range_n"] / table["force_resolution_mn"]
    return (
        f"Harder gel ({gels[0]} to {gels[-1]}): {mean[gels[-1]] / mean[gels[0]]:.3g} times the force "
        "range and the least force that is told, the same pictures at equal depth. So in how many steps "
        f"force is told, {steps.min():.2g} to {steps.max():.2g}, is a matter of thickness and light."
    )


def choice(table: pd.DataFrame, force_n: float) -> str:
    """The design of the finest lateral resolution of those that take a force."""
    able = table[table["force_range_n"] >= force_n].dropna(subset="lateral_resolution_mm")
    if able.empty:
        most = table["force_range_n"].max()
        return f"None of these takes {force_n:g} N; the most is {most:.3g} N. Take a harder or a thicker gel."
    # The softest gel that takes the force tells the least force; harder ones have the same pictures.
    best = able.sort_values(["lateral_resolution_mm", "force_resolution_mn"]).iloc[0]
    return (
        f"Finest of those that take {force_n:g} N: {best['elastomer.thickness_mm']:g} mm of {best['gel']}, "
        f"LEDs at {best['leds.height_mm']:g} mm: bars of {best['lateral_resolution_mm']:.2g} mm, "
        f"normal error {best['normal_error_median_deg']:.2g} deg, up to {best['force_range_n']:.2g} N told "
        f"to {best['force_resolution_mn']:.0f} mN, U0 {best['uniformity_u0']:.2g}."
    )


def picture(table: pd.DataFrame, path: Path) -> None:
    """Draw resolution over force range, and normal error over evenness of light."""
    import matplotlib
    from matplotlib.ticker import LogLocator, NullFormatter

    thicknesses = sorted(table["elastomer.thickness_mm"].unique())
    colours = dict(
        zip(thicknesses, matplotlib.colormaps["viridis"](np.linspace(0, 0.85, len(thicknesses))), strict=True)
    )
    heights = sorted(table["leds.height_mm"].unique())
    gels = table["gel"].drop_duplicates().tolist()
    figure = new_figure(10.5, 4.4, dots_per_inch=120)
    touch, light = figure.subplots(1, 2)
    for (thickness, height), rows in table.groupby(["elastomer.thickness_mm", "leds.height_mm"]):
        style: dict[str, Any] = {
            "color": colours[thickness],
            "marker": MARKERS[heights.index(height) % len(MARKERS)],
            "capsize": 2,
            "elinewidth": 1,
        }
        touch.errorbar(
            rows["force_range_n"],
            rows["lateral_resolution_mm"],
            rows["lateral_resolution_mm_se"],
            linestyle=":",
            linewidth=1,
            **style,
        )
        one = rows.iloc[:1]
        light.errorbar(
            one["uniformity_u0"],
            one["normal_error_median_deg"],
            one["normal_error_median_deg_se"],
            one["uniformity_u0_se"],
            linestyle="",
            label=f"{thickness:g} mm, LEDs at {height:g} mm",
            **style,
        )
    touch.set(
        xscale="log",
        xlabel="force of a ball of 4 mm that the sensor takes (N)",
        ylabel="lateral resolution (mm)",
        title=f"Touch: each row of points is one design in\n{', '.join(gels)} (left to right)",
    )
    light.set(
        xlabel="evenness of light, U0 of the worst LED group",
        ylabel="median normal error (deg)",
        title="Light: the same for all gels",
    )
    touch.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    touch.xaxis.set_major_formatter("{x:g}")
    touch.xaxis.set_minor_formatter(NullFormatter())
    touch.set_ylim(bottom=0)
    light.set_ylim(bottom=0)
    light.legend(fontsize="small", title="gel")
    write_figure(figure, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--full", action="store_true", help="more thicknesses and LED heights")
    parser.add_argument(
        "--force-n",
        type=float,
        default=FORCE_N,
        help="force that it is to take (N; default: %(default)s)",
    )
    parser.add_argument("--workers", type=int, default=1, help="processes (default: %(default)s)")
    arguments = parser.parse_args()
    trade = run(
        arguments.out,
        thickness_mm=FULL_THICKNESS_MM if arguments.full else THICKNESS_MM,
        led_height_mm=FULL_LED_HEIGHT_MM if arguments.full else LED_HEIGHT_MM,
        force_n=arguments.force_n,
        workers=arguments.workers,
    )
    columns = {
        "gel": "gel",
        "elastomer.thickness_mm": "thickness_mm",
        "leds.height_mm": "led_height_mm",
        "lateral_resolution_mm": "lateral_mm",
        "normal_error_median_deg": "normal_deg",
        "depth_range_mm": "depth_mm",
        "force_range_n": "force_n",
        "force_resolution_mn": "resolution_mn",
        "uniformity_u0": "u0",
    }
    print(trade.table[list(columns)].rename(columns=columns).round(3).to_string(index=False))
    for line in trade.conclusions:
        print(f"- {line}")
    print(f"figure: {arguments.out / 'trade.png'}")


if __name__ == "__main__":
    main()
