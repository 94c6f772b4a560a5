"""The capture plan lists the frames of a kit, what is stated of them, and what is really there."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from designlab.core.types import Array
from designlab.sensor.design import Design
from designlab.validation.synthetic.generator_sensor import Rig
from designlab.validation.synthetic.indenter import Indenter
from geometries import elastomer, probes
from geometries.probes import Probe

SIGMA = {
    "depth_mm": 0.02,
    "centre_mm": 0.05,
    "yaw_deg": 0.5,
}  # between the metadata and what was really pressed
PLACES = {
    "hour": ((-32, -28), (5, -30), (33, -22), (-33, 6), (2, 3), (31, 10), (-25, 31), (12, 30)),
    "small": ((-28, -20), (30, -5), (-2, 26)),
}  # of ball presses, in percent of the sensing area's width and height
BACKGROUNDS = {"hour": 5, "small": 3}  # of the untouched gel, in between
LADDER = (0.25, 0.5)  # exposures besides 1
TURN_DEG = 180.0
FURTHER = "further"  # begins the file names of frames taken after those of a kit
MOST_EDGE = 0.99  # of the radius at which a probe has no straight edge left
OTHER_KIND = {"sphere": "cone", "triangle": "star", "star": "triangle", "cone": "sphere"}
"""What is pressed instead of a probe where the object is wrong; a ball for all others."""


class PlannedShot(NamedTuple):
    """One frame to take: the metadata written, the true indentation, and which groups are on.

    `exposure` is relative, `gel_deg` the rotation of the gel; a flat field shows no gel at all.
    """

    metadata: dict[str, Any]
    indenter: Indenter | None
    lit: Array
    exposure: float = 1.0
    gel_deg: float = 0.0

    @property
    def file(self) -> str:
        """Name of its file."""
        return str(self.metadata["file"])

    @property
    def is_flat_field(self) -> bool:
        """Whether the camera looks into uniform light."""
        return bool(self.metadata["kind"] == "flat_field")


def stated_presses(design: Design, kit: str, random: np.random.Generator) -> list[dict[str, Any]]:
    """Presses of a kit, scaled to the sensor; places move by up to 4 % of the sensing area."""
    width, height = design.sensing_area_mm
    thickness = design.elastomer.thickness_mm
    shallow, deep = (round(min(limit, share * thickness), 3) for limit, share in ((0.4, 0.2), (0.8, 0.4)))
    ball, side = round(min(4.0, height / 3), 2), round(min(5.0, 0.42 * height), 2)

    def place(percent_x: float, percent_y: float) -> list[float]:
        shift = random.uniform(-4, 4, 2)
        return [
            round((percent_x + shift[0]) / 100 * width, 2),
            round((percent_y + shift[1]) / 100 * height, 2),
        ]

    found = []
    for percent in PLACES[kit]:
        centre = place(*percent)
        found += [
            {"probe": f"sphere:{ball:g}", "depth_mm": depth, "centre_mm": centre, "yaw_deg": 0.0}
            for depth in (shallow, deep)
        ]
    if kit == "hour":
        for percent, yaw_deg, depth in (((12, -10), -28.0, deep), ((-15, 12), 40.0, shallow)):
            found.append(
                {
                    "probe": f"triangle:{side:g}",
                    "depth_mm": depth,
                    "centre_mm": place(*percent),
                    "yaw_deg": yaw_deg,
                }
            )
    return found


def true_press(
    rig: Rig,
    press: Mapping[str, Any],
    random: np.random.Generator,
    *,
    sigma: Mapping[str, float] = SIGMA,
) -> Indenter:
    """Indentation that is really there when the metadata say `press`, give or take `sigma`.

    Raises
    ------
    ValueError
        If a field is missing, or the press misses the gel.
    """
    missing = [field for field in ("probe", "depth_mm", "centre_mm") if field not in press]
    if missing:
        raise ValueError(f"presses: {missing[0]} is needed, got {dict(press)}")
    x, y = press["centre_mm"]
    if not elastomer.inside(rig.elastomer, x, y):
        raise ValueError(f"presses: centre_mm ({x:g}, {y:g}) lies on the gel")
    error = random.standard_normal(4)
    contact, probe = rig.contact, probes.parse(press["probe"])
    if contact.probe_scale != 1.0:
        probe = probe.scaled(contact.probe_scale)
    if contact.edge_mm:
        probe = _rounded(probe, contact.edge_mm)
    beside = None
    if contact.second is not None:
        *place, diameter, depth = contact.second
        beside = Indenter(probes.sphere(diameter_mm=diameter), depth, (place[0], place[1]))
    return Indenter(
        probe,
        max(float(press["depth_mm"]) + contact.deeper_mm + sigma["depth_mm"] * error[0], 0.01),
        (x + sigma["centre_mm"] * error[1], y + sigma["centre_mm"] * error[2]),
        float(press.get("yaw_deg", 0.0)) + sigma["yaw_deg"] * error[3],
        other=_instead(probe) if contact.wrong else None,
        wrong=contact.wrong,
        beside=beside,
    )


def _rounded(probe: Probe, edge_mm: float) -> Probe:
    """Round the edges of a probe that has any by so much more."""
    if probe.kind not in probes.LARGEST_EDGE:
        return probe
    most_mm = MOST_EDGE * probes.LARGEST_EDGE[probe.kind] * probe.size_mm
    return probe.model_copy(update={"edge_radius_mm": min(probe.edge_radius_mm + edge_mm, most_mm)})


def _instead(probe: Probe) -> Probe:
    return probes.parse(f"{OTHER_KIND.get(probe.kind, 'sphere')}:{probe.size_mm:g}")


def shots(
    rig: Rig,
    kit: str,
    stated: list[dict[str, Any]],
    true: list[Indenter],
    *,
    flat_field: bool,
    sigma: Mapping[str, float] = SIGMA,
) -> list[PlannedShot]:
    """Frames in the order in which they are taken: backgrounds lie between the presses."""
    groups = len(rig.flux_mw)
    everything, nothing = np.ones(groups), np.zeros(groups)

    def background(name: str, lit: Array = everything, **more: Any) -> PlannedShot:
        return PlannedShot({"file": f"background-{name}.exr", "kind": "background", **more}, None, lit)

    known = {"sigma": dict(sigma)}
    presses = [
        PlannedShot({"file": f"press-{number:02d}.exr", "kind": "press", **press, **known}, one, everything)
        for number, (press, one) in enumerate(zip(stated, true, strict=True), start=1)
    ]
    between = [background(str(number), repeat=number) for number in range(BACKGROUNDS[kit])]
    first = [PlannedShot({"file": "dark.exr", "kind": "dark", "leds": []}, None, nothing)]
    first += [
        background(name, lit, leds=[name]) for name, lit in zip(rig.group_names, np.eye(groups), strict=True)
    ]
    if flat_field:
        first.append(PlannedShot({"file": "flat-field.exr", "kind": "flat_field"}, None, everything))
    found = [*first, between[0]]
    if kit == "hour":
        if presses:
            again = presses[0]._replace(
                metadata=presses[0].metadata | {"file": f"press-{len(presses) + 1:02d}.exr", "repeat": 1}
            )
            presses.append(again)
        found += [background(f"exposure-{share:g}")._replace(exposure=share) for share in LADDER]
    parts = np.array_split(np.arange(len(presses)), len(between) - 1)
    for part, after in zip(parts, between[1:], strict=True):
        found += [presses[number] for number in part] + [after]
    if kit == "hour":
        turned = background(f"turned-{TURN_DEG:g}", gel_rotation_deg=TURN_DEG)
        found.append(turned._replace(gel_deg=TURN_DEG))
    return found


def further_shot(
    rig: Rig,
    frame: Mapping[str, Any],
    number: int,
    random: np.random.Generator,
    *,
    sigma: Mapping[str, float] = SIGMA,
) -> PlannedShot:
    """Frame that is taken after those of a kit.

    Parameters
    ----------
    frame : mapping
        Fields of a measurement file: kind (background, dark or press), leds, exposure, gel_rotation_deg, and
        those of a press.

    Raises
    ------
    ValueError
        If a field cannot be used.
    """
    fields = dict(frame)
    kind = fields.get("kind")
    if kind not in ("background", "dark", "press"):
        raise ValueError(f"frames: kind: background, dark or press, got {kind!r}")
    names = fields.get("leds", rig.group_names)
    if unknown := [name for name in names if name not in rig.group_names]:
        raise ValueError(f"frames: leds: no group {unknown[0]!r}; there are {', '.join(rig.group_names)}")
    lit = np.array([float(name in names and kind != "dark") for name in rig.group_names])
    exposure = float(fields.pop("exposure", 1.0))
    metadata = {"file": f"{FURTHER}-{number:02d}.exr", **fields}
    gel_deg = float(fields.get("gel_rotation_deg", 0.0))
    if kind != "press":
        return PlannedShot(metadata, None, lit, exposure, gel_deg)
    true = true_press(rig, fields, random, sigma=sigma)
    return PlannedShot({**metadata, "sigma": dict(sigma)}, true, lit, exposure, gel_deg)
