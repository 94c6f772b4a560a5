"""The view of a study: its front while it runs, and the designs that its points stand for."""

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nicegui import ui

from designlab.app.studio.confinement import OutsideFolder, files_below, inside, shown
from designlab.app.studio.desk import Desk
from designlab.app.studio.messages import Picture, PictureJob, Reply, StudyJob
from designlab.app.studio.opened import STUDY_FILE
from designlab.app.studio.session import usual_press
from designlab.app.studio.studies import StudyState
from designlab.app.studio.views.stage import call, source
from designlab.optimization.study.folder import RECORD_FILE, trial_folder
from designlab.sensor.design import DesignError, load

LOOK_S = 2.0
STATE, LOOKED_AT, DESIGN_FILE = "study", "trial", "design.toml"
PRIORITY = 1
PREVIEW = """
<figure class="preview"><img id="trial-picture" alt="" hidden>
<figcaption id="trial-words">Point at a design to see its picture.</figcaption></figure>
"""
TRIAL_CELL = """
<q-td :props="props"><q-btn flat dense no-caps color="" :label="props.value"
  :aria-label="'put trial ' + props.value + ' on the bench'"
  @click.stop="() => $parent.$emit('open', props.row)"
  @mouseenter="() => $parent.$emit('look', props.row)"
  @focus="() => $parent.$emit('look', props.row)" /></q-td>
"""
EMPTY = (
    "No study under this folder. Write one with `designlab init DIR`, or give its folder: "
    "`designlab studio FOLDER`."
)


