"""Arguments that several commands share, and how their values are read."""

import argparse
import re
from typing import Any, NoReturn

# As geometries.mesh_files has them, which is not imported here: help is instant.
UNITS = ("um", "mm", "cm", "m", "inch")
SIDES = ("+z", "-z", "+x", "-x", "+y", "-y")
FIDELITIES = ("fast", "standard", "reference")
DESIGN_HELP = "preset name (see `designlab presets`) or TOML file"
MODEL_HELP = "preset name, design file, or model file written by `gap`"
PRESET = "default"
AGAIN = "run the same command again to resume"
LARGEST_SEED = 2**31 - 1


class UsageError(ValueError):
    """Arguments that fit no command; the text names the argument and the rule."""


class Parser(argparse.ArgumentParser):
    """A parser that raises instead of exiting, so that wrong arguments read like other bad input."""

    def __init__(self, **options: Any) -> None:
        super().__init__(allow_abbrev=False, **options)

    def error(self, message: str) -> NoReturn:
        """Raise what is wrong with the arguments."""
        raise UsageError(f"{message} (see `{self.prog} --help`)")


def option(to: Any, words: str, text: str, **more: Any) -> None:
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


def noted(to: Any) -> None:
    """What a lab notes of a press: depth, force or circle, place and yaw, each left out where not known."""
    option(to, "--depth-mm D", "how deep it was pressed (mm)", type=float)
    option(to, "--force-n F", "force on it (N), which tells the depth on an elastic gel", type=float)
    text = "diameter of the contact circle of a ball (mm), which tells the depth"
    option(to, "--contact-diameter-mm D", text, type=float)
    text = "least and greatest depth, where it is not known (default: from the thickness of the gel)"
    option(to, "--depth-range-mm LO,HI", text, type=point)
    option(to, "--at X,Y", "where its axis meets the gel (mm); else read off the picture", type=point)
    option(to, "--yaw-deg A", "its rotation, counter-clockwise (deg)", type=float)
    direction(to)


def part(
    to: Any, text: str = "part of the camera's full picture that the files show, where not the whole"
) -> None:
    """Part of the full picture that files show."""
    option(to, "--crop-px X,Y,W,H", text, type=crop)


def direction(to: Any) -> None:
    """Direction of a press."""
    text = "along the sensor's axis (default) or the membrane's normal at that place"
    option(to, "--direction", text, choices=("axis", "normal"), default=None)


def mesh(command: Any) -> None:
    """How a mesh file is to be read."""
    text = "unit of a mesh file that states none (mm when absent, if that is plausible)"
    option(command, "--probe-unit", text, choices=UNITS, default=None)
    text = "side of a mesh that presses, by the axes of its file (+z when absent)"
    option(command, "--probe-side", text, choices=SIDES, default=None)


def workers(command: argparse.ArgumentParser) -> None:
    """Processes at once."""
    option(command, "--workers N", "processes at once (default: 1)", type=whole(1, 256), default=1)


def out(command: argparse.ArgumentParser, text: str, *, required: bool = True) -> None:
    """Folder of results."""
    option(command, "--out DIR", text, required=required)


def presses(command: argparse.ArgumentParser) -> None:
    """Depth or force of the presses that scores are of."""
    text = "depth of the deepest press (mm), the same for all designs (default: 0.8, less on small areas)"
    option(command, "--depth-mm D", text, type=float)
    text = "force of the strongest press (N) instead, the same for all designs; for elastic gels"
    option(command, "--force-n F", text, type=float)


def seed(command: argparse.ArgumentParser, *, default: int = 0) -> None:
    """Seed of what is drawn."""
    read = whole(0, LARGEST_SEED)
    option(command, "--seed N", "random seed (default: %(default)s)", type=read, default=default)


def samples(command: argparse.ArgumentParser) -> None:
    """Light paths of a picture."""
    option(command, "--samples N", "light paths a pixel (default: 64)", type=whole(1, 65536), default=64)


def trust(command: argparse.ArgumentParser) -> None:
    """Suspicions that are set aside."""
    text = "go on although pictures look suspicious (repeatable); the refusal says which name"
    option(command, "--trust NAME", text, action="append", default=[])


def whole(low: int, high: int) -> Any:
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


def point(text: str) -> tuple[float, float]:
    """Read two numbers, X,Y."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be two numbers X,Y in mm, got {text!r}") from None
    return x, y


def crop(text: str) -> tuple[int, int, int, int]:
    """Read a part of a picture, X,Y,WIDTH,HEIGHT."""
    try:
        x, y, width, height = (int(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"must be four whole numbers X,Y,WIDTH,HEIGHT in px, got {text!r}"
        ) from None
    return x, y, width, height


def size(text: str) -> tuple[int, int]:
    """Read the size of a picture, WIDTHxHEIGHT."""
    match = re.fullmatch(r"(\d{1,6})[xX](\d{1,6})", text.strip())
    if match is None:
        raise argparse.ArgumentTypeError(f"must be width and height in px such as 640x480, got {text!r}")
    return int(match[1]), int(match[2])
