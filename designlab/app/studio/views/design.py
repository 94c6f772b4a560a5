"""The view of a design: knobs, pictures, scores; what is turned is asked for, what comes back is shown."""

import time
from typing import Any

from nicegui import ui

from designlab.app.studio.desk import Desk
from designlab.app.studio.messages import ModelJob, Picture, PictureJob, Relief, Reply, ScoreJob
from designlab.app.studio.scoring import rows
from designlab.app.studio.session import NotAllowed
from designlab.app.studio.structure import GROUPS
from designlab.app.studio.views.knobs import Change, Knobs, fields_wrong
from designlab.app.studio.views.press import PressKnobs
from designlab.app.studio.views.scores import Scores
from designlab.app.studio.views.sensor3d import Sensor3d
from designlab.app.studio.views.stage import Stage, call, membrane_mm, place_of
from designlab.evaluation.score import Score
from designlab.sensor.design import DesignError
from designlab.simulation.contact.press import Press
from geometries.probes import REACH, Probe

REST_S = 0.8  # after the last turn, and after its first picture, before scores and drawing follow
# A browser lays the whole page out anew when a value on it changes, and shows no picture meanwhile. So knobs
# and rules follow this long after a turn, and this often while turns go on.
SETTLE_S, SETTLE_EVERY_S = 0.12, 0.5
LOOK_S = 0.1
NUDGE_MM, LARGE_NUDGE_MM = 0.1, 1.0
DEEPER = 1.08  # a step of the wheel
NOW, PINNED, SCORES, PIN_SCORES, MODEL = "picture", "pinned picture", "scores", "pinned scores", "model"
SCORE_PRIORITY, MODEL_PRIORITY, PIN_PRIORITY = 100, 2, 3
SCORES_KEPT = 40


