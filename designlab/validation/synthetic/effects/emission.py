"""Effects of the LEDs: where they stand, how much, how narrowly and whereto they shine."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.validation.synthetic.effects.base import Planted, PlantedParameter
from designlab.validation.synthetic.generator_sensor import Rectangles, Rig


def _bonded(rig: Rig) -> bool:
    """Whether the LEDs are glued to the core, so that they only slide along it."""
    return rig.glass is not None and rig.glass.bonded


def _position_parameters(rig: Rig) -> dict[str, PlantedParameter]:
    free = ("height", "tangential") if _bonded(rig) else ("radial", "height", "tangential")
    return {f"{axis}_mm": PlantedParameter(0.0, 0.5, -3.0, 3.0, "mm") for axis in free}


def _move(rig: Rig, values: Mapping[str, float]) -> Rig:
    """Move every package in the cylindrical frame of its row: outwards, up, counter-clockwise."""

    def moved(rectangles: Rectangles) -> Rectangles:
        around = rectangles.across
        outwards = np.stack([around[:, 1], -around[:, 0], np.zeros(len(around))], axis=1)
        up = np.array([0.0, 0.0, values["height_mm"]])
        shift = values.get("radial_mm", 0.0) * outwards + values["tangential_mm"] * around + up
        return rectangles._replace(centre=rectangles.centre + shift)

    return replace(rig, emitters=moved(rig.emitters), boards=moved(rig.boards))


def _spread_parameters(rig: Rig) -> dict[str, PlantedParameter]:
    """All faces of a group but the last, which makes up for them: their sum is the group's own flux."""
    faces = np.bincount(rig.emitters.group, minlength=len(rig.group_names))
    return {
        f"{name}_{number}": PlantedParameter(0.0, 0.12, -1.0, 1.0)
        for name, count in zip(rig.group_names, faces, strict=True)
        for number in range(1, count)
    }


def _spread(rig: Rig, values: Mapping[str, float]) -> Rig:
    """Move flux between the faces of each group."""
    flux, area = rig.face_flux.copy(), rig.emitters.half.prod(axis=1)
    for group, name in enumerate(rig.group_names):
        *others, last = np.flatnonzero(rig.emitters.group == group)
        moved = np.array([values[f"{name}_{number}"] for number in range(1, len(others) + 1)])
        flux[others] *= 1 + moved
        flux[last] -= float(moved @ (rig.face_flux * area)[others]) / area[last]
    return replace(rig, face_flux=flux)


def _profile_parameters(rig: Rig) -> dict[str, PlantedParameter]:
    return {
        f"{name}_exponent": PlantedParameter(
            float(exponent), 0.3, min(0.3, float(exponent)), max(20.0, float(exponent))
        )
        for name, exponent in zip(rig.group_names, rig.exponent, strict=True)
    }


def _profile(rig: Rig, values: Mapping[str, float]) -> Rig:
    return replace(rig, exponent=np.array([values[f"{name}_exponent"] for name in rig.group_names]))


def _tilt_parameters(rig: Rig) -> dict[str, PlantedParameter]:
    if _bonded(rig):
        return {}
    return {
        f"{name}_{way}_deg": PlantedParameter(0.0, 3.0, -20.0, 20.0, "deg")
        for name in _joined_names(rig).values()
        for way in ("tilt", "turn")
    }


def _joined_names(rig: Rig) -> dict[tuple[int, ...], str]:
    """Name of every set of groups that turn together, since they share boards."""
    return {groups: "_".join(rig.group_names[g] for g in groups) for groups in rig.joined}


def _tilt(rig: Rig, values: Mapping[str, float]) -> Rig:
    """Turn every package about the middle of its front: towards the membrane, and about its own up."""
    if not values:
        return rig
    boards, faces = rig.boards, rig.emitters
    of_group = {group: name for groups, name in _joined_names(rig).items() for group in groups}
    names = [of_group[group] for group in boards.group.tolist()]
    tilt, turn = (np.array([values[f"{name}_{way}_deg"] for name in names]) for way in ("tilt", "turn"))

    def turned(vector: Array, board: NDArray[np.int64]) -> Array:
        # About `across` the normal goes towards `down`; (across, down, normal) is right-handed, so that this
        # is a turn by the negative angle.
        tilted = _about(boards.across[board], vector, -tilt[board])
        return _about(-boards.down[board], tilted, turn[board])

    def axes(part: Rectangles, board: NDArray[np.int64]) -> Rectangles:
        return part._replace(
            normal=turned(part.normal, board),
            across=turned(part.across, board),
            down=turned(part.down, board),
        )

    every, own = np.arange(len(names)), rig.carrier
    centre = boards.centre[own] + turned(faces.centre - boards.centre[own], own)
    return replace(rig, boards=axes(boards, every), emitters=axes(faces, own)._replace(centre=centre))


def _about(axis: Array, vector: Array, angle_deg: Array) -> Array:
    """Turn vectors (n, 3) about unit axes (n, 3), counter-clockwise seen from their tips (Rodrigues)."""
    angle = np.radians(angle_deg)[:, None]
    along = (axis * vector).sum(axis=1, keepdims=True) * axis
    return np.asarray(along + np.cos(angle) * (vector - along) + np.sin(angle) * np.cross(axis, vector))


EMISSION = {
    "led_position": Planted(_position_parameters, _move),
    "led_spread": Planted(_spread_parameters, _spread),
    "led_profile": Planted(_profile_parameters, _profile),
    "led_tilt": Planted(_tilt_parameters, _tilt),
}
