"""The light probe of the published sensor, and where each LED strip must appear in it.

Flat gel and dome have the same LEDs, and no gel is in place when the ball is photographed: one map is both.
"""

from pathlib import Path
from typing import Any

import numpy as np

from designlab.core.progress import silent
from designlab.core.types import Progress
from designlab.measurement.light_probe.lobes import Lobe, lobes
from designlab.measurement.light_probe.panels import Panel, panels
from designlab.measurement.light_probe.picture import light_probe
from designlab.measurement.light_probe.polar import polar_map
from designlab.report.figures import write_figure
from designlab.report.plots import light_map
from designlab.sensor.design import preset
from designlab.validation.paper_2020.sizes import Size

SENSOR, PICTURE = "gelsight-2020-flat", "light-map.png"
COLUMNS = {"full": 400, "reduced": 200}
SAMPLES = 16
STEP_DEG = 1.0  # of the map that is drawn


def probe(folder: str | Path, size: Size, seed: int = 1, progress: Progress = silent) -> dict[str, Any]:
    """Render a chrome ball in the sensor, unwrap it, and hold its lobes against the LED strips.

    Strips are mirrored in the ball point by point, in closed form; the lobes come from the picture.

    Parameters
    ----------
    folder : path
        Where the map is drawn.
    size : Size
        Its name chooses the width of the picture.
    seed : int
        Seed of the light transport.
    progress : callable, optional
        Called with the sensor, parts done and parts in all.

    Returns
    -------
    dict
        ``sensor``; ``strips``: angle between the centres of lobe and strip (deg), and ratio of the
        solid angles (of the directions, and as seen from the ball); ``unmatched`` lobes; the ``picture``,
        relative to the folder.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    progress(SENSOR, 0, 1)
    design = preset(SENSOR)
    picture = light_probe(design, columns=COLUMNS[size.name], samples=SAMPLES, seed=seed)
    light = picture.unwrap()
    found, traced = lobes(light), panels(design, picture.probe, picture.view)
    strips = [_strip(panel, found.of(panel.group)) for panel in traced.panels]
    figure = light_map(polar_map(light, step_deg=STEP_DEG), found, traced=traced, title=SENSOR)
    write_figure(figure, folder / PICTURE)
    return {
        "sensor": SENSOR,
        "strips": strips,
        "unmatched": len(found.lobes) - len({strip["lobe"] for strip in strips}),
        "picture": PICTURE,
    }


def _strip(panel: Panel, found: tuple[Lobe, ...]) -> dict[str, Any]:
    """One strip beside the lobe of its LED group that lies nearest."""
    number = min(range(len(found)), key=lambda n: _apart_deg(panel, found[n]))
    lobe = found[number]
    return {
        "channel": panel.group,
        "lobe": f"{panel.group} {number + 1}",
        "polar_deg": panel.polar_deg,
        "azimuth_deg": panel.azimuth_deg,
        "apart_deg": _apart_deg(panel, lobe),
        "solid_angle_ratio": lobe.solid_angle_sr / panel.solid_angle_sr,
        "seen_ratio": lobe.seen_sr / panel.seen_sr,
    }


def _apart_deg(panel: Panel, lobe: Lobe) -> float:
    across = np.linalg.norm(np.cross(panel.direction, lobe.direction))
    return float(np.degrees(np.arctan2(across, np.dot(panel.direction, lobe.direction))))
