"""The command line: commands, their arguments and their help."""

import argparse
import os
import re
from collections.abc import Sequence
from typing import Any, NoReturn

from designlab.core import __version__

STORAGE_VARIABLE = "DESIGNLAB_STORAGE"
"""Environment variable with the URL of the database that records of studies lie in."""

# As geometries.mesh_files has them, which is not imported here: help is instant.
UNITS = ("um", "mm", "cm", "m", "inch")
SIDES = ("+z", "-z", "+x", "-x", "+y", "-y")
FIDELITIES = ("fast", "standard", "reference")
DESIGN_HELP = "preset name (see `designlab presets`) or TOML file"
LENS_HELP = "calibration by OpenCV, ROS, Kalibr, COLMAP or a script (YAML, XML, JSON, .npz, cameras.txt)"
MODEL_HELP = "preset name, design file, or model file written by `gap`"

_DESIGNS = "designlab.app.cli.designs"
_START = "designlab.app.cli.start"
_STUDY = "designlab.app.cli.study"
_GAP = "designlab.app.cli.gap"

_WITH_MINUS = {"--at": r"-[\d.]", "--probe-side": r"-[xyz]$"}

_LARGEST_SEED = 2**31 - 1

_PRESET = "default"
_AGAIN = "run the same command again to resume"

_EPILOGUE = """\
Every command takes --json: one JSON object on stdout and nothing else there.
Exit status: 0 done, 1 failure, 2 bad input, 130 interrupted.
First steps: designlab doctor; designlab init my-sensor; designlab demo --out demo-out
"""


class UsageError(ValueError):
    """Arguments that fit no command; the text names the argument and the rule."""


class _Parser(argparse.ArgumentParser):
    """A parser that raises instead of exiting, so that wrong arguments read like other bad input."""

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
    _option(common, "--json", "print one JSON object instead of text")
    _option(common, "--debug", "show the traceback of a failure")
    top = _Parser(
        prog="designlab",
        parents=[common],
        description="Design, simulate, score and diagnose camera-based tactile sensors.",
        epilog=_EPILOGUE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"designlab {__version__}")
    commands = top.add_subparsers(metavar="COMMAND", required=True, parser_class=_Parser)

    def add(
        name: str, run: str, text: str, *, to: Any = commands, **defaults: str
    ) -> argparse.ArgumentParser:
        description = text[0].upper() + text[1:] + "."
        added: argparse.ArgumentParser = to.add_parser(
            name, help=text, description=description, parents=[common]
        )
        added.set_defaults(run=run, **defaults)
        return added

    add("doctor", f"{_START}:doctor", "what this machine offers, what is missing and how to get it")
    presets = add("presets", f"{_DESIGNS}:presets", "designs to start from, published sensors among them")
    _option(presets, "name NAME", "preset to print", nargs="?")
    parts = add("parts", f"{_DESIGNS}:parts", "LEDs with the figures of their data sheets")
    _option(parts, "name NAME", "part to show, with its source; or a TOML file of own parts", nargs="?")
    init = add("init", f"{_START}:init", "a starter folder: design, study, notebook, measurement template")
    _option(init, "folder DIR", "folder to make; must not exist, or be empty")
    _option(init, "--preset NAME", "sensor to start from (default: %(default)s)", default=_PRESET)
    demo = add("demo", f"{_START}:demo", "the main job end to end on a small budget")
    _out(demo, "folder of the results; the same command again goes on where it ended")
    _seed(demo)
    _add_designs(add)
    _add_import(add)
    _add_study(add)
    _add_tolerance(add)
    _add_gap(add)
    studio = add(
        "studio",
        "designlab.app.cli.studio:studio",
        "live page in the browser: turn a knob, see what the sensor sees",
    )
    _option(
        studio,
        "thing DESIGN",
        "preset name or TOML file; or the folder of a study or a diagnosis (default: %(default)s)",
        nargs="?",
        default=_PRESET,
    )
    local = "address to listen on; another one than this machine's own asks for a token, which is printed"
    _option(studio, "--host HOST", local, default="127.0.0.1")
    _option(studio, "--port PORT", "0 takes a free one", type=_whole(0, 65535), default=8421)
    reproduce = add(
        "reproduce",
        "designlab.app.cli.reproduce:reproduce",
        "the experiments of arXiv 2012.13184 on made sensors, its figures beside ours",
    )
    _out(reproduce, "folder of the results; the same command again goes on where it ended")
    _option(
        reproduce,
        "--size",
        "full: the paper's layout, hours on a few cores; reduced: some minutes, shows that it runs",
        choices=("full", "reduced"),
    )
    _seed(reproduce, default=1)
    return top


