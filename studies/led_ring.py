"""Height and tilt of the LED panels of a flat GelSight.

They decide how evenly the gel is lit and how well a press can be reconstructed from its picture. The study
starts from the 2020 prototype and searches for better designs; where the two aims disagree it finds those
between which one has to choose.

    python studies/led_ring.py --out led-ring-out --trials 40

The same command again goes on where it ended. Results: the folder of the study, with ``report.html``.
"""

import argparse
from pathlib import Path

from designlab.optimization.study import Parameter, Plan, Results, Study, run_study
from designlab.report.study import study_report
from designlab.sensor.design import preset

BASE = "gelsight-2020-flat"
HEIGHT_MM = (4.0, 14.0)  # of the panels' centre above the membrane; lower, the boards touch it
TILT_DEG = (-10.0, 60.0)  # towards the membrane
TRIALS = 40
FIDELITY = "fast"
SEED = 1
PLAN = Plan(promoted=4, confirmed=2)  # of the best, evaluated again with fresh seeds and more effort


def run(out: Path, *, trials: int = TRIALS, workers: int = 1) -> Results:
    """Run or resume the study and write its report."""
    study = Study(
        name="LED ring",
        base=preset(BASE),
        parameters={
            "leds.height_mm": Parameter(low=HEIGHT_MM[0], high=HEIGHT_MM[1]),
            "leds.tilt_deg": Parameter(low=TILT_DEG[0], high=TILT_DEG[1]),
        },
        objectives={"uniformity_u0": "maximise", "normal_error_median_deg": "minimise"},
        trials=trials,
        fidelity=FIDELITY,
        seed=SEED,
        plan=PLAN,
    )
    results = run_study(study, out=out, trials=trials, workers=workers)
    study_report(results)
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument(
        "--trials", type=int, default=TRIALS, help="designs to evaluate (default: %(default)s)"
    )
    parser.add_argument("--workers", type=int, default=1, help="processes (default: %(default)s)")
    arguments = parser.parse_args()
    results = run(arguments.out, trials=arguments.trials, workers=arguments.workers)
    columns = ["trial", "pick", *results.study.parameters, *results.study.objectives]
    print(results.picks[columns].to_string(index=False))
    print(f"report: {arguments.out / 'report.html'}")


if __name__ == "__main__":
    main()
