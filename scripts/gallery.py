"""Draw the picture gallery of docs/gallery.md: each optical effect off and on, side by side.

.venv/bin/python scripts/gallery.py               every picture, into docs/images/gallery
.venv/bin/python scripts/gallery.py haze lens     these alone

Every panel is the preset named in `FIGURES` with the TOML lines below it merged in. "mean"
is the mean radiance of the picture over that of the first panel.
"""

import argparse
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from designlab.core.images import tone_map
from designlab.sensor.design import Design, loads, preset_text
from designlab.simulation.contact.press import Press
from designlab.simulation.simulator import Simulator
from geometries.probes import parse

TARGET = Path(__file__).parents[1] / "docs" / "images" / "gallery"
COLUMNS, SAMPLES, SEED = 320, 256, 1
GAP_PX, LINE_PX, FONT_PX = 8, 15, 12


@dataclass(frozen=True)
class Figure:
    """One picture of the gallery.

    Attributes
    ----------
    panels : tuple of str
        TOML lines that are merged into the preset, one text for each panel.
    press : tuple of (str, float), or None
        Probe and depth (mm) at the centre; None is the untouched gel.
    shared_white : bool
        Whether all panels share one brightness; else each is shown as bright as its own camera would.
    always : str
        Lines that every panel has besides its own.
    """

    panels: tuple[str, ...]
    press: tuple[str, float] | None = ("sphere:5", 0.8)
    shared_white: bool = False
    always: str = ""
    preset: str = "default"


FIGURES: dict[str, Figure] = {
    "gel": Figure(
        (
            '[elastomer]\nshape = "flat"\n[gelcore]\nshape = "hexagonal"',
            '[elastomer]\nshape = "dome"\noutline = "round"\nradius_mm = 35.0\n'
            '[gelcore]\nshape = "dome"\nradius_mm = 33.0',
            '[elastomer]\nshape = "freeform"\noutline = "round"\nthickness_mm = 3.0\n'
            "profile_mm = [[0, 0], [5, 0.1],\n  [9, 0.9], [13, 2.4]]",
        ),
    ),
    "coupling": Figure(
        (
            '[leds]\ncoupling = "air_gap"\nradius_mm = 13.3',
            '[leds]\ncoupling = "bonded"\nradius_mm = 13.05',
            '[leds]\ncoupling = "embedded"\nradius_mm = 11.5',
        ),
    ),
    "profile": Figure(
        (
            "[leds]\nprofile.exponent = 1.0",
            "[leds]\nprofile.beam_deg = 60.0",
            "[leds]\nprofile.beam_deg = 20.0",
        ),
        press=None,
        preset="gelsight-2020-flat",
        always="[leds]\ntilt_deg = 35.0",
    ),
    "sides": Figure(
        (
            '[gelcore]\nside_finish = "painted"\npaint_reflectance = 0.0',
            '[gelcore]\nside_finish = "painted"\npaint_reflectance = 0.9',
            '[gelcore]\nside_finish = "polished"',
            '[gelcore]\nside_finish = "ground"\nground_roughness = 0.3',
        ),
    ),
    "absorption": Figure(
        (
            "[optics]\ngelcore_absorption_per_mm = [0.0]",
            "[optics]\ngelcore_absorption_per_mm = [0.03]",
            "[optics]\ngelcore_absorption_per_mm = [0.1]",
        ),
        shared_white=True,
    ),
    "coating": Figure(
        (
            "[optics]\ncoating_specular = 0.0",
            "[optics]\ncoating_specular = 0.5\ncoating_roughness = 0.5",
            "[optics]\ncoating_specular = 0.5\ncoating_roughness = 0.2",
        ),
    ),
    "markers": Figure(
        (
            "[optics]\nmarker_pitch_mm = 0.0",
            "[optics]\nmarker_pitch_mm = 1.5\nmarker_diameter_mm = 0.5\nmarker_reflectance = 0.05",
        ),
    ),
    "leak": Figure(
        (
            "[optics]\ncoating_transmittance = 0.0",
            "[optics]\ncoating_transmittance = 0.5\nobject_reflectance = 0.0",
            "[optics]\ncoating_transmittance = 0.5\nobject_reflectance = 0.8",
        ),
        press=("star:6", 0.3),
        shared_white=True,
        always="[optics]\nmembrane_albedo = [0.3]",
    ),
    "lens": Figure(
        (
            '[camera]\nlens = "pinhole"',
            "[camera]\ndistortion.k1 = -1.0\ndistortion.k2 = 1.0",
            '[camera]\nlens = "fisheye"\nhorizontal_fov_deg = 150.0',
        ),
        always="[optics]\nmarker_pitch_mm = 1.5",
    ),
    "defocus": Figure(
        (
            "[camera]\n# no focus_mm: all is sharp",
            "[camera]\nfocus_mm = 20.8\naperture_mm = 1.5",
            "[camera]\nfocus_mm = 12.0\naperture_mm = 1.5",
        ),
        press=("star:6", 0.6),
        always="[optics]\nmarker_pitch_mm = 1.5",
    ),
    "vignetting": Figure(
        (
            "[camera]\nvignetting.cosine_power = 0.0",
            "[camera]\nvignetting.cosine_power = 4.0",
            "[camera]\nvignetting.a1 = -1.8\nvignetting.a2 = 0.9",
        ),
        shared_white=True,
    ),
    "housing": Figure(
        ("[optics]\nhousing_reflectance = [0.0]", "[optics]\nhousing_reflectance = [0.8]"),
        preset="gelsight-2020-flat",
        always="[optics]\npath_length = 16",
    ),
    "colour": Figure(
        ("# no camera.sensitivity, no mixing", '[camera]\nsensitivity = "imx219"'),
    ),
    "haze": Figure(
        (
            "[optics]\ngelcore_scattering_per_mm = 0.0",
            "[optics]\ngelcore_scattering_per_mm = 0.01",
            "[optics]\ngelcore_scattering_per_mm = 0.05",
        ),
        shared_white=True,
    ),
}


