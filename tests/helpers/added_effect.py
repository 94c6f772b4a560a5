"""An effect that is in the catalogue for one test alone."""

import re
import sys

import pytest

from designlab.simulation.effects import CATALOGUE, Effect
from tests import ROOT

STAGES = ("geometry", "emission", "transport", "material", "contact", "camera")


def documented(page: str, name: str) -> Effect:
    """The effect of a class that a page of the docs shows."""
    text = (ROOT / page).read_text(encoding="utf-8")
    (code,) = (c for c in re.findall(r"^```python\n(.*?)^```", text, re.S | re.M) if f"class {name}(" in c)
    namespace: dict[str, object] = {}
    exec(code, namespace)
    made = namespace[name]
    assert isinstance(made, type)
    assert issubclass(made, Effect)
    return made()


def register(effect: Effect, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put an effect behind the others of its stage, wherever the catalogue has been imported."""
    known, stage = CATALOGUE, STAGES.index(effect.stage)
    behind = sum(STAGES.index(e.stage) <= stage for e in known)
    for module in [*sys.modules.values()]:
        if getattr(module, "CATALOGUE", None) is known:
            monkeypatch.setattr(module, "CATALOGUE", (*known[:behind], effect, *known[behind:]))
