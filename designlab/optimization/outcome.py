"""One evaluation as plain data, whatever becomes of it: it can cross processes and be stored as JSON."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Protocol, TypeVar

from designlab.core.plain import plain
from designlab.sensor.design import Design, DesignError, InfeasibleDesign
from designlab.sensor.feasibility import RULES

if TYPE_CHECKING:
    from designlab.evaluation.press_plan import PressPlan
    from designlab.reconstruction import KernelCalibration
    from designlab.simulation.effects.model import SensorModel

Subject = TypeVar("Subject", bound="Design | SensorModel")


class Evaluator(Protocol):
    """What turns a design into scores; the result has ``scores``, and may have ``seconds``."""

    def __call__(self, design: Any, /, *, fidelity: str, seed: int) -> Any:
        """Return the score of a feasible design, or of the sensor model it makes with the study's effects."""


@dataclass(frozen=True)
class Simulated:
    """Scores a design by simulation, with `designlab.evaluation.evaluate.evaluate`.

    Attributes
    ----------
    presses : PressPlan, optional
        How deep and where gels are pressed, the same for all; each as is usual for it without.
    all_scores : bool
        Whether to find scores that need presses of their own at every fidelity.
    as_built : bool
        Whether it is a sensor as it was built, which may have lost some of its view.
    calibration : KernelCalibration, optional
        That of another sensor of the kind; each is calibrated on its own without.
    """

    presses: "PressPlan | None" = None
    all_scores: bool = False
    as_built: bool = False
    calibration: "KernelCalibration | None" = None

    def __call__(self, design: "Design | SensorModel", /, *, fidelity: str, seed: int) -> Any:
        """Return the score of a design."""
        from designlab.evaluation.evaluate import evaluate

        found = evaluate(
            design,
            fidelity=fidelity,
            seed=seed,
            presses=self.presses,
            all_scores=self.all_scores,
            calibration=self.calibration,
            as_built=self.as_built,
        )
        return found.score


class Prepared(NamedTuple, Generic[Subject]):
    """What can be evaluated; or None, why not in words, and the rules that it breaks with their margins."""

    subject: Subject | None
    reason: str = ""
    broken: Mapping[str, float] = {}


def prepared(make: Callable[[], Subject], *, as_built: bool = False) -> Prepared[Subject]:
    """Make a design or sensor model, unless its fields do not go together or it breaks a rule."""
    from designlab.simulation.effects.model import SensorModel

    try:
        subject = make()
        design = SensorModel.of(subject).effective_design()
    except DesignError as error:
        return Prepared(None, str(error).removeprefix("replace(): "))
    broken = design.broken(as_built=as_built)
    return Prepared(None, ", ".join(broken), broken) if broken else Prepared(subject)


def told(broken: Mapping[str, float]) -> str:
    """Rules that a design breaks, by how much, and what they demand."""
    return "; ".join(f"{rule} by {margin:.2g} mm: {RULES[rule]}" for rule, margin in broken.items())


def evaluate_design(
    evaluator: Evaluator, subject: "Design | SensorModel", fidelity: str, seed: int
) -> dict[str, Any]:
    """Evaluate one design; plain data, so that it can cross processes and be stored as JSON.

    Returns
    -------
    dict
        ``scores`` (name to ``value``, ``se``, ``bias_bound``, ``unit``), ``margins`` and ``seconds``; or
        ``infeasible`` with the reason and the rules ``broken``, or ``failed`` with the reason. Any
        other exception is a defect and passes through.
    """
    from designlab.mechanics.contact import NotConverged
    from designlab.simulation.simulator import RenderFailed

    try:
        score = evaluator(subject, fidelity=fidelity, seed=seed)
    except InfeasibleDesign as error:
        return {"infeasible": str(error), "broken": error.broken}
    except (RenderFailed, NotConverged) as error:
        return {"failed": str(error)}
    scores = {
        name: {
            "value": plain(estimate.value),
            "se": plain(estimate.se),
            "bias_bound": plain(estimate.bias_bound),
            "unit": estimate.unit,
        }
        for name, estimate in score.scores.items()
    }
    warnings = list(getattr(score, "warnings", ()))
    seconds = getattr(score, "seconds", None)
    found = {"scores": scores, "seconds": dict(seconds) if isinstance(seconds, Mapping) else seconds}
    return found | {"warnings": warnings} if warnings else found
