"""Draws one job folder, see `view3d.render_view`; a process of its own, as OpenGL may abort it."""

import json
import sys
from pathlib import Path

import numpy as np

from designlab.report.view3d.apart import MESHES, draw_apart
from designlab.report.view3d.labels import compose, labels
from designlab.report.view3d.space import scene
from designlab.sensor.design import loads


def main(job: Path) -> None:
    """Read what to draw from the folder and write PNG files there: the sensor, or its parts taken apart."""
    if (job / MESHES).exists():
        draw_apart(job)
        return
    design = loads((job / "design.toml").read_text(encoding="utf-8"))
    settings = json.loads((job / "job.json").read_text(encoding="utf-8"))
    stored = np.load(job / "surface.npz") if (job / "surface.npz").exists() else None
    indentation = None if stored is None else (stored["x"], stored["y"], stored["height"])
    plotter = scene(design, indentation, cutaway=settings["cutaway"])
    image = np.asarray(plotter.screenshot(return_img=True))
    deepest = None if indentation is None else float(indentation[2].max())
    compose(design.name, image, labels(design, deepest_mm=deepest), plotter.camera, job / "picture.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
