"""Commands about the gap between a model and a measurement: plant and diagnose."""

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from designlab.app.cli.console import Result
from designlab.app.cli.shared import as_understood, table
from designlab.core.progress import IN_PERCENT, bar
from designlab.core.run_folder import require_writable

if TYPE_CHECKING:
    from designlab.inference.diagnosis import GapReport
    from designlab.validation.blind import Crew, Trial


def plant(args: Namespace) -> Result:
    """Generate a measurement with hidden effects."""
    from designlab.simulation.effects.model import load_model
    from designlab.validation.synthetic import answer_path, seal_path
    from designlab.validation.synthetic import plant as generate
    from designlab.validation.synthetic.effects import draw
    from designlab.validation.synthetic.generator_sensor import Rig

    model = load_model(args.design)
    if model.effects:
        raise ValueError(
            f"{args.design}: must be a design, since the generator has its own form of every effect; those "
            f"of this sensor model ({', '.join(a.name for a in model.effects)}) can be planted by --effect "
            "NAME:PARAMETER=VALUE,..."
        )
    design = model.design
    wanted = [_effect(text) for text in args.effect]
    names = [name for name, _ in wanted]
    if len(set(names)) < len(names):
        raise ValueError(f"--effect: each effect once, got {', '.join(names)}")
    effects = {
        name: values or draw(name, Rig.of(design), strength=args.strength, seed=args.seed)
        for name, values in wanted
    }
    outside = dict(_outside(text) for text in args.outside)
    require_writable(args.out, made_with="measurement.toml")
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
            outside=outside,
            dirt=args.dirt,
            noted=args.noted,
            placed=not args.unplaced,
            progress=progress,
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
    from designlab.app.python import PAGE, diagnosed
    from designlab.measurement import load_measurement
    from designlab.simulation.effects.model import load_model

    measurement, model = load_measurement(args.measurement), load_model(args.model)
    meshes = measurement.meshes()
    page = Path(args.out) / PAGE
    with bar(form=IN_PERCENT, keep=True) as progress:
        found, content = diagnosed(
            measurement,
            model,
            args.out,
            seed=args.seed,
            effects=args.effects,
            presses=args.most_presses,
            trust=args.trust,
            renders=args.renders,
            progress=progress,
        )
    lines = [_summary(found), *map(str, meshes), f"report: {page}"]
    return Result({**content, **as_understood(meshes), "report": str(page)}, "\n".join(lines))


def benchmark(args: Namespace) -> Result:
    """Diagnose a pool of generated sets and score the diagnoses."""
    from designlab.core.store import write_json
    from designlab.report.pool import pool_report
    from designlab.validation.blind import Crew, record, run, scored
    from designlab.validation.blind.learn import learnt
    from designlab.validation.blind.records import key, missing, read_records, write_records

    trials = _trials(args)
    before = {} if args.records is None else read_records(Path(args.records))
    require_writable(args.out)
    crew = Crew(args.workers, args.dask)
    if args.transfer:
        return _transferred(trials, Path(args.out), crew)
    if args.further:
        return _further(trials, Path(args.out), crew)
    with bar("set") as progress:
        todo = missing(trials, before)
        outcomes = run(todo, Path(args.out), progress=progress, crew=crew)
    records = before | {key(trial): record(o) for trial, o in zip(todo, outcomes, strict=True)}
    found = scored([records[key(trial)] for trial in trials])
    write_json(Path(args.out) / "score.json", found)
    write_records(Path(args.out) / "records.jsonl", records.values())
    page = pool_report(found, Path(args.out) / "report.html", title=_title(args))
    # Part of a pool, or of a kit, is not to be learnt from.
    if len(outcomes) == len(trials) and not args.only and args.shard is None and args.kit == "hour":
        if args.pool == "power":
            write_json(Path(args.out) / "limits.json", found["limits"])
        if args.pool == "calibration":
            write_json(Path(args.out) / "learnt.json", learnt(outcomes))
    rows = [
        (
            row["set"],
            row["design"],
            row["verdict"].split(":")[0],
            ", ".join(row["named"]) or "-",
            "-" if row["gap_removed"] is None else f"{row['gap_removed']:.0%}",
        )
        for row in found["rows"]
    ]
    text = table(("set", "design", "verdict", "named", "gap removed"), rows)
    lines = [_limits(found["limits"])] if args.pool == "power" else _rates(found)
    return Result(found, "\n".join([text, *lines, f"report: {page}"]))


