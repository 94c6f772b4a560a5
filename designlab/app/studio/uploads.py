"""A picture of a real sensor is read as a relief, by a calibration or by the light of the design."""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import gaussian_filter

from designlab.app.studio.messages import Relief, UploadJob
from designlab.core.images import png_bytes, read_picture, resize_area
from designlab.core.types import Array
from designlab.evaluation.protocol import SMOOTHING_PX, EvaluationProtocol
from designlab.measurement.importing.conversion import decoded
from designlab.reconstruction import blended, normals
from designlab.report.live_maps import height_colours, normal_pixels
from designlab.sensor.camera import View
from designlab.sensor.design import Design
from designlab.sensor.response_curve import Response
from designlab.simulation.simulator import Simulator, exposure
from geometries.elastomer import base_gradient

if TYPE_CHECKING:
    from designlab.app.studio.pictures import Bench

MOST_BYTES = 20_000_000
SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".exr")
LINEAR = (".exr",)
COLUMNS = 160
ALIKE = 0.02  # of two proportions
SEED = 0


def read(data: bytes, suffix: str) -> Array:
    """Picture of a file's content, values from 0 to 1, shape (rows, columns, 3).

    Raises
    ------
    ValueError
        If it is too large, of another kind, or no picture.
    """
    if len(data) > MOST_BYTES:
        raise ValueError(f"the picture: must have at most {MOST_BYTES // 1_000_000} MB")
    if suffix.lower() not in SUFFIXES:
        raise ValueError(f"the picture: must be one of {', '.join(SUFFIXES)}, got {suffix[:12]!r}")
    with tempfile.TemporaryDirectory(prefix="designlab-studio-") as folder:
        path = Path(folder) / f"picture{suffix.lower()}"
        path.write_bytes(data)
        try:
            found = np.asarray(read_picture(path), dtype=float)
        except ValueError as error:
            raise ValueError(str(error).replace(f"{folder}/", "")) from None
    if found.shape[-1] != 3:
        raise ValueError("the picture: is grey; reconstruction needs the three channels of a colour camera")
    return found


def relief(bench: "Bench", job: UploadJob) -> Relief:
    """Read a picture as a relief.

    Raises
    ------
    ValueError
        If the picture cannot be used.
    """
    picture = read(job.data, job.suffix)
    if job.calibration is not None:
        return _by_calibration(picture, job.calibration)
    curve = Response(curve="linear" if job.suffix.lower() in LINEAR else "srgb").model_dump(mode="json")
    background = (
        None
        if job.background is None
        else np.asarray(decoded(read(job.background, job.background_suffix), curve), dtype=float)
    )
    return _by_design(bench, np.asarray(decoded(picture, curve), dtype=float), background, job.design)


def _by_calibration(picture: Array, file: Path) -> Relief:
    from designlab.reconstruction.reconstructor import Reconstructor

    made = Reconstructor.load(file)
    about: Mapping[str, Any] = made.kept.about
    shape = made(np.asarray(decoded(picture, about.get("response")), dtype=float), pressure=False)
    facts = {"depth": f"{shape.depth_mm:.2f} mm", "contact": f"{shape.contact_area_mm2:.2f} mm²"}
    facts |= {"note": "; ".join(shape.warnings)} if shape.warnings else {}
    return _relief(shape.height_mm, shape.normals, facts)


def _by_design(bench: "Bench", picture: Array, background: Array | None, design: Design) -> Relief:
    """Heights by the light of the design; the picture is levelled to it by its background or its border."""
    if background is not None and background.shape != picture.shape:
        raise ValueError(
            f"the background: must be as large as the picture, is {background.shape[1]} x "
            f"{background.shape[0]} pixels instead of {picture.shape[1]} x {picture.shape[0]}"
        )
    view = _view(design, picture)
    simulator = Simulator(design, view=view, samples=bench.effort.samples[-1], seed=SEED)
    if not simulator.has_light_field:
        raise ValueError("the picture: needs LLVM or CUDA to be read by a design; give a calibration")
    untouched = simulator.frame(None)
    protocol = EvaluationProtocol(design, exposure(design, untouched), SEED)
    near = protocol.near_field(untouched, np.asarray(simulator.slope_response()))
    smaller = np.asarray(resize_area(picture, view.rows, view.columns), dtype=float)
    if background is None:
        # The border shows mostly gel at rest.
        edge = np.concatenate([smaller[0], smaller[-1], smaller[:, 0], smaller[:, -1]])
        own = near.background
        model = np.concatenate([own[0], own[-1], own[:, 0], own[:, -1]])
        level = np.median(model, axis=0) / np.maximum(np.median(edge, axis=0), 1e-6)
    else:
        rest = np.asarray(resize_area(background, view.rows, view.columns), dtype=float)
        rest = gaussian_filter(rest, (SMOOTHING_PX, SMOOTHING_PX, 0))
        level = near.background / np.maximum(rest, 1e-4)
    found = near.estimate(smaller * level)
    pitch_mm = untouched.rays.pitch_mm
    height = found.height_mm(pitch_mm=pitch_mm)
    p, q = blended(found.p, found.q, height, pitch_mm=pitch_mm)
    base_p, base_q = (np.nan_to_num(part) for part in base_gradient(design.elastomer, *untouched.seen_mm))
    by = "levelled to the background" if background is not None else "levelled to its border"
    facts = {"depth": f"{float(height.max()):.2f} mm", "light": f"of the design, {by}"}
    return _relief(height, normals(p + base_p, q + base_q), facts)


def _view(design: Design, picture: Array) -> View:
    """Part of the camera's sensor that a picture shows: all of it, or the sensing area, by its proportion."""
    rows, columns = picture.shape[:2]
    count = min(columns, COLUMNS)
    camera, area = design.camera, design.view(count)
    whole = View(0.0, 0.0, camera.width_px, camera.height_px, count, max(1, round(count * rows / columns)))
    for view in (area, whole):
        if abs(columns / rows / (view.width_px / view.height_px) - 1) < ALIKE:
            return view
    raise ValueError(
        f"the picture: {columns} x {rows} pixels are in proportion to neither the sensing area nor the whole "
        "sensor of the design's camera"
    )


def _relief(height_mm: Array, normal: Array, facts: dict[str, str]) -> Relief:
    low, high = (float(end) for end in np.nanpercentile(height_mm, (0.5, 99.9)))
    return Relief(
        png_bytes(normal_pixels(normal)), png_bytes(height_colours(height_mm, (low, high))), low, high, facts
    )
