"""Commands about the gap between a model and a measurement: plant and diagnose."""

from argparse import Namespace

from designlab.cli.console import Result
from designlab.cli.shared import bar, results_folder


def plant(args: Namespace) -> Result:
    """Generate a measurement with hidden effects."""
    from designlab.design import load
    from designlab.plant import answer_path, seal_path
    from designlab.plant import plant as generate
    from designlab.plant.effects import draw
    from designlab.plant.rig import Rig

    design = load(args.design)
    wanted = [_effect(text) for text in args.effect]
    names = [name for name, _ in wanted]
    if len(set(names)) < len(names):
        raise ValueError(f"--effect: each effect once, got {', '.join(names)}")
    effects = {
        name: values or draw(name, Rig.of(design), strength=args.strength, seed=args.seed)
        for name, values in wanted
    }
    with bar("frame") as progress:
        folder = generate(
            design,
            effects=effects,
            out=args.out,
            seed=args.seed,
            kit=args.kit,
            columns=args.columns,
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


def diagnose(args: Namespace) -> Result:
    """Name the effects a model lacks."""
    from designlab.effects.model import load_model
    from designlab.gap import diagnose as find
    from designlab.measurement import load_measurement

    measurement = load_measurement(args.measurement)
    model = load_model(args.model)
    results_folder(args.out)
    with bar() as progress:
        report = find(measurement, model, out=args.out, seed=args.seed, progress=progress)
    return Result(report.to_json(), report.summary)
