"""The guide that a sensor is built by, made of its design: shopping list, recipes, steps with pictures."""

import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter

from designlab.core.images import png_bytes, tone_map
from designlab.fabrication import BOARD_COLOUR, PART_COLOURS, Built, package_colour
from designlab.fabrication.assembly import Step
from designlab.fabrication.boards import Board
from designlab.fabrication.tables import CASTING_SURPLUS
from designlab.report.page import Html, Section, listed, page, paragraph, picture, table
from designlab.report.view3d.apart import Apart, Drawn, pictures_apart
from designlab.sensor.contact import LayerContact
from designlab.sensor.design import Design
from designlab.sensor.gel_materials import MATERIALS
from designlab.sensor.refraction import apparent_distance_mm
from designlab.simulation.simulator import Simulator

PICTURES = "guide"
MARKDOWN, WEBPAGE = "guide.md", "guide.html"
FIRST_PICTURE = "first-picture.png"
COLUMNS, SAMPLES, SEED = 320, 96, 0
"""Effort of the expected first picture."""
SMOOTHED_PX = 1.5
"""Of that picture: what differs within so few pixels is noise of the simulation."""
OVERVIEW = "all.png"
GLUED = ("board", "core_ring", "core")
"""Steps that need sealant."""
FROM_BELOW = ("board", "core_ring", "core")
"""Steps whose parts go in from the gel's side."""
WHOLE = ("gelcore", "elastomer", "camera", "core_ring")
"""Parts that are not cut open once they are in place; in the viewer's half, others would hang in the air."""
AWAY = 0.75  # of a part's way out at which it is drawn
SPREAD_MM = 5.0  # between parts in the picture of all of them
SUPPLY_V = 5.0  # where no board says more
_WORDS: dict[str, Any] = tomllib.loads(
    files(__package__).joinpath("build_guide.toml").read_text(encoding="utf-8")
)


class GuideStep(NamedTuple):
    """One step: what is done, numbers of the parts that it uses, and the file of its picture if any."""

    title: str
    text: tuple[str, ...]
    parts: tuple[str, ...]
    picture: str = ""


class Chapter(NamedTuple):
    """A heading with paragraphs, then rows of a table, then steps, then pictures with their captions."""

    title: str
    text: tuple[str, ...] = ()
    rows: tuple[Mapping[str, Any], ...] = ()
    steps: tuple[GuideStep, ...] = ()
    pictures: tuple[tuple[str, str], ...] = ()


def write(built: Built, folder: Path) -> list[str]:
    """Write ``guide.md``, ``guide.html`` and their pictures into the folder of an export.

    Parameters
    ----------
    built : Built
        What the export made; its housing has seats.
    folder : Path
        The folder.

    Returns
    -------
    list of str
        Why pictures are missing, if so.
    """
    pictures = folder / PICTURES
    pictures.mkdir()
    reason = _draw(built, pictures)
    frame = Simulator(built.design, columns=COLUMNS, samples=SAMPLES, seed=SEED).frame(None)
    smooth = gaussian_filter(frame.mixed, (SMOOTHED_PX, SMOOTHED_PX, 0), mode="nearest")
    (pictures / FIRST_PICTURE).write_bytes(png_bytes(tone_map(smooth)))
    found = chapters(built, drawn=not reason)
    title = f"How to build {built.design.name}"
    (folder / MARKDOWN).write_text(_markdown(title, found), encoding="utf-8")
    (folder / WEBPAGE).write_text(_webpage(title, found, pictures), encoding="utf-8")
    return [f"the guide has no pictures of its steps: {reason}"] if reason else []


