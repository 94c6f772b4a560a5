"""Shapes found in pictures, as files, pictures and one page."""

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from designlab.core.images import tone_map, write_image
from designlab.core.store import write_atomic
from designlab.core.types import Array
from designlab.reconstruction.reconstructor import PressShape
from designlab.report.evaluation_plots import normal_colours
from designlab.report.figures import new_figure, write_figure
from designlab.report.page import Column, Lead, Section, counted, gallery, page, paragraph, picture, table
from designlab.report.plots import draw_relief

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MESH_COLUMNS = 200  # of a mesh; more triangles show no more
RELIEF_COLUMNS = 110
TABLE = "shapes.csv"


def write_shape(
    shape: PressShape, image: Array, folder: Path, name: str, *, mm_per_px: float, mesh: str
) -> None:
    """Write one shape: heights (TIFF and NPY, mm), normals, contact, mesh, and a picture of all.

    Parameters
    ----------
    shape : PressShape
        What was found.
    image : array, shape (rows, columns, channels)
        The picture that it was found in.
    folder : Path
        Where files are written; each appears whole or not at all.
    name : str
        Begins their names.
    mm_per_px : float
        Size of a pixel at the gel.
    mesh : str
        Kind of the mesh's file: ply, stl, glb or none.
    """
    height = shape.height_mm.astype(np.float32)
    write_atomic(folder / f"{name}-height.npy", _npy(height))
    write_image(folder / f"{name}-height.exr", np.repeat(height[..., None], 3, axis=-1))
    write_atomic(folder / f"{name}-height.tiff", _tiff(height))
    write_atomic(folder / f"{name}-normals.npy", _npy(shape.normals.astype(np.float32)))
    write_image(
        folder / f"{name}-contact.png", np.repeat(255 * shape.contact.astype(np.uint8)[..., None], 3, axis=-1)
    )
    if mesh != "none":
        write_atomic(folder / f"{name}.{mesh}", _mesh(shape.height_mm, mm_per_px, mesh))
    write_figure(shape_picture(shape, image, mm_per_px, name), folder / f"{name}.png")


