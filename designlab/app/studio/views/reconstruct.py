"""The view of a real picture: drop it, see the relief."""

from pathlib import PurePosixPath
from typing import Any

from nicegui import ui

from designlab.app.studio.confinement import OutsideFolder, files_below, inside, shown
from designlab.app.studio.desk import Desk
from designlab.app.studio.messages import Relief, Reply, UploadJob
from designlab.app.studio.uploads import MOST_BYTES, SUFFIXES
from designlab.app.studio.views.look import FILLED
from designlab.app.studio.views.stage import call, source
from designlab.report.live_maps import scale_css

LANE = "upload"
BY_DESIGN = "the light of the design"
HOW = (
    "Drop a picture of a press. A background, the gel at rest, makes it better. A calibration "
    "(designlab calibrate --balls) needs no design."
)


class ReconstructView:
    """Two places to drop pictures at, a list of calibrations, and the relief."""

    def __init__(self, page: Desk) -> None:
        self._page = page
        self._picture: tuple[bytes, str] | None = None
        self._background: tuple[bytes, str] | None = None
        with ui.element("div").classes("view"):
            ui.label(HOW).classes("note")
            with ui.element("div").classes("columns"):
                self._upload("picture of a press", self._got_picture, "drop-picture")
                self._upload("background (optional)", self._got_background, "drop-background")
                with ui.element("div").style("min-width: 16rem"):
                    self._by = ui.select([BY_DESIGN], value=BY_DESIGN, label="read by", on_change=self._ask)
                    self._by.props("dense outlined options-dense")
            self._state = ui.label("No picture yet.").classes("note").props('role="status" id="upload-state"')
            with ui.element("div").classes("gap-pictures") as self._maps:
                for name, title in (("up-height", "height"), ("up-normals", "normals")):
                    figure = (
                        f'<figure class="map"><img id="{name}" alt="" hidden>'
                        f"<figcaption>{title}</figcaption></figure>"
                    )
                    ui.html(figure, sanitize=False)
            with ui.element("div").classes("scale").style("max-width: 30rem") as self._scale:
                self._low = ui.label("")
                ui.element("span").classes("bar").style(f"background: {scale_css()}")
                self._high = ui.label("")
            self._maps.set_visibility(False)
            self._scale.set_visibility(False)

    def shown(self) -> None:
        """Find the calibrations there are."""
        root = self._page.root
        found = [shown(root, path) for path in files_below(root, "*.npz")]
        self._by.set_options([BY_DESIGN, *found])

    def _upload(self, label: str, got: Any, name: str) -> None:
        def refused() -> None:
            self._state.set_text(f"The file must be a picture of at most {MOST_BYTES // 1_000_000} MB.")

        place = ui.upload(
            label=label,
            on_upload=got,
            on_rejected=refused,
            max_file_size=MOST_BYTES,
            auto_upload=True,
        )
        place.props(f'accept="{",".join(SUFFIXES)}" flat bordered {FILLED} id="{name}"').style("width: 18rem")

    async def _got_picture(self, event: Any) -> None:
        self._picture = await _content(event)
        self._ask(None)

    async def _got_background(self, event: Any) -> None:
        self._background = await _content(event)
        self._ask(None)

    def _ask(self, _: Any) -> None:
        if self._picture is None:
            return
        calibration = None
        if self._by.value != BY_DESIGN:
            try:
                calibration = inside(self._page.root, str(self._by.value))
            except OutsideFolder as error:
                self._state.set_text(str(error))
                return
        data, suffix = self._picture
        background, other = self._background or (None, ".png")
        job = UploadJob(self._page.session.design, data, suffix, calibration, background, other)
        self._state.set_text("reading the picture")
        self._page.ask(LANE, job, self._told)

    def _told(self, reply: Reply) -> None:
        if reply.error:
            self._state.set_text(reply.error)
        if not isinstance(reply.content, Relief):
            return
        found, client = reply.content, self._page.client
        self._maps.set_visibility(True)
        self._scale.set_visibility(True)
        call(client, "map", "up-height", source(found.height), "height, reconstructed")
        call(client, "map", "up-normals", source(found.normals), "normals, reconstructed")
        self._low.set_text(f"{found.low_mm:.2f}")
        self._high.set_text(f"{found.high_mm:.2f} mm")
        self._state.set_text(", ".join(f"{what} {value}" for what, value in found.facts.items()))


async def _content(event: Any) -> tuple[bytes, str]:
    """Content of an uploaded file, and the end of its name."""
    return await event.file.read(), PurePosixPath(str(event.file.name)).suffix[:12]
