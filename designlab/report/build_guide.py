"""The guide that a sensor is built by, made of its design: shopping list, recipes, steps with pictures."""

import math
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from designlab.core.images import png_bytes, tone_map
from designlab.fabrication import BOARD_COLOUR, PART_COLOURS, Built, package_colour
from designlab.fabrication.assembly import Step
from designlab.fabrication.boards import Board
from designlab.fabrication.seating import plates, wire_holes
from designlab.fabrication.tables import WIRE_M, batch_g, gel_to_buy, mixed_masses
from designlab.report.page import Html, Section, listed, page, paragraph, picture, table
from designlab.report.view3d.apart import Apart, Drawn, pictures_apart
from designlab.sensor.contact import LayerContact
from designlab.sensor.design import Design, preset_names
from designlab.sensor.refraction import apparent_distance_mm
from designlab.sensor.seating import mount
from designlab.simulation.simulator import Simulator

PICTURES = "guide"
MARKDOWN, WEBPAGE = "guide.md", "guide.html"
FIRST_PICTURE = "first-picture.png"
COLUMNS, SAMPLES, SEED = 320, 96, 0
"""Effort of the expected first picture."""
SMOOTHED_PX = 1.5
"""Of that picture: what differs within so few pixels is noise of the simulation."""
OVERVIEW = "all.png"
FIRST_STEPS = 7
"""Steps before parts go into the housing, that of the LEDs left out."""
GLUED = ("board", "core_ring", "core", "gel_ring")
"""Steps that need sealant."""
FROM_BELOW = ("board", "core_ring", "core", "gel_ring")
"""Steps whose parts go in from the gel's side."""
WHOLE = ("gelcore", "elastomer", "camera", "core_ring", "gel_ring")
"""Parts that are not cut open once they are in place; in the viewer's half, others would hang in the air."""
AWAY = 0.75  # of a part's way out at which it is drawn
SPREAD_MM = 5.0  # between parts in the picture of all of them
SUPPLY_V = 5.0  # where no board says more
LIMIT = 1.25
"""Current limit of the supply over the current of the LEDs."""
SIDED = 0.04
"""Of half the picture's width: a picture whose brightness has its middle nearer to the middle is even."""
_WORDS: dict[str, Any] = tomllib.loads(
    files(__package__).joinpath("build_guide.toml").read_text(encoding="utf-8")
)


class GuideStep(NamedTuple):
    """One step: what is done, numbers of the parts that it uses, and its pictures with their captions."""

    title: str
    text: tuple[str, ...]
    parts: tuple[str, ...]
    pictures: tuple[tuple[str, str], ...] = ()


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
    shown = {FIRST_PICTURE: frame.mixed}
    shown |= {
        _colour_file(group.name): frame.basis[index][..., None] * frame.weights[:, index]
        for index, group in enumerate(built.design.leds.groups)
    }
    for name, light in shown.items():
        smooth = gaussian_filter(light, (SMOOTHED_PX, SMOOTHED_PX, 0), mode="nearest")
        (pictures / name).write_bytes(png_bytes(tone_map(smooth)))
    found = chapters(built, drawn=not reason, light=frame.basis)
    title = f"How to build {built.design.name}"
    (folder / MARKDOWN).write_text(_markdown(title, found), encoding="utf-8")
    (folder / WEBPAGE).write_text(_webpage(title, found, pictures), encoding="utf-8")
    return [f"the guide has no pictures of its steps: {reason}"] if reason else []


def chapters(built: Built, *, drawn: bool = True, light: NDArray[np.float32] | None = None) -> list[Chapter]:
    """Content of the guide of an export; without `drawn`, steps show no pictures.

    `light` is the untouched gel as simulated, (groups, rows, columns), which tells where each colour is
    brightest.
    """
    design, words = built.design, _WORDS["chapters"]
    shopping = [
        {"part": row["part"], "item": row["item"], "count": row["count"], "what": row["material"]}
        | {"mass (g)": "" if row["mass_g"] is None else f"{row['mass_g']:.1f}", "note": row["note"]}
        for row in built.manifest["bom"]
    ]
    overview = ((f"{PICTURES}/{OVERVIEW}", words["overview"]),) if drawn else ()
    about = tuple(text for text in (design.description, design.lineage) if text)
    supply = _supply_v(built)
    return [
        Chapter("What it is", (*about, *words["what"]), pictures=overview),
        Chapter("Words", tuple(words["words"])),
        Chapter("What to buy and make", tuple(words["buy"]), rows=tuple(shopping)),
        Chapter("Tools", tuple(line.format(supply=supply) for line in words["tools"])),
        Chapter("Print settings", _print_settings(design)),
        Chapter("Gel", _gel(built)),
        Chapter("Coating", _coating(design)),
        Chapter("Light of the LEDs", _leds(built)),
        Chapter("Steps", steps=tuple(steps(built, drawn=drawn))),
        Chapter("Camera settings", _camera(design)),
        Chapter("First measurement", _measure(design), pictures=_first_pictures(built, light)),
    ]


