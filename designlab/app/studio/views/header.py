"""The line above all views: which design, which view, undo, pin, save, and the colours of the page."""

from collections.abc import Callable
from typing import Any

from nicegui import ui

from designlab.app.studio.confinement import files_below, shown
from designlab.app.studio.desk import Desk
from designlab.app.studio.views.dialogs import copy_dialog, export_dialog, save_dialog
from designlab.sensor.design import preset_names

VIEWS = {"design": "Design", "study": "Study", "gap": "Gap", "reconstruct": "Reconstruct"}
MOST_FILES = 200
Pressed = Callable[[], None]


class Header:
    """The line above the views."""

    def __init__(self, page: Desk, *, undo: Pressed, redo: Pressed, pin: Pressed) -> None:
        self._page, self._quiet = page, True
        self._dark = ui.dark_mode(None)
        with ui.element("header").classes("top"):
            ui.label("designlab studio").classes("brand")
            self._source = ui.select(self._sources(), value=page.session.source, on_change=self._opened)
            self._source.props('dense outlined options-dense aria-label="design to open"').classes(
                "entry source"
            )
            self._name = ui.label("").classes("design-name")
            with ui.tabs(on_change=self._tab).props("dense no-caps inline-label") as self._tabs:
                for name, title in VIEWS.items():
                    ui.tab(name, label=title)
            self._undo = self._button("undo", "undo (Ctrl+Z)", undo)
            self._redo = self._button("redo", "redo (Ctrl+Y)", redo)
            self._pin = self._button("pin", "put this design aside to compare with", pin)
            self._button("save", "write the design as a TOML file", lambda: save_dialog(page))
            self._button("export", "write the files to make it", lambda: export_dialog(page))
            self._button("copy", "command line and Python that do the same", lambda: copy_dialog(page))
            self._button("light/dark", "colours of the page", self._toggle)
        self._quiet = False
        self.update()

    def update(self) -> None:
        """Show the state of the session."""
        session = self._page.session
        self._quiet = True
        if session.source not in self._source.options:
            self._source.set_options([*self._source.options, session.source])
        self._source.set_value(session.source)
        count = len(session.edits)
        self._name.set_text(f"{count} change{'s' if count > 1 else ''}" if count else "")
        if self._name.props.get("title") != session.design.name:  # to set it lays the page out anew
            self._name.props["title"] = session.design.name  # which lists them
        self._undo.set_enabled(session.can_undo)
        self._redo.set_enabled(session.can_redo)
        self._pin.set_text("pin" if session.pin is None else "unpin")
        self._quiet = False

    def refresh_sources(self) -> None:
        """Look for design files again."""
        self._source.set_options(self._sources())

    def chosen(self, view: str) -> None:
        """Mark the view that is shown."""
        self._quiet = True
        self._tabs.set_value(view)
        self._quiet = False

    def _button(self, text: str, meaning: str, pressed: Pressed) -> Any:
        button = ui.button(text, on_click=pressed).props("flat dense no-caps")
        button.props(f'id="{text.replace("/", "-")}"')
        with button:
            ui.tooltip(meaning).props("delay=400")
        return button

    def _sources(self) -> list[str]:
        root = self._page.root
        others = ("study.toml", "measurement.toml", "pyproject.toml")
        files = [shown(root, path) for path in files_below(root, "*.toml") if path.name not in others]
        return [*preset_names(), *files[:MOST_FILES]]

    def _opened(self, event: Any) -> None:
        if not self._quiet:
            self._page.open(event.value)

    def _tab(self, event: Any) -> None:
        if not self._quiet:
            self._page.show(str(event.value))

    def _toggle(self) -> None:
        # From what the system asks for to dark, to light, and round again.
        self._dark.set_value({None: True, True: False, False: None}[self._dark.value])
