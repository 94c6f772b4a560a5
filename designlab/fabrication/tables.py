"""Workshop tables hold LED coordinates and the bill of materials; ``readme.txt`` explains the folder."""

import csv
import math
import re
import textwrap
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from designlab.fabrication.boards import Boards
from designlab.fabrication.seating import BOUGHT, WIRE_MM, screw_length_mm
from designlab.fabrication.seating import PRINTED as PRINTED_PARTS
from designlab.sensor.contact import LayerContact
from designlab.sensor.design import Design
from designlab.sensor.gel_materials import MATERIALS, GelMaterial
from designlab.sensor.seating import mount
from geometries.camera_head import screw_places
from geometries.leds import LedGroup, bodies, emitters

if TYPE_CHECKING:
    import cadquery


class Stock(NamedTuple):
    """What a part is made of: density (g/ml) and where the figure comes from."""

    material: str
    density_g_ml: float
    source: str


_STOCK = tomllib.loads(files(__package__).joinpath("stock.toml").read_text(encoding="utf-8"))
CLEAR_STOCK = {name: Stock(**entry) for name, entry in _STOCK["clear"].items()}
"""What clear parts are made of, by the name of their optical material."""
PRINTED, SMOOTH = Stock(**_STOCK["printed"]), Stock(**_STOCK["smooth"])

CASTING_SURPLUS = 1.3
"""Gel to mix over the gel's volume: overflow, cup and nozzle keep some."""
BESIDE_GEL_G, LEAST_BATCH_G = 5.0, 10.0
"""Silicone for bond, coating and test pieces, and the least that is mixed, so that a scale of 0.1 g suffices
(assumed)."""
WIRE_M = 0.3
"""Length of each wire."""


def led_rows(design: Design, numbers: Mapping[str, str] | None = None) -> list[dict[str, Any]]:
    """One row an emitting strip: group, LED, place, direction, wavelength and share of the group's flux.

    `numbers` are part numbers of the bill of materials, by item.
    """
    packages = [led_item(design, body.groups) for body in bodies(design.leds)]
    strips = len(design.leds.emitting_spans_mm)  # the LED is the package's number, as in the assembly
    flux = "relative_flux" if design.leds.relative_flux else "flux_mw"
    found = emitters(design.leds)
    area = [0.0] * len(design.leds.groups)
    for emitter in found:
        area[emitter.group] += emitter.area_mm2
    rows = []
    for index, emitter in enumerate(found):
        group = design.leds.groups[emitter.group]
        x, y, z = emitter.centre_mm
        rows.append(
            {
                "group": group.name,
                "led": emitter.body + 1,
                **({} if numbers is None else {"part": numbers[packages[emitter.body]]}),
                "strip": index % strips + 1,
                "x_mm": x,
                "y_mm": y,
                "z_mm": z,
                **{f"normal_{axis}": value for axis, value in zip("xyz", emitter.normal, strict=True)},
                "azimuth_deg": math.degrees(math.atan2(y, x)) % 360,
                "width_mm": 2 * emitter.half_width_mm,
                "height_mm": 2 * emitter.half_height_mm,
                "wavelength_nm": group.wavelength_nm,
                flux: group.flux_mw * emitter.area_mm2 / area[emitter.group],
            }
        )
    # 1 nm is far below any machine's step; adding zero turns -0.0 into 0.0.
    return [{key: round(v, 6) + 0.0 if isinstance(v, float) else v for key, v in row.items()} for row in rows]


def led_item(design: Design, groups: Sequence[int]) -> str:
    """Item of the bill of materials for packages that hold some groups."""
    return "_".join(["led", *(design.leds.groups[index].name for index in groups)])


def _colours(groups: Sequence[LedGroup]) -> str:
    """Peaks of groups in nm, or the names of their spectra."""
    if any(group.spectrum is not None for group in groups):
        return _listed([group.colour for group in groups])
    return f"{_listed([f'{g.wavelength_nm:g}' for g in groups])} nm"


def batch_g(gel_g: float) -> float:
    """Silicone to mix in all (g), for gel, bond, coating and test pieces, from the mass of the gel."""
    return max(LEAST_BATCH_G, math.ceil(CASTING_SURPLUS * gel_g + BESIDE_GEL_G))


def gel_to_buy(design: Design) -> tuple[GelMaterial | None, bool]:
    """Silicone that the gel is cast of, and whether the design names it; None where nothing tells it.

    Where the design's own has no mixing ratio, it is the nearest in modulus that cameras have looked through.
    """
    contact = design.contact
    if not isinstance(contact, LayerContact):
        return None, False
    own = MATERIALS.get(contact.gel)
    if own is not None and own.mixing_ratio:
        return own, True
    modulus = contact.layer(thickness_mm=design.elastomer.thickness_mm).modulus_mpa
    mixed = [entry for entry in MATERIALS.values() if entry.mixing_ratio and entry.in_sensors]
    return min(mixed, key=lambda entry: abs(math.log(entry.modulus_mpa / modulus))), False


