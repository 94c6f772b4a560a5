"""Small planted sets of the flat sensor, and the same with a fault put in."""

import numpy as np

from designlab.measurement import load_measurement, write_measurement
from designlab.sensor.design import preset
from designlab.validation.synthetic import plant

DESIGN = preset("gelsight-2020-flat")
COLUMNS, SEED = 32, 2
PLACES = ((-4.0, -3.0), (4.0, -2.0), (0.0, 3.0), (-3.0, 2.0))
PRESSES = [
    {"probe": "sphere:5", "depth_mm": depth, "centre_mm": place, "yaw_deg": 0.0}
    for place in PLACES
    for depth in (0.3, 0.6)
]


def planted(folder, effects=None, *, design=DESIGN, **options):
    options = {"kit": "small", "presses": PRESSES, "columns": COLUMNS, "unlisted": False} | options
    return load_measurement(plant(design, effects=effects or {}, out=folder, seed=SEED, **options))


def changed(measurement, folder, *, files=None, pictures=None, frames=None, drop=(), **fields):
    """Write a set anew: pictures changed, fields of frames changed, frames left out."""
    kept, images = [], {}
    for frame in measurement.frames:
        if frame.file in drop:
            continue
        image = measurement.image(frame)
        if pictures is not None and (files is None or frame.file in files):
            image = np.ascontiguousarray(pictures(image)).astype(np.float32)
        images[frame.file] = image
        if frames is not None and (files is None or frame.file in files):
            frame = frame.model_copy(update=frames(frame))
        kept.append(frame)
    return load_measurement(
        write_measurement(measurement.model_copy(update={"frames": tuple(kept), **fields}), images, folder)
    )
