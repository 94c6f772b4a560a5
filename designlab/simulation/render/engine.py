"""Dr.Jit and Mitsuba, loaded when something of them is first used: `backend.activate` comes before that."""

from importlib import import_module
from typing import Any


class _Late:
    """A module that is imported when something of it is first asked for."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        return getattr(import_module(self._name), attribute)


dr: Any = _Late("drjit")
mi: Any = _Late("mitsuba")
