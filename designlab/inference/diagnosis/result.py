"""What a diagnosis finds: data, which `report` puts into words and pictures."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

from designlab.core import __version__
from designlab.core.types import Array, Mask
from designlab.measurement import Measurement
from designlab.measurement.quality.invariants import FrameCheck
from designlab.measurement.shots import Observations, Shot
from designlab.sensor.design import Design
from designlab.simulation.effects import SensorModel, effect

FORMAT = 1
"""Version of the report's fields; a number means the same fields in every release."""

Verdict = Literal["named", "ambiguous", "partial", "unexplained", "at_floor"]


@dataclass(frozen=True)
class Value:
    """A fitted parameter with the ends of its 95 % interval, None where they are not known.

    `null` is where the effect does nothing, `sd` how large it usually is, `bounds` what it cannot exceed.
    `fit_sd` is the error by the fit alone, which does not know of what no catalogue lists.
    """

    value: float
    low: float | None
    high: float | None
    unit: str
    null: float
    sd: float
    bounds: tuple[float, float]
    fit_sd: float | None = None


@dataclass(frozen=True)
class Found:
    """An effect that was named.

    Attributes
    ----------
    confidence : float
        Share of right names among those that looked like it on generated sets with known answers, see
        `verdict.confidence`, limited by what weakens the verdict. Of a single picture: one over the
        number of effects that do as well, limited likewise; not calibrated.
    coherence_set : tuple of str
        Effects that explain these frames as well, itself included.
    summary : str
        What it is, in words.
    transferable : bool
        Whether it holds for new designs too, or belongs to this unit.
    """

    name: str
    parameters: Mapping[str, Value]
    confidence: float
    coherence_set: tuple[str, ...]
    summary: str = ""
    transferable: bool = True

    @classmethod
    def of(
        cls, name: str, parameters: Mapping[str, Value], confidence: float, coherence_set: tuple[str, ...]
    ) -> Self:
        """Name an effect of the catalogue, which says what it is."""
        known = effect(name)
        return cls(name, parameters, confidence, coherence_set, known.summary, known.transferable)


@dataclass(frozen=True)
class Where:
    """Part of the excess: a region of the picture in one channel.

    Attributes
    ----------
    frames : str
        background, press or dark.
    share : float
        Of the whole excess over the noise floor.
    area : float
        Share of all values that were compared.
    times : float
        Excess of a value here over that in the mean of the same channel and frames: a region stands out where
        it is well above 1.
    mean_z : float
        Signed mean of measured minus simulated, in standard deviations.
    """

    region: str
    channel: str
    frames: str
    share: float
    area: float
    times: float
    mean_z: float


@dataclass(frozen=True)
class Level:
    """Mean squared residual in units of the noise: given model, updated model, and the floor.

    The floor is what noise, grain and the errors granted to the simulation may leave, `usual` what the
    updated model leaves as noise, grain and smooth errors of light; without grain at most 0.75 floors.
    """

    before: float
    after: float
    floor: float
    usual: float

    @property
    def removed(self) -> float | None:
        """Share of the excess over what is usual that the update takes away; None where there was none."""
        excess = self.before - self.usual
        return (self.before - self.after) / excess if excess > 0 else None


@dataclass(frozen=True)
class Unexplained:
    """What the effects named leave of the gap, and what it looks like.

    Attributes
    ----------
    share, low, high : float or None
        Share of the gap on presses that were not fitted to, and its 95 % interval; None where there is no gap
        or too few presses tell.
    smooth_rms : float
        Smooth departure of the light of each LED group over the picture, relative.
    grain_rms : float
        Grain of single frames that repeats share, relative to their light.
    parts : mapping of str to float
        Shares of all that is left beyond noise of the camera: ``smooth``, ``grain``, ``edges`` of presses.
    frame, group : str or None
        A frame, or the frame of an LED group, that leaves far more than the others.
    """

    share: float | None
    low: float | None
    high: float | None
    smooth_rms: float
    grain_rms: float
    parts: Mapping[str, float]
    frame: str | None = None
    group: str | None = None


@dataclass(frozen=True)
class Candidate:
    """One candidate that was tried, accepted or not; `gain` and `se` are shares of the first gap.

    `seconds` is what its fit took; None for those that were only screened.
    """

    round: int
    name: str
    outcome: str
    gain: float | None = None
    se: float | None = None
    improved: float | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    evidence: float | None = None
    seconds: float | None = None


@dataclass(frozen=True)
class Overlap:
    """Share of what an effect does to these frames that another can bring about."""

    effect: str
    by: str
    share: float


@dataclass(frozen=True)
class Control:
    """A wrong effect of about as many parameters as those named, and the share of the gap it takes away."""

    name: str
    removed: float
    parameters: int


