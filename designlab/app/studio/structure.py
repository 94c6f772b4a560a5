"""Parts of a design that are added and taken away: LED groups, and a mirror before the camera.

Changes of a session are values by path. Which groups there are is one of them: at `GROUPS` stand the name of
each group and the number of the group of the opened file that it began as.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import ValidationError

from designlab.sensor.design import PER_GROUP, Design, DesignError
from designlab.sensor.field_errors import explain
from designlab.sensor.mirror import Mirror

GROUPS, MIXING, MIRROR = "leds.groups", "mixing", "camera.mirror"
CAMERA_PLACE, CAMERA_TILT = "camera.position_mm", "camera.tilt_deg"
BESIDE = {GROUPS: (MIXING, *(f"optics.{name}" for name in PER_GROUP)), MIRROR: (CAMERA_PLACE, CAMERA_TILT)}
"""Fields that may have to change at once with a part."""
MOST_GROUPS = 12
MIRROR_SHARE = 0.2  # of the way from the camera to the window, at which a new mirror hangs
MIRROR_ROOM = 1.05  # size of a new mirror over what the camera needs of it
POINT_MM = 1e-3
FULL_TURN_DEG = 360.0

Edits = Mapping[str, Any]


def replacements(base: Design, edits: Edits) -> dict[str, Any]:
    """Changes as `Design.replace` takes them.

    Raises
    ------
    DesignError
        If a group or a mirror is none.
    """
    found = dict(edits)
    if GROUPS in edits:
        found[GROUPS] = [
            {**base.leds.groups[number].model_dump(), "name": name}
            for name, number in _groups(base, edits[GROUPS])
        ]
    if edits.get(MIRROR) is not None:
        try:
            found[MIRROR] = Mirror.model_validate(edits[MIRROR]).model_dump()
        except ValidationError as error:
            raise DesignError(f"{MIRROR}: {explain(error)}") from None
    # Parts first: changes within them follow.
    return {path: found[path] for path in sorted(found, key=lambda path: path not in BESIDE)}


def with_group(base: Design, design: Design, edits: Edits, like: int) -> dict[str, Any]:
    """Changes with one more LED group, like another of the design, where most room is between the rows."""
    groups = _groups(base, edits.get(GROUPS, _of(base)))
    if len(groups) >= MOST_GROUPS:
        raise DesignError(f"{GROUPS}: must be at most {MOST_GROUPS}")
    names = {group.name for group in design.leds.groups}
    stem = design.leds.groups[like].name.rstrip("0123456789")
    name = next(f"{stem}{number}" for number in range(2, len(names) + 3) if f"{stem}{number}" not in names)
    new = len(groups)
    copied = {
        _moved(path, like, new): value
        for path, value in edits.items()
        if _number(path) == like and not path.endswith((".azimuth_deg", ".name"))
    }
    rows = [row for group in design.leds.groups for row in group.azimuth_deg]
    found = {
        **edits,
        GROUPS: [*groups, (name, groups[like][1])],
        **copied,
        f"{GROUPS}.{new}.azimuth_deg": [widest_gap_deg(rows)],
    }
    return found | _by_group(base, design, [*range(new), like])


def without_group(base: Design, design: Design, edits: Edits, index: int) -> dict[str, Any]:
    """Changes with one LED group less.

    Raises
    ------
    DesignError
        If it is the only one.
    """
    groups = _groups(base, edits.get(GROUPS, _of(base)))
    if len(groups) < 2:
        raise DesignError(f"{GROUPS}: a sensor needs at least one LED group")
    kept = [number for number in range(len(groups)) if number != index]
    found: dict[str, Any] = {}
    for path, value in edits.items():
        number = _number(path)
        if number is None:
            found[path] = value
        elif number != index:
            found[_moved(path, number, kept.index(number))] = value
    found[GROUPS] = [groups[number] for number in kept]
    return found | _by_group(base, design, kept)


def with_mirror(design: Design, edits: Edits) -> dict[str, Any]:
    """Changes with a mirror at 45 deg and the camera beside it, so that the picture stays the same.

    Raises
    ------
    DesignError
        If the camera does not look straight down, or the housing has seats for it.
    """
    camera = design.camera
    if any(camera.tilt_deg):
        raise DesignError(f"{MIRROR}: the studio adds one where camera.tilt_deg is 0; write it in the file")
    x, y, z = camera.position_mm
    way_mm = MIRROR_SHARE * max(z - design.gelcore.height_mm, 0.0) or z / 2
    mirror: dict[str, Any] = {"centre_mm": [x, y, z - way_mm], "tilt_deg": [45.0, 0.0]}
    moved = {CAMERA_PLACE: [x, y + way_mm, z - way_mm], CAMERA_TILT: [-90.0, 0.0]}
    point = design.replace({MIRROR: {**mirror, "width_mm": POINT_MM, "height_mm": POINT_MM}, **moved})
    size_mm = math.ceil(20 * MIRROR_ROOM * point.margins()["mirror_fills_view"]) / 10
    sized = Mirror.model_validate({**mirror, "width_mm": size_mm, "height_mm": size_mm})
    kept = {path: value for path, value in edits.items() if not path.startswith(f"{MIRROR}.")}
    return {**kept, MIRROR: sized.model_dump(mode="json"), **moved}


def without_mirror(design: Design, edits: Edits) -> dict[str, Any]:
    """Changes without the mirror, the camera where it sees the same."""
    seen = design.camera.unfolded
    return {
        **{path: value for path, value in edits.items() if not path.startswith(f"{MIRROR}.")},
        MIRROR: None,
        CAMERA_PLACE: [round(part, 6) + 0.0 for part in seen.position_mm],
        CAMERA_TILT: [round(part, 6) + 0.0 for part in seen.tilt_deg],
    }


def widest_gap_deg(rows_deg: Sequence[float]) -> float:
    """Middle of the widest gap between directions (deg, from 0 to 360)."""
    there = sorted({row % FULL_TURN_DEG for row in rows_deg})
    gaps = np.diff([*there, there[0] + FULL_TURN_DEG])
    widest = int(gaps.argmax())
    return round(float(there[widest] + gaps[widest] / 2) % FULL_TURN_DEG, 3)


def _of(base: Design) -> list[tuple[str, int]]:
    return [(group.name, number) for number, group in enumerate(base.leds.groups)]


def _groups(base: Design, told: Any) -> list[tuple[str, int]]:
    """Names and numbers of groups as they are stated; an address may state anything."""
    most = len(base.leds.groups)
    try:
        found = [(str(name), int(number)) for name, number in told]
    except (TypeError, ValueError):
        found = []
    if not 0 < len(found) <= MOST_GROUPS or any(not 0 <= number < most for _, number in found):
        raise DesignError(
            f"{GROUPS}: must be a name and a number below {most} for each of at most {MOST_GROUPS} groups"
        )
    return found


def _by_group(base: Design, design: Design, columns: Sequence[int]) -> dict[str, Any]:
    """Fields that have a value for each group, for so many groups, each as one of the design."""
    found: dict[str, Any] = {}
    if design.mixing is not None or design.camera.sensitivity is None:  # else spectra give it
        matrix = design.mixing_matrix[:, list(columns)].tolist()
        found[MIXING] = base.mixing if matrix == base.mixing_matrix.tolist() else matrix
    for name in PER_GROUP:
        values = getattr(design.optics, name)
        if values is not None and len(values) > 1:
            found[f"optics.{name}"] = [values[column] for column in columns]
    return found


def _number(path: str) -> int | None:
    """Number of the group that a field belongs to, if it belongs to one."""
    start = f"{GROUPS}."
    word = path.removeprefix(start).partition(".")[0]
    return int(word) if path.startswith(start) and word.isdigit() else None


def _moved(path: str, number: int, to: int) -> str:
    return path.replace(f"{GROUPS}.{number}.", f"{GROUPS}.{to}.", 1)
