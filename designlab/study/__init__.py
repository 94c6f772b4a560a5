"""Studies: search designs for the best scores, resumably; sweeps over full grids."""

from designlab.bounds import Bound
from designlab.study.defaults import default_parameters
from designlab.study.definition import Plan, Study, StudyError, dumps_study, load_study
from designlab.study.front import history, pareto
from designlab.study.parameter import Parameter
from designlab.study.results import Results, importance, load_results
from designlab.study.robust import Robust
from designlab.study.runner import StudyInterrupted, run_study
from designlab.study.shortlist import picks
from designlab.study.sweep import SweepInterrupted, optimise, sweep

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