def _first_pictures(built: Built, light: NDArray[np.float32] | None) -> tuple[tuple[str, str], ...]:
    """The expected first pictures: all LEDs, then each colour alone, and where it is brightest."""
    design, words = built.design, _WORDS["chapters"]
    width, height = design.sensing_area_mm
    found = [(f"{PICTURES}/{FIRST_PICTURE}", words["first_picture"].format(width=width, height=height))]
    for index, group in enumerate(design.leds.groups if light is not None else ()):
        assert light is not None
        caption = words["colour_picture"].format(
            group=group.name, board=_listed_hours(group.azimuth_deg), where=_brightest(light[index])
        )
        found.append((f"{PICTURES}/{_colour_file(group.name)}", caption))
    return tuple(found)


def _brightest(light: NDArray[np.float32]) -> str:
    """Towards which hour the middle of a picture's brightness lies."""
    words, (rows, columns) = _WORDS["chapters"], light.shape
    y, x = np.mgrid[0:rows, 0:columns]
    share = light / light.sum()
    across = float((share * (x - (columns - 1) / 2)).sum())
    up = -float((share * (y - (rows - 1) / 2)).sum())
    if math.hypot(across, up) < SIDED * columns / 2:
        return str(words["even"])
    return str(words["brightest"].format(clock=_hour(math.degrees(math.atan2(up, across)))))


def _hour(azimuth_deg: float) -> str:
    """Hour of a clock seen from the lid, to half an hour, of a direction from the axis."""
    hour = (3.0 - azimuth_deg / 30.0) % 12.0
    hour = 12.0 if hour < 0.25 else round(2 * hour) / 2
    return f"{hour:g}"


def _listed_hours(azimuths_deg: Sequence[float]) -> str:
    return ", ".join(_hour(azimuth) for azimuth in azimuths_deg)


def _colour_file(group: str) -> str:
    return f"first-picture-{re.sub(r'[^A-Za-z0-9_-]+', '_', group)}.png"


def _supply_v(built: Built) -> float:
    drives = built.manifest["drive"]
    return float(drives[0]["supply_v"]) if drives else SUPPLY_V


def _leds(built: Built) -> tuple[str, ...]:
    """What light the boards give against what the design reckons with."""
    words, drives = _WORDS["leds"], built.manifest["drive"]
    if not drives:
        return (words["after"],)
    leds, lines = built.design.leds, []
    if leds.part is None and all(group.part is None for group in leds.groups):
        drawn = f"{leds.body_width_mm:g} x {leds.body_height_mm:g} x {leds.body_thickness_mm:g}"
        lines.append(words["part"].format(drawn=drawn))
    for group, drive in zip(leds.groups, drives, strict=True):
        wanted, flux = group.flux_mw / (group.count * len(group.azimuth_deg)), drive["board_flux_mw"]
        if leds.relative_flux:
            light = words["relative"]
        elif flux is None or drive["current_from"] != "flux":
            light = words["unknown"].format(wanted=wanted)
        else:
            light = words["known"].format(flux=flux, wanted=drive["design_flux_mw"])
        power = drive["current_ma"] * drive["forward_v"]
        lines.append(words["each"].format(**drive, power=power, light=light))
    return (*lines, words["after"])


def _measure(design: Design) -> tuple[str, ...]:
    """The first measurement, with the commands that it takes."""
    words = _WORDS["measure"]
    named = f" --preset {design.name}" if design.name in preset_names() else ""
    commands = {key: words[key] for key in ("convert", "compare", "balls", "model")}
    return tuple(line.format(init=f"designlab init sensor{named}", **commands) for line in words["text"])


def steps(built: Built, *, drawn: bool = True) -> list[GuideStep]:
    """Steps of the guide, in order; every part of the bill of materials is used in one of them."""
    number = {row["item"]: row["part"] for row in built.manifest["bom"]}
    design, drives = built.design, built.manifest["drive"]
    seats = design.housing.seats
    assert seats is not None
    painted = "painted matt black" if design.gelcore.side_finish == "painted" else design.gelcore.side_finish
    total = sum(_group_current_ma(built, index) for index in range(len(drives)))
    of_resin = design.optics.gelcore_material.startswith("resin")
    told: dict[str, Any] = {
        "finish": painted,
        "gap": seats.gap_mm,
        "supply": _supply_v(built),
        "wire": WIRE_M,
        "total": total,
        "limit": math.ceil(LIMIT * total),
        "outside": _outside_window(design),
        "resin": ", or print it in clear resin, then sand and polish it" if of_resin else "",
    }

    def step(
        key: str,
        *items: str,
        pictures: Sequence[tuple[str, str]] = (),
        before: Sequence[str] = (),
        **more: Any,
    ) -> GuideStep:
        words = _WORDS["steps"][key]
        text = [*before, *(line.format(**told, **more) for line in words["text"])]
        used = tuple(number[item] for item in items if item in number)
        return GuideStep(words["title"].format(**told, **more), tuple(text), used, tuple(pictures))

    leds = [item for item in number if item.startswith("led_")]
    probes = [item for item in number if item.startswith("probe")]
    coats = ("silicone", "pigment", "solvent", "isopropanol", "masking", "grey_card")
    found = [
        step("print", "housing", "lid", "core_ring", "gel_ring", "paint", "masking"),
        step("mould", "mould_cavity", "mould_lid", "lacquer", "isopropanol"),
        step("gelcore", "gelcore", *(("paint",) if design.gelcore.side_finish == "painted" else ())),
        step("gel", "elastomer", "silicone", "mould_cavity", "mould_lid"),
        step("bond", "gelcore", "elastomer", "silicone", "primer", "isopropanol"),
        step("membrane", "membrane", *coats),
    ]
    if built.boards is not None:
        names = [board.name for board in built.boards.boards]
        sheets = [(f"boards/{name}.png", f"{name}: front and back") for name in names]
        found.append(step("boards", *names, *leds, "wire", pictures=sheets))
    elif leds:
        found.append(step("leds", *leds, "wire"))
    found.append(step("camera_test", "camera", "computer", "ribbon"))
    boards = {} if built.boards is None else {board.name: board for board in built.boards.boards}
    for place, put in enumerate(built.order):
        key = put.key
        where: dict[str, Any] = {"part": put.parts[0]}
        if put.key == "board":
            where |= _pocket(design, boards[put.parts[0]])
            ring = boards[put.parts[0]].blank.kind == "ring"
            key = "board_ring" if ring else "board_leaning" if len(put.way) > 1 else "board"
        tried = ("gelcore", *boards) if put.key == "body" else ()
        glue = ("adhesive",) if put.key in GLUED else ()
        made = step(key, *put.parts, *tried, *glue, **where)
        if drawn and put.way:
            caption = _WORDS["chapters"]["step_picture"].format(title=made.title)
            made = made._replace(pictures=((f"{PICTURES}/{_file(built, place, put)}", caption),))
        found.append(made)
    lines = _wiring(built)
    found += [step("seal", "adhesive", "tape"), step("connect", "wire", "switches", before=lines)]
    found.append(step("measure", "ball", "grey_card"))
    return [*found, step("probes", *probes)] if probes else found


