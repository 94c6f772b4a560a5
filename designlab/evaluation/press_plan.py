"""The press plan states where and how hard an evaluation presses: the same for all designs compared."""

from collections.abc import Mapping
from itertools import product
from typing import Any, NamedTuple, Self

import numpy as np
from pydantic import Field, ValidationError, model_validator

from designlab.evaluation.protocol import sub_seed
from designlab.sensor.contact import KernelContact
from designlab.sensor.design import Design, InfeasibleDesign
from designlab.sensor.field_errors import explain
from designlab.simulation.contact.press import Press
from geometries.probes import parse, profile_mm
from geometries.spec import Spec, quantity

DEPTH_MM = 0.8
"""Depth of the deepest press where none is stated; as probes do, it shrinks with small sensing areas."""
FULL_SIZE_MM = 12.0
"""Shorter side of the sensing area from which on probes have their full size."""
LEFT_MM = 0.01  # of the gel under the deepest press: a probe that meets the core is no sensor's press
RIM_MM = 1.0  # around a contact the membrane is still lifted
# A small ball shows steep slopes, a large one many of each; depths as shares of the deepest.
BALLS_MM, BALL_SHARES = (6.0, 4.0, 3.0), (1.0, 0.6)
TEST_PROBES = ("sphere:4", "triangle:5", "star:6", "cylinder:4", "cone:4", "dots:1.5")
# Errors grow steeply with depth: one depth for all test presses keeps their choice from deciding the score.
TEST_SHARE = 0.7

PRESS_RULES = {
    "press_area": "the sensing area holds the area in which presses are made",
    "press_depth": "the gel is thicker than the deepest press is deep",
}
"""What presses demand of a design."""


class Presses(NamedTuple):
    """Calibration balls and test presses."""

    calibration: tuple[Press, ...]
    test: tuple[Press, ...]


