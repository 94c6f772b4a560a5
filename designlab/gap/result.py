"""What a diagnosis says."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from designlab.effects.model import SensorModel
from designlab.measurement.invariants import Check

Verdict = Literal["named", "ambiguous", "partial", "unexplained", "at_floor"]


@dataclass(frozen=True)
class Value:
    """A fitted parameter with the ends of its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Found:
    """An effect that was named.

    Attributes
    ----------
    confidence : float
        Share of the effect in the evidence of those that do as well, limited by the number of held-out
        presses; not calibrated.
    coherence_set : tuple of str
        Effects that explain these frames as well, itself included.
    """

    name: str
    parameters: Mapping[str, Value]
    confidence: float
    coherence_set: tuple[str, ...]


@dataclass(frozen=True)
class Where:
    """Part of the excess: a region of the picture in one channel.

    Attributes
    ----------
    frames : str
        background or press.
    share : float
        Of the whole excess over the noise floor.
    mean_z : float
        Signed mean of measured minus simulated, in standard deviations.
    """

    region: str
    channel: str
    frames: str
    share: float
    mean_z: float


@dataclass(frozen=True)
class Level:
    """Mean squared residual in units of the noise: given model, updated model, and the noise floor."""

    before: float
    after: float
    floor: float


@dataclass(frozen=True)
class Candidate:
    """One candidate that was tried, accepted or not; `gain` and `se` are shares of the first gap."""

    round: int
    name: str
    outcome: str
    gain: float | None = None
    se: float | None = None
    improved: float | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    evidence: float | None = None


@dataclass(frozen=True)
class GapReport:
    """Result of a diagnosis."""

    verdict: Verdict
    effects: tuple[Found, ...]
    where: tuple[Where, ...]
    gap: Mapping[str, Level]
    next_measurement: str
    updated: SensorModel
    model: Path
    candidates: tuple[Candidate, ...]
    notes: tuple[str, ...]
    provenance: Mapping[str, Any]
    pictures: Mapping[Path, str] = field(default_factory=dict)
    checks: tuple[Check, ...] = ()
    reserves: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        return {
            "verdict": self.verdict,
            "effects": [
                {
                    "name": effect.name,
                    "parameters": {name: vars(value) for name, value in effect.parameters.items()},
                    "confidence": effect.confidence,
                    "coherence_set": list(effect.coherence_set),
                }
                for effect in self.effects
            ],
            "where": [vars(where) for where in self.where],
            "gap": {split: vars(level) for split, level in self.gap.items()},
            "next_measurement": self.next_measurement,
            "model": str(self.model),
            "candidates": [vars(c) | {"parameters": dict(c.parameters)} for c in self.candidates],
            "notes": list(self.notes),
            "provenance": dict(self.provenance),
            "pictures": {str(path): caption for path, caption in self.pictures.items()},
            "checks": [vars(check) | {"files": list(check.files)} for check in self.checks],
            "reserves": list(self.reserves),
        }

    @property
    def summary(self) -> str:
        """A few lines for people."""
        lines = [f"verdict: {self.verdict}"]
        for effect in self.effects:
            others = [name for name in effect.coherence_set if name != effect.name]
            or_else = f", not told apart from {', '.join(others)}" if others else ""
            lines.append(f"{effect.name} (confidence {effect.confidence:.2f}, not calibrated{or_else})")
            for name, v in effect.parameters.items():
                lines.append(f"  {name} = {v.value:.4g} [{v.low:.4g}, {v.high:.4g}] {v.unit}".rstrip(" 1"))
        for split, level in self.gap.items():
            lines.append(
                f"{split}: mean squared residual {level.before:.3f} before, {level.after:.3f} after, "
                f"floor {level.floor:.3f}"
            )
        for place in self.where[:3]:
            lines.append(
                f"{place.share:.0%} of the excess: {place.region}, channel {place.channel} ({place.frames})"
            )
        if self.next_measurement:
            lines.append(f"measure next: {self.next_measurement}")
        return "\n".join([*lines, f"model: {self.model}"])