def _add_designs(add: Any) -> None:
    evaluate = add("evaluate", f"{_DESIGNS}:evaluate", "scores of a design, by simulation")
    _option(evaluate, "design DESIGN", DESIGN_HELP)
    _option(evaluate, "other OTHER", "second design, with --compare", nargs="?")
    _option(evaluate, "--compare", "say in which scores two designs differ, and which is better")
    _option(evaluate, "--fidelity", "effort", choices=FIDELITIES)
    _option(evaluate, "--profile", "show how long each part took")
    _presses(evaluate)
    text = "along the sensor's axis (default) or the membrane's normal at each place"
    _option(evaluate, "--direction", text, choices=("axis", "normal"), default="axis")
    own = "of elastic gels: saturation depth and lateral resolution too, as fidelity standard"
    _option(evaluate, "--all-scores", own)
    _seed(evaluate)
    _out(evaluate, "folder for the score and its pictures", required=False)

    render = add("render", f"{_DESIGNS}:render", "one picture of the sensing area")
    _option(render, "design DESIGN", MODEL_HELP)
    press = render.add_argument_group("press (without: the untouched gel)")
    _option(
        press,
        "--probe SPEC",
        "kind[:size_mm] such as sphere:4, triangle:5:r0.2 (edge radius in mm), or a mesh file",
    )
    _mesh(press)
    _option(press, "--depth-mm D", "how deep it is pressed (mm)", type=float)
    _option(press, "--force-n F", "force (N) instead of a depth, on an elastic gel", type=float)
    _option(press, "--at X,Y", "where its axis meets the gel (mm; default 0,0)", type=_point)
    _direction(press)
    _option(press, "--yaw-deg A", "its rotation, counter-clockwise (deg)", type=float)
    _option(press, "--shear-mm X,Y", "how far it is then moved sideways (mm)", type=_point)
    _option(press, "--twist-deg A", "how far it is then turned, counter-clockwise (deg)", type=float)
    png = "picture for eyes (sRGB, brightest 0.1 %% clipped)"
    _option(render, "-o --output FILE", f".exr: linear radiance; .png: {png}", required=True)
    _option(render, "--columns N", "width of the picture in pixels", type=_whole(16, 4096), default=640)
    _samples(render)
    _seed(render)

    compare = add("compare", f"{_DESIGNS}:compare", "image metrics of a simulation against the real thing")
    _option(compare, "simulated SIM", f"image file; or {MODEL_HELP} or `calibrate`")
    _option(compare, "real REAL", "image file; or a measurement folder")
    real = compare.add_argument_group("what one picture of the real sensor shows, beside a design")
    _option(real, "--untouched", "the gel without contact")
    _option(real, "--probe SPEC", "kind:size_mm such as sphere:4, or a mesh file")
    _noted(real)
    _option(real, "--background FILE", "pictures of the untouched gel, by which places are found", nargs="+")
    _option(real, "--response CURVE", "linear, srgb, gamma:G, or a file of lines 'encoded,linear'")
    _part(real)
    _out(compare, "folder for the simulated pictures, beside the real ones", required=False)
    _samples(compare)
    _seed(compare)

    calibrate = add(
        "calibrate",
        "designlab.app.cli.calibrate:calibrate",
        "the design under which the simulator gives a sensor's pictures",
    )
    _option(
        calibrate,
        "measurement MEASUREMENT",
        "folder with a measurement.toml; with --model, or --balls FOLDER in its place",
        nargs="?",
    )
    _option(calibrate, "--model MODEL", DESIGN_HELP + ", or what calibrate wrote", default=None)
    balls = calibrate.add_argument_group("calibration on balls, for reconstruct")
    _option(
        balls,
        "--balls FOLDER",
        "ball presses and a background: a measurement folder, or pictures, the background's name "
        "beginning with background; circles from balls.csv, else found",
        default=None,
    )
    _option(balls, "--ball-mm D", "diameter of the ball (mm)", type=float, default=None)
    _option(balls, "--mm-per-px S", "size of a pixel at the gel (mm)", type=float, default=None)
    _option(
        balls,
        "--thickness-mm T",
        "thickness of the gel (mm); that of --design, or fitted, when absent",
        type=float,
        default=None,
    )
    _option(
        balls,
        "--design MODEL",
        "preset or design file that says what the gel is; of a dome, or behind a lens that bends, also where "
        "pixels see it, and how steep it is there; its light does not matter",
        default=None,
    )
    _option(
        balls,
        "--crop-px N",
        "with --design, the part of the camera's sensor that pictures show: left, top, width, height",
        nargs=4,
        type=int,
        default=None,
    )
    _option(
        calibrate,
        "--baseline",
        "fit, in place of light transport, one distant light for each LED group on a surface of this "
        "reflection, starting from where the LEDs stand; calibrated.toml is then for compare and calibrate",
        choices=("diffuse", "phong"),
        default=None,
    )
    _option(
        calibrate,
        "--free FIELD",
        "numbers of the design, or of the probe such as probe.size_mm, to fit beside light and poses; after "
        "one may stand what is known of it, =4+-1.5 (value and standard deviation), =5..5.8 (bounds) or "
        "=4+-1.5,2..6 (default: contact.kernel_length_mm or contact.skin_length_mm, "
        "camera.horizontal_fov_deg, and contact.modulus_mpa where a press states depth_mm and force_n; of a "
        "baseline, which names these with design. in front, lights.N.azimuth_deg, lights.N.elevation_deg and "
        "exponent)",
        nargs="*",
    )
    _option(
        calibrate,
        "--layout",
        "find first where each LED group shines from, then fit azimuth, height and tilt of each",
    )
    _option(calibrate, "--columns N", "wider frames are binned to this", type=_whole(8, 2048), default=160)
    _out(calibrate, "folder for the calibrated model, the result and a picture of what is left")
    _trust(calibrate)
    _seed(calibrate)

    shapes = add(
        "reconstruct",
        "designlab.app.cli.reconstruct:reconstruct",
        "heights, normals and contact from pictures of one's own sensor",
    )
    _option(shapes, "pictures PICTURE", "files, folders, patterns or videos", nargs="*")
    _option(
        shapes,
        "--watch FOLDER",
        "reconstruct what a camera writes into a folder as it comes, until Ctrl-C",
        default=None,
    )
    _option(shapes, "--every N", "of a video, every Nth frame", type=_whole(1, 10**6), default=1)
    _option(
        shapes,
        "--mode",
        "accurate, or video: some hundredths of a second a picture",
        choices=("accurate", "video"),
        default="accurate",
    )
    _option(
        shapes,
        "--files",
        "kinds of files to write of each picture (default: all; height and contact in mode video; picture "
        "only of those that matter where there are many)",
        choices=("height", "tiff", "exr", "normals", "contact", "mesh", "picture"),
        default=None,
        nargs="+",
    )
    _option(
        shapes,
        "--calibration FILE",
        "calibration.npz of `calibrate --balls`, or of an earlier --design",
        default=None,
    )
    _option(
        shapes,
        "--design MODEL",
        "instead of a calibration: preset, design or model file that the pictures are taken to come from; "
        "needs --background",
        default=None,
    )
    _option(
        shapes,
        "--response CURVE",
        "with --design, the curve of the pictures: linear, srgb, gamma:G, or a file of lines "
        "'encoded,linear'; linear for EXR when absent",
        default=None,
    )
    _option(
        shapes,
        "--crop-px N",
        "with --design, the part of the camera's sensor that pictures show: left, top, width, height",
        nargs=4,
        type=int,
        default=None,
    )
    _option(
        shapes,
        "--markers",
        "printed markers: looked for in the background, filled in and followed; none ignores them",
        choices=("auto", "none"),
        default="auto",
    )
    _option(
        shapes,
        "--camera-mm Z",
        "with markers and --calibration, distance of the camera from the gel, for the shear (mm)",
        type=float,
        default=None,
    )
    _option(shapes, "--background FILE", "today's picture of the untouched gel", default=None)
    _option(
        shapes, "--gel NAME", "material of the gel, for forces; see docs/reference/catalogue.md", default=None
    )
    _option(shapes, "--modulus-mpa E", "Young's modulus of the gel instead (MPa)", type=float, default=None)
    _option(
        shapes,
        "--modulus-sd-mpa S",
        "its standard deviation (MPa); 10 %% when absent",
        type=float,
        default=None,
    )
    _option(shapes, "--mesh", "kind of the mesh", choices=("ply", "stl", "glb", "none"), default="ply")
    _out(shapes, "folder of the shapes; the same command again goes on there")

    export = add("export", f"{_DESIGNS}:export", "STL, STEP, 3MF, LED boards, bill of materials, checks")
    _option(export, "design DESIGN", DESIGN_HELP)
    _out(export, "folder to make; replaces an earlier export")
    _option(export, "--probe SPEC", "indenter to add (repeatable)", action="append", default=[])
    _mesh(export)
    _option(export, "--supply-v V", "supply of the LED boards", type=float, default=5.0)
    _option(export, "--no-boards", "leave the LED boards out")
    _option(export, "--allow-infeasible", "export although rules are broken, with warnings")


