"""One tab: its state, its view, what it asks the worker for, and what it does with the answers."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

from nicegui import ui

from designlab.app.studio.confinement import inside
from designlab.app.studio.desk import Answer, Desk
from designlab.app.studio.messages import Reply
from designlab.app.studio.runs import Runs
from designlab.app.studio.session import NotAllowed, Session, pinned, read_press
from designlab.app.studio.supervisor import Supervisor
from designlab.app.studio.url_state import Address, address_of, press_texts, query_of
from designlab.app.studio.views.design import DesignView
from designlab.app.studio.views.gap import GapView
from designlab.app.studio.views.header import Header
from designlab.app.studio.views.reconstruct import ReconstructView
from designlab.app.studio.views.study import StudyView
from designlab.sensor.design import Design, DesignError, InfeasibleDesign, load, preset, preset_names

DEFAULT = "default"
HEAD = '<link rel="stylesheet" href="/studio/studio.css"><script src="/studio/studio.js"></script>'


class View(Protocol):
    """What a view answers to."""

    def shown(self) -> None:
        """Begin when the view is shown."""
        ...


class Page:
    """A tab of the studio.

    Attributes
    ----------
    session : Session
        Design, press and undo of the tab.
    root : Path
        Folder that all files lie in.
    """

    def __init__(self, client: Any, root: Path, worker: Supervisor, runs: Runs) -> None:
        self.client, self.root, self.runs, self._worker = client, root, runs, worker
        self.session = Session(DEFAULT, preset(DEFAULT))
        self.address = Address(design=DEFAULT)
        self._views: dict[str, View] = {}
        self._boxes: dict[str, Any] = {}
        self._lanes: dict[str, Answer] = {}
        self._query = ""

    def build(self, query: str, opened: Address) -> None:
        """Lay the page out; the state is that of its address, or what the studio was opened with."""
        stated = address_of(query)
        self.address = opened if stated == Address() else stated
        problem = self._restored(self.address)
        ui.add_head_html(HEAD)
        ui.query("html").props('lang="en"')
        self._header = Header(
            self,
            undo=lambda: self._design_view.undo(),
            redo=lambda: self._design_view.redo(),
            pin=lambda: self._design_view.toggle_pin(),
        )
        makers: dict[str, Callable[[Desk], View]] = {
            "design": self._with_design,
            "study": StudyView,
            "gap": GapView,
            "reconstruct": ReconstructView,
        }
        for name, made in makers.items():
            self._boxes[name] = ui.element("main").classes("fill").props(f'data-view="{name}"')
            with self._boxes[name]:
                self._views[name] = made(self)
        ui.keyboard(on_key=self._key)
        self.show(self.address.view)
        if problem:
            self.warn(problem)

    def ask(self, lane: str, job: Any, answer: Answer, *, priority: int = 0) -> int:
        """Ask the worker; `answer` gets each step. An older request of the lane gives way to it."""
        self._lanes[lane] = answer
        design = getattr(job, "design", self.session.design)
        digest = self.session.digest if design is self.session.design else design.digest
        return self._worker.ask(self.client.id, lane, job, digest=digest, priority=priority)

    def forget(self, lane: str) -> None:
        """Forget what was asked for in a lane."""
        self._worker.forget(self.client.id, lane)

    def receive(self, reply: Reply) -> None:
        """Take an answer of the worker."""
        if (answer := self._lanes.get(reply.lane)) is not None and not self.client.is_deleted:
            with self.client:
                answer(reply)

    def worker_restarted(self) -> None:
        """Say that the worker died."""
        with self.client:
            self.warn("The worker process ended and was started again; what was asked for is on its way.")

    def open(self, source: str) -> None:
        """Begin with another design: a preset, or a file under the folder."""
        try:
            base = self.read(source)
        except (DesignError, ValueError) as error:
            self.warn(str(error))
            return
        self.begin(source, base)

    def begin(self, source: str, base: Design, edits: Mapping[str, Any] | None = None) -> None:
        """Put a design on the bench, with changes."""
        self.session = Session(source, base)
        if edits:
            self.session.restore(edits)
        self.changed()
        self.show("design")
        self._design_view.opened()

    def changed(self) -> None:
        """Show the state of the session above all views."""
        self._header.update()

    def saved(self, source: str) -> None:
        """Go on with the file that the design was saved as."""
        self._header.refresh_sources()
        self.open(source)

    def read(self, source: str) -> Design:
        """Design of a preset or of a file under the folder.

        Raises
        ------
        DesignError, ValueError
            If there is none.
        """
        return preset(source) if source in preset_names() else load(inside(self.root, source))

    def show(self, name: str) -> None:
        """Show a view."""
        for other, box in self._boxes.items():
            box.set_visibility(other == name)
        self.address = self.address._replace(view=name)
        self._header.chosen(name)
        self._views[name].shown()
        self.remember()

    def look_at(self, folder: str) -> None:
        """Note which study or diagnosis is looked at."""
        self.address = self.address._replace(folder=folder)
        self.remember()

    def remember(self) -> None:
        """Write the state into the address."""
        session = self.session
        address = Address(
            design=session.source,
            edits=session.edits,
            press=press_texts(session.press),
            pin=None if session.pin is None else session.pin.edits,
            view=self.address.view,
            folder=self.address.folder,
        )
        self.address = address
        query = query_of(address)
        if query != self._query:
            self._query = query
            ui.navigate.history.replace(f"/?{query}")

    def warn(self, text: str) -> None:
        """Say that something cannot be done."""
        ui.notify(text[:400], type="warning", position="bottom", timeout=8000, close_button="close")

    def tell(self, text: str) -> None:
        """Say that something was done."""
        ui.notify(text[:400], type="positive", position="bottom", timeout=4000)

    def _restored(self, address: Address) -> str:
        """Make the state that an address states; returns what of it cannot be made."""
        source = address.design or DEFAULT
        try:
            self.session = Session(source, self.read(source))
        except (DesignError, ValueError) as error:
            self.session = Session(DEFAULT, preset(DEFAULT))
            return str(error)
        try:
            press = read_press(address.press, self.session.press)
            self.session.restore(address.edits, press)
            if address.pin is not None:
                self.session.pin = pinned(self.session, address.pin).put_pin()
        except (DesignError, InfeasibleDesign, NotAllowed) as error:
            return f"the address cannot be used as it is: {error}"
        return ""

    def _with_design(self, desk: Desk) -> View:
        self._design_view = DesignView(desk)
        return self._design_view

    def _key(self, event: Any) -> None:
        if not event.action.keydown or not (event.modifiers.ctrl or event.modifiers.meta):
            return
        if event.key == "z" and not event.modifiers.shift:
            self._design_view.undo()
        elif event.key == "y" or (event.key == "z" and event.modifiers.shift):
            self._design_view.redo()
