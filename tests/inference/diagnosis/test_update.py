"""What of a fit goes into the new model."""

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest

from designlab.inference.diagnosis.emulator.state import State, Unknown
from designlab.inference.diagnosis.likelihood.fit import Fit
from designlab.inference.diagnosis.likelihood.normal_equations import System
from designlab.inference.diagnosis.verdict.intervals import values
from designlab.inference.diagnosis.verdict.update import covariance, domain
from designlab.measurement.shots import Shot
from designlab.sensor.camera import View
from designlab.sensor.design import preset
from designlab.simulation.contact.press import Press
from designlab.simulation.effects import effect
from geometries.probes import sphere, triangle

DESIGN = preset("gelsight-2020-flat")
BLUR_UM, OFFSET = 90.0, 0.01
UNLISTED: dict[str, float] = {}


def fitted() -> tuple[SimpleNamespace, Fit]:
    """A fit of a blur and a black level beside a gain, with made-up information."""
    unknowns = (
        Unknown("point_spread", "sigma_um", 75.0),
        *(Unknown("black_level", channel, 0.015) for channel in "RGB"),
        Unknown("gain", "red", 0.3),
        Unknown("pose", "x", 0.05, 4),
    )
    random = np.random.default_rng(1).standard_normal((6, 9))
    gram = 40 * random @ random.T
    system = System(unknowns, gram, np.zeros(6), 0.0, np.zeros(6))
    levels = {"R": OFFSET, "G": 0.0, "B": 0.0}
    state = State(np.ones(3), values={"point_spread": {"sigma_um": BLUR_UM}, "black_level": levels})
    parameters = {name: effect(name).parameters(DESIGN) for name in state.values}
    fitter = SimpleNamespace(
        forward=SimpleNamespace(parameters=parameters),
        unlisted_sd=lambda _, name, __: UNLISTED.get(name, 0.0),
    )
    return fitter, Fit(state, system, 0.0)


@pytest.fixture
def unlisted() -> Iterator[dict[str, float]]:
    """What the unlisted does to values (prior standard deviations): nothing, unless a test says so."""
    yield UNLISTED
    UNLISTED.clear()


def test_the_covariance_is_that_of_all_unknowns_fitted_together(unlisted) -> None:
    fitter, best = fitted()
    found = covariance(fitter, best)
    assert found is not None
    assert found.parameters == ("point_spread.sigma_um", *(f"black_level.{c}" for c in "RGB"))
    whole = np.linalg.inv(best.system.gram + np.eye(6))[:4, :4]
    unit = np.array([75.0**2, 0.015, 0.015, 0.015])  # of a blur its square is what is fitted
    assert np.array(found.matrix) == pytest.approx(whole * np.outer(unit, unit))


def test_the_intervals_are_those_of_the_covariance(unlisted) -> None:
    fitter, best = fitted()
    found = covariance(fitter, best)
    assert found is not None
    sd = np.sqrt(np.diag(np.array(found.matrix)))
    blur = values(fitter, best, "point_spread", ())["sigma_um"]
    assert blur.value == BLUR_UM
    assert blur.high**2 == pytest.approx(BLUR_UM**2 + 1.96 * sd[0])
    assert blur.low**2 == pytest.approx(max(BLUR_UM**2 - 1.96 * sd[0], 0.0))
    red = values(fitter, best, "black_level", ())["R"]
    assert (red.low, red.high) == pytest.approx((OFFSET - 1.96 * sd[1], OFFSET + 1.96 * sd[1]))


def test_what_no_catalogue_lists_widens_intervals_and_covariance(unlisted) -> None:
    fitter, best = fitted()
    before = np.array(covariance(fitter, best).matrix)  # type: ignore[union-attr]
    fit = values(fitter, best, "black_level", ())["R"]
    unlisted.update(black_level=0.2, point_spread=0.1)
    after = np.array(covariance(fitter, best).matrix)  # type: ignore[union-attr]
    # Of 0.015 a fifth. Of a blur v its square varies, with an error e of a tenth of 75 um, as (v + e)^2 does.
    errors = np.random.default_rng(3).normal(0.0, 7.5, 1_000_000)
    square = np.var((BLUR_UM + errors) ** 2)
    assert np.diag(after - before) == pytest.approx([square, *3 * [0.003**2]], rel=0.01)
    apart = [matrix / np.sqrt(np.outer(np.diag(matrix), np.diag(matrix))) for matrix in (before, after)]
    assert apart[1] == pytest.approx(apart[0])
    found = values(fitter, best, "black_level", ())["R"]
    assert (found.value, found.fit_sd) == (fit.value, fit.fit_sd)
    assert found.high - found.value == pytest.approx(1.96 * np.hypot(fit.fit_sd, 0.003))


def test_a_fit_of_gains_alone_has_none() -> None:
    fitter, best = fitted()
    assert covariance(fitter, Fit(State(np.ones(3)), best.system, 0.0)) is None


def shot(press: Press | None, exposure: float) -> Shot:
    view = View(0.0, 0.0, 8.0, 6.0, 8, 6)
    picture = np.zeros((6, 8, 3))
    lit = np.full(3, exposure)
    return Shot(("f",), "train", press, np.zeros(4), lit, view, picture, picture, picture > -1, np.zeros(3))


def test_the_domain_spans_what_was_fitted() -> None:
    presses = [
        Press(probe=sphere(diameter_mm=4), depth_mm=0.4, centre_mm=(-3.0, 1.0)),
        Press(probe=triangle(side_mm=5), depth_mm=0.9, centre_mm=(2.0, -2.0)),
    ]
    found = domain([shot(None, 0.25), shot(None, 0.0), *(shot(press, 1.0) for press in presses)])
    assert found.depth_mm == (0.4, 0.9)
    assert (found.x_mm, found.y_mm) == ((-3.0, 2.0), (-2.0, 1.0))
    assert found.probes == ("sphere", "triangle")
    assert found.exposure == (0.25, 1.0)