def mixed_masses(ratio: str, batch: float) -> str:
    """Masses of the parts of a batch (g) by a ratio such as ``A : B 10:1``; empty where it has no numbers."""
    found = re.search(r"\d+(?:\.\d+)?(?::\d+(?:\.\d+)?)+", ratio)
    if found is None:
        return ""
    shares = [float(share) for share in found.group().split(":")]
    return _listed([f"{batch * share / sum(shares):.1f} g" for share in shares])


def bill(
    design: Design, shapes: Mapping[str, "cadquery.Shape"], made: Boards | None = None
) -> list[dict[str, Any]]:
    """Bill of materials: each part with count, material, volume (ml) and mass (g), then what is bought.

    LEDs are counted in packages: one that groups share is one row, with a channel for each. Where boards are
    `made`, they are the LEDs on these.
    """
    clear = {"gelcore": design.optics.gelcore_material, "elastomer": design.optics.elastomer_material}
    rows = []
    for name, shape in shapes.items():
        if name == "led_array" or name in BOUGHT:
            continue
        stock = SMOOTH if name.startswith("mould") else PRINTED
        if name in clear:
            stock = CLEAR_STOCK[clear[name]]
        volume = shape.Volume() / 1000
        note = f"density {stock.density_g_ml:g} g/ml ({stock.source})"
        note = f"{note}; mass of a solid print, an open infill weighs less" if name in PRINTED_PARTS else note
        rows.append(_row(name, 1, stock.material, volume, volume * stock.density_g_ml, note))
    gel = next(row for row in rows if row["item"] == "elastomer")
    gel["note"] += "; cast of the silicone below"
    coating = f"reflective coating, {_membrane_area_mm2(shapes['elastomer']):.0f} mm²"
    albedo = ", ".join(f"{value:.2g}" for value in design.per_group("membrane_albedo"))
    rows.append(_row("membrane", 1, coating, None, None, f"pigment in silicone; reflectance {albedo}"))
    silicone, named = gel_to_buy(design)
    name = "clear silicone" if silicone is None else f"{silicone.name}, {silicone.mixing_ratio}"
    text = "for gel, bond, coating and test pieces"
    text += "" if named else "; the design names none with a ratio: assumed"
    rows.append(_row("silicone", 1, f"{name}: {batch_g(gel['mass_g']):g} g mixed", None, None, text))
    leds = design.leds
    board = f"{leds.body_width_mm:g} x {leds.body_height_mm:g} x {leds.body_thickness_mm:g} mm"
    packages = Counter(body.groups for body in bodies(leds))
    for held, count in packages.items():
        groups = [leds.groups[index] for index in held]
        each = [f"{g.flux_mw / (g.count * len(g.azimuth_deg)):.4g}" for g in groups]
        flux = "relative, no power is known" if leds.relative_flux else f"{_listed(each)} mW each"
        text = f"{_colours(groups)} {leds.package}, {board}, {flux}"
        bought = [name for name in dict.fromkeys(g.part or leds.part for g in groups) if name is not None]
        if bought:
            parts = [design.led_part(name) for name in bought]
            text = f"{_listed([f'{part.maker} {part.number}'.strip() for part in parts])}, {text}"
        note = "places in leds.csv" if len(held) == 1 else f"{len(held)} channels; places in leds.csv"
        if made is not None:
            channel = made.channels[held[0]]
            count = sum(place.groups == held for board in made.boards for place in board.blank.places)
            lit = _listed([made.channels[index].colour for index in held])
            number = f"{channel.part.maker} {channel.number}".strip()
            size = channel.part.size_mm
            outside = (
                "" if size is None else f", {' x '.join('?' if v is None else f'{v:g}' for v in size)} mm"
            )
            text = f"{number}{outside}, lit in {lit}"
            note = f"come on the LED boards; {note}; light in the design: {flux}; that of the boards differs"
        rows.append(_row(led_item(design, held), count, text, None, None, note))
    camera = design.camera
    text = (
        f"{camera.width_px} x {camera.height_px} px, {camera.horizontal_fov_deg:g}° horizontal, "
        f"lens barrel up to {2 * camera.body_radius_mm:g} mm"
    )
    place = ", ".join(f"{value:g}" for value in camera.position_mm)
    if "camera" in shapes:
        text = f"{mount(design).board.title}, {text}"
    look = (
        "looks down at the gel"
        if camera.mirror is None
        else "looks into the mirror; its picture comes out turned"
    )
    rows.append(_row("camera", 1, text, None, None, f"entrance pupil at ({place}) mm, {look}"))
    if (mirror := camera.mirror) is not None:
        text = f"flat front-surface mirror, {mirror.width_mm:g} x {mirror.height_mm:g} mm"
        centre = ", ".join(f"{value:g}" for value in mirror.centre_mm)
        normal = ", ".join(f"{value:.4g}" for value in mirror.axes[2] + 0.0)
        rows.append(_row("mirror", 1, text, None, None, f"middle at ({centre}) mm, faces ({normal})"))
    if design.housing.seats is not None:
        rows += _fasteners(design, shapes, made)
    return rows


