"""A fit moves the unknowns of a measurement by damped Gauss-Newton steps."""

from collections.abc import Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.forward import Forward
from designlab.inference.diagnosis.emulator.snapshots import Bank
from designlab.inference.diagnosis.emulator.state import FRINGES, SIZE, State, Unknown
from designlab.inference.diagnosis.likelihood.empirical_errors import (
    dirt_looks_like,
    dirt_sd,
    over_dirt,
    unlisted_sd,
)
from designlab.inference.diagnosis.likelihood.monte_carlo_noise import monte_carlo_noise
from designlab.inference.diagnosis.likelihood.noise import SMOOTH_ALIKE, Noise, noise
from designlab.inference.diagnosis.likelihood.normal_equations import (
    ALIKE,
    Shared,
    System,
    fitted_size,
    system,
)
from designlab.measurement.shots import POSE
from designlab.sensor.design import DesignError
from designlab.simulation.effects import CATALOGUE, EffectParameter, effect

GAIN_SD = 0.3  # of LED groups: what their products with the albedo are off by before anything is fitted
SIZE_SD = 0.01  # of a probe, relative: 0.05 mm of 5 mm, as printed and machined ones are off by
FRINGES_SD = 0.002  # of lateral colour, relative: a fifth of a pixel at the edge of 200 columns (estimate)
BOUND_SD = 5.0  # of poses, sizes of probes and lateral colour
BEYOND_SD = 3.0  # prior standard deviations from null that speak against an effect
SURELY = 2.0  # standard deviations by which what no catalogue lists may have moved a value that far
DIRTY = 100.0  # evidence for smooth errors of light from which a sensor has a lab's dirt
AT_BOUND = 0.01  # share of a parameter's range that counts as its bound
ITERATIONS = 12
ALONG = ("gain", "numerical", SIZE, FRINGES)  # fitted with every effect
TRUST = 1.5  # prior standard deviations that an effect moves at once
SETTLED = 0.5  # fall of half the misfit below which a fit has converged
SETTLED_SHARE = 2e-6  # likewise, of the misfit


@dataclass(frozen=True, eq=False)
class Fit:
    """Where a fit ended, the system of its unknowns there, and the penalised misfit."""

    state: State
    system: System
    objective: float


