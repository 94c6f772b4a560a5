"""Commands about one design: presets, evaluate, render, compare, export."""

from argparse import Namespace
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from designlab.app.cli.console import Result
from designlab.app.cli.shared import (
    as_understood,
    light_files,
    probes_named,
    source_named,
    table,
    understood_lines,
)
from designlab.core.progress import bar
from designlab.core.run_folder import require_writable
from designlab.core.store import write_atomic

if TYPE_CHECKING:
    from designlab.evaluation.press_plan import PressPlan
    from designlab.evaluation.score import Evaluation
    from designlab.measurement import Measurement
    from designlab.measurement.compare import Comparison
    from designlab.report.evaluation_plots import Scale
    from designlab.report.page import Html
    from designlab.simulation.contact.press import Press
    from designlab.simulation.effects.model import SensorModel
    from geometries.mesh_files import Understood

PAGE = "report.html"
PRESSED = (
    "depth_mm", "force_n", "at", "direction", "yaw_deg", "shear_mm", "twist_deg", "probe_unit", "probe_side"
)  # fmt: skip
UNLIKE = 1.25  # ratio of brightness from which other figures than structure say little
GRAINY = 0.05  # noise of a square millimetre above which pictures are worth a warning


def presets(args: Namespace) -> Result:
    """List the presets, or print one as TOML."""
    from designlab.sensor.design import preset, preset_names, preset_text

    if args.name is not None:
        text = preset_text(args.name)
        return Result(
            {"name": args.name, "digest": preset(args.name).digest, "toml": text}, text.rstrip("\n")
        )
    listed = [
        {"name": name, "description": preset(name).description, "not_buildable": preset(name).not_buildable}
        for name in preset_names()
    ]
    width = max(len(entry["name"]) for entry in listed)
    lines = []
    for entry in listed:
        lines.append(f"{entry['name']:<{width}}  {entry['description']}")
        if entry["not_buildable"]:
            lines.append(f"{'':<{width}}  {entry['not_buildable']}")
    return Result({"presets": listed}, "\n".join(lines))


def parts(args: Namespace) -> Result:
    """List the LED library or a file of one's own parts, or show one part of the library."""
    from designlab.sensor.led_catalogue import PARTS, flux_mw, part
    from designlab.sensor.parts_file import OwnParts, load_parts

    file = args.name if args.name is not None and args.name.endswith(".toml") else None
    own = OwnParts() if file is None else load_parts(file)

    def content(name: str) -> dict[str, Any]:
        entry = part(name, own.leds)
        return {
            "name": name,
            **entry.model_dump(exclude={"chips"}),
            "chips": {
                colour: {**chip.model_dump(), "estimated_flux_mw": flux_mw(entry, chip)}
                for colour, chip in entry.chips.items()
            },
        }

    names = list(own.leds) if file else list(PARTS) if args.name is None else [args.name]
    entries = [content(name) for name in names]
    rows = []
    for entry in entries:
        size = entry["size_mm"]
        front = "-" if size is None else " x ".join("?" if s is None else f"{s:g}" for s in size)
        angle = "-" if entry["viewing_deg"] is None else f"{entry['viewing_deg']:g}"
        for colour, chip in entry["chips"].items():
            flux = chip["flux_mw"] if chip["flux_mw"] is not None else chip["estimated_flux_mw"]
            figures = (chip["wavelength_nm"], chip["width_nm"], chip["intensity_mcd"], flux)
            shown = ["-" if figure is None else f"{figure:g}" for figure in figures]
            rows.append((entry["name"], front, angle, colour, *shown))
    header = ("part", "size mm", "angle deg", "chip", "nm", "width nm", "mcd", "mW")
    lines = [table(header, rows), "mW beside mcd are estimated from angle and spectrum"]
    if file:
        others = {kind: list(getattr(own, kind)) for kind in ("spectra", "filters", "gels")}
        lines += [f"{kind}: {', '.join(found)}" for kind, found in others.items() if found]
        return Result({"parts": entries, **others}, "\n".join(lines))
    if args.name is not None:
        lines += [f"{entries[0]['maker']} {entries[0]['number']}", f"source: {entries[0]['source']}"]
    return Result({"parts": entries} if args.name is None else entries[0], "\n".join(lines))


def evaluate(args: Namespace) -> Result:
    """Score a design, or two against each other."""
    from designlab.report.evaluation_folder import SCORE_FILE
    from designlab.simulation.effects.model import load_model

    if args.compare != (args.other is not None):
        raise ValueError("--compare: takes two designs: designlab evaluate DESIGN OTHER --compare")
    if args.compare:
        return _against(args)
    out = None if args.out is None else Path(args.out)
    model = load_model(args.design)
    if out is not None:
        require_writable(out, made_with=SCORE_FILE)
    found = _evaluated(args, model, args.design, _plan(args, model))
    score = found.score
    notes = [] if out is None else _write(found, out)
    data: dict[str, Any] = score.to_json()
    lamps = light_files(model.design)
    data |= {"understood": lamps} if lamps else {}
    text = [
        *understood_lines(lamps),
        f"{score.design}, fidelity {score.fidelity}, seed {score.seed}, {sum(score.seconds.values()):.0f} s",
        f"presses: {score.press_plan.text()}",
        *_verdict(data),
    ]
    if score.light.noise > GRAINY:
        text.append(
            "The pictures are noisy. A higher --fidelity removes the noise and the error that it adds."
        )
    text += [f"warning: {warning}" for warning in score.warnings]
    text += notes
    if args.profile:
        text.append(str(score.light))
        text.append(table(("part", "seconds"), [(part, f"{s:.1f}") for part, s in score.seconds.items()]))
    if out is not None:
        pictures = sorted(path.name for path in out.glob("*.png"))
        data |= {"out": args.out, "pictures": pictures, "report": str(out / PAGE)}
        text.append(f"report: {out / PAGE}")
    else:
        text.append(
            f"{len(score.scores)} scores with --json, maps and all of them as a page with --out FOLDER"
        )
    return Result(data, "\n".join(text))


def _against(args: Namespace) -> Result:
    """Score two designs with the same presses and random numbers, and tell where they differ."""
    from designlab.evaluation.paired_comparison import differences, same_presses
    from designlab.report.comparison import comparison_report, verdict
    from designlab.report.evaluation_plots import Scale
    from designlab.report.page import link, rounded
    from designlab.report.yardsticks import row
    from designlab.simulation.effects.model import load_model

    sources = {"first": args.design, "second": args.other}
    models = {place: load_model(source) for place, source in sources.items()}
    plan = _plan(args, *models.values())
    for place, model in models.items():
        with source_named(sources[place]):
            model.effective_design().require_feasible()
            plan.require_possible(model.effective_design())
    if args.out is not None:
        _require_comparison(Path(args.out), [*sources, PAGE])
    both = {place: _evaluated(args, models[place], sources[place], plan) for place in sources}
    scores = {place: one.score for place, one in both.items()}
    found = differences(scores["first"], scores["second"])
    rows = []
    for name, difference in found.items():
        a, b = (scores[place].scores[name] for place in sources)
        said = verdict(name, difference)
        said = {"first": "DESIGN better", "second": "OTHER better"}.get(said, said)
        depths_mm = [depth for score in scores.values() for depth in score.presses.get("depth_mm", ())]
        title = row(name, {"value": a.value, "se": a.se, "unit": a.unit}, depths_mm)["title"]
        change = rounded(difference.value, difference.se)
        rows.append((title, rounded(a.value, a.se), rounded(b.value, b.se), change, said))
    same = same_presses(models["first"], models["second"], plan)
    shared = "same presses and" if same else "presses that effects of the models change, same"
    data: dict[str, Any] = {place: score.to_json() for place, score in scores.items()} | {
        "differences": {name: d._asdict() | {"differs": d.differs} for name, d in found.items()}
    }
    text = [
        f"DESIGN: {args.design}, OTHER: {args.other}; {shared} random numbers, seed {args.seed}",
        f"presses: {plan.text()}",
        table(("score", "DESIGN", "OTHER", "OTHER - DESIGN", "verdict"), rows),
        "verdicts allow for the number of scores: chance makes one of them wrong in one comparison of twenty",
        *(f"warning: {place}: {w}" for place, score in scores.items() for w in score.warnings),
    ]
    if args.out is not None:
        folders = {place: Path(args.out) / place for place in sources}
        scale = Scale.of(*both.values())
        for place, folder in folders.items():
            text += _write(both[place], folder, scale=scale, links=(link(f"../{PAGE}", "both designs"),))
        data["report"] = str(comparison_report(scores, found, folders, Path(args.out) / PAGE))
        text.append(f"report: {data['report']}")
    return Result(data, "\n".join(text))


