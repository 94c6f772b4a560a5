"""The parts of a design are built as CAD solids in the sensor frame, the mould of the gel among them."""

import math
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from designlab.fabrication.boards.drawn import Board
from designlab.fabrication.boards.orders import led_solids
from designlab.fabrication.seating import seated_parts
from designlab.sensor.design import Design
from geometries import elastomer, gelcore, housing, leds, probes
from geometries.elastomer import Elastomer
from geometries.mesh import solids
from geometries.probes import Probe

if TYPE_CHECKING:
    import cadquery

SENSOR_PARTS = ("gelcore", "elastomer", "led_array", "housing")
"""Parts of the sensor itself; the others are tools to make and to calibrate it."""
SEATED_PARTS = ("housing", "lid", "core_ring", "gel_ring", "camera", "inserts", "screws")
"""Body of a housing with seats, and what such a one adds to the sensor."""
CASTING_PARTS = ("elastomer", "mould_cavity", "mould_lid")
"""Parts that fill the closed mould."""

# Pins stand in the corners of the wall, which holds a pin and some printed lines around it.
MOULD_WALL_MM = 8.0
MOULD_FLOOR_MM = 4.0
PIN_DIAMETER_MM, PIN_HEIGHT_MM, PIN_INSET_MM = 3.0, 3.0, 3.5
PIN_FOOT_MM = 0.5  # room under a pin, so that the halves meet before the pins do
PIN_CLEARANCE_MM = 0.2  # on the diameter: printed pins grow, printed holes shrink
GROOVE_WIDTH_MM, GROOVE_DEPTH_MM = 1.0, 0.5


class Led(NamedTuple):
    """An LED as it is built: its name, its groups, the board that carries it if any, and its solid."""

    name: str
    groups: tuple[int, ...]
    board: str
    solid: "cadquery.Shape"


def built_leds(design: Design, boards: Sequence[Board]) -> list[Led]:
    """LEDs in the order of the design's packages: those that the boards carry, else as the design draws them.

    A package that a board fills with several LEDs gives each a name with a number of its own.
    """
    found = leds.bodies(design.leds)
    names = [
        "_".join([f"led_{n:03d}", *_names(design, body.groups)]) for n, body in enumerate(found, start=1)
    ]
    if not boards:
        shapes = solids(leds.solid(design.leds))
        return [
            Led(name, body.groups, "", shape) for name, body, shape in zip(names, found, shapes, strict=True)
        ]
    held: list[tuple[int, Led]] = []
    for board in boards:
        for place, shape in zip(board.blank.places, led_solids(board), strict=True):
            held.append((place.body, Led(names[place.body], place.groups, board.name, shape)))
    held.sort(key=lambda numbered: numbered[0])
    count = Counter(number for number, _ in held)
    seen: Counter[int] = Counter()
    made = []
    for number, led in held:
        seen[number] += 1
        made.append(led if count[number] == 1 else led._replace(name=f"{led.name}_{seen[number]}"))
    return made


def _names(design: Design, groups: Sequence[int]) -> list[str]:
    return [design.leds.groups[index].name for index in groups]


def parts(
    design: Design, *, probe_list: Sequence[Probe] = (), boards: Sequence[Board] = ()
) -> dict[str, "cadquery.Shape"]:
    """Build every part of a design.

    Parameters
    ----------
    design : Design
        The sensor.
    probe_list : sequence of Probe
        Indenters to add as ``probe_<kind>_<size>``, in their own frame; mesh probes have no solid: refused.
    boards : sequence of Board
        LED boards that a housing with seats has pockets for, and whose LEDs are drawn.

    Returns
    -------
    dict of str to cadquery.Shape
        ``gelcore`` (with the cavities of LEDs cast into it), ``elastomer``, ``led_array`` (one solid an
        LED), ``housing``, ``mould_cavity`` and ``mould_lid`` in the sensor frame (mm), and the probes. A
        housing with seats adds ``lid``, ``camera``, ``screws`` and, where needed, ``inserts``, ``core_ring``,
        ``gel_ring``.

    Raises
    ------
    InfeasibleDesign
        If a part has no shape, see `designlab.sensor.feasibility.SHAPED`.
    SeatError
        If a part finds no seat; names part, value and rule.
    """
    design.require_shapes()
    gel = _shape(elastomer.solid(design.elastomer))
    core = _shape(gelcore.solid(design.gelcore).translate((0, 0, design.elastomer.thickness_mm)))
    if design.leds.coupling == "embedded":
        core = core.cut(*leds.solids(design.leds))
    found = {
        "gelcore": core,
        "elastomer": gel,
        "led_array": _joined([led.solid for led in built_leds(design, boards)]),
        **(
            {"housing": _shape(housing.solid(design.housing))}
            if design.housing.seats is None
            else seated_parts(design, boards)
        ),
        **_mould(design.elastomer, gel),
    }
    return found | {probe_name(probe): _shape(probes.solid(probe)) for probe in probe_list}