def _add_import(add: Any) -> None:
    command = add(
        "import",
        "designlab.app.cli.importing:import_pictures",
        "a camera's own files as linear images of a measurement folder",
    )
    _option(
        command,
        "sources SOURCE",
        "JPEG, PNG, TIFF, EXR, WebP, BMP, PGM, NPY or raw files, or folders of them; or one folder with a "
        "measurement.toml that says what each of its files shows",
        nargs="*",
    )
    _out(command, "measurement folder; frames are added to one that exists", required=False)
    shown = command.add_argument_group("what the pictures show (all of this call; several are repeats)")
    kinds = ("background", "press", "light_probe", "dark", "flat_field")
    _option(shown, "--kind", "what they show", choices=kinds, default=None)
    _option(shown, "--leds NAMES", "LED groups on, with commas; all when absent")
    _option(shown, "--exposure E", "relative exposure", type=float)
    _option(shown, "--probe SPEC", "kind:size_mm such as sphere:4, or a mesh file, which is copied")
    _mesh(shown)
    _noted(shown)
    text = "the same, read off the picture (px)"
    _option(shown, "--contact-diameter-px D", text, type=float)
    _part(shown)
    undone = command.add_argument_group("what is undone")
    curves = "linear, srgb, gamma:G, or a file of lines 'encoded,linear'; linear for raw files when absent"
    _option(undone, "--response CURVE", curves)
    _option(undone, "--ladder FILE=E", "estimate the response from one scene at exposures E", nargs="+")
    _option(undone, "--save-response FILE", "write the estimated response, for --response")
    _option(undone, "--dark FILE", "pictures with all LEDs off, imported too", nargs="+")
    _option(undone, "--black V", "value without light, as the files store it", type=float)
    _option(undone, "--white V", "value at full scale, as the files store it", type=float)
    patterns = ("RGGB", "BGGR", "GRBG", "GBRG")
    _option(undone, "--bayer", "pattern of files with one channel", choices=patterns, default=None)
    matrix = "matrix that the camera applied to linear R, G, B: nine numbers, row by row, or a file"
    _option(undone, "--colour-matrix M", matrix)
    sensor = command.add_argument_group("the sensor")
    _option(sensor, "--sensor DESIGN", DESIGN_HELP)
    _option(sensor, "--lens FILE", f"{LENS_HELP}, to put into a copy of the design")
    _lens(sensor)

    lens = add(
        "lens",
        "designlab.app.cli.importing:lens",
        "what a lens calibration says, and a design with this lens",
    )
    _option(lens, "file FILE", LENS_HELP)
    _option(lens, "--design DESIGN", f"whose camera has this lens: {DESIGN_HELP}")
    _option(lens, "--out FILE", "design file to write, a copy of DESIGN with this lens")
    _lens(lens)