class Fitter:
    """Fits states to the shots of a bank.

    Parameters
    ----------
    bank : Bank
        Pictures and shots.

    Attributes
    ----------
    noises : list of Noise
        Of each shot, see `measure`.
    alike, smooth_alike : float
        Neighbouring values that count as one, see `normal_equations.ALIKE`, and the same for smooth errors.
    grain : float
        Of single frames, relative to their light, see `grain.grain`.
    known : mapping of shape to Shared
        What other shots have shown of the error that all share, see `given`.
    """

    def __init__(self, bank: Bank) -> None:
        self.bank = bank
        self.forward = Forward(bank)
        self.noises: list[Noise] = []
        self.alike = ALIKE
        self.smooth_alike = SMOOTH_ALIKE
        self.grain = 0.0
        self.known: Mapping[tuple[int, ...], Shared] = {}

    @property
    def fits_smooth(self) -> bool:
        """Whether the size of the smooth error that shots share is fitted: where frames have grain.

        Built sensors have both. Without grain what looks like that error is rather an effect.
        """
        return self.grain > 0

    def of(self, bank: Bank, noises: list[Noise]) -> "Fitter":
        """Fitter of other pictures and noise that counts values as this one does."""
        other = Fitter(bank)
        other.noises, other.alike, other.smooth_alike = noises, self.alike, self.smooth_alike
        other.grain = self.grain
        return other

    def start(self, shots: Sequence[int]) -> State:
        """Gains by linear least squares, by brightness: a wrong model must not let dark values decide.

        Raises
        ------
        ValueError
            If the light of a group does not fit the measurement at all.
        """
        design = self.forward.design
        groups = len(design.leds.groups)
        unit, dark = State(np.ones(groups)), State(np.zeros(groups))
        unknowns = [Unknown("gain", name, 1.0) for name in design.group_names]
        matrix, right = np.zeros((groups, groups)), np.zeros(groups)
        for number in shots:
            shot = self.bank.shots[number]
            columns = self.forward.linear(unit, number, unknowns)[1][:, shot.valid].astype(float)
            signal = (shot.signal - self.forward.predict(dark, number))[shot.valid]
            matrix += columns @ columns.T
            right += columns @ signal
        for name, light in zip(design.group_names, np.diag(matrix), strict=True):
            if not light > 0:
                raise ValueError(f"measurement: no frame is lit by the LED group {name!r} of the model")
        gains = np.linalg.solve(matrix, right)
        for name, gain in zip(design.group_names, gains, strict=True):
            if not gain > 0:
                raise ValueError(
                    f"model: the light of LED group {name!r} fits the measurement only with a negative gain, "
                    f"{gain:.3g}: is it dead or off, or are groups, places or colour channels mixed up?"
                )
        state = State(np.asarray(gains))
        self.measure(state)
        return state

    def measure(self, state: State) -> None:
        """Set the noise of all shots by what a state predicts."""
        forward, black = self.forward, self.forward.black
        random = monte_carlo_noise(forward, state)
        self.noises = [
            noise(
                shot,
                forward.predict(state, n),
                forward.untouched(state, n),
                forward.of_groups(state, n) if self.fits_smooth else None,
                black,
                random[n],
                grain=self.grain,
            )
            for n, shot in enumerate(self.bank.shots)
        ]

    def chance(self, shots: Sequence[int]) -> tuple[float, float]:
        """Misfit that noise of camera and grain leave of shots, and how many independent values they are."""
        least = values = 0.0
        for number in shots:
            valid, own = self.bank.shots[number].valid, self.noises[number]
            least += float(((own.camera / own.sigma) ** 2)[valid].sum())
            values += float(valid.sum())
        return least / self.alike, values / self.alike

    def of_smooth(self, found: "Fit") -> float:
        """Logarithm of the Bayes factor of the smooth error that shots share, against none of it."""
        if not self.fits_smooth:
            return 0.0
        parts = [part.explained(found.state.smooth_rms) for part in found.system.shared.values()]
        return sum(0.5 * float(less / self.alike - logdet) for less, logdet in parts)

    def unknowns(
        self, state: State, names: Collection[str], shots: Sequence[int], *, gains: bool = True
    ) -> list[Unknown]:
        """Parameters of effects, gains, the simulation's own error, and what each shot has alone.

        That error is a rival of every effect and is fitted with each: what a finer mesh explains is none. So
        are sizes of probes, which no lab knows exactly: a smaller punch looks as if the lens magnified less;
        and lateral colour, which no lens is without: it shifts the light of each colour its own way. Of an
        effect's finer form those are unknown that the state has.
        """
        found = [
            Unknown(name, p.name, p.sd)
            for name in names
            for p in self.forward.parameters.get(name, ())
            if not effect(name).drawn and p.name in self.forward.values(state, name)
        ]
        if gains:
            found.append(Unknown("numerical", "amount", 1.0))
            found.append(Unknown(FRINGES, "red", FRINGES_SD))
            found += [
                Unknown("gain", name, GAIN_SD * float(gain))
                for name, gain in zip(self.forward.design.group_names, state.gains, strict=True)
            ]
        pressed = [press for number in shots if (press := self.bank.shots[number].press) is not None]
        probes = dict.fromkeys(press.probe.text for press in pressed)
        found += [Unknown(SIZE, probe, SIZE_SD) for probe in probes if gains or probe not in state.sizes]
        for number in shots:
            shot = self.bank.shots[number]
            if shot.press is not None:
                found += [
                    Unknown("pose", axis, float(sigma), number)
                    for axis, sigma in zip(POSE, shot.pose_sigma, strict=True)
                    if sigma > 0
                ]
            if not shot.lit.any():
                continue
            for e in CATALOGUE:
                if e.draws is not None and e.name in names:
                    found += [Unknown(e.name, str(k), e.draws.sd, number) for k in range(e.draws.count)]
        return found

    def given(self, known: Mapping[tuple[int, ...], Shared]) -> "Fitter":
        """Return the same for shots that are judged given what others have shown of the error all share."""
        other = copy(self)
        other.known = known
        return other

    def system(self, state: State, shots: Sequence[int], unknowns: Sequence[Unknown]) -> System:
        """Normal equations at a state."""
        now = np.array([self._now(state, u) for u in unknowns])
        return system(
            self.forward,
            state,
            shots,
            unknowns,
            self.noises,
            now,
            alike=self.alike,
            smooth_alike=self.smooth_alike,
            known=self.known,
        )

    def _now(self, state: State, u: Unknown) -> float:
        """Where an unknown is, in prior standard deviations from its null."""
        if u.effect == "gain":
            return 0.0  # no gain is more likely than another about where the fit stands
        if u.effect == "pose":
            return float(state.pose(u.shot)[POSE.index(u.name)] / u.sd)
        if u.shot >= 0:
            drawn = state.drawn.get(u.effect, {}).get(u.shot)
            return 0.0 if drawn is None else float(drawn[int(u.name)] / u.sd)
        if u.effect == "numerical":
            return state.numerical
        if u.effect == SIZE:
            return state.sizes.get(u.name, 0.0) / u.sd
        if u.effect == FRINGES:
            return state.fringes / u.sd
        values = state.values.get(u.effect)
        if values is None:
            return 0.0
        return self.forward.parameter(u).coordinate(values[u.name])

    def bounds(self, unknowns: Sequence[Unknown]) -> tuple[Array, Array]:
        """Bounds of unknowns in prior standard deviations from null."""
        low, high = np.full(len(unknowns), -np.inf), np.full(len(unknowns), np.inf)
        for k, u in enumerate(unknowns):
            if u.effect in ("pose", SIZE, FRINGES):
                low[k], high[k] = -BOUND_SD, BOUND_SD
            elif u.effect in self.forward.parameters and u.shot < 0:
                p = self.forward.parameter(u)
                ends = p.coordinate(p.low), p.coordinate(p.high)
                low[k], high[k] = (0.0, ends[1]) if p.squared else ends
        return low, high

    def moved(self, state: State, unknowns: Sequence[Unknown], step: Array) -> State:
        """Take a step, in prior standard deviations."""
        gains = state.gains.copy()
        values = {name: dict(own) for name, own in state.values.items()}
        poses = {number: pose.copy() for number, pose in state.poses.items()}
        drawn = {name: dict(own) for name, own in state.drawn.items()}
        numerical, sizes, fringes = state.numerical, dict(state.sizes), state.fringes
        for u, change in zip(unknowns, step, strict=True):
            if u.effect == "gain":
                group = self.forward.design.group_names.index(u.name)
                gains[group] = max(gains[group] + change * u.sd, 0.02 * gains[group])
            elif u.effect == "pose":
                pose = poses.setdefault(u.shot, np.zeros(len(POSE)))
                pose[POSE.index(u.name)] += change * u.sd
            elif u.shot >= 0:
                own, draws = drawn.setdefault(u.effect, {}), effect(u.effect).draws
                assert draws is not None
                own[u.shot] = own.get(u.shot, np.zeros(draws.count)).copy()
                own[u.shot][int(u.name)] += change * u.sd
            elif u.effect == "numerical":
                numerical += float(change)
            elif u.effect == SIZE:
                sizes[u.name] = sizes.get(u.name, 0.0) + float(change) * u.sd
            elif u.effect == FRINGES:
                fringes += float(change) * u.sd
            else:
                p = self.forward.parameter(u)
                own_values = values.setdefault(u.effect, effect(u.effect).null(self.bank.model.design))
                own_values[p.name] = p.value_at(p.coordinate(own_values[p.name]) + float(change))
        return replace(
            state,
            gains=gains,
            values=values,
            poses=poses,
            drawn=drawn,
            numerical=numerical,
            sizes=sizes,
            fringes=fringes,
        )

    def fit(
        self,
        state: State,
        names: Collection[str],
        shots: Sequence[int],
        *,
        gains: bool = True,
        held: Collection[str] = (),
    ) -> Fit:
        """Fit effects, gains and what shots have alone.

        Parameters
        ----------
        names : collection of str
            Effects whose parameters are fitted; those of the state that are not named stay.
        shots : sequence of int
            Shots to fit to.
        gains : bool
            Whether gains are fitted, and the size of the smooth error that shots share.
        held : collection of str
            Effects of the state whose own draws of each shot are fitted though their parameters stay.
        """
        wanted = [*names, *(name for name in held if effect(name).draws is not None)]
        for name in wanted:
            if name not in state.values and name in self.forward.parameters:
                state = state.with_values(name, effect(name).null(self.bank.model.design))
        unknowns = self.unknowns(state, wanted, shots, gains=gains)
        state, found, objective = self._sized(state, shots, unknowns, fitted=gains)
        low, high = self.bounds(unknowns)
        for _ in range(ITERATIONS):
            step, predicted = found.step(low, high)
            if predicted < 2 * SETTLED:
                break
            step = _within_trust(found, step, low, high)
            for _ in range(4):
                there = self.moved(state, unknowns, step)
                reached = self._objective(there, shots, unknowns)
                if reached < objective:
                    break
                step = step * 0.4
            else:
                break
            before = objective
            state, found, objective = self._sized(there, shots, unknowns, fitted=gains)
            if before - objective < max(2 * SETTLED, SETTLED_SHARE * before):
                break
        return Fit(state, found, objective)

    def _sized(
        self, state: State, shots: Sequence[int], unknowns: Sequence[Unknown], *, fitted: bool
    ) -> tuple[State, System, float]:
        """State with the likeliest size of the smooth error, if that is fitted, and what it gives."""
        found = self.system(state, shots, unknowns)
        if fitted and self.fits_smooth:
            likely = fitted_size(found.shared.values(), self.alike)
            if likely != state.smooth_rms:
                state = replace(state, smooth_rms=likely)
                found = self.system(state, shots, unknowns)
        return state, found, found.misfit + float(found.now @ found.now)

    def _objective(self, state: State, shots: Sequence[int], unknowns: Sequence[Unknown]) -> float:
        """Penalised misfit; infinite where no such sensor can be."""
        now = np.array([self._now(state, u) for u in unknowns])
        try:
            return self.system(state, shots, ()).misfit + float(now @ now)
        except DesignError:
            return float("inf")

    def beyond_prior(self, found: Fit, name: str) -> tuple[str, ...]:
        """Names of parameters of an effect that are surely further from null than its prior makes likely."""
        values = found.state.values[name]

        def most(p: EffectParameter) -> float:
            return float(p.sd * (BEYOND_SD + SURELY * self.unlisted_sd(found, name, p)))

        own = (p for p in self.forward.parameters[name] if p.name in values and not p.shape)
        return tuple(p.name for p in own if abs(values[p.name] - p.null) > most(p))

    def dirty(self, found: Fit) -> bool:
        """Whether the sensor has a lab's dirt beside the effects of a fit: grain and smooth errors."""
        return self.of_smooth(found) > DIRTY

    def unlisted_sd(self, found: Fit, name: str, p: EffectParameter) -> float:
        """What no catalogue lists does to a fitted value, in prior standard deviations."""
        return unlisted_sd(name, p.name, shape=p.shape, dirty=self.dirty(found))

    def beyond_dirt(self, found: Fit, name: str) -> bool:
        """Whether an effect is surely larger than what a lab's dirt makes of it by itself (Wald's test)."""
        if not dirt_looks_like(name) or not self.dirty(found):
            return True
        shapes = {p.name for p in self.forward.parameters[name] if p.shape}
        unknowns = found.system.unknowns
        places = [
            k for k, u in enumerate(unknowns) if u.effect == name and u.shot < 0 and u.name not in shapes
        ]
        away = np.array([self._now(found.state, unknowns[k]) for k in places])
        information, _ = found.system.reduced(places)
        return over_dirt(away, information, dirt_sd(name)) > 1

    def at_bound(self, state: State, name: str) -> tuple[str, ...]:
        """Names of parameters of an effect that ended at a bound which is not their null."""
        values, found = state.values[name], []
        for p in self.forward.parameters[name]:
            if p.shape or p.name not in values:
                continue  # its pictures are of its usual value, from which its bounds may be far
            room = AT_BOUND * (p.high - p.low)
            below, above = values[p.name] - p.low < room, p.high - values[p.name] < room
            if (below and not p.one_sided) or (above and not p.whole):
                found.append(p.name)
        return tuple(found)


