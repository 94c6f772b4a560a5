"""A pool is a list of measurement sets: designs, what is hidden in each, and seeds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from designlab.core.store import digest
from designlab.measurement import Measurement
from designlab.measurement.frames import MeasuredFrame
from designlab.validation.synthetic.capture_plan import FURTHER

AIR = ("gelsight-2020-flat", "gelsight-2020-dome")
CORE = ("gelsight-2020-flat-core", "gelsight-2020-dome-core")
OF_CORE = ("gelcore_index", "absorption", "core_scatter")
STRENGTHS = (0.0625, 0.125, 0.25, 0.5, 1.0, 2.0)  # of power curves, in prior standard deviations
MORE_KINDS = ("interreflection", "translucency", "depth_offset", "point_spread", "veiling_glare")
KINDS = (
    "black_level",
    "colour_mixing",
    "response_curve",
    "vignetting",
    "banding",
    "exposure_drift",
    "fixed_pattern",
    "lens_distortion",
    "camera_pose",
    "led_spread",
    "led_profile",
    "led_tilt",
    "led_position",
    "albedo_field",
    "specular_coat",
    "contact_kernel",
    "contact_profile",
)
OUTSIDE = ("printed_markers", "debris", "second_contact", "lens_ghost", "wrong_object", "jpeg_blocks")
KIT_SEED = 1
KITS = ("hour", "no_dark", "no_groups", "plain")
"""hour: all frames; no_dark, no_groups: without the dark frame, without those of single LED groups;
plain: without these, other exposures and the turned gel."""
POWER_SEED = 10_000
SECOND_SEED = 5_000  # between the first and the second set of a strength
QUICK_SEED = 90_000


@dataclass(frozen=True)
class Trial:
    """One set: a design, the effects hidden in it by strength, kinds outside the catalogue, and its seed.

    `without` names effects that are taken out of the catalogue before the set is diagnosed, `kit` the frames
    that are used of it (see `KITS`), `further` are frames taken besides, `size` is small for pools that only
    show that all works, `dirt` says whether the sensor has a lab's dirt (see `synthetic.dirt`).
    """

    name: str
    design: str
    seed: int
    effects: Mapping[str, float] = field(default_factory=dict)
    outside: Mapping[str, float] = field(default_factory=dict)
    kit_seed: int = KIT_SEED
    without: tuple[str, ...] = ()
    kit: str = "hour"
    further: tuple[Mapping[str, Any], ...] = ()
    size: Literal["full", "small"] = "full"
    dirt: bool = False

    @property
    def label(self) -> str:
        """What tells it from all others."""
        kit = "" if self.kit == "hour" else f"-{self.kit}"
        return f"{self.set_label}{kit}"

    @property
    def set_label(self) -> str:
        """What tells its set from all others; kits share sets."""
        small = "-small" if self.size == "small" else ""
        further = f"-further-{digest(list(self.further))[:8]}" if self.further else ""
        return f"{self.name}-{self.seed}{small}{further}"

    @property
    def kind(self) -> str:
        """What is hidden, in one word."""
        return "+".join([*self.effects, *self.outside]) or "nothing"


def frames_of(measurement: Measurement, kit: str) -> Measurement:
    """Measurement with the frames that a kit has."""

    def kept(frame: MeasuredFrame) -> bool:
        if frame.file.startswith(FURTHER) or kit == "hour":
            return True
        dark = frame.kind == "dark"
        single = frame.kind == "background" and frame.leds is not None and len(frame.leds) == 1
        other = frame.exposure not in (None, 1.0) or frame.gel_rotation_deg not in (None, 0.0)
        dropped = {"no_dark": dark, "no_groups": single, "plain": dark or single or other}
        return not dropped[kit]

    return measurement.model_copy(
        update={"frames": tuple(frame for frame in measurement.frames if kept(frame))}
    )


def shard(pool: Sequence[Trial], text: str | None) -> list[Trial]:
    """Part of a pool, in an order by chance that is always the same: each part holds sets of all families.

    Parameters
    ----------
    text : str, optional
        ``k/n`` for the k-th of n parts; the whole pool when absent.

    Raises
    ------
    ValueError
        If `text` names no part.
    """
    if text is None:
        return list(pool)
    part, slash, parts = text.partition("/")
    if not slash or not (part.isdigit() and parts.isdigit()) or not 1 <= int(part) <= int(parts):
        raise ValueError(f"--shard: must be K/N with K from 1 to N, got {text!r}")
    if int(parts) > len(pool):
        raise ValueError(f"--shard: the pool has {len(pool)} sets, got {text!r}")
    order = np.random.default_rng(0).permutation(len(pool))
    return [pool[number] for number in sorted(order[int(part) - 1 :: int(parts)])]


def power(*, base: int = 0) -> list[Trial]:
    """Sets of each kind of effect at rising strengths on both designs, for detection limits: two of each.

    Parameters
    ----------
    base : int
        Start of the seeds; another base gives other sets of the same kinds.
    """
    found = []
    for number, kind in enumerate([*KINDS, *MORE_KINDS]):
        for k, design in enumerate(AIR):
            for step, strength in enumerate(STRENGTHS):
                seed = base + POWER_SEED + 100 * number + 10 * k + step
                name = f"power-{kind}-{'flat' if k == 0 else 'dome'}-{strength:g}"
                found.append(Trial(f"{name}-a", design, seed, {kind: strength}))
                found.append(Trial(f"{name}-b", design, seed + SECOND_SEED, {kind: strength}))
    return found


def development(*, base: int = 0) -> list[Trial]:
    """Pool that may be looked at: 30 sets without an effect, 3 of each kind at one prior sd, 18 outside.

    Parameters
    ----------
    base : int
        Start of the seeds; another base gives other sets of the same kinds.
    """
    found = [Trial(f"nothing-{k:02d}", AIR[k % 2], base + k) for k in range(30)]
    for number, kind in enumerate([*KINDS, *OF_CORE]):
        designs = CORE if kind in OF_CORE else AIR
        for k in range(3):
            seed = base + 100 + 10 * number + k
            found.append(Trial(f"{kind}-{k}", designs[(number + k) % 2], seed, {kind: 1.0}))
    for number, kind in enumerate(OUTSIDE):
        for k in range(3):
            seed = base + 500 + 10 * number + k
            found.append(Trial(f"{kind}-{k}", AIR[(number + k) % 2], seed, outside={kind: 1.0}))
    return found


def quick() -> list[Trial]:
    """A few small sets with what must not fail: names of plain effects, and none where none belongs."""
    single = ("black_level", "colour_mixing", "vignetting")
    sets: list[tuple[str, dict[str, Any]]] = [("nothing", {})]
    sets += [(kind, {"effects": {kind: 1.0}}) for kind in single]
    sets += [
        ("debris", {"outside": {"debris": 1.0}}),
        ("left-out", {"effects": {"colour_mixing": 2.0}, "without": ("colour_mixing",)}),
    ]
    return [
        Trial(f"quick-{name}", AIR[0], QUICK_SEED + number, size="small", **hidden)
        for number, (name, hidden) in enumerate(sets)
    ]
