"""Trials of the gap workflow: measurement sets with known answers, diagnosed blind, and the score of that."""

from designlab.trials.blind import calibration, sealed
from designlab.trials.pool import Trial, development, power, quick
from designlab.trials.runner import Crew, Outcome, run
from designlab.trials.score import record, score, scored
from designlab.trials.transfer import Transferred, run_transfers, transfers

__all__ = [
    "Crew",
    "Outcome",
    "Transferred",
    "Trial",
    "calibration",
    "development",
    "power",
    "quick",
    "record",
    "run",
    "run_transfers",
    "score",
    "scored",
    "sealed",
    "transfers",
]
