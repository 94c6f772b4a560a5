"""Shear force on an elastic layer from how far marked points of its surface have moved sideways."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.ndimage import map_coordinates
from scipy.sparse.linalg import LinearOperator, cg

from designlab.core.types import Array
from designlab.mechanics.grid_response import MARGIN, symbol
from designlab.mechanics.surface_pressure import SurfacePressure

FEWEST = 4  # markers that have moved, below which nothing follows
NOISE_MM = 0.005  # least error of a marker's place
LARGEST_MM = 0.5  # standard deviation of what a contact is moved by, before anything is known
CLOSE = 1e-3  # of the traction that sticks, relative
ITERATIONS = 200
# What the layer itself is off by, against finite elements of blocks (docs/validation.md): a share of the
# shear, as the gel ends somewhere, and a share of the pressing force, which moves markers as well.
MODEL_SD, PRESSED_SD = 0.05, 0.008


@dataclass(frozen=True, eq=False)
class SurfaceShear:
    """Shear that moves markers as they have moved.

    Attributes
    ----------
    force : (float, float)
        Force to the right and up over Young's modulus (mm2).
    error : (float, float)
        Their standard errors, by what is left of the markers' displacements and what the layer is off by.
    rest_mm : float
        Root mean square of what is left.
    """

    force: tuple[float, float]
    error: tuple[float, float]
    rest_mm: float

    @property
    def relative_error(self) -> float:
        """Standard error over the size of the force; inf where there is none."""
        size = math.hypot(*self.force)
        return max(self.error) / size if size else math.inf

    def force_n(self, modulus_mpa: float) -> tuple[float, float]:
        """Shear force (N) to the right and up, on a layer of a modulus in MPa."""
        return self.force[0] * modulus_mpa, self.force[1] * modulus_mpa

    def error_n(self, modulus_mpa: float, modulus_sd_mpa: float = 0.0) -> tuple[float, float]:
        """Standard errors (N) of the force, on a layer of a modulus and its standard deviation in MPa."""
        x, y = (
            math.hypot(error * modulus_mpa, force * modulus_sd_mpa)
            for force, error in zip(self.force, self.error, strict=True)
        )
        return x, y


def shear_under(places_mm: Array, moved_mm: Array, pressure: SurfacePressure) -> SurfaceShear:
    """Find the shear under which markers have moved.

    Few markers lie in a contact, so traction is sought among the ways in which a contact can be loaded:
    shifted or turned while it sticks, sliding with traction in proportion to pressure, and held where the
    pressure alone would spread it. What they do to the markers is fitted to their displacements, after that
    of the pressure. Of ways that do nearly the same none is preferred: amplitudes have a wide prior.

    Parameters
    ----------
    places_mm : array, shape (markers, 2)
        Places right of and above the middle of the surface, before the press.
    moved_mm : array, shape (markers, 2)
        How far they have moved to the right and up.
    pressure : SurfacePressure
        Pressure and contact.

    Raises
    ------
    ValueError
        If there are fewer than four markers.
    """
    if len(places_mm) < FEWEST:
        raise ValueError(f"markers: {FEWEST} or more are needed, got {len(places_mm)}")
    field = _Field(pressure)
    ways = field.ways()
    rows, columns = pressure.pressure.shape
    # pressure and contact are those of the surface as it now lies, so markers are taken where they are now
    now = places_mm + moved_mm
    at = np.stack(
        [
            (rows - 1) / 2 - now[:, 1] / pressure.pitch_mm,
            (columns - 1) / 2 + now[:, 0] / pressure.pitch_mm,
        ]
    )

    def at_markers(displacement: Array) -> Array:
        x, y = (map_coordinates(part, at, order=1, mode="nearest") for part in displacement)
        return np.concatenate([x, y])

    # rows count downwards
    target = np.concatenate([moved_mm[:, 0], -moved_mm[:, 1]]) - at_markers(field.spread)
    effects = np.stack([at_markers(field.displacement(way)) for way in ways], axis=1)
    forces = np.stack([way.sum(axis=(1, 2)) for way in ways], axis=1) * pressure.pitch_mm**2
    # amplitudes are in mm of the contact's own displacement
    noise = NOISE_MM
    for _ in range(3):
        information = effects.T @ effects / noise**2 + np.eye(len(ways)) / LARGEST_MM**2
        amplitude = np.linalg.solve(information, effects.T @ target / noise**2)
        rest = target - effects @ amplitude
        noise = max(NOISE_MM, float(np.sqrt((rest**2).sum() / max(len(rest) - len(ways), 1))))
    force = forces @ amplitude
    pressed = float(pressure.pressure.sum()) * pressure.pitch_mm**2
    layer_sd = math.hypot(MODEL_SD * float(np.hypot(*force)), PRESSED_SD * pressed)
    error = np.sqrt(np.diag(forces @ np.linalg.solve(information, forces.T)) + layer_sd**2)
    return SurfaceShear(
        (float(force[0]), -float(force[1])),
        (float(error[0]), float(error[1])),
        float(np.sqrt((rest**2).mean())),
    )


class _Field:
    """Displacement of a surface along columns and rows by tractions over the modulus, (2, rows, columns)."""

    def __init__(self, pressure: SurfacePressure) -> None:
        self.pressure = pressure.pressure.astype(float)
        self.contact = pressure.contact
        margin = math.ceil(MARGIN * pressure.layer.thickness_mm / pressure.pitch_mm)
        self.shape = [fft.next_fast_len(side + margin, real=True) for side in self.pressure.shape]
        self.response = {
            part: symbol(pressure.layer, pressure.pitch_mm, *self.shape, part)
            for part in ("xx", "xy", "yy", "xz", "yz")
        }
        self.spread = self._moved((("xz", self.pressure),), (("yz", self.pressure),))

    def displacement(self, traction: Array) -> Array:
        """Displacement by a traction."""
        x, y = traction
        return self._moved((("xx", x), ("xy", y)), (("xy", x), ("yy", y)))

    def ways(self) -> list[Array]:
        """Tractions that a contact may have; each moves the contact by some 1 mm."""
        rows, columns = np.indices(self.contact.shape).astype(float)
        inside = self.contact
        row, column = rows - rows[inside].mean(), columns - columns[inside].mean()
        size = math.sqrt(float((row[inside] ** 2 + column[inside] ** 2).mean()))
        ones, none = np.ones_like(row), np.zeros_like(row)
        stuck = [
            self._sticking(np.stack(moved))
            for moved in ((ones, none), (none, ones), (-row / size, column / size))
        ]
        held = self._sticking(-self.spread)
        spread = float(np.sqrt((self.spread[:, inside] ** 2).sum(axis=0).mean()))
        sliding = []
        for axis in (0, 1):
            traction = np.zeros_like(stuck[0])
            traction[axis] = self.pressure
            sliding.append(traction / self.displacement(traction)[axis][inside].mean())
        return [*stuck, *sliding, held / max(spread, 1e-6)]

    def _sticking(self, moved: Array) -> Array:
        """Traction within the contact that moves it so."""
        within = np.broadcast_to(self.contact, moved.shape)

        def whole(values: Array) -> Array:
            traction = np.zeros_like(moved)
            traction[within] = values
            return traction

        size = int(within.sum())
        operator = LinearOperator(
            (size, size), matvec=lambda values: self.displacement(whole(values))[within], dtype=float
        )
        found, _ = cg(operator, moved[within], rtol=CLOSE, maxiter=ITERATIONS)
        return whole(found)

    def _moved(self, x: tuple[tuple[str, Array], ...], y: tuple[tuple[str, Array], ...]) -> Array:
        rows, columns = self.pressure.shape

        def along(loads: tuple[tuple[str, Array], ...]) -> Array:
            spectrum = sum(self.response[part] * fft.rfft2(load, s=self.shape) for part, load in loads)
            return np.asarray(fft.irfft2(spectrum, s=self.shape)[:rows, :columns])

        return np.stack([along(x), along(y)])
