"""Commands about the gap between a model and a measurement: plant and diagnose."""

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from designlab.cli.console import Result
from designlab.cli.shared import bar, results_folder, table

if TYPE_CHECKING:
    from designlab.gap import GapReport


def plant(args: Namespace) -> Result:
    """Generate a measurement with hidden effects."""
    from designlab.effects.model import load_model
    from designlab.plant import answer_path, seal_path
    from designlab.plant import plant as generate
    from designlab.plant.effects import draw
    from designlab.plant.rig import Rig

    design = load_model(args.design).effective_design()
    wanted = [_effect(text) for text in args.effect]
    names = [name for name, _ in wanted]
    if len(set(names)) < len(names):
        raise ValueError(f"--effect: each effect once, got {', '.join(names)}")
    effects = {
        name: values or draw(name, Rig.of(design), strength=args.strength, seed=args.seed)
        for name, values in wanted
    }
    outside = [_outside(text) for text in args.outside]
    with bar("frame") as progress:
        folder = generate(
            design,
            effects=effects,
            out=args.out,
            seed=args.seed,
            kit=args.kit,
            kit_seed=args.kit_seed,
            columns=args.columns,
            flat_field=args.flat_field,
            outside=dict(outside),
            progress=lambda done, total: progress("planting", done, total),
        )
    data = {"measurement": str(folder), "answer": str(answer_path(folder)), "seal": str(seal_path(folder))}
    text = (
        f"measurement: {folder}\n"
        f"answer (do not look before the diagnosis): {answer_path(folder)}\n"
        f"seal: {seal_path(folder)}"
    )
    return Result(data, text)


def _effect(text: str) -> tuple[str, dict[str, float]]:
    """Read ``name`` or ``name:parameter=value,...``."""
    name, colon, assignments = text.partition(":")
    values: dict[str, float] = {}
    for assignment in assignments.split(",") if colon else []:
        parameter, equals, value = (part.strip() for part in assignment.partition("="))
        if not parameter or not equals:
            raise ValueError(f"--effect: must be NAME[:PARAMETER=VALUE,...], got {text!r}")
        try:
            values[parameter] = float(value)
        except ValueError:
            raise ValueError(f"--effect {name}: {parameter} must be a number, got {value!r}") from None
    return name.strip(), values


def _outside(text: str) -> tuple[str, float]:
    """Read ``kind`` or ``kind:strength``."""
    kind, colon, strength = text.partition(":")
    try:
        return kind.strip(), float(strength) if colon else 1.0
    except ValueError:
        raise ValueError(f"--outside {kind}: strength must be a number, got {strength!r}") from None


def diagnose(args: Namespace) -> Result:
    """Name the effects a model lacks."""
    from designlab.effects.model import load_model
    from designlab.gap import diagnose as find
    from designlab.gap.run import RUN
    from designlab.measurement import load_measurement
    from designlab.report import gap_report

    measurement = load_measurement(args.measurement)
    model = load_model(args.model)
    results_folder(args.out, made_with=RUN)
    page = Path(args.out) / "report.html"
    with bar("picture") as progress:
        report = find(
            measurement,
            model,
            out=args.out,
            seed=args.seed,
            progress=progress,
            renders=None if args.renders is None else Path(args.renders),
            trust=args.trust,
            page=lambda found: gap_report(found.to_json(), page, pictures=found.pictures),
        )
    return Result({**report.to_json(), "report": str(page)}, f"{_summary(report)}\nreport: {page}")


def benchmark(args: Namespace) -> Result:
    """Diagnose a pool of generated sets and score the diagnoses."""
    import re

    from designlab.store import write_json
    from designlab.trials import development, run, score

    try:
        wanted = re.compile(args.only)
    except re.error as error:
        raise ValueError(f"--only: must be a regular expression, got {args.only!r}: {error}") from None
    trials = [trial for trial in development(base=args.base) if wanted.search(trial.name)]
    if not trials:
        raise ValueError(f"--only: no set's name matches {args.only!r}")
    results_folder(args.out)
    with bar("set") as progress:
        found = score(run(trials, Path(args.out), progress=progress))
    write_json(Path(args.out) / "score.json", found)
    rows = [
        (
            row["set"],
            row["design"],
            row["verdict"],
            ", ".join(row["named"]) or "-",
            "-" if row["gap_removed"] is None else f"{row['gap_removed']:.0%}",
        )
        for row in found["rows"]
    ]
    parts = [f"{part}: {found[part]}" for part in ("nothing", "single", "outside")]
    text = table(("set", "design", "verdict", "named", "gap removed"), rows)
    return Result(found, "\n".join([text, *parts]))


def _summary(report: "GapReport") -> str:
    lines = [f"verdict: {report.verdict}"]
    rows = [
        (f"{effect.name}.{name}", f"{v.value:.4g}", f"{v.low:.4g} to {v.high:.4g}", v.unit.removeprefix("1"))
        for effect in report.effects
        for name, v in effect.parameters.items()
    ]
    if rows:
        lines.append(table(("effect", "value", "95 % interval", "unit"), rows))
    for effect in report.effects:
        others = [name for name in effect.coherence_set if name != effect.name]
        if others:
            lines.append(f"{effect.name} cannot be told apart from {', '.join(others)} on these frames")
    rows = [
        (split, f"{gap.before:.3g}", f"{gap.after:.3g}", f"{gap.floor:.3g}")
        for split, gap in report.gap.items()
    ]
    lines.append(table(("squared residual / noise", "before", "after", "floor"), rows))
    if report.next_measurement:
        lines.append(f"measure next: {report.next_measurement}")
    return "\n".join([*lines, *(f"note: {note}" for note in report.notes), f"model: {report.model}"])
