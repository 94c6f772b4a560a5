"""Shapes found in pictures, as files, pictures and one page."""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from designlab.core.images import png_bytes, tone_map, write_image
from designlab.core.store import write_atomic
from designlab.core.types import Array
from designlab.reconstruction.press_shape import MarkerShift, PressShape
from designlab.report.evaluation_plots import normal_colours
from designlab.report.figures import new_figure, write_figure
from designlab.report.page import (
    Column,
    Html,
    Lead,
    Section,
    counted,
    gallery,
    listed,
    page,
    paragraph,
    picture,
    prose,
    table,
    unbroken,
)
from designlab.report.plots import draw_relief

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MESH_COLUMNS = 200  # of a mesh; more triangles show no more
RELIEF_COLUMNS = 110
ARROW_SHARE = 0.1  # of the picture's width, that the longest displacement of a marker is drawn
TABLE = "shapes.csv"
MANY = 50  # pictures from which the page shows their course, and a table of some
TABLE_ROWS = 600  # of the page at most
NUMBERS = re.compile(r"[\d.+-]+")


def write_shape(
    shape: PressShape,
    image: NDArray[Any],
    folder: Path,
    name: str,
    *,
    mm_per_px: float,
    mesh: str,
    kinds: Sequence[str],
) -> None:
    """Write one shape, as files of the kinds that are wanted.

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
        Kind of the mesh's file: ply, stl or glb.
    kinds : sequence of str
        Some of height (NPY, mm), tiff, exr, normals, contact, mesh, and picture, which shows all.
    """
    height = shape.height_mm.astype(np.float32)
    if "height" in kinds:
        write_atomic(folder / f"{name}-height.npy", _npy(height))
    if "exr" in kinds:
        write_image(folder / f"{name}-height.exr", np.repeat(height[..., None], 3, axis=-1))
    if "tiff" in kinds:
        write_atomic(folder / f"{name}-height.tiff", _tiff(height))
    if "normals" in kinds:
        write_atomic(folder / f"{name}-normals.npy", _npy(shape.normals.astype(np.float32)))
    if "contact" in kinds:
        mask = 255 * shape.contact.astype(np.uint8)[..., None]
        write_atomic(folder / f"{name}-contact.png", png_bytes(np.repeat(mask, 3, axis=-1)))
    if "mesh" in kinds:
        write_atomic(folder / f"{name}.{mesh}", _mesh(shape.height_mm, mm_per_px, mesh))
    if "picture" in kinds:
        draw_shape(shape, image, folder, name, mm_per_px)


def draw_shape(shape: PressShape, image: NDArray[Any], folder: Path, name: str, mm_per_px: float) -> None:
    """Write the picture NAME.png of one shape, see `shape_picture`."""
    write_figure(shape_picture(shape, image, mm_per_px, name), folder / f"{name}.png")


