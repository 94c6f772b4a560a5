"""Two light probes side by side: lobe by lobe, and as a whole."""

import json
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np
from scipy.optimize import linear_sum_assignment

from designlab.measurement.light_probe.lobes import Lobe, lobes
from designlab.measurement.light_probe.polar import polar_map
from designlab.measurement.light_probe.unwrap import Unwrapped


@dataclass(frozen=True)
class LobeDifference:
    """One lobe in both; ratios are found over reference.

    Attributes
    ----------
    channel : str
        Channel of both.
    polar_deg, azimuth_deg : float
        Middle of the lobe of the reference.
    apart_deg : float
        Angle between the two middles.
    polar_change_deg, azimuth_change_deg : float
        Found minus reference.
    solid_angle, seen, width, flux, peak : float
        Ratios; `width` that of the greater width.
    cut : bool
        Whether either is cut off by the ball's outline or the picture.
    """

    channel: str
    polar_deg: float
    azimuth_deg: float
    apart_deg: float
    polar_change_deg: float
    azimuth_change_deg: float
    solid_angle: float
    seen: float
    width: float
    flux: float
    peak: float
    cut: bool


@dataclass(frozen=True)
class LightDifference:
    """What two light probes differ by.

    Attributes
    ----------
    lobes : tuple of LobeDifference
        Lobes that both have.
    missing, extra : tuple of Lobe
        Lobes that only the reference, or only what was found, has.
    error : dict of str to float
        By channel, root of the mean squared difference over that of the reference, weighed by solid angle;
        0 is agreement.
    scale : dict of str to float
        By channel, the factor on what was found that makes the error least.
    scaled_error : dict of str to float
        The error after that.
    compared_sr : float
        Solid angle of the directions that both show, of 4 pi.
    """

    lobes: tuple[LobeDifference, ...]
    missing: tuple[Lobe, ...]
    extra: tuple[Lobe, ...]
    error: dict[str, float]
    scale: dict[str, float]
    scaled_error: dict[str, float]
    compared_sr: float

    def to_json(self) -> str:
        """Content as JSON."""
        return json.dumps(asdict(self))


def compare_light(
    found: Unwrapped,
    reference: Unwrapped,
    *,
    threshold: float = 0.5,
    furthest_deg: float = 20.0,
    step_deg: float = 1.0,
    unit: Literal["absolute", "scaled"] = "absolute",
) -> LightDifference:
    """Compare the light of two probes channel by channel.

    Parameters
    ----------
    found, reference : Unwrapped
        Light of the same channels, as seen by balls of one size at one place: near light looks different
        from elsewhere.
    threshold : float
        Of the lobes, see `lobes`.
    furthest_deg : float
        Lobes further apart than this are different ones.
    step_deg : float
        Cell of the polar maps that the error is taken over.
    unit : str
        "scaled": fluxes and peaks of lobes are compared after each channel's own scale, for pictures whose
        units differ.

    Raises
    ------
    ValueError
        If the channels differ, or the reference has a dark channel.
    """
    if found.names != reference.names:
        raise ValueError(
            f"names: both must have the same channels, got {', '.join(found.names)} and "
            f"{', '.join(reference.names)}"
        )
    if not 0 < furthest_deg <= 180:
        raise ValueError(f"furthest_deg: must lie between 0 and 180 deg, got {furthest_deg:g} deg")
    maps = [polar_map(one, step_deg=step_deg, furthest_deg=180.0) for one in (found, reference)]
    both = np.isfinite(maps[0].radiance[0]) & np.isfinite(maps[1].radiance[0])
    weight = np.broadcast_to(maps[0].solid_angle_sr, both.shape)[both]
    error, scale, scaled = {}, {}, {}
    for channel, name in enumerate(found.names):
        ours, theirs = (one.radiance[channel][both] for one in maps)
        power = float(weight @ theirs**2)
        if power <= 0:
            raise ValueError(f"reference: channel {name} must not be dark")
        error[name] = float(np.sqrt(weight @ (ours - theirs) ** 2 / power))
        own = float(weight @ ours**2)
        scale[name] = float(weight @ (ours * theirs)) / own if own > 0 else 1.0
        scaled[name] = float(np.sqrt(weight @ (scale[name] * ours - theirs) ** 2 / power))
    own_lobes, their_lobes = lobes(found, threshold=threshold), lobes(reference, threshold=threshold)
    pairs: list[LobeDifference] = []
    missing: list[Lobe] = []
    extra: list[Lobe] = []
    for name in found.names:
        factor = scale[name] if unit == "scaled" else 1.0
        matched, lone, other = _matched(own_lobes.of(name), their_lobes.of(name), furthest_deg)
        pairs += [_difference(a, b, factor) for a, b in matched]
        extra += lone
        missing += other
    return LightDifference(
        tuple(pairs), tuple(missing), tuple(extra), error, scale, scaled, float(weight.sum())
    )


def _matched(
    ours: tuple[Lobe, ...], theirs: tuple[Lobe, ...], furthest_deg: float
) -> tuple[list[tuple[Lobe, Lobe]], list[Lobe], list[Lobe]]:
    """Pairs with the least sum of angles, and the lobes of either side that remain."""
    apart = np.array([[_apart_deg(a, b) for b in theirs] for a in ours]).reshape(len(ours), len(theirs))
    chosen = [(int(i), int(j)) for i, j in zip(*linear_sum_assignment(apart), strict=True)]
    chosen = [(i, j) for i, j in chosen if apart[i, j] <= furthest_deg]
    taken, given = {i for i, _ in chosen}, {j for _, j in chosen}
    return (
        [(ours[i], theirs[j]) for i, j in chosen],
        [lobe for i, lobe in enumerate(ours) if i not in taken],
        [lobe for j, lobe in enumerate(theirs) if j not in given],
    )


def _apart_deg(a: Lobe, b: Lobe) -> float:
    cross = np.linalg.norm(np.cross(a.direction, b.direction))
    return float(np.degrees(np.arctan2(cross, np.dot(a.direction, b.direction))))


def _difference(ours: Lobe, theirs: Lobe, factor: float) -> LobeDifference:
    return LobeDifference(
        channel=ours.channel,
        polar_deg=theirs.polar_deg,
        azimuth_deg=theirs.azimuth_deg,
        apart_deg=_apart_deg(ours, theirs),
        polar_change_deg=ours.polar_deg - theirs.polar_deg,
        azimuth_change_deg=(ours.azimuth_deg - theirs.azimuth_deg + 180.0) % 360.0 - 180.0,
        solid_angle=ours.solid_angle_sr / theirs.solid_angle_sr,
        seen=ours.seen_sr / theirs.seen_sr,
        width=ours.width_deg[0] / theirs.width_deg[0],
        flux=factor * ours.flux / theirs.flux,
        peak=factor * ours.peak / theirs.peak,
        cut=ours.cut or theirs.cut,
    )
