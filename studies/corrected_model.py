"""From a sensor whose pictures do not match the simulation to the next design, by a corrected model.

A lab has built the flat prototype of 2020 and wants the next sensor to be as flat as it can: the LEDs should
stand low, but every group must still light the gel evenly enough. How low that is depends on the beam of the
LEDs, and the beam is not quite what the design says. Here a generated measurement takes the place of the
bench, so that what is hidden is known in the end; it is made by code that shares nothing with the simulator.

1. The sensor is measured: a few backgrounds and ball presses.
2. `gap diagnose` names the effect that the design lacks, and writes the corrected model.
3. The heights of the LEDs are tried with the design as drawn and with the corrected model. The model is drawn
   several times from what the measurement leaves open, which shows how sure the answer is.

    python studies/corrected_model.py --out corrected-model-out

A few minutes on a quiet machine; the same command again goes on where it ended. Results: ``heights.csv``,
``heights.png``, and the page about the diagnosis under ``diagnosis``.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from designlab.evaluation.illumination_scores import Estimate, uniformity
from designlab.inference.diagnosis import diagnose
from designlab.measurement import load_measurement
from designlab.optimization.study import sweep
from designlab.report.diagnosis_folder import write_diagnosis
from designlab.report.figures import new_figure, write_figure
from designlab.report.gap import gap_report
from designlab.sensor.design import Design, preset
from designlab.simulation.effects import AppliedEffect, SensorModel, load_model
from designlab.simulation.simulator import Simulator
from designlab.validation.synthetic import plant, unseal

BASE = "gelsight-2020-flat"
HIDDEN = {"led_profile": {"red_exponent": 1.5, "green_exponent": 1.7, "blue_exponent": 1.6}}
"""What nobody in the lab knows: the LEDs shine in a narrower beam than the exponent 1 of the design."""
TRIED = (
    "led_profile",
    "led_position",
    "vignetting",
    "albedo_field",
    "colour_mixing",
    "black_level",
    "response_curve",
)  # effects on how light is spread and reported; None tries the whole catalogue and takes longer
NEEDED_U0 = 0.45  # darkest over mean light of the gel, that the worst LED group must reach
HEIGHTS_MM = (9.0, 11.0, 13.0, 15.0)  # of the panels' centre above the membrane
DRAWS = 4
COLUMNS = 64
SAMPLES = 128
SEED = 3
DRAWN, CORRECTED, TRUE = "design as drawn", "corrected model", "what was hidden"


class Story(NamedTuple):
    """Verdict and effects of the diagnosis, the table of designs, and the least height by each model."""

    verdict: str
    named: tuple[str, ...]
    table: pd.DataFrame
    least_mm: dict[str, float]


class Lit(NamedTuple):
    """How evenly a design lights the untouched gel."""

    scores: dict[str, Estimate]
    warnings: tuple[str, ...]


def run(
    out: Path,
    *,
    heights_mm: Sequence[float] = HEIGHTS_MM,
    draws: int = DRAWS,
    columns: int = COLUMNS,
    samples: int = SAMPLES,
    catalogue: Sequence[str] | None = TRIED,
) -> Story:
    """Measure, diagnose, and search with the corrected model; go on where an earlier run ended."""
    design = preset(BASE)
    measurement = out / "measurement"
    if not measurement.exists():
        plant(design, effects=HIDDEN, out=measurement, seed=SEED, kit="small", columns=columns)
    verdict, named, model = diagnosed(design, out, columns=columns, samples=samples, catalogue=catalogue)
    hidden = unseal(measurement)["effects"]
    true = tuple(AppliedEffect(name=name, values=values) for name, values in hidden.items())
    subjects = {
        DRAWN: SensorModel.of(design),
        CORRECTED: model,
        **{f"draw {k + 1}": model.sampled(SEED + k) for k in range(draws)},
        TRUE: SensorModel(design=design, effects=true),
    }
    table = pd.concat(
        sweep(
            subject,
            {"leds.height_mm": heights_mm},
            seed=SEED,
            progress=False,
            evaluator=lambda one, **_: lit(one, columns=columns, samples=samples),
        ).assign(model=name)
        for name, subject in subjects.items()
    )
    table.to_csv(out / "heights.csv", index=False)
    least_mm = {name: least_height_mm(table[table["model"] == name]) for name in subjects}
    picture(table, least_mm, out / "heights.png")
    return Story(verdict, named, table, least_mm)


def diagnosed(
    design: Design, out: Path, *, columns: int, samples: int, catalogue: Sequence[str] | None
) -> tuple[str, tuple[str, ...], SensorModel]:
    """Verdict, names and the corrected model; only its effects that hold for other designs are used later."""
    folder = out / "diagnosis"
    if not (folder / "report.html").is_file():
        found = diagnose(
            load_measurement(out / "measurement"),
            design,
            out=folder,
            seed=SEED,
            columns=columns,
            samples=samples,
            catalogue=catalogue,
        )
        gap_report(write_diagnosis(found), folder / "report.html")
    report: dict[str, Any] = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    named = tuple(effect["name"] for effect in report["effects"])
    return report["verdict"], named, load_model(folder / "model.toml").transferable()


def lit(subject: Design | SensorModel, *, columns: int, samples: int) -> Lit:
    """Score the light on the untouched gel alone: no press is needed for it."""
    simulator = Simulator(subject, columns=columns, samples=samples, seed=SEED)
    one, other = (simulator.frame(None, half=half) for half in (0, 1))
    return Lit(uniformity(simulator.design, one, other, SEED), one.warnings)


def least_height_mm(table: pd.DataFrame) -> float:
    """Lowest height at which the light is even enough, between the heights tried; not a number if none is."""
    height, even = table["leds.height_mm"].to_numpy(float), table["uniformity_u0"].to_numpy(float)
    enough = np.flatnonzero(even >= NEEDED_U0)
    if not len(enough):
        return float("nan")
    first = int(enough[0])
    if first == 0:
        return float(height[0])
    return float(np.interp(NEEDED_U0, even[first - 1 : first + 1], height[first - 1 : first + 1]))


def picture(table: pd.DataFrame, least_mm: dict[str, float], path: Path) -> None:
    """Draw evenness over height by each model, and where it suffices."""
    colours = {DRAWN: "tab:gray", CORRECTED: "tab:blue", TRUE: "black"}
    figure = new_figure(6.4, 4.0, dots_per_inch=120)
    axis = figure.subplots()
    for name, rows in table.groupby("model", sort=False):
        colour = colours.get(str(name), "tab:blue")
        shown = str(name) in colours
        axis.plot(
            rows["leds.height_mm"],
            rows["uniformity_u0"],
            color=colour,
            alpha=1.0 if shown else 0.3,
            linestyle="--" if name == TRUE else "-",
            marker="o" if shown else "",
            label=f"{name}: {least_mm[str(name)]:.1f} mm" if shown else None,
        )
    axis.axhline(NEEDED_U0, color="tab:red", linewidth=1)
    axis.set(xlabel="height of the LED panels (mm)", ylabel="U0 of the worst LED group")
    axis.legend(title="least height, by the")
    write_figure(figure, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument(
        "--draws", type=int, default=DRAWS, help="draws of the corrected model (default: %(default)s)"
    )
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    story = run(arguments.out, draws=arguments.draws)
    print(f"verdict: {story.verdict}; named: {', '.join(story.named) or 'nothing'}")
    print("least height of the LED panels (mm):")
    for name, height_mm in story.least_mm.items():
        print(f"  by the {name}: {height_mm:.2f}")
    for warning in dict.fromkeys(story.table.get("warnings", pd.Series(dtype=str)).dropna()):
        print(f"warning: {warning}")
    print(f"diagnosis: {arguments.out / 'diagnosis' / 'report.html'}")


if __name__ == "__main__":
    main()
