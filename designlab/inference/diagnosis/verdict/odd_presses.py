"""An odd press does not show what is stated of it: another probe, another place, something else."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from designlab.core.types import Array
from designlab.inference.calibration.suspicions import (
    CoarseShot,
    Fault,
    FittedLight,
    fitted_light,
    misfit,
    picture,
)
from designlab.inference.diagnosis.emulator.render_cache import Renders
from designlab.measurement.quality.suspicion import Suspicion
from designlab.measurement.shots import Shot
from designlab.simulation.contact.press import Press
from designlab.simulation.effects import SensorModel
from geometries.probes import Probe, parse

Turn = tuple[tuple[int, int], tuple[int, int]]

# Misfits are root mean squares in units of the noise and 1 % of the mean signal together, light fitted to all
# other frames. In generated sets with effects of usual size no press that was as stated missed by more than
# 15.1, nor by more than 4.3 times the median of its set.
MOST_MISFIT = 20.0  # of a press whose metadata are right
MOST_ODD = 6.0  # the same over the median of all presses
ODD = 5.0  # the same from which a press is looked at by itself
ASKED_FROM = 5.0  # misfit of presses from which other probes and places are tried
BETTER = 2.0  # factor by which these must be better
TRIED = 2  # presses of each probe that others are tried on, the deepest
OTHER_KINDS = ("sphere", "cylinder", "cone", "triangle", "star", "prism")
OTHER_SIZES = (0.5, 2.0)

TURNS: dict[str, Turn] = {
    "[x, -y]": ((1, 0), (0, -1)),
    "[-x, y]": ((-1, 0), (0, 1)),
    "[-x, -y]": ((-1, 0), (0, -1)),
    "[y, x]": ((0, 1), (1, 0)),
}


def odd_presses(
    shots: Sequence[Shot],
    pictures: Sequence[CoarseShot],
    compared: Sequence[float],
    black: Array,
    model: SensorModel,
    renders: Renders,
) -> list[Suspicion]:
    """Name presses that the model misses by far, and what explains them clearly better.

    Parameters
    ----------
    shots : sequence of Shot
        Shots with LEDs on, black level taken away.
    pictures : sequence of CoarseShot
        The same with the pictures of the model.
    compared : sequence of float
        Misfit of each with the light that the others tell.
    black : array, shape (3,)
        Black level.
    model : SensorModel
        The model as given.
    renders : Renders
        Where other pictures of it come from.
    """
    pressed = {n: shot.press for n, shot in enumerate(shots) if shot.press is not None}
    usual = float(np.median([compared[n] for n in pressed]))
    odd = [n for n in pressed if compared[n] > max(ASKED_FROM, ODD * usual)]
    groups: dict[str, list[int]] = {}
    for n, press in pressed.items():
        groups.setdefault(shots[n].files[0] if n in odd else press.probe.text, []).append(n)
    found: list[Suspicion] = []
    for numbers in groups.values():
        deepest = sorted(numbers, key=lambda n: -pressed[n].stated_depth_mm)[:TRIED]
        if np.mean([compared[n] for n in deepest]) < ASKED_FROM:
            continue
        untouched = [p for n, p in enumerate(pictures) if n not in pressed]
        light = untouched or [p for n, p in enumerate(pictures) if n not in numbers]
        alone = numbers[0] in odd
        places = [pressed[n].centre_mm for n in odd if n not in numbers] if alone else []
        files = tuple(shots[n].files[0] for n in numbers)
        if light:
            told = fitted_light(light, Fault(), black)
            other = _other_press([(shots[n], pressed[n]) for n in deepest], told, places, model, renders)
            if other is not None:
                found.append(replace(other, files=files))
                continue
        if alone:
            found.append(_odd(files, compared[numbers[0]], usual))
    return found


def _odd(files: tuple[str, ...], missed: float, usual: float) -> Suspicion:
    return Suspicion(
        "odd",
        files,
        f"the model misses it by {missed:.3g} times noise and 1 % of the mean, half of all presses by less "
        f"than {usual:.2g}",
        "it shows something else than stated: another sensor, another probe, another place",
        "take it again, correct what measurement.toml says of it, or delete the frame",
        strong=missed > max(MOST_MISFIT, MOST_ODD * usual),
    )


def _other_press(
    presses: Sequence[tuple[Shot, Press]],
    light: FittedLight,
    places: Sequence[tuple[float, float]],
    model: SensorModel,
    renders: Renders,
) -> Suspicion | None:
    """Another probe or other places under which the model explains presses clearly better."""
    stated_probe = presses[0][1].probe
    renders.begin("checks", len(presses) * (len(OTHER_KINDS) + len(OTHER_SIZES) + len(TURNS) + len(places)))

    def left(changed: Callable[[Press], Press]) -> float:
        squares = []
        for shot, press in presses:
            basis = renders.basis(model, changed(press), shot.view).astype(float)
            squares.append(misfit(picture(shot, shot.lit, basis), light) ** 2)
        return float(np.sqrt(np.mean(squares)))

    stated = left(lambda press: press)
    tried: dict[str, tuple[str, float]] = {}
    for probe in _other_probes(stated_probe):
        tried[probe.text] = "probe", left(_with(probe=probe))
    for name, signs in TURNS.items():
        tried[name] = "place", left(partial(_placed, turn=signs))
    for place in places:
        text = f"[{place[0]:g}, {place[1]:g}], the place of another press"
        tried[text] = "place", left(_with(centre_mm=place))
    text, (kind, best) = min(tried.items(), key=lambda item: item[1][1])
    if BETTER * best > stated:
        return None
    evidence = (
        f"the model misses them by {stated:.3g} times noise and 1 % of the mean as stated, by {best:.2g} "
        f"with {text}"
    )
    if kind == "place":
        return Suspicion(
            "place",
            (),
            evidence,
            "files were exchanged, or places were noted in another frame: centre_mm counts x to the right "
            "and y upwards in the picture, from the middle of the gel",
            f"write centre_mm = {text}",
        )
    return Suspicion(
        "probe",
        (),
        evidence,
        f"another probe was pressed than {stated_probe.text}, or its size means something else: of spheres "
        "and cylinders the diameter, of a triangle its side",
        f'write probe = "{text}" if that is what was pressed, else the right one',
    )


def _with(**fields: object) -> Callable[[Press], Press]:
    """Change of a press that gives it other fields."""
    return lambda press: press.model_copy(update=fields)


def _placed(press: Press, turn: Turn) -> Press:
    x, y = press.centre_mm
    (a, b), (c, d) = turn
    return press.model_copy(update={"centre_mm": (a * x + b * y, c * x + d * y)})


def _other_probes(stated: Probe) -> Iterable[Probe]:
    """Other sizes of a probe, and other probes of its size."""
    for factor in OTHER_SIZES:
        yield stated.scaled(factor)
    for kind in OTHER_KINDS:
        if kind != stated.kind:
            yield parse(f"{kind}:{stated.size_mm!r}")
