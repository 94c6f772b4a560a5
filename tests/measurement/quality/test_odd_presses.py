"""Presses that are not as stated are named, in pictures by formula."""

from dataclasses import replace

import numpy as np
import pytest

from designlab.measurement.quality.model_check import against_model
from designlab.measurement.shots import Shot
from designlab.sensor.camera import View
from designlab.simulation.contact.press import Press
from geometries.probes import parse

VIEW = View(0.0, 0.0, 480.0, 360.0, 48, 36)
PITCH_MM = 0.3
TRANSFER = np.array([[1.0, 0.2, 0.1], [0.2, 1.0, 0.2], [0.1, 0.2, 1.0]]) * 0.1
NOISE = 5e-4
PLACES = ((-4.0, -3.0), (4.0, -2.0), (0.0, 3.0), (-3.0, 2.0))


def drawn(asked):
    """Light from three sides, of a pattern that no turn repeats; a press is a dent of the probe's size."""
    row, column = np.indices((VIEW.rows, VIEW.columns))
    x, y = PITCH_MM * (column - 23.5), PITCH_MM * (17.5 - row)
    found = []
    for press, _ in asked:
        sides = [(np.cos(a), np.sin(a)) for a in (0.3, 2.4, 4.5)]
        flat = [
            1 + 0.3 * np.sin(0.5 * x * (1 + c) + 0.4 * y + c) * np.exp(0.1 * (c * x + s * y))
            for c, s in sides
        ]
        if press is not None:
            width = press.probe.size_mm / 4
            u, v = (x - press.centre_mm[0]) / width, (y - press.centre_mm[1]) / width
            dent = 2 * press.depth_mm * np.exp(-(u**2 + v**2) / 2)
            flat = [f + (c * u + s * v) * dent for f, (c, s) in zip(flat, sides, strict=True)]
        found.append(np.stack(flat))
    return found


def pressed(place, probe="sphere:5"):
    return Press(probe=parse(probe), depth_mm=0.6, centre_mm=place)


def photographed(shown, stated=None, *, seed=0):
    """What a press gives that is stated to be another one."""
    basis = drawn([(shown, VIEW)])[0]
    signal = np.moveaxis(np.tensordot(TRANSFER, basis, axes=1), 0, -1)
    signal = signal + NOISE * np.random.default_rng(seed).standard_normal(signal.shape)
    name = "gel.exr" if shown is None else f"press {shown.centre_mm}.exr"
    return Shot(
        files=(name,),
        use="background" if shown is None else "train",
        press=shown if stated is None else stated,
        pose_sigma=np.zeros(4),
        lit=np.ones(3),
        view=VIEW,
        signal=signal,
        variance=np.full_like(signal, NOISE**2),
        valid=np.ones(signal.shape, dtype=bool),
        dark_sigma=np.full(3, NOISE),
    )


def checked(presses, others=drawn):
    shots = [photographed(None), *presses]
    bases = drawn([(shot.press, shot.view) for shot in shots])
    return against_model(shots, bases, black=np.zeros(3), transfer=TRANSFER, response="linear", others=others)


def test_presses_as_stated_are_not_accused():
    found = checked([photographed(pressed(place), seed=n) for n, place in enumerate(PLACES)])
    assert found.suspicions == ()
    assert found.missed.passed
    assert found.missed.figure.count("at most") == 2


@pytest.mark.parametrize(
    ("stated", "text"),
    [
        (lambda x, y: (x, -y), "[x, -y]"),
        (lambda x, y: (-x, y), "[-x, y]"),
        (lambda x, y: (-x, -y), "[-x, -y]"),
        (lambda x, y: (y, x), "[y, x]"),
    ],
)
def test_places_noted_in_another_frame_are_named(stated, text):
    shots = [photographed(pressed(place), pressed(stated(*place))) for place in PLACES]
    (found,) = checked(shots).suspicions
    assert (found.name, found.remedy) == ("place", f"write centre_mm = {text}")
    assert found.files == tuple(shot.files[0] for shot in shots)


@pytest.mark.parametrize(("shown", "stated"), [("sphere:5", "sphere:2.5"), ("sphere:5", "sphere:10")])
def test_another_size_is_named(shown, stated):
    shots = [photographed(pressed(place, shown), pressed(place, stated)) for place in PLACES]
    (found,) = checked(shots).suspicions
    assert found.name == "probe"
    assert f'probe = "{shown}"' in found.remedy
    assert stated in found.cause


def test_two_files_that_were_exchanged_are_named_each_with_its_place():
    places = (*PLACES, (3.0, 3.0), (-1.0, -3.5), (5.0, 1.0))
    shots = [photographed(pressed(place)) for place in places]
    shots[0] = photographed(pressed(places[0]), pressed(places[4]))
    shots[4] = photographed(pressed(places[4]), pressed(places[0]))
    first, second = checked(shots).suspicions
    assert {first.name, second.name} == {"place"}
    assert "[-4, -3], the place of another press" in first.remedy
    assert "[3, 3], the place of another press" in second.remedy


def test_a_picture_of_something_else_is_odd():
    shots = [photographed(pressed(place)) for place in (*PLACES, (3.0, 3.0))]
    shots[1] = replace(shots[1], signal=1.5 * np.roll(shots[1].signal, 20, axis=1))
    checks = checked(shots)
    (found,) = checks.suspicions
    assert (found.name, found.files, found.strong) == ("odd", shots[1].files, True)
    assert not checks.missed.passed


def test_poses_that_are_still_to_be_fitted_are_not_looked_at():
    shots = [photographed(pressed((x, y)), pressed((x, -y))) for x, y in PLACES]
    assert checked(shots, others=None).suspicions == ()