def that_matter(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The pictures of many that are worth looking at, in their order.

    First and last, the deepest, the one of most force, and the first that has each kind of warning, up to
    four of those that most pictures have.

    Parameters
    ----------
    rows : sequence of mapping
        See `reconstruction_report`.
    """
    chosen = {0, len(rows) - 1, max(range(len(rows)), key=lambda at: float(rows[at]["depth_mm"]))}
    if rows[0]["force_n"] is not None:
        chosen.add(max(range(len(rows)), key=lambda at: float(rows[at]["force_n"])))
    met: dict[str, list[int]] = {}
    for at, row in enumerate(rows):
        for text in row["warnings"]:
            met.setdefault(NUMBERS.sub("#", text), []).append(at)
    chosen |= {places[0] for places in sorted(met.values(), key=len, reverse=True)[:4]}
    return [rows[at] for at in sorted(chosen)]


def course_picture(rows: Sequence[Mapping[str, Any]]) -> "Figure":
    """Draw depth, contact area and force over the pictures, and where warnings are."""
    figure = new_figure(11.0, 5.4)
    shown = [("depth_mm", "depth (mm)"), ("contact_area_mm2", "contact (mm²)")]
    if rows[0]["force_n"] is not None:
        shown.append(("force_n", "force (N)"))
    number = np.arange(len(rows))
    doubtful = np.array([bool(row["warnings"]) for row in rows])
    for place, (key, title) in enumerate(shown, start=1):
        axes = figure.add_subplot(len(shown), 1, place)
        values = np.array([float(row[key]) for row in rows])
        axes.plot(number, values, color="#2a6fdb", linewidth=1.0)
        axes.plot(number[doubtful], values[doubtful], ".", color="#d1541e", markersize=3.0)
        axes.set_ylabel(title)
        axes.grid(color="#e2e6ec", linewidth=0.6)
    axes.set_xlabel("picture; dots have a warning")
    return figure


def shape_picture(shape: PressShape, image: NDArray[Any], mm_per_px: float, name: str) -> "Figure":
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
        if shape.markers is not None and len(shape.markers.places_mm) and place == panels[0, 0]:
            _draw_markers(axes, shape.markers, extent[1])
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


def _draw_markers(axes: "Axes", markers: MarkerShift, half_width_mm: float) -> None:
    """Draw how markers have moved, the longest arrow as long as a tenth of the picture's width."""
    longest = max(float(np.hypot(*markers.moved_mm.T).max()), 1e-6)
    larger = ARROW_SHARE * 2 * half_width_mm / longest
    x, y = markers.places_mm.T
    along, across = larger * markers.moved_mm.T
    axes.quiver(x, y, along, across, angles="xy", scale_units="xy", scale=1.0, color="#ffd23f", width=0.004)
    axes.set_xlabel(f"markers have moved by up to {longest:.3f} mm (arrows {larger:.0f} times)", fontsize=8)


def reconstruction_report(
    rows: Sequence[Mapping[str, Any]],
    folder: Path,
    target: Path,
    *,
    about: Mapping[str, Any],
    matter: Sequence[Mapping[str, Any]],
) -> Path:
    """Write the table of all shapes, and the page about them.

    Parameters
    ----------
    rows : sequence of mapping
        Of each picture: file, frame or None, name, depth_mm, contact_area_mm2, force_n or None, warnings.
    folder : Path
        Where the pictures of shapes are.
    target : Path
        HTML file to write.
    about : mapping
        What the calibration says of its errors.
    matter : sequence of mapping
        Those of the rows whose pictures the page shows.
    """
    write_atomic(folder / TABLE, _csv(rows))
    doubtful = [row for row in rows if row["warnings"]]
    deepest = max(rows, key=lambda row: float(row["depth_mm"]))
    simulated = about.get("simulated")
    error = (
        f"By {'simulated presses' if simulated else 'the balls'}, normals are good to "
        f"{about['normal_error_deg']:.1f} deg and heights to {about['height_error_um']:.0f} µm."
    )
    if simulated:
        error += f" That holds for the model {about['model']}, not for the sensor."
    answer = (
        f"The deepest of {counted(len(rows), 'picture')}, {_called(deepest)}, shows a press of "
        f"{deepest['depth_mm']:.3f} mm. {error}",
        f"{len(doubtful)} of them have a warning: read it before you use them."
        if doubtful
        else "No picture has a warning.",
    )
    pictures = [
        picture(folder / f"{row['name']}.png", _called(row))
        for row in matter[:12]
        if row is not deepest and (folder / f"{row['name']}.png").is_file()
    ]
    sections = []
    if simulated:
        told = [*about["warnings"], *about["notes"]]
        sections.append(Section("Model and sensor", (listed(told),)))
    if len(rows) > MANY:
        written = io.BytesIO()
        course_picture(rows).savefig(written, format="png", dpi=110)
        sections.append(Section("Over time", (picture(written.getvalue(), "Each picture in its order"),)))
    sections += [
        Section("Picture by picture", _rows_told(rows)),
        Section("Shapes", (gallery(pictures),) if pictures else (), folded=True),
    ]
    shown = folder / f"{deepest['name']}.png"
    lead = Lead(
        question="What shapes do these pictures show?",
        answer=tuple(map(paragraph, answer)),
        picture=picture(shown, f"The deepest: {_called(deepest)}") if shown.is_file() else None,
        next_words="Heights in mm are in the NPY and TIFF files; in Python:",
        next_command="dl.Reconstructor.load('calibrated/calibration.npz')(image).height_mm",
        word=f"{len(doubtful)} doubtful" if doubtful else "done",
        kind="fair" if doubtful else "good",
    )
    return write_atomic(target, page("Shapes", sections, lead=lead))


def _rows_told(rows: Sequence[Mapping[str, Any]]) -> tuple[Any, ...]:
    """Table of the pictures; of many, their warnings are numbered, and of very many it shows some."""
    columns = [
        Column("file", "picture"),
        Column("depth_mm", "depth", "mm"),
        Column("contact_area_mm2", "contact", "mm²"),
        Column("force_n", "force", "N"),
        Column("between", "95 % interval", "N"),
        *([Column("shear", "shear, right and up", "N")] if any(row.get("shear_n") for row in rows) else []),
        Column("told", "warnings"),
    ]
    rows = [{**row, "shear": _shear_words(row)} for row in rows]
    if len(rows) <= MANY:
        told = [
            {**row, "file": _called(row), "between": _between(row), "told": prose("; ".join(row["warnings"]))}
            for row in rows
        ]
        return (table(told, columns),)
    kinds: dict[str, tuple[int, str]] = {}
    for row in rows:
        for text in row["warnings"]:
            kinds.setdefault(NUMBERS.sub("#", text), (len(kinds) + 1, text))
    step = -(-len(rows) // TABLE_ROWS)
    told = [
        {
            **row,
            "file": _called(row),
            "between": _between(row),
            "told": ", ".join(str(kinds[NUMBERS.sub("#", text)][0]) for text in row["warnings"]),
        }
        for row in rows[::step]
    ]
    some = f"Every {step}th of {len(rows)} pictures; {TABLE} has all." if step > 1 else ""
    return (
        *(
            (listed(f"Warning {number}, for example: {text}" for number, text in kinds.values()),)
            if kinds
            else ()
        ),
        table(told, columns, caption=some),
    )


def _between(row: Mapping[str, Any]) -> Html | None:
    """The interval of a force."""
    if row.get("force_low_n") is None:
        return None
    return unbroken(f"{row['force_low_n']:.2g} to {row['force_high_n']:.2g}")


def _shear_words(row: Mapping[str, Any]) -> str:
    """Shear with its standard errors, in words."""
    if row.get("shear_n") is None:
        return "-"
    parts = zip(row["shear_n"], row["shear_error_n"], strict=True)
    return ", ".join(f"{value:.3f} ± {error:.3f}" for value, error in parts)


def _called(row: Mapping[str, Any]) -> str:
    """Name of a picture for people."""
    name = Path(row["file"]).name
    return name if row["frame"] is None else f"{name}, frame {row['frame']}"


def _csv(rows: Sequence[Mapping[str, Any]]) -> str:
    text = io.StringIO()
    names = ["file", "frame", "depth_mm", "contact_area_mm2"]
    names += ["force_n", "force_low_n", "force_high_n", "warnings"]
    if any("markers" in row for row in rows):
        names[-1:-1] = ["markers", "markers_moved_mm", "shear_x_n", "shear_y_n"]
    writer = csv.DictWriter(text, names, extrasaction="ignore")
    writer.writeheader()
    for row in rows:
        x, y = row.get("shear_n") or (None, None)
        told = {"shear_x_n": x, "shear_y_n": y, "warnings": "; ".join(row["warnings"])}
        writer.writerow({**row, **told})
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
