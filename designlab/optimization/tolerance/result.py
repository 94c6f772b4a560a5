"""What copies of a design scored: how many are good, how scores vary, and which spread is to blame."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from designlab.core.plain import plain
from designlab.core.store import read_json
from designlab.optimization.constraint import Bound
from designlab.optimization.tolerance.distributions import Spread

if TYPE_CHECKING:
    import pandas as pd

NOMINAL = -1
"""Number of the drawing among its copies."""

RUN_FILE = "tolerance.json"
COPIES_FOLDER = "copies"
USUAL = ("uniformity_u0", "normal_error_median_deg")
FEWEST = 40  # copies below which nothing is said of which spread is to blame
RESAMPLES = 200


@dataclass(frozen=True)
class Tolerance:
    """Copies of a design and their scores.

    Attributes
    ----------
    folder : Path
        Where they lie.
    design : str
        Name of the design.
    spec : mapping of str to Bound
        What scores a copy must reach to be good.
    frame : DataFrame
        One row a copy: ``copy`` (`NOMINAL` is the drawing), a column for each thing drawn (in standard
        deviations), ``built``, ``reason`` (why it could not be built, or not be evaluated), and for each
        score its value and ``<score>_se``.
    inputs : tuple of str
        Columns of what is drawn.
    units : mapping of str to str
        Unit of each score.
    spreads : tuple of Spread
        What was drawn from.
    calibrate : str
        Whether ``each`` copy was calibrated or the drawing ``once``.
    """

    folder: Path
    design: str
    spec: Mapping[str, Bound]
    frame: "pd.DataFrame"
    inputs: tuple[str, ...]
    units: Mapping[str, str]
    spreads: tuple[Spread, ...] = ()
    calibrate: str = "each"

    @property
    def scores(self) -> tuple[str, ...]:
        """Names of the scores."""
        return tuple(self.units)

    @property
    def nominal(self) -> "pd.Series[Any]":
        """Scores of the drawing."""
        return self.frame[self.frame["copy"] == NOMINAL].iloc[0]

    @property
    def copies(self) -> "pd.DataFrame":
        """The copies without the drawing."""
        return self.frame[self.frame["copy"] != NOMINAL]

    def built(self) -> "pd.DataFrame":
        """The copies that could be built and evaluated."""
        return self.copies[self.copies["reason"] == ""]

    @property
    def failed(self) -> "pd.DataFrame":
        """The copies that could be built and of which no score could be had; nothing is said of them."""
        return self.copies[self.copies["built"].astype(bool) & (self.copies["reason"] != "")]

    @property
    def unbuilt(self) -> "pd.DataFrame":
        """The copies that could not be built."""
        return self.copies[~self.copies["built"].astype(bool)]

    def headline(self) -> tuple[str, ...]:
        """Scores to look at first: those of the specification, or the usual ones."""
        return tuple(self.spec) or tuple(name for name in USUAL if name in self.units) or self.scores[:2]

    def good(self) -> "pd.Series[bool]":
        """Whether each copy could be built and meets the specification; those that failed are left out."""
        import pandas as pd

        copies = self.copies.drop(self.failed.index)
        fine = copies["built"].astype(bool)
        for name, bound in self.spec.items():
            values = copies[name].to_numpy(dtype=float)
            fine &= pd.Series([bound.broken_by(v) <= 0 for v in values], index=copies.index)
        return fine

    def passed(self) -> dict[str, float]:
        """Share of good copies with its 95 % interval (Clopper and Pearson 1934)."""
        from scipy.stats import binomtest

        good = self.good()
        if good.empty:
            return {"share": math.nan, "low": 0.0, "high": 1.0}
        interval = binomtest(int(good.sum()), len(good)).proportion_ci(0.95, method="exact")
        return {"share": float(good.mean()), "low": float(interval.low), "high": float(interval.high)}

    def yield_curve(self, score: str, *, at_least: bool = False, points: int = 101) -> "pd.DataFrame":
        """Share of copies that would be good if a score were bounded by each value alone.

        Parameters
        ----------
        at_least : bool
            Whether a copy must have at least the value; at most otherwise.

        Returns
        -------
        DataFrame
            ``value`` and ``share``, of all copies: unbuilt ones are never good.
        """
        import pandas as pd

        values = np.sort(self.built()[score].dropna().to_numpy(dtype=float))
        grid = np.linspace(values[0], values[-1], points) if len(values) else values
        below = np.searchsorted(values, grid, side="left" if at_least else "right")
        share = (len(values) - below if at_least else below) / max(len(self.good()), 1)
        return pd.DataFrame({"value": grid, "share": share})

    def to_json(self) -> dict[str, Any]:
        """Plain data: how many are good, how scores vary, what is to blame."""
        built = self.built()
        spread = {
            name: {
                "unit": self.units[name],
                "nominal": plain(self.nominal[name]),
                "mean": plain(built[name].mean()),
                "sd": plain(built[name].std()),
                "low_5": plain(built[name].quantile(0.05)),
                "high_95": plain(built[name].quantile(0.95)),
            }
            for name in self.scores
        }
        blame = {name: self.offenders(name) for name in self.headline()}
        return {
            "design": self.design,
            "folder": str(self.folder),
            "copies": len(self.copies),
            "calibrate": self.calibrate,
            "unbuilt": len(self.unbuilt),
            "failed": len(self.failed),
            "spec": {name: bound.model_dump(exclude_none=True) for name, bound in self.spec.items()},
            "good": self.passed() if self.spec else None,
            "scores": spread,
            "offenders": {
                name: [] if found is None else found.to_dict(orient="records")
                for name, found in blame.items()
            },
        }

    def offenders(self, score: str) -> "pd.DataFrame | None":
        """Share of a score's variance that each thing drawn is to blame for, worst first.

        First-order indices by random balance designs (Tarantola 2006, unbiased after Tissot 2012), which
        need no copies of their own; computed by SALib.

        Returns
        -------
        DataFrame or None
            ``input``, ``share`` and ``ci``, half its 95 % interval by resampling; None if copies are few, or
            do not differ.
        """
        import pandas as pd
        from SALib.analyze import rbd_fast

        built = self.built().dropna(subset=[score])
        if len(built) < FEWEST or not built[score].std() > 0:
            return None
        problem = {
            "num_vars": len(self.inputs),
            "names": list(self.inputs),
            "bounds": [[-3.0, 3.0]] * len(self.inputs),
        }
        found = rbd_fast.analyze(
            problem,
            built[list(self.inputs)].to_numpy(dtype=float),
            built[score].to_numpy(dtype=float),
            M=4,
            num_resamples=RESAMPLES,
            seed=0,
        )
        table = pd.DataFrame({"input": self.inputs, "share": found["S1"], "ci": found["S1_conf"]})
        return table.sort_values("share", ascending=False, ignore_index=True)


def copy_path(folder: Path, number: int) -> Path:
    """Where the scores of a copy, or of the drawing, are kept."""
    return folder / COPIES_FOLDER / ("nominal.json" if number == NOMINAL else f"{number:05d}.json")


def is_finished(folder: Path, number: int) -> bool:
    """Whether nothing is left to do for a copy: what failed is tried again."""
    path = copy_path(folder, number)
    return path.is_file() and "failed" not in read_json(path)


def load_tolerance(folder: str | Path) -> Tolerance:
    """Read what copies of a design scored so far.

    Raises
    ------
    ValueError
        If the folder holds no run, or not yet a copy, or a file there is damaged.
    """
    import pandas as pd

    folder = Path(folder)
    path = folder / RUN_FILE
    if not path.is_file():
        raise ValueError(f"{folder}: holds no tolerance run ({RUN_FILE} is expected)")
    run = read_json(path)
    paths = (copy_path(folder, number) for number in range(NOMINAL, run["copies"]))
    records = [read_json(own) for own in paths if own.is_file()]
    inputs = tuple(next((r["deviates"] for r in records if r["deviates"]), {}))
    units = {name: estimate["unit"] for r in records for name, estimate in r.get("scores", {}).items()}
    if not inputs or not units:
        reason = next((f", since {r['failed']}" for r in records if "failed" in r), "")
        raise ValueError(f"{folder}: no copy is evaluated yet{reason}")
    require_scores(run["spec"], units)
    frame = pd.DataFrame([_row(record, inputs, tuple(units)) for record in records])
    spec = {name: Bound.model_validate(bound) for name, bound in run["spec"].items()}
    spreads = tuple(Spread.model_validate(spread) for spread in run["spreads"])
    return Tolerance(folder, run["design"], spec, frame, inputs, units, spreads, run.get("calibrate", "each"))


def require_scores(spec: Collection[str], known: Collection[str]) -> None:
    """Refuse a specification of scores that an evaluation does not give."""
    if unknown := [name for name in spec if name not in known]:
        raise ValueError(f"spec: {', '.join(unknown)}: no such score; known are {', '.join(known)}")


def _row(record: Mapping[str, Any], inputs: tuple[str, ...], scores: tuple[str, ...]) -> dict[str, Any]:
    reason = next((str(record[why]) for why in ("unbuilt", "infeasible", "failed") if why in record), "")
    built = not reason or "failed" in record
    row: dict[str, Any] = {"copy": record["copy"], "built": built, "reason": reason}
    row |= {name: record["deviates"].get(name, 0.0) for name in inputs}
    for name in scores:
        estimate = record.get("scores", {}).get(name, {})
        row[name], row[f"{name}_se"] = (
            np.nan if estimate.get(key) is None else estimate[key] for key in ("value", "se")
        )
    return row