def _fasteners(
    design: Design, shapes: Mapping[str, "cadquery.Shape"], made: Boards | None
) -> list[dict[str, Any]]:
    """Rows of what is bought to put a housing with seats together."""
    camera, rows = mount(design), []
    count = len(screw_places(camera))
    screw = f"{camera.fastener.title}, {screw_length_mm(camera, design.housing.top_mm):g} mm long"
    rows.append(_row("screws", count, screw, None, None, "hold lid and camera"))
    if "inserts" in shapes:
        rows.append(
            _row(
                "inserts", count, camera.fastener.insert_title, None, None, "in the housing, under the screws"
            )
        )
    groups = len(design.leds.groups)
    pins = 2 * groups if made is None else sum(len(board.pins) for board in made.boards)
    told = {
        "core": CLEAR_STOCK[design.optics.gelcore_material].material,
        "wire_mm": WIRE_MM,
        "wire_m": WIRE_M * pins,
        "colours": groups + 1,
    }
    for item, entry in _STOCK["consumables"].items():
        count = groups if item == "switches" else 1
        rows.append(_row(item, count, entry["material"].format(**told), None, None, entry["note"]))
    return rows


def numbered(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Rows of a bill of materials with part numbers, which the building guide uses too."""
    return [{"part": f"P{number:02d}", **row} for number, row in enumerate(rows, start=1)]


def _listed(texts: Sequence[str]) -> str:
    """Texts in a row: a, b and c."""
    *others, last = texts
    return f"{', '.join(others)} and {last}" if others else last


def _row(
    item: str, count: int, material: str, volume: float | None, mass: float | None, note: str
) -> dict[str, Any]:
    return {
        "item": item,
        "count": count,
        "material": material,
        "volume_ml": None if volume is None else round(volume, 4),
        "mass_g": None if mass is None else round(mass, 3),
        "note": note,
    }


def _membrane_area_mm2(gel: "cadquery.Shape") -> float:
    """Area of the gel's outer side: the face on which its lowest point lies."""
    return float(min(gel.Faces(), key=lambda face: (face.BoundingBox().zmin, face.Center().z)).Area())


def write_csv(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write rows of equal keys; None becomes an empty cell."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def readme(design: Design, manifest: Mapping[str, Any]) -> str:
    """Text of README.txt: what lies in the folder, how the parts are made, and every warning."""
    gel = next(row for row in manifest["bom"] if row["item"] == "elastomer")
    text = files(__package__).joinpath("readme.txt").read_text(encoding="utf-8")
    text = text.format(
        thinnest=manifest["walls"]["thinnest_mm"],
        least=manifest["walls"]["least_mm"],
        core=CLEAR_STOCK[design.optics.gelcore_material].material,
        finish=design.gelcore.side_finish,
        gel_ml=gel["volume_ml"],
        mix_g=batch_g(gel["mass_g"]),
        thinnest_part=manifest["walls"]["thinnest_part"],
        probes=" (probes in their own)"
        if any(name.startswith("probe") for name in manifest["parts"])
        else "",
        coupling=_STOCK["coupling"].get(design.leds.coupling, ""),
        boards=_STOCK["boards"]["made" if manifest["boards"] else "none"],
        seats=_STOCK["seats"]["none" if design.housing.seats is None else "made"],
        warnings="\n".join(f"- {warning}" for warning in manifest["warnings"] or ["none"]),
    )
    about = [*textwrap.wrap(design.description, 100), *textwrap.wrap(design.lineage, 100)]
    if assumed := manifest["assumed"]:
        text += (
            "\nAssumed, for want of a published figure; measure yours or state it in the design:\n- "
            + ", ".join(assumed)
            + "\n"
        )
    lines = [design.name, *about, f"design digest {design.digest}", ""]
    for line in text.splitlines():
        lines += textwrap.wrap(line, 100, subsequent_indent="  ") if line.startswith("- ") else [line]
    return "\n".join(lines) + "\n"
