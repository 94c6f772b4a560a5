"""The linear elastic response of a layer that is bonded to a rigid base."""

import cmath
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from designlab.core.types import Array

SHALLOW = 1e-3  # wave number times thickness below which the response is its limit of long waves
DEEP = 50.0  # above it the layer answers as a half space; sinh of more would overflow


@dataclass(frozen=True)
class ElasticLayer:
    """An elastic layer is a homogeneous, isotropic sheet on a rigid base that it does not slip on.

    Parameters
    ----------
    modulus_mpa : float
        Young's modulus in MPa, above 0.
    poisson : float
        Poisson's ratio, above 0, at most 0.5; at 0.5 the layer keeps its volume.
    thickness_mm : float
        Thickness in mm, above 0.

    Raises
    ------
    ValueError
        If a value is out of its bounds; the text names field, value and rule.
    """

    modulus_mpa: float
    poisson: float
    thickness_mm: float

    def __post_init__(self) -> None:
        for field, unit in (("modulus_mpa", "MPa"), ("thickness_mm", "mm")):
            value = getattr(self, field)
            if not 0 < value < math.inf:
                raise ValueError(f"{field}: must be above 0 {unit} and finite, got {value:g}")
        if not 0 < self.poisson <= 0.5:
            raise ValueError(f"poisson: must lie above 0 and be at most 0.5, got {self.poisson:g}")

    @property
    def shear_modulus_mpa(self) -> float:
        """Shear modulus in MPa."""
        return self.modulus_mpa / (2 * (1 + self.poisson))

    @cached_property
    def decay_per_mm(self) -> float:
        """How fast the surface settles far from a load: its height falls as exp(-decay r) (1/mm).

        That is the imaginary part of the wave number nearest to the real axis at which the layer gives way
        without load: 0.74 to 0.91 over the thickness.
        """
        nu, x = self.poisson, 1.1 + 0.74j  # of nu 1/2, from which Newton's method finds the others
        for _ in range(60):
            value = (3 - 4 * nu) * cmath.cosh(2 * x) + 2 * x**2 + 5 - 12 * nu + 8 * nu**2
            x -= value / (2 * (3 - 4 * nu) * cmath.sinh(2 * x) + 4 * x)
        return abs(x.imag) / self.thickness_mm

    def normal(self, wavenumber: Array) -> Array:
        """Displacement along the normal per unit pressure.

        Parameters
        ----------
        wavenumber : array
            Wave numbers of the pressure (1/mm).

        Returns
        -------
        array
            Displacement into the layer in mm per MPa; at nu = 1/2 it vanishes at wave number 0.
        """
        x = wavenumber * self.thickness_mm
        a, _, _ = self._shares(x)
        nu = self.poisson
        uniform = (1 - 2 * nu) / (2 * (1 - nu))  # a layer under uniform pressure
        # What long waves add to it, from the series of the closed form.
        long_waves = uniform + self._curvature() * x**2
        with np.errstate(divide="ignore", invalid="ignore"):
            whole = np.where(x < SHALLOW, long_waves, (1 - nu) * a / x)
        return np.asarray(whole * self.thickness_mm / self.shear_modulus_mpa)

    def along(self, wavenumber: Array) -> Array:
        """Displacement along the wave per unit of tangential traction along it (mm per MPa)."""
        x = wavenumber * self.thickness_mm
        _, b, _ = self._shares(x)
        with np.errstate(divide="ignore", invalid="ignore"):
            whole = np.where(x < SHALLOW, 1.0, (1 - self.poisson) * b / x)
        return np.asarray(whole * self.thickness_mm / self.shear_modulus_mpa)

    def across(self, wavenumber: Array) -> Array:
        """Displacement across the wave per unit of tangential traction across it (mm per MPa)."""
        x = wavenumber * self.thickness_mm
        with np.errstate(divide="ignore", invalid="ignore"):
            whole = np.where(x < SHALLOW, 1.0, np.tanh(x) / x)
        return np.asarray(whole * self.thickness_mm / self.shear_modulus_mpa)

    def coupling(self, wavenumber: Array) -> Array:
        """Displacement along the wave per unit pressure, a quarter of a wave later (mm per MPa).

        It is positive where a pressed layer is squeezed out sideways, and negative where, as on a
        compressible half space, its surface is drawn towards the load.
        """
        x = wavenumber * self.thickness_mm
        _, _, c = self._shares(x)
        with np.errstate(divide="ignore", invalid="ignore"):
            whole = np.where(x < 1e-6, 0.0, c / x)
        return np.asarray(whole * self.thickness_mm / self.shear_modulus_mpa)

    def _shares(self, x: Array) -> tuple[Array, Array, Array]:
        """Return the three functions of wave number times thickness, 1, 1 and a constant for short waves.

        They solve Navier's equations for a layer with zero displacement at its base; hyperbolic functions
        are divided by exp(2 x), which would overflow.
        """
        nu = self.poisson
        x = np.minimum(x, DEEP)
        decay = np.exp(-2 * x)
        cosh2, sinh2 = (1 + decay**2) / 2, (1 - decay**2) / 2
        sinh_squared = (cosh2 - decay) / 2
        stiffness = 3 - 4 * nu
        bottom = stiffness * cosh2 + (2 * x**2 + 5 - 12 * nu + 8 * nu**2) * decay
        a = (stiffness * sinh2 - 2 * x * decay) / bottom
        b = (stiffness * sinh2 + 2 * x * decay) / bottom
        c = (x**2 * decay - stiffness * (1 - 2 * nu) * sinh_squared) / bottom
        return a, b, c

    def _curvature(self) -> float:
        """Second-order term of the normal response for long waves, in x."""
        # (1 - nu) a / x with a = n1 x + n3 x^3 over d0 + d2 x^2.
        nu = self.poisson
        stiffness = 3 - 4 * nu
        n1, n3 = 2 * stiffness - 2, stiffness * 8 / 6
        d0, d2 = stiffness + 5 - 12 * nu + 8 * nu**2, 2 * stiffness + 2
        return (1 - nu) * (n3 / d0 - n1 * d2 / d0**2)
