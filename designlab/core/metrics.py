"""Figures of merit: how alike two images are, how even a light is, how wrong normals are."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_erosion, find_objects, label, map_coordinates

from designlab.core.types import Array, Mask

_SSIM_WINDOW_PX = 7
# below this share of an image's power its structure is rounding: 1e-6 of the amplitude
_NO_STRUCTURE = 1e-12
_DIRECTIONS = 8  # of the lines that `rgb_to_normal` samples from the middle of each contact
_LEAST_TILT_DEG = 1.0  # of a membrane that counts as pressed
_FEWEST_SAMPLES = 6  # on a line that is fitted


def compare(simulated: ArrayLike, real: ArrayLike) -> dict[str, Any]:
    """Compare two linear images of the same size; `real` is the reference.

    With S the simulated and R the real values over all pixels (and, at the top level, all channels):

    - ``mse``: mean (R - S)^2, in squared units of the images.
    - ``snr_db``: 10 log10(sum R^2 / sum (R - S)^2).
    - ``smape``: mean of 2 |R - S| / (|R| + |S|), between 0 and 2; 0 where both are 0.
    - ``ssim``: mean structural similarity (doi 10.1109/TIP.2003.819861) with a uniform 7 x 7 window and, per
      channel, the data range max(R) - min(R); at the top level the mean of the channels.
    - ``structure_corr``, ``structure_snr_db``: Pearson correlation and SNR after the least-squares quadratic
      field (1, x, y, x^2, xy, y^2) of each channel is removed from each image; at the top level the means of
      the channels. A smooth field alone scores well on SNR and SSIM; structure is what a press leaves.

    The figures per channel are under ``channels``, keyed R, G, B (or Y for a single channel). A figure is
    infinite or NaN where it has no value: the SNR of equal images is +inf; SSIM of a constant reference and
    the structure of a reference without structure are NaN; a simulation without structure correlates 0.

    Parameters
    ----------
    simulated, real : array, shape (rows, columns, channels) or (rows, columns)
        Linear images in the same unit, 1 or 3 channels, at least 7 x 7 pixels.

    Raises
    ------
    ValueError
        If the shapes differ or do not fit, or a value is not finite, or the reference is zero everywhere.
    """
    simulated, real = _image(simulated, "simulated"), _image(real, "real")
    if simulated.shape != real.shape:
        raise ValueError(
            f"simulated: must have the shape of the real image {real.shape}, got {simulated.shape}"
        )
    if not real.any():
        raise ValueError("real: must have light somewhere, it is zero everywhere")
    names = "RGB" if real.shape[-1] == 3 else "Y"
    channels = {
        name: {**_pixelwise(simulated[..., index], real[..., index])}
        | {"ssim": _ssim(simulated[..., index], real[..., index])}
        | _structure(simulated[..., index], real[..., index])
        for index, name in enumerate(names)
    }
    means = {
        figure: float(np.mean([channel[figure] for channel in channels.values()]))
        for figure in ("ssim", "structure_corr", "structure_snr_db")
    }
    return {**_pixelwise(simulated, real), **means, "channels": channels}


def compare_within(simulated: Array, real: Array, mask: Mask) -> dict[str, float]:
    """Figures of `compare` over part of a picture: the quadratic field is taken from that part alone.

    Parameters
    ----------
    simulated, real : array, shape (rows, columns, 3)
        Linear pictures.
    mask : bool array, shape (rows, columns)
        Where they are compared.

    Returns
    -------
    mapping of str to float
        ``structure_corr``, ``structure_snr_db`` (means of the channels) and ``snr_db``.
    """
    each = [_structure(simulated[..., k], real[..., k], mask) for k in range(simulated.shape[-1])]
    means = {name: float(np.mean([figures[name] for figures in each])) for name in each[0]}
    return {**means, "snr_db": _pixelwise(simulated[mask], real[mask])["snr_db"]}


def remove_quadratic_field(channel: ArrayLike, mask: Mask | None = None) -> Array:
    """Subtract the least-squares field 1, x, y, x^2, xy, y^2 from a channel, shape (rows, columns).

    The field is that of the values within a mask, where there is one.
    """
    channel = np.asarray(channel, dtype=float)
    used = np.ones(channel.size, dtype=bool) if mask is None else np.ravel(mask)
    rows, columns = channel.shape
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1).reshape(-1, 6)
    coefficients = np.linalg.lstsq(terms[used], channel.ravel()[used], rcond=None)[0]
    return np.asarray(channel - (terms @ coefficients).reshape(rows, columns))


def uniformity_u0(channel: ArrayLike, mask: Mask | None = None) -> float:
    """Least over mean, U0 of EN 12464-1, with the 1st percentile for the least so that noise does not decide.

    Parameters
    ----------
    channel : array, shape (rows, columns)
        One colour of the untouched gel, linear.
    mask : bool array, same shape, optional
        Where it counts; everywhere when absent.
    """
    values = _inside(channel, mask)
    return float(np.percentile(values, 1) / values.mean())


def uniformity_cv(channel: ArrayLike, mask: Mask | None = None) -> float:
    """Coefficient of variation: standard deviation over mean. Parameters as `uniformity_u0`."""
    values = _inside(channel, mask)
    return float(values.std() / values.mean())


def uniformity_min_max(channel: ArrayLike, mask: Mask | None = None) -> float:
    """Least over greatest value. Parameters as `uniformity_u0`."""
    values = _inside(channel, mask)
    return float(values.min() / values.max())


def uniformity_nine_point(channel: ArrayLike, mask: Mask | None = None) -> float:
    """Least over greatest mean of the nine cells of a 3 x 3 split of the mask's bounding box.

    Display practice measures nine spots; whole cells are used here because they average the noise.
    Parameters as `uniformity_u0`.

    Raises
    ------
    ValueError
        If a cell holds no pixel of the mask.
    """
    mask = _mask(channel, mask)
    values = np.asarray(channel, dtype=float)
    rows, columns = _bounding_box(mask)
    means = []
    for row in np.array_split(rows, 3):
        for column in np.array_split(columns, 3):
            inside = mask[np.ix_(row, column)]
            if not inside.any():
                raise ValueError("mask: each cell of a 3 x 3 split must hold pixels, one holds none")
            means.append(values[np.ix_(row, column)][inside].mean())
    return float(min(means) / max(means))


def gradient_nonuniformity(channel: ArrayLike, mask: Mask | None = None) -> float:
    """Mean length of the gradient times the mask's width over the mean: relative change across the width.

    Gradients are central differences at pixels whose four neighbours lie in the mask.
    Parameters as `uniformity_u0`.
    """
    mask = _mask(channel, mask)
    values = np.asarray(channel, dtype=float)
    inner = binary_erosion(mask)
    if not inner.any():
        raise ValueError("mask: must be at least 3 x 3 pixels somewhere")
    along_row, along_column = np.gradient(values)
    width_px = len(_bounding_box(mask)[1])
    return float(np.hypot(along_row, along_column)[inner].mean() * width_px / values[mask].mean())


def normal_error_deg(estimated: ArrayLike, truth: ArrayLike) -> Array:
    """Angle between estimated and true normals, per pixel.

    Parameters
    ----------
    estimated, truth : array, shape (..., 3)
        Normals of any length but zero.

    Returns
    -------
    array, shape (...)
        Degrees, from 0 to 180; NaN where a normal is NaN.

    Raises
    ------
    ValueError
        If the shapes differ, or a normal is zero.
    """
    estimated, truth = np.asarray(estimated, dtype=float), np.asarray(truth, dtype=float)
    if estimated.shape != truth.shape or estimated.shape[-1:] != (3,):
        raise ValueError(
            f"normals: must be two arrays of one shape (..., 3), got {estimated.shape} and {truth.shape}"
        )
    for name, normals in (("estimated", estimated), ("truth", truth)):
        if (np.abs(normals).max(axis=-1) == 0).any():
            raise ValueError(f"{name}: normals must not be zero")
    # atan2 keeps its accuracy at small angles, where acos loses half the digits
    sine = np.linalg.norm(np.cross(estimated, truth), axis=-1)
    return np.asarray(np.degrees(np.arctan2(sine, np.sum(estimated * truth, axis=-1))))


def rgb_to_normal(
    image: ArrayLike, untouched: ArrayLike, normals: ArrayLike, untouched_normals: ArrayLike
) -> float:
    """How well the colour of a press follows the angle of its normals along straight lines, from 0 to 1.

    RGB2Normal of Agarwal et al., "Vision-based tactile sensor design using physically based rendering",
    Communications Engineering 2025 (doi 10.1038/s44172-025-00350-4): where the membrane is tilted, from the
    centre of the box around each contact along eight directions to its edge, the change of colour is brought
    to its first principal component, and correlated with the angle between pressed and untouched normal. The
    score is the mean of the absolute correlations. It needs no calibration, and does not see errors of sign
    between directions.

    Parameters
    ----------
    image, untouched : array, shape (rows, columns, channels)
        The pressed and the untouched gel, linear.
    normals, untouched_normals : array, shape (rows, columns, 3)
        Their true normals.

    Returns
    -------
    float
        NaN where no line is long enough, or colour or normals do not change along any.

    Raises
    ------
    ValueError
        If the shapes differ, or a normal is zero.
    """
    colour = np.asarray(untouched, dtype=float) - np.asarray(image, dtype=float)
    tilt = normal_error_deg(normals, untouched_normals)
    if colour.ndim != 3 or colour.shape[:2] != tilt.shape:
        raise ValueError(f"image: must have the shape of its normals {tilt.shape}, got {colour.shape[:2]}")
    contacts, _ = label(tilt > _LEAST_TILT_DEG)
    found = []
    for rows, columns in find_objects(contacts):
        half = np.array([rows.stop - rows.start - 1, columns.stop - columns.start - 1]) / 2
        centre = np.array([rows.start, columns.start]) + half
        for turn in 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS:
            way = np.array([np.sin(turn), np.cos(turn)])
            reach = float(np.min(half / np.maximum(np.abs(way), 1e-9)))
            at = centre[:, None] + way[:, None] * np.arange(int(reach) + 1)
            found.append(_line_correlation(colour, tilt, at))
    fits = [r for r in found if np.isfinite(r)]
    return float(np.mean(fits)) if fits else float("nan")


def _line_correlation(colour: Array, tilt: Array, at: Array) -> float:
    """Absolute correlation of the first principal component of colour with tilt at points (row, column)."""
    if at.shape[1] < _FEWEST_SAMPLES:
        return float("nan")
    angle = map_coordinates(tilt, at, order=1, mode="nearest")
    channels = [map_coordinates(c, at, order=1, mode="nearest") for c in np.moveaxis(colour, -1, 0)]
    samples = np.stack(channels, axis=-1) - np.mean(channels, axis=1)
    _, _, axes = np.linalg.svd(samples, full_matrices=False)
    component = samples @ axes[0]
    angle = angle - angle.mean()
    power = float(np.sqrt(np.sum(component**2) * np.sum(angle**2)))
    return float(abs(np.sum(component * angle)) / power) if power > 0 else float("nan")


def _image(array: ArrayLike, name: str) -> Array:
    image = np.asarray(array, dtype=float)
    image = image[..., None] if image.ndim == 2 else image
    if image.ndim != 3 or image.shape[-1] not in (1, 3) or min(image.shape[:2]) < _SSIM_WINDOW_PX:
        raise ValueError(
            f"{name}: must be at least {_SSIM_WINDOW_PX} x {_SSIM_WINDOW_PX} pixels with 1 or 3 channels, "
            f"got shape {image.shape}"
        )
    if not np.isfinite(image).all():
        raise ValueError(f"{name}: values must be finite, {int((~np.isfinite(image)).sum())} are not")
    return image


def _pixelwise(simulated: Array, real: Array) -> dict[str, float]:
    error = real - simulated
    scale = np.abs(real) + np.abs(simulated)
    relative = np.divide(2 * np.abs(error), scale, out=np.zeros_like(scale), where=scale > 0)
    return {
        "mse": float(np.mean(error**2)),
        "snr_db": _ratio_db(np.sum(real**2), np.sum(error**2)),
        "smape": float(relative.mean()),
    }


def _structure(simulated: Array, real: Array, mask: Mask | None = None) -> dict[str, float]:
    part = ... if mask is None else mask
    s, r = (remove_quadratic_field(image, mask)[part] for image in (simulated, real))
    simulated, real = simulated[part], real[part]
    power_s, power_r = float(np.sum(s**2)), float(np.sum(r**2))
    structured = power_r > _NO_STRUCTURE * np.sum(real**2)
    if not structured:
        corr = snr_db = float("nan")
    else:
        flat = power_s <= _NO_STRUCTURE * np.sum(simulated**2)
        corr = 0.0 if flat else float(np.sum(s * r) / np.sqrt(power_s * power_r))
        snr_db = _ratio_db(power_r, np.sum((r - s) ** 2))
    return {"structure_corr": corr, "structure_snr_db": snr_db}


def _ssim(simulated: Array, real: Array) -> float:
    from skimage.metrics import structural_similarity

    data_range = float(real.max() - real.min())
    if data_range == 0:
        return float("nan")
    similarity = structural_similarity(simulated, real, win_size=_SSIM_WINDOW_PX, data_range=data_range)
    return float(similarity)


def _ratio_db(power: Any, error: Any) -> float:
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(10 * np.log10(np.float64(power) / np.float64(error)))


def _mask(channel: ArrayLike, mask: Mask | None) -> Mask:
    shape = np.shape(channel)
    if len(shape) != 2:
        raise ValueError(f"channel: must have rows and columns, got shape {shape}")
    if mask is None:
        return np.ones(shape, dtype=bool)
    if mask.shape != shape or mask.dtype != bool:
        raise ValueError(f"mask: must be bool of shape {shape}, got {mask.dtype} of shape {mask.shape}")
    if not mask.any():
        raise ValueError("mask: must hold pixels, it is empty")
    return mask


def _inside(channel: ArrayLike, mask: Mask | None) -> Array:
    values = np.asarray(channel, dtype=float)[_mask(channel, mask)]
    bad = int((~np.isfinite(values)).sum())
    if bad:
        raise ValueError(f"mask: values inside must be finite, {bad} of {values.size} are not")
    return values


def _bounding_box(mask: Mask) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return np.arange(rows[0], rows[-1] + 1), np.arange(columns[0], columns[-1] + 1)
