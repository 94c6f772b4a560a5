"""Ball presses of a lab: what they teach, and finding their contact circle in a picture."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import map_coordinates

from designlab.core.types import Array, Mask
from designlab.reconstruction.pictures import smoothed

_SMOOTHING_PX = 2.0
_DIRECTIONS = 72
_DARKEST = 0.3  # share of the mean background below which a ratio would be noise
_ROUNDS = 20


@dataclass(frozen=True, eq=False)
class BallPress:
    """A picture of a ball pressed into the gel.

    Attributes
    ----------
    image : array, shape (rows, columns, channels)
        The picture.
    centre_px : pair of float
        Column and row of the centre of the contact.
    contact_radius_px : float
        Radius of the contact circle as read off the picture.
    radius_mm : float, optional
        Radius of the ball, where balls differ; that of the setup when absent.
    file : str
        Its file, by which messages name it; empty where it has none.
    covered : bool array, shape (rows, columns), optional
        Pixels that show a printed marker, filled in from around; they teach nothing. None if absent.
    """

    image: Array
    centre_px: tuple[float, float]
    contact_radius_px: float
    radius_mm: float | None = None
    file: str = ""
    covered: Mask | None = None

    def moved(self, centre_px: tuple[float, float]) -> "BallPress":
        """The same press with another centre."""
        return replace(self, centre_px=centre_px)


@dataclass(frozen=True)
class ContactCircle:
    """Contact circle in pixels: centre as column and row, and radius."""

    centre_px: tuple[float, float]
    radius_px: float


def ball_gradients(
    shape: tuple[int, int], centre_px: tuple[float, float], *, ball_radius_mm: float, mm_per_px: float
) -> tuple[Array, Array, Array]:
    """Slopes p, q of a ball at the pixels of a picture, and their distance from its centre (px)."""
    rows, columns = np.indices(shape)
    x_px, y_px = np.asarray(columns - centre_px[0]), np.asarray(centre_px[1] - rows)
    return *slopes_on_ball(x_px, y_px, ball_radius_px=ball_radius_mm / mm_per_px), np.hypot(x_px, y_px)


def slopes_on_ball(x_px: Array, y_px: Array, *, ball_radius_px: float) -> tuple[Array, Array]:
    """Slopes p, q of a ball at places to the right of and above its axis.

    They depend on the place only, not on the depth: p = -x / sqrt(R^2 - r^2). Beyond the ball's radius they
    are kept at those of 0.999 R.
    """
    down = np.sqrt(np.maximum(ball_radius_px**2 - x_px**2 - y_px**2, 0.002 * ball_radius_px**2))
    return -x_px / down, -y_px / down


def find_contact_circle(
    image: ArrayLike, background: ArrayLike, *, mask: Mask | None = None
) -> ContactCircle:
    """Find the contact circle of a ball in a picture, without calibration.

    The membrane is steepest at the rim of the contact and flattens beyond it. In each direction from the
    centre the place is found where the change of colour falls off fastest; a circle is fitted to these
    places, outliers counting little; its centre is the next start.
    `centres.refine_centres` then makes centres more exact.

    Parameters
    ----------
    image, background : array, shape (rows, columns, channels)
        The press and the untouched gel.
    mask : bool array, shape (rows, columns), optional
        Pixels to use; printed markers left out, for instance.

    Raises
    ------
    ValueError
        If shapes differ, or nothing in the picture stands out from the noise.
    """
    image, background = np.asarray(image, dtype=float), np.asarray(background, dtype=float)
    if image.shape != background.shape or image.ndim != 3:
        raise ValueError(
            f"image: must have the shape of the background {background.shape}, got {image.shape}"
        )
    # relative to the local background: uneven light would shift the rim towards where it is bright
    level = np.maximum(background, _DARKEST * background.mean(axis=(0, 1)))
    change = smoothed((image - background) / level, _SMOOTHING_PX, mask)
    change -= np.median(change, axis=(0, 1))
    strength = np.sqrt((change**2).sum(axis=-1))
    noise, half = float(np.median(strength)), 0.5 * float(np.percentile(strength, 99.8))
    if not half > 3 * noise:  # also where nothing changes at all
        raise ValueError(
            f"image: must show a contact, the strongest change of colour is {2 * half:.3g} of the background "
            f"against {noise:.3g} where nothing happens"
        )
    rows, columns = np.indices(strength.shape)
    weight = np.where(strength > half, strength, 0.0)
    centre = np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()
    reach = 2 * np.sqrt((weight > 0).sum() / np.pi)
    radius = reach / 2
    for _ in range(_ROUNDS):
        found, radius = _circle(_rim(strength, centre, reach))
        shift, centre = np.hypot(*(found - centre)), found
        # uneven light beyond the contact falls off too
        reach = 1.5 * radius
        if shift < 0.01:
            break
    return ContactCircle((float(centre[0]), float(centre[1])), float(radius))


def _rim(strength: Array, centre: Array, reach_px: float) -> Array:
    """Places where the change falls off fastest along rays, (directions, 2) columns and rows."""
    radii = np.arange(2.0, max(reach_px, 6.0), 0.25)
    angle = np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS
    along = np.stack([np.cos(angle), -np.sin(angle)], axis=1)
    columns, rows = centre[:, None, None] + along.T[:, None, :] * radii[:, None]
    # the border of the picture is no fall
    profile = map_coordinates(strength, [rows, columns], order=1, mode="nearest")
    # smoothing and clipped channels move the maximum inwards, but hardly the steepest fall beyond it
    radius = radii[np.gradient(profile, axis=0).argmin(axis=0)]
    return np.asarray(centre + radius[:, None] * along)


def _circle(points: Array) -> tuple[Array, float]:
    """Circle through points, by Kasa's linear fit reweighted so that outliers count little."""
    terms = np.column_stack([2 * points, np.ones(len(points))])
    right, weight = (points**2).sum(axis=1), np.ones(len(points))
    for _ in range(_ROUNDS):
        x, y, c = np.linalg.lstsq(terms * weight[:, None], right * weight, rcond=None)[0]
        radius = float(np.sqrt(c + x * x + y * y))
        miss = np.abs(np.hypot(points[:, 0] - x, points[:, 1] - y) - radius)
        weight = 1 / (1 + (miss / (0.1 * radius)) ** 2)
    return np.array([x, y]), radius