class PressPlan(Spec):
    """A plan of presses: how deep or with which force, and in which area, whatever design is pressed.

    Parameters
    ----------
    area_mm : tuple of two float
        Width and height in mm of the area around the origin in which presses are made.
    force_n : float, optional
        Force of the strongest calibration press in N, for elastic gels; the others have shares of it.
    depth_mm : float, optional
        Depth of the deepest calibration press in mm; the others have shares of it. Where neither is stated
        0.8, less as probes get smaller.

    Raises
    ------
    pydantic.ValidationError
        If a value is out of its bounds, or depth and force are both stated.
    """

    area_mm: tuple[float, float]
    """Width and height of the area in which presses are made, centred on the membrane (mm)."""
    force_n: float | None = quantity(None, unit="N", gt=0, le=1000)
    """Force of the strongest calibration press, for elastic gels; every second one has 0.6 of it, test
    presses have 0.7."""
    depth_mm: float | None = Field(
        default_factory=lambda given: _usual_depth_mm(given),
        validate_default=True,
        gt=0,
        le=20,
        json_schema_extra={"unit": "mm"},
    )
    """Depth of the deepest calibration press; every second one has 0.6 of it, test presses have 0.7. Where
    neither it nor a force is stated 0.8, less where the area is small."""

    @model_validator(mode="after")
    def _an_area_and_one_strength(self) -> Self:
        if min(self.area_mm) <= 0.5 or max(self.area_mm) > 200:
            width, height = self.area_mm
            raise ValueError(f"area_mm: sides lie between 0.5 and 200 mm, got {width:g} x {height:g} mm")
        if (self.depth_mm is None) == (self.force_n is None):
            raise ValueError("depth_mm, force_n: state one of them, how deep or with which force")
        return self

    @classmethod
    def of(cls, *designs: Design, depth_mm: float | None = None, force_n: float | None = None) -> Self:
        """Plan the presses that some designs share.

        Parameters
        ----------
        *designs : Design
            What is compared; presses lie within the sensing area of each.
        depth_mm : float, optional
            Depth of the deepest press in mm; 0.8 mm when absent, less where probes are smaller than usual.
        force_n : float, optional
            Force of the strongest press in N instead.

        Raises
        ------
        ValueError
            If depth or force is out of its bounds, or both are given.
        """
        width, height = (min(sides) for sides in zip(*(d.sensing_area_mm for d in designs), strict=True))
        return cls.on((width, height), depth_mm=depth_mm, force_n=force_n)

    @classmethod
    def on(
        cls, area_mm: tuple[float, float], *, depth_mm: float | None = None, force_n: float | None = None
    ) -> Self:
        """Plan presses in an area; depth, force and errors as in `of`."""
        strength = {"depth_mm": depth_mm, "force_n": force_n}
        stated = {name: value for name, value in strength.items() if value is not None}
        try:
            return cls.model_validate({"area_mm": area_mm, **stated})
        except ValidationError as error:
            raise ValueError(f"presses: {explain(error)}") from None

    @property
    def scale(self) -> float:
        """Size of probes, relative to their full one: small areas get small probes."""
        return _scale(*self.area_mm)

    def presses(self, *, rounds: int, seed: int, grids: int = 1) -> Presses:
        """Choose places: calibration balls on jittered 3 x 3 grids, test probes anywhere and at any angle."""
        random = np.random.default_rng(sub_seed(seed, 0, 0))
        width, height = self.area_mm
        balls = []
        for number, (grid, row, column) in enumerate(product(range(grids), (-1, 0, 1), (-1, 0, 1))):
            jitter = random.uniform(-0.04, 0.04, size=2)
            centre = ((0.3 * column + jitter[0]) * width, (0.28 * row + jitter[1]) * height)
            # each row and column of a grid has every size, each grid another at each place
            diameter_mm = BALLS_MM[(column + row + grid + 2) % 3]
            balls.append(
                self.press(f"sphere:{diameter_mm * self.scale:.6g}", BALL_SHARES[number % 2], centre)
            )
        tests = []
        for number in range(rounds):
            # The first round does not depend on how many follow.
            draw = np.random.default_rng(sub_seed(seed, 9, number))
            for text in TEST_PROBES:
                kind, size = text.split(":")
                centre = (draw.uniform(-0.22, 0.22) * width, draw.uniform(-0.2, 0.2) * height)
                probe = f"{kind}:{float(size) * self.scale:.6g}"
                press = self.press(probe, TEST_SHARE, centre, yaw_deg=draw.uniform(-180.0, 180.0))
                tests.append(_moved_into(press, self.area_mm))
        return Presses(tuple(balls), tuple(tests))

    @property
    def strength(self) -> float:
        """Depth (mm) of the deepest, or force (N) of the strongest press, whichever is stated."""
        stated = self.force_n if self.depth_mm is None else self.depth_mm
        assert stated is not None  # one of them is
        return stated

    def press(
        self, probe: str, share: float, centre_mm: tuple[float, float] = (0.0, 0.0), *, yaw_deg: float = 0.0
    ) -> Press:
        """A press with a share of the largest depth or force."""
        by_force = self.depth_mm is None
        return Press(
            probe=parse(probe),
            depth_mm=None if by_force else share * self.strength,
            force_n=share * self.strength if by_force else None,
            centre_mm=centre_mm,
            yaw_deg=yaw_deg,
        )

    def broken(self, design: Design) -> dict[str, float]:
        """`PRESS_RULES` that a design breaks, and by how much (mm)."""
        found = {
            "press_area": max(
                own - side for own, side in zip(self.area_mm, design.sensing_area_mm, strict=True)
            ),
            "press_depth": (self.depth_mm or 0.0) + LEFT_MM - design.elastomer.thickness_mm,
        }
        return {rule: by for rule, by in found.items() if by > 0}

    def require_possible(self, design: Design) -> None:
        """Raise `InfeasibleDesign` unless a design takes the presses, as far as is known before."""
        if self.force_n is not None and isinstance(design.contact, KernelContact):
            raise InfeasibleDesign(
                f"design {design.name!r} is infeasible for these presses: force_n: needs an elastic gel, "
                "contact.model is 'kernel', which knows no force"
            )
        if not (broken := self.broken(design)):
            return
        width, height = self.area_mm
        got = {
            "press_area": f"presses take {width:g} x {height:g} mm",
            "press_depth": f"presses are up to {self.depth_mm or 0.0:g} mm deep, "
            f"elastomer.thickness_mm is {design.elastomer.thickness_mm:g}",
        }
        reasons = "; ".join(f"{rule}: {PRESS_RULES[rule]}, {got[rule]}" for rule in broken)
        raise InfeasibleDesign(f"design {design.name!r} is infeasible for these presses: {reasons}", broken)

    def to_json(self) -> dict[str, Any]:
        """Return what is stated as plain data."""
        return self.model_dump(mode="json", exclude_none=True)

    def text(self) -> str:
        """Say the presses in words."""
        unit = "N" if self.depth_mm is None else "mm deep"
        balls = " and ".join(f"{share * self.strength:.3g}" for share in BALL_SHARES)
        area = " x ".join(f"{side:.4g}" for side in self.area_mm)
        size = "" if self.scale == 1 else f", probes at {100 * self.scale:.3g} % of their full size"
        return (
            f"balls {balls} {unit}, test probes {TEST_SHARE * self.strength:.3g} {unit}, on {area} mm{size}"
        )


def _usual_depth_mm(given: Mapping[str, Any]) -> float | None:
    if given.get("force_n") is not None:
        return None
    width, height = given.get("area_mm", (FULL_SIZE_MM, FULL_SIZE_MM))  # another error is reported
    return round(DEPTH_MM * _scale(width, height), 6)


def _scale(width_mm: float, height_mm: float) -> float:
    return min(1.0, min(width_mm, height_mm) / FULL_SIZE_MM)


def _moved_into(press: Press, area_mm: tuple[float, float]) -> Press:
    """The press, moved so that it ends within an area around the origin: a picture's border is no contact."""
    reach = 1.6 * press.probe.size_mm
    x, y = np.meshgrid(*2 * [np.linspace(-reach, reach, 161)])
    # How deep a force goes depends on the gel; then the whole probe counts.
    touches = profile_mm(press.probe, x, y) > (-np.inf if press.depth_mm is None else -press.depth_mm)
    yaw = np.radians(press.yaw_deg)
    across = np.cos(yaw) * x[touches] - np.sin(yaw) * y[touches]
    along = np.sin(yaw) * x[touches] + np.cos(yaw) * y[touches]
    centre = []
    for place, extent, side in zip(press.centre_mm, (across, along), area_mm, strict=True):
        furthest = max(side / 2 - RIM_MM - float(np.abs(extent).max()), 0.0)
        centre.append(float(np.clip(place, -furthest, furthest)))
    return press.model_copy(update={"centre_mm": (centre[0], centre[1])})