def _lens(to: Any) -> None:
    text = "size of the calibrated pictures, such as 640x480, where the lens file states none"
    _option(to, "--lens-size WxH", text, type=_size)
    _option(to, "--fisheye", "cv2.fisheye made the lens file, where it does not say so")


def _add_study(add: Any) -> None:
    study = add("study", "", "search for better designs; resumable, many workers")
    actions = study.add_subparsers(metavar="ACTION", required=True, parser_class=_Parser)
    run = add("run", f"{_STUDY}:run", "evaluate designs until the study is done", to=actions, resume=_AGAIN)
    status = add("status", f"{_STUDY}:status", "how far a study is, and its best designs", to=actions)
    report = add("report", f"{_STUDY}:report", "one HTML page about a study", to=actions)
    for action in (run, status, report):
        _option(action, "study STUDY", "study file (TOML), or the folder of its results")
        _option(
            action,
            "--storage URL",
            "database that holds the record, for runs on several machines, "
            f"postgresql+psycopg://user@host/name (default: {STORAGE_VARIABLE} if set, else the folder)",
            default=os.environ.get(STORAGE_VARIABLE),
        )
    _out(run, "folder of the results (default: STUDY without .toml, with -out)", required=False)
    _out(status, "folder of the results, where `run` had one", required=False)
    _option(report, "--results DIR", "folder of the results, where `run` had --out")
    _option(report, "-o --output FILE", "page to write (default: report.html there)")
    _workers(run)
    _presses(run)
    _option(run, "--trials N", "designs in all, instead of the study's own", type=_whole(1, 100_000))
    _option(run, "--budget TIME", "time in all, such as 10min: fewer designs and a shorter confirmation")
    _option(run, "--no-confirm", "do not evaluate the best designs again")
    _option(run, "--rebuild", "make a new record of the scores kept; the old one stays")