def _require_comparison(folder: Path, own: Sequence[str]) -> None:
    """Refuse a folder with anything but what a comparison leaves there."""
    foreign = (
        sorted(path.name for path in folder.iterdir() if path.name not in own) if folder.is_dir() else []
    )
    if foreign:
        raise ValueError(
            f"--out: {folder} must be absent, empty or an earlier comparison, it holds {foreign[0]!r}"
        )
    require_writable(folder)


def _plan(args: Namespace, *models: "SensorModel") -> "PressPlan":
    """Presses that models share, as deep or as strong as the arguments say."""
    from designlab.evaluation.press_plan import PressPlan

    designs = [model.effective_design() for model in models]
    strength = {"depth_mm": args.depth_mm, "force_n": args.force_n}
    return PressPlan.of(*designs, direction=args.direction, **strength)


def _evaluated(args: Namespace, model: "SensorModel", source: str, plan: "PressPlan") -> "Evaluation":
    """Score a design by the presses of a plan."""
    from designlab.evaluation.evaluate import evaluate as score_of

    with bar() as progress, source_named(source):
        return score_of(
            model,
            fidelity=args.fidelity,
            seed=args.seed,
            presses=plan,
            all_scores=args.all_scores,
            progress=progress,
        )


def _write(
    found: "Evaluation", folder: Path, *, scale: "Scale | None" = None, links: Sequence["Html"] = ()
) -> list[str]:
    """Write pictures of an evaluation, a drawing of its sensor, and the page; return what is to be said."""
    from designlab.report.evaluation import DRAWING, evaluation_report
    from designlab.report.evaluation_folder import write_evaluation
    from designlab.report.view3d import render_view

    with bar() as progress, TemporaryDirectory() as kept, ThreadPoolExecutor(1) as beside:
        progress("pictures", 0, 2)
        # A process of its own draws the sensor, meanwhile, on another core.
        drawing = beside.submit(render_view, found.design, Path(kept) / DRAWING)
        write_evaluation(found, folder, scale=scale)
        progress("drawing of the sensor", 1, 2)
        drawn = drawing.result()
        if drawn.path is not None:
            write_atomic(folder / DRAWING, drawn.path.read_bytes())
        evaluation_report(found.score.to_json(), folder / PAGE, links=links)
        progress("page", 2, 2)
    return [f"note: the page has no drawing of the sensor: {drawn.reason}"] if drawn.reason else []


def _verdict(score: dict[str, Any]) -> list[str]:
    """Main scores with their verdict, and the worst places."""
    from designlab.report.page import rounded
    from designlab.report.yardsticks import judged, worst_place

    judgement = judged(score["scores"], score["presses"].get("depth_mm", ()))
    rows = [(row["title"], rounded(row["value"], row["se"]), row["verdict"]) for row in judgement]
    places = [worst_place(kind, place) for kind, place in score["worst"].items()]
    return [table(("score", "value", "verdict"), rows), *places]