def _title(args: Namespace) -> str:
    """Heading of the page about a pool, or about the part of it that was run."""
    part = ["sensors with a lab's dirt"] if args.dirt else []
    part += [f"part {args.shard}"] if args.shard else []
    part += [f"sets that match {args.only}"] if args.only else []
    part += [f"kit {args.kit}"] if args.kit != "hour" else []
    part += ["opened before, run again by later code"] if args.again else []
    return ", ".join([f"Diagnoses of the pool {args.pool}", *part])


def _trials(args: Namespace) -> "list[Trial]":
    """Sets that the arguments ask for."""
    import re
    from dataclasses import replace

    from designlab.validation.blind import calibration, development, power, quick, sealed, transfers
    from designlab.validation.blind.frozen import frozen
    from designlab.validation.blind.pool import shard

    try:
        wanted = re.compile(args.only)
    except re.error as error:
        raise ValueError(f"--only: must be a regular expression, got {args.only!r}: {error}") from None
    if args.transfer and args.kit != "hour":
        raise ValueError("--transfer: is for --kit hour")
    if args.transfer and args.further:
        raise ValueError("--further: cannot be asked for together with --transfer")
    if args.records is not None and (args.transfer or args.further):
        raise ValueError("--records: hold scores alone, --transfer and --further need the sets themselves")
    if (args.pool == "test") != (args.frozen is not None):
        raise ValueError(
            "--frozen: the commit that froze the thresholds goes with --pool test, and only there"
        )
    if args.again and args.pool != "test":
        raise ValueError("--again: is for --pool test")
    if args.base and args.pool not in ("development", "power"):
        raise ValueError(f"--base: --pool {args.pool} has seeds of its own")
    if args.dirt and args.pool not in ("calibration", "test"):
        raise ValueError("--dirt: is for --pool calibration and --pool test")
    if args.pool == "test":
        pool = sealed(frozen(args.frozen, again=args.again), dirt=args.dirt)
    elif args.pool == "calibration":
        pool = calibration(dirt=args.dirt)
    elif args.pool == "quick":
        pool = quick()
    elif args.pool == "power":
        pool = power(base=args.base)
    else:
        pool = development(base=args.base)
    trials = [trial for trial in shard(pool, args.shard) if wanted.search(trial.name)]
    if not trials:
        raise ValueError(f"--only: no set's name matches {args.only!r}, of {len(pool)} in the pool")
    if args.transfer:
        number = len(trials)
        trials = transfers(trials)
        if not trials:
            raise ValueError(
                f"--transfer: none of these {number} sets hides one effect that holds for other designs"
            )
    return [replace(trial, kit=args.kit) for trial in trials]


def _rates(found: dict[str, Any]) -> list[str]:
    """Lines that say how often names were right, and what was gained."""
    single, pair = found["single"], found["pair"]
    said = {
        "nothing hidden, a name given": found["nothing"]["named"],
        "one effect hidden, right name first": single["right_first"],
        "one effect hidden, in the reported set": single["truth_in_set"],
        "one effect hidden, named with a confidence of 0.9 or more": single["sure"],
        "one effect hidden, a further name that is wrong": single["further_wrong"],
        "two effects hidden, both named": pair["all_named"],
        "outside the catalogue, a name without reserve": found["outside"]["named_or_ambiguous"],
        "outside the catalogue, unexplained, partial or refused": found["outside"]["abstained"],
        "left out of the catalogue, another named": found["left_out"]["named"],
        "left out of the catalogue, ambiguous or another named": found["left_out"]["named_or_ambiguous"],
        "intervals that hold the truth": single["intervals_hold"],
        "names with a confidence of 0.9 or more that are right": found["sure_names"],
    }
    lines = [f"{what}: {_share(of)}" for what, of in said.items() if of is not None]
    medians = {
        "gap removed on presses used for nothing else": "gap_removed_median",
        "the same by a wrong effect of that size": "control_removed_median",
        "error of values, over their distance from null": "value_error_median",
    }
    for family, of in (("one effect", single), ("two effects", pair)):
        lines += [
            f"{family}, {what}, median: {of[key]:.0%}" for what, key in medians.items() if of[key] is not None
        ]
    if single["set_size_mean"] is not None:
        lines.append(f"one effect, names in a set, mean: {single['set_size_mean']:.2f}")
    if found["confidence"] is not None:
        lines.append(
            f"confidence of {found['confidence']['names']} names off by {found['confidence']['error']:.2f}"
        )
    if (curve := found["risk_coverage"]) is not None:
        lines.append(
            f"area under the risk-coverage curve of {curve['names']} first names: {curve['area']:.4f}"
        )
    return lines


