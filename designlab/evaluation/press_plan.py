"""The press plan states where and how hard an evaluation presses: the same for all designs compared."""

import math
from collections.abc import Mapping
from itertools import product
from typing import Any, NamedTuple, Self

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, ValidationError, model_serializer, model_validator

from designlab.core.types import Array
from designlab.evaluation.protocol import sub_seed
from designlab.sensor.contact import KernelContact
from designlab.sensor.design import Design, InfeasibleDesign
from designlab.sensor.field_errors import explain
from designlab.sensor.sensing_area import SensingArea, Shape
from designlab.simulation.contact.press import Direction, Press
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
    area_shape : {"rectangle", "ellipse"}
        Shape of that area; width and height are the full axes of an ellipse.
    direction : {"axis", "normal"}
        Whether probes are pressed along the sensor's axis or along the normal of each membrane.
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
    area_shape: Shape = "rectangle"
    """Shape of that area; width and height are the full axes of an ellipse."""
    direction: Direction = "axis"
    """Whether probes are pressed along the sensor's axis or along the normal of each membrane."""
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

    @model_serializer(mode="wrap")
    def _as_on_record(self, written: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """What is stated; plans on record state neither a rectangle nor a direction."""
        content: dict[str, Any] = written(self)
        usual = {"area_shape": "rectangle", "direction": "axis"}
        return {name: value for name, value in content.items() if usual.get(name) != value}

    @classmethod
    def of(
        cls,
        *designs: Design,
        direction: Direction = "axis",
        depth_mm: float | None = None,
        force_n: float | None = None,
    ) -> Self:
        """Plan the presses that some designs share.

        Parameters
        ----------
        *designs : Design
            What is compared; presses lie within the sensing area of each.
        direction : {"axis", "normal"}
            Along which probes are pressed.
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
        # The ellipse lies in every rectangle that is no smaller, not the other way round.
        round_one = any(d.sensing_area_shape == "ellipse" for d in designs)
        shape: Shape = "ellipse" if round_one else "rectangle"
        return cls.on(
            (width, height), area_shape=shape, direction=direction, depth_mm=depth_mm, force_n=force_n
        )

    @classmethod
    def on(
        cls,
        area_mm: tuple[float, float],
        *,
        area_shape: Shape = "rectangle",
        direction: Direction = "axis",
        depth_mm: float | None = None,
        force_n: float | None = None,
    ) -> Self:
        """Plan presses in an area; direction, depth, force and errors as in `of`."""
        strength = {"depth_mm": depth_mm, "force_n": force_n}
        stated = {name: value for name, value in strength.items() if value is not None}
        try:
            return cls.model_validate(
                {"area_mm": area_mm, "area_shape": area_shape, "direction": direction, **stated}
            )
        except ValidationError as error:
            raise ValueError(f"presses: {explain(error)}") from None

    @property
    def area(self) -> SensingArea:
        """The area in which presses are made."""
        return SensingArea(*self.area_mm, self.area_shape)

    @property
    def scale(self) -> float:
        """Size of probes, relative to their full one: small areas get small probes."""
        return _scale(*self.area_mm)

    def presses(self, *, rounds: int, seed: int, grids: int = 1) -> Presses:
        """Choose places: calibration balls on jittered 3 x 3 grids, test probes anywhere and at any angle."""
        random = np.random.default_rng(sub_seed(seed, 0, 0))
        balls = []
        for number, (grid, row, column) in enumerate(product(range(grids), (-1, 0, 1), (-1, 0, 1))):
            jitter = random.uniform(-0.04, 0.04, size=2)
            centre = self._place(0.3 * column + jitter[0], 0.28 * row + jitter[1])
            # each row and column of a grid has every size, each grid another at each place
            diameter_mm = BALLS_MM[(column + row + grid + 2) % 3]
            ball = self.press(f"sphere:{diameter_mm * self.scale:.6g}", BALL_SHARES[number % 2], centre)
            balls.append(ball if self.area_shape == "rectangle" else _moved_into(ball, self.area))
        tests = []
        for number in range(rounds):
            # The first round does not depend on how many follow.
            draw = np.random.default_rng(sub_seed(seed, 9, number))
            for text in TEST_PROBES:
                kind, size = text.split(":")
                centre = self._place(draw.uniform(-0.22, 0.22), draw.uniform(-0.2, 0.2))
                probe = f"{kind}:{float(size) * self.scale:.6g}"
                press = self.press(probe, TEST_SHARE, centre, yaw_deg=draw.uniform(-180.0, 180.0))
                tests.append(_moved_into(press, self.area))
        return Presses(tuple(balls), tuple(tests))

    def _place(self, across: float, along: float) -> tuple[float, float]:
        """A place (mm) of the area by its place in a square of side 1 around the origin."""
        if self.area_shape == "ellipse":  # the square's concentric squares become ellipses
            across, along = (
                across * math.sqrt(1 - 2 * along**2),
                along * math.sqrt(1 - 2 * across**2),
            )
        return across * self.area_mm[0], along * self.area_mm[1]

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
            direction=self.direction,
            yaw_deg=yaw_deg,
        )

    def broken(self, design: Design) -> dict[str, float]:
        """`PRESS_RULES` that a design breaks, and by how much (mm)."""
        own, area = self.area, design.sensing_area
        beyond = max(own.width_mm - area.width_mm, own.height_mm - area.height_mm)
        if area.shape == "ellipse" and own.shape == "rectangle":  # its corners must lie in the ellipse
            corner = math.hypot(own.width_mm / area.width_mm, own.height_mm / area.height_mm)
            beyond = max(beyond, (corner - 1) * min(self.area_mm))
        found = {
            "press_area": beyond,
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
        got = {
            "press_area": f"presses take {self.area}, the sensing area is {design.sensing_area}",
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
        along = "" if self.direction == "axis" else ", along the normal"
        size = "" if self.scale == 1 else f", probes at {100 * self.scale:.3g} % of their full size"
        tests = f"{TEST_SHARE * self.strength:.3g} {unit}"
        return f"balls {balls} {unit}, test probes {tests}, on {self.area}{along}{size}"


def _usual_depth_mm(given: Mapping[str, Any]) -> float | None:
    if given.get("force_n") is not None:
        return None
    width, height = given.get("area_mm", (FULL_SIZE_MM, FULL_SIZE_MM))  # another error is reported
    return round(DEPTH_MM * _scale(width, height), 6)


def _scale(width_mm: float, height_mm: float) -> float:
    return min(1.0, min(width_mm, height_mm) / FULL_SIZE_MM)


def _moved_into(press: Press, area: SensingArea) -> Press:
    """The press, moved so that it ends within an area around the origin: a picture's border is no contact."""
    reach = 1.6 * press.probe.size_mm
    x, y = np.meshgrid(*2 * [np.linspace(-reach, reach, 161)])
    # How deep a force goes depends on the gel; then the whole probe counts.
    touches = profile_mm(press.probe, x, y) > (-np.inf if press.depth_mm is None else -press.depth_mm)
    yaw = np.radians(press.yaw_deg)
    across = np.cos(yaw) * x[touches] - np.sin(yaw) * y[touches]
    along = np.sin(yaw) * x[touches] + np.cos(yaw) * y[touches]
    if area.shape == "ellipse":
        return press.model_copy(update={"centre_mm": _towards_middle(press.centre_mm, across, along, area)})
    centre = []
    sides = area.width_mm, area.height_mm
    for place, extent, side in zip(press.centre_mm, (across, along), sides, strict=True):
        furthest = max(side / 2 - RIM_MM - float(np.abs(extent).max()), 0.0)
        centre.append(float(np.clip(place, -furthest, furthest)))
    return press.model_copy(update={"centre_mm": (centre[0], centre[1])})


def _towards_middle(
    centre_mm: tuple[float, float], across: Array, along: Array, area: SensingArea
) -> tuple[float, float]:
    """Where a press goes, on the way to the middle, until its contact lies within an ellipse.

    `across` and `along` are the points of the contact (mm) from its centre. In units of the half axes each
    point p leaves the unit circle where |s c + p| = 1, for a centre s c; the first to do so decides s.
    """
    half = np.maximum(np.array([area.width_mm, area.height_mm]) / 2 - RIM_MM, 1e-6)
    centre, points = np.array(centre_mm) / half, np.stack([across, along], axis=-1) / half
    far, ahead, room = centre @ centre, points @ centre, 1.0 - (points * points).sum(axis=-1)
    if far == 0.0 or room.min() <= 0.0:
        return (0.0, 0.0)
    share = min(float(((np.sqrt(ahead**2 + far * room) - ahead) / far).min()), 1.0)
    return (share * centre_mm[0], share * centre_mm[1])
