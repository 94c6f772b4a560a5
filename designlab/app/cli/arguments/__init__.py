"""The command line: commands, their arguments and their help."""

import argparse
import re
from collections.abc import Sequence
from typing import Any

from designlab.app.cli.arguments.designs import add_designs
from designlab.app.cli.arguments.gap import add_gap
from designlab.app.cli.arguments.options import PRESET, Parser, option, out, seed, whole
from designlab.app.cli.arguments.pictures import add_calibration, add_import, add_reconstruct
from designlab.app.cli.arguments.studies import add_study, add_tolerance
from designlab.core import __version__

_START = "designlab.app.cli.start"
_DESIGNS = "designlab.app.cli.designs"

_WITH_MINUS = {"--at": r"-[\d.]", "--probe-side": r"-[xyz]$"}

_EPILOGUE = """\
Every command takes --json: one JSON object on stdout and nothing else there.
Exit status: 0 done, 1 failure, 2 bad input, 130 interrupted.
First steps: designlab doctor; designlab init my-sensor; designlab demo --out demo-out
"""


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
    option(common, "--json", "print one JSON object instead of text")
    option(common, "--debug", "show the traceback of a failure")
    top = Parser(
        prog="designlab",
        parents=[common],
        description="Design, simulate, score and diagnose camera-based tactile sensors.",
        epilog=_EPILOGUE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"designlab {__version__}")
    commands = top.add_subparsers(metavar="COMMAND", required=True, parser_class=Parser)

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
    option(presets, "name NAME", "preset to print", nargs="?")
    parts = add("parts", f"{_DESIGNS}:parts", "LEDs with the figures of their data sheets")
    option(parts, "name NAME", "part to show, with its source; or a TOML file of own parts", nargs="?")
    init = add("init", f"{_START}:init", "a starter folder: design, study, notebook, measurement template")
    option(init, "folder DIR", "folder to make; must not exist, or be empty")
    option(init, "--preset NAME", "sensor to start from (default: %(default)s)", default=PRESET)
    demo = add("demo", f"{_START}:demo", "the main job end to end on a small budget")
    out(demo, "folder of the results; the same command again goes on where it ended")
    seed(demo)
    add_designs(add)
    add_import(add)
    add_calibration(add)
    add_reconstruct(add)
    add_study(add)
    add_tolerance(add)
    add_gap(add)
    studio = add(
        "studio",
        "designlab.app.cli.studio:studio",
        "live page in the browser: turn a knob, see what the sensor sees",
    )
    option(
        studio,
        "thing DESIGN",
        "preset name or TOML file; or the folder of a study or a diagnosis (default: %(default)s)",
        nargs="?",
        default=PRESET,
    )
    local = "address to listen on; another one than this machine's own asks for a token, which is printed"
    option(studio, "--host HOST", local, default="127.0.0.1")
    option(studio, "--port PORT", "0 takes a free one", type=whole(0, 65535), default=8421)
    reproduce = add(
        "reproduce",
        "designlab.app.cli.reproduce:reproduce",
        "the experiments of arXiv 2012.13184 on made sensors, its figures beside ours",
    )
    out(reproduce, "folder of the results; the same command again goes on where it ended")
    option(
        reproduce,
        "--size",
        "full: the paper's layout, hours on a few cores; reduced: some minutes, shows that it runs",
        choices=("full", "reduced"),
    )
    seed(reproduce, default=1)
    return top


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
