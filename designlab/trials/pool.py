"""Which sets a pool holds: designs, what is hidden in each, seeds."""

from collections.abc import Mapping
from dataclasses import dataclass, field

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
POWER_SEED = 10_000


@dataclass(frozen=True)
class Trial:
    """One set: a design, the effects hidden in it by strength, kinds outside the catalogue, and its seed.

    `without` names effects that are taken out of the catalogue before the set is diagnosed.
    """

    name: str
    design: str
    seed: int
    effects: Mapping[str, float] = field(default_factory=dict)
    outside: Mapping[str, float] = field(default_factory=dict)
    kit_seed: int = KIT_SEED
    without: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """What is hidden, in one word."""
        return "+".join([*self.effects, *self.outside]) or "nothing"


def power(*, base: int = 0) -> list[Trial]:
    """Sets of each kind of effect at rising strengths on both designs, for detection limits.

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
                found.append(Trial(name, design, seed, {kind: strength}))
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
