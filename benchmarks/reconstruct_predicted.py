"""What `evaluate` predicts of a design, and what `reconstruct` achieves on pictures of it.

    python benchmarks/reconstruct_predicted.py --out /tmp/achieved --presets default digit360-like

Of each preset, presses of a ball and test presses are rendered and written as picture files, as the camera
of the design takes them: with its noise and its bits. The files go through the doors of `calibrate --balls`
and `reconstruct`. Heights and normals are then compared with the truth on the pixels that `evaluate` counts.
Probes and depths are those of `evaluate`; places, angles, light and noise have other seeds. `NAME+dots` is a
preset with printed markers.

One table is printed and written to OUT/table.txt: preset, score, predicted and achieved with their standard
errors, achieved over predicted, and whether both agree within 10 % or two standard errors of the difference.
What is in OUT already is not rendered again.
"""

import argparse
import csv
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from designlab.core.images import read_picture, write_image
from designlab.core.metrics import normal_error_deg
from designlab.core.store import write_json
from designlab.evaluation.evaluate import evaluate
from designlab.evaluation.press_plan import TEST_PROBES, PressPlan
from designlab.evaluation.protocol import EvaluationProtocol, error_region, sub_seed
from designlab.inference.calibration.ball_set import load_balls
from designlab.inference.calibration.balls import calibrate_balls
from designlab.inference.calibration.from_model import Gel, membrane_of
from designlab.reconstruction import normals
from designlab.reconstruction.calibration_file import save_calibration
from designlab.reconstruction.contact_pressure import Mode
from designlab.reconstruction.reconstructor import Reconstructor
from designlab.sensor.design import Design, preset
from designlab.simulation.contact.press import Press
from designlab.simulation.simulator import Frame, Simulator, exposure
from geometries.elastomer import base_gradient

PRESETS = ("default", "default+dots", "gelsight-2020-dome-elastic", "difftactile-dome-like")
SCORES = ("normal_error_median_deg", "normal_error_mean_deg", "height_mae_um", "height_rmse_um")
WITHIN, SIGMAS = 0.1, 2.0
GRIDS = 2  # of nine balls, of three sizes
BACKGROUNDS = 8  # pictures of the untouched gel
COLUMNS, SAMPLES = 320, 192
DOTS = {"optics.marker_pitch_mm": 1.5, "optics.marker_diameter_mm": 0.35}


class Truth(NamedTuple):
    """What the pixels of a test press see: height, slopes of indentation and base, and where errors count."""

    height_mm: NDArray[np.float64]
    slopes: NDArray[np.float64]
    base: NDArray[np.float64]
    region: NDArray[np.bool_]


class Measured(NamedTuple):
    """A score and its standard error."""

    value: float
    se: float


def sensor(name: str) -> Design:
    """A preset, with printed markers where its name ends in ``+dots``."""
    base, _, dots = name.partition("+")
    return preset(base).replace(DOTS) if dots else preset(base)


def predicted(design: Design, fidelity: str, out: Path) -> dict[str, Measured]:
    """Scores that `evaluate` gives."""
    file = out / f"predicted-{fidelity}.json"
    if not file.is_file():
        found = evaluate(design, fidelity=fidelity, seed=0).score.scores
        file.write_text(json.dumps({name: (found[name].value, found[name].se) for name in SCORES}))
    return {name: Measured(*pair) for name, pair in json.loads(file.read_text()).items()}