def _add_tolerance(add: Any) -> None:
    command = add(
        "tolerance",
        "designlab.app.cli.tolerance:tolerance",
        "copies of a design as they would be built: how many are good, and what is to blame",
        resume=_AGAIN,
    )
    _option(command, "design DESIGN", MODEL_HELP)
    _option(command, "--terms FILE", "TOML file: what a copy must score, what differs between copies")
    _option(command, "--copies N", "how many (default: 200)", type=_whole(2, 100_000), default=200)
    _option(
        command, "--calibrate", "calibrate each copy, or the drawing once for all", choices=("each", "once")
    )
    _option(command, "--fidelity", "effort", choices=FIDELITIES)
    _workers(command)
    _option(command, "--dask ADDRESS", "Dask scheduler whose workers run the copies, tcp://host:8786")
    _out(command, "folder of the copies and the report; the same command again goes on there")
    _seed(command)


def _add_gap(add: Any) -> None:
    gap = add("gap", "", "what a model lacks: diagnose a measurement, or make one with a hidden effect")
    actions = gap.add_subparsers(metavar="ACTION", required=True, parser_class=_Parser)
    plant = add("plant", f"{_GAP}:plant", "a measurement set with a hidden effect, answer apart", to=actions)
    _option(
        plant,
        "--effect NAME[:P=V,...]",
        "effect to hide (repeatable); values not given are drawn from the seed; left out: nothing is hidden",
        action="append",
        default=[],
    )
    _option(plant, "--design DESIGN", DESIGN_HELP, default=_PRESET)
    strength = "distance of drawn values from null in usual spreads (default: 1.5)"
    _option(plant, "--strength S", strength, type=float, default=1.5)
    plant.add_argument("--kit", choices=("hour", "small"), default="hour", help="which presses are taken")
    kit_seed = "seed of the stated places (default: that of --seed)"
    _option(plant, "--kit-seed N", kit_seed, type=_whole(0, _LARGEST_SEED))
    _option(
        plant,
        "--outside KIND[:STRENGTH]",
        "departure that no effect explains (repeatable): printed_markers, debris, second_contact, "
        "lens_ghost, wrong_object, jpeg_blocks, moire or water_drop",
        action="append",
        default=[],
    )
    dirt = (
        "light off by 1 to 5 %%, grain, gaps between LEDs, other boards, rounded edges, poses read off the "
        "picture"
    )
    _option(plant, "--dirt", f"a sensor as labs have them: {dirt}")
    text = "what is noted of how deep presses are: force and circle for balls on elastic gels"
    _option(plant, "--noted", text, choices=("depth", "force", "circle", "nothing"))
    _option(plant, "--unplaced", "places and yaws of presses are not noted")
    _option(plant, "--flat-field", "add a frame of uniform light")
    _option(plant, "--columns N", "image width in pixels", type=_whole(8, 2048), default=96)
    _out(plant, "folder to make; the answer is written beside it")
    _seed(plant)

    resume = "the pictures rendered so far are kept; run the same command again to go on"
    diagnose = add(
        "diagnose", f"{_GAP}:diagnose", "name the effects a model lacks", to=actions, resume=resume
    )
    _option(diagnose, "measurement MEASUREMENT", "folder with a measurement.toml")
    _option(diagnose, "--model MODEL", MODEL_HELP, required=True)
    most = "presses to use at most, those that differ most in place, depth and probe (default: 20)"
    _option(diagnose, "--most-presses N", most, type=_whole(3, 10_000))
    _out(diagnose, "folder of the report and the updated model; the same command again goes on there")
    _trust(diagnose)
    _option(diagnose, "--renders DIR", "folder of pictures that several diagnoses share (default: in --out)")
    _option(
        diagnose,
        "--effects NAME",
        "effects to try (default: all that can act on the design, but those tried by name alone)",
        nargs="+",
    )
    _seed(diagnose)

    text = "diagnose a pool of generated sets and score it"
    benchmark = add("benchmark", f"{_GAP}:benchmark", text, to=actions)
    _option(benchmark, "--only REGEX", "sets whose name matches (default: the whole pool)", default="")
    _option(
        benchmark,
        "--pool",
        "quick: six small sets, to see that all works; development: sets without and with one effect, "
        "and outside the catalogue; power: each effect at rising strengths, for the smallest that is named; "
        "calibration: the families of the test, for the errors of fitted values; test: the sealed sets",
        choices=("quick", "development", "power", "calibration", "test"),
        default="development",
    )
    _option(
        benchmark,
        "--frozen COMMIT",
        "commit that froze the thresholds, from which --pool test takes its seeds; the code must be "
        "as it was there",
    )
    _option(
        benchmark,
        "--again",
        "run sets of a pool that was opened once more by later code, for its time and what it changes; "
        "no opening, since the sets are known",
    )
    _option(
        benchmark,
        "--dirt",
        f"sensors as labs have them, in --pool calibration and test: {dirt}",
    )
    _option(benchmark, "--shard K/N", "the k-th of n parts of the pool, 1/4 to 4/4 (default: all)")
    _option(
        benchmark,
        "--records FILE",
        "records.jsonl of an earlier run by the same code: its sets are not run again, and count; "
        "records.jsonl in --out holds both",
    )
    _option(
        benchmark, "--base N", "start of the seeds (default: 0)", type=_whole(0, _LARGEST_SEED), default=0
    )
    _option(
        benchmark,
        "--transfer",
        "see how much better the corrected models predict another design: LEDs 3 mm higher, 15 deg more "
        "tilted, with the same hidden effect",
    )
    _option(
        benchmark,
        "--kit",
        "frames that are used of each set: all; all but the dark frame; all but those of single LED "
        "groups; without these, other exposures and the turned gel",
        choices=("hour", "no_dark", "no_groups", "plain"),
    )
    further = "take the frames that each ambiguous report asks for, and see whether they settle the matter"
    _option(benchmark, "--further", further)
    _workers(benchmark)
    _option(benchmark, "--dask ADDRESS", "Dask scheduler whose workers run the sets, tcp://host:8786")
    _out(benchmark, "folder of sets, reports and scores; the same command again goes on where it ended")


