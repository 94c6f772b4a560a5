"""What an evaluation finds of a design: its scores, and the pictures and maps that they were taken from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from designlab.evaluation.illumination_scores import Estimate, TransportError
from designlab.evaluation.press_plan import PressPlan
from designlab.evaluation.protocol import Reconstruction
from designlab.evaluation.weakest_point import GelMaps, Place
from designlab.sensor.design import Design
from designlab.simulation.simulator import Frame

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Score:
    """A score holds what an evaluation found of a design.

    Each of `scores` is an attribute too, for example ``score.normal_error_median_deg``.

    Attributes
    ----------
    design, digest : str
        Name of the design, and digest of the design or the sensor model.
    fidelity : str
        Effort of the evaluation.
    seed : int
        Seed of places, render noise and camera noise.
    press_plan : PressPlan
        How deep and in which area the gel was pressed.
    scores : mapping of str to Estimate
        The scores; of figures that each LED group has, that of the worst group.
    groups : mapping of str to mapping of str to Estimate
        Figures of each LED group.
    worst : mapping of str to Place
        Worst place of the untouched gel (``gel``) and of the test presses (``press``), see `weakest_point`.
    presses : mapping of str to sequence of float
        Figures of each test press, of which the scores of presses are pooled, with what render noise adds;
        at equal force also how deep it went, in mm.
    margins : mapping of str to float
        Signed distance to each geometric rule in mm; positive means violated.
    light : TransportError
        How far the light may be off, relative to its mean.
    seconds : mapping of str to float
        Time that each part took, in s.
    warnings : sequence of str
        Where a sensor model was used beyond what it was fitted to, and what of it is not simulated.
    made_from, not_buildable : str
        Preset that the design was made from, with the differences, and why it cannot be built as simulated;
        empty where there is neither.
    """

    design: str
    digest: str
    fidelity: str
    seed: int
    press_plan: PressPlan
    scores: Mapping[str, Estimate]
    margins: Mapping[str, float]
    light: TransportError
    seconds: Mapping[str, float] = field(default_factory=dict)
    groups: Mapping[str, Mapping[str, Estimate]] = field(default_factory=dict)
    worst: Mapping[str, Place] = field(default_factory=dict)
    presses: Mapping[str, Sequence[float]] = field(default_factory=dict)
    warnings: Sequence[str] = ()
    made_from: str = ""
    not_buildable: str = ""

    def __getattr__(self, name: str) -> Estimate:
        """Look a score up by name."""
        scores: Mapping[str, Estimate] = self.__dict__.get("scores", {})
        if name in scores:
            return scores[name]
        raise AttributeError(f"no score {name!r}; there are {', '.join(scores)}")

    def __repr__(self) -> str:
        """Name, effort and number of scores in a line."""
        return f"Score({self.design!r}, {self.fidelity}, seed {self.seed}: {len(self.scores)} scores)"

    def table(self) -> "pd.DataFrame":
        """All scores as a table: value, standard error and unit of each."""
        import pandas as pd

        rows = [(name, e.value, e.se, e.unit) for name, e in self.scores.items()]
        return pd.DataFrame(rows, columns=["score", "value", "se", "unit"]).set_index("score")

    def _repr_html_(self) -> str:
        """What a notebook shows of it."""
        return self.table().to_html(float_format="{:.4g}".format)

    def to_json(self) -> dict[str, Any]:
        """Return the content as plain data."""
        return {
            "design": self.design,
            "made_from": self.made_from,
            "not_buildable": self.not_buildable,
            "digest": self.digest,
            "fidelity": self.fidelity,
            "seed": self.seed,
            "press_plan": self.press_plan.to_json(),
            "scores": _plain(self.scores),
            "groups": {name: _plain(figures) for name, figures in self.groups.items()},
            "worst": {name: place._asdict() for name, place in self.worst.items()},
            "presses": {
                # A figure that a press does not have is not a number, which JSON does not know.
                name: [None if np.isnan(value) else value for value in values]
                for name, values in self.presses.items()
            },
            "margins": dict(self.margins),
            "light": self.light._asdict(),
            "seconds": dict(self.seconds),
            "warnings": list(self.warnings),
        }


def _plain(estimates: Mapping[str, Estimate]) -> dict[str, dict[str, Any]]:
    return {
        name: {"value": e.value, "se": e.se, "bias_bound": e.bias_bound, "unit": e.unit}
        for name, e in estimates.items()
    }


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A score, with the pictures and maps that it was taken from.

    Attributes
    ----------
    score : Score
        The scores.
    design : Design
        The design as simulated, the effects of a sensor model that change it included.
    exposure : float
        Signal of the camera per unit of radiance.
    untouched : Frame
        The untouched gel.
    gel : GelMaps
        What it looks like, pixel by pixel.
    presses : sequence of Reconstruction
        The test presses.
    """

    score: Score
    design: Design
    exposure: float
    untouched: Frame
    gel: GelMaps
    presses: Sequence[Reconstruction]
