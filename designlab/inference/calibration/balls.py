"""A sensor calibrated on pictures of ball presses, with its errors on balls left out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from designlab.core.progress import Work, silent
from designlab.core.types import Array, Progress
from designlab.inference.calibration.ball_set import ENOUGH, BallSet
from designlab.inference.calibration.verdict import FitVerdict
from designlab.reconstruction.ball_samples import known_gel, smoothing_by
from designlab.reconstruction.balls import BallPress
from designlab.reconstruction.calibration_file import Kept
from designlab.reconstruction.centres import place_by_circles, refine_centres
from designlab.reconstruction.drift import Untouched, drift_between
from designlab.reconstruction.gel_fit import GelFit
from designlab.reconstruction.lab import LabCalibration, calibrate
from designlab.reconstruction.left_out import LeftOut, left_out_of_each, suited
from designlab.reconstruction.methods import Kernel, Method
from designlab.reconstruction.setup import Setup

COARSE = Kernel(ridge=3e-3, colour_scale=1.5, features=300)  # moves centres once more
NORMAL_DEG = (5.0, 10.0)  # error on balls left out: doubtful, failed
ROUNDS_RIMS_PX = 1.5  # smoothing from which a map of its own for the rims of contacts is tried
SPREAD_PX = 1.3  # contact radii around a ball whose colours it taught
TAUGHT = 4000  # samples of colour that are kept
STRANGE_QUANTILE, STRANGE_MARGIN = 0.995, 1.25
"""A colour is strange further from those taught than nearly all of a ball left out are, and this much."""
WORST_TIMES = 1.5  # error of a ball over the median from which it is called out


@dataclass(frozen=True, eq=False)
class BallCalibration:
    """A calibration on balls.

    Attributes
    ----------
    kept : Kept
        What the calibration file holds.
    balls : BallSet
        What it was made from, centres refined.
    errors : tuple of LeftOut
        Errors on each ball of a calibration on the others.
    gel : GelFit or None
        Fit of thickness and bias of the circles.
    """

    kept: Kept
    balls: BallSet
    errors: tuple[LeftOut, ...]
    gel: GelFit | None

    @property
    def mean(self) -> LeftOut:
        """Means over the balls."""
        return LeftOut(*(float(np.mean(values)) for values in zip(*self.errors, strict=True)))

    def verdict(self) -> FitVerdict:
        """Whether it is worth using, and why not."""
        reasons: list[tuple[bool, str]] = []
        if len(self.errors) < ENOUGH:
            reasons.append(
                (False, f"{len(self.errors)} balls teach little: press one at {ENOUGH} places or more")
            )
        error = self.mean.contact_deg
        if error > NORMAL_DEG[0]:
            reasons.append(
                (
                    error > NORMAL_DEG[1],
                    f"normals on balls left out are off by {error:.1f} deg: are the ball's diameter "
                    "(--ball-mm), the scale (--mm-per-px) and the circles right?",
                )
            )
        failed = [text for fails, text in reasons if fails]
        others = [text for fails, text in reasons if not fails]
        return FitVerdict("failed" if failed else "doubtful" if others else "good", (*failed, *others))

    def odd(self) -> list[tuple[str, LeftOut, str]]:
        """Balls that fit worst: file, errors, and the likely reason."""
        usual = float(np.median([one.contact_deg for one in self.errors]))
        found = []
        for file, ball, one in zip(self.balls.files, self.balls.balls, self.errors, strict=True):
            if one.contact_deg > WORST_TIMES * usual:
                found.append((file, one, _reason(ball)))
        return sorted(found, key=lambda row: -row[1].contact_deg)


def calibrate_balls(
    balls: BallSet,
    *,
    thickness_mm: float | None = None,
    poisson: float | None = None,
    skin_mm: float = 0.0,
    method: Method | None = None,
    progress: Progress = silent,
) -> BallCalibration:
    """Calibrate on balls, and measure the error on each by a calibration on the others.

    Parameters
    ----------
    balls : BallSet
        What `load_balls` read.
    thickness_mm, poisson : float, optional
        Of the gel, where they are known; the thickness is fitted, Poisson's ratio usual when absent.
    skin_mm : float
        How far the coating rounds what the gel is pressed to, where that is known, see `Setup`.
    method : Method, optional
        See `reconstruction.methods`. When absent, what errs least on the balls left out: smoothing by the
        pictures' noise with the kernel that suits it, or what serves most sensors. Where pictures are
        smoothed much, each is tried with a map of the rims of contacts and without.
    progress : callable, optional
        Called with what is being done, and how much of everything is done in thousandths.
    """
    parts = {"centres of the balls": 14, "gel": 4, "balls left out": 6, "calibration": 2}
    work = Work(progress, parts)
    setup = Setup(balls.radius_mm, balls.mm_per_px, thickness_mm=thickness_mm, skin_mm=skin_mm)
    if poisson is not None:
        setup = setup._replace(poisson=poisson)
    work.begin("centres of the balls")
    membrane = balls.membrane
    if membrane is not None:
        placed = place_by_circles(balls.balls, balls.background, setup, membrane)
    else:
        placed = refine_centres(balls.balls, balls.background, setup)
        placed = refine_centres(placed, balls.background, setup, method=COARSE, rounds=2)
    work.step(parts["centres of the balls"])
    work.begin("gel")
    known, setup, gel = known_gel(placed, balls.background, setup, membrane)
    work.step(parts["gel"])
    work.begin("balls left out")
    ways: list[tuple[Setup, Method]] = []
    if method is None:
        smoothing_px = smoothing_by(known, balls.background)
        by_noise, kernel = suited(
            known, balls.background, setup._replace(smoothing_px=smoothing_px), membrane=membrane
        )
        if smoothing_px >= ROUNDS_RIMS_PX:
            ways.append((by_noise, kernel))
        ways += [(setup, Kernel()), (setup._replace(detail=0.0), Kernel())]
        ways.append((by_noise._replace(detail=0.0), kernel))
    else:
        ways.append((setup, method))
    tried = []
    for each in ways:
        left_out = left_out_of_each(known, balls.background, each[0], method=each[1], membrane=membrane)
        tried.append((float(np.mean([error.contact_deg for error in left_out])), left_out, each))
        work.step(parts["balls left out"] / len(ways))
    _, errors, (setup, method) = min(tried, key=lambda one: one[0])
    work.begin("calibration")
    calibration = calibrate(known, balls.background, setup, method=method, membrane=membrane)
    work.end()
    mean = LeftOut(*(float(np.mean(values)) for values in zip(*errors, strict=True)))
    about = {
        "balls": len(known),
        "ball_mm": 2 * balls.radius_mm,
        "normal_error_deg": mean.contact_deg,
        "height_error_um": 1000 * mean.height_mm,
        **({} if balls.markers is None else {"markers": balls.markers.plain()}),
    }
    kept = kept_of(calibration, known, about)._replace(membrane=membrane)
    return BallCalibration(kept, balls._replace(balls=known), tuple(errors), gel)


def kept_of(calibration: LabCalibration, balls: Sequence[BallPress], about: Mapping[str, Any]) -> Kept:
    """What a file holds of a calibration on balls: also their colours, and how their pictures differ from it.

    Parameters
    ----------
    calibration : LabCalibration
        Made from the balls.
    balls : sequence of BallPress
        At least two.
    about : mapping
        Plain data about it.
    """
    taught = [_taught(calibration, ball) for ball in balls]
    told = {
        **about,
        "strange_beyond": _strange_beyond(taught),
        "usual_gain": _usual_gain(balls, calibration.background),
    }
    return Kept(calibration, np.concatenate(taught), told)


def _taught(calibration: LabCalibration, ball: BallPress) -> Array:
    """Changes of colour on and around a ball, thinned."""
    rows, columns = np.indices(calibration.background.shape[:2])
    near = np.hypot(columns - ball.centre_px[0], rows - ball.centre_px[1])
    shown = near < SPREAD_PX * ball.contact_radius_px
    if ball.covered is not None:
        shown &= ~ball.covered
    change = calibration.change(ball.image)[shown]
    return np.asarray(change[:: max(1, len(change) * 16 // TAUGHT)])


def _strange_beyond(taught: Sequence[Array]) -> float:
    """Distance from all colours taught beyond which a colour is strange, by balls left out in turn."""
    far = []
    for number, own in enumerate(taught):
        others = np.concatenate([*taught[:number], *taught[number + 1 :]])
        far.append(cKDTree(others).query(own)[0])
    return STRANGE_MARGIN * float(np.quantile(np.concatenate(far), STRANGE_QUANTILE))


def _usual_gain(balls: Sequence[BallPress], background: Array) -> list[float]:
    """Brightness of the gel beside the balls over that of the untouched gel, which the maps have learned."""
    untouched = Untouched.of(background)
    found = [drift_between(untouched, np.asarray(ball.image, dtype=float), place=False) for ball in balls]
    known = [each.gain for each in found if each.known]
    return [float(value) for value in np.median(known, axis=0)] if known else [1.0] * background.shape[-1]


def _reason(ball: BallPress) -> str:
    """Why a ball may fit badly, as far as its picture tells."""
    rows, columns = ball.image.shape[:2]
    column, row = ball.centre_px
    reach = 2 * ball.contact_radius_px
    if min(column, row, columns - 1 - column, rows - 1 - row) < reach:
        return "it lies at the edge of the picture"
    if (ball.image >= 1.0).any(axis=-1).mean() > 0.001:
        return "parts of the picture are at full scale"
    return "its circle may be off, or light there differs from that of the other balls"