def render(args: Namespace) -> Result:
    """Write one picture."""
    from designlab.core.images import tone_map, write_image
    from designlab.simulation.effects.model import load_model
    from designlab.simulation.simulator import Simulator, saturation_share, saturation_warning
    from geometries.probes import understood

    output = Path(args.output)
    if output.suffix.lower() not in (".exr", ".png"):
        raise ValueError(f"--output: must end in .exr or .png, got {args.output!r}")
    model = load_model(args.design)
    with source_named(args.design):
        model.effective_design().require_feasible()
    press = _press(args)
    require_writable(output.parent)
    frame = Simulator(model, columns=args.columns, samples=args.samples, seed=args.seed).frame(press)
    mixed = frame.mixed
    try:
        write_image(output, mixed if output.suffix.lower() == ".exr" else tone_map(mixed))
    except OSError as error:
        raise OSError(error.errno, f"cannot write {output}: {error.strerror or error}") from None
    rows, columns = mixed.shape[:2]
    mechanics = frame.mechanics
    saturation = saturation_share(model.effective_design(), frame)
    warnings = [*frame.warnings, *saturation_warning(saturation)]
    mesh = None if press is None else understood(press.probe)
    share = None if mesh is None else frame.share_touching
    data: dict[str, Any] = {
        "output": args.output,
        "columns": columns,
        "rows": rows,
        "mean_radiance": [float(value) for value in mixed.mean(axis=(0, 1))],
        "deepest_mm": float(frame.height_mm.max()),
        **({} if mechanics is None else mechanics.to_json()),
        **({} if mesh is None else {"understood": [{**mesh.to_json(), "share_touching": share}]}),
        "samples": args.samples,
        "seed": args.seed,
        "saturation_share": saturation,
        "warnings": warnings,
    }
    lines = [f"{args.output}: {columns} x {rows} pixels"]
    if mesh is not None:
        touching = "" if share is None else f"; {share:.0%} of its top that is in the picture touches"
        lines.append(f"{mesh}{touching}")
    if lamps := light_files(model.design):
        data["understood"] = [*data.get("understood", []), *lamps]
        lines += understood_lines(lamps)
    if mechanics is not None:
        lines.append(
            f"pressed {mechanics.depth_mm:.3g} mm deep with {mechanics.force_n:.3g} N; contact of "
            f"{mechanics.contact_area_mm2:.3g} mm2, the gel bulges by {mechanics.bulge_um:.3g} um"
        )
    lines += [f"warning: {warning}" for warning in warnings]
    return Result(data, "\n".join(lines))


def _press(args: Namespace) -> "Press | None":
    """The press that the arguments describe, if any."""
    given = [name for name in PRESSED if getattr(args, name) is not None]
    if args.probe is None:
        if given:
            raise ValueError(f"--probe: needed with --{given[0].replace('_', '-')}, which probe is pressed?")
        return None
    if args.depth_mm is None and args.force_n is None:
        raise ValueError("--depth-mm or --force-n: needed with --probe, how deep or how hard is it pressed?")
    from pydantic import ValidationError

    from designlab.sensor.field_errors import explain
    from designlab.simulation.contact.press import Press

    (probe,) = probes_named(args, [args.probe])
    try:
        return Press(
            probe=probe,
            depth_mm=args.depth_mm,
            force_n=args.force_n,
            centre_mm=args.at or (0.0, 0.0),
            direction=args.direction or "axis",
            yaw_deg=args.yaw_deg or 0.0,
            shear_mm=args.shear_mm or (0.0, 0.0),
            twist_deg=args.twist_deg or 0.0,
        )
    except ValidationError as error:
        raise ValueError(f"press: {explain(error)}") from None


def compare(args: Namespace) -> Result:
    """Compare two images, or a model with a measurement."""
    from designlab.app.cli.picture_set import given, measured_picture
    from designlab.measurement import load_measurement
    from designlab.sensor.design import preset_names

    real = Path(args.real)
    folder = real.is_dir() or real.name == "measurement.toml"
    of_design = args.simulated in preset_names() or Path(args.simulated).suffix.lower() == ".toml"
    measured = folder or of_design
    if (options := given(args)) and (folder or not of_design):
        raise ValueError(f"{options[0]}: is for a design and one picture of the real sensor; leave it out")
    meshes: list[Understood] = []
    if folder:
        data, meshes = _compare_model(args, load_measurement(real))
    elif of_design:
        with measured_picture(args) as measurement:
            data, meshes = _compare_model(args, measurement)
    else:
        from designlab.measurement.compare import compare_files

        data = compare_files(args.simulated, args.real)
    names = ("mse", "snr_db", "smape", "ssim", "structure_corr", "structure_snr_db")
    channels = data["channels"]
    rows = [(name, *(f"{entry[name]:.4g}" for entry in (data, *channels.values()))) for name in names]
    lines = [table(("figure", "all", *channels), rows)]
    if measured:
        gel = [frame["file"] for frame in data.get("backgrounds", ())]
        compared = [frame["file"] for frame in data["frames"]] or gel
        lines.insert(0, f"compared: {', '.join(compared)}")
        if gel and data["frames"]:
            rows = [
                (frame["file"], *(f"{frame[name]:.4g}" for name in names)) for frame in data["backgrounds"]
            ]
            lines.append(table(("untouched gel", *names), rows))
    lines += map(str, meshes)
    lines += [f"skipped {entry['file']}: {entry['reason']}" for entry in data.get("skipped", ())]
    lines += [f"note: {note}" for note in data.get("notes", ())]
    lines += [f"pictures in {args.out}"] if args.out and measured else []
    return Result(data, "\n".join(lines))


