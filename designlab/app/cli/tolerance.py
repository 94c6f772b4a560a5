"""The command about copies of a design as they would be built."""

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from designlab.app.cli.console import Result
from designlab.app.cli.shared import table

if TYPE_CHECKING:
    from designlab.optimization.tolerance import Tolerance

SHOWN = 5  # worst offenders that are printed


def tolerance(args: Namespace) -> Result:
    """Evaluate copies of a design, say how many are good and what is to blame."""
    from designlab.optimization.tolerance import Terms, load_terms, tolerance
    from designlab.report.tolerance import tolerance_report
    from designlab.simulation.effects.model import load_model

    model = load_model(args.design)
    terms = Terms() if args.terms is None else load_terms(args.terms)
    found = tolerance(
        model,
        out=args.out,
        copies=args.copies,
        spreads=terms.spread,
        spec=terms.spec,
        fidelity=args.fidelity,
        seed=args.seed,
        calibrate=args.calibrate,
        workers=args.workers,
        dask=args.dask,
    )
    page = tolerance_report(found, Path(args.out) / "report.html")
    return Result({**found.to_json(), "report": str(page)}, f"{_summary(found)}\nreport: {page}")


def _summary(found: "Tolerance") -> str:
    """Share of good copies, how scores vary, and the worst offenders."""
    built = found.built()
    lines = [f"{found.design}: {len(found.copies)} copies, {len(found.unbuilt)} of them cannot be built"]
    if len(found.failed):
        reason = found.failed["reason"].iloc[0]
        lines.append(f"{len(found.failed)} could not be evaluated; the same command tries again: {reason}")
    if found.spec and len(found.good()):
        share = found.passed()
        bounds = ", ".join(f"{name} {bound.text()}" for name, bound in found.spec.items())
        lines.append(
            f"good ({bounds}): {share['share']:.1%}, 95 % interval {share['low']:.1%} to {share['high']:.1%}"
        )
    rows = [
        (
            name,
            f"{found.nominal[name]:.4g}",
            *(f"{value:.4g}" for value in (built[name].mean(), built[name].std())),
            *(f"{value:.4g}" for value in built[name].quantile([0.05, 0.95])),
            found.units[name].removeprefix("1"),
        )
        for name in found.headline()
    ]
    lines.append(table(("score", "drawing", "mean", "sd", "5 %", "95 %", "unit"), rows))
    for name in found.headline():
        blame = found.offenders(name)
        if blame is not None:
            worst = ", ".join(f"{row['input']} {row['share']:.0%}" for _, row in blame.head(SHOWN).iterrows())
            lines.append(f"variance of {name}: {worst}")
    return "\n".join(lines)
