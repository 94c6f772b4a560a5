"""The view of a gap: a frame beside the model, before and after the effects that were named."""

from pathlib import Path
from typing import Any

from nicegui import ui

from designlab.app.studio.confinement import OutsideFolder, files_below, inside, shown
from designlab.app.studio.desk import Desk
from designlab.app.studio.gaps import REPORT, GapPictures, GapState, Knob, measurements, report_of
from designlab.app.studio.messages import GapJob, Reply
from designlab.app.studio.views.look import TOGGLE
from designlab.app.studio.views.stage import call, source
from designlab.report.live_maps import RESIDUAL_MAP, scale_css

LANE = "gap"
PICTURES = {"measured": "measured", "before": "as given", "after": "with effects"}
RESIDUALS = {"residual before": "as given", "residual after": "with effects"}
EMPTY = (
    "No diagnosis under this folder. `designlab gap diagnose MEASUREMENT --model MODEL --out DIR` makes one."
)
NO_MEASUREMENT = "The measurement of this diagnosis is not under this folder; put it there to see its frames."
FLICK_HELP = "The keys 1 to 3 flick between the pictures."


class GapView:
    """Pictures and residuals to flick between, effects to switch, values to move within their intervals."""

    def __init__(self, page: Desk) -> None:
        self._page = page
        self._off: set[str] = set()
        self._values: dict[str, float] = {}
        self._frame = 0
        self._last: GapPictures | None = None
        self._shape: tuple[Any, ...] = ()
        self._quiet = False
        with ui.element("div").classes("view"):
            self._empty = ui.label(EMPTY).classes("empty-words")
            with ui.row().classes("items-center") as self._bar:
                self._folder = self._select("diagnosis", self._picked)
                self._measurement = self._select("measurement", self._asked)
                self._frames = self._select("frame", self._frame_picked)
            self._verdict = ui.label("").classes("lead").props('aria-live="polite" id="gap-verdict"')
            with ui.expansion("what else the diagnosis says").props("dense").classes("part") as self._more:
                self._rest = ui.label("").classes("said")
            self._state = ui.label("").classes("note").props('role="status" id="gap-state"')
            with ui.element("div").classes("gap-pictures") as self._pictures:
                with ui.element("div"):
                    self._shown = ui.toggle(PICTURES, value="measured", on_change=self._draw).props(
                        f'{TOGGLE} id="gap-flick" aria-label="picture"'
                    )
                    ui.html('<img id="gap-picture" class="gap-image" alt="" hidden>', sanitize=False)
                with ui.element("div"):
                    self._left = ui.toggle(RESIDUALS, value="residual before", on_change=self._draw).props(
                        f'{TOGGLE} aria-label="residual"'
                    )
                    ui.html('<img id="gap-residual" class="gap-image" alt="" hidden>', sanitize=False)
                    with ui.element("div").classes("scale"):
                        self._low = ui.label("")
                        ui.element("span").classes("bar").style(f"background: {scale_css(RESIDUAL_MAP)}")
                        self._high = ui.label("")
            self._rms = ui.label("").classes("facts").props('id="gap-rms"')
            self._knobs = ui.element("div").classes("columns")
        ui.keyboard(on_key=self._key)

    def shown(self) -> None:
        """Find the diagnoses there are, and show the one that was asked for."""
        root = self._page.root
        reports = files_below(root, REPORT)
        found = [shown(root, path.parent) for path in reports if (path.parent / "model.toml").is_file()]
        there = bool(found)
        self._empty.set_visibility(not there)
        for part in (self._bar, self._verdict, self._more, self._state, self._pictures, self._rms):
            part.set_visibility(there)
        if there:
            wanted = self._page.address.folder
            self._folder.set_options(found, value=wanted if wanted in found else found[0])
            self._picked(None)

    def _select(self, label: str, changed: Any) -> Any:
        found = ui.select([], label=label, on_change=changed).props("dense outlined options-dense")
        return found.style("min-width: 13rem")

    def _inside(self, name: Any) -> Path | None:
        try:
            return inside(self._page.root, str(name)) if name else None
        except OutsideFolder:
            return None

    def _picked(self, _: Any) -> None:
        folder = self._inside(self._folder.value)
        if folder is None or self._page.address.view != "gap":
            return
        self._page.look_at(str(self._folder.value))
        self._off, self._values, self._frame, self._shape, self._last = set(), {}, 0, (), None
        self._knobs.clear()
        try:
            report = report_of(folder)
        except (OSError, ValueError) as error:
            self._state.set_text(str(error))
            return
        said = [str(line) for line in report.get("statement", ())] or [str(report["verdict"])]
        self._verdict.set_text(said[0])
        self._rest.set_text(" ".join(said[1:]))
        named = str(report.get("provenance", {}).get("measurement", ""))
        there = [shown(self._page.root, path) for path in measurements(self._page.root, named)]
        if not there:
            self._measurement.set_options([])
            self._state.set_text(NO_MEASUREMENT)
            return
        self._measurement.set_options(there, value=there[0])
        self._asked(None)

    def _frame_picked(self, event: Any) -> None:
        if not self._quiet and event.value is not None:
            self._frame = list(self._frames.options).index(event.value)
            self._asked(None)

    def _asked(self, _: Any) -> None:
        folder, measurement = self._inside(self._folder.value), self._inside(self._measurement.value)
        if folder is None or measurement is None:
            return
        job = GapJob(folder, measurement, self._frame, frozenset(self._off), dict(self._values))
        self._state.set_text("simulating the frame")
        self._page.ask(LANE, job, self._told)

    def _told(self, reply: Reply) -> None:
        if reply.error:
            self._state.set_text(reply.error)
        elif isinstance(reply.content, GapState):
            self._show(reply.content)
        elif isinstance(reply.content, GapPictures):
            self._last = reply.content
            self._draw(None)
        if reply.last and not reply.error:
            self._state.set_text(f"Brightness of each LED group is fitted to the frame. {FLICK_HELP}")

    def _show(self, state: GapState) -> None:
        self._quiet = True
        self._frames.set_options(state.frames, value=state.frames[min(self._frame, len(state.frames) - 1)])
        self._quiet = False
        shape = tuple(knob.key for knob in state.knobs)
        if shape == self._shape:
            return
        self._shape = shape
        self._knobs.clear()
        with self._knobs:
            for name in dict.fromkeys(knob.effect for knob in state.knobs):
                self._effect(name, [knob for knob in state.knobs if knob.effect == name])
            if not state.knobs:
                ui.label("No effect was named.").classes("note")

    def _effect(self, name: str, knobs: list[Knob]) -> None:
        with ui.element("section").classes("panel").props(f'aria-label="{name}"'):
            ui.switch(name, value=True, on_change=lambda event: self._switch(name, event.value)).props(
                f'data-effect="{name}"'
            )
            ui.label(knobs[0].summary).classes("note")
            for knob in knobs:
                self._knob(knob)

    def _knob(self, knob: Knob) -> None:
        label = f"{knob.parameter.replace('_', ' ')} {knob.unit}".strip()
        ends = f"{knob.low:.3g} to {knob.high:.3g}"
        with ui.element("div").classes("gap-knob"):
            ui.label(label)
            step = max(knob.high - knob.low, 1e-9) / 100
            slider = ui.slider(
                min=knob.low, max=max(knob.high, knob.low + 1e-9), step=step, value=float(f"{knob.value:.4g}")
            )
            slider.props(f'dense label aria-label="{label}"')
            ui.label().bind_text_from(slider, "value", lambda value: f"{value:.3g}").classes("facts")
            slider.on("change", lambda: self._move(knob.key, float(slider.value)))
            ui.label(ends).classes("note")

    def _switch(self, name: str, on: bool) -> None:
        (self._off.discard if on else self._off.add)(name)
        self._asked(None)

    def _move(self, key: str, value: float) -> None:
        self._values[key] = value
        self._asked(None)

    def _draw(self, _: Any) -> None:
        if self._last is None:
            return
        found, client = self._last, self._page.client
        picture, residual = str(self._shown.value), str(self._left.value)
        call(client, "map", "gap-picture", source(found.pictures[picture]), PICTURES[picture])
        call(
            client, "map", "gap-residual", source(found.pictures[residual]), f"residual {RESIDUALS[residual]}"
        )
        self._low.set_text(f"−{found.limit:.1%}")
        self._high.set_text(f"+{found.limit:.1%} of the mean")
        self._rms.set_text(
            f"residual, root mean square: {found.rms['before']:.2%} of the mean as given, "
            f"{found.rms['after']:.2%} with effects"
        )

    def _key(self, event: Any) -> None:
        if event.action.keydown and self._page.address.view == "gap" and str(event.key) in ("1", "2", "3"):
            self._shown.set_value(list(PICTURES)[int(str(event.key)) - 1])