def _compare_model(args: Namespace, measurement: "Measurement") -> tuple[dict[str, Any], "list[Understood]"]:
    """Compare a model with a measurement, poses that it does not state read off the pictures."""
    import numpy as np

    from designlab.core.images import tone_map, write_image
    from designlab.inference.calibration.poses import posed
    from designlab.measurement.compare import compare_model
    from designlab.simulation.directional_light import design_of, load_any_model

    model = load_any_model(args.simulated)
    if args.out is not None:
        require_writable(args.out)
    with bar("frame") as progress:
        read = posed(measurement, design_of(model), seed=args.seed, progress=progress)
        found = compare_model(
            model,
            read.measurement,
            samples=args.samples,
            seed=args.seed,
            backgrounds=True,
            progress=progress,
        )
    if args.out is not None:
        folder = Path(args.out)
        for pair in [*found.pairs, *found.untouched]:
            stem = Path(pair.file).stem
            white = float(np.percentile(pair.real, 99.9))
            beside = np.concatenate([pair.simulated, pair.real], axis=1)
            write_image(folder / f"{stem}-simulated.exr", pair.simulated)
            write_image(folder / f"{stem}-simulated-and-real.png", tone_map(beside, white))
    meshes = measurement.meshes()
    notes = [*read.notes, *_brightness(found)]
    data = found.to_json() | ({"notes": notes} if notes else {})
    return data | as_understood(meshes), meshes


def _brightness(found: "Comparison") -> list[str]:
    """Say where figures other than those of structure are about brightness above all."""
    if 1 / UNLIKE < found.brightness < UNLIKE:
        return []
    return [
        f"the pictures are {found.brightness:.2g} times as bright as the simulation: nothing is fitted "
        "here, and only structure_corr does not depend on that; `designlab calibrate` fits the light"
    ]


def export(args: Namespace) -> Result:
    """Write the files to make a design."""
    from designlab.fabrication import export as write_files
    from designlab.report.build_guide import write as write_guide
    from designlab.simulation.effects.model import load_model
    from geometries.probes import understood

    model = load_model(args.design)
    probes = probes_named(args, args.probe)
    meshes = [mesh for mesh in map(understood, probes) if mesh is not None]
    with bar() as progress, source_named(args.design):
        manifest = write_files(
            model,
            args.out,
            probes=probes,
            boards=not args.no_boards,
            supply_v=args.supply_v,
            allow_infeasible=args.allow_infeasible,
            describe=write_guide,
            progress=progress,
        )
    passed = sum(check["ok"] for check in manifest["checks"])
    lines = [
        f"{args.out}: {len(manifest['files'])} files for "
        + ", ".join([*manifest["parts"], *(board["name"] for board in manifest["boards"])]),
        *map(str, meshes),
        f"{passed} of {len(manifest['checks'])} checks passed; README.txt there says what each file is for",
        *(_driven(drive) for drive in manifest["drive"]),
        *(f"warning: {warning}" for warning in manifest["warnings"]),
    ]
    if assumed := manifest["assumed"]:
        lines.append(f"{len(assumed)} figures are assumed, README.txt lists them")
    return Result({"out": args.out, **manifest, **as_understood(meshes)}, "\n".join(lines))


def _driven(drive: dict[str, Any]) -> str:
    """How a group of LEDs is driven, in a line."""
    flux = "no flux known"
    if drive["current_from"] == "flux":
        flux = f"{drive['board_flux_mw']:.3g} mW each, the design has {drive['design_flux_mw']:.3g} mW"
    return (
        f"{drive['group']}: {drive['number']}, {drive['current_ma']:.3g} mA through "
        f"{drive['resistor_ohm']:g} ohm at {drive['supply_v']:g} V, {flux}"
    )
