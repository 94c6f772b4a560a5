"""Whose a failure is: what the command line and the studio tell of an exception."""

from pathlib import Path

import numpy as np
import pytest

from designlab.app.failures import judged
from designlab.sensor.design import preset


def raised(work):
    try:
        work()
    except Exception as error:
        return error
    raise AssertionError("nothing was raised")


def lost():
    raise KeyError("secret")


@pytest.mark.faults
@pytest.mark.parametrize(
    ("work", "cause", "text"),
    [
        (lambda: preset("nothing"), "input", "nothing"),
        (lambda: preset("default").replace({"gelcore.height_mm": -1.0}), "input", "gelcore.height_mm"),
        (
            lambda: Path("/nowhere/at/all").read_bytes(),
            "machine",
            "/nowhere/at/all: No such file",
        ),
        (lambda: np.linalg.inv(np.zeros((2, 2))), "defect", "a defect of designlab: LinAlgError"),
        (lambda: np.zeros(3).reshape(2, 2), "defect", "a defect of designlab: ValueError"),
        (lost, "defect", "a defect of designlab: KeyError: 'secret'"),
    ],
)
def test_whose_a_failure_is(work, cause, text):
    found = judged(raised(work))
    assert found.cause == cause
    assert text in found.text
    assert "\n" not in found.text


@pytest.mark.faults
def test_a_mistake_within_our_own_code_is_no_message():
    """A KeyError has no words for people, wherever it is raised."""
    own = {"__name__": "designlab.somewhere"}
    exec("def look(table):\n    return table['secret']", own)
    assert judged(raised(lambda: own["look"]({}))).cause == "defect"