def _option(to: Any, words: str, text: str, **more: Any) -> None:
    """Add an argument to a parser or a group.

    Parameters
    ----------
    to : argparse.ArgumentParser or argument group
        Where to add it.
    words : str
        Its names and the placeholder of its value, such as ``-o --output FILE``. An option without a
        placeholder is a switch or takes one of `choices`, of which the first is the default, and named so.
    text : str
        Its help.
    **more
        What `add_argument` takes besides.
    """
    *names, last = words.split()
    if not last.startswith("-"):
        more["metavar"] = last
    else:
        names.append(last)
        if "choices" not in more:
            more["action"] = "store_true"
        elif more.setdefault("default", more["choices"][0]) is not None:
            text += " (default: %(default)s)"
    to.add_argument(*names, help=text, **more)


def _noted(to: Any) -> None:
    """What a lab notes of a press: depth, force or circle, place and yaw, each left out where not known."""
    _option(to, "--depth-mm D", "how deep it was pressed (mm)", type=float)
    _option(to, "--force-n F", "force on it (N), which tells the depth on an elastic gel", type=float)
    text = "diameter of the contact circle of a ball (mm), which tells the depth"
    _option(to, "--contact-diameter-mm D", text, type=float)
    text = "least and greatest depth, where it is not known (default: from the thickness of the gel)"
    _option(to, "--depth-range-mm LO,HI", text, type=_point)
    _option(to, "--at X,Y", "where its axis meets the gel (mm); else read off the picture", type=_point)
    _option(to, "--yaw-deg A", "its rotation, counter-clockwise (deg)", type=float)
    _direction(to)


