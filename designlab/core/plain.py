"""Plain data are what JSON can hold."""

import math
import os
from typing import Any


def plain(value: Any) -> Any:
    """Return data that JSON can hold: numbers without a finite value are None, for which it has no word.

    Keys of mappings become text, tuples lists, paths text, and NumPy scalars numbers.
    """
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, os.PathLike):
        return str(value)
    if hasattr(value, "item") and not hasattr(value, "__len__"):  # a NumPy scalar
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