def shape_picture(shape: PressShape, image: Array, mm_per_px: float, name: str) -> "Figure":
    """Draw picture, normals, height, relief and profile of one shape."""
    rows, columns = shape.height_mm.shape
    half = columns * mm_per_px / 2, rows * mm_per_px / 2
    extent = (-half[0], half[0], -half[1], half[1])
    top = max(float(shape.height_mm.max()), 1e-3)
    low = min(-0.1 * top, float(shape.height_mm.min()))
    figure = new_figure(13.0, 6.8)
    panels = figure.add_gridspec(2, 3)
    for place, shown, title in (
        (panels[0, 0], tone_map(np.asarray(image)[..., :3]), f"{name}, picture"),
        (panels[0, 1], normal_colours(shape.normals), "Normals"),
    ):
        axes = figure.add_subplot(place)
        axes.imshow(shown, extent=extent)
        axes.set_title(title, fontsize=10)
        axes.set_ylabel("y (mm)")
    axes = figure.add_subplot(panels[1, 0])
    drawn = axes.imshow(shape.height_mm, extent=extent, cmap="viridis", vmin=low, vmax=top)
    figure.colorbar(drawn, ax=axes, label="height (mm)", shrink=0.85)
    if shape.contact.any() and not shape.contact.all():
        axes.contour(np.flipud(shape.contact), levels=[0.5], extent=extent, colors="w", linewidths=1.0)
    row, _ = np.unravel_index(int(shape.height_mm.argmax()), shape.height_mm.shape)
    axes.axhline(half[1] - (row + 0.5) * mm_per_px, color="w", linewidth=0.8, linestyle="--")
    axes.set_title("Height; the contact, and the line of the profile", fontsize=10)
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")
    step = max(1, columns // RELIEF_COLUMNS)
    x = np.linspace(extent[0], extent[1], columns)[::step]
    y = np.linspace(extent[3], extent[2], rows)[::step]
    solid = figure.add_subplot(panels[0:2, 2], projection="3d")
    draw_relief(solid, x, y, shape.height_mm[::step, ::step], (low, top))
    line = figure.add_subplot(panels[1, 1])
    places = [np.full(columns, float(row)), np.arange(columns, dtype=float)]
    line.plot(
        np.linspace(extent[0], extent[1], columns),
        map_coordinates(shape.height_mm, places, order=1),
        color="#d1541e",
    )
    line.set_xlabel("x (mm)")
    line.set_ylabel("height (mm)")
    line.grid(color="#e2e6ec", linewidth=0.6)
    line.set_title(f"Profile; deepest {shape.depth_mm:.3f} mm", fontsize=10)
    return figure


def reconstruction_report(
    rows: Sequence[Mapping[str, Any]], folder: Path, target: Path, *, about: Mapping[str, Any]
) -> Path:
    """Write the table of all shapes, and the page about them.

    Parameters
    ----------
    rows : sequence of mapping
        Of each picture: file, name, depth_mm, contact_area_mm2, force_n or None, warnings.
    folder : Path
        Where the pictures of shapes are.
    target : Path
        HTML file to write.
    about : mapping
        What the calibration says of its errors.
    """
    write_atomic(folder / TABLE, _csv(rows))
    doubtful = [row for row in rows if row["warnings"]]
    deepest = max(rows, key=lambda row: float(row["depth_mm"]))
    error = (
        f"By the balls, normals are good to {about['normal_error_deg']:.1f} deg and heights to "
        f"{about['height_error_um']:.0f} µm."
    )
    answer = (
        f"The deepest of {counted(len(rows), 'picture')}, {Path(deepest['file']).name}, shows a press of "
        f"{deepest['depth_mm']:.3f} mm. {error}",
        f"{len(doubtful)} of them have a warning: read it before you use them."
        if doubtful
        else "No picture has a warning.",
    )
    shown = folder / f"{deepest['name']}.png"
    columns = [
        Column("file", "picture"),
        Column("depth_mm", "depth", "mm"),
        Column("contact_area_mm2", "contact", "mm²"),
        Column("force_n", "force", "N"),
        Column("told", "warnings"),
    ]
    told = [{**row, "file": Path(row["file"]).name, "told": "; ".join(row["warnings"])} for row in rows]
    pictures = [
        picture(folder / f"{row['name']}.png", Path(row["file"]).name)
        for row in rows[:12]
        if row is not deepest
    ]
    sections = [
        Section("Picture by picture", (table(told, columns),)),
        Section("Shapes", (gallery(pictures),) if pictures else (), folded=True),
    ]
    lead = Lead(
        question="What shapes do these pictures show?",
        answer=tuple(map(paragraph, answer)),
        picture=picture(shown, f"The deepest: {Path(deepest['file']).name}") if shown.is_file() else None,
        next_words="Heights in mm are in the NPY and TIFF files; in Python:",
        next_command="dl.Reconstructor.load('calibrated/calibration.npz')(image).height_mm",
        word=f"{len(doubtful)} doubtful" if doubtful else "done",
        kind="fair" if doubtful else "good",
    )
    return write_atomic(target, page("Shapes", sections, lead=lead))


def _csv(rows: Sequence[Mapping[str, Any]]) -> str:
    text = io.StringIO()
    names = ["file", "depth_mm", "contact_area_mm2", "force_n", "warnings"]
    writer = csv.DictWriter(text, names, extrasaction="ignore")
    writer.writeheader()
    writer.writerows({**row, "warnings": "; ".join(row["warnings"])} for row in rows)
    return text.getvalue()


def _npy(values: NDArray[np.float32]) -> bytes:
    written = io.BytesIO()
    np.save(written, values)
    return written.getvalue()


def _tiff(height_mm: NDArray[np.float32]) -> bytes:
    import tifffile

    written = io.BytesIO()
    tifffile.imwrite(written, height_mm, photometric="minisblack", description="height in mm")
    return written.getvalue()


def _mesh(height_mm: Array, mm_per_px: float, kind: str) -> bytes:
    """The surface as triangles in mm, x right, y up."""
    import trimesh

    step = max(1, height_mm.shape[1] // MESH_COLUMNS)
    z = height_mm[::step, ::step]
    rows, columns = z.shape
    x = (np.arange(columns) - (columns - 1) / 2) * step * mm_per_px
    y = ((rows - 1) / 2 - np.arange(rows)) * step * mm_per_px
    across, along = np.meshgrid(x, y)
    corner = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    faces = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    points = np.stack([across, along, z], axis=-1).reshape(-1, 3)
    made = trimesh.Trimesh(points, faces, process=False).export(file_type=kind)
    return made if isinstance(made, bytes) else str(made).encode()