def _part(to: Any) -> None:
    text = "part of the camera's full picture that the files show, where not the whole"
    _option(to, "--crop-px X,Y,W,H", text, type=_crop)


def _direction(to: Any) -> None:
    text = "along the sensor's axis (default) or the membrane's normal at that place"
    _option(to, "--direction", text, choices=("axis", "normal"), default=None)


def _mesh(command: Any) -> None:
    text = "unit of a mesh file that states none (mm when absent, if that is plausible)"
    _option(command, "--probe-unit", text, choices=UNITS, default=None)
    text = "side of a mesh that presses, by the axes of its file (+z when absent)"
    _option(command, "--probe-side", text, choices=SIDES, default=None)


def _workers(command: argparse.ArgumentParser) -> None:
    _option(command, "--workers N", "processes at once (default: 1)", type=_whole(1, 256), default=1)


def _out(command: argparse.ArgumentParser, text: str, *, required: bool = True) -> None:
    _option(command, "--out DIR", text, required=required)


def _presses(command: argparse.ArgumentParser) -> None:
    text = "depth of the deepest press (mm), the same for all designs (default: 0.8, less on small areas)"
    _option(command, "--depth-mm D", text, type=float)
    text = "force of the strongest press (N) instead, the same for all designs; for elastic gels"
    _option(command, "--force-n F", text, type=float)


def _seed(command: argparse.ArgumentParser, *, default: int = 0) -> None:
    seed = _whole(0, _LARGEST_SEED)
    _option(command, "--seed N", "random seed (default: %(default)s)", type=seed, default=default)


def _samples(command: argparse.ArgumentParser) -> None:
    _option(command, "--samples N", "light paths a pixel (default: 64)", type=_whole(1, 65536), default=64)


def _trust(command: argparse.ArgumentParser) -> None:
    text = "go on although pictures look suspicious (repeatable); the refusal says which name"
    _option(command, "--trust NAME", text, action="append", default=[])


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


def _crop(text: str) -> tuple[int, int, int, int]:
    try:
        x, y, width, height = (int(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"must be four whole numbers X,Y,WIDTH,HEIGHT in px, got {text!r}"
        ) from None
    return x, y, width, height


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,6})[xX](\d{1,6})", text.strip())
    if match is None:
        raise argparse.ArgumentTypeError(f"must be width and height in px such as 640x480, got {text!r}")
    return int(match[1]), int(match[2])


def _with_negative_values(arguments: Sequence[str]) -> list[str]:
    """Join ``--at -1,2`` to ``--at=-1,2``: argparse takes a leading minus for an option."""
    joined: list[str] = []
    for argument in arguments:
        if joined and any(
            joined[-1] == option and re.match(value, argument) for option, value in _WITH_MINUS.items()
        ):
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined
