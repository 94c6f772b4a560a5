"""How far errors go together, on noise that is made to."""

import numpy as np

from designlab.measurement.residuals import spread_of


def test_residuals_that_go_together_count_by_the_blocks_in_which_they_do() -> None:
    random = np.random.default_rng(3)
    alone = random.standard_normal((384, 384, 3))
    together = np.kron(3.0 * random.standard_normal((96, 96, 3)), np.ones((4, 4, 1)))
    valid = np.ones(alone.shape, dtype=bool)
    spread, needed = spread_of(alone, valid)
    np.testing.assert_allclose(spread, 1.0, rtol=0.2)
    assert needed == 1
    # A sum over a block of 16 that err alike by 3 has the variance 9 x 16^2, 9 x 16 a value.
    spread, needed = spread_of(together, valid)
    np.testing.assert_allclose(spread, 9.0 * 16, rtol=0.2)
    assert needed == 4
