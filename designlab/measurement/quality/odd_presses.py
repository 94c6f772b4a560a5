"""An odd press does not show what is stated of it: another probe, another place, something else."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from designlab.core.types import Array
from designlab.measurement.quality.picture_faults import (
    CoarseShot,
    Fault,
    FittedLight,
    coarse,
    fitted_light,
    misfit,
)
from designlab.measurement.quality.suspicion import Suspicion
from designlab.measurement.quality.turns import TURNS
from designlab.measurement.shots import Shot
from designlab.sensor.camera import View
from designlab.simulation.contact.press import Press
from geometries.probes import Probe, parse

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
PLACED = ("up-down", "left-right", "half", "other diagonal")  # turns of the frame that places are noted in


class ModelPictures(Protocol):
    """Simulates presses with the model as given."""

    def __call__(self, asked: Sequence[tuple[Press | None, View]]) -> Sequence[Array]:
        """Return a picture of each LED group at unit flux, (groups, rows, columns), of everything asked."""


def odd_presses(
    shots: Sequence[Shot],
    pictures: Sequence[CoarseShot],
    compared: Sequence[float],
    black: Array,
    model: ModelPictures,
) -> tuple[Suspicion, ...]:
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
    model : ModelPictures
        Simulates other presses.
    """
    pressed = {n: shot.press for n, shot in enumerate(shots) if shot.press is not None}
    if not pressed:
        return ()
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
            stated = [misfit(pictures[n], told) for n in deepest]
            presses = [(shots[n], pressed[n]) for n in deepest]
            other = _other_press(presses, stated, told, places, model)
            if other is not None:
                found.append(replace(other, files=files))
                continue
        if alone:
            found.append(_odd(files, compared[numbers[0]], usual))
    return tuple(found)


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
    stated: Sequence[float],
    light: FittedLight,
    places: Sequence[tuple[float, float]],
    model: ModelPictures,
) -> Suspicion | None:
    """Another probe or other places under which the model explains presses clearly better."""
    probe = presses[0][1].probe
    others = [
        ("probe", other.text, [press.model_copy(update={"probe": other}) for _, press in presses])
        for other in _other_probes(probe)
    ]
    for turn in (TURNS[name] for name in PLACED):
        turned = [_at(press, turn.placed(*press.centre_mm)) for _, press in presses]
        others.append(("place", turn.place, turned))
    for x, y in places:
        text = f"[{x:g}, {y:g}], the place of another press"
        others.append(("place", text, [_at(press, (x, y)) for _, press in presses]))
    views = [shot.view for shot, _ in presses]
    asked = [each for _, _, changed in others for each in zip(changed, views, strict=True)]
    pictures = iter(model(asked))
    left = [_rms([misfit(coarse(shot, next(pictures)), light) for shot, _ in presses]) for _ in others]
    best = int(np.argmin(left))
    if BETTER * left[best] > _rms(stated):
        return None
    what, text, _ = others[best]
    evidence = (
        f"the model misses them by {_rms(stated):.3g} times noise and 1 % of the mean as stated, by "
        f"{left[best]:.2g} with {text}"
    )
    if what == "place":
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
        f"another probe was pressed than {probe.text}, or its size means something else: of spheres "
        "and cylinders the diameter, of a triangle its side",
        f'write probe = "{text}" if that is what was pressed, else the right one',
    )


def _at(press: Press, centre_mm: tuple[float, float]) -> Press:
    return press.model_copy(update={"centre_mm": centre_mm})


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _other_probes(stated: Probe) -> Iterable[Probe]:
    """Other sizes of a probe, and other probes of its size."""
    for factor in OTHER_SIZES:
        yield stated.scaled(factor)
    for kind in OTHER_KINDS:
        if kind != stated.kind:
            yield parse(f"{kind}:{stated.size_mm!r}")