class Pictures:
    """Picture files of a design, as its camera takes them.

    Parameters
    ----------
    design : Design
        The sensor.
    seed : int
        Of places, light and noise.
    rounds : int
        Presses of each test probe.
    """

    def __init__(self, design: Design, seed: int, rounds: int) -> None:
        self.design, self.seed = design, seed
        self.simulator = Simulator(design, columns=COLUMNS, samples=SAMPLES, seed=seed)
        self.balls, self.tests = PressPlan.of(design).presses(rounds=rounds, seed=seed, grids=GRIDS)
        self.untouched = self.simulator.frame(None)
        self.protocol = EvaluationProtocol(design, exposure(design, self.untouched), seed)
        self.bits = 8 if design.camera.bit_depth <= 8 else 16

    def write(self, frame: Frame, number: int, path: Path) -> None:
        """Write a picture with noise of its own."""
        picture = np.clip(self.protocol.picture(frame, number), 0, 1)
        write_image(path, picture, bits=self.bits)

    def frames(self, presses: Sequence[Press], stage: int) -> list[Frame]:
        """Render presses."""
        return [
            self.simulator.frame(press, seed=sub_seed(self.seed, stage, number))
            for number, press in enumerate(presses)
        ]

    def make(self, out: Path) -> None:
        """Write all pictures, and the truth of the test presses."""
        for name in ("balls", "presses"):
            (out / name).mkdir(parents=True, exist_ok=True)
        for number in range(BACKGROUNDS):
            self.write(self.untouched, number, out / "balls" / f"background-{number}.png")
        lines = ["file,ball_mm"]
        for number, frame in enumerate(self.frames(self.balls, 1)):
            self.write(frame, 100 + number, out / "balls" / f"ball-{number:02d}.png")
            lines.append(f"ball-{number:02d}.png,{self.balls[number].probe.size_mm:.6g}")
        (out / "balls" / "balls.csv").write_text("\n".join(lines) + "\n")
        truths = []
        for number, frame in enumerate(self.frames(self.tests, 2)):
            self.write(frame, 1000 + number, out / "presses" / f"{number:02d}.png")
            base = base_gradient(self.design.elastomer, *frame.seen_mm)
            truths.append((frame.height_mm, np.array(frame.gradient), np.array(base), error_region(frame)))
        pitch_mm = float(np.mean(self.untouched.rays.pitch_mm))
        write_json(out / "set.json", {"mm_per_px": pitch_mm})
        np.savez_compressed(
            out / "truth.npz",
            **{
                name: np.array(part)
                for name, part in zip(Truth._fields, zip(*truths, strict=True), strict=True)
            },
        )


def calibrated(design: Design, out: Path) -> Path:
    """`designlab calibrate --balls --design` on the written pictures."""
    about = json.loads((out / "set.json").read_text())
    scale = about["mm_per_px"]
    balls = load_balls(
        out / "balls",
        mm_per_px=scale,
        membrane_of=partial(membrane_of, design, mm_per_px=scale),
    )
    found = calibrate_balls(balls, **Gel.of(design)._asdict())
    setup = found.kept.calibration.setup
    told = f"smoothing {setup.smoothing_px:.2f} px, change relative to {setup.relative_to}"
    print(
        f"{out.name}: {'; '.join(balls.notes)}; balls left out {found.mean.contact_deg:.2f} deg; {told}",
        flush=True,
    )
    return save_calibration(out / "calibration.npz", found.kept)


def errors(reconstructor: Reconstructor, image: NDArray[np.float32], truth: Truth) -> tuple[float, ...]:
    """Median and mean angle, mean absolute and mean squared error of height, on the region that counts."""
    shape = reconstructor(image)
    # pictures of a curved gel are laid on a grid, and so is what their pixels see
    truth = Truth(
        reconstructor.laid_out(truth.height_mm),
        np.moveaxis(reconstructor.laid_out(np.moveaxis(truth.slopes, 0, -1)), -1, 0),
        np.moveaxis(reconstructor.laid_out(np.moveaxis(truth.base, 0, -1)), -1, 0),
        reconstructor.laid_out(truth.region.astype(float)) > 0.5,
    )
    slopes = np.array([-shape.normals[..., axis] / shape.normals[..., 2] for axis in (0, 1)])
    angle = normal_error_deg(normals(*(slopes + truth.base)), normals(*(truth.slopes + truth.base)))
    angle, height = angle[truth.region], 1000 * (shape.height_mm - truth.height_mm)[truth.region]
    return (
        float(np.median(angle)),
        float(angle.mean()),
        float(np.abs(height).mean()),
        float((height**2).mean()),
    )


