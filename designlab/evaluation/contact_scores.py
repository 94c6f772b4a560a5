"""Contact scores say what an elastic gel does to touch: its force, and how deep and how finely it is told.

They exist for designs with an elastic gel. Force and depth of a stated ball follow from the contact alone;
saturation and lateral resolution need pictures of presses of their own.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.special import ndtri

from designlab.core.types import Array
from designlab.evaluation.illumination_scores import SCORES, Estimate, Scores
from designlab.evaluation.press_plan import LEFT_MM
from designlab.evaluation.protocol import EvaluationProtocol, Reconstruction, error_region
from designlab.evaluation.response_maps import signal_of, thinned
from designlab.mechanics.contact import NotConverged
from designlab.reconstruction import KernelCalibration
from designlab.sensor.contact import LayerContact
from designlab.sensor.design import Design
from designlab.simulation import imaging
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from designlab.simulation.contact.surface import Mechanics
from designlab.simulation.imaging import Capture
from designlab.simulation.simulator import Frame
from geometries.probes import Probe, parse

BALL, BALL_DEPTH_MM, BALL_FORCE_N = "sphere:4", 0.5, 1.0
"""The ball whose force at a depth, and depth at a force, are scores: the same for every design."""
PITCHES_MM = (0.1, 0.05)  # at which that contact is solved; the finer counts, the other tells its error
ORDER = 2.0  # by how much the error falls from one to the other
STEP = 1.04  # between the depths from which the stiffness of a contact follows

LOST_SHARE = 0.05  # of the pixels on and around a contact, from which on slopes saturate a picture
DEEPEST = 0.95  # of the gel's thickness
PLACES = ((0.0, 0.0), (0.22, 0.2), (-0.22, -0.2))  # of the ball, as shares of the sensing area
HALVINGS = 4  # of a range of depths or, as often again, of the logarithm of bars' widths

BARS_DEPTH_MM = 0.25
DIP, SIGMAS = 0.2, 3.0  # of the height between two bars that are told apart: share of theirs, times its noise
PROBABILITY = 0.95  # with which they must be
DRAWS = 4  # of the camera's noise
WIDEST_MM = 1.5  # of bars that are looked at, less on small sensing areas
ACROSS, ALONG = 5, 9  # points at which the height of a stripe is looked at
TURNS_DEG = (0.0, 90.0)

OWN_PRESSES = ("saturation_depth_mm", "lateral_resolution_mm")
"""Scores that need pictures of presses of their own."""

CONTACT_SCORES = (
    "press_depth_mm",
    "force_at_depth_n",
    "depth_at_force_mm",
    "force_resolution_mn",
    *OWN_PRESSES,
)
"""Scores that not every design has."""

Picture = Callable[[Press], Frame]


def force_scores(design: Design, presses: Sequence[Reconstruction], height_rmse_um: Estimate) -> Scores:
    """Force and depth of the stated ball, and how finely reconstructed heights tell force.

    The standard errors of the first two are those of the grid; how well the gel's modulus is known is another
    matter (`designlab.sensor.gel_materials`). Force resolution is the error of height of each test press
    times the stiffness of its contact there, in the mean; it is as well known as the error of height.

    Parameters
    ----------
    design : Design
        The design.
    presses : sequence of Reconstruction
        The test presses.
    height_rmse_um : Estimate
        The score pooled from them.
    """
    if not isinstance(design.contact, LayerContact):
        return {}
    probe = parse(BALL)
    found: Scores = {}
    for name, press, of in (
        ("force_at_depth_n", Press(probe=probe, depth_mm=BALL_DEPTH_MM), _force_n),
        ("depth_at_force_mm", Press(probe=probe, force_n=BALL_FORCE_N), _depth_mm),
    ):
        try:
            coarse, fine = (of(_mechanics(design, press, pitch_mm)) for pitch_mm in PITCHES_MM)
        except (ValueError, NotConverged):  # the gel is too thin for the depth, or too soft for the force
            continue
        grid = abs(fine - coarse) / (ORDER - 1)
        found[name] = Estimate(fine, grid, SCORES[name], grid)
    errors_mn = [
        float(np.sqrt(np.mean(one.height_error_um**2))) * _stiffness_n_per_mm(design, one.frame)
        for one in presses
    ]
    value = float(np.mean(errors_mn))  # um times N/mm
    share = height_rmse_um.se / max(height_rmse_um.value, 1e-9)
    found["force_resolution_mn"] = Estimate(value, share * value, SCORES["force_resolution_mn"])
    return found


def _force_n(mechanics: Mechanics) -> float:
    return mechanics.force_n


def _depth_mm(mechanics: Mechanics) -> float:
    return mechanics.depth_mm


def _mechanics(design: Design, press: Press, pitch_mm: float) -> Mechanics:
    reach = 2 * press.probe.size_mm
    x_mm, y_mm = press.centre_mm
    area_mm = 2 * (abs(x_mm) + reach), 2 * (abs(y_mm) + reach)
    surface = indent(design.elastomer, design.contact, press, area_mm=area_mm, pitch_mm=pitch_mm)
    assert surface.mechanics is not None  # an elastic gel has them
    return surface.mechanics


def _stiffness_n_per_mm(design: Design, frame: Frame) -> float:
    """How force grows with depth at a press: the power is told on the coarser grid, the force is its own."""
    press, mechanics = frame.press, frame.surface.mechanics
    assert press is not None  # every test frame has one
    assert mechanics is not None
    depths = mechanics.depth_mm / STEP, mechanics.depth_mm
    low, high = (
        _mechanics(design, press.model_copy(update={"depth_mm": d, "force_n": None}), PITCHES_MM[0]).force_n
        for d in depths
    )
    return math.log(high / low) / math.log(STEP) * mechanics.force_n / mechanics.depth_mm


def saturation_depth(protocol: EvaluationProtocol, picture: Picture) -> Scores:
    """Depth of a ball from which on slopes saturate the picture of it.

    A pixel is lost where a channel is at full scale, or within three sigma of the camera's noise from black:
    there it no longer changes with slope. The depth is that at which 5 % of the pixels on and around the
    contact are lost; where it is never so many, the deepest that is tried, 0.95 of the gel's thickness or the
    ball's radius. Its standard error is that of the mean over three places, with the last step of the search.

    Parameters
    ----------
    protocol : EvaluationProtocol
        Camera and exposure.
    picture : callable
        Renders a press.
    """
    design, probe = protocol.design, parse(BALL)
    width, height = design.sensing_area_mm
    limit_mm = min(DEEPEST * design.elastomer.thickness_mm, probe.size_mm / 2)

    def excess(place: tuple[float, float], depth_mm: float) -> float:
        centre = (place[0] * width, place[1] * height)
        return _lost(protocol, picture(Press(probe=probe, depth_mm=depth_mm, centre_mm=centre))) - LOST_SHARE

    depths = [_crossing(partial(excess, place), limit_mm) for place in PLACES]
    name = "saturation_depth_mm"
    return {name: _mean(depths, limit_mm / 2**HALVINGS, name)}


def _mean(values: Sequence[float], step: float, name: str) -> Estimate:
    """Mean of values that were searched on one grid: the rounding to its last step is common to them."""
    scatter = float(np.std(values, ddof=1)) / math.sqrt(len(values))
    return Estimate(float(np.mean(values)), math.hypot(scatter, step / math.sqrt(12)), SCORES[name])


def _crossing(excess: Callable[[float], float], limit: float) -> float:
    """Where a growing function passes zero between 0 and a limit, by halving; the limit if nowhere."""
    if excess(limit) <= 0:
        return limit
    low, high = 0.0, limit
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if excess(middle) > 0 else (middle, high)
    return (low + high) / 2


def _lost(protocol: EvaluationProtocol, frame: Frame) -> float:
    """Share of the pixels on and around a contact that no longer tell slope."""
    thin, camera = thinned(frame), protocol.design.camera
    signal = signal_of(protocol, frame, thin)
    collected = np.clip(signal, camera.black_level, 1.0) - camera.black_level
    sigma = imaging.noise_sigma(
        collected, Capture(camera, protocol.model, binned=max(frame.rays.binned, 1.0))
    )
    dull = (signal >= 1.0) | (collected < SIGMAS * sigma)
    lost = np.asarray(dull.any(axis=-1))
    return float(lost[error_region(frame)[thin]].mean())


def lateral_resolution(
    protocol: EvaluationProtocol, calibration: KernelCalibration, picture: Picture, *, pixel_mm: float
) -> Scores:
    """Width of two bars, as far apart as wide, that a reconstructed press just tells apart.

    They are pressed 0.25 mm deep, and told apart where the height between them is lower than theirs by at
    least 20 %, and by at least three sigma of what camera noise does to that difference; the width is that at
    which this holds with a probability of 95 %. The standard error is that of the mean over bars along y and
    along x, with the last step of the search. There is no score where the widest bars are not told apart or
    the gel is too thin.

    Parameters
    ----------
    protocol, calibration : EvaluationProtocol, KernelCalibration
        Camera and reconstruction.
    picture : callable
        Renders a press.
    pixel_mm : float
        Size of a pixel on the membrane (mm); narrower bars are not looked at.
    """
    design, name = protocol.design, "lateral_resolution_mm"
    if design.elastomer.thickness_mm < BARS_DEPTH_MM + LEFT_MM:
        return {}
    widest_mm = min(WIDEST_MM, min(design.sensing_area_mm) / 8)
    first, count = 1000, DRAWS * (HALVINGS + 2)  # of noise that no other picture has
    found = []
    for turn, turn_deg in enumerate(TURNS_DEG):
        numbers = iter(range(first + turn * count, first + (turn + 1) * count))
        told = partial(_told_apart, protocol, calibration, picture, turn_deg, numbers)
        if not told(widest_mm):
            return {}
        low, high = math.log(pixel_mm), math.log(widest_mm)
        for _ in range(HALVINGS + 1):
            middle = (low + high) / 2
            low, high = (low, middle) if told(math.exp(middle)) else (middle, high)
        found.append((math.exp((low + high) / 2), math.exp(high) - math.exp(low)))
    widths, steps = zip(*found, strict=True)
    return {name: _mean(widths, max(steps), name)}


def _told_apart(
    protocol: EvaluationProtocol,
    calibration: KernelCalibration,
    picture: Picture,
    turn_deg: float,
    numbers: Iterator[int],
    width_mm: float,
) -> bool:
    """Whether two bars of a width are told apart with the probability asked for."""
    probe = Probe(kind="bars", size_mm=2 * width_mm)
    frame = picture(Press(probe=probe, depth_mm=BARS_DEPTH_MM, yaw_deg=turn_deg))
    drawn = [next(numbers) for _ in range(DRAWS)]
    seen = protocol.reconstruct(calibration, DRAWS * [frame], numbers=drawn)
    dips = [_dip(one.height_mm, frame, width_mm, turn_deg) for one in seen]
    mean, sigma = float(np.mean(dips)), float(np.std(dips, ddof=1))
    return mean - max(DIP, SIGMAS * sigma) >= float(ndtri(PROBABILITY)) * sigma


def _dip(height_mm: Array, frame: Frame, width_mm: float, turn_deg: float) -> float:
    """How much lower the gel is midway between two bars than on them, as a share of the height there."""
    across = np.linspace(-1.0, 1.0, ACROSS)[:, None]
    along = np.linspace(-0.5, 0.5, ALONG)[None, :]

    def level(axis: float) -> float:
        """Mean height over the middle half of a stripe of the width of a bar about an axis."""
        x, y = width_mm * (axis + across / 4), np.broadcast_to(width_mm * along, (ACROSS, ALONG))
        turn = math.radians(turn_deg)
        x, y = math.cos(turn) * x - math.sin(turn) * y, math.sin(turn) * x + math.cos(turn) * y
        return float(map_coordinates(height_mm, _pixels(frame, x, y), order=1).mean())

    on, between = (level(-1.0) + level(1.0)) / 2, level(0.0)
    return 1.0 - between / on if on > 0 else 0.0


def _pixels(frame: Frame, x_mm: Array, y_mm: Array) -> tuple[Array, Array]:
    """Rows and columns that see points near the middle of the picture."""
    seen_x, seen_y = frame.rays.x_mm, frame.rays.y_mm
    rows, columns = seen_x.shape
    column = np.interp(x_mm, seen_x[rows // 2], np.arange(columns))
    row = np.interp(-y_mm, -seen_y[:, columns // 2], np.arange(rows))
    return row, column