class StudyView:
    """Front, shortlist, and buttons to start, pause and go on."""

    def __init__(self, page: Desk) -> None:
        self._page = page
        self._seen: tuple[float, bool] | None = None
        self._state: StudyState | None = None
        self._plot: ui.plotly | None = None
        self._looked_at = -1
        with ui.element("div").classes("view"):
            self._empty = ui.label(EMPTY).classes("empty-words")
            with ui.row().classes("items-center") as self._bar:
                self._folder = ui.select([], on_change=self._picked, label="study").props(
                    "dense outlined options-dense"
                )
                self._folder.style("min-width: 16rem")
                self._start = ui.button("start", on_click=self._run).props(
                    'no-caps outline dense id="study-start"'
                )
                self._pause = ui.button("pause", on_click=self._stop).props(
                    'no-caps outline dense id="study-pause"'
                )
            self._words = ui.label("").classes("lead").props('aria-live="polite"')
            self._problem = ui.label("").classes("wrong").props('role="alert"')
            self._hint = ui.label("Click a point, or a row, to put its design on the bench.").classes("note")
            with ui.element("div").classes("study-body") as self._body:
                self._chart = ui.element("div").props('id="front"')
                ui.html(PREVIEW, sanitize=False)
            self._table = ui.element("div").style("width: 100%; overflow-x: auto")
        ui.timer(LOOK_S, self._look)

    def shown(self) -> None:
        """Find the studies there are, and show the one that was asked for."""
        root = self._page.root
        found = [shown(root, path.parent) for path in files_below(root, STUDY_FILE)]
        wanted = self._page.address.folder
        there = bool(found)
        self._empty.set_visibility(not there)
        for part in (self._bar, self._words, self._hint, self._body):
            part.set_visibility(there)
        if not there:
            return
        chosen = wanted if wanted in found else found[0]
        self._seen = None
        if chosen == self._folder.value:
            self._folder.set_options(found, value=chosen)
            self._look()
        else:
            self._folder.set_options(found, value=chosen)  # which tells `_picked`

    @property
    def _path(self) -> Path | None:
        if not self._folder.value:
            return None
        try:
            return inside(self._page.root, str(self._folder.value))
        except OutsideFolder:
            return None

    def _picked(self, _: Any) -> None:
        self._seen = None
        if self._page.address.view == "study":
            self._page.look_at(str(self._folder.value))
        self._look()

    def _look(self) -> None:
        """Ask for the state where the record has changed."""
        path = self._path
        if path is None or self._page.address.view != "study":
            return
        running = self._page.runs.running(path)
        self._start.set_enabled(not running and not (self._state is not None and self._state.finished))
        self._pause.set_enabled(running)
        self._start.set_text("go on" if self._state is not None and self._state.rows else "start")
        said = self._page.runs.said(path)
        if said:
            self._problem.set_text(said)
        records = [path / (RECORD_FILE + end) for end in ("", "-wal")]
        stamps = [record.stat().st_mtime for record in records if record.is_file()]
        if not stamps:
            self._words.set_text("This study was not started yet." if not running else "starting")
            return
        seen = max(stamps), running
        if seen != self._seen:
            self._seen = seen
            self._page.ask(STATE, StudyJob(path), self._told, priority=PRIORITY)

    def _run(self) -> None:
        if (path := self._path) is not None:
            self._problem.set_text("")
            self._page.runs.start(path)
            self._look()

    def _stop(self) -> None:
        if (path := self._path) is not None:
            self._page.runs.pause(path)
            self._words.set_text("pausing; what is finished is kept")

    def _told(self, reply: Reply) -> None:
        if reply.error:
            self._problem.set_text(reply.error)
        if isinstance(reply.content, StudyState):
            self._problem.set_text("")
            self._show(reply.content)

    def _show(self, state: StudyState) -> None:
        self._state = state
        self._words.set_text(f"{state.name}: {state.words}")
        self._draw(state.figure)
        self._table.clear()
        if state.rows:
            names = list(state.rows[0])
            columns = [{"name": n, "label": n, "field": n, "align": "left"} for n in names]
            with self._table:
                table = ui.table(columns=columns, rows=state.rows, row_key="trial").props("dense flat")
                table.add_slot("body-cell-trial", TRIAL_CELL)
                table.on("rowClick", lambda event: self._load(int(event.args[1]["trial"])))
                table.on("open", lambda event: self._load(int(event.args["trial"])))
                table.on("look", lambda event: self._look_at(int(event.args["trial"])))

    def _draw(self, figure: dict[str, Any] | None) -> None:
        """Draw the front. A chart that is there is drawn anew: the browser may still be laying it out."""
        if figure is None:
            self._chart.clear()
            self._plot = None
        elif self._plot is not None:
            self._plot.update_figure(_themed(figure))
        else:
            with self._chart:
                self._plot = ui.plotly(_themed(figure)).style("width: 100%; height: 26rem")
                self._plot.on("plotly_click", lambda event: self._pointed(event, self._load))
                self._plot.on("plotly_hover", lambda event: self._pointed(event, self._look_at))

    def _pointed(self, event: Any, then: Callable[[int], None]) -> None:
        points = event.args.get("points") or []
        told = points[0].get("customdata") if points else None
        if told is not None and str(told).isdigit():
            then(int(told))

    def _design_file(self, trial: int) -> Path | None:
        """File of a trial's design; None where it was evaluated in another trial."""
        path = self._path
        file = None if path is None else trial_folder(path, trial) / DESIGN_FILE
        return file if file is not None and file.is_file() else None

    def _load(self, trial: int) -> None:
        if (file := self._design_file(trial)) is not None:
            self._page.open(shown(self._page.root, file))
        else:
            self._page.warn(f"trial {trial}: its design was evaluated in another trial; choose that one")

    def _look_at(self, trial: int) -> None:
        """Show the picture of a design that is pointed at."""
        if trial == self._looked_at or (file := self._design_file(trial)) is None:
            return
        self._looked_at = trial
        try:
            design = load(file)
        except DesignError:
            return
        call(self._page.client, "words", "trial-words", f"Trial {trial}: its picture is on its way.")

        def told(reply: Reply) -> None:
            if reply.error:
                call(self._page.client, "words", "trial-words", f"Trial {trial}: {reply.error}")
            if isinstance(reply.content, Picture):
                picture = source(reply.content.file)
                call(self._page.client, "map", "trial-picture", picture, f"camera picture of trial {trial}")
                call(self._page.client, "words", "trial-words", f"Trial {trial}, {reply.content.step}")

        job = PictureJob(design, usual_press(design), quick=True)
        self._page.ask(LOOKED_AT, job, told, priority=PRIORITY)


def _themed(figure: dict[str, Any]) -> dict[str, Any]:
    """The figure on a clear ground, so that it stands on light and dark pages."""
    found = copy.deepcopy(figure)
    grid = {"gridcolor": "rgba(128,136,150,.3)", "zerolinecolor": "rgba(128,136,150,.5)"}
    layout = found["layout"]
    layout["paper_bgcolor"] = layout["plot_bgcolor"] = "rgba(0,0,0,0)"
    layout["font"] = {"color": "#7d8796", "size": 13}
    layout["margin"] = {"l": 70, "r": 20, "t": 40, "b": 60}
    for axis in ("xaxis", "yaxis"):
        layout[axis] = {**layout.get(axis, {}), **grid}
        if isinstance(title := layout[axis].get("title"), dict):
            title["font"] = {"size": 13}
    layout.pop("template", None)
    found["config"] = {"displaylogo": False, "responsive": True}
    return found
