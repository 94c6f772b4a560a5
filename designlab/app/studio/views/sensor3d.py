"""The sensor in three dimensions: parts, LEDs and the camera's view, to be turned by hand."""

import base64
from collections.abc import Callable
from typing import Any

from nicegui import background_tasks, ui

from designlab.app.studio.views.stage import call

WIDTH_PX, HEIGHT_PX = 296, 260
ANSWER_S = 30.0  # that a busy page may take
FAR = 1.45  # of the camera, in heights of the sensor
NO_WEBGL = "This browser has no WebGL: the sensor is not drawn."
HAS_WEBGL = "!!document.createElement('canvas').getContext('webgl2')"


class Sensor3d:
    """A view of the sensor that is turned with the mouse; `wanted` is called when another one is."""

    def __init__(self, client: Any, wanted: Callable[[], None]) -> None:
        self._client = client
        self._scene: Any = None
        self._drawn: Any = None
        self._asked = False
        with ui.element("section").props('aria-label="Sensor"').style("width: 100%"):
            ui.label("Sensor").classes("heading").props('role="heading" aria-level="2"')
            self._box = ui.element("div").classes("model")
            self._words = ui.label("The drawing follows.").classes("note").props('id="model-state"')
            with ui.element("div").classes("model-bar"):
                self._drawing = ui.switch("drawing", value=True, on_change=self._hide)
                self._drawing.props('dense id="model-shown"')
                self._section = ui.switch("cut open", on_change=wanted).props('dense id="model-section"')
        self._wanted = wanted

    def _hide(self, event: Any) -> None:
        for part in (self._box, self._words, self._section):
            part.set_visibility(event.value)
        if event.value:
            self._wanted()

    @property
    def hidden(self) -> bool:
        """Whether no drawing is wanted."""
        return not self._drawing.value

    @property
    def section(self) -> bool:
        """Whether the sensor is to be drawn cut open."""
        return bool(self._section.value)

    def say(self, text: str) -> None:
        """Say why nothing is drawn."""
        self._words.set_text(text)

    def outdated(self) -> None:
        """Say that what is drawn is not the present design."""
        if self._drawn is not None:
            self._words.set_text("previous design; the drawing follows")

    async def _begin(self) -> bool:
        if self._asked:
            return self._scene is not None
        self._asked = True
        try:
            drawn = await self._client.run_javascript(HAS_WEBGL, timeout=ANSWER_S)
        except TimeoutError:  # the page is busy, or gone; the next drawing asks again
            self._asked = False
            return False
        if not drawn:
            self._words.set_text(NO_WEBGL)
            return False
        with self._box:
            self._scene = ui.scene(
                width=WIDTH_PX, height=HEIGHT_PX, grid=False, background_color="#dfe3ea", show_stats=False
            )
        return True

    def show(self, glb: bytes, height_mm: float) -> None:
        """Show a model, binary glTF, of so high a sensor."""
        background_tasks.create(self._show(glb, height_mm), name="sensor model")

    async def _show(self, glb: bytes, height_mm: float) -> None:
        with self._client:
            if not await self._begin():
                return
            source = "data:model/gltf-binary;base64," + base64.b64encode(glb).decode()
            before = self._drawn
            if before is None:
                far = height_mm * FAR
                middle = {"look_at_x": 0, "look_at_y": 0, "look_at_z": height_mm / 2}
                self._scene.move_camera(x=0.4 * far, y=-0.9 * far, z=1.1 * far, duration=0, **middle)
            call(self._client, "calm", self._scene.html_id)
            with self._scene:
                self._drawn = self._scene.gltf(source)
            if before is not None:
                before.delete()
            self._words.set_text("drag to turn, wheel to come nearer")
