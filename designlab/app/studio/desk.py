"""What the views of a tab may ask of it."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

from designlab.app.studio.messages import Reply
from designlab.app.studio.runs import Runs
from designlab.app.studio.session import Session
from designlab.app.studio.url_state import Address
from designlab.sensor.design import Design

Answer = Callable[[Reply], None]


class Desk(Protocol):
    """A tab: its state, its files, its way to the worker.

    Attributes
    ----------
    client : Any
        The browser's side of the tab.
    root : Path
        Folder that all files lie in.
    session : Session
        Design, press and undo.
    address : Address
        What the address of the tab states.
    runs : Runs
        Runs of studies, which all tabs share.
    """

    client: Any
    root: Path
    session: Session
    address: Address
    runs: Runs

    def ask(self, lane: str, job: Any, answer: Answer, *, priority: int = 0) -> int:
        """Ask the worker; `answer` gets each step. An older request of the lane gives way to it."""
        ...

    def forget(self, lane: str) -> None:
        """Forget what was asked for in a lane."""
        ...

    def open(self, source: str) -> None:
        """Begin with another design: a preset, or a file under the folder."""
        ...

    def begin(self, source: str, base: Design, edits: Mapping[str, Any] | None = None) -> None:
        """Put a design on the bench, with changes."""
        ...

    def show(self, name: str) -> None:
        """Show a view."""
        ...

    def look_at(self, folder: str) -> None:
        """Note which study or diagnosis is looked at."""
        ...

    def changed(self) -> None:
        """Show the state of the session above all views."""
        ...

    def saved(self, source: str) -> None:
        """Go on with the file that the design was saved as."""
        ...

    def remember(self) -> None:
        """Write the state into the address."""
        ...

    def warn(self, text: str) -> None:
        """Say that something cannot be done."""
        ...

    def tell(self, text: str) -> None:
        """Say that something was done."""
        ...