def probe_name(probe: Probe) -> str:
    """Name of a probe's part, for example ``probe_sphere_4mm``; a mesh probe is called after its file."""
    kind = probe.kind if probe.file is None else re.sub(r"[^A-Za-z0-9_-]+", "_", Path(probe.file).stem)
    edge = f"_edge_{probe.edge_radius_mm:.6g}mm" if probe.edge_radius_mm else ""
    return f"probe_{kind}_{probe.size_mm:.6g}mm{edge}"


def _shape(work: "cadquery.Workplane") -> "cadquery.Shape":
    """Join what stands on a workplane into one shape: the solid, or a compound of several."""
    return _joined(solids(work))


def _joined(found: "Sequence[cadquery.Shape]") -> "cadquery.Shape":
    import cadquery

    return found[0] if len(found) == 1 else cadquery.Compound.makeCompound(found)


def _mould(spec: Elastomer, gel: "cadquery.Shape") -> dict[str, "cadquery.Shape"]:
    """Two halves that leave the gel's volume between them; the membrane lies on the cavity's floor.

    They part at the gel's highest point. Four pins align them, and four grooves let surplus gel out.
    """
    import cadquery

    box = gel.BoundingBox()
    parting = box.zmax
    size_x, size_y = box.xlen + 2 * MOULD_WALL_MM, box.ylen + 2 * MOULD_WALL_MM

    def block(size_x: float, size_y: float, bottom: float, top: float) -> "cadquery.Workplane":
        plane = cadquery.Workplane("XY", origin=(0, 0, bottom))
        return plane.box(size_x, size_y, top - bottom, centered=(True, True, False))

    def pins(diameter: float, bottom: float) -> "cadquery.Workplane":
        spacing = size_x - 2 * PIN_INSET_MM, size_y - 2 * PIN_INSET_MM
        places = cadquery.Workplane("XY", origin=(0, 0, bottom)).rarray(*spacing, 2, 2)
        return places.circle(diameter / 2).extrude(parting - bottom)

    cavity = block(size_x, size_y, box.zmin - MOULD_FLOOR_MM, parting).cut(cadquery.Workplane(gel))
    lid = block(size_x, size_y, parting, parting + MOULD_FLOOR_MM)
    if spec.radius_mm is not None:
        plug = _plug(spec, parting)
        cavity, lid = cavity.cut(plug), lid.union(plug)
    groove_floor = parting - min(GROOVE_DEPTH_MM, spec.thickness_mm / 2)
    for groove in ((size_x, GROOVE_WIDTH_MM), (GROOVE_WIDTH_MM, size_y)):
        cavity = cavity.cut(block(*groove, groove_floor, parting))
    cavity = cavity.cut(pins(PIN_DIAMETER_MM + PIN_CLEARANCE_MM, parting - PIN_HEIGHT_MM - PIN_FOOT_MM))
    lid = lid.union(pins(PIN_DIAMETER_MM, parting - PIN_HEIGHT_MM))
    return {"mould_cavity": _shape(cavity), "mould_lid": _shape(lid)}


def _plug(spec: Elastomer, parting_mm: float) -> "cadquery.Workplane":
    """What a dome's lid puts into the cavity: the ball's cap between the gel and the parting plane."""
    import cadquery

    assert spec.radius_mm is not None
    bottom, radius = spec.thickness_mm, spec.radius_mm - spec.thickness_mm
    half_angle = math.asin(min(1.0, spec.width_mm / 2 / radius)) / 2
    middle = radius * math.sin(half_angle), bottom + 2 * radius * math.sin(half_angle / 2) ** 2
    sketch = cadquery.Workplane("XZ").moveTo(0, bottom)
    sketch = sketch.threePointArc(middle, (min(spec.width_mm / 2, radius), parting_mm))
    return sketch.lineTo(0, parting_mm).close().revolve(360, (0, 0, 0), (0, 1, 0))
