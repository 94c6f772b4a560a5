"""Command calibrate: the design under which the simulator gives a sensor's pictures."""

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from designlab.app.cli.console import DONE, FAILED, Result
from designlab.app.cli.shared import as_understood, source_named, table
from designlab.core.progress import IN_PERCENT, bar
from designlab.core.run_folder import require_writable

if TYPE_CHECKING:
    from collections.abc import Callable

    from designlab.inference.calibration import Calibration
    from designlab.inference.calibration.ball_set import BallSet
    from designlab.measurement import Measurement
    from designlab.reconstruction.membrane import Membrane
    from designlab.sensor.design import Design
    from designlab.simulation.directional_light import DirectionalLight
    from designlab.simulation.effects.model import SensorModel

DESIGN, RESULT, PICTURE, PAGE = "calibrated.toml", "calibration.json", "residual.png", "report.html"
MAP = "calibration.npz"
OF_DESIGNS = ("measurement", "model", "baseline", "free", "layout")
OF_BALLS = ("ball_mm", "mm_per_px", "thickness_mm", "design", "crop_px")
SHOWN = ("snr_db", "structure_corr", "structure_snr_db")


def calibrate(args: Namespace) -> Result:
    """Fit light, poses and some fields of a design to a measurement, or a map to shape on balls."""
    if args.balls is not None:
        if given := [name for name in OF_DESIGNS if getattr(args, name) not in (None, False)]:
            option = "MEASUREMENT" if given[0] == "measurement" else f"--{given[0]}"
            raise ValueError(f"{option}: fits a design and does not go with --balls; leave one of them out")
        return _on_balls(args)
    if given := [name for name in OF_BALLS if getattr(args, name) is not None]:
        raise ValueError(f"--{given[0].replace('_', '-')}: is for --balls FOLDER; give that, or leave it out")
    if args.measurement is None or args.model is None:
        raise ValueError("calibrate: needs MEASUREMENT and --model MODEL, or --balls FOLDER")
    from designlab.core.store import atomic_folder, write_atomic, write_json
    from designlab.inference.calibration import calibrate as fit
    from designlab.inference.calibration.layout import as_searched, layout_words
    from designlab.inference.calibration.verdict import fit_verdict
    from designlab.measurement import load_measurement
    from designlab.report.calibration import calibration_report
    from designlab.report.calibration_pictures import residual_plot
    from designlab.report.figures import write_figure

    measurement = load_measurement(args.measurement)
    meshes = measurement.meshes()
    model, drawn, free = _start(args), None, args.free
    require_writable(args.out, made_with=RESULT)
    if args.layout:
        drawn, model, free = _laid_out(args, measurement, model)
    with bar(form=IN_PERCENT, keep=True) as progress, source_named(args.model):
        found = fit(
            measurement,
            model,
            columns=args.columns,
            seed=args.seed,
            free=free,
            trust=args.trust,
            drawn=drawn,
            progress=progress,
        )
    if drawn is not None:
        found = as_searched(found, model.design)
    out, verdict = Path(args.out), fit_verdict(found)
    data = found.to_json() | {"fit_verdict": verdict.word, "reasons": list(verdict.reasons)}
    with atomic_folder(out, replace=True) as folder:
        write_atomic(folder / DESIGN, found.model.dumps())
        write_json(folder / RESULT, data)
        residual = write_figure(residual_plot(found), folder / PICTURE)
        calibration_report(found, verdict, folder / PAGE, design=str(out / DESIGN), residual=residual)
    files = {"design": DESIGN, "result": RESULT, "picture": PICTURE, "report": PAGE}
    data |= as_understood(meshes)
    data["files"] = {what: str(out / name) for what, name in files.items()}
    words = [] if drawn is None else layout_words(found, drawn, verdict.word)
    data |= {"layout": words} if words else {}
    lines = [
        f"fit: {verdict.word}",
        *(f"reason: {reason}" for reason in verdict.reasons),
        *words,
        _summary(found),
        *map(str, meshes),
        f"design: {out / DESIGN}",
        f"report: {out / PAGE}",
    ]
    return Result(data, "\n".join(lines), FAILED if verdict.word == "failed" else DONE)


def _laid_out(
    args: Namespace, measurement: "Measurement", model: "SensorModel | DirectionalLight"
) -> "tuple[Design, SensorModel, list[str]]":
    """The design as drawn, a model with the groups where the pictures show them, and what a fit frees."""
    from designlab.inference.calibration.layout import layout_fields, search_layout
    from designlab.simulation.effects.model import SensorModel

    if not isinstance(model, SensorModel) or model.effects:
        raise ValueError("--layout: starts from a design without effects")
    with bar(form=IN_PERCENT) as progress:
        found = search_layout(measurement, model.design, seed=args.seed, progress=progress)
    start, paths = layout_fields(found.design)
    return model.design, SensorModel(design=start), [*paths, *(args.free or [])]