def scores(rows: NDArray[np.float64]) -> dict[str, Measured]:
    """Scores of test presses with standard errors: the scatter of each probe about its own mean."""
    kinds = rows.reshape(-1, len(TEST_PROBES), rows.shape[1])
    rounds = len(kinds)
    scatter = kinds.std(axis=0, ddof=1) if rounds > 1 else np.full(kinds.shape[1:], np.nan)
    mean, se = rows.mean(axis=0), np.sqrt((scatter**2).sum(axis=0) / rounds) / len(TEST_PROBES)
    found = {name: Measured(float(mean[at]), float(se[at])) for at, name in enumerate(SCORES)}
    rmse = float(np.sqrt(mean[3]))
    found["height_rmse_um"] = Measured(rmse, float(se[3] / (2 * rmse)))
    return found


def rows_of(name: str, said: dict[str, Measured], found: dict[str, Measured]) -> list[dict[str, object]]:
    """Rows of the table of one preset."""
    rows = []
    for score in SCORES:
        expected, got = said[score], found[score]
        off = abs(got.value - expected.value)
        within = off <= max(WITHIN * expected.value, SIGMAS * float(np.hypot(expected.se, got.se)))
        rows.append(
            {
                "preset": name,
                "score": score,
                "predicted": expected.value,
                "predicted_se": expected.se,
                "achieved": got.value,
                "achieved_se": got.se,
                "ratio": got.value / expected.value,
                "within": within,
            }
        )
    return rows


def line(row: dict[str, object]) -> str:
    """A row of the table as text."""
    return (
        f"{row['preset']:32} {row['score']:24} {row['predicted']:7.3f} ± {row['predicted_se']:6.3f}   "
        f"{row['achieved']:7.3f} ± {row['achieved_se']:6.3f}   {row['ratio']:5.2f}   "
        f"{'yes' if row['within'] else 'NO'}"
    )


def main() -> None:
    """Render, calibrate, reconstruct, compare."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--presets", nargs="+", default=PRESETS)
    parser.add_argument("--fidelity", default="standard", help="of the prediction")
    parser.add_argument("--rounds", type=int, default=4, help="presses of each of the six test probes")
    parser.add_argument("--seed", type=int, default=1, help="of the pictures; the prediction has 0")
    parser.add_argument("--mode", choices=("accurate", "video"), default="accurate")
    args = parser.parse_args()
    mode: Mode = args.mode
    table: list[dict[str, object]] = []
    for name in args.presets:
        design, out = sensor(name), args.out / name
        out.mkdir(parents=True, exist_ok=True)
        with threadpool_limits(1):
            said = predicted(design, args.fidelity, out)
            if not (out / "truth.npz").is_file():
                Pictures(design, args.seed, args.rounds).make(out)
            reconstructor = Reconstructor.load(calibrated(design, out), mode=mode)
            with np.load(out / "truth.npz") as file:
                truths = [
                    Truth(*parts) for parts in zip(*(file[name] for name in Truth._fields), strict=True)
                ]
            each = [
                errors(reconstructor, read_picture(out / "presses" / f"{number:02d}.png"), truth)
                for number, truth in enumerate(truths)
            ]
        write_json(out / "presses.json", each)
        rows = rows_of(name, said, scores(np.array(each)))
        print("\n".join(map(line, rows)), flush=True)
        table += rows
    with (args.out / "table.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(table[0]))
        writer.writeheader()
        writer.writerows(table)
    (args.out / "table.txt").write_text("\n".join(map(line, table)) + "\n")
    held = sum(bool(row["within"]) for row in table)
    print(f"{held} of {len(table)} scores within {WITHIN:.0%} or {SIGMAS:g} standard errors")


if __name__ == "__main__":
    main()
