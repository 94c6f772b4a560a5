"""LED boards: what is written is read again by pygerber, which shares nothing with the writer."""

import csv
import io
import math
import re
import tempfile
import zipfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from pygerber.gerberx3.parser2.parser2 import Parser2
from pygerber.gerberx3.tokenizer.tokenizer import Tokenizer
from shapely import affinity
from shapely.geometry import LineString, Point, Polygon, box

from designlab.app.cli import main
from designlab.fabrication import _boards, export
from designlab.fabrication import boards as led_boards
from designlab.fabrication.boards import BoardError, Boards, boards, circuit, gerber, orders, routing
from designlab.fabrication.boards.stock import (
    CLEARANCE_MM,
    EDGE_MM,
    LAND_PATTERNS,
    TRACK_MM,
    VIA_DRILL_MM,
)
from designlab.fabrication.parts import built_leds
from designlab.sensor.design import Design, load, preset
from designlab.sensor.led_catalogue import PARTS, flux_mw
from geometries.leds import bodies

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of pygerber
READ_MM = 2e-4  # what the files' decimals take
SLOW = (
    "digit-like",
    "difftactile-dome-like",
    "digit360-like",
    "gelsight-2020-dome-core",
    "gelslim-3-like",
    "pbr-fingertip-like",
    "rainbowsight-like",
)
PRESETS = [
    "default",
    "gelsight-mini-like",
    *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW),
]
READ = [
    pytest.param(name, marks=pytest.mark.slow) for name in ("default", "gelsight-mini-like", *SLOW)
]  # pygerber takes its time
ROOMY = {
    "housing.inner_radius_mm": 30.0,
    "housing.top_mm": 40.0,
    "leds.pitch_mm": 7.0,
    "leds.body_width_mm": 4.0,
    "leds.body_height_mm": 3.6,
}


@cache
def drawn(name: str) -> Boards:
    """Boards of a preset, drawn once."""
    return boards(preset(name))


@cache
def read(name: str) -> "list[Read]":
    """Files of the boards of a preset, read once."""
    with tempfile.TemporaryDirectory() as folder:
        return [Read(board, Path(folder)) for board in drawn(name).boards]


def part_design(part: str, **changes: Any) -> Design:
    """The default sensor with room, its LEDs of one part."""
    design = preset("default").replace(ROOMY)
    content = design.model_dump(mode="json", exclude_none=True)
    content["leds"]["part"] = part
    for group in content["leds"]["groups"]:
        group["flux_mw"] = changes.get("flux_mw", 1.0)
        group.pop("wavelength_nm", None) if PARTS[part].chips.get(group["name"]) else None
        group.setdefault("wavelength_nm", 600.0)
    return Design.model_validate(content)


# ---------------------------------------------------------------- reading what was written


def shapes_of(text: str) -> list[Any]:
    """Shapes of one Gerber layer, as pygerber reads it."""
    return [_shape(command) for command in Parser2().parse(Tokenizer().tokenize(text))]


def _shape(command: Any) -> Any:
    kind, tool = type(command).__name__, command.aperture
    if kind == "Line2":
        ends = [(float(p.x.value), float(p.y.value)) for p in (command.start_point, command.end_point)]
        cap = "flat" if type(tool).__name__ == "NoCircle2" else "round"
        return LineString(ends).buffer(float(tool.diameter.value) / 2, cap_style=cap)
    assert kind == "Flash2", kind
    x, y = (float(c.value) for c in (command.flash_point.x, command.flash_point.y))
    shape = type(tool).__name__
    if shape == "Circle2":
        flat: Any = Point(0, 0).buffer(float(tool.diameter.value) / 2)
    elif shape == "Rectangle2":
        w, h = float(tool.x_size.value) / 2, float(tool.y_size.value) / 2
        flat = box(-w, -h, w, h)
    else:
        assert shape == "Macro2", shape
        dark = [c for c in tool.command_buffer if "Dark" in str(c.transform.polarity)]
        flat = shapely.union_all([_shape(c) for c in dark])
    return affinity.translate(flat, x, y)


def widths_of(text: str) -> list[float]:
    """Widths of all lines of one Gerber layer (mm)."""
    found = Parser2().parse(Tokenizer().tokenize(text))
    return [float(c.aperture.diameter.value) for c in found if type(c).__name__ == "Line2"]


def drills_of(text: str) -> list[tuple[float, float, float]]:
    """Holes of an Excellon file: x, y, diameter (mm)."""
    assert "METRIC" in text.split("%")[0]
    tools = {t: float(d) for t, d in re.findall(r"^T(\d+)C([\d.]+)$", text, re.MULTILINE)}
    found, tool = [], 0.0
    for line in text.split("%", 1)[1].splitlines():
        if match := re.fullmatch(r"T(\d+)", line):
            tool = tools[match[1]]
        elif match := re.fullmatch(r"X(-?[\d.]+)Y(-?[\d.]+)", line):
            found.append((float(match[1]), float(match[2]), tool))
    return found


class Read:
    """A board's ZIP as read again."""

    def __init__(self, board: Any, folder: Path) -> None:
        path = folder / f"{board.name}.zip"
        gerber.write_gerbers(board, path, project="a test, with *signs%")
        with zipfile.ZipFile(path) as package:
            self.text = {
                n.removeprefix(f"{board.name}-"): package.read(n).decode() for n in package.namelist()
            }
        self.copper = [shapes_of(self.text[name]) for name in ("F_Cu.gtl", "B_Cu.gbl")]
        self.plated, self.bare = (drills_of(self.text[name]) for name in ("PTH.drl", "NPTH.drl"))

    @property
    def outline(self) -> Polygon:
        """Area inside the outline's lines, at their middle."""
        lines = []
        for command in Parser2().parse(Tokenizer().tokenize(self.text["Edge_Cuts.gm1"])):
            ends = (command.start_point, command.end_point)
            lines.append(LineString([(float(p.x.value), float(p.y.value)) for p in ends]))
        rings = sorted(shapely.polygonize([shapely.union_all(lines)]).geoms, key=lambda p: -p.area)
        whole = max((Polygon(ring.exterior) for ring in rings), key=lambda p: p.area)
        inner = [r for r in rings if not r.interiors and r.area < whole.area - 1e-9]
        return whole.difference(shapely.union_all(inner)) if len(rings) > 1 else whole

    def pieces(self) -> list[dict[int, Any]]:
        """Connected copper: for each piece its shape on each layer; plated holes join the layers."""
        pieces: list[dict[int, Any]] = []
        for layer, shapes in enumerate(self.copper):
            union = shapely.union_all(shapes)
            pieces += [{layer: part} for part in getattr(union, "geoms", [union])]
        for x, y, _ in self.plated:
            hit = [p for p in pieces if any(s.contains(Point(x, y)) for s in p.values())]
            joined: dict[int, Any] = {}
            for piece in hit:
                for layer, shape in piece.items():
                    joined[layer] = shapely.union(joined.get(layer, Polygon()), shape)
            assert set(joined) == {0, 1}, f"a plated hole at {x}, {y} does not meet both layers"
            pieces = [p for p in pieces if not any(p is h for h in hit)] + [joined]
        return pieces


@pytest.mark.parametrize("name", READ)
def test_nets_are_connected_and_apart_as_read(name: str) -> None:
    for board, files in zip(drawn(name).boards, read(name), strict=True):
        pieces = files.pieces()
        net_of: dict[int, set[str]] = {}
        piece_of: dict[str, set[int]] = {}
        for row in orders.net_rows(board):
            layer = 1 if row["Layer"] == "bottom" else 0
            at = Point(row["X"], row["Y"])
            hit = [k for k, piece in enumerate(pieces) if layer in piece and piece[layer].contains(at)]
            assert len(hit) == 1, row
            net_of.setdefault(hit[0], set()).add(row["Net"])
            piece_of.setdefault(row["Net"], set()).add(hit[0])
        assert all(len(found) == 1 for found in piece_of.values()), piece_of
        assert all(len(found) == 1 for found in net_of.values()), net_of
        assert len(net_of) == len(pieces)  # no copper without a net
        for k, first in enumerate(pieces):
            for second in pieces[k + 1 :]:
                for layer in first.keys() & second.keys():
                    assert first[layer].distance(second[layer]) >= CLEARANCE_MM - READ_MM


@pytest.mark.parametrize("name", READ)
def test_outline_holes_and_masks_as_read(name: str) -> None:
    for board, files in zip(drawn(name).boards, read(name), strict=True):
        outline = files.outline
        assert outline.area == pytest.approx(board.outline.area, rel=1e-4)
        assert outline.symmetric_difference(board.outline).area < 2e-3 * board.outline.area
        assert outline.bounds == pytest.approx(board.outline.bounds, abs=1e-3)
        body = orders.solid(board)
        assert body.isValid()
        holes = sum(math.pi * d**2 / 4 for _, _, d in files.bare)
        assert body.Volume() == pytest.approx((outline.area - holes) * board.thickness_mm, rel=2e-3)
        drills = [(v.x, v.y, VIA_DRILL_MM) for v in board.vias]
        drills += list({(p.x, p.y, p.drill_mm) for p in board.pads if p.drill_mm})
        for read_again, as_drawn in ((files.bare, board.holes), (files.plated, drills)):
            assert len(read_again) == len(as_drawn)
            for hole in as_drawn:
                assert min(math.dist(hole, each) for each in read_again) < 1e-3
        # Limits that the specification states are kept.
        text = orders.specification(board, drawn(name).channels)
        assert f"least track    {TRACK_MM:g} mm, least clearance {CLEARANCE_MM:g} mm" in text
        assert f"vias {VIA_DRILL_MM:g} mm" in text
        assert min((d for *_, d in files.plated), default=1.0) >= VIA_DRILL_MM
        for part in ("F_Cu.gtl", "B_Cu.gbl"):
            assert min(widths_of(files.text[part]), default=1.0) >= TRACK_MM
        for x, y, diameter in [*files.bare, *files.plated]:
            assert outline.buffer(-EDGE_MM + 1e-3).contains(Point(x, y).buffer(diameter / 2))
        for layer, mask in enumerate(("F_Mask.gts", "B_Mask.gbs")):
            copper = shapely.union_all(files.copper[layer])
            assert outline.buffer(-EDGE_MM + READ_MM).contains(copper)
            assert all(copper.distance(Point(x, y)) >= d / 2 + EDGE_MM - 1e-2 for x, y, d in files.bare)
            openings = shapes_of(files.text[mask])
            assert len(openings) == sum(layer in pad.layers for pad in board.pads)
            pads = [pad.shape for pad in board.pads if layer in pad.layers]
            assert all(copper.buffer(READ_MM).contains(pad) for pad in pads)
            assert all(any(o.contains(pad) for o in openings) for pad in pads)
        for text in files.text.values():
            assert text.startswith(("G04", ";"))
        assert "%TF.FileFunction,Copper,L1,Top*%" in files.text["F_Cu.gtl"]
        # The polarity marks lie on no pad and no LED.
        marks = shapes_of(files.text["F_Silkscreen.gto"])
        leds = [c for c in board.components if c.kind == "led"]
        assert len(marks) == len(leds)
        bare = shapely.union_all(shapes_of(files.text["F_Mask.gts"]))
        assert not any(mark.intersects(led.body) for mark in marks for led in leds)
        assert not any(mark.intersects(bare) for mark in marks)


@pytest.mark.parametrize("name", PRESETS)
def test_leds_stand_where_the_design_has_them(name: str) -> None:
    design = preset(name)
    found = []
    for board in drawn(name).boards:
        frame = board.blank.frames[0]
        assert np.allclose(np.cross(frame.x, frame.y), frame.normal)
        rows = {row["Designator"]: row for row in orders.placement_rows(board)}
        for component in board.components:
            if component.kind == "led":
                row = rows[component.designator]
                assert row["Layer"] == "top"
                place = frame.point(row["Mid X"], row["Mid Y"], board.blank.led_mm)
                found.append((place, frame.normal, {design.leds.groups[g].name for g in component.groups}))
    strips = []
    for body in bodies(design.leds):
        front = np.asarray(body.centre_mm) + body.half_mm[2] * np.asarray(body.normal)
        groups = {design.leds.groups[g].name for g in body.groups}
        spans = design.leds.emitting_spans_mm if design.leds.package == "panel" else [(0.0, 0.0)]
        strips += [
            (front + (a + b) / 2 * np.asarray(body.down), np.asarray(body.normal), groups) for a, b in spans
        ]
    for place, normal, groups in strips:
        # Of a panel's strip, the mean of its LEDs.
        own = [
            f for f in found if f[2] == groups and abs((f[0] - place) @ f[1]) < 0.05 and f[1] @ normal > 0.999
        ]
        near = sorted(own, key=lambda f: float(np.linalg.norm(f[0] - place)))
        count = len(found) // len(strips)
        middle = np.mean([f[0] for f in near[:count]], axis=0)
        assert np.linalg.norm(middle - place) < 0.05
        assert math.degrees(math.acos(min(1.0, float(near[0][1] @ normal)))) < 0.5


@pytest.mark.parametrize("name", PRESETS)
def test_bill_and_placement_name_the_same_parts(name: str) -> None:
    found = drawn(name)
    for board in found.boards:
        rows = orders.bill_rows(board)
        fitted = [row for row in rows if not row["DNP"]]
        billed = [d for row in fitted for d in row["Designator"].split(",")]
        listed = [row["Designator"] for row in orders.placement_rows(board)]
        assert sorted(billed) == sorted(listed)
        assert len(set(listed)) == len(listed)
        assert sum(row["Quantity"] for row in fitted) == len(listed)
        # Only the connector stays off, and the specification counts what is fitted.
        assert {row["Designator"] for row in rows if row["DNP"]} <= {"J1"}
        text = orders.specification(board, found.channels)
        assert re.findall(r"^parts +(\d+)", text, re.MULTILINE) == [str(len(listed))]
        assert "electrical truth" not in text
        parts = [found.channels[g].part for place in board.blank.places for g in place.groups]
        unsure = any({"land", "anode", "cathode"} & {*part.assumed} for part in parts)
        assert ("compare pads and pins" in text) == unsure
        assert "black" in text
        assert f"{board.thickness_mm:g} mm" in text
        assert all(net in text for net in board.pins)


# ---------------------------------------------------------------- electrical truth


@pytest.mark.parametrize("part", ["broadcom-asmb-ktf0", "vishay-vlm1300", "kingbright-apt1608ec"])
@pytest.mark.parametrize("share", [0.3, 0.8, 1.0])
@pytest.mark.parametrize("supply_v", [4.5, 5.0, 9.0])
def test_current_follows_from_the_flux(part: str, share: float, supply_v: float) -> None:
    design = part_design(part)
    content = design.model_dump(mode="json", exclude_none=True)
    known = {}
    for group in content["leds"]["groups"]:
        chips = PARTS[part].chips
        chip = chips.get(group["name"], next(iter(chips.values())))
        at_sheet = flux_mw(PARTS[part], chip)
        if at_sheet is not None:
            group["flux_mw"] = share * at_sheet * group["count"]
            known[group["name"]] = (chip, at_sheet)
    assert known
    for channel in circuit.channels(Design.model_validate(content), supply_v=supply_v):
        if channel.group.name not in known:
            assert not channel.from_flux
            assert "no flux" in channel.note
            continue
        chip, at_sheet = known[channel.group.name]
        assert channel.from_flux
        # A step of E24 is 10 %, so the nearest value is within 5 %.
        assert channel.current_ma == pytest.approx(share * chip.current_ma, rel=0.055)
        assert channel.current_ma <= chip.current_max_ma
        across = supply_v - chip.forward_v
        assert channel.current_ma == pytest.approx(1e3 * across / channel.resistor.ohm)
        assert channel.flux_mw == pytest.approx(at_sheet * channel.current_ma / chip.current_ma)
        assert channel.resistor.load_mw == pytest.approx(channel.current_ma * across)
        assert channel.resistor.load_mw < channel.resistor.rating_mw
        mantissa = channel.resistor.ohm / 10 ** math.floor(math.log10(channel.resistor.ohm) + 1e-9)
        assert any(mantissa * 10 == pytest.approx(step) for step in circuit.E24)


@pytest.mark.parametrize(
    ("supply_v", "lengths"),
    [(5.0, [1, 1, 1]), (9.0, [3, 1, 1]), (12.0, [3, 3, 3]), (24.0, [3, 3, 3])],
)
def test_chips_are_in_series_as_far_as_the_supply_permits(supply_v: float, lengths: list[int]) -> None:
    """Three LEDs a board; their resistor keeps 30 % of the voltage of its string or more."""
    found = boards(preset("default"), supply_v=supply_v)
    assert [channel.in_series for channel in found.channels] == lengths
    for board, channel in zip(found.boards, found.channels, strict=True):
        resistors = [c for c in board.components if c.kind == "resistor"]
        assert len(resistors) == 3 // channel.in_series
        string_v = channel.in_series * channel.chip.forward_v
        assert channel.in_series == 1 or supply_v - string_v >= 0.3 * string_v - 1e-9
        across = supply_v - string_v
        assert channel.current_ma == pytest.approx(1e3 * across / channel.resistor.ohm)
        assert channel.current_ma == pytest.approx(channel.chip.current_ma, rel=0.055)
        assert channel.told()["in_series"] == channel.in_series
        leds = [c for c in board.components if c.kind == "led"]
        nets = [{pad.name: pad.net for pad in led.pads} for led in leds]
        for number, (own, before) in enumerate(zip(nets, [{}, *nets], strict=False)):
            first = number % channel.in_series == 0
            assert own[channel.anode] == ("V+" if first else before[channel.cathode])
        text = orders.specification(board, found.channels)
        assert ("in series" in text) == (channel.in_series > 1)


@pytest.mark.slow
def test_strings_are_connected_as_read(tmp_path: Path) -> None:
    for board in boards(preset("default"), supply_v=12.0).boards:
        files = Read(board, tmp_path)
        assert len(files.pieces()) == len({pad.net for pad in board.pads})


@pytest.mark.faults
@pytest.mark.parametrize("share", [0.0, 0.1, 0.2])
def test_a_board_in_the_cameras_view_is_refused(share: float) -> None:
    design, board = preset("default"), drawn("default").boards[0]
    led_boards._require_out_of_view(design, board)
    frame = board.blank.frames[0]
    at = frame.origin * (share, share, 1.0) + (0.0, 0.0, 6.0)
    moved = board._replace(blank=board.blank._replace(frames=(frame._replace(origin=at),)))
    with pytest.raises(BoardError, match=r"board_red: reaches .* mm into the camera's view"):
        led_boards._require_out_of_view(design, moved)


@pytest.mark.parametrize("name", PRESETS)
def test_leds_as_built_stand_on_their_boards_with_their_front_where_light_starts(name: str) -> None:
    design, made = preset(name), drawn(name).boards
    found = built_leds(design, made)
    assert len({led.name for led in found}) == len(found)
    fronts: dict[str, list[np.ndarray]] = {}
    for led in found:
        number = led.name.split("_")[1]
        middle = np.array(led.solid.Center().toTuple())
        normal = np.array(bodies(design.leds)[int(number) - 1].normal)
        board = next(b for b in made if b.name == led.board)
        fronts.setdefault(number, []).append(middle + board.blank.led_mm / 2 * normal)
    for number, places in fronts.items():
        body = bodies(design.leds)[int(number) - 1]
        drop = np.mean(design.leds.emitting_spans_mm) if design.leds.package == "panel" else 0.0
        front = np.asarray(body.centre_mm) + body.half_mm[2] * np.asarray(body.normal)
        assert np.linalg.norm(np.mean(places, axis=0) - front - drop * np.asarray(body.down)) < 0.05


def test_relative_flux_has_no_current_of_its_own() -> None:
    design = preset("pbr-fingertip-like")
    for channel in circuit.channels(design):
        assert not channel.from_flux
        assert "relative" in channel.note
        assert channel.told()["board_flux_mw"] is None
        assert channel.current_ma == pytest.approx(channel.chip.current_ma, rel=0.055)


@pytest.mark.slow
@pytest.mark.parametrize(
    "part",
    [
        "broadcom-asmb-ktf0",
        "broadcom-asmt-qtb4",
        "kingbright-aptf1616",
        "osram-lrtb-g6tg",
        "vishay-vlm1300",
        "vishay-vlmrgb6112",
    ],
)
def test_parts_of_the_catalogue_have_boards(part: str, tmp_path: Path) -> None:
    found = boards(part_design(part, flux_mw=0.3))
    assert len(found.boards) == 3
    assert any(name.startswith(part) for name in found.assumed) == bool(PARTS[part].assumed)
    for board, channel in zip(found.boards, found.channels, strict=True):
        files = Read(board, tmp_path)
        led = board.components[0]
        nets = {pad.name: pad.net for pad in led.pads}
        assert nets[channel.anode] == "V+"
        resistor = next(c for c in board.components if c.kind == "resistor")
        assert nets[channel.cathode] == resistor.pads[0].net
        assert len(files.pieces()) == len({pad.net for pad in board.pads})


@pytest.mark.slow
@pytest.mark.parametrize(("places", "colours"), [((0.0, 120.0), 2), ((0.0, 90.0, 180.0), 3)])
def test_a_package_of_several_colours_has_a_resistor_for_each(
    places: tuple[float, ...], colours: int
) -> None:
    content = preset("default").replace(ROOMY).model_dump(mode="json", exclude_none=True)
    content["leds"]["part"] = "broadcom-asmb-ktf0"
    content["leds"]["layout"], content["leds"]["tilt_deg"] = "ring", 90.0
    for group in content["leds"]["groups"]:
        group |= {"azimuth_deg": [places[0]], "count": 1, "flux_mw": 0.5}
    for k, group in enumerate(content["leds"]["groups"]):
        group["azimuth_deg"] = list(places) if k < colours else [300.0]
    (board,) = boards(Design.model_validate(content)).boards
    first = next(c for c in board.components if c.kind == "led")
    assert len(first.groups) == colours
    assert sum(c.kind == "resistor" for c in board.components) == colours * len(places) + (3 - colours)


@pytest.mark.slow
def test_strips_hold_packages_of_three_colours(tmp_path: Path) -> None:
    rows = {f"leds.groups.{k}.azimuth_deg": (90.0, 210.0, 330.0) for k in range(3)}
    found = boards(preset("default").replace(rows)).boards
    assert len(found) == 3
    for board in found:
        assert sum(c.kind == "resistor" for c in board.components) == 9
        assert len(Read(board, tmp_path).pieces()) == len({pad.net for pad in board.pads})


@pytest.mark.slow
@pytest.mark.parametrize("azimuths", [(0.0, 40.0, 80.0), (10.0, 100.0, 190.0), (0.0, 150.0, 210.0)])
def test_a_ring_of_level_leds_has_a_flexible_board(azimuths: tuple[float, ...], tmp_path: Path) -> None:
    content = preset("default").replace(ROOMY).model_dump(mode="json", exclude_none=True)
    content["leds"] |= {"layout": "ring", "pitch_mm": 5.0}
    for group, azimuth in zip(content["leds"]["groups"], azimuths, strict=True):
        group |= {"azimuth_deg": [azimuth], "count": 2}
    design = Design.model_validate(content)
    (board,) = boards(design).boards
    assert board.blank.kind == "flex"
    assert len(Read(board, tmp_path).pieces()) == len({pad.net for pad in board.pads})
    fronts = [
        (np.asarray(b.centre_mm) + b.half_mm[2] * np.asarray(b.normal), np.asarray(b.normal))
        for b in bodies(design.leds)
    ]
    for led in (c for c in board.components if c.kind == "led"):
        frame, x = board.blank.frame_at(led.x)
        place = frame.point(x, led.y, board.blank.led_mm)
        assert min(np.linalg.norm(place - front) for front, _ in fronts) < 0.05
        assert max(float(frame.normal @ normal) for _, normal in fronts) > math.cos(math.radians(0.5))
    # Bends lie beside the parts, and the bent board is one body as long as the flat one.
    folds = [high for _, high in board.blank.facets[:-1]]
    for component in board.components:
        low, _, high, _ = component.extent.bounds
        assert not any(low < fold < high for fold in folds)
    body = orders.solid(board)
    assert body.isValid()
    width, height = board.size_mm
    assert body.Volume() == pytest.approx(width * height * board.thickness_mm, rel=0.05)


# ---------------------------------------------------------------- bad input


def write(design: Design, path: Path) -> str:
    design.save(path)
    return str(path)


@pytest.mark.faults
@pytest.mark.parametrize(
    ("changes", "options", "said"),
    [
        ({}, ["--supply-v", "2.0"], ("supply_v is 2 V", "forward voltage", "kingbright-aptf1616")),
        ({}, ["--supply-v", "-3"], ("supply_v", "-3 V")),
        ({}, ["--supply-v", "nan"], ("supply_v",)),
        ({"leds.part": "worldsemi-ws2812b"}, [], ("worldsemi-ws2812b", "land pattern")),
        ({"leds.part": "vishay-vlm1300", "leds.groups.0.flux_mw": 300.0}, [], ("red", "mA", "bears 20 mA")),
        ({"leds.part": "broadcom-asmt-qtb4"}, [], ("overlap", "pitch_mm", "ASMT-QTB4")),
        ({"housing.inner_radius_mm": 15.35}, [], ("wider than the housing", "inner_radius_mm")),
        ({"leds.layout": "ring", "leds.tilt_deg": 35.0}, [], ("leds.tilt_deg", "35 deg")),
    ],
)
def test_what_no_board_can_be_made_of_is_refused(
    changes: dict[str, Any],
    options: list[str],
    said: tuple[str, ...],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    design = preset("default").replace(changes) if changes else preset("default")
    monkeypatch.setattr(Design, "require_feasible", lambda self, **_: None)  # other rules may be broken too
    out = tmp_path / "out"
    status = main(["export", write(design, tmp_path / "d.toml"), "--out", str(out), *options])
    told = capsys.readouterr().err
    assert status == 2, told
    assert "Traceback" not in told
    assert all(text in told for text in said), told
    assert not out.exists()
    assert not list(tmp_path.glob("*out*"))


@pytest.mark.faults
@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("land", '"TO-220"', "land pattern 'TO-220' is unknown"),
        ("chips.red.cathode", '"9"', "pad '9'"),
        ("chips.red.forward_v", None, "chips.red.forward_v is not given"),
        ("chips.red.current_max_ma", "0.5", "bears 0.5 mA"),
    ],
)
def test_a_users_part_that_lacks_figures_is_refused(
    field: str, value: str | None, said: str, tmp_path: Path
) -> None:
    figures = {
        "number": '"MINE-1"',
        "size_mm": "[1.6, 0.8, 0.6]",
        "land": '"LED_0603_1608Metric"',
        "chips.red.wavelength_nm": "625.0",
        "chips.red.flux_mw": "2.0",
        "chips.red.forward_v": "2.0",
        "chips.red.current_ma": "10.0",
        "chips.red.current_max_ma": "20.0",
        "chips.red.anode": '"2"',
        "chips.red.cathode": '"1"',
    }
    sound = "\n".join(f"{k} = {v}" for k, v in figures.items())
    figures[field] = value  # type: ignore[assignment]
    text = "\n".join(f"{k} = {v}" for k, v in figures.items() if v is not None)

    def design(content: str) -> Design:
        (tmp_path / "parts.toml").write_text(f"[leds.mine]\n{content}\n", encoding="utf-8")
        base = preset("default").model_dump(mode="json", exclude_none=True) | {"parts": "parts.toml"}
        base["leds"]["groups"][0] |= {"part": "mine", "flux_mw": 3.0}
        import tomli_w

        (tmp_path / "d.toml").write_text(tomli_w.dumps(base), encoding="utf-8")
        return load(tmp_path / "d.toml")

    found = boards(design(sound))
    assert found.channels[0].from_flux
    assert found.channels[0].current_ma == pytest.approx(5.0, rel=0.055)
    with pytest.raises(BoardError, match=re.escape(said)):
        boards(design(text))


# ---------------------------------------------------------------- pieces


@pytest.mark.parametrize(
    ("wall", "crossed"), [((), True), (((0.0, -1.2, 0.0, 1.2),), True), (((0.0, -2.0, 0.0, 2.0),), False)]
)
def test_router_goes_around_what_it_can(wall: tuple[tuple[float, ...], ...], crossed: bool) -> None:
    outline = box(-4, -2, 4, 2)
    lands = [routing.Land(box(x - 0.3, -0.3, x + 0.3, 0.3), "A", (0,)) for x in (-3.0, 3.0)]
    for x0, y0, x1, y1 in wall:
        lands.append(routing.Land(LineString([(x0, y0), (x1, y1)]).buffer(0.1), "B", (0, 1)))
    if not crossed:
        with pytest.raises(routing.NoWay):
            routing.route(outline, [], lands)
        return
    tracks, _ = routing.route(outline, [], lands)
    copper = shapely.union_all([*(t.shape for t in tracks), lands[0].shape, lands[1].shape])
    assert copper.geom_type == "Polygon"


@pytest.mark.parametrize("nets", [2, 3, 4])
def test_router_crosses_nets_on_two_layers(nets: int) -> None:
    outline = box(-6, -5, 6, 5)
    lands = []
    for k in range(nets):
        angle = math.pi * k / nets
        for sign in (-1, 1):
            x, y = sign * 4 * math.cos(angle), sign * 4 * math.sin(angle)
            lands.append(routing.Land(Point(x, y).buffer(0.4), f"N{k}", (0,)))
    tracks, vias = routing.route(outline, [(0.0, 0.0, 1.0)], lands)
    assert vias
    for layer in (0, 1):
        for k in range(nets):
            for other in range(k):
                a, b = (
                    shapely.union_all(
                        [t.shape for t in tracks if t.net == net and t.layer == layer]
                        + [v.shape for v in vias if v.net == net]
                        + [x.shape for x in lands if x.net == net and layer in x.layers]
                    )
                    for net in (f"N{k}", f"N{other}")
                )
                assert a.is_empty or b.is_empty or a.distance(b) >= CLEARANCE_MM


def test_every_land_pattern_says_where_it_is_from() -> None:
    for pattern in LAND_PATTERNS.values():
        assert ".kicad_mod" in pattern.source
        for x, y, width, height in pattern.pads.values():
            assert min(width, height) > 0
            assert math.hypot(x, y) < 5


@pytest.mark.slow
def test_export_holds_the_boards(tmp_path: Path) -> None:
    manifest = export(preset("default"), tmp_path / "out", supply_v=6.0)
    assert [board["name"] for board in manifest["boards"]] == ["board_red", "board_green", "board_blue"]
    assert all(drive["supply_v"] == 6.0 for drive in manifest["drive"])
    for board in manifest["boards"]:
        files = {f"boards/{board['name']}{end}" for end in ("-gerbers.zip", "-bom.csv", "-cpl.csv", ".png")}
        assert files | {f"step/{board['name']}.step"} <= set(manifest["files"])
    assert any(name.startswith("kingbright-aptf1616") for name in manifest["assumed"])
    assert "board_red" in (tmp_path / "out" / "assembly.step").read_text(encoding="utf-8")
    readme = (tmp_path / "out" / "README.txt").read_text(encoding="utf-8")
    assert "kingbright-aptf1616" in readme
    rows = list(csv.DictReader(io.StringIO((tmp_path / "out" / "bom.csv").read_text(encoding="utf-8"))))
    assert {"board_red", "board_green", "board_blue"} <= {row["item"] for row in rows}
    plain = export(preset("default"), tmp_path / "out", boards=False)
    assert plain["boards"] == []
    assert not (tmp_path / "out" / "boards").exists()


@pytest.mark.parametrize(
    ("changes", "made"),
    [
        ({}, True),
        ({"housing.inner_radius_mm": 15.35}, False),
        ({"leds.groups.0.wavelength_nm": 940.0, "leds.groups.0.name": "infrared"}, False),
    ],
)
def test_boards_that_do_not_fit_are_left_out_if_that_is_allowed(changes: dict[str, Any], made: bool) -> None:
    found, notes = _boards(preset("default").replace(changes), 5.0, True)
    assert (found is not None) == made
    assert made or notes[0].startswith("no LED boards")


@pytest.mark.parametrize("supply_v", [0.0, 1.5, 2.9])
def test_what_cannot_be_driven_is_refused_whatever_is_allowed(supply_v: float) -> None:
    with pytest.raises(BoardError, match="supply_v"):
        _boards(preset("default"), supply_v, True)


def test_embedded_leds_get_no_board() -> None:
    design = preset("default").replace({"leds.coupling": "embedded", "gelcore.side_finish": "polished"})
    made, notes = _boards(design, 5.0, False)
    assert made is None
    assert "cast" in notes[0]
    assert led_boards.SUPPLY_V == 5.0