def changed(name: str, *changes: str) -> Design:
    """Preset with TOML lines merged in: tables are merged, anything else is replaced."""
    content = tomllib.loads(preset_text(name))
    for text in changes:
        content = _merged(content, tomllib.loads(text))
    import tomli_w

    return loads(tomli_w.dumps(content), source=f"preset {name}, changed")


def _merged(content: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    found = dict(content)
    for key, value in change.items():
        own = found.get(key)
        if isinstance(own, Mapping) and isinstance(value, Mapping):
            value = _merged(own, value)
        found[key] = value
    return found


def pictures(figure: Figure) -> list[NDArray[np.float32]]:
    """Linear pictures of a figure's panels."""
    press = figure.press and Press(probe=parse(figure.press[0]), depth_mm=figure.press[1], yaw_deg=10.0)
    found = []
    for panel in figure.panels:
        design = changed(figure.preset, figure.always, panel)
        design.require_feasible()
        simulator = Simulator(design, columns=COLUMNS, samples=SAMPLES, seed=SEED)
        found.append(simulator.frame(press or None).mixed)
    return found


def page(figure: Figure, panels: list[NDArray[np.float32]]) -> Image.Image:
    """Panels side by side, the lines of each and its mean brightness below it."""
    import matplotlib

    font = ImageFont.truetype(
        str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSansMono.ttf"), FONT_PX
    )
    whites = [float(np.percentile(panel, 99.9)) for panel in panels]
    if figure.shared_white:
        whites = [max(whites)] * len(panels)
    labels = [
        [*text.splitlines(), f"mean {panel.mean() / panels[0].mean():.2f}"]
        for text, panel in zip(figure.panels, panels, strict=True)
    ]
    rows = max(panel.shape[0] for panel in panels)
    height = rows + GAP_PX + LINE_PX * max(len(label) for label in labels)
    drawn = Image.new("RGB", (len(panels) * (COLUMNS + GAP_PX) - GAP_PX, height), "white")
    pen = ImageDraw.Draw(drawn)
    for number, (panel, white, label) in enumerate(zip(panels, whites, labels, strict=True)):
        left = number * (COLUMNS + GAP_PX)
        drawn.paste(Image.fromarray(tone_map(panel, white)), (left, 0))
        for line, text in enumerate(label):
            pen.text((left, rows + GAP_PX // 2 + line * LINE_PX), text, font=font, fill="black")
    return drawn


def main() -> None:
    """Draw the figures named on the command line, all of them where none is."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "figures", nargs="*", choices=[[], *FIGURES], metavar="FIGURE", help=", ".join(FIGURES)
    )
    TARGET.mkdir(parents=True, exist_ok=True)
    for name in parser.parse_args().figures or FIGURES:
        figure = FIGURES[name]
        page(figure, pictures(figure)).save(TARGET / f"{name}.jpg", quality=88, subsampling=0, optimize=True)
        print(TARGET / f"{name}.jpg")


if __name__ == "__main__":
    main()
