"""What one tab of the studio has on its bench: a design with its changes, a press, what was before, a pin."""

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from pydantic import ValidationError

from designlab.app.studio.controls import Control, Part, control_at, parts
from designlab.app.studio.structure import (
    BESIDE,
    replacements,
    with_group,
    with_mirror,
    without_group,
    without_mirror,
)
from designlab.sensor.contact import LayerContact
from designlab.sensor.design import Design, DesignError
from designlab.sensor.field_errors import explain
from designlab.simulation.contact.press import Press
from geometries.probes import is_mesh, parse

MOST_KEPT = 200  # states that undo reaches back
DEPTHS_MM = (0.02, 5.0)  # ends that the wheel stays within
FORCES_N = (0.01, 100.0)
CHANGES_MOST = 400  # fields that an address may change
PRESS = "press"

Told = TypeVar("Told")


class NotAllowed(ValueError):
    """A change that the studio does not make; the text says which and why."""


def usual_press(design: Design) -> Press:
    """The press that a page begins with: a ball in the middle, a quarter of the gel deep, at most 0.5 mm."""
    depth_mm = min(0.5, round(design.elastomer.thickness_mm / 4, 2))
    return Press(probe=parse("sphere:4"), depth_mm=max(depth_mm, 0.05))


def read_press(text: Mapping[str, str], usual: Press) -> Press:
    """Press of texts by field: probe, depth_mm or force_n, at, yaw_deg; what is absent is usual.

    Raises
    ------
    NotAllowed
        If a text cannot be used.
    """
    content: dict[str, Any] = usual.model_dump()
    try:
        if "probe" in text:
            if is_mesh(text["probe"]):
                raise NotAllowed("probe: the studio presses with probes of the library alone")
            content["probe"] = parse(text["probe"])
        for name, other in (("depth_mm", "force_n"), ("force_n", "depth_mm")):
            if name in text:
                content |= {name: float(text[name]), other: None}
        if "at" in text:
            x, y = (float(part) for part in text["at"].split(","))
            content["centre_mm"] = (x, y)
        if "yaw_deg" in text:
            content["yaw_deg"] = float(text["yaw_deg"])
        return Press(**content)
    except ValidationError as error:
        raise NotAllowed(f"press: {explain(error)}") from None
    except ValueError as error:
        raise NotAllowed(f"press: {error}") from None


@dataclass(frozen=True)
class State:
    """What undo goes back to.

    Attributes
    ----------
    edits : mapping of str to Any
        Changed fields, as `Design.replace` takes them, in the order in which they were made.
    press : Press
        The press.
    """

    edits: Mapping[str, Any]
    press: Press


@dataclass(frozen=True)
class Pin:
    """A design put aside to be compared with."""

    design: Design
    edits: Mapping[str, Any]


