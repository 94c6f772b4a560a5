"""What a workshop reads: LED coordinates, bill of materials, and the text that explains the folder."""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from designlab.design import Design
from geometries.leds import emitters

if TYPE_CHECKING:
    import cadquery


class Stock(NamedTuple):
    """What a part is made of: density (g/ml) and where the figure comes from."""

    material: str
    density_g_ml: float
    source: str


CLEAR_STOCK: dict[str, Stock] = {
    "silicone": Stock("clear silicone gel", 1.03, "SYLGARD 184 data sheet, cured; clear gels lie between 0.97 and 1.04"),
    "acrylic": Stock("acrylic (PMMA), optical grade", 1.19, "optical PMMA data sheets, 1.17 to 1.19"),
    "resin-2020": Stock("clear SLA resin, cured", 1.15, "mid of 1.10 to 1.20 in makers' data sheets"),
    "glass": Stock("N-BK7 glass", 2.51, "SCHOTT N-BK7 data sheet"),
}
PRINTED = Stock("black PLA, or black SLA resin", 1.24, "PLA filament data sheets, solid print; SLA resin is about 1.15")
SMOOTH = Stock("SLA resin, or machined acrylic, polished", 1.15, "mid of 1.10 to 1.20 in makers' data sheets")

CASTING_SURPLUS = 1.3
"""Gel to mix over the gel's volume: overflow, cup and nozzle keep some."""


def led_rows(design: Design) -> list[dict[str, Any]]:
    """One row an emitting strip: group, LED, place, direction, wavelength and its share of the group's flux."""
    strips = len(design.leds.emitting_spans_mm)
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
                "led": index // strips + 1,
                "strip": index % strips + 1,
                "x_mm": round(x, 6),
                "y_mm": round(y, 6),
                "z_mm": round(z, 6),
                **{f"normal_{axis}": round(value, 9) for axis, value in zip("xyz", emitter.normal, strict=True)},
                "azimuth_deg": round(math.degrees(math.atan2(y, x)) % 360, 6),
                "width_mm": round(2 * emitter.half_width_mm, 6),
                "height_mm": round(2 * emitter.half_height_mm, 6),
                "wavelength_nm": group.wavelength_nm,
                "flux_mw": round(group.flux_mw * emitter.area_mm2 / area[emitter.group], 9),
            }
        )
    return rows


def bill(design: Design, shapes: Mapping[str, "cadquery.Shape"]) -> list[dict[str, Any]]:
    """Bill of materials: every part with count, material, volume (ml) and mass (g), then what has to be bought."""
    clear = {"gelcore": design.optics.gelcore_material, "elastomer": design.optics.elastomer_material}
    rows = []
    for name, shape in shapes.items():
        if name == "led_array":
            continue
        stock = SMOOTH if name.startswith("mould") else PRINTED
        if name in clear:
            stock = CLEAR_STOCK[clear[name]]
        volume = shape.Volume() / 1000
        rows.append(_row(name, 1, stock.material, volume, volume * stock.density_g_ml, f"density {stock.source}"))
    gel = next(row for row in rows if row["item"] == "elastomer")
    gel["note"] += f"; mix {CASTING_SURPLUS * gel['mass_g']:.2g} g"
    membrane_mm2 = _membrane_area_mm2(shapes["elastomer"])
    rows.append(_row("membrane", 1, f"reflective coating, {membrane_mm2:.0f} mm2", None, None, "see optics.membrane_albedo"))
    board = f"{design.leds.body_width_mm:g} x {design.leds.body_height_mm:g} x {design.leds.body_thickness_mm:g} mm"
    for group in design.leds.groups:
        count = group.count * len(group.azimuth_deg)
        text = f"{group.wavelength_nm:g} nm {design.leds.package}, {board}, {group.flux_mw / count:.4g} mW each"
        rows.append(_row(f"led_{group.name}", count, text, None, None, "places in leds.csv"))
    camera = design.camera
    text = (
        f"{camera.width_px} x {camera.height_px} px, {camera.horizontal_fov_deg:g} deg horizontal, "
        f"lens barrel up to {2 * camera.body_radius_mm:g} mm"
    )
    place = ", ".join(f"{value:g}" for value in camera.position_mm)
    rows.append(_row("camera", 1, text, None, None, f"entrance pupil at ({place}) mm, looks along -z"))
    return rows


def _row(item: str, count: int, material: str, volume: float | None, mass: float | None, note: str) -> dict[str, Any]:
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
    walls = manifest["walls"]
    lines = [
        f"{design.name}",
        f"{design.description}",
        f"design digest {design.digest}",
        "",
        "All lengths are mm. Sensor frame: origin at the centre of the untouched membrane, +z to the camera.",
        "",
        "design.toml    the design; load it to simulate or to export again",
        "assembly.step  all parts of the sensor in place, named and coloured",
        "step/ stl/     each part, in the sensor frame (probes in their own)",
        "3mf/           the parts to print",
        "leds.csv       centre, direction, wavelength and flux of every emitting face",
        "bom.csv        parts and materials",
        "checks.json    every file read again and compared with the solid",
        "manifest.json  the same figures for programs, with the SHA-256 of every file",
        "",
        "Making it",
        "- housing: print with the camera plate down, in black; paint it matt black inside.",
        f"  Thinnest wall {walls['thinnest_mm']:g} mm, least {walls['least_mm']:g} mm.",
        f"- gelcore: {CLEAR_STOCK[design.optics.gelcore_material].material}; "
        f"polish the window and the faces the LEDs shine through; other sides: {design.gelcore.side_finish}.",
        "- mould: the cavity's floor shapes the membrane and prints its layers into it: print it in SLA resin and",
        "  polish it, or line it. Cure addition silicone only in a mould that does not inhibit it (bake or coat resin).",
        f"- gel: volume {gel['volume_ml']:.3g} ml; {gel['note'].split('; ')[-1]}. Degas, pour, close with the lid;",
        "  surplus leaves through the four grooves. The lid may be replaced by the gelcore itself, primed, so that",
        "  the gel bonds to it. Cure shrinkage (typically below 1 %) is not compensated.",
        "- membrane: coat the gel's outer side.",
        "- LEDs: place by leds.csv. The parts hold no seats for LED boards, camera and gelcore: how these are",
        "  fixed depends on the boards, so add the seats to the STEP files.",
        "",
        "Warnings",
        *([f"- {warning}" for warning in manifest["warnings"]] or ["- none"]),
    ]
    return "\n".join(lines) + "\n"
