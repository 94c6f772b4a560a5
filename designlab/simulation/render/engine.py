"""Dr.Jit and Mitsuba, loaded when something of them is first used: `backend.activate` comes before that."""

from functools import cached_property
from importlib import import_module
from types import ModuleType
from typing import Any


class _Late:
    """A module that is imported when something of it is first asked for."""

    def __init__(self, name: str) -> None:
        self._name = name

    @cached_property
    def _module(self) -> ModuleType:
        return import_module(self._name)

    def __getattr__(self, attribute: str) -> Any:
        return getattr(self._module, attribute)


dr: Any = _Late("drjit")
mi: Any = _Late("mitsuba")