@dataclass
class Session:
    """The state of one tab, with undo; designs are checked before they become the state.

    Attributes
    ----------
    source : str
        Preset name, or file of the design that it began with, relative to the folder of the studio.
    base : Design
        That design.
    """

    source: str
    base: Design
    press: Press = field(init=False)
    design: Design = field(init=False)
    pin: Pin | None = None
    edits: Mapping[str, Any] = field(default_factory=dict)
    _past: list[State] = field(default_factory=list)
    _future: list[State] = field(default_factory=list)
    _last: str = ""
    _told: tuple[Design | None, dict[str, Any]] = field(default=(None, {}), init=False, repr=False)

    def __post_init__(self) -> None:
        self.design = self._made(self.edits)
        self.press = usual_press(self.design)

    @property
    def parts(self) -> tuple[Part, ...]:
        """Every control of the design by part."""
        return self._once("parts", parts)

    @property
    def broken(self) -> dict[str, float]:
        """Rules that the design breaks, with their margins (mm)."""
        return self._once("broken", Design.broken)

    @property
    def digest(self) -> str:
        """Digest of the design."""
        return self._once("digest", lambda design: design.digest)

    def controls(self) -> dict[str, Control]:
        """Every control by path."""
        return {control.path: control for part in self.parts for control in part.controls}

    def change(self, path: str, value: Any, *, going_on: bool = False) -> None:
        """Set a field of the design.

        Parameters
        ----------
        path : str
            Of a control.
        value : Any
            What shall stand there; None switches an optional field off.
        going_on : bool
            Whether the knob is still turned: changes of one field are one step of undo then.

        Raises
        ------
        NotAllowed
            If there is no such control.
        DesignError
            If the value breaks a rule of the field; the design stays as it was.
        """
        control = control_at(self.design, path)
        if control is None:
            raise NotAllowed(f"{path[:80]}: is no field that can be changed here")
        if control.choices and value is not None and value not in control.choices:
            raise NotAllowed(f"{path}: must be one of {', '.join(control.choices)}, got {str(value)[:40]!r}")
        where, what = control.edit(value)
        edits = {name: old for name, old in self.edits.items() if name != where}
        # Fields of another model of contact go with it.
        if where == "contact":
            edits = {name: old for name, old in edits.items() if not name.startswith("contact.")}
        edits[where] = what
        self._set(edits, path, going_on)

    def add_group(self, like: int) -> None:
        """Add an LED group like another, where most room is between the rows.

        Raises
        ------
        DesignError
            If there are too many.
        """
        self._set(with_group(self.base, self.design, self.edits, like), f"group like {like}")

    def remove_group(self, index: int) -> None:
        """Take an LED group away.

        Raises
        ------
        DesignError
            If it is the only one.
        """
        self._set(without_group(self.base, self.design, self.edits, index), f"without group {index}")

    def fold(self) -> None:
        """Put a mirror before the camera, or take the one that is there away; the picture stays.

        Raises
        ------
        DesignError
            If the housing or the camera's direction leaves no room for one.
        """
        folded = self.design.camera.mirror is not None
        change = without_mirror if folded else with_mirror
        self._set(change(self.design, self.edits), "mirror")

    @property
    def changes(self) -> dict[str, Any]:
        """Changes as `Design.replace` takes them."""
        return replacements(self.base, self.edits)

    def move_press(self, *, going_on: bool = False, **changes: Any) -> None:
        """Change the press: probe, depth_mm, force_n, centre_mm, yaw_deg.

        Raises
        ------
        NotAllowed
            If a value is out of its bounds, or a force is stated of a gel that knows none.
        """
        if changes.get("force_n") is not None and not isinstance(self.design.contact, LayerContact):
            raise NotAllowed("press: a force needs contact.model = 'layer'; state a depth")
        try:
            press = Press(**{**self.press.model_dump(), **changes})
        except ValidationError as error:
            raise NotAllowed(f"press: {explain(error)}") from None
        self._remember(PRESS, going_on)
        self.press = press

    def push(self, factor: float) -> None:
        """Press deeper, or harder, by a factor."""
        if self.press.depth_mm is not None:
            low, high = DEPTHS_MM
            self.move_press(going_on=True, depth_mm=min(max(self.press.depth_mm * factor, low), high))
        elif self.press.force_n is not None:
            low, high = FORCES_N
            self.move_press(going_on=True, force_n=min(max(self.press.force_n * factor, low), high))

    def rest(self) -> None:
        """The knob is at rest: the next change is a step of undo of its own."""
        self._last = ""

    @property
    def can_undo(self) -> bool:
        """Whether there is something to undo."""
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        """Whether something was undone."""
        return bool(self._future)

    def undo(self) -> None:
        """Go one step back."""
        self._go(self._past, self._future)

    def redo(self) -> None:
        """Go one step forth again."""
        self._go(self._future, self._past)

    def put_pin(self) -> Pin:
        """Put the design aside to be compared with."""
        self.pin = Pin(self.design, dict(self.edits))
        return self.pin

    def restore(self, edits: Mapping[str, Any], press: Press | None = None) -> None:
        """Make changes that an address states, each as `change` does.

        Raises
        ------
        NotAllowed, DesignError
            If one cannot be made; the state stays as it was.
        """
        before = replace_state(self)
        told = dict(list(edits.items())[:CHANGES_MOST])
        # Parts that are there or not come first, with what has to change at once with them.
        first = {path: told.pop(path) for path in BESIDE if path in told}
        first |= {path: told[path] for part in first for path in BESIDE[part] if path in told}
        try:
            if first:
                self._set(first, "parts")
            for path, value in told.items():
                if path == "contact":
                    path, value = "contact.model", value.get("model") if isinstance(value, dict) else value
                self.change(path, value)
        except (NotAllowed, DesignError):
            self.edits, self.press = before.edits, before.press
            self.design = self._made(self.edits)
            raise
        finally:
            self._past.clear()
        if press is not None:
            self.press = press

    def _set(self, edits: Mapping[str, Any], what: str, going_on: bool = False) -> None:
        design = self._made(edits)
        self._remember(what, going_on)
        self.edits, self.design = edits, design
        if self.press.force_n is not None and not isinstance(design.contact, LayerContact):
            self.press = usual_press(design)

    def _once(self, what: str, make: Callable[[Design], Told]) -> Told:
        """What is made of the design, found once and kept until another design is shown."""
        if self._told[0] is not self.design:
            self._told = self.design, {}
        told = self._told[1]
        if what not in told:
            told[what] = make(self.design)
        found: Told = told[what]
        return found

    def _made(self, edits: Mapping[str, Any]) -> Design:
        # A copy: values within values are set in place.
        return self.base.replace(copy.deepcopy(replacements(self.base, edits))) if edits else self.base

    def _remember(self, what: str, going_on: bool) -> None:
        if not (going_on and self._last == what):
            self._past.append(replace_state(self))
            del self._past[:-MOST_KEPT]
        self._last = what if going_on else ""
        self._future.clear()

    def _go(self, from_: list[State], to: list[State]) -> None:
        if not from_:
            return
        to.append(replace_state(self))
        state = from_.pop()
        self.edits, self.press = state.edits, state.press
        self.design = self._made(self.edits)
        self._last = ""


def replace_state(session: Session) -> State:
    """The state of a session, which later changes do not touch."""
    return State(dict(session.edits), session.press)


def pinned(session: Session, edits: Mapping[str, Any]) -> Session:
    """A session with the same source whose design has other changes, to pin what an address states."""
    found = replace(session, pin=None, edits={})
    found.restore(edits)
    return found