def log_score(misfit: Array | float, values: Array | float) -> Array:
    """Log score of shots whose errors are at least as large as they are known to be.

    The likelihood of Gaussian errors at their most likely size, which is what was granted where no more is
    left. Beyond, a share of the misfit counts the same, however large the misfit is: a wrong model must not
    gain the more by taking a little of it away, the more it leaves.

    Parameters
    ----------
    misfit, values : array or float
        Penalised misfit in units of errors known, and number of independent values.
    """
    size = np.maximum(np.asarray(misfit) / values, 1.0)
    return np.asarray(-0.5 * (misfit / size + values * np.log(size)))


def _within_trust(found: System, step: Array, low: Array, high: Array) -> Array:
    """Damp a step that goes further than derivatives can be trusted (Levenberg 1944)."""
    effects = np.array([u.shot < 0 and u.effect not in ALONG for u in found.unknowns])
    damping = 1e-8 * float(np.diag(found.gram).max(initial=0.0))
    while effects.any() and np.abs(step[effects]).max() > TRUST and damping < np.diag(found.gram).max():
        damping *= 10.0
        step, _ = found.step(low, high, damping=damping)
    return step


def with_strength(state: State, name: str) -> State:
    """Give an effect that acts by draws of each shot the strength of those draws."""
    own = effect(name).draws
    if own is None or name not in state.drawn:
        return state
    draws = np.array(list(state.drawn[name].values()))
    strength = float(np.sqrt((draws**2).sum(axis=1).mean()))
    return state.with_values(name, {**state.values[name], own.strength: strength})
