"""Recentring renders pictures where a fit stands, instead of combining those about the model as given."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from designlab.core.types import Array, Single
from designlab.inference.diagnosis.emulator.forward import Forward
from designlab.inference.diagnosis.emulator.rendering import rendered_at
from designlab.inference.diagnosis.emulator.snapshots import POSE_STEP, SHARPER, LocalCorrection
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.selection.held_out import judge
from designlab.simulation.effects import effect
from designlab.simulation.render_cache import Renders

PLACINGS = 2  # times that presses are rendered anew where they seem to stand
REACH = 1.0  # steps of a pose about the stated one between which pictures are combined well
NEAR = 0.2  # likewise, about one that was rendered
FAR_SD = 0.5  # prior standard deviations from null that pictures rendered about it are exact enough for


def exact_fitter(source: Renders, fitter: Fitter, state: State, shots: Sequence[int]) -> Fitter:
    """Fitter whose pictures of some shots are exact at a state's poses and effects, with the same noise.

    How light changes about them stays as it was, so that a picture of each shot is enough, instead of two for
    each parameter: Newton's method with a fixed derivative.

    Parameters
    ----------
    source : Renders
        Where pictures come from.
    fitter : Fitter
        What combines pictures so far.
    state : State
        Where the light is to be exact.
    shots : sequence of int
        Numbers of the shots; the others keep their pictures.
    """
    bank = fitter.bank
    poses = {number: fitter.forward.pose(state, number) for number in shots}
    pictures = [bank.of(number) for number in range(len(bank.shots))]
    for number, error in _lacking(source, fitter.forward, state, poses):
        at = poses[number] / POSE_STEP
        pictures[number] = replace(pictures[number], light=pictures[number].light + error, exact_at=at)
    if any(effect(name).warps for name in state.values):
        edged = {number: pose for number, pose in poses.items() if pictures[number].sharp is not None}
        for number, sharp in rendered_at(source, bank, state.rendered, edged, state.sizes, times=SHARPER):
            pictures[number] = replace(pictures[number], sharp=sharp, sharp_at=poses[number] / POSE_STEP)
    return fitter.of(replace(bank.with_own(pictures), stands=state.rendered), fitter.noises)


def _lacking(
    source: Renders, forward: Forward, state: State, poses: Mapping[int, Array]
) -> Iterator[tuple[int, Single]]:
    """What the light of shots lacks of that rendered at their poses and a state's effects, by their numbers.

    A common offset of the depth is part of the poses; rendered, it would be counted once more.
    """
    combined = replace(state, values=state.rendered, poses=poses, numerical=0.0)
    for number, light in rendered_at(source, forward.bank, state.rendered, poses, state.sizes):
        yield number, light - forward.light(combined, number)


def is_exact(fitter: Fitter) -> bool:
    """Whether pictures of a fitter were rendered where a fit stands."""
    return any(picture.exact_at is not None for picture in fitter.bank.pictures)


def is_far(fitter: Fitter, state: State, reach: float = FAR_SD) -> bool:
    """Whether a state is too far from where the light of a fitter's pictures is exact.

    Parameters
    ----------
    reach : float
        How far values may be from where pictures were rendered anew, in prior standard deviations.
    """
    stands, rendered = fitter.bank.stands, state.rendered
    if len(rendered) > 1 and not stands.keys() >= rendered.keys():
        return True  # no picture of one effect shows what several do together
    for name, values in rendered.items():
        moved = name in stands
        for p in fitter.forward.parameters[name]:
            if (p.shape and not moved) or p.name not in values:
                continue  # what only shapes an effect is known least, and cannot be far alone
            away = abs(values[p.name] - (stands[name][p.name] if moved else p.null)) / p.sd
            # About null derivatives are known best; pictures rendered elsewhere are exact there alone.
            if away > (reach if moved else FAR_SD):
                return True
    return False


def looks_elsewhere(fitter: Fitter, state: State, shots: Sequence[int]) -> bool:
    """Whether the camera of a state looks far from where it was stated, and edges of presses are not sharp.

    What a camera that looks elsewhere shows of an edge depends on where in a pixel it lies.
    """
    forward = fitter.forward
    looks = [
        abs(values[p.name] - p.null) / p.sd
        for name, values in state.values.items()
        if effect(name).warps
        for p in forward.parameters[name]
        if p.name in values
    ]
    if max(looks, default=0.0) <= FAR_SD:
        return False
    for number in shots:
        picture = fitter.bank.of(number)
        if picture.sharp is None or not picture.pose:
            continue
        at = np.zeros(len(POSE_STEP)) if picture.sharp_at is None else picture.sharp_at
        if np.abs(forward.pose(state, number) / POSE_STEP - at).max() > NEAR:
            return True
    return False


def placed(source: Renders, fitter: Fitter, train: Sequence[int], others: Sequence[int]) -> Fitter:
    """Fitter whose pictures are exact where presses stand, if others do not reach there.

    Light goes on straight beyond a step of a pose: at the edges of a punch 0.1 mm off that leaves several
    times the noise, which any effect that moves edges would take up.

    Parameters
    ----------
    source : Renders
        Where pictures come from.
    fitter : Fitter
        The model as given.
    train, others : sequence of int
        Shots that gains are fitted to, and all others with a press, which are registered each by itself.
    """
    for _ in range(PLACINGS):
        found = fitter.fit(fitter.start(train), (), train)
        fitter.measure(found.state)
        state = judge(fitter, found, others).state
        far = beyond(fitter, state, [*train, *others])
        if not far:
            break
        fitter = standing(source, fitter, state, far)
    return fitter


def standing(source: Renders, fitter: Fitter, state: State, shots: Sequence[int]) -> Fitter:
    """Fitter whose pictures of some shots are exact where these stand in a state, see `LocalCorrection`."""
    bank = fitter.bank
    pictures = [bank.of(number) for number in range(len(bank.shots))]
    for number in shots:
        pictures[number] = replace(pictures[number], stand=None)
    without = Forward(bank.with_own(pictures))
    poses = {number: fitter.forward.pose(state, number) for number in shots}
    for number, error in _lacking(source, without, state, poses):
        stand = LocalCorrection(poses[number] / POSE_STEP, error)
        pictures[number] = replace(pictures[number], stand=stand)
    return fitter.of(bank.with_own(pictures), fitter.noises)


def beyond(fitter: Fitter, state: State, shots: Sequence[int]) -> list[int]:
    """Shots whose poses are further than pictures about the stated or a rendered one reach."""
    found = []
    for number in shots:
        pose = fitter.forward.pose(state, number) / POSE_STEP
        picture = fitter.bank.of(number)
        if picture.stand is not None and np.abs(pose - picture.stand.pose).max() <= NEAR:
            continue
        centre = np.zeros(len(pose)) if picture.exact_at is None else picture.exact_at
        if picture.pose and np.abs(pose - centre).max() > REACH:
            found.append(number)
    return found
