"""Design, simulate, score and diagnose camera-based tactile sensors.

Names are loaded on first use, so that importing the package costs nothing.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from designlab.design import Design, load, preset
    from designlab.evaluate import Score, evaluate
    from designlab.light_probe import LightProbe, light_probe
    from designlab.press import Press, Surface
    from designlab.simulate import render
    from designlab.study.sweep import optimise, sweep
    from designlab.tolerance import tolerance
    from geometries.probes import Probe, sphere, star, triangle

__version__ = "0.1.0"

_HOMES = {
    "Design": "designlab.design",
    "load": "designlab.design",
    "preset": "designlab.design",
    "LightProbe": "designlab.light_probe",
    "light_probe": "designlab.light_probe",
    "Press": "designlab.press",
    "Surface": "designlab.press",
    "render": "designlab.simulate",
    "Score": "designlab.evaluate",
    "evaluate": "designlab.evaluate",
    "sweep": "designlab.study",
    "optimise": "designlab.study",
    "tolerance": "designlab.tolerance",
    "Probe": "geometries.probes",
    "sphere": "geometries.probes",
    "star": "geometries.probes",
    "triangle": "geometries.probes",
}

__all__ = [
    "Design",
    "LightProbe",
    "Press",
    "Probe",
    "Score",
    "Surface",
    "evaluate",
    "light_probe",
    "load",
    "optimise",
    "preset",
    "render",
    "sphere",
    "star",
    "sweep",
    "tolerance",
    "triangle",
]


class _Package(ModuleType):
    """Keeps functions such as `render`: importing the modules of these names would hide them."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in _HOMES or not isinstance(value, ModuleType):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'designlab' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