def _group_current_ma(built: Built, index: int) -> float:
    """Current of an LED group over all boards (mA)."""
    drive = built.manifest["drive"][index]
    boards = () if built.boards is None else built.boards.boards
    count = sum(index in place.groups for board in boards for place in board.blank.places)
    return float(count // drive["in_series"] * drive["current_ma"])


def _outside_window(design: Design) -> str:
    core = design.gelcore
    text = f"Of the window, {core.window_diameter_mm:g} mm in the middle must be clear"
    around = "; black paint around that does no harm." if core.side_finish == "painted" else "."
    return text + around


def _pocket(design: Design, board: Board) -> dict[str, str]:
    """Where a board and its wires go, as hours of a clock seen from the lid with the ribbon's slot at 6.

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
    hole = wire_holes(design, plates([board]))[board.name]
    return {
        "clock": _hour(math.degrees(math.atan2(out[1], out[0]))),
        "wires": _hour(math.degrees(math.atan2(hole.way[1], hole.way[0]))),
        "colour": design.leds.groups[first.groups[0]].name,
    }


def _wiring(built: Built) -> list[str]:
    """Connectors of the boards, and the current of each group."""
    if built.boards is None:
        return []
    words, boards = _WORDS["steps"]["connect"], built.boards.boards
    lines = [words["pins"].format(board=board.name, pins=", ".join(board.pins)) for board in boards]
    for index, drive in enumerate(built.manifest["drive"]):
        row = drive["in_series"]
        chips = "each" if row == 1 else f"{row} in series"
        lines.append(words["drive"].format(**drive, chips=chips, total=_group_current_ma(built, index)))
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
    design, words = built.design, _WORDS["gel"]
    row = next(row for row in built.manifest["bom"] if row["item"] == "elastomer")
    silicone, named = gel_to_buy(design)
    batch = batch_g(row["mass_g"])
    name = "a clear silicone" if silicone is None else silicone.name
    told = {"volume": row["volume_ml"], "mass": row["mass_g"], "batch": batch, "silicone": name}
    lines = [words["mass"].format(**told)]
    if silicone is None:
        lines.append(words["none"])
    else:
        parts = mixed_masses(silicone.mixing_ratio, batch)
        parts = f"; for {batch:g} g, in this order, {parts}" if parts else ""
        about = {"gel": silicone.name, "ratio": silicone.mixing_ratio, "masses": parts}
        if named:
            lines.append(words["ratio"].format(**about))
            lines += [] if silicone.in_sensors else [words["hazy"].format(**about)]
        else:
            assert isinstance(design.contact, LayerContact)
            modulus = design.contact.layer(thickness_mm=design.elastomer.thickness_mm).modulus_mpa
            lines.append(words["near"].format(**about, modulus=modulus, own=silicone.modulus_mpa))
    lines.append(words["clear"].format(thickness=design.elastomer.thickness_mm))
    return tuple([*lines, *words["cast"]])


def _camera(design: Design) -> tuple[str, ...]:
    camera, words, board = design.camera, _WORDS["camera"], mount(design).board
    timed = camera.exposure_time_ms
    shutter = "10000" if timed is None else f"{1000 * timed:.0f}"
    told = {"width": camera.width_px, "height": camera.height_px, "raw": board.raw_bits, "shutter": shutter}
    pi = (words["raspberry"].format(**told),) if board.name.startswith("raspberry-pi") else ()
    # Distances are reckoned from the entrance pupil, which lies inside the lens.
    inside_mm = board.lens_height_mm - board.pupil_mm
    return (
        words["mode"].format(**told),
        *(
            ()
            if camera.bit_depth == board.raw_bits
            else (words["bits"].format(bits=camera.bit_depth, **told),)
        ),
        words["focus"].format(
            distance=apparent_distance_mm(design.layers_to_camera(0.0)) - inside_mm,
            place=camera.position_mm[2] - inside_mm,
        ),
        words["choose"] if timed is None else words["exposure"].format(time=timed, gain=camera.gain),
        *pi,
    )


def _file(built: Built, place: int, step: Step) -> str:
    """Name of a step's picture, by the step's number in the guide."""
    leds = built.boards is not None or any(row["item"].startswith("led_") for row in built.manifest["bom"])
    return f"step-{FIRST_STEPS + leds + place + 1:02d}-{step.parts[0]}.png"


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
            wanted.append(Apart(_file(built, place, step), tuple(drawn), step.key in FROM_BELOW))
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
            for file, caption in step.pictures:
                lines += ["", f"![{caption}]({file})", "", f"*{caption}*"]
            lines.append("")
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
            blocks.append(picture(pictures.parent / file, caption))
        sections.append(Section(chapter.title, tuple(blocks)))
        for number, step in enumerate(chapter.steps, start=1):
            own = [paragraph(f"Parts: {', '.join(step.parts) or 'none'}"), listed(step.text)]
            own += [picture(pictures.parent / file, caption) for file, caption in step.pictures]
            sections.append(Section(f"{number}. {step.title}", tuple(own)))
    return page(title, sections)
