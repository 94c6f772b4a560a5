"""Studies: search designs for the best scores, resumably; sweeps over full grids."""

from designlab.optimization.constraint import Bound
from designlab.optimization.study.defaults import default_parameters
from designlab.optimization.study.definition import Plan, Study, StudyError, dumps_study, load_study
from designlab.optimization.study.front import history, pareto
from designlab.optimization.study.parameter import Parameter
from designlab.optimization.study.results import Results, importance, load_results
from designlab.optimization.study.robust import Robust
from designlab.optimization.study.runner import StudyInterrupted, run_study
from designlab.optimization.study.shortlist import picks
from designlab.optimization.study.sweep import SweepInterrupted, optimise, sweep

__all__ = [
    "Bound",
    "Parameter",
    "Plan",
    "Results",
    "Robust",
    "Study",
    "StudyError",
    "StudyInterrupted",
    "SweepInterrupted",
    "default_parameters",
    "dumps_study",
    "history",
    "importance",
    "load_results",
    "load_study",
    "optimise",
    "pareto",
    "picks",
    "run_study",
    "sweep",
]
