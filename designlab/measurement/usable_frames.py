"""Which shots are needed, and which are used, to name what a model lacks."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from designlab.measurement import Measurement, MeasurementError
from designlab.measurement.depths import by_force
from designlab.measurement.shots import Observations, Shot, force_sigma_n, observe
from designlab.mechanics.contact import NotConverged
from designlab.sensor.design import Design
from designlab.simulation.contact.press import Press

LEAST_PLACES = 3
MOST_PRESSES = 20  # of which more tell little that is new, each costs pictures of every effect tried
DARK_SIGMA = 2.0  # median of a channel, in its noise without light, below which it is dark


def observe_apart(measurement: Measurement, design: Design, *, columns: int) -> Observations:
    """Gather the frames of a measurement, each a shot of its own, and check that a diagnosis can use them.

    Raises
    ------
    MeasurementError
        As `observe`, or if a background or presses for training, selection and final numbers are missing.
    """
    seen = _with_depths(measurement, observe(measurement, design, columns=columns, apart=True), design)
    seen = _alone(seen)
    if not is_single(seen):
        _require_enough(measurement, seen)
    return replace(seen, shots=tuple(without_cut(shot) for shot in seen.shots))


def _with_depths(measurement: Measurement, seen: Observations, design: Design) -> Observations:
    """Press to a depth what states its force alone: depths are fitted about the one the gel lets it go."""
    frames = {frame.file: frame for frame in measurement.frames}
    kept, notes = [], [*seen.notes]
    for shot in seen.shots:
        press, frame = shot.press, frames[shot.files[0]]
        if press is not None and press.force_n is not None:
            try:
                press, doubt = by_force(press, design, force_sigma_n(frame, press.force_n, notes))
            except (ValueError, NotConverged) as error:
                notes.append(f"{frame.file}: left out, its force tells no depth: {error}")
                continue
            sigma = shot.pose_sigma.copy()
            sigma[2] = doubt
            shot = replace(shot, press=press, pose_sigma=sigma)
            notes.append(
                f"{frame.file}: its depth is that of its force, {press.stated_depth_mm:.3g} mm, give or take "
                f"{doubt:.2g}"
            )
        kept.append(shot)
    return replace(seen, shots=tuple(kept), notes=tuple(notes))


def _alone(seen: Observations) -> Observations:
    """Keep one picture of a press that is the only one: no other press tells what it has alone."""
    pressed = [shot for shot in seen.shots if shot.press is not None]
    if len({shot.press for shot in pressed}) != 1:
        return seen
    kept = max(pressed, key=lambda shot: float(shot.lit.sum()))
    beside = [shot for shot in seen.shots if shot is not kept and shot.lit.any() and shot.ball is None]
    if not beside:
        return seen
    files = ", ".join(file for shot in beside for file in shot.files)
    note = (
        f"{files}: left out beside {', '.join(kept.files)}, the only press, which is diagnosed by itself; "
        f"with presses at {LEAST_PLACES} places or more they would be used"
    )
    shots = tuple(shot for shot in seen.shots if shot not in beside)
    return replace(seen, shots=shots, notes=(*seen.notes, note))


def spread_out(seen: Observations, most: int = MOST_PRESSES) -> Observations:
    """Keep the presses that differ most in place, depth and probe, where there are more than are needed.

    Of those to train on, to choose by and to judge by in the end, the same share is kept each.

    Parameters
    ----------
    seen : Observations
        What was photographed.
    most : int
        Presses to keep, repeats counted once.
    """
    uses = {shot.press: shot.use for shot in seen.shots if shot.press is not None}
    if len(uses) <= most:
        return seen
    kept: set[Press] = set()
    for use in dict.fromkeys(uses.values()):
        own = [press for press in uses if uses[press] == use]
        kept.update(_most_apart(own, max(round(most * len(own) / len(uses)), 1)))
    left = sorted(file for s in seen.shots if s.press is not None and s.press not in kept for file in s.files)
    note = (
        f"{len(kept)} of {len(uses)} presses are used, those that differ most in place, depth and probe; "
        f"left out: {', '.join(left)}"
    )
    shots = tuple(shot for shot in seen.shots if shot.press is None or shot.press in kept)
    return replace(seen, shots=shots, notes=(*seen.notes, note))


def _most_apart(presses: Sequence[Press], count: int) -> list[Press]:
    """The deepest press, then each time the one that is farthest from all chosen before."""
    ordered = sorted(presses, key=lambda press: (-press.stated_depth_mm, press.model_dump_json()))
    place = np.array([[*press.centre_mm, press.stated_depth_mm] for press in ordered])
    reach = np.ptp(place, axis=0)
    reach[:2] = reach[:2].max()  # a place counts alike in x and y
    place /= np.where(reach > 0, reach, 1.0)
    probes = np.unique([press.probe.text for press in ordered], return_inverse=True)[1]
    away = np.full(len(ordered), np.inf)
    chosen = [0]
    while len(chosen) < min(count, len(ordered)):
        last = chosen[-1]
        to_last = np.hypot(np.linalg.norm(place - place[last], axis=1), probes != probes[last])
        away = np.minimum(away, to_last)
        away[chosen] = -1.0
        chosen.append(int(away.argmax()))
    return [ordered[number] for number in chosen]


def is_single(seen: Observations) -> bool:
    """Whether the only picture with light is one press."""
    lit = [shot for shot in seen.shots if shot.lit.any() and shot.ball is None]
    return len(lit) == 1 and lit[0].press is not None


def without_cut(shot: Shot) -> Shot:
    """Leave out channels that are dark and cut at zero: how far below zero they would be is not known."""
    level = np.median(shot.signal, axis=(0, 1))
    seen = (shot.clip_sigma == 0) | (level > DARK_SIGMA * shot.clip_sigma)
    return replace(shot, valid=shot.valid & seen)


def end_at_zero(shots: Sequence[Shot]) -> tuple[bool, bool, bool]:
    """Channels of which a frame without light shows, or would show, no value below zero."""
    dark = [shot.clips for shot in shots if not shot.lit.any()]
    if dark:
        red, green, blue = (any(clips[channel] for clips in dark) for channel in range(3))
    else:
        red, green, blue = (all((shot.signal[..., c] >= 0).all() for shot in shots) for c in range(3))
    return red, green, blue


def _require_enough(measurement: Measurement, seen: Observations) -> None:
    shots = seen.shots
    if not any(shot.press is None and shot.lit.any() for shot in shots):
        raise MeasurementError(f"{measurement.folder}: field frame: a background with LEDs on is needed")
    missing = [use for use in ("train", "select", "final") if not any(shot.use == use for shot in shots)]
    if missing:
        presses = {frame.file for frame in measurement.frames if frame.kind == "press"}
        lost = [note for note in seen.notes if ": left out" in note and note.partition(":")[0] in presses]
        why = f". {lost[0]}" if lost else ""
        others = f"; {len(lost) - 1} more are left out" if len(lost) > 1 else ""
        raise MeasurementError(
            f"{measurement.folder}: field frame: usable presses at {LEAST_PLACES} places or more are needed, "
            f"so that an effect fitted at one is judged at others; none is left for {', '.join(missing)}{why}"
            f"{others}"
        )
