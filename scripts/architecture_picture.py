"""Draw the picture of docs/architecture.md: the rooms of designlab, and the two paths through them.

.venv/bin/python scripts/architecture_picture.py        writes docs/images/architecture.png
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch
from PIL import Image

TARGET = Path(__file__).parents[1] / "docs" / "images" / "architecture.png"
SIZE_IN, DPI = (13.0, 8.45), 125
INK, FAINT, PAPER = "#1f2733", "#6b7686", "#fbfbf9"
SCORE, EFFECT = "#2563a8", "#c2571a"  # colours of the two paths
FLOOR_HEIGHT, ROOM_HEIGHT, GAP = 0.9, 0.76, 0.12
HOUSE = (2.05, 8.2)  # left and right wall


class Room(NamedTuple):
    """A package, what it is for, its colour, and which steps of the two paths it does."""

    name: str
    does: str
    colour: str
    score: tuple[int, ...] = ()
    effect: tuple[int, ...] = ()


TOP, PROOF, PAGES, ANSWERS, FIGURES, PICTURE, THINGS, GEL, BASE = (
    "#e9e4f3", "#e4e9f5", "#dfeef5", "#dff1ec", "#e6f2dd", "#f6f0d3", "#f8e6d3", "#f3e3e3", "#e9e9e6",
)  # fmt: skip
FLOORS = (
    (Room("app", "command line, demo, check of the machine", TOP),),
    (Room("validation", "independent generator, blind benchmarks, the experiments of 2020", PROOF),),
    (Room("report", "plots, prose, HTML pages, 3D views", PAGES, (11,), (8,)),),
    (
        Room("inference", "measurement to parameters\nand named effects", ANSWERS, (), (3, 4, 5, 6)),
        Room("optimization", "studies, build tolerances", ANSWERS, (9,)),
    ),
    (
        Room("measurement", "real frames,\nchecked", FIGURES, (), (1,)),
        Room("evaluation", "presses to scores,\nstandard errors", FIGURES, (8,)),
        Room("fabrication", "files to make it", FIGURES, (10,)),
    ),
    (Room("simulation", "design and press to picture", PICTURE, (3, 4, 5, 6), (2, 7)),),
    (
        Room("sensor", "what a sensor is: design, rules, camera", THINGS, (1,)),
        Room("reconstruction", "picture to normals to height", THINGS, (7,)),
    ),
    (Room("mechanics", "elastic layers and contact: arrays in, arrays out", GEL, (3,)),),
    (Room("core", "files, cache and run folders, images, metrics, processes, back end", BASE),),
)
OUTSIDE = Room("geometries", "CAD of every part", "#ffffff", (2,))  # beside the library
PATHS = (
    (
        "From a design to its score",
        SCORE,
        (
            "a design is read and held against its rules",
            "its parts give their outlines, heights, solids",
            "a press deforms the membrane",
            "design and membrane become a scene",
            "light of each LED group at unit power",
            "lens, effects, mixing, camera",
            "pictures become normals and heights",
            "scores with standard errors",
            "a study searches for better designs",
            "files to make the best one",
            "a page with the verdict first",
        ),
    ),
    (
        "From a measurement to a named effect",
        EFFECT,
        (
            "frames are loaded and checked",
            "the model predicts every frame",
            "pictures and their derivatives are kept",
            "gains, poses and values are fitted",
            "candidates are judged on held-out presses",
            "verdict, intervals, next measurement",
            "the effects join the model",
            "a page that says so in words",
        ),
    ),
)


def main() -> None:
    figure = Figure(figsize=SIZE_IN, dpi=DPI, facecolor=PAPER)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, SIZE_IN[0]), ylim=(0, SIZE_IN[1]))
    axes.axis("off")
    bottom = 0.0
    for number, floor in enumerate(FLOORS):
        bottom = SIZE_IN[1] - 0.15 - (number + 1) * FLOOR_HEIGHT + (FLOOR_HEIGHT - ROOM_HEIGHT)
        width = (HOUSE[1] - HOUSE[0] - GAP * (len(floor) - 1)) / len(floor)
        for place, room in enumerate(floor):
            draw_room(axes, room, HOUSE[0] + place * (width + GAP), bottom, width)
    draw_room(axes, OUTSIDE, 0.2, bottom + FLOOR_HEIGHT, HOUSE[0] - 0.2 - GAP, dashed=True)
    arrow = FancyArrowPatch(
        (1.2, SIZE_IN[1] - 0.3), (1.2, 2.2), arrowstyle="-|>", mutation_scale=18, color=FAINT, linewidth=1.4
    )
    axes.add_patch(arrow)
    axes.text(0.98, 4.9, "imports go down only", rotation=90, ha="center", va="center", color=FAINT, size=10)
    top = SIZE_IN[1] - 0.35
    for title, colour, steps in PATHS:
        top = draw_path(axes, title, colour, steps, top) - 0.3
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    picture.quantize(128).save(TARGET, optimize=True)


def draw_room(
    axes: Axes, room: Room, left: float, bottom: float, width: float, *, dashed: bool = False
) -> None:
    """Draw a room with its name, what it does, and the steps that pass through it."""
    box = FancyBboxPatch(
        (left, bottom), width, ROOM_HEIGHT,
        boxstyle="round,pad=0,rounding_size=0.09",
        facecolor=room.colour, edgecolor=FAINT, linewidth=0.8, linestyle="--" if dashed else "-",
    )  # fmt: skip
    axes.add_patch(box)
    two = "\n" in room.does
    axes.text(
        left + 0.13, bottom + ROOM_HEIGHT - 0.2, room.name, color=INK, size=12.5, weight="bold", va="center"
    )
    axes.text(
        left + 0.13,
        bottom + (0.27 if two else 0.24),
        room.does,
        color=INK,
        size=8.6,
        va="center",
        linespacing=1.15,
    )
    x = left + width - 0.2
    for colour, steps in ((EFFECT, room.effect), (SCORE, room.score)):
        for step in reversed(steps):
            bubble(axes, x, bottom + ROOM_HEIGHT - 0.2, step, colour)
            x -= 0.29


def bubble(axes: Axes, x: float, y: float, step: int, colour: str) -> None:
    """Draw the number of a step."""
    axes.plot(x, y, "o", color=colour, markersize=15)
    axes.text(x, y - 0.01, str(step), color="white", size=8.5, weight="bold", ha="center", va="center")


def draw_path(axes: Axes, title: str, colour: str, steps: tuple[str, ...], top: float) -> float:
    """List the steps of a path, and return where the list ends."""
    left = HOUSE[1] + 0.4
    axes.text(left, top, title, color=colour, size=13, weight="bold", va="center")
    for number, step in enumerate(steps, 1):
        top -= 0.325
        bubble(axes, left + 0.14, top, number, colour)
        axes.text(left + 0.42, top, step, color=INK, size=10.2, va="center")
    return top - 0.3


if __name__ == "__main__":
    main()