class DesignView:
    """Knobs left, pictures in the middle, scores right."""

    def __init__(self, page: Desk) -> None:
        self._page = page
        self._turned_at = self._pictured_at = time.monotonic()
        self._unsettled_at: float | None = None  # first turn that knobs and rules do not show yet
        self._followed = ""  # digest that scores and drawing were asked for
        self._scores: dict[str, Score] = {}
        self._unscored = ""  # why the design that was followed has none
        self._grid: Picture | None = None
        self._begun = False
        self._awaited: int | None = None  # request of which no picture has come
        self._banner = ui.label("").classes("banner").props('role="alert" id="banner"')
        with ui.element("div").classes("bench"):
            with ui.element("div").classes("left").props('aria-label="Knobs"'):
                ui.label("Press").classes("heading").props('role="heading" aria-level="2"')
                self._press = PressKnobs(page.session.press, self._press_set)
                ui.label("Design").classes("heading").props('role="heading" aria-level="2"')
                self._knob_box = ui.element("div")
                with self._knob_box:
                    self._knobs = Knobs(page.session, self._turned, self._parts_changed)
            with ui.element("div").classes("middle"):
                self._stage = Stage(self._moded)
            with ui.element("div").classes("right"):
                self._table = Scores()
                self._sensor = Sensor3d(page.client, self._ask_model)
        ui.on("studio_touch", self._touched)
        ui.on("studio_push", self._pushed)
        ui.on("studio_nudge", self._nudged)
        ui.timer(LOOK_S, self._look)

    def shown(self) -> None:
        """Begin with the first picture."""
        if self._begun:
            return
        self._begun = True
        ui.run_javascript("studio.begin()")
        self._changed()
        self._ask_pinned()

    def opened(self) -> None:
        """Show a session that was begun anew."""
        self._knob_box.clear()
        with self._knob_box:
            self._knobs = Knobs(self._page.session, self._turned, self._parts_changed)
        call(self._page.client, "forget", "pinned")
        self._begun = True
        self._changed()
        self._ask_pinned()

    def undo(self) -> None:
        """Go a step back."""
        self._page.session.undo()
        self._changed()
        self._ask_pinned()

    def redo(self) -> None:
        """Go a step forth."""
        self._page.session.redo()
        self._changed()
        self._ask_pinned()

    def toggle_pin(self) -> None:
        """Put the design aside, or forget the one that is."""
        session = self._page.session
        if session.pin is None:
            session.put_pin()
        else:
            session.pin = None
            call(self._page.client, "forget", "pinned")
        self._ask_pinned()
        self._page.changed()
        self._page.remember()
        self._show_scores()

    def _turned(self, path: str, value: Any, going_on: bool) -> str:
        try:
            self._page.session.change(path, value, going_on=going_on)
        except (DesignError, NotAllowed) as error:
            return str(error).removeprefix("replace(): field ")
        if not going_on:
            self._page.session.rest()
        self._changed()
        return ""

    def _parts_changed(self, what: Change, number: int) -> None:
        """Add an LED group or a mirror, or take one away."""
        session = self._page.session
        count = len(session.design.leds.groups)
        try:
            if what == "add group":
                session.add_group(number % count)
                self._knobs.open(f"{GROUPS}.{count}")
            elif what == "remove group":
                session.remove_group(number)
            else:
                session.fold()
        except DesignError as error:
            self._page.warn(str(error).removeprefix("replace(): field "))
            return
        self._changed()
        self._settle()  # other knobs are there

    def _press_set(self, name: str, value: Any) -> str:
        press = self._page.session.press
        changes: dict[str, Any] = {name: value}
        if name in ("kind", "size_mm"):
            kept = press.probe.model_dump(include={"kind", "size_mm"})
            changes = {"probe": {**kept, name: value}}
        elif name in ("x_mm", "y_mm"):
            x, y = press.centre_mm
            changes = {"centre_mm": (value, y) if name == "x_mm" else (x, value)}
        elif name in ("depth_mm", "force_n"):
            changes = {"depth_mm": None, "force_n": None, name: value}
        return self._move(going_on=False, **changes)

    def _move(self, *, going_on: bool, **changes: Any) -> str:
        try:
            self._page.session.move_press(going_on=going_on, **changes)
        except NotAllowed as error:
            return str(error)
        self._press_changed()
        if not going_on:
            self._page.session.rest()
            self._settle()
        return ""

    def _touched(self, event: Any) -> None:
        if self._grid is None:
            return
        told = event.args
        x, y = membrane_mm(tuple(told["place"]), self._grid.columns_mm, self._grid.rows_mm)
        self._move(going_on=bool(told["going_on"]), centre_mm=(round(x, 3), round(y, 3)))

    def _pushed(self, event: Any) -> None:
        self._page.session.push(DEEPER if event.args["steps"] > 0 else 1 / DEEPER)
        self._press_changed()

    def _nudged(self, event: Any) -> None:
        step = LARGE_NUDGE_MM if event.args["large"] else NUDGE_MM
        (x, y), (right, up) = self._page.session.press.centre_mm, event.args["steps"]
        self._move(going_on=True, centre_mm=(round(x + step * right, 3), round(y + step * up, 3)))

    def _press_changed(self) -> None:
        self._asked()
        self._ask_pinned()

    def _changed(self) -> None:
        """Ask for what belongs to the state; all but the picture is shown when that is on its way."""
        self._asked()
        if self._followed != self._page.session.digest:
            self._followed = ""
            self._page.forget(SCORES)

    def _asked(self) -> None:
        """Ask for the picture; knobs are behind from now on."""
        self._turned_at = time.monotonic()
        self._ask_picture()
        if self._unsettled_at is None:
            self._unsettled_at = self._turned_at

    def _follow(self) -> None:
        """Show the number that a slider is turned to, and mark what belongs to an older design."""
        self._knobs.follow()
        if not self._followed:
            self._sensor.outdated()
            self._show_scores()

    def _settle(self) -> None:
        """Show values and rules beside the knobs, where the probe is, and the scores that there are."""
        session = self._page.session
        self._unsettled_at = None
        self._press.update(session.press)
        self._mark()
        self._page.changed()
        self._knobs.update(session)
        self._banner.set_text(fields_wrong(session.broken))
        self._banner.set_visibility(bool(self._banner.text))
        self._show_scores()

    @property
    def _shown_press(self) -> Press | None:
        return self._page.session.press if self._stage.pressed else None

    def _moded(self) -> None:
        self._ask_picture()
        self._ask_pinned()

    def _ask_picture(self) -> None:
        session = self._page.session
        self._awaited = self._page.ask(NOW, PictureJob(session.design, self._shown_press), self._picture)
        call(self._page.client, "expect", session.digest, self._awaited)

    def _ask_pinned(self) -> None:
        session = self._page.session
        self._stage.comparing(session.pin is not None)
        if session.pin is not None:
            job = PictureJob(session.pin.design, self._shown_press)
            self._page.ask(PINNED, job, self._pinned_picture, priority=PIN_PRIORITY)

    def _picture(self, reply: Reply) -> None:
        session = self._page.session
        if reply.digest != session.digest:
            return  # made for a design that is no longer shown
        if reply.number == self._awaited:
            self._awaited, self._pictured_at = None, time.monotonic()
        if reply.error:
            if self._unsettled_at is not None:
                self._settle()  # which has its own say in the banner
            self._banner.set_text(reply.error)
            self._banner.set_visibility(True)
            call(self._page.client, "fail", reply.digest)
        elif isinstance(reply.content, Picture):
            self._grid = reply.content
            self._stage.picture(
                self._page.client,
                "now",
                reply.content,
                digest=reply.digest,
                request=reply.number,
                name=session.design.name,
            )
            self._mark()
        elif isinstance(reply.content, Relief):
            self._stage.relief(self._page.client, reply.content, digest=reply.digest, request=reply.number)

    def _pinned_picture(self, reply: Reply) -> None:
        pin = self._page.session.pin
        if pin is not None and isinstance(reply.content, Picture):
            self._stage.picture(
                self._page.client,
                "pinned",
                reply.content,
                digest=pin.design.digest,
                request=reply.number,
                name=pin.design.name,
            )

    def _mark(self) -> None:
        """Put the ring where the probe is; its size is that of the probe."""
        if self._grid is None:
            return
        press = self._page.session.press
        place = place_of(press.centre_mm, self._grid.columns_mm, self._grid.rows_mm)
        width_mm = float(self._grid.columns_mm[:, -1].mean() - self._grid.columns_mm[:, 0].mean())
        call(self._page.client, "mark", [*place, 2 * _reach_mm(press.probe) / width_mm])

    def _look(self) -> None:
        """Ask for scores and drawing once the knobs are at rest."""
        now = time.monotonic()
        if self._unsettled_at is not None:
            behind = now - self._unsettled_at
            if behind > SETTLE_S or self._awaited is None:
                self._follow()
            if now - self._turned_at > SETTLE_S or behind > SETTLE_EVERY_S:
                self._settle()
        if not self._begun or now - self._turned_at < REST_S:
            return
        self._page.remember()
        session = self._page.session
        if self._awaited is not None or now - self._pictured_at < REST_S or self._followed == session.digest:
            return
        self._followed = session.digest
        self._ask_model()
        self._ask_scores()

    def _ask_model(self) -> None:
        if self._sensor.hidden:
            return
        job = ModelJob(self._page.session.design, section=self._sensor.section)
        self._page.ask(MODEL, job, self._model, priority=MODEL_PRIORITY)

    def _ask_scores(self) -> None:
        session = self._page.session
        if session.digest in self._scores:
            return
        if not session.broken:
            self._unscored = ""
            self._page.ask(SCORES, ScoreJob(session.design), self._scored, priority=SCORE_PRIORITY)
        self._table.say(self._why_unscored())

    def _why_unscored(self) -> str:
        """Why the present design has no scores yet."""
        session = self._page.session
        if session.broken:
            return "No scores: the design breaks a rule."
        if self._followed == session.digest:
            return self._unscored or "scoring; this takes some seconds"
        return "scores follow when the knobs rest"

    def _model(self, reply: Reply) -> None:
        if reply.error and reply.digest == self._page.session.digest:
            self._sensor.say(f"No drawing: {reply.error}")
        if reply.digest == self._page.session.digest and isinstance(reply.content, bytes):
            self._sensor.show(reply.content, self._page.session.design.housing.top_mm)

    def _scored(self, reply: Reply) -> None:
        if reply.error and reply.digest == self._page.session.digest:
            self._unscored = f"No scores: {reply.error}"
            self._table.say(self._unscored)
        if isinstance(reply.content, Score):
            self._keep(reply.digest, reply.content)
            self._show_scores()

    def _pin_scored(self, reply: Reply) -> None:
        pin = self._page.session.pin
        if pin is not None and isinstance(reply.content, Score):
            self._keep(pin.design.digest, reply.content)
            self._show_scores()

    def _keep(self, digest: str, score: Score) -> None:
        self._scores[digest] = score
        while len(self._scores) > SCORES_KEPT:
            del self._scores[next(iter(self._scores))]

    def _show_scores(self) -> None:
        session = self._page.session
        score = self._scores.get(session.digest)
        if score is None:
            self._table.say(self._why_unscored())
            return
        before = None
        if session.pin is not None:
            before = self._scores.get(session.pin.design.digest)
            if before is None and not session.pin.design.broken():
                job = ScoreJob(session.pin.design)
                self._page.ask(PIN_SCORES, job, self._pin_scored, priority=SCORE_PRIORITY + 1)
        self._table.show(rows(score, before), pinned=before is not None)
        told = f"fidelity {score.fidelity}"
        if session.pin is not None:
            told += "; changes since the pin" if before is not None else "; the pinned design is scored next"
        self._table.say(told, stale=False)


def _reach_mm(probe: Probe) -> float:
    return REACH[probe.kind] * probe.size_mm