def _share(of: dict[str, Any]) -> str:
    return f"{of['share']:.0%} of {of['sets']} ({of['low']:.0%} to {of['high']:.0%})"


def _limits(limits: dict[str, Any]) -> str:
    """Table of detection limits, smallest first."""
    rows = [
        (
            kind,
            f"{limit['strength']:.2g}",
            *(_end(limit[end]) for end in ("low", "high")),
            ", ".join(f"{of:.2g} ({design})" for design, of in limit["designs"].items()),
            limit["in_units"],
        )
        for kind, limit in sorted(limits.items(), key=lambda item: item[1]["strength"])
    ]
    heads = ("effect", "named in half of the sets at (prior sd)", "low", "high", "by design", "in units")
    return table(heads, rows)


def _end(value: float | None) -> str:
    return "open" if value is None else f"{value:.2g}"


def _transferred(trials: "list[Trial]", folder: Path, crew: "Crew") -> Result:
    """Put what was learnt on each set's design on another one, and say how much better that is predicted."""
    from designlab.core.store import write_json
    from designlab.validation.blind import run_transfers
    from designlab.validation.blind.transfer import summary

    with bar("set") as progress:
        found = summary(run_transfers(trials, folder, progress=progress, crew=crew))
    write_json(folder / "transfer.json", found)
    rows = [
        (
            row["set"],
            row["design"],
            ", ".join(row["named"]) or "-",
            ", ".join(row["left"]) or "-",
            *(f"{row[name]:.3g}" for name in ("before", "after", "floor")),
            "-" if row["removed"] is None else f"{row['removed']:.0%}",
        )
        for row in found["rows"]
    ]
    lines = [table(("set", "design", "named", "left behind", "before", "after", "floor", "removed"), rows)]
    if "median" in found:
        lines.append(
            f"gap removed on the other design, median of {found['sets'] - found['without_gap']} sets: "
            f"{found['median']:.0%}, 95 % interval {found['low']:.0%} to {found['high']:.0%}"
        )
    if found["without_gap"]:
        lines.append(f"{found['without_gap']} sets are predicted as well without a correction")
    return Result(found, "\n".join(lines))


def _further(trials: "list[Trial]", folder: Path, crew: "Crew") -> Result:
    """Take the frames that ambiguous reports ask for, and see what is left of each set of names."""
    from designlab.core.store import write_json
    from designlab.validation.blind.further import run_further, summary

    with bar("set") as progress:
        found = summary(run_further(trials, folder, progress=progress, crew=crew))
    write_json(folder / "further.json", found)
    rows = [
        (
            row["set"],
            "+".join(row["hidden"]),
            "; ".join(", ".join(names) for names in row["sets"]),
            row["verdict"],
            "; ".join(", ".join(names) for names in row["sets_after"]) or "-",
        )
        for row in found["rows"]
    ]
    lines = [table(("set", "hidden", "told apart no further", "with the frames asked for", "names"), rows)]
    if found["resolved"] is None:
        lines.append(f"none of {len(trials)} sets is ambiguous")
    else:
        left = _share(found["resolved"])
        lines.append(f"ambiguous sets of which the right name alone is left: {left}")
    return Result(found, "\n".join(lines))


def _summary(report: "GapReport") -> str:
    """The verdict in words, values with intervals, the gap before and after."""
    from designlab.report.gap_text import percent, statement

    lines = [f"verdict: {report.verdict}", *statement(report)]
    rows = [
        (f"{effect.name}.{name}", f"{v.value:.4g}", _interval(v.low, v.high), v.unit.removeprefix("1"))
        for effect in report.effects
        for name, v in effect.parameters.items()
    ]
    if rows:
        lines.append(table(("effect", "value", "95 % interval", "unit"), rows))
    levels = [
        (
            split,
            f"{gap.before:.3g}",
            f"{gap.after:.3g}",
            f"{gap.floor:.3g}",
            f"{gap.usual:.3g}",
            "-" if gap.removed is None else percent(gap.removed),
        )
        for split, gap in report.gap.items()
    ]
    lines.append(table(("squared residual / noise", "before", "after", "floor", "usual", "gap gone"), levels))
    if report.next_measurement.text:
        lines.append(f"measure next: {report.next_measurement}")
    return "\n".join([*lines, *(f"note: {note}" for note in report.notes), f"model: {report.model}"])


def _interval(low: float | None, high: float | None) -> str:
    return "not known" if low is None or high is None else f"{low:.4g} to {high:.4g}"