@dataclass(frozen=True)
class Advice:
    """What to measure next, how far it would separate what is not told apart (sd), and minutes in the lab.

    `frames` are the frames in the fields of a measurement file, without their files; empty where words say
    more.
    """

    text: str
    separation_sd: float | None = None
    minutes: float | None = None
    frames: tuple[Mapping[str, Any], ...] = ()

    def __str__(self) -> str:
        words = [self.text]
        if self.minutes is not None:
            words.append(f" (about {self.minutes:g} min)")
        if self.separation_sd is not None:
            words.append(f": there they differ by {self.separation_sd:.2g} standard deviations")
        return "".join(words)


class Prediction(NamedTuple):
    """What a model predicts of a shot, and by how much a right one may miss it.

    All arrays have shape (rows, columns, 3): the signal, the standard deviation of what residuals are counted
    in, and the part of it that noise of the camera and errors granted to the simulation leave.
    """

    signal: Array
    sigma: Array
    granted: Array


@dataclass(frozen=True, eq=False)
class ShotComparison:
    """A shot beside the predictions of models, by what a model is called: as given, updated."""

    shot: Shot
    predictions: Mapping[str, Prediction]


@dataclass(frozen=True, eq=False)
class PressComparison:
    """The final press that the model as given misses by most and the untouched gel, beside predictions.

    Attributes
    ----------
    press, untouched : ShotComparison
        The two shots.
    contact : bool array, shape (rows, columns)
        Pixels of the press that see the contact.
    x_mm, y_mm : array, shape (rows, columns)
        Points of the untouched gel that its pixels see.
    design : Design
        The sensor.
    """

    press: ShotComparison
    untouched: ShotComparison
    contact: Mask
    x_mm: Array
    y_mm: Array
    design: Design


@dataclass(frozen=True, eq=False)
class PictureComparison:
    """A single picture beside those of the model as given and of the corrected one.

    Attributes
    ----------
    measured, given, corrected : array, shape (rows, columns, 3)
        Linear pictures; light and pose are fitted.
    fitted : bool array, shape (rows, columns)
        Pixels of the blocks that were fitted to.
    """

    measured: Array
    given: Array
    corrected: Array
    fitted: Mask


@dataclass(frozen=True)
class GapReport:
    """Result of a diagnosis; ``docs/gap.md`` explains every field that `to_json` gives.

    Attributes
    ----------
    seen : Observations
        What was fitted to and judged by, which decides what a diagnosis cannot know.
    barred : tuple of str
        Reserves for which a name has fallen.
    shown : PressComparison or PictureComparison, optional
        What pictures of the diagnosis show.
    """

    verdict: Verdict
    effects: tuple[Found, ...]
    where: tuple[Where, ...]
    gap: Mapping[str, Level]
    next_measurement: Advice
    updated: SensorModel
    model: Path
    candidates: tuple[Candidate, ...]
    notes: tuple[str, ...]
    provenance: Mapping[str, Any]
    seen: Observations = field(compare=False)
    control: Control | None = None
    unexplained: Unexplained | None = None
    overlaps: tuple[Overlap, ...] = ()
    checks: tuple[FrameCheck, ...] = ()
    reserves: tuple[str, ...] = ()
    barred: tuple[str, ...] = ()
    shown: PressComparison | PictureComparison | None = field(default=None, compare=False)

    def to_json(self) -> dict[str, Any]:
        """Plain data, ready for JSON, without what `report` says of it in words and pictures."""
        return {
            "format": FORMAT,
            "verdict": self.verdict,
            "effects": [asdict(effect) for effect in self.effects],
            "where": [vars(where) for where in self.where],
            "gap": {split: vars(level) | {"removed": level.removed} for split, level in self.gap.items()},
            "control": None if self.control is None else vars(self.control),
            "unexplained": None if self.unexplained is None else asdict(self.unexplained),
            "next_measurement": str(self.next_measurement),
            "next": vars(self.next_measurement),
            "overlaps": [vars(overlap) for overlap in self.overlaps],
            "model": str(self.model),
            "candidates": [vars(c) | {"parameters": dict(c.parameters)} for c in self.candidates],
            "notes": list(self.notes),
            "provenance": dict(self.provenance),
            "checks": [vars(check) | {"files": list(check.files)} for check in self.checks],
            "reserves": list(self.reserves),
        }


def provenance(
    measurement: Measurement, seen: Observations, model: SensorModel, *, seed: int, samples: int
) -> dict[str, Any]:
    """What every report says of how it was made; frames, pictures rendered and seconds come on top."""
    return {
        "measurement": measurement.name,
        "model": model.digest,
        "seed": seed,
        "samples": samples,
        "noise": seen.noise_source,
        "floor": "measured" if seen.repeats else "assumed",
        "version": __version__,
    }
