"""Plain data are what JSON can hold."""

import json
from pathlib import Path

import numpy as np

from designlab.core.plain import plain


def test_what_json_cannot_hold_is_replaced():
    data = {
        1: (np.float32(0.5), np.int64(3), float("nan")),
        "b": [np.float64("inf"), Path("a/b"), None, True],
    }
    assert plain(data) == {"1": [0.5, 3, None], "b": [None, "a/b", None, True]}
    json.dumps(plain(data), allow_nan=False)
