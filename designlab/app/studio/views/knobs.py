"""The left column: a knob for each field, by part, with what is wrong beside the field that is."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Literal

from nicegui import ui

from designlab.app.studio.controls import OPEN, Control, Part, numbers_text, read_numbers, slider_range
from designlab.app.studio.rule_fields import RULE_FIELDS
from designlab.app.studio.session import Session
from designlab.app.studio.structure import MIRROR
from designlab.sensor.feasibility import RULES

OFF = "off"
GROUP = "leds.groups."
FIRST_OPEN = "leds"
Turned = Callable[[str, Any, bool], str]
"""Called with path, value and whether the knob is still turned; returns what is wrong, or nothing."""
Change = Literal["add group", "remove group", "mirror"]
Changed = Callable[[Change, int], None]
"""Called when a part shall be added or taken away; of LED groups with their number."""


class Knobs:
    """Knobs of a design.

    Parameters
    ----------
    session : Session
        The design with its controls.
    turned : callable
        Told of every turn.
    changed : callable
        Told what shall be added or taken away.
    """

    def __init__(self, session: Session, turned: Turned, changed: Changed) -> None:
        self._turned, self._changed = turned, changed
        self._start = {path: control.value for path, control in session.controls().items()}
        self._rows: dict[str, Row] = {}
        self._boxes: dict[str, ui.expansion] = {}
        self._open = {FIRST_OPEN}
        self._column = ui.column().classes("knobs")
        self._shape: list[tuple[str, tuple[str, ...]]] = []
        self.update(session)

    def update(self, session: Session) -> None:
        """Show a design: values, and the rules that it breaks."""
        found = session.parts
        shape = [(part.title, tuple(c.path for c in part.controls)) for part in found]
        if shape != self._shape:
            self._shape = shape
            self._build(found)
        for part in found:
            for control in part.controls:
                if (row := self._rows.get(control.path)) is not None:
                    row.update(control)
        self._tell(session.broken, found)

    def follow(self) -> None:
        """Show the numbers that sliders are turned to."""
        for row in self._rows.values():
            row.follow()

    def _build(self, found: tuple[Part, ...]) -> None:
        self._rows.clear()
        self._boxes.clear()
        self._column.clear()
        with self._column:
            for part in found:
                self._part(part)

    def _part(self, part: Part) -> None:
        box = ui.expansion(part.title, value=part.key in self._open).classes("part").props("dense")
        self._boxes[part.key] = box
        with box:
            inside = ui.column().classes("rows")
        filled = False

        def fill(part: Part) -> None:
            nonlocal filled
            if filled:
                return
            filled = True
            with inside:
                for control in part.controls:
                    start = self._start.get(control.path, control.value)
                    self._rows[control.path] = Row(control, start, self._turned)
                self._buttons(part)

        def opened(event: Any) -> None:
            (self._open.add if event.value else self._open.discard)(part.key)
            if event.value:
                fill(part)

        box.on_value_change(opened)
        if part.key in self._open:
            fill(part)

    def _buttons(self, part: Part) -> None:
        """Buttons that add a part or take one away."""
        made: list[tuple[str, Change, int]] = []
        if part.key == "leds":
            made = [("add an LED group", "add group", -1)]
        elif part.key.startswith(GROUP):
            number = int(part.key.removeprefix(GROUP))
            made = [("add one like it", "add group", number), ("remove this group", "remove group", number)]
        elif part.key == "camera":
            there = any(control.path.startswith(f"{MIRROR}.") for control in part.controls)
            made = [("take the mirror away" if there else "add a mirror", "mirror", 0)]
        if made:
            with ui.element("div").classes("knob-buttons"):
                for text, what, number in made:
                    button = ui.button(text, on_click=partial(self._changed, what, number))
                    button.props(f'outline dense no-caps size=sm data-change="{what} {number}"')

    def open(self, key: str) -> None:
        """Open a part, also one that is there only after the next update."""
        self._open.add(key)

    def _tell(self, broken: Mapping[str, float], found: tuple[Part, ...]) -> None:
        """Write the margin of each broken rule beside the first of its fields, and mark its part."""
        there = {control.path for part in found for control in part.controls}
        told: dict[str, list[str]] = {}
        for rule, margin in broken.items():
            path = next((p for p in RULE_FIELDS[rule] if p in there), None)
            if path is not None:
                told.setdefault(path, []).append(f"{RULES[rule]}; violated by {margin:.2g} mm")
        for path, row in self._rows.items():
            row.violated("; ".join(told.get(path, ())))
        for key, box in self._boxes.items():
            marked = any(path == key or path.rpartition(".")[0] == key for path in told)
            box.classes(add="broken" if marked else "", remove="" if marked else "broken")


class Row:
    """One field: label, slider where one makes sense, value, and a line for what is wrong."""

    def __init__(self, control: Control, start: Any, turned: Turned) -> None:
        self.control, self._turned = control, turned
        self._own = control.value  # as turned to here, whatever of the design is shown yet
        self._quiet = True
        self._behind: Any = None  # slider or entry that has yet to show what the other was set to
        self._slider: Any = None
        with ui.element("div").classes("knob") as self.box:
            self.box.props(f'data-path="{control.path}"')
            with ui.element("label").classes("name"):
                ui.label(control.label).classes("word")
                if control.unit:
                    ui.label(control.unit).classes("unit")
                if control.meaning:
                    ui.tooltip(control.meaning).props("max-width=20rem delay=400")
            self._field = self._entry(control, start)
            self._wrong = ui.label("").classes("wrong").props('role="alert"')
        self._said, self._broken = "", ""
        self._quiet = False

    def update(self, control: Control) -> None:
        """Show the value where it was changed elsewhere; what is written here stays, refused or not."""
        elsewhere = control.value != self._own
        self.control, self._own = control, control.value
        if elsewhere:
            self._said, self._behind = "", None
            self._show(self._field, self._shown(control.value))
            self._slide_to(control.value)
            self._say()
        elif self._behind is not None and self._behind is self._slider:
            self._behind = None
            self._slide_to(self._own)

    def follow(self) -> None:
        """Show the number that the slider is turned to."""
        if self._behind is self._field:
            self._behind = None
            self._show(self._field, self._shown(self._own))

    def violated(self, text: str) -> None:
        """Say which rule the field breaks; nothing where it breaks none."""
        self._broken = text
        self._say()

    def _say(self) -> None:
        text = self._said or self._broken
        self._wrong.set_text(text)
        self.box.classes(add="bad" if text else "", remove="" if text else "bad")

    def _entry(self, control: Control, start: Any) -> Any:
        spoken = f'aria-label="{control.label} {control.unit}"'
        if control.kind == "switch":
            return ui.switch(value=control.value, on_change=self._set).props(f"dense {spoken}")
        if control.kind == "choice":
            choices = list(control.choices)
            choices += [OPEN] if control.value == OPEN else []
            options = ([OFF] if control.optional else []) + choices
            picked = ui.select(options, value=self._shown(control.value), on_change=self._set)
            return picked.props(f"dense outlined options-dense {spoken}").classes("entry wide")
        if control.kind == "number":
            return self._number(control, start, spoken)
        entry = (
            ui.input(value=self._shown(control.value)).props(f"dense outlined {spoken}").classes("entry wide")
        )
        entry.on("change", self._written)
        return entry

    def _number(self, control: Control, start: Any, spoken: str) -> Any:
        ends = slider_range(control, start if isinstance(start, int | float) else None)
        if ends is not None and control.value is not None:
            low, high, step = ends
            self._slider = ui.slider(min=low, max=high, step=step, value=control.value)
            # The entry beside it does the same from the keyboard.
            self._slider.props(f"dense tabindex=-1 {spoken}").classes("slider")
            self._slider.on_value_change(lambda event: self._slid(event.value, True))
            self._slider.on("change", lambda: self._slid(self._slider.value, False))
        entry = ui.input(value=self._shown(control.value), placeholder=OFF if control.optional else "")
        entry.props(f'dense outlined inputmode="decimal" {spoken}')
        entry.classes("entry" if self._slider is not None else "entry wide")
        entry.on("change", self._written)
        return entry

    def _shown(self, value: Any) -> Any:
        """What an entry shows of a value."""
        control = self.control
        if control.kind == "choice":
            return OFF if value is None else value
        if control.kind == "number":
            return "" if value is None else f"{value:.6g}"
        if control.kind == "numbers":
            return numbers_text(value)
        return value if value is not None else ("" if control.kind == "text" else value)

    def _show(self, element: Any, value: Any) -> None:
        """Set what an element shows; that is no turn of the knob."""
        self._quiet = True
        try:
            element.set_value(value)
        finally:
            self._quiet = False

    def _slide_to(self, value: Any) -> None:
        if self._slider is not None and value is not None:
            self._show(self._slider, value)

    def _slid(self, value: Any, going_on: bool) -> None:
        if not self._quiet:
            self._turn(value, going_on)
            if not self._said:
                self._behind = self._field

    def _set(self, event: Any) -> None:
        """Take what was picked."""
        if not self._quiet:
            self._take(event.value)

    def _written(self, event: Any) -> None:
        """Take what was written: the event tells it, the entry itself may lag behind."""
        self._take(event.args if isinstance(event.args, str) else self._field.value)

    def _take(self, given: Any) -> None:
        control, self._behind = self.control, None
        try:
            value = self._read(given, control)
        except ValueError as error:
            self._said = str(error)
            self._say()
            return
        if value == self._own:
            self._said = ""
            self._say()
            return
        self._turn(value, False)
        if not self._said:
            self._behind = self._slider

    def _read(self, given: Any, control: Control) -> Any:
        if control.kind == "number":
            text = str(given).strip().replace(",", ".")
            if not text or text == OFF:
                if not control.optional:
                    raise ValueError("must be a number, got nothing")
                return None
            try:
                return int(text) if control.whole else float(text)
            except ValueError:
                word = "a whole number" if control.whole else "a number"
                raise ValueError(f"must be {word}, got {text[:20]!r}") from None
        if control.kind == "choice":
            return None if given == OFF else given
        if control.kind == "numbers":
            return read_numbers(str(given))
        return given if given or not control.optional else None

    def _turn(self, value: Any, going_on: bool) -> None:
        value = int(value) if self.control.whole and value is not None else value
        self._said = self._turned(self.control.path, value, going_on)
        if not self._said:
            self._own = value
        self._say()


def fields_wrong(broken: Mapping[str, float]) -> str:
    """A line about the rules that a design breaks; empty where it breaks none."""
    if not broken:
        return ""
    rules = "1 rule is" if len(broken) == 1 else f"{len(broken)} rules are"
    return f"{rules} broken: " + "; ".join(
        f"{RULES[rule]} (violated by {margin:.2g} mm)" for rule, margin in broken.items()
    )
