"""One evaluation as plain data, whatever becomes of it: it can cross processes and be stored as JSON."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from designlab.design import Design, InfeasibleDesign

if TYPE_CHECKING:
    from designlab.effects.model import SensorModel
    from designlab.reconstruct import KernelCalibration


class Evaluator(Protocol):
    """What turns a design into scores; the result has ``scores``, and may have ``seconds``."""

    def __call__(self, design: Any, /, *, fidelity: str, seed: int) -> Any:
        """Return the score of a feasible design, or of the sensor model it makes with the study's effects."""


def default_evaluator(design: "Design | SensorModel", /, *, fidelity: str, seed: int) -> Any:
    """Score a design by simulation, with `designlab.evaluate.evaluate`."""
    from designlab.evaluate import evaluate

    return evaluate(design, fidelity=fidelity, seed=seed)


@dataclass(frozen=True)
class CalibratedOnce:
    """Scores designs with the calibration of another sensor of the kind, see `designlab.evaluate`."""

    calibration: "KernelCalibration"

    def __call__(self, design: "Design | SensorModel", /, *, fidelity: str, seed: int) -> Any:
        """Return the score of a feasible design."""
        from designlab.evaluate import evaluate

        return evaluate(design, fidelity=fidelity, seed=seed, calibration=self.calibration)


def evaluate_design(
    evaluator: Evaluator, subject: "Design | SensorModel", fidelity: str, seed: int
) -> dict[str, Any]:
    """Evaluate one design; plain data, so that it can cross processes and be stored as JSON.

    Returns
    -------
    dict
        ``scores`` (name to ``value``, ``se``, ``bias_bound``, ``unit``), ``margins`` and ``seconds``; or
        ``infeasible`` or ``failed`` with the reason. Any other exception is a defect and passes through.
    """
    from designlab.simulate import RenderFailed

    try:
        score = evaluator(subject, fidelity=fidelity, seed=seed)
    except InfeasibleDesign as error:
        return {"infeasible": str(error)}
    except RenderFailed as error:
        return {"failed": str(error)}
    scores = {
        name: {
            "value": _finite(estimate.value),
            "se": _finite(estimate.se),
            "bias_bound": _finite(estimate.bias_bound),
            "unit": estimate.unit,
        }
        for name, estimate in score.scores.items()
    }
    warnings = list(getattr(score, "warnings", ()))
    found = {"scores": scores, "seconds": _plain(score, "seconds")}
    return found | {"warnings": warnings} if warnings else found


def _finite(value: Any) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None


def _plain(score: Any, name: str) -> Any:
    found = getattr(score, name, None)
    return dict(found) if isinstance(found, Mapping) else found
