"""Pictures of images, normals and heights for people: one scale, units, colour bars; arrays to PNG."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from designlab.images import tone_map

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.floating[Any]]
Extent = tuple[float, float, float, float]
BRIGHTEST_PERCENTILE = 99.5  # of all groups: the end of the colour scale
CONTOUR_SMOOTHING_PX = 2.0  # contours of a noisy picture would be ragged


def extent_mm(x_mm: Array, y_mm: Array) -> Extent:
    """Edges (left, right, bottom, top) in mm of an image whose pixels see the points (x, y)."""
    half_x = float(np.median(np.diff(x_mm, axis=1))) / 2
    half_y = float(np.median(-np.diff(y_mm, axis=0))) / 2
    return (
        float(np.median(x_mm[:, 0])) - half_x,
        float(np.median(x_mm[:, -1])) + half_x,
        float(np.median(y_mm[-1])) - half_y,
        float(np.median(y_mm[0])) + half_y,
    )


def background(path: Path, signal: Array, extent: Extent) -> None:
    """Untouched gel as the camera shows it, brightened to its own white."""
    figure = _figure(5.2, 4.2)
    axes = figure.add_subplot()
    axes.imshow(tone_map(signal), extent=extent)
    _label(axes, "Untouched gel")
    _save(figure, path)


def uniformity(path: Path, groups: Mapping[str, Array], extent: Extent) -> None:
    """Illumination of the untouched gel by each LED group, relative to its mean."""
    figure = _figure(4.0 * len(groups) + 0.6, 3.6)
    panels = figure.subplots(1, len(groups), squeeze=False)[0]
    relative = {name: image / image.mean() for name, image in groups.items()}
    brightest = float(np.percentile(np.stack(list(relative.values())), BRIGHTEST_PERCENTILE))
    for axes, (name, image) in zip(panels, relative.items(), strict=True):
        shown = axes.imshow(image, extent=extent, cmap="cividis", vmin=0, vmax=brightest)
        axes.contour(
            np.flipud(gaussian_filter(image, CONTOUR_SMOOTHING_PX, mode="nearest")),
            levels=[0.5, 0.75, 1.25, 1.5],
            extent=extent,
            colors="w",
            linewidths=0.6,
        )
        _label(axes, f"LED group {name}")
    figure.colorbar(shown, ax=list(panels), label="radiance / mean", shrink=0.85)
    _save(figure, path)


def press(
    path: Path,
    *,
    title: str,
    image: Array,
    normals: Array,
    true_normals: Array,
    height_mm: Array,
    true_height_mm: Array,
    error_deg: Array,
    extent: Extent,
) -> None:
    """One press: picture, normals and heights beside the truth, and where the normals err."""
    figure = _figure(12.6, 6.4)
    figure.suptitle(title)
    panels = figure.subplots(2, 3)
    panels[0, 0].imshow(tone_map(image), extent=extent)
    _label(panels[0, 0], "Camera picture")
    for axes, field, name in (
        (panels[0, 1], normals, "Normals, reconstructed"),
        (panels[0, 2], true_normals, "Normals, truth"),
    ):
        axes.imshow(np.clip(field * 0.5 + 0.5, 0, 1), extent=extent)
        _label(axes, name)
    shown = panels[1, 0].imshow(error_deg, extent=extent, cmap="magma", vmin=0, vmax=15)
    figure.colorbar(shown, ax=panels[1, 0], label="normal error (deg)", extend="max")
    _label(panels[1, 0], "Error over the grown contact")
    top = float(true_height_mm.max())
    for axes, field, name in (
        (panels[1, 1], height_mm, "Height, reconstructed"),
        (panels[1, 2], true_height_mm, "Height, truth"),
    ):
        shown = axes.imshow(field, extent=extent, cmap="viridis", vmin=min(0.0, -0.1 * top), vmax=1.1 * top)
        figure.colorbar(shown, ax=axes, label="height (mm)")
        _label(axes, name)
    _save(figure, path)


def _figure(width: float, height: float) -> "Figure":
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained", dpi=110)


def _label(axes: "Axes", title: str) -> None:
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")


def _save(figure: "Figure", path: Path) -> None:
    figure.savefig(path, format="png")