def chapters(built: Built, *, drawn: bool = True) -> list[Chapter]:
    """Content of the guide of an export; without `drawn`, steps show no pictures."""
    design, words = built.design, _WORDS["chapters"]
    shopping = [
        {"part": row["part"], "item": row["item"], "count": row["count"], "what": row["material"]}
        | {"mass_g": "" if row["mass_g"] is None else row["mass_g"], "note": row["note"]}
        for row in built.manifest["bom"]
    ]
    overview = ((f"{PICTURES}/{OVERVIEW}", words["overview"]),) if drawn else ()
    first = ((f"{PICTURES}/{FIRST_PICTURE}", words["first_picture"]),)
    about = tuple(text for text in (design.description, design.lineage) if text)
    return [
        Chapter("What it is", about, pictures=overview),
        Chapter("What to buy and make", tuple(words["buy"]), rows=tuple(shopping)),
        Chapter("Tools", tuple(words["tools"])),
        Chapter("Print settings", _print_settings(design)),
        Chapter("Gel", _gel(built)),
        Chapter("Coating", _coating(design)),
        Chapter("Steps", steps=tuple(steps(built, drawn=drawn))),
        Chapter("Camera settings", _camera(design)),
        Chapter("First measurement", tuple(words["measure"]), pictures=first),
    ]


def steps(built: Built, *, drawn: bool = True) -> list[GuideStep]:
    """Steps of the guide, in order; every part of the bill of materials is used in one of them."""
    number = {row["item"]: row["part"] for row in built.manifest["bom"]}
    design, drives = built.design, built.manifest["drive"]
    seats = design.housing.seats
    assert seats is not None
    painted = "painted matt black" if design.gelcore.side_finish == "painted" else design.gelcore.side_finish
    supply = drives[0]["supply_v"] if drives else SUPPLY_V
    told = {"finish": painted, "gap": seats.gap_mm, "supply": supply}

    def step(key: str, *items: str, picture: str = "", before: Sequence[str] = (), **more: Any) -> GuideStep:
        words = _WORDS["steps"][key]
        text = [*before, *(line.format(**told, **more) for line in words["text"])]
        used = tuple(number[item] for item in items if item in number)
        return GuideStep(words["title"].format(**told, **more), tuple(text), used, picture)

    leds = [item for item in number if item.startswith("led_")]
    probes = [item for item in number if item.startswith("probe")]
    found = [
        step("print", "housing", "lid", "core_ring", "mould_cavity", "mould_lid", "paint"),
        step("gelcore", "gelcore", *(("paint",) if design.gelcore.side_finish == "painted" else ())),
        step("gel", "elastomer", "mould_cavity", "mould_lid"),
        step("membrane", "membrane"),
    ]
    if built.boards is not None:
        names = [board.name for board in built.boards.boards]
        found.append(step("boards", *names, *leds, "wire"))
    elif leds:
        found.append(step("leds", *leds, "wire"))
    boards = {} if built.boards is None else {board.name: board for board in built.boards.boards}
    for place, put in enumerate(built.order):
        key, where = put.key, {"part": put.parts[0]}
        if put.key == "board":
            where |= _pocket(design, boards[put.parts[0]])
            ring = boards[put.parts[0]].blank.kind == "ring"
            key = "board_ring" if ring else "board_leaning" if len(put.way) > 1 else "board"
        tried = ("gelcore", *boards) if put.key == "body" else ()
        glue = ("adhesive",) if put.key in GLUED else ()
        file = f"{PICTURES}/{_file(place, put)}" if drawn and put.way else ""
        found.append(step(key, *put.parts, *tried, *glue, picture=file, **where))
    lines = _wiring(built)
    found += [step("seal", "adhesive", "tape"), step("connect", "wire", "camera", before=lines)]
    return [*found, step("probes", *probes)] if probes else found


def _pocket(design: Design, board: Board) -> dict[str, str]:
    """Where a board goes, as the hour of a clock seen from the lid with the ribbon's slot at 6.

    Of a board about the axis, where LEDs of its first group stand.
    """
    blank = board.blank
    frame, first = blank.frames[0], blank.places[0]
    out = -frame.normal
    if blank.kind == "ring":
        row = [frame.point(place.x, place.y) for place in blank.places if place.groups == first.groups]
        own = np.mean(row, axis=0)
        # Rows on several sides have their middle on the axis; the first LED stands for them then.
        out = own if float(np.hypot(*own[:2])) > 1.0 else row[0]
    hour = (3.0 - math.degrees(math.atan2(out[1], out[0])) / 30.0) % 12.0
    hour = 12.0 if hour < 0.25 else round(2 * hour) / 2
    return {"clock": f"{hour:g}", "colour": design.leds.groups[first.groups[0]].name}


