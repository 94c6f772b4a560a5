"""What may be written after `designlab`: commands, their arguments and their help."""

import argparse
import os
import re
from collections.abc import Sequence
from typing import Any, NoReturn

from designlab import __version__

STORAGE_VARIABLE = "DESIGNLAB_STORAGE"
"""Environment variable with the URL of the database that records of studies lie in."""

FIDELITIES = ("fast", "standard", "reference")
DESIGN_HELP = "preset name (see `designlab presets`) or TOML file"
BASELINES = ("diffuse", "phong")
SIZES = ("full", "reduced")
MODEL_HELP = "preset name, design file, or model file written by `gap`"

_DESIGNS = "designlab.app.cli.designs"
_START = "designlab.app.cli.start"
_STUDY = "designlab.app.cli.study"
_GAP = "designlab.app.cli.gap"
_CALIBRATE = "designlab.app.cli.calibrate"
_IMPORT = "designlab.app.cli.importing"
_REPRODUCE = "designlab.app.cli.reproduce"

_EPILOGUE = """\
Every command takes --json: one JSON object on stdout and nothing else there.
Exit status: 0 done, 1 failure, 2 bad input, 130 interrupted.
First steps: designlab doctor; designlab init my-sensor; designlab demo --out demo-out
"""


class UsageError(ValueError):
    """Arguments that fit no command; the text names the argument and the rule."""


