"""The press plan states where and how hard an evaluation presses: the same for all designs compared."""

from collections.abc import Mapping
from itertools import product
from typing import Any, NamedTuple, Self

import numpy as np
from pydantic import Field, ValidationError, model_validator

from designlab.evaluation.protocol import sub_seed
from designlab.sensor.design import Design, InfeasibleDesign, explain
from designlab.simulation.contact.press import Press
from geometries.probes import parse, profile_mm
from geometries.spec import Spec

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
    """A plan of presses: how deep and in which area, whatever design is pressed.

    Parameters
    ----------
    area_mm : tuple of two float
        Width and height in mm of the area around the origin in which presses are made.
    depth_mm : float
        Depth of the deepest calibration press in mm; the others have shares of it. Where absent 0.8, less as
        probes get smaller.

    Raises
    ------
    pydantic.ValidationError
        If a value is out of its bounds.
    """

    area_mm: tuple[float, float]
    """Width and height of the area in which presses are made, centred on the membrane (mm)."""
    depth_mm: float = Field(
        default_factory=lambda given: _usual_depth_mm(given),
        validate_default=True,
        gt=0,
        le=20,
        json_schema_extra={"unit": "mm"},
    )
    """Depth of the deepest calibration press; every second one has 0.6 of it, test presses have 0.7. When
    absent 0.8, less where the area is small."""

    @model_validator(mode="after")
    def _an_area(self) -> Self:
        if min(self.area_mm) <= 0.5 or max(self.area_mm) > 200:
            width, height = self.area_mm
            raise ValueError(f"area_mm: sides lie between 0.5 and 200 mm, got {width:g} x {height:g} mm")
        return self

    @classmethod
    def of(cls, *designs: Design, depth_mm: float | None = None) -> Self:
        """Plan the presses that some designs share.

        Parameters
        ----------
        *designs : Design
            What is compared; presses lie within the sensing area of each.
        depth_mm : float, optional
            Depth of the deepest press in mm; 0.8 mm when absent, less where probes are smaller than usual.

        Raises
        ------
        ValueError
            If the depth is out of its bounds.
        """
        width, height = (min(sides) for sides in zip(*(d.sensing_area_mm for d in designs), strict=True))
        return cls.on((width, height), depth_mm=depth_mm)

    @classmethod
    def on(cls, area_mm: tuple[float, float], *, depth_mm: float | None = None) -> Self:
        """Plan presses in an area; depth and errors as in `of`."""
        stated = {} if depth_mm is None else {"depth_mm": depth_mm}
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
                Press(
                    probe=parse(f"sphere:{diameter_mm * self.scale:.6g}"),
                    depth_mm=self.depth_mm * BALL_SHARES[number % 2],
                    centre_mm=centre,
                )
            )
        tests = []
        for number in range(rounds):
            # The first round does not depend on how many follow.
            draw = np.random.default_rng(sub_seed(seed, 9, number))
            for text in TEST_PROBES:
                kind, size = text.split(":")
                centre = (draw.uniform(-0.22, 0.22) * width, draw.uniform(-0.2, 0.2) * height)
                press = Press(
                    probe=parse(f"{kind}:{float(size) * self.scale:.6g}"),
                    depth_mm=self.depth_mm * TEST_SHARE,
                    centre_mm=centre,
                    yaw_deg=draw.uniform(-180.0, 180.0),
                )
                tests.append(_moved_into(press, self.area_mm))
        return Presses(tuple(balls), tuple(tests))

    def broken(self, design: Design) -> dict[str, float]:
        """`PRESS_RULES` that a design breaks, and by how much (mm)."""
        found = {
            "press_area": max(
                own - side for own, side in zip(self.area_mm, design.sensing_area_mm, strict=True)
            ),
            "press_depth": self.depth_mm + LEFT_MM - design.elastomer.thickness_mm,
        }
        return {rule: by for rule, by in found.items() if by > 0}

    def require_possible(self, design: Design) -> None:
        """Raise `InfeasibleDesign` unless a design takes the presses."""
        if not (broken := self.broken(design)):
            return
        width, height = self.area_mm
        got = {
            "press_area": f"presses take {width:g} x {height:g} mm",
            "press_depth": f"presses are up to {self.depth_mm:g} mm deep, "
            f"elastomer.thickness_mm is {design.elastomer.thickness_mm:g}",
        }
        reasons = "; ".join(f"{rule}: {PRESS_RULES[rule]}, {got[rule]}" for rule in broken)
        raise InfeasibleDesign(f"design {design.name!r} is infeasible for these presses: {reasons}", broken)

    def text(self) -> str:
        """Say the presses in words."""
        balls = " and ".join(f"{self.depth_mm * share:.3g}" for share in BALL_SHARES)
        area = " x ".join(f"{side:.4g}" for side in self.area_mm)
        size = "" if self.scale == 1 else f", probes at {self.scale:.3g} of their full size"
        return f"balls {balls} mm deep, test probes {self.depth_mm * TEST_SHARE:.3g} mm, on {area} mm{size}"


def _usual_depth_mm(given: Mapping[str, Any]) -> float:
    width, height = given.get("area_mm", (FULL_SIZE_MM, FULL_SIZE_MM))  # another error is reported
    return round(DEPTH_MM * _scale(width, height), 6)


def _scale(width_mm: float, height_mm: float) -> float:
    return min(1.0, min(width_mm, height_mm) / FULL_SIZE_MM)


def _moved_into(press: Press, area_mm: tuple[float, float]) -> Press:
    """The press, moved so that it ends within an area around the origin: a picture's border is no contact."""
    reach = 1.6 * press.probe.size_mm
    x, y = np.meshgrid(*2 * [np.linspace(-reach, reach, 161)])
    touches = profile_mm(press.probe, x, y) > -press.stated_depth_mm
    yaw = np.radians(press.yaw_deg)
    across = np.cos(yaw) * x[touches] - np.sin(yaw) * y[touches]
    along = np.sin(yaw) * x[touches] + np.cos(yaw) * y[touches]
    centre = []
    for place, extent, side in zip(press.centre_mm, (across, along), area_mm, strict=True):
        furthest = max(side / 2 - RIM_MM - float(np.abs(extent).max()), 0.0)
        centre.append(float(np.clip(place, -furthest, furthest)))
    return press.model_copy(update={"centre_mm": (centre[0], centre[1])})