def _wiring(built: Built) -> list[str]:
    """Connectors of the boards, and the current of each group."""
    if built.boards is None:
        return []
    words, boards = _WORDS["steps"]["connect"], built.boards.boards
    lines = [words["pins"].format(board=board.name, pins=", ".join(board.pins)) for board in boards]
    for index, drive in enumerate(built.manifest["drive"]):
        row = drive["in_series"]
        count = sum(index in place.groups for board in boards for place in board.blank.places)
        chips = "each" if row == 1 else f"{row} in series"
        total = count // row * drive["current_ma"]
        lines.append(words["drive"].format(**drive, chips=chips, total=total))
    return lines


def _coating(design: Design) -> tuple[str, ...]:
    """What the coating reflects in the design, and how it is made."""
    words, optics = _WORDS["coating"], design.optics
    share = 100 * optics.coating_specular
    gloss = words["glossy"].format(share=share) if share else words["matt"]
    albedo = ", ".join(f"{value:.2g}" for value in design.per_group("membrane_albedo"))
    groups = ", ".join(group.name for group in design.leds.groups)
    return (words["reflectance"].format(albedo=albedo, groups=groups, gloss=gloss), *words["options"])


def _print_settings(design: Design) -> tuple[str, ...]:
    seats, words = design.housing.seats, _WORDS["print"]
    assert seats is not None
    return tuple([*words[seats.fit], *(line.format(gap=seats.gap_mm) for line in words["all"])])


def _gel(built: Built) -> tuple[str, ...]:
    row = next(row for row in built.manifest["bom"] if row["item"] == "elastomer")
    contact, words = built.design.contact, _WORDS["gel"]
    mix = CASTING_SURPLUS * row["mass_g"]
    lines = [words["mass"].format(volume=row["volume_ml"], mix=mix, surplus=CASTING_SURPLUS)]
    if isinstance(contact, LayerContact):
        gel = MATERIALS.get(contact.gel)
        modulus = contact.layer(thickness_mm=built.design.elastomer.thickness_mm).modulus_mpa
        if gel is not None and gel.mixing_ratio:
            lines.append(words["ratio"].format(gel=contact.gel, ratio=gel.mixing_ratio))
        else:
            mixed = [entry for entry in MATERIALS.values() if entry.mixing_ratio]
            near = min(mixed, key=lambda entry: abs(math.log(entry.modulus_mpa / modulus)))
            lines.append(
                words["near"].format(
                    modulus=modulus, gel=near.name, own=near.modulus_mpa, ratio=near.mixing_ratio
                )
            )
    else:
        lines.append(words["none"])
    return tuple([*lines, *words["cast"]])


def _camera(design: Design) -> tuple[str, ...]:
    camera, words = design.camera, _WORDS["camera"]
    timed, seats = camera.exposure_time_ms, design.housing.seats
    shutter = "10000" if timed is None else f"{1000 * timed:.0f}"
    pi = seats is not None and seats.camera.startswith("raspberry-pi")
    command = (words["raspberry"].format(shutter=shutter),) if pi else ()
    return (
        words["mode"].format(width=camera.width_px, height=camera.height_px, bits=camera.bit_depth),
        words["focus"].format(
            distance=apparent_distance_mm(design.layers_to_camera(0.0)), place=camera.position_mm[2]
        ),
        words["choose"] if timed is None else words["exposure"].format(time=timed, gain=camera.gain),
        *command,
    )


def _file(place: int, step: Step) -> str:
    return f"step-{place:02d}-{step.parts[0]}.png"


