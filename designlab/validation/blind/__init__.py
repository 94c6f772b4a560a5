"""The blind benchmark diagnoses measurement sets with known answers, and scores the diagnoses."""

from designlab.validation.blind.pool import Trial, development, power, quick
from designlab.validation.blind.runner import Crew, Outcome, run
from designlab.validation.blind.score import record, score, scored
from designlab.validation.blind.sealed_pools import calibration, sealed
from designlab.validation.blind.transfer import Transferred, run_transfers, transfers

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
