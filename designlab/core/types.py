"""Types that every room shares."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Array of floating-point numbers."""

Single = NDArray[np.float32]
"""Array of floating-point numbers in single precision: pictures, light."""

Mask = NDArray[np.bool_]
"""Array of truth values."""

Progress = Callable[[str, int, int], None]
"""Called with the name of a stage, the number of its steps that are done, and the number of all its steps."""
