"""How large a lab's dirt makes effects that are not there.

    python benchmarks/dirt_sizes.py FOLDER [--also FOLDER ...] [--write]

The sets are those of the calibration pool with dirt that hide nothing; they are made in FOLDER. Each is
fitted by the model as given, as a diagnosis begins, and every effect to what is left, by linear
approximation. `--also` names folders of benchmarks: their sets with dirt that hide nothing count too. Printed
is the size by effect, in prior standard deviations, what it was before, how far the furthest set is away,
where 1 is what chance may do, and whether dirt looks like the effect. `--write` puts it in place of what is
known.
"""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import designlab
from designlab.core.store import read_json
from designlab.core.types import Array
from designlab.inference.calibration.poses import posed
from designlab.inference.diagnosis.diagnose import COLUMNS, SAMPLES, begun
from designlab.inference.diagnosis.likelihood.empirical_errors import FILE, known, over_dirt
from designlab.inference.diagnosis.selection.screening import alone, of_all
from designlab.measurement import load_measurement
from designlab.measurement.usable_frames import MOST_PRESSES, observe_apart, spread_out
from designlab.sensor.design import preset
from designlab.simulation.effects import UNASKED, SensorModel, effect
from designlab.simulation.render_cache import Renders
from designlab.validation.blind.learn import dirt_sd, like_dirt
from designlab.validation.blind.runner import SEED, planted
from designlab.validation.blind.sealed_pools import calibration

KEPT = Path(designlab.__file__).parent / "inference" / "diagnosis" / "likelihood" / FILE
Told = dict[str, tuple[Array, Array]]


def main() -> None:
    """Make sets, fit, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--also", type=Path, nargs="+", default=[], help="folders of benchmarks")
    parser.add_argument("--write", action="store_true", help=f"to {KEPT.name}")
    args = parser.parse_args()
    for other in args.also:
        if not (other / "outcomes").is_dir():
            raise SystemExit(f"--also: {other} holds no outcomes of `designlab gap benchmark`")
    sets = [told(path, design, args.folder) for path, design in _sets(args.folder, args.also)]
    sizes, alike = dirt_sd(sets), like_dirt(sets)
    print(f"{len(sets)} sets: effect, size in prior standard deviations, before, furthest set")
    for name, size in sizes.items():
        furthest = max(_over(*found[name], size) for found in sets if name in found)
        before, told_ = known()["dirt_sd"].get(name, 0.0), "looks like dirt" if name in alike else ""
        print(f"{name:18s} {size:.3f}  {before:.3f}  {furthest:.2f}  {told_}")
    if args.write:
        KEPT.write_text(
            json.dumps({**read_json(KEPT), "dirt_sd": sizes, "like_dirt": alike}, indent=2) + "\n"
        )


def _sets(folder: Path, others: list[Path]) -> Iterator[tuple[Path, str]]:
    """Paths of sets that hide nothing, and their designs."""
    for trial in calibration(dirt=True):
        if trial.kind == "nothing":
            yield planted(trial, folder), trial.design
    for other in others:
        for path in sorted((other / "outcomes").glob("*.json")):
            trial = read_json(path)["trial"]
            if trial["dirt"] and not trial["effects"] and not trial["outside"]:
                yield other / "sets" / path.stem, trial["design"]


def told(path: Path, name: str, folder: Path) -> Told:
    """Information about every effect of a set, and its right side; kept beside the renders."""
    kept = folder / "told" / f"{path.name}.npz"
    if not kept.is_file():
        kept.parent.mkdir(parents=True, exist_ok=True)
        found = _fitted(path, SensorModel.of(preset(name)), folder / "renders" / name)
        np.savez(kept, **{f"{e} {k}": part for e, parts in found.items() for k, part in enumerate(parts)})
        print(f"{path.name}: fitted", flush=True)
    with np.load(kept) as parts:
        return {e: (parts[f"{e} 0"], parts[f"{e} 1"]) for e in dict.fromkeys(k.split()[0] for k in parts)}


def _fitted(path: Path, model: SensorModel, renders: Path) -> Told:
    design = model.effective_design()
    measurement = posed(load_measurement(path), design, seed=SEED).measurement
    seen = spread_out(observe_apart(measurement, design, columns=COLUMNS), MOST_PRESSES)
    source, train = Renders(renders, SAMPLES, SEED), seen.of("dark", "background", "train")
    names = [
        name
        for name in UNASKED
        if not effect(name).drawn and effect(name).parameters_under(design, seen.presses)
    ]
    fitter, state = begun(seen, model, names, source)
    whole = of_all(fitter, state, names, train)
    shapes = {name: [p.name for p in fitter.forward.parameters[name] if p.shape] for name in names}
    return {name: alone(whole, name, names, along=shapes[name]) for name in names}


def _over(told: Array, right: Array, size: float) -> float:
    """How far the fitted value of a set is from null, over what chance and dirt may do."""
    return over_dirt(np.linalg.solve(told + np.eye(len(right)), right), told, size)


if __name__ == "__main__":
    main()
