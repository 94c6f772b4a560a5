"""Knobs of the press: probe, depth or force, place and turn."""

from collections.abc import Callable
from typing import Any

from nicegui import ui

from designlab.simulation.contact.press import Press
from geometries.probes import SIZES

KINDS = [kind for kind in SIZES if kind != "mesh"]
FIELDS = (
    ("size_mm", "size", "mm"),
    ("depth_mm", "depth", "mm"),
    ("force_n", "force", "N"),
    ("x_mm", "x", "mm"),
    ("y_mm", "y", "mm"),
    ("yaw_deg", "yaw", "deg"),
)


class PressKnobs:
    """Knobs of a press; `moved` is called with the changed field and its value, and returns what is wrong."""

    def __init__(self, press: Press, moved: Callable[[str, Any], str]) -> None:
        self._moved, self._quiet = moved, True
        self._entries: dict[str, Any] = {}
        with ui.element("section").classes("press").props('aria-label="Press"'):
            self._kind = ui.select(KINDS, value=press.probe.kind, on_change=self._picked)
            self._kind.props('dense outlined options-dense aria-label="probe"').classes("entry wide")
            with ui.element("div").classes("press-fields"):
                for name, label, unit in FIELDS:
                    with ui.element("label").classes("small"):
                        ui.label(f"{label} ({unit})")
                        entry = ui.input().props(
                            f'dense outlined inputmode="decimal" aria-label="{label} ({unit})"'
                        )
                        entry.on("change", lambda event, name=name: self._set(name, event.args))
                        self._entries[name] = entry
            self._wrong = ui.label("").classes("wrong").props('role="alert"')
        self.update(press)

    def update(self, press: Press) -> None:
        """Show a press."""
        self._quiet = True
        values = {
            "size_mm": press.probe.size_mm,
            "depth_mm": press.depth_mm,
            "force_n": press.force_n,
            "x_mm": press.centre_mm[0],
            "y_mm": press.centre_mm[1],
            "yaw_deg": press.yaw_deg,
        }
        for name, value in values.items():
            self._entries[name].set_value("" if value is None else f"{value:.4g}")
        self._kind.set_value(press.probe.kind)
        self._wrong.set_text("")
        self._quiet = False

    def _picked(self, event: Any) -> None:
        if not self._quiet:
            self._wrong.set_text(self._moved("kind", event.value))

    def _set(self, name: str, written: Any) -> None:
        text = str(written if isinstance(written, str) else self._entries[name].value)
        text = text.strip().replace(",", ".")
        if not text and name in ("depth_mm", "force_n"):
            return
        try:
            value = float(text)
        except ValueError:
            self._wrong.set_text(f"{name}: must be a number, got {text[:20]!r}")
            return
        self._wrong.set_text(self._moved(name, value))
