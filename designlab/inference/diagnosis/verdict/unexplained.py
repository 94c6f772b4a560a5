"""What effects found leave of the gap: how much it is, and what it looks like."""

from collections.abc import Iterable, Mapping

import numpy as np
from scipy.fft import idctn
from scipy.ndimage import maximum_filter
from scipy.stats import t

from designlab.core.types import Array, Mask
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.likelihood.noise import LONG_LENGTH, spectrum, transformed
from designlab.inference.diagnosis.result import Unexplained
from designlab.inference.diagnosis.selection.held_out import USUAL, Judged

LOWEST = 1e-2  # power of long waves, over the most, of what counts as smooth
STANDS_OUT = 3.0  # times what the others of its kind leave, from which one frame or group is named
HOLDS = 0.2  # of what is left, likewise
MARGIN_PX = 2  # about what a press changes
CHANGED = 0.05  # relative change of light by a press that has an edge


def unexplained(
    fitter: Fitter, states: Mapping[int, State], held_out: Iterable[tuple[Judged, Judged]]
) -> Unexplained:
    """Say how much of the gap is left, and what that looks like.

    Parameters
    ----------
    fitter : Fitter
        Of the corrected model, or of the model as given where nothing was found.
    states : mapping of int to State
        Where each shot stands.
    held_out : iterable of (Judged, Judged)
        Presses that were not fitted to, by the model as given and by the corrected one.
    """
    left = {n: _Left(fitter, state, n) for n, state in states.items() if fitter.bank.shots[n].lit.any()}
    total = sum(own.total for own in left.values())
    parts: dict[str, float] = {}
    if total > 0:
        parts = {
            kind: float(np.clip(sum(getattr(own, kind) for own in left.values()) / total, 0.0, 1.0))
            for kind in ("smooth", "grain", "edges")
        }
    apart = {n: own for n, own in left.items() if fitter.bank.shots[n].press is None}
    groups = {n: own for n, own in apart.items() if (fitter.bank.shots[n].lit > 0).sum() == 1}
    names = fitter.forward.design.group_names
    frame = _standing_out({n: own for n, own in left.items() if n not in groups}, total)
    group = _standing_out(groups, total) if len(groups) > 1 else None
    return Unexplained(
        *_share([*held_out]),
        smooth_rms=next(iter(states.values())).smooth_rms,
        grain_rms=fitter.grain,
        parts=parts,
        frame=None if frame is None else fitter.bank.shots[frame].files[0],
        group=None if group is None else names[int(np.argmax(fitter.bank.shots[group].lit))],
    )


class _Left:
    """Squared residual of a shot beyond noise of the camera, in units of the noise: all of it, and parts."""

    def __init__(self, fitter: Fitter, state: State, number: int) -> None:
        shot, noise = fitter.bank.shots[number], fitter.noises[number]
        predicted = fitter.forward.predict(state, number)
        light = predicted - fitter.forward.black
        z = np.where(shot.valid, (shot.signal - predicted) / noise.sigma, 0.0)
        grain = (fitter.grain * light / noise.sigma) ** 2
        camera = shot.variance / noise.sigma**2
        low = _low_frequencies(z.shape[:2])
        smooth = idctn(transformed(z) * low[..., None], axes=(0, 1), norm="ortho")
        edge = _edges(light, fitter.forward.untouched(state, number) - fitter.forward.black) & shot.valid
        self.values = int(shot.valid.sum())
        self.total = float((z**2 - camera)[shot.valid].sum())
        self.smooth = float((smooth**2)[shot.valid].sum())
        self.grain = float(grain[shot.valid & ~edge].sum())
        self.edges = float(((z - smooth) ** 2 - camera - grain)[edge].sum())


def _low_frequencies(shape: tuple[int, int]) -> Mask:
    power = spectrum(shape, LONG_LENGTH)
    return np.asarray(power > LOWEST * power.max())


def _edges(light: Array, bare: Array) -> Mask:
    """Pixels near to which a press changes the light much."""
    changed = np.abs(light - bare) > CHANGED * np.abs(bare)
    return np.asarray(maximum_filter(changed, size=(2 * MARGIN_PX + 1, 2 * MARGIN_PX + 1, 1)))


def _standing_out(left: Mapping[int, _Left], total: float) -> int | None:
    """Number of the shot that leaves far more than the others, if it holds much of all."""
    if len(left) < 2 or total <= 0:
        return None
    most = max(left, key=lambda n: left[n].total / left[n].values)
    others = np.median([own.total / own.values for n, own in left.items() if n != most])
    far = left[most].total / left[most].values > STANDS_OUT * max(float(others), 0.0)
    return most if far and left[most].total > HOLDS * total else None


def _share(held_out: list[tuple[Judged, Judged]]) -> tuple[float | None, float | None, float | None]:
    """Share of the gap that is left, and its 95 % interval by the spread between presses (jackknife).

    The gap is what noise and grain do not leave. None where there is none, or too few presses tell.
    """
    usual = np.concatenate([USUAL * before.least / before.values for before, _ in held_out])
    before = np.concatenate([judged.per_shot for judged, _ in held_out]) - usual
    after = np.concatenate([judged.per_shot for _, judged in held_out]) - usual
    if before.sum() <= 0:
        return None, None, None
    share = float(np.clip(after.sum() / before.sum(), 0.0, 1.0))
    count = len(before)
    if count < 2:
        return share, None, None
    without = (after.sum() - after) / np.maximum(before.sum() - before, 1e-12)
    error = float(np.sqrt((count - 1) / count * ((without - without.mean()) ** 2).sum()))
    away = float(t.ppf(0.975, count - 1)) * error
    return share, max(share - away, 0.0), min(share + away, 1.0)
