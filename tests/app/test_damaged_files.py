"""Damaged files of every kind through the command line: a line of refusal, or a picture of something."""

import fuzz_files
import numpy as np
import pytest

pytestmark = [
    pytest.mark.faults,
    pytest.mark.renders,
    pytest.mark.slow,
    pytest.mark.filterwarnings("default"),  # notes on what was understood are no faults
]


def in_bounds(files: int, seed: int) -> None:
    """Try so many files; state what must hold of all."""
    before = fuzz_files.peak_gb()  # of all tests that this process has run
    found = fuzz_files.fuzz(files, seed=seed)
    assert [(one.case.number, one.fault) for one in found if one.fault] == []
    assert np.quantile([one.seconds for one in found], 0.95) < 5
    assert fuzz_files.peak_gb() - before < 2


def test_sixty_damaged_files():
    in_bounds(60, seed=3)


@pytest.mark.full
def test_a_thousand_damaged_files():
    in_bounds(1000, seed=0)


def test_cases_follow_from_seed_and_number():
    good = {kind: {"a.json": b'{"fx": 500, "fy": 500}'} for kind in fuzz_files.SHARES}
    one, again, other = (fuzz_files.case(7, good, seed) for seed in (1, 1, 2))
    assert one == again
    assert one.data != other.data
