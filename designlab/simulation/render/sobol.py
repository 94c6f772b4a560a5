"""Points spread evenly in a few dimensions: Sobol' sequence, scrambled."""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.simulation.render.engine import dr, mi
from designlab.simulation.render.tables import held

BITS = 32
# Degree s, coefficients a and initial numbers m of the primitive polynomials of dimensions 2 to 5, from
# new-joe-kuo-6.21201: Joe and Kuo, SIAM J. Sci. Comput. 30, 2635 (2008).
POLYNOMIALS = (
    (1, 0, (1,)),
    (2, 1, (1, 3)),
    (3, 1, (1, 3, 1)),
    (3, 2, (1, 1, 1)),
)
DIMENSIONS = len(POLYNOMIALS) + 1


@cache
def directions() -> NDArray[np.uint32]:
    """Direction numbers, shape (dimensions, bits)."""
    table = np.zeros((DIMENSIONS, BITS), dtype=np.uint64)
    table[0] = [1 << (BITS - 1 - bit) for bit in range(BITS)]
    for row, (degree, coefficients, initial) in zip(table[1:], POLYNOMIALS, strict=True):
        for bit in range(BITS):
            if bit < degree:
                row[bit] = initial[bit] << (BITS - 1 - bit)
                continue
            value = int(row[bit - degree]) ^ (int(row[bit - degree]) >> degree)
            for k in range(1, degree):
                if coefficients >> (degree - 1 - k) & 1:
                    value ^= int(row[bit - k])
            row[bit] = value
    return table.astype(np.uint32)


def points(first: int, size: int, seeds: NDArray[np.integer[Any]]) -> list[Any]:
    """Coordinates below one of points `first` to `first + size`, a Dr.Jit array for each dimension.

    Nested uniform (Owen) scrambling by a hash of the bits above each one, after Laine and Karras, Comput.
    Graph. Forum 30, 1265 (2011), with the constants of N. Vegdahl. Unlike a lattice it has no wavelengths at
    which the error adds up.

    Parameters
    ----------
    first, size : int
        Which points of the sequence.
    seeds : array of int below 2**32, shape (dimensions,)
        Randomise the sequence.
    """
    index = dr.arange(mi.UInt32, size) + held(first)
    found = []
    for row, seed in zip(directions(), seeds, strict=True):
        bits = mi.UInt32(0)
        for bit, number in enumerate(row.tolist()):
            bits ^= dr.select((index >> bit) & 1 == 1, mi.UInt32(number), mi.UInt32(0))
        # The top 24 bits are exact in single precision and never reach one.
        found.append(mi.Float(_scrambled(bits, int(seed)) >> 8) * float(2.0**-24))
    return found


def _scrambled(bits: Any, seed: int) -> Any:
    x = dr.brev(bits)
    x ^= x * 0x3D20ADEA
    x += held(seed)
    x *= held((seed >> 16) | 1)
    x ^= x * 0x05526C56
    x ^= x * 0x53A22864
    return dr.brev(x)
