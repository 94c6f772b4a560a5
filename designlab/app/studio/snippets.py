"""Command lines and Python that do what the page shows."""

import shlex
from collections.abc import Mapping
from typing import Any

from designlab.app.studio.url_state import press_texts
from designlab.sensor.design import preset_names
from designlab.simulation.contact.press import Press


def command_lines(file: str, press: Press | None, *, out: str = "picture.png") -> str:
    """Commands that render the picture, score the design and export its parts.

    Parameters
    ----------
    file : str
        Preset, or file of the design.
    press : Press or None
        None for the untouched gel.
    out : str
        Picture that is written.
    """
    render = ["designlab", "render", file]
    if press is not None:
        for name, text in press_texts(press).items():
            render += [f"--{name.replace('_', '-')}", text]
    render += ["-o", out]
    lines = (render, ["designlab", "evaluate", file], ["designlab", "export", file, "--out", "parts"])
    return "\n".join(shlex.join(line) for line in lines)


def python_lines(source: str, edits: Mapping[str, Any], press: Press | None) -> str:
    """Python that makes the same design and picture, as a notebook types it."""
    lines = ["import designlab as dl", ""]
    start = f"dl.preset({source!r})" if source in preset_names() else f"dl.load({source!r})"
    lines.append(f"design = {start}")
    if edits:
        changed = ",\n".join(f"    {path!r}: {value!r}" for path, value in edits.items())
        lines.append(f"design = design.replace({{\n{changed},\n}})")
    if press is None:
        lines.append("frame = dl.render(design)")
    else:
        told = [f"probe={press.probe.text!r}"]
        for name in ("depth_mm", "force_n"):
            if (value := getattr(press, name)) is not None:
                told.append(f"{name}={value:.6g}")
        if press.centre_mm != (0.0, 0.0):
            told.append("centre_mm=({:.6g}, {:.6g})".format(*press.centre_mm))
        if press.yaw_deg:
            told.append(f"yaw_deg={press.yaw_deg:.6g}")
        lines.append(f"frame = dl.render(design, dl.Press({', '.join(told)}))")
    lines += ["frame.show()", "score = dl.evaluate(design)"]
    return "\n".join(lines)
