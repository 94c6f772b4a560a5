"""Normal equations and evidence against dense linear algebra written out in full."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.fft import dct, idctn
from scipy.stats import multivariate_normal

from designlab.inference.diagnosis.emulator.state import State, Unknown
from designlab.inference.diagnosis.likelihood.noise import (
    LONG_LENGTH,
    SHOT_BUDGET,
    SMOOTH_ALIKE,
    SMOOTH_BUDGET,
    SMOOTH_LENGTH,
    WEAK,
    MonteCarloNoise,
    Noise,
    spectrum,
)
from designlab.inference.diagnosis.likelihood.normal_equations import (
    ALIKE,
    System,
    fitted_size,
    log_evidence,
    system,
)
from designlab.inference.diagnosis.selection.confounding import overlaps

ROWS, COLUMNS = 5, 6
SHAPE = (ROWS, COLUMNS, 3)
UNKNOWNS = [Unknown("gain", "red", 1.0), Unknown("a", "p", 1.0), Unknown("pose", "x_mm", 1.0, 0)]


class Known:
    """Two shots with given signals, predictions and derivatives."""

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng(seed)
        self.derivatives = random.standard_normal((2, len(UNKNOWNS), *SHAPE))
        self.derivatives[1, 2] = 0.0  # the pose of the first shot
        self.signals = random.standard_normal((2, *SHAPE))
        self.valid = random.random((2, *SHAPE)) > 0.1
        shots = [SimpleNamespace(signal=s, valid=v) for s, v in zip(self.signals, self.valid, strict=True)]
        self.bank = SimpleNamespace(shots=shots)

    def linear(self, state: object, number: int, unknowns: list[Unknown]) -> tuple[np.ndarray, np.ndarray]:
        columns = self.derivatives[number][[UNKNOWNS.index(u) for u in unknowns]]
        return np.zeros(SHAPE), columns.astype(np.float32)


def noises(level: float, grain: MonteCarloNoise | None = None) -> list[Noise]:
    sigma = np.full(SHAPE, 0.5)  # of every value
    colours = level * np.array([[0.9, 0.2, 0.3], [0.1, 0.8, 0.7]])
    # The light of one group falls off to the right, that of the other downwards.
    right, down = np.linspace(1.5, 0.5, COLUMNS)[None, :, None], np.linspace(0.2, 1.8, ROWS)[:, None, None]
    lit = np.stack([right * colours[0] * np.ones(SHAPE), down * colours[1] * np.ones(SHAPE)])
    bright = np.full(3, 1.2 * level)
    return [
        Noise(
            sigma,
            sigma,
            sigma,
            bright * (1 + n),
            np.full(3, level) * (1 + n),
            (1 + n) * lit.astype("f"),
            grain,
        )
        for n in range(2)
    ]


def correlation(power: np.ndarray) -> np.ndarray:
    """Covariance over the pixels of a picture whose cosine coefficients have some power, (pixels, pixels)."""
    across, down = (dct(np.eye(n), axis=0, norm="ortho") for n in (COLUMNS, ROWS))
    transform = np.kron(down, across)
    return transform.T @ np.diag(power.ravel()) @ transform


def smooth_covariance(length: float = SMOOTH_LENGTH, *, with_mean: bool = True) -> np.ndarray:
    """Covariance over the pixels of a picture of the smooth error of unit variance, (pixels, pixels)."""
    power = spectrum((ROWS, COLUMNS), length)
    power[0, 0] *= with_mean
    return correlation(power)


def test_smooth_errors_have_unit_variance_and_are_alike_next_to_each_other() -> None:
    covariance = smooth_covariance()
    assert np.trace(covariance) / len(covariance) == pytest.approx(1.0)
    assert covariance[14, 15] > 0.2  # neighbours in a row


def coarse() -> np.ndarray:
    """Power that falls with frequency, one in the mean."""
    power = 1.0 / (1.0 + np.add.outer(np.arange(ROWS) ** 2, np.arange(COLUMNS) ** 2))
    return np.asarray(power / power.mean())


@pytest.mark.parametrize(
    ("grainy", "alike", "smooth_rms"),
    [(0.0, ALIKE, 0.0), (0.9, ALIKE, 0.0), (0.0, 1.0, 0.0), (0.0, ALIKE, 0.02), (0.9, 1.0, 0.02)],
)
def test_normal_equations_are_those_of_the_dense_covariance(
    grainy: float, alike: float, smooth_rms: float
) -> None:
    # Of the variance of every value `grainy` is grain; 0.1 and, where twice as bright, 0.4 are shared.
    power, relative = coarse(), 0.1 / 200.0**2
    grain = (
        MonteCarloNoise(np.full(SHAPE, 0.5 * np.sqrt(grainy)), np.full(3, relative), power)
        if grainy
        else None
    )
    known, own = Known(3), noises(200.0, grain)
    state = State(np.ones(2), smooth_rms=smooth_rms)
    found = system(known, state, [0, 1], UNKNOWNS, own, np.zeros(3), alike=alike)  # type: ignore[arg-type]
    # Of a misfit divided by `alike`, smooth errors are to weigh as if divided by no more than `SMOOTH_ALIKE`.
    granted = SMOOTH_BUDGET**2 * min(SMOOTH_ALIKE / alike, 1.0)
    smooth, rough = smooth_covariance(), correlation(power)
    without = np.zeros((3, 2 * ROWS * COLUMNS, 3, 2 * ROWS * COLUMNS))
    for channel in range(3):
        levels = [noise.all_level[channel] for noise in own]
        apart = [
            (1 - grainy) * np.eye(ROWS * COLUMNS) + (SHOT_BUDGET * noise.level[channel]) ** 2 * smooth
            for noise in own
        ]
        shared = granted * np.kron(np.outer(levels, levels), smooth_covariance(with_mean=False))
        if grainy:
            for k, level in enumerate(levels):
                apart[k] += (grainy - relative * level**2) * rough
            shared += relative * np.kron(np.outer(levels, levels), rough)
        zero = np.zeros_like(smooth)
        without[channel, :, channel] = np.block([[apart[0], zero], [zero, apart[1]]]) + shared
    size = 6 * ROWS * COLUMNS
    covariance = without.reshape(size, size)
    logdet = -np.linalg.slogdet(covariance)[1]
    # Of each group one error, relative to its light, in all channels and shots. Its size is fitted, so it
    # counts in full.
    power = spectrum((ROWS, COLUMNS), LONG_LENGTH)
    power[0, 0] = 0.0
    long = correlation(np.where(power > WEAK * power.max(), power, 0.0)) / alike
    for group in range(2):
        light = np.stack([noise.groups[group] for noise in own])
        lit = np.moveaxis(light, -1, 0).reshape(6, ROWS * COLUMNS)  # channels, then shots
        each = np.concatenate([np.diag(part) for part in lit])
        covariance = covariance + smooth_rms**2 * each @ long @ each.T
    inverse = np.linalg.inv(covariance)
    logdet += np.linalg.slogdet(covariance)[1]
    scale = np.where(known.valid, 2.0, 0.0)
    columns = np.swapaxes(known.derivatives, 0, 1) * scale
    rows = np.moveaxis(columns, -1, 1).reshape(3, -1).T
    left = np.moveaxis(known.signals * scale, -1, 0).ravel()
    gram, right, misfit = rows.T @ inverse @ rows, rows.T @ inverse @ left, left @ inverse @ left
    np.testing.assert_allclose(alike * found.gram, gram, rtol=2e-4, atol=2e-4 * np.abs(gram).max())
    np.testing.assert_allclose(alike * found.right, right, atol=2e-4 * np.abs(gram).max())
    assert alike * (found.misfit - logdet) == pytest.approx(misfit, rel=1e-4)


def test_what_is_judged_given_other_shots_adds_up_to_both_together() -> None:
    known, own, state = Known(3), noises(200.0), State(np.ones(2), smooth_rms=0.02)
    both, first = (
        system(known, state, shots, UNKNOWNS, own, np.zeros(3))  # type: ignore[arg-type]
        for shots in ([0, 1], [0])
    )
    second = system(known, state, [1], UNKNOWNS, own, np.zeros(3), known=first.shared)  # type: ignore[arg-type]
    alone = system(known, state, [1], UNKNOWNS, own, np.zeros(3))  # type: ignore[arg-type]
    assert first.misfit + second.misfit == pytest.approx(both.misfit, rel=1e-6)
    assert abs(alone.misfit - second.misfit) > 0.01 * both.misfit


@pytest.mark.parametrize("hidden", [0.0, 0.01, 0.04])
def test_the_size_of_smooth_errors_of_groups_is_found(hidden: float) -> None:
    """Pictures lit by one group each and by both; the light of each is off by a smooth error of its own."""
    random = np.random.default_rng(5)
    shape, lit, sigma = (48, 64, 3), ([1, 0], [0, 1], [1, 1], [1, 1]), 0.002
    power = np.sqrt(spectrum((48, 64), LONG_LENGTH))
    power[0, 0] = 0.0
    fields = [idctn(power * random.standard_normal(shape[:2]), norm="ortho")[..., None] for _ in range(2)]
    light = np.array([[0.9, 0.2, 0.0], [0.0, 0.3, 0.8]])
    falls = np.linspace(2.0, 0.2, 64)[None, :, None]  # from one side to the other
    shots, own = [], []
    for groups in lit:
        parts = [on * colour * falls * np.ones(shape) for on, colour in zip(groups, light, strict=True)]
        error = sum(part * hidden * field for part, field in zip(parts, fields, strict=True))
        shots.append(SimpleNamespace(signal=error + sigma * random.standard_normal(shape), valid=error < 1))
        level = np.sqrt((sum(parts) ** 2).mean(axis=(0, 1))) / sigma
        all_ = np.full(shape, sigma)
        own.append(Noise(all_, all_, all_, level, level, np.array(parts, dtype=np.float32) / sigma))
    known = SimpleNamespace(
        bank=SimpleNamespace(shots=shots), linear=lambda *_: (np.zeros(shape), np.zeros((0, *shape)))
    )
    state = State(np.ones(2))
    found = system(known, state, range(4), (), own, np.zeros(0), alike=1.0)  # type: ignore[arg-type]
    # Where nothing is hidden, chance makes half of the most likely sizes more than none.
    assert fitted_size(found.shared.values(), 1.0) == pytest.approx(hidden, rel=0.25, abs=0.003)


def test_evidence_is_the_ratio_of_marginal_likelihoods() -> None:
    random = np.random.default_rng(0)
    matrix, data = random.standard_normal((8, 2)), random.standard_normal(8)
    with_effect = multivariate_normal(np.zeros(8), np.eye(8) + matrix @ matrix.T).logpdf(data)
    without = multivariate_normal(np.zeros(8), np.eye(8)).logpdf(data)
    assert log_evidence(matrix.T @ matrix, matrix.T @ data) == pytest.approx(with_effect - without)


def quadratic(seed: int, now: np.ndarray) -> System:
    random = np.random.default_rng(seed)
    matrix, data = random.standard_normal((20, 3)), random.standard_normal(20)
    return System(tuple(UNKNOWNS), matrix.T @ matrix, matrix.T @ data, float(data @ data), now)


def test_reducing_is_marginalising() -> None:
    whole = quadratic(1, np.zeros(3))
    information, _ = whole.reduced([1])
    covariance = np.linalg.inv(whole.gram + np.eye(3))
    assert information[0, 0] + 1.0 == pytest.approx(1.0 / covariance[1, 1])


def test_a_step_reaches_the_least_penalised_misfit() -> None:
    from scipy.optimize import minimize

    now = np.array([0.3, -0.2, 0.1])
    whole = quadratic(2, now)

    def objective(step: np.ndarray) -> float:
        return float(step @ whole.gram @ step - 2 * whole.right @ step + ((now + step) ** 2).sum())

    low, high = np.array([0.0, -np.inf, -0.05]), np.array([np.inf, 0.4, 0.05])
    step, fallen = whole.step(low, high)
    best = minimize(objective, np.zeros(3), bounds=list(zip(low - now, high - now, strict=True)))
    np.testing.assert_allclose(step, best.x, atol=1e-4)
    assert fallen == pytest.approx(objective(np.zeros(3)) - best.fun, rel=1e-6)


def test_a_step_bears_information_that_rounding_has_made_negative() -> None:
    """Differences of large sums in single precision: the information of one direction is -3 in place of 0."""
    gram = np.diag([1e8, 50.0, -3.0])
    whole = System(tuple(Unknown("a", str(k), 1.0) for k in range(3)), gram, np.ones(3), 0.0, np.zeros(3))
    step, _ = whole.step(np.full(3, -0.01), np.full(3, 0.01))
    assert (np.abs(step) <= 0.01).all()
    np.testing.assert_allclose(step[:2], [1e-8, 0.01], rtol=1e-6)


@pytest.mark.parametrize("seed", range(20))
def test_a_step_leaves_a_bound_where_what_is_held_elsewhere_asks_for_it(seed: int) -> None:
    random = np.random.default_rng(seed)
    columns = random.standard_normal((8, 6)) + 2.0 * random.standard_normal((8, 1))
    right = 5.0 * columns.T @ random.standard_normal(8)
    unknowns = tuple(Unknown("a", str(k), 1.0) for k in range(6))
    whole = System(unknowns, columns.T @ columns, right, 0.0, np.zeros(6))
    step, _ = whole.step(np.zeros(6), np.full(6, 0.7))
    # At the least misfit within bounds the gradient points out of them (Karush, Kuhn and Tucker).
    slope = right - (whole.gram + np.eye(6)) @ step
    assert (step >= 0.0).all()
    assert (step <= 0.7).all()
    np.testing.assert_allclose(slope[(step > 1e-9) & (step < 0.7 - 1e-9)], 0.0, atol=1e-6)
    assert (slope[step <= 1e-9] <= 1e-6).all()
    assert (slope[step >= 0.7 - 1e-9] >= -1e-6).all()


def test_overlap_is_the_squared_cosine_between_what_two_effects_do() -> None:
    random = np.random.default_rng(4)
    one, other, nuisance = np.linalg.qr(random.standard_normal((60, 3)))[0].T * 1e3
    turned = 0.8 * one + 0.6 * other
    columns = np.stack([one + 5 * nuisance, turned - 2 * nuisance, other, nuisance], axis=-1)
    unknowns = tuple(Unknown(name, "p", 1.0) for name in ("a", "b", "c", "gain"))
    found = System(unknowns, columns.T @ columns, np.zeros(4), 0.0, np.zeros(4))
    table = overlaps(found, ["a", "b", "c"])
    assert table["a", "b"] == pytest.approx(0.64, abs=1e-3)
    assert table["b", "a"] == pytest.approx(0.64, abs=1e-3)
    assert table["a", "c"] == pytest.approx(0.0, abs=1e-3)
    assert ("a", "gain") not in table


def test_a_part_is_brought_about_by_the_whole_but_not_the_other_way_round() -> None:
    columns = 1e3 * np.eye(5)[:, [0, 0, 1]]
    unknowns = (Unknown("a", "p", 1.0), Unknown("b", "p", 1.0), Unknown("b", "q", 1.0))
    found = System(unknowns, columns.T @ columns, np.zeros(3), 0.0, np.zeros(3))
    table = overlaps(found, ["a", "b"])
    assert table["a", "b"] == pytest.approx(1.0, abs=1e-3)
    assert table["b", "a"] == pytest.approx(0.5, abs=1e-3)
