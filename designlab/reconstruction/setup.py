"""What is fixed of a lab's sensor before anything is fitted to its pictures."""

import math
from typing import Literal, NamedTuple

from designlab.reconstruction.balls import BallPress
from designlab.reconstruction.height import Boundary


class Setup(NamedTuple):
    """What is fixed by the lab and the physics, not by fitting.

    Attributes
    ----------
    ball_radius_mm, mm_per_px : float
        Ball, of those that state no radius of their own, and scale of the pictures at the membrane.
    detail : float
        Height finer than this share of the balls' mean contact radius (the standard deviation of a Gaussian)
        is taken from a second map, which is taught almost the whole contact circle; 0 does without. See
        `LabCalibration`.
    flat_beyond : float
        From this many contact radii on the membrane counts as flat.
    smoothing_px : float
        Gaussian smoothing of the colour change, against grain and the blocks of compressed video.
    boundary : str
        Of the integration, see `integrate`.
    thickness_mm : float, optional
        Thickness of the gel. What is absent is fitted to the balls, see `known_gel`.
    label_bias : float, optional
        By how much more than the contact the circles measure that were read off, as a share of it.
    poisson : float
        Poisson's ratio of the gel; silicones have little less than 0.5.
    weighted : bool
        Weigh each pixel in the integration by the inverse of its expected error, which is learned from balls
        left out of the calibration.
    skin_mm : float
        How far the coating rounds what the gel is pressed to (standard deviation of a Gaussian).
    relative_to : str
        What changes of colour are shares of: the ``mean`` of the untouched gel, or the untouched gel at the
        same ``place``, which is noisier in dark corners and takes off what uneven light does to all slopes.
    """

    ball_radius_mm: float
    mm_per_px: float
    detail: float = 0.5
    flat_beyond: float = 2.5
    smoothing_px: float = 2.0
    boundary: Boundary = "dirichlet"
    weighted: bool = True
    thickness_mm: float | None = None
    label_bias: float | None = None
    poisson: float = 0.49
    skin_mm: float = 0.0
    relative_to: Literal["mean", "place"] = "mean"

    def radius_mm(self, ball: BallPress) -> float:
        """Radius of a ball."""
        return self.ball_radius_mm if ball.radius_mm is None else ball.radius_mm

    def radius_px(self, ball: BallPress) -> float:
        """Radius of a ball in pixels."""
        return self.radius_mm(ball) / self.mm_per_px

    def contact_radius_px(self, ball: BallPress) -> float:
        """Radius within which the gel touches the ball: of the circle read off, less its bias."""
        return ball.contact_radius_px / (1 + (self.label_bias or 0.0))


def require_possible(setup: Setup) -> None:
    """Refuse lengths, bias and Poisson's ratio that no gel has, by name."""
    for name in ("ball_radius_mm", "mm_per_px", "thickness_mm"):
        value = getattr(setup, name)
        if value is not None and not 0 < value < math.inf:
            raise ValueError(f"{name}: must be above 0 mm and finite, got {value:g}")
    if setup.label_bias is not None and not -0.5 < setup.label_bias < 1:
        raise ValueError(f"label_bias: must lie between -0.5 and 1, got {setup.label_bias:g}")
    if not 0 < setup.poisson <= 0.5:
        raise ValueError(f"poisson: must lie above 0 and be at most 0.5, got {setup.poisson:g}")