def _draw(built: Built, folder: Path) -> str:
    """Draw a picture of each step and one of all parts; return why not, if so."""
    shapes = dict(built.shapes)
    colours = {name: PART_COLOURS.get(name, BOARD_COLOUR) for name in shapes}
    colours |= {
        "housing": (0.62, 0.65, 0.70, 1.0),
        "gelcore": (0.55, 0.80, 0.95, 0.55),
        "lid": (0.72, 0.74, 0.80, 1.0),
    }
    for number, led in enumerate(built.leds):
        colour = package_colour([built.design.leds.groups[index] for index in led.groups])
        shapes[f"led-{number}"], colours[f"led-{number}"] = led.solid, (*colour, 1.0)
    there: list[str] = []
    wanted: list[Apart] = []
    for place, step in enumerate(built.order):
        moving = [
            *step.parts,
            *(f"led-{number}" for name in step.parts for number in built.carried.get(name, ())),
        ]
        if step.way:
            x, y, z = (AWAY * sum(stretch[axis] for stretch in step.way) for axis in range(3))
            away = (x, y, z)
            drawn = [Drawn(name, opened=name not in WHOLE) for name in there]
            drawn += [Drawn(name, away, arrow=name == step.parts[0]) for name in moving]
            wanted.append(Apart(_file(place, step), tuple(drawn), step.key in FROM_BELOW))
        there += moving
    wanted.append(Apart(OVERVIEW, tuple(_spread(built)), False))
    return pictures_apart(shapes, colours, wanted, folder)


def _spread(built: Built) -> Iterable[Drawn]:
    """All parts along the axis, those of the gel's side below the body, the others above it."""
    yield Drawn("housing", opened=True)
    body = built.shapes["housing"].BoundingBox()
    boards = [name for step in built.order if step.key == "board" for name in step.parts]
    below = [boards] if boards else []
    below += [list(step.parts) for step in built.order if step.key in FROM_BELOW and step.key != "board"]
    above = [list(step.parts) for step in built.order if step.way and step.key not in FROM_BELOW]
    reached = body.zmin
    for parts in below:
        ends = [built.shapes[name].BoundingBox() for name in parts]
        by = reached - SPREAD_MM - max(end.zmax for end in ends)
        reached = min(end.zmin for end in ends) + by
        yield from _moved(built, parts, by)
    reached = body.zmax
    for parts in above:
        ends = [built.shapes[name].BoundingBox() for name in parts]
        by = reached + SPREAD_MM - min(end.zmin for end in ends)
        reached = max(end.zmax for end in ends) + by
        yield from _moved(built, parts, by)


def _moved(built: Built, parts: Sequence[str], by_mm: float) -> Iterable[Drawn]:
    """Parts and the LEDs on them, moved along the axis."""
    for name in parts:
        yield Drawn(name, (0.0, 0.0, by_mm))
        for number in built.carried.get(name, ()):
            yield Drawn(f"led-{number}", (0.0, 0.0, by_mm))


def _markdown(title: str, found: Sequence[Chapter]) -> str:
    lines = [f"# {title}", ""]
    for chapter in found:
        lines += [f"## {chapter.title}", ""]
        lines += [f"- {text}" for text in chapter.text]
        if chapter.rows:
            keys = list(chapter.rows[0])
            lines += ["", f"| {' | '.join(keys)} |", f"|{' --- |' * len(keys)}"]
            lines += [f"| {' | '.join(str(row[key]) for key in keys)} |" for row in chapter.rows]
        for number, step in enumerate(chapter.steps, start=1):
            lines += [f"### {number}. {step.title}", "", f"Parts: {', '.join(step.parts) or 'none'}", ""]
            lines += [f"- {text}" for text in step.text]
            lines += ["", f"![{step.title}]({step.picture})", ""] if step.picture else [""]
        for file, caption in chapter.pictures:
            lines += ["", f"![{caption}]({file})", "", f"*{caption}*"]
        lines.append("")
    return "\n".join(lines)


def _webpage(title: str, found: Sequence[Chapter], pictures: Path) -> str:
    sections = []
    for chapter in found:
        blocks: list[Html] = [paragraph(text) for text in chapter.text]
        if chapter.rows:
            blocks.append(table(chapter.rows, list(chapter.rows[0])))
        for file, caption in chapter.pictures:
            blocks.append(picture(pictures / Path(file).name, caption))
        sections.append(Section(chapter.title, tuple(blocks)))
        for number, step in enumerate(chapter.steps, start=1):
            own = [paragraph(f"Parts: {', '.join(step.parts) or 'none'}"), listed(step.text)]
            if step.picture:
                own.append(picture(pictures / Path(step.picture).name, step.title))
            sections.append(Section(f"{number}. {step.title}", tuple(own)))
    return page(title, sections)
