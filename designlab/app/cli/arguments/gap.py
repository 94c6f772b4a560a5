"""Arguments of the gap workflow: plant, diagnose, benchmark."""

from typing import Any

from designlab.app.cli.arguments.options import (
    DESIGN_HELP,
    LARGEST_SEED,
    MODEL_HELP,
    PRESET,
    Parser,
    option,
    out,
    seed,
    trust,
    whole,
    workers,
)

_GAP = "designlab.app.cli.gap"


def add_gap(add: Any) -> None:
    """Add gap and its actions."""
    gap = add("gap", "", "what a model lacks: diagnose a measurement, or make one with a hidden effect")
    actions = gap.add_subparsers(metavar="ACTION", required=True, parser_class=Parser)
    plant = add("plant", f"{_GAP}:plant", "a measurement set with a hidden effect, answer apart", to=actions)
    option(
        plant,
        "--effect NAME[:P=V,...]",
        "effect to hide (repeatable); values not given are drawn from the seed; left out: nothing is hidden",
        action="append",
        default=[],
    )
    option(plant, "--design DESIGN", DESIGN_HELP, default=PRESET)
    strength = "distance of drawn values from null in usual spreads (default: 1.5)"
    option(plant, "--strength S", strength, type=float, default=1.5)
    plant.add_argument("--kit", choices=("hour", "small"), default="hour", help="which presses are taken")
    kit_seed = "seed of the stated places (default: that of --seed)"
    option(plant, "--kit-seed N", kit_seed, type=whole(0, LARGEST_SEED))
    option(
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
    option(plant, "--dirt", f"a sensor as labs have them: {dirt}")
    text = "what is noted of how deep presses are: force and circle for balls on elastic gels"
    option(plant, "--noted", text, choices=("depth", "force", "circle", "nothing"))
    option(plant, "--unplaced", "places and yaws of presses are not noted")
    option(plant, "--flat-field", "add a frame of uniform light")
    option(plant, "--columns N", "image width in pixels", type=whole(8, 2048), default=96)
    out(plant, "folder to make; the answer is written beside it")
    seed(plant)

    resume = "the pictures rendered so far are kept; run the same command again to go on"
    diagnose = add(
        "diagnose", f"{_GAP}:diagnose", "name the effects a model lacks", to=actions, resume=resume
    )
    option(diagnose, "measurement MEASUREMENT", "folder with a measurement.toml")
    option(diagnose, "--model MODEL", MODEL_HELP, required=True)
    most = "presses to use at most, those that differ most in place, depth and probe (default: 20)"
    option(diagnose, "--most-presses N", most, type=whole(3, 10_000))
    out(diagnose, "folder of the report and the updated model; the same command again goes on there")
    trust(diagnose)
    option(diagnose, "--renders DIR", "folder of pictures that several diagnoses share (default: in --out)")
    option(
        diagnose,
        "--effects NAME",
        "effects to try (default: all that can act on the design, but those tried by name alone)",
        nargs="+",
    )
    seed(diagnose)

    text = "diagnose a pool of generated sets and score it"
    benchmark = add("benchmark", f"{_GAP}:benchmark", text, to=actions)
    option(benchmark, "--only REGEX", "sets whose name matches (default: the whole pool)", default="")
    option(
        benchmark,
        "--pool",
        "quick: six small sets, to see that all works; development: sets without and with one effect, "
        "and outside the catalogue; power: each effect at rising strengths, for the smallest that is named; "
        "calibration: the families of the test, for the errors of fitted values; test: the sealed sets",
        choices=("quick", "development", "power", "calibration", "test"),
        default="development",
    )
    option(
        benchmark,
        "--frozen COMMIT",
        "commit that froze the thresholds, from which --pool test takes its seeds; the code must be "
        "as it was there",
    )
    option(
        benchmark,
        "--again",
        "run sets of a pool that was opened once more by later code, for its time and what it changes; "
        "no opening, since the sets are known",
    )
    option(
        benchmark,
        "--dirt",
        f"sensors as labs have them, in --pool calibration and test: {dirt}",
    )
    option(benchmark, "--shard K/N", "the k-th of n parts of the pool, 1/4 to 4/4 (default: all)")
    option(
        benchmark,
        "--records FILE",
        "records.jsonl of an earlier run by the same code: its sets are not run again, and count; "
        "records.jsonl in --out holds both",
    )
    option(benchmark, "--base N", "start of the seeds (default: 0)", type=whole(0, LARGEST_SEED), default=0)
    option(
        benchmark,
        "--transfer",
        "see how much better the corrected models predict another design: LEDs 3 mm higher, 15 deg more "
        "tilted, with the same hidden effect",
    )
    option(
        benchmark,
        "--kit",
        "frames that are used of each set: all; all but the dark frame; all but those of single LED "
        "groups; without these, other exposures and the turned gel",
        choices=("hour", "no_dark", "no_groups", "plain"),
    )
    further = "take the frames that each ambiguous report asks for, and see whether they settle the matter"
    option(benchmark, "--further", further)
    workers(benchmark)
    option(benchmark, "--dask ADDRESS", "Dask scheduler whose workers run the sets, tcp://host:8786")
    out(benchmark, "folder of sets, reports and scores; the same command again goes on where it ended")
