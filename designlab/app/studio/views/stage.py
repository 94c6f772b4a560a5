"""The middle: the camera's picture, what is read off it, and the sensor in three dimensions."""

import base64
import json
import math
from collections.abc import Callable
from typing import Any

from nicegui import ui

from designlab.app.studio.messages import Picture, Relief
from designlab.app.studio.views.look import TOGGLE
from designlab.core.types import Array
from designlab.report.live_maps import scale_css

STAGE = """
<figure id="stage" data-mode="pressed" class="stage">
  <div id="pictures" class="pictures" tabindex="0" role="application"
    aria-label="Camera picture. Drag to move the probe; wheel, plus and minus press deeper; arrows move it.">
    <img id="picture-now" alt="" draggable="false" hidden>
    <img id="picture-pinned" alt="" draggable="false" hidden>
    <span id="probe-mark" class="probe-mark" hidden></span>
    <span class="empty">The first picture is on its way.</span>
  </div>
  <figcaption id="caption"></figcaption>
</figure>
"""
MODES = {"pressed": "pressed", "untouched": "untouched"}


class Stage:
    """Pictures and maps; `moded` is called when another state of the gel is to be shown."""

    def __init__(self, moded: Callable[[], None]) -> None:
        self._moded = moded
        with ui.element("div").classes("stage-bar"):
            self._mode = ui.toggle(MODES, value="pressed", on_change=self._set_mode)
            self._mode.props(f'{TOGGLE} aria-label="what is shown"')
            ui.html('<span id="facts" class="facts"></span>', sanitize=False)
            with ui.element("div").classes("compare") as self._compare:
                ui.label("pinned")
                wipe = ui.slider(min=0, max=100, value=50).classes("wipe")
                wipe.props('dense aria-label="how much of the pinned picture is shown" id="wipe"')
                wipe.on("update:model-value", js_handler="(share) => studio.wipe(share)")
                ui.label("now")
                flick = ui.button("flick").props('dense flat no-caps id="flick"')
                flick.on("click", js_handler=FLICK)
            self._compare.set_visibility(False)
        ui.html(STAGE, sanitize=False).classes("stage-box")
        with ui.element("div").classes("maps") as self._maps:
            with ui.element("div"):
                self._map("map-height", "height, reconstructed")
                with ui.element("div").classes("scale"):
                    self._low = ui.label("")
                    ui.element("span").classes("bar").style(f"background: {scale_css()}")
                    self._high = ui.label("")
            self._map("map-normals", "normals, reconstructed")
            self._read = ui.label("").classes("facts read").props('id="relief-facts"')
        self._maps.set_visibility(False)
        self._read_off = False

    def _map(self, name: str, title: str) -> None:
        picture = (
            f'<figure class="map"><img id="{name}" alt="" hidden><figcaption>{title}</figcaption></figure>'
        )
        ui.html(picture, sanitize=False)

    @property
    def pressed(self) -> bool:
        """Whether the press is to be shown, or the untouched gel."""
        return bool(self._mode.value == "pressed")

    def _set_mode(self, event: Any) -> None:
        ui.run_javascript(f"studio.mode({event.value!r})")
        self._maps.set_visibility(self.pressed and self._read_off)
        self._moded()

    def comparing(self, shown: bool) -> None:
        """Show or hide what flicks between the pinned picture and the present one."""
        self._compare.set_visibility(shown)

    def picture(
        self, client: Any, slot: str, found: Picture, *, digest: str, request: int, name: str
    ) -> None:
        """Show a picture in the slot ``now`` or ``pinned``."""
        caption = found.step
        if math.isfinite(found.grain):
            caption += f"; grain {found.grain:.1%} of the light"
        elif found.step.startswith("coarse"):
            caption += "; grain is that of few photons"
        if found.note:
            caption += f". {found.note}"
        payload = {
            "src": source(found.file),
            "digest": digest,
            "request": request,
            "step": found.step,
            "caption": caption,
            "alt": f"camera picture of {name}",
            "shape": "{} / {}".format(*found.shape),
            "facts": ", ".join(f"{what} {value}" for what, value in found.facts.items()),
        }
        call(client, "show", slot, payload)

    def relief(self, client: Any, found: Relief, *, digest: str, request: int) -> None:
        """Show what was read off the press of a picture."""
        self._read_off = True
        self._maps.set_visibility(self.pressed)
        call(client, "relief", digest, request)
        call(client, "map", "map-height", source(found.height), "height of the membrane, reconstructed")
        call(client, "map", "map-normals", source(found.normals), "normals of the membrane, reconstructed")
        self._low.set_text(f"{found.low_mm:.2f}")
        self._high.set_text(f"{found.high_mm:.2f} mm")
        self._read.set_text("\n".join(f"{what} {value}" for what, value in found.facts.items()))


FLICK = (
    "() => { const s = getComputedStyle(document.getElementById('stage')).getPropertyValue('--wipe');"
    " studio.wipe(parseFloat(s) > 50 ? 0 : 100); }"
)


def source(file: bytes) -> str:
    """A PNG or JPEG file as a source of an image."""
    kind = "png" if file.startswith(b"\x89PNG") else "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(file).decode()}"


def call(client: Any, name: str, *arguments: Any) -> None:
    """Call a function of the page's own script."""
    told = ", ".join(json.dumps(argument) for argument in arguments)
    client.run_javascript(f"studio.{name}({told})")


def membrane_mm(place: tuple[float, float], columns_mm: Array, rows_mm: Array) -> tuple[float, float]:
    """Point of the membrane (mm) that a place of the picture shows, from the grid of `Picture`."""
    from scipy.ndimage import map_coordinates

    rows, columns = columns_mm.shape
    at = [[place[1] * (rows - 1)], [place[0] * (columns - 1)]]
    x, y = (float(map_coordinates(field, at, order=1, mode="nearest")[0]) for field in (columns_mm, rows_mm))
    return x, y


def place_of(point_mm: tuple[float, float], columns_mm: Array, rows_mm: Array) -> tuple[float, float]:
    """Where a point of the membrane lies in the picture, as shares of its width and height."""
    x, y = columns_mm.mean(axis=0), rows_mm.mean(axis=1)
    across = (point_mm[0] - x[0]) / (x[-1] - x[0])
    down = (point_mm[1] - y[0]) / (y[-1] - y[0])
    return float(across), float(down)
