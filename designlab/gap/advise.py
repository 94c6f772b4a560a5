"""What to measure next."""

from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from designlab.gap.problem import Problem, State, mixed, weights
from designlab.gap.result import Verdict
from designlab.gap.search import Search
from designlab.measurement.shots import Observations, Shot

Array = NDArray[np.float64]

FEW_HELD_OUT = 4


def advise(problem: Problem, seen: Observations, search: Search, verdict: Verdict) -> str:
    """Name the measurement that would help most; empty where none is needed."""
    if verdict == "ambiguous":
        return _separating(problem, search)
    if not seen.repeats:
        return "repeat the background twice: the noise floor is only assumed so far"
    if not seen.dark:
        return "one frame with the LEDs off: without it an additive floor hides in other effects"
    single = {int(np.argmax(s.lit)) for s in seen.shots if s.press is None and (s.lit > 0).sum() == 1}
    if verdict in ("unexplained", "partial") and len(single) < len(problem.shots[0].lit):
        return (
            "one background for each LED group alone: it separates effects of light from those of the camera"
        )
    held_out = len(seen.of("select"))
    if verdict == "unexplained":
        return (
            "the same press at two more depths, and turned by 180 deg with the gel: the first tells effects "
            "of contact from effects of light, the second effects of the gel from effects of the sensor"
        )
    if verdict in ("named", "partial") and held_out < FEW_HELD_OUT:
        return f"presses at more places: only {held_out} held-out presses bear the verdict"
    return ""


def _separating(problem: Problem, search: Search) -> str:
    """The frame on which the effects of the last coherence set differ most after refitting the gains."""
    pairs = list(combinations(search.alternatives.values(), 2))
    scores = {}
    for text, shot in _actions(problem, search).items():
        scores[text] = min(_separation(problem, shot, *pair) for pair in pairs)
    best = max(scores, key=lambda text: scores[text])
    return f"{best}: there the effects of the set differ by {scores[best]:.3g} standard deviations (rms)"


def _actions(problem: Problem, search: Search) -> dict[str, Shot]:
    """Frames that could be taken."""
    background = next(shot for shot in problem.shots if shot.press is None)
    names = next(iter(search.alternatives.values())).model.design.group_names
    actions = {
        f"a background with the {name} LEDs alone": replace(background, lit=np.eye(len(names))[group])
        for group, name in enumerate(names)
    }
    pressed = max((s for s in problem.shots if s.press), key=lambda s: s.press.depth_mm if s.press else 0.0)
    assert pressed.press is not None
    for share in (0.5, 1.5):
        depth = round(share * pressed.press.depth_mm, 3)
        press = pressed.press.model_copy(update={"depth_mm": depth, "centre_mm": (0.0, 0.0)})
        actions[f"{press.probe.text} pressed {depth:g} mm deep at the centre"] = replace(pressed, press=press)
    return actions


def _separation(problem: Problem, shot: Shot, first: State, second: State) -> float:
    stream = 0 if shot.press is None else len(problem.shots) + 1
    pictures, columns = [], None
    for state in (first, second):
        basis = problem.renders.basis(state.model, shot.press, shot.view, stream=stream).astype(float)
        mixing = weights(state, shot)
        pictures.append(mixed(mixing, basis))
        columns = np.moveaxis(mixing[:, :, None, None] * basis[None], (0, 1), (2, 3))
    assert columns is not None
    number = next(n for n, s in enumerate(problem.shots) if (s.press is None) == (shot.press is None))
    sigma = problem.sigma[number]
    difference = ((pictures[0] - pictures[1]) / sigma).ravel()
    matrix = (columns / sigma[..., None]).reshape(-1, columns.shape[-1])
    lit = np.abs(matrix).sum(axis=0) > 0
    fitted = matrix[:, lit] @ np.linalg.lstsq(matrix[:, lit], difference, rcond=None)[0]
    return float(np.sqrt(((difference - fitted) ** 2).mean()))
