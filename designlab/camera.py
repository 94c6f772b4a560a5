"""The camera: from linear radiance on the sensor to digital counts."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from geometries.spec import Spec, quantity


class View(NamedTuple):
    """A rectangle of the full sensor, in its pixels, shown by `columns` x `rows` output pixels."""

    x_px: float
    y_px: float
    width_px: float
    height_px: float
    columns: int
    rows: int


class Camera(Spec):
    """Pinhole camera with a noise model. It looks along -z, image up is +y, image right is +x."""

    position_mm: tuple[float, float, float] = Field(
        (0.0, 0.0, 30.0), description="Centre of projection in the sensor frame (mm)."
    )
    width_px: int = Field(1640, ge=16, le=20000, description="Columns of the full sensor.")
    height_px: int = Field(1232, ge=16, le=20000, description="Rows of the full sensor.")
    horizontal_fov_deg: float = quantity(
        62.2,
        unit="deg",
        gt=1,
        lt=170,
        description="Full horizontal field of view of the full sensor, in air.",
    )
    body_radius_mm: float = quantity(4.0, unit="mm", gt=0, le=100, description="Radius of the lens barrel.")
    exposure: float | None = quantity(
        None,
        unit="1",
        gt=0,
        description="Signal as a share of full scale per unit of mixed radiance; "
        "chosen automatically from the untouched gel when absent.",
    )
    full_well_e: float = quantity(
        4700.0, unit="e-", gt=10, le=1e7, description="Photo-electrons at full scale; sets the photon noise."
    )
    read_noise_e: float = quantity(
        5.0, unit="e-", ge=0, le=1e5, description="Standard deviation of the read noise."
    )
    black_level: float = quantity(
        0.0, unit="1", ge=0, lt=1, description="Signal without light, as a share of full scale."
    )
    bit_depth: int = Field(10, ge=1, le=16, description="Bits of the analogue-digital converter.")

    @property
    def focal_px(self) -> float:
        """Focal length in pixels of the full sensor."""
        return self.width_px / 2 / float(np.tan(np.radians(self.horizontal_fov_deg) / 2))

    def full_view(self) -> View:
        """The whole sensor at its own resolution."""
        return View(0.0, 0.0, float(self.width_px), float(self.height_px), self.width_px, self.height_px)

    def expose(
        self,
        radiance: NDArray[np.floating],
        *,
        exposure: float,
        seed: int,
        noise: bool = True,
        binned: float = 1.0,
    ) -> NDArray[np.float32]:
        """Turn linear radiance into what the camera reports, as a share of full scale.

        Photon noise follows Poisson statistics of the collected electrons (drawn as a Gaussian above
        1000 e-, where the two agree), read noise is Gaussian, and the result is quantised and clipped.

        Parameters
        ----------
        radiance : array, shape (rows, columns, channels)
            Mixed linear radiance.
        exposure : float
            Signal as a share of full scale per unit of radiance.
        seed : int
            Seed of the noise.
        noise : bool
            Without it only exposure, black level and clipping act; nothing is quantised.
        binned : float
            Sensor pixels averaged into one output pixel, at least 1; lowers the noise accordingly.
        """
        signal = np.clip(np.asarray(radiance, dtype=float) * exposure, 0.0, None)
        if not noise:
            return np.clip(signal + self.black_level, 0.0, 1.0).astype(np.float32)
        random = np.random.default_rng(seed)
        electrons = signal * self.full_well_e * binned
        shot = np.where(
            electrons < 1000.0,
            random.poisson(np.minimum(electrons, 1000.0)),
            electrons + np.sqrt(electrons) * random.standard_normal(electrons.shape),
        )
        # Averaging pixels refines the converter's steps, but each pixel has brought its own rounding error.
        steps = (2**self.bit_depth - 1) * binned
        rounding_e = self.full_well_e * np.sqrt((binned - 1) / 12) / (2**self.bit_depth - 1)
        read_e = np.hypot(self.read_noise_e * np.sqrt(binned), rounding_e)
        read = read_e * random.standard_normal(electrons.shape)
        digital = (shot + read) / (self.full_well_e * binned) + self.black_level
        return np.asarray(np.clip(np.round(digital * steps) / steps, 0.0, 1.0), dtype=np.float32)

    def noise_sigma(self, signal: NDArray[np.floating], *, binned: float = 1.0) -> NDArray[np.float64]:
        """Standard deviation of the noise `expose` adds to a signal given as a share of full scale."""
        electrons = (
            np.clip(np.asarray(signal, dtype=float) - self.black_level, 0.0, None) * self.full_well_e * binned
        )
        quantisation = 1.0 / (2**self.bit_depth - 1) / np.sqrt(12.0 * binned)
        electronic = np.sqrt(electrons + self.read_noise_e**2 * binned) / (self.full_well_e * binned)
        return np.asarray(np.hypot(electronic, quantisation))
