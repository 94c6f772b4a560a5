"""The electronics turn light on the pixels into what the camera reports."""

import numpy as np
from scipy.fft import dctn, idctn
from scipy.ndimage import gaussian_filter

from designlab.core.types import Array
from designlab.sensor.camera import Camera, View
from designlab.validation.synthetic.generator_sensor import Sensor

NEIGHBOUR = 1 / 3  # weight of the next pixel, by which neighbours correlate with 0.3
FEW_E = 1000.0  # electrons below which photons are counted one by one
LEVELS = 4096  # of the sampled curve of a converter
DEVIATES = np.linspace(-5.0, 5.0, 121)  # of the Gaussian noise of one sensor pixel
LEAST_LIGHT = 0.01  # of the mean, below which noise of sampling grows no more
BLOCK = 8
STEPS = np.add.outer(np.arange(BLOCK), np.arange(BLOCK)) * 6.0 + 10.0  # of an 8 bit block transform


class Converter:
    """The sensor's electronics.

    Parameters
    ----------
    camera : Camera
        As designed.
    sensor : Sensor
        How it departs from that.
    binned : float
        Sensor pixels averaged into one output pixel.
    """

    def __init__(self, camera: Camera, sensor: Sensor, *, binned: float) -> None:
        self._camera, self._sensor, self._binned = camera, sensor, binned
        self._black = camera.black_level + np.array(sensor.black)
        self._is_linear = camera.response.is_linear and sensor.exponent == 1.0
        # Evenly spaced in the square root, so that a steep start of the curve is sampled finely.
        self._levels = 1.25 * np.linspace(0.0, 1.0, LEVELS) ** 2
        self._values = camera.response.encode(self._levels**sensor.exponent)

    def curve(self, signal: Array) -> Array:
        """Reported value of a signal, both shares of full scale, interpolated in the sampled curve."""
        if self._is_linear:
            return signal
        return np.interp(signal, self._levels, self._values)

    def report(self, light: Array, random: np.random.Generator | None, *, correlated: bool) -> Array:
        """Values of a frame (rows, columns, 3), share of full scale.

        Parameters
        ----------
        light : array, shape (rows, columns, 3)
            Signal of light, share of full scale.
        random : Generator or None
            Source of noise; None for no noise and no steps of the converter.
        correlated : bool
            Whether neighbours share noise, as behind a demosaicing filter.
        """
        light = np.maximum(light, 0.0)
        if random is None:
            return self._packed(np.clip(self.curve(light + self._black), 0.0, 1.0))
        camera, binned = self._camera, self._binned
        steps = 2**camera.bit_depth - 1
        deviates = self._deviates(light, random, correlated=correlated)
        # Averaging pixels refines the converter's steps, but each pixel has brought its own rounding error.
        rounding = np.sqrt((1 - 1 / binned) / 12 / binned) / steps
        if self._is_linear:
            found = light + self._black + np.hypot(self._noise(light) / np.sqrt(binned), rounding) * deviates
        else:
            found = np.empty_like(light)
            for channel in range(light.shape[-1]):
                mean, sigma = self._of_pixels(light[..., channel], self._black[channel])
                noise = np.hypot(sigma / np.sqrt(binned), rounding)
                found[..., channel] = mean + noise * deviates[..., channel]
        found = np.round(found * steps * binned) / (steps * binned)
        return self._packed(np.clip(found, 0.0, 1.0))

    def _noise(self, light: Array) -> Array:
        """Standard deviation of photon and read noise of one sensor pixel."""
        well = self._camera.full_scale_e
        return np.sqrt(light / well + (self._camera.read_noise_e / well) ** 2)

    def _deviates(self, light: Array, random: np.random.Generator, *, correlated: bool) -> Array:
        """Noise over its standard deviation."""
        found = random.standard_normal(light.shape)
        electrons = light * self._camera.full_scale_e * self._binned
        few = electrons < FEW_E
        read_e = self._camera.read_noise_e * np.sqrt(self._binned)
        scale = np.maximum(np.sqrt(electrons[few] + read_e**2), 1e-12)
        found[few] = (random.poisson(electrons[few]) - electrons[few] + read_e * found[few]) / scale
        if correlated:
            for axis in (0, 1):
                found = (found + NEIGHBOUR * np.roll(found, 1, axis)) / np.hypot(1, NEIGHBOUR)
        return found

    def _of_pixels(self, light: Array, black: float) -> tuple[Array, Array]:
        """Mean and spread of the values of sensor pixels, each of which goes through the curve by itself."""
        table = np.linspace(0.0, np.sqrt(max(float(light.max()), 1e-3)), 512) ** 2
        weights = np.exp(-(DEVIATES**2) / 2)
        weights /= weights.sum()
        values = np.clip(
            self.curve(table[:, None] + black + self._noise(table)[:, None] * DEVIATES), 0.0, 1.0
        )
        mean = values @ weights
        sigma = np.sqrt(np.maximum((values - mean[:, None]) ** 2 @ weights, 0.0))
        return np.interp(light, table, mean), np.interp(light, table, sigma)

    def _packed(self, values: Array) -> Array:
        """Values after a block transform with coarse steps, as of JPEG, in the square root of light."""
        if not self._sensor.jpeg:
            return values
        rows, columns = values.shape[:2]
        pad = [(0, -rows % BLOCK), (0, -columns % BLOCK), (0, 0)]
        wide = np.pad(255 * np.sqrt(values), pad, mode="edge")
        shape = wide.shape[0] // BLOCK, BLOCK, wide.shape[1] // BLOCK, BLOCK, 3
        steps = self._sensor.jpeg * STEPS[:, None, :, None]
        spectrum = dctn(wide.reshape(shape), axes=(1, 3), norm="ortho")
        spectrum = np.round(spectrum / steps) * steps
        flat = idctn(spectrum, axes=(1, 3), norm="ortho").reshape(wide.shape)[:rows, :columns]
        return np.asarray(np.clip(flat / 255, 0.0, 1.0) ** 2)


def flicker(view: View, *, amplitude: float, period_rows: float, phase: float) -> Array:
    """Factor of every output row (rows, 1, 1): the mean over the sensor rows that it averages."""
    per_row = view.height_px / view.rows
    centres = view.y_px + (np.arange(view.rows)[:, None] + (np.arange(32) + 0.5) / 32) * per_row
    wave = np.sin(2 * np.pi * (centres / period_rows + phase)).mean(axis=1)
    return np.asarray(1 + amplitude * wave)[:, None, None]


def fringes(view: View, *, amplitude: float) -> Array:
    """Coloured fringes of two gratings that nearly agree, (rows, columns, 3): finer and finer arcs."""
    row, column = np.mgrid[: view.rows, : view.columns] / view.columns
    phase = 2 * np.pi * (9 * column + 5 * row + 6 * (column - 0.3) ** 2 + 4 * (row - 0.5) ** 2)
    return np.stack([1 + amplitude * np.sin(phase + shift) for shift in (0.0, 2.1, 4.2)], axis=-1)


def grain(light: Array, sensor: Sensor, random: np.random.Generator) -> Array:
    """Factor of every value of a frame: grain of a size, and noise that is as that of photons."""
    fine = gaussian_filter(random.standard_normal(light.shape), (sensor.grain_px, sensor.grain_px, 0))
    white = random.standard_normal(light.shape)
    few = np.sqrt(light.mean() / np.maximum(light, LEAST_LIGHT * light.mean()))
    return np.asarray(1 + sensor.grain_rms * fine / fine.std() + sensor.sampling_rms * few * white)
