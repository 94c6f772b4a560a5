"""Draw the picture of the README: a sensor cut open, and what its camera sees of six presses.

.venv/bin/python scripts/readme_picture.py        writes docs/images/sensor-and-presses.jpg
"""

import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from designlab.core.images import tone_map
from designlab.report.view3d import render_view
from designlab.sensor.design import preset
from designlab.simulation.contact.press import Press
from designlab.simulation.simulator import Simulator
from geometries.probes import parse

TARGET = Path(__file__).parents[1] / "docs" / "images" / "sensor-and-presses.jpg"
SENSOR = "default"
PRESSES = (
    ("sphere:5", 0.8, 0),
    ("star:6", 0.8, 10),
    ("dots:2", 0.5, 20),
    ("triangle:5", 0.7, 40),
    ("wave:2.5", 0.5, 30),
    ("cylinder:3", 0.6, 60),
)  # probe, depth (mm), yaw (deg)
COLUMNS, SAMPLES = 300, 256
GAP_PX = 8


def main() -> None:
    design = preset(SENSOR)
    simulator = Simulator(design, columns=COLUMNS, samples=SAMPLES, seed=1)
    frames = [
        simulator.frame(Press(probe=parse(probe), depth_mm=depth_mm, yaw_deg=yaw_deg)).mixed
        for probe, depth_mm, yaw_deg in PRESSES
    ]
    white = float(np.percentile(frames, 99.9))
    tiles = [tone_map(frame, white) for frame in frames]
    rows, columns = tiles[0].shape[:2]
    height = 3 * rows + 2 * GAP_PX
    with tempfile.TemporaryDirectory() as folder:
        drawn = render_view(design, Path(folder) / "sensor.png")
        if drawn.path is None:
            raise SystemExit(drawn.reason)
        with Image.open(drawn.path) as opened:
            sensor = opened.convert("RGB")
            sensor = sensor.resize(
                (round(sensor.width * height / sensor.height), height), Image.Resampling.LANCZOS
            )
    page = Image.new("RGB", (sensor.width + 2 * (columns + GAP_PX), height), "white")
    page.paste(sensor, (0, 0))
    for number, tile in enumerate(tiles):
        left = sensor.width + GAP_PX + number % 2 * (columns + GAP_PX)
        page.paste(Image.fromarray(tile), (left, number // 2 * (rows + GAP_PX)))
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    page.save(TARGET, quality=90, subsampling=0, optimize=True)


if __name__ == "__main__":
    main()