def _on_balls(args: Namespace) -> Result:
    """Teach a map from pictures to shape on ball presses, and write it as one file."""
    from designlab.core.store import atomic_folder, write_json
    from designlab.inference.calibration.ball_set import load_balls
    from designlab.inference.calibration.balls import calibrate_balls
    from designlab.inference.calibration.from_model import Gel
    from designlab.reconstruction.calibration_file import save_calibration
    from designlab.report.ball_calibration import ball_calibration_report

    design = _design(args)
    balls = load_balls(
        args.balls,
        ball_mm=args.ball_mm,
        mm_per_px=args.mm_per_px,
        membrane_of=None if design is None else _membrane_of(args, design),
    )
    gel = {} if design is None else Gel.of(design)._asdict()
    if args.thickness_mm is not None:
        gel["thickness_mm"] = args.thickness_mm
    require_writable(args.out, made_with=RESULT)
    with bar(form=IN_PERCENT, keep=True) as progress:
        found = calibrate_balls(balls, **gel, progress=progress)
    out, verdict, mean = Path(args.out), found.verdict(), found.mean
    data = {
        "fit_verdict": verdict.word,
        "reasons": list(verdict.reasons),
        "balls": len(found.errors),
        "normal_error_deg": mean.contact_deg,
        "height_error_um": 1000 * mean.height_mm,
        "worst": [
            {"file": file, "normal_error_deg": one.contact_deg, "why": why} for file, one, why in found.odd()
        ],
        "notes": [*balls.notes, *_laid(args, balls)],
        "files": {"calibration": str(out / MAP), "result": str(out / RESULT), "report": str(out / PAGE)},
    }
    with atomic_folder(out, replace=True) as folder:
        save_calibration(folder / MAP, found.kept)
        write_json(folder / RESULT, data)
        ball_calibration_report(found, folder, folder / PAGE, calibration=str(out / MAP))
    lines = [
        *balls.notes,
        *_laid(args, balls),
        f"balls left out: normals off {mean.contact_deg:.2f} deg, heights {1000 * mean.height_mm:.0f} um",
        f"fit: {verdict.word}",
        *(f"reason: {reason}" for reason in verdict.reasons),
        *(f"fits badly: {file}, {one.contact_deg:.1f} deg: {why}" for file, one, why in found.odd()),
        f"calibration: {out / MAP}",
        f"report: {out / PAGE}",
    ]
    return Result(data, "\n".join(lines), FAILED if verdict.word == "failed" else DONE)


def _laid(args: Namespace, balls: "BallSet") -> list[str]:
    """How pictures were laid on the membrane of a design."""
    if balls.membrane is None:
        return []
    rows, columns = balls.membrane.columns.shape
    return [
        f"pictures are laid on the membrane of {args.design}: {columns} x {rows} points, "
        f"{balls.membrane.mm_per_px:.4g} mm apart; heights and normals are those of the indentation"
    ]


def _design(args: Namespace) -> "Design | None":
    """The design whose gel and camera are taken as known; None without one."""
    from designlab.simulation.effects.model import load_model

    if args.design is not None:
        return load_model(args.design).effective_design()
    if args.crop_px is not None:
        raise ValueError("--crop-px: is for --design MODEL; give that, or leave it out")
    return None


def _membrane_of(args: Namespace, design: "Design") -> "Callable[[tuple[int, ...]], Membrane]":
    """How pictures show the membrane, by the design that is named."""
    from designlab.inference.calibration.from_model import membrane_of

    def found(shape: tuple[int, ...]) -> "Membrane":
        try:
            return membrane_of(design, shape, crop_px=args.crop_px, mm_per_px=args.mm_per_px)
        except ValueError as error:
            field, _, rule = str(error).partition(": ")
            options = {"crop_px": "--crop-px", "mm_per_px": "--mm-per-px"}
            raise ValueError(f"{options.get(field, f'--balls: {args.balls}')}: {rule}") from None

    return found


def _start(args: Namespace) -> "SensorModel | DirectionalLight":
    """Load the model to start from, as a baseline where one is asked for."""
    from designlab.simulation.directional_light import DirectionalLight, load_any_model

    model = load_any_model(args.model)
    if args.baseline is None:
        return model
    if isinstance(model, DirectionalLight):
        raise ValueError(f"--baseline: starts from a design, {args.model} is a model of directional light")
    named = [applied.name for applied in model.effects if applied.name != "black_level"]
    if named:
        raise ValueError(
            f"--baseline: starts from a design without effects, which light without transport cannot show; "
            f"{args.model} has {', '.join(named)}"
        )
    return DirectionalLight.of(model.design, args.baseline)


def _summary(found: "Calibration") -> str:
    rows = [
        (p.name, f"{p.value:.5g}", "-" if p.se is None else f"{p.se:.2g}", p.unit.removeprefix("1"))
        for p in found.parameters
    ]
    header = ("parameter", "value", "standard error", "unit")
    figures = [
        (
            frame.file,
            "held out" if frame.held_out else "fitted",
            *(f"{frame.before[name]:.3g} -> {frame.after[name]:.3g}" for name in SHOWN),
        )
        for frame in found.frames
    ]
    lines = [table(header, rows), table(("frame", "use", *SHOWN), figures)]
    return "\n".join([*lines, *(f"note: {note}" for note in found.notes)])