class _Parser(argparse.ArgumentParser):
    """Raises instead of exiting, so that wrong arguments read like every other bad input."""

    def __init__(self, **options: Any) -> None:
        super().__init__(allow_abbrev=False, **options)

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message} (see `{self.prog} --help`)")


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Read the arguments of the command line.

    Raises
    ------
    UsageError
        If they fit no command.
    SystemExit
        After ``--help`` and ``--version``.
    """
    return parser().parse_args(_with_negative_values(arguments))


def parser() -> argparse.ArgumentParser:
    """Build the parser of all commands."""
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--json", action="store_true", help="print one JSON object instead of text")
    common.add_argument("--debug", action="store_true", help="show the traceback of a failure")
    top = _Parser(
        prog="designlab",
        parents=[common],
        description="Design, simulate, score and diagnose camera-based tactile sensors.",
        epilog=_EPILOGUE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"designlab {__version__}")
    commands = top.add_subparsers(metavar="COMMAND", required=True, parser_class=_Parser)

    def add(name: str, run: str, text: str, *, to: Any = commands, **options: Any) -> argparse.ArgumentParser:
        added: argparse.ArgumentParser = to.add_parser(
            name, help=text, description=text[0].upper() + text[1:] + ".", parents=[common], **options
        )
        added.set_defaults(run=run)
        return added

    add("doctor", f"{_START}:doctor", "what this machine offers, what is missing and how to get it")
    presets = add("presets", f"{_DESIGNS}:presets", "designs to start from, published sensors among them")
    presets.add_argument("name", nargs="?", metavar="NAME", help="preset to print")
    parts = add("parts", f"{_DESIGNS}:parts", "LEDs with the figures of their data sheets")
    parts.add_argument("name", nargs="?", metavar="NAME", help="part to show, with its source")
    init = add("init", f"{_START}:init", "a starter folder: design, study, notebook, measurement template")
    init.add_argument("folder", metavar="DIR", help="folder to make; must not exist, or be empty")
    init.add_argument(
        "--preset",
        default="gelsight-2020-flat",
        metavar="NAME",
        help="sensor to start from (default: %(default)s)",
    )
    demo = add("demo", f"{_START}:demo", "the main job end to end on a small budget")
    _out(demo, "folder of the results; the same command again goes on where it ended")
    _seed(demo)
    _add_designs(add)
    _add_import(add)
    _add_study(add)
    _add_tolerance(add)
    _add_gap(add)
    _add_reproduce(add)
    return top


def _add_designs(add: Any) -> None:
    evaluate = add("evaluate", f"{_DESIGNS}:evaluate", "scores of a design, by simulation")
    evaluate.add_argument("design", metavar="DESIGN", help=DESIGN_HELP)
    evaluate.add_argument("other", metavar="OTHER", nargs="?", help="second design, with --compare")
    evaluate.add_argument(
        "--compare", action="store_true", help="say in which scores two designs differ, and which is better"
    )
    evaluate.add_argument("--fidelity", choices=FIDELITIES, default="fast", help="effort (default: fast)")
    evaluate.add_argument("--profile", action="store_true", help="show how long each part took")
    _seed(evaluate)
    _out(evaluate, "folder for the score and its pictures", required=False)

    render = add("render", f"{_DESIGNS}:render", "one picture of the sensing area")
    _model(render, "design")
    press = render.add_argument_group("press (without: the untouched gel)")
    press.add_argument("--probe", metavar="SPEC", help="kind[:size_mm] such as sphere:4, or a mesh file")
    press.add_argument("--depth-mm", type=float, metavar="D", help="how deep it is pressed (mm)")
    press.add_argument(
        "--at", type=_point, metavar="X,Y", help="where its axis meets the gel (mm; default 0,0)"
    )
    press.add_argument("--yaw-deg", type=float, metavar="A", help="its rotation, counter-clockwise (deg)")
    render.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="FILE",
        help=".exr: linear radiance; .png: picture for eyes (sRGB, brightest 0.1 %% clipped)",
    )
    render.add_argument(
        "--columns", type=_whole(16, 4096), default=640, metavar="N", help="width of the picture in pixels"
    )
    _samples(render)
    _seed(render)

    compare = add("compare", f"{_DESIGNS}:compare", "image metrics of a simulation against the real thing")
    compare.add_argument("simulated", metavar="SIM", help="image file; or " + MODEL_HELP + " or `calibrate`")
    compare.add_argument("real", metavar="REAL", help="image file; or a measurement folder")
    _out(compare, "folder for the simulated pictures, beside the real ones", required=False)
    _samples(compare)
    _seed(compare)

    calibrate = add(
        "calibrate",
        f"{_CALIBRATE}:calibrate",
        "the design under which the simulator gives a sensor's pictures",
    )
    calibrate.add_argument("measurement", metavar="MEASUREMENT", help="folder with a measurement.toml")
    calibrate.add_argument(
        "--model", required=True, metavar="MODEL", help=DESIGN_HELP + ", or what calibrate wrote"
    )
    calibrate.add_argument(
        "--baseline",
        choices=BASELINES,
        help="fit, in place of light transport, one distant light for each LED group on a surface of this "
        "reflection, starting from where the LEDs stand; calibrated.toml is then for compare and calibrate",
    )
    calibrate.add_argument(
        "--free",
        nargs="*",
        metavar="FIELD",
        help="numbers of the design to fit beside light and poses "
        "(default: contact.kernel_length_mm camera.horizontal_fov_deg; of a baseline, which names these with "
        "design. in front, lights.N.azimuth_deg, lights.N.elevation_deg and exponent)",
    )
    calibrate.add_argument(
        "--columns", type=_whole(8, 2048), default=160, metavar="N", help="wider frames are binned to this"
    )
    _out(calibrate, "folder for the calibrated model, the result and a picture of what is left")
    _trust(calibrate)
    _seed(calibrate)

    export = add("export", f"{_DESIGNS}:export", "STL, STEP, 3MF, LED coordinates, bill of materials, checks")
    _design(export)
    _out(export, "folder to make; replaces an earlier export")
    export.add_argument(
        "--probe", action="append", default=[], metavar="SPEC", help="indenter to add (repeatable)"
    )
    export.add_argument(
        "--allow-infeasible", action="store_true", help="export although rules are broken, with warnings"
    )


def _add_import(add: Any) -> None:
    command = add(
        "import",
        f"{_IMPORT}:import_pictures",
        "a camera's own files as linear images of a measurement folder",
    )
    command.add_argument(
        "sources",
        nargs="*",
        metavar="SOURCE",
        help="JPEG, PNG, TIFF, EXR, PGM, NPY or raw files, or folders of them; or one folder with a "
        "measurement.toml that says what each of its files shows",
    )
    command.add_argument(
        "--out", metavar="DIR", help="measurement folder; frames are added to one that exists"
    )
    shown = command.add_argument_group("what the pictures show (all of this call; several are repeats)")
    shown.add_argument(
        "--kind", choices=("background", "press", "light_probe", "dark", "flat_field"), help="what they show"
    )
    shown.add_argument("--leds", metavar="NAMES", help="LED groups on, with commas; all when absent")
    shown.add_argument("--exposure", type=float, metavar="E", help="relative exposure")
    shown.add_argument("--probe", metavar="SPEC", help="kind:size_mm such as sphere:4, or a mesh file")
    shown.add_argument("--depth-mm", type=float, metavar="D", help="how deep it was pressed (mm)")
    shown.add_argument("--at", type=_point, metavar="X,Y", help="where its axis meets the gel (mm)")
    shown.add_argument("--yaw-deg", type=float, metavar="A", help="its rotation, counter-clockwise (deg)")
    undone = command.add_argument_group("what is undone")
    undone.add_argument(
        "--response",
        metavar="CURVE",
        help="linear, srgb, gamma:G, or a file of lines 'encoded,linear'; linear for raw files when absent",
    )
    undone.add_argument(
        "--ladder", nargs="+", metavar="FILE=E", help="estimate the response from one scene at exposures E"
    )
    undone.add_argument(
        "--save-response", metavar="FILE", help="write the estimated response, for --response"
    )
    undone.add_argument("--dark", nargs="+", metavar="FILE", help="pictures with all LEDs off, imported too")
    undone.add_argument("--black", type=float, metavar="V", help="value without light, as the files store it")
    undone.add_argument("--white", type=float, metavar="V", help="value at full scale, as the files store it")
    undone.add_argument(
        "--bayer", choices=("RGGB", "BGGR", "GRBG", "GBRG"), help="pattern of files with one channel"
    )
    undone.add_argument(
        "--colour-matrix",
        metavar="M",
        help="matrix that the camera applied to linear R, G, B: nine numbers, row by row, or a file",
    )
    sensor = command.add_argument_group("the sensor")
    sensor.add_argument("--sensor", metavar="DESIGN", help=DESIGN_HELP)
    sensor.add_argument("--lens", metavar="FILE", help="OpenCV calibration to put into a copy of the design")
    sensor.add_argument("--fisheye", action="store_true", help="it was made by cv2.fisheye")


def _add_study(add: Any) -> None:
    study = add("study", "", "search for better designs; resumable, many workers")
    actions = study.add_subparsers(metavar="ACTION", required=True, parser_class=_Parser)
    run = add("run", f"{_STUDY}:run", "evaluate designs until the study is done", to=actions)
    run.set_defaults(resume="run the same command again to resume")
    status = add("status", f"{_STUDY}:status", "how far a study is, and its best designs", to=actions)
    report = add("report", f"{_STUDY}:report", "one HTML page about a study", to=actions)
    for action in (run, status, report):
        action.add_argument("study", metavar="STUDY", help="study file (TOML), or the folder of its results")
        action.add_argument(
            "--storage",
            metavar="URL",
            default=os.environ.get(STORAGE_VARIABLE),
            help="database that holds the record, for runs on several machines, "
            f"postgresql+psycopg://user@host/name (default: {STORAGE_VARIABLE} if set, else the folder)",
        )
    _out(run, "folder of the results (default: STUDY without .toml, with -out)", required=False)
    _out(status, "folder of the results, where `run` had one", required=False)
    report.add_argument("--results", metavar="DIR", help="folder of the results, where `run` had --out")
    report.add_argument("-o", "--output", metavar="FILE", help="page to write (default: report.html there)")
    _workers(run)
    run.add_argument(
        "--trials", type=_whole(1, 100_000), metavar="N", help="designs in all, instead of the study's own"
    )
    run.add_argument(
        "--rebuild", action="store_true", help="make a new record of the scores kept; the old one stays"
    )


def _add_tolerance(add: Any) -> None:
    command = add(
        "tolerance",
        "designlab.app.cli.tolerance:tolerance",
        "copies of a design as they would be built: how many are good, and what is to blame",
    )
    command.add_argument("design", metavar="DESIGN", help=MODEL_HELP)
    command.add_argument(
        "--terms", metavar="FILE", help="TOML file: what a copy must score, what differs between copies"
    )
    command.add_argument(
        "--copies", type=_whole(2, 100_000), default=200, metavar="N", help="how many (default: 200)"
    )
    command.add_argument(
        "--calibrate",
        choices=("each", "once"),
        default="each",
        help="calibrate each copy, or the drawing once for all (default: each)",
    )
    command.add_argument("--fidelity", choices=FIDELITIES, default="fast", help="effort (default: fast)")
    _workers(command)
    command.add_argument(
        "--dask", metavar="ADDRESS", help="Dask scheduler whose workers run the copies, tcp://host:8786"
    )
    _out(command, "folder of the copies and the report; the same command again goes on there")
    _seed(command)
    command.set_defaults(resume="run the same command again to resume")


def _trust(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--trust",
        action="append",
        default=[],
        metavar="NAME",
        help="go on although pictures look suspicious (repeatable); the refusal says which name",
    )


def _add_gap(add: Any) -> None:
    gap = add("gap", "", "what a model lacks: diagnose a measurement, or make one with a hidden effect")
    actions = gap.add_subparsers(metavar="ACTION", required=True, parser_class=_Parser)
    plant = add("plant", f"{_GAP}:plant", "a measurement set with a hidden effect, answer apart", to=actions)
    plant.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME[:P=V,...]",
        help="effect to hide (repeatable); without values they are drawn from the seed; none: a null set",
    )
    plant.add_argument("--design", default="gelsight-2020-flat", metavar="DESIGN", help=DESIGN_HELP)
    plant.add_argument(
        "--strength",
        type=float,
        default=1.5,
        metavar="S",
        help="distance of drawn values from null in usual spreads (default: 1.5)",
    )
    plant.add_argument("--kit", choices=("hour", "small"), default="hour", help="which presses are taken")
    plant.add_argument(
        "--kit-seed",
        type=_whole(0, 2**31 - 1),
        metavar="N",
        help="seed of the stated places (default: that of --seed)",
    )
    plant.add_argument(
        "--outside",
        action="append",
        default=[],
        metavar="KIND[:STRENGTH]",
        help="departure that no effect explains (repeatable): printed_markers, debris, second_contact, "
        "lens_ghost, wrong_object, jpeg_blocks, moire or water_drop",
    )
    plant.add_argument("--flat-field", action="store_true", help="add a frame of uniform light")
    plant.add_argument(
        "--columns", type=_whole(8, 2048), default=96, metavar="N", help="image width in pixels"
    )
    _out(plant, "folder to make; the answer is written beside it")
    _seed(plant)
    diagnose = add("diagnose", f"{_GAP}:diagnose", "name the effects a model lacks", to=actions)
    diagnose.add_argument("measurement", metavar="MEASUREMENT", help="folder with a measurement.toml")
    diagnose.add_argument("--model", required=True, metavar="MODEL", help=MODEL_HELP)
    _out(diagnose, "folder of the report and the updated model; the same command again goes on there")
    _trust(diagnose)
    diagnose.add_argument(
        "--renders", metavar="DIR", help="folder of pictures that several diagnoses share (default: in --out)"
    )
    _seed(diagnose)
    diagnose.set_defaults(resume="the pictures rendered so far are kept; run the same command again to go on")
    benchmark = add(
        "benchmark", f"{_GAP}:benchmark", "diagnose a pool of generated sets and score it", to=actions
    )
    benchmark.add_argument(
        "--only", default="", metavar="REGEX", help="sets whose name matches (default: the whole pool)"
    )
    benchmark.add_argument(
        "--pool",
        choices=("quick", "development", "power", "calibration", "test"),
        default="development",
        help="quick: six small sets, to see that all works; development: sets without and with one effect, "
        "and outside the catalogue; power: each effect at rising strengths, for the smallest that is named; "
        "calibration: the families of the test, for the errors of fitted values; test: the sealed sets "
        "(default: development)",
    )
    benchmark.add_argument(
        "--frozen",
        metavar="COMMIT",
        help="commit that froze the thresholds, from which --pool test takes its seeds; the code must be "
        "as it was there",
    )
    benchmark.add_argument(
        "--again",
        action="store_true",
        help="run sets of a pool that was opened once more by later code, for its time and what it changes; "
        "no opening, since the sets are known",
    )
    benchmark.add_argument(
        "--shard", metavar="K/N", help="the k-th of n parts of the pool, 1/4 to 4/4 (default: all)"
    )
    benchmark.add_argument(
        "--records",
        metavar="FILE",
        help="records.jsonl of an earlier run by the same code: its sets are not run again, and count; "
        "records.jsonl in --out holds both",
    )
    benchmark.add_argument(
        "--base", type=_whole(0, 2**31 - 1), default=0, metavar="N", help="start of the seeds (default: 0)"
    )
    benchmark.add_argument(
        "--transfer",
        action="store_true",
        help="see how much better the corrected models predict another design: LEDs 3 mm higher, 15 deg more "
        "tilted, with the same hidden effect",
    )
    benchmark.add_argument(
        "--kit",
        choices=("hour", "no_dark", "no_groups", "plain"),
        default="hour",
        help="frames that are used of each set: all; all but the dark frame; all but those of single LED "
        "groups; without these, other exposures and the turned gel (default: hour)",
    )
    benchmark.add_argument(
        "--further",
        action="store_true",
        help="take the frames that each ambiguous report asks for, and see whether they settle the matter",
    )
    _workers(benchmark)
    benchmark.add_argument(
        "--dask", metavar="ADDRESS", help="Dask scheduler whose workers run the sets, tcp://host:8786"
    )
    _out(benchmark, "folder of sets, reports and scores; the same command again goes on where it ended")


def _add_reproduce(add: Any) -> None:
    reproduce = add(
        "reproduce",
        f"{_REPRODUCE}:reproduce",
        "the experiments of arXiv 2012.13184 on made sensors, its figures beside ours",
    )
    _out(reproduce, "folder of the results; the same command again goes on where it ended")
    reproduce.add_argument(
        "--size",
        choices=SIZES,
        default="full",
        help="full: the paper's layout, hours on a few cores; reduced: some minutes, shows that it runs "
        "(default: full)",
    )
    _seed(reproduce, default=1)


def _design(command: argparse.ArgumentParser) -> None:
    command.add_argument("design", metavar="DESIGN", help=DESIGN_HELP)


def _model(command: argparse.ArgumentParser, name: str) -> None:
    command.add_argument(name, metavar="DESIGN", help=MODEL_HELP)


def _workers(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--workers", type=_whole(1, 256), default=1, metavar="N", help="processes at once (default: 1)"
    )


def _out(command: argparse.ArgumentParser, text: str, *, required: bool = True) -> None:
    command.add_argument("--out", required=required, metavar="DIR", help=text)


def _seed(command: argparse.ArgumentParser, *, default: int = 0) -> None:
    command.add_argument(
        "--seed",
        type=_whole(0, 2**31 - 1),
        default=default,
        metavar="N",
        help="random seed (default: %(default)s)",
    )


def _samples(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--samples",
        type=_whole(1, 65536),
        default=64,
        metavar="N",
        help="light paths a pixel (default: 64)",
    )


def _whole(low: int, high: int) -> Any:
    """Return the reader of a whole number between two bounds."""

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"must be a whole number, got {text!r}") from None
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"must lie between {low} and {high}, got {value}")
        return value

    return read


def _point(text: str) -> tuple[float, float]:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be two numbers X,Y in mm, got {text!r}") from None
    return x, y


def _with_negative_values(arguments: Sequence[str]) -> list[str]:
    """Join ``--at -1,2`` to ``--at=-1,2``: argparse takes a leading minus for an option."""
    joined: list[str] = []
    for argument in arguments:
        if joined and joined[-1] == "--at" and re.match(r"-[\d.]", argument):
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined
