"""A picture of the sensor: translucent parts, coloured LEDs, a housing cut open, and the camera's view."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from designlab.sensor.design import Design, dumps
from designlab.simulation.contact.surface import Surface

__all__ = ["ViewPicture", "render_view"]


class ViewPicture(NamedTuple):
    """Where the picture was written, or None and the reason in words."""

    path: Path | None
    reason: str


def render_view(
    design: Design,
    path: str | Path,
    *,
    surface: Surface | None = None,
    cutaway: bool = True,
    timeout_s: float = 300.0,
) -> ViewPicture:
    """Draw the sensor off screen, in a process of its own: without OpenGL there is a reason, not a crash.

    Parameters
    ----------
    design : Design
        The sensor; an infeasible one is drawn as it is.
    path : str or Path
        PNG file to write; it appears whole or not at all.
    surface : Surface, optional
        Deformed membrane to show; the untouched one when absent.
    cutaway : bool
        Cut the housing open towards the viewer; otherwise it is translucent.
    timeout_s : float
        Time (s) after which drawing is given up.
    """
    if not isinstance(design, Design):
        raise TypeError(
            "design: must be a Design, since effects of a built sensor are not drawn; of a sensor model give "
            f"its design, got {type(design).__name__}"
        )
    path = Path(path)
    with tempfile.TemporaryDirectory(prefix="designlab-view-") as work:
        job = Path(work)
        (job / "design.toml").write_text(dumps(design), encoding="utf-8")
        (job / "job.json").write_text(json.dumps({"cutaway": cutaway}), encoding="utf-8")
        if surface is not None:
            np.savez(job / "surface.npz", x=surface.x_mm, y=surface.y_mm, height=surface.height_mm)
        reason = draw_job(job, timeout_s)
        if reason:
            return ViewPicture(None, f"no picture: {reason}")
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
        try:
            shutil.copyfile(job / "picture.png", partial)
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
    return ViewPicture(path, "")


def draw_job(job: Path, timeout_s: float) -> str:
    """Run the drawing process on a job folder; return why it failed, or an empty text."""
    command = [sys.executable, "-m", "designlab.report.view3d", str(job)]
    log = job / "log.txt"
    with log.open("wb") as output:
        try:
            done = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                timeout=timeout_s,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return f"drawing took longer than {timeout_s:g} s"
    if done.returncode == 0 and any(job.glob("*.png")):
        return ""
    lines = log.read_text(errors="replace").strip().splitlines() or ["it said nothing"]
    return f"the drawing process ended with code {done.returncode}: {lines[-1]}"
