"""Design, simulate, score and diagnose camera-based tactile sensors.

The names below are the public interface. Each is loaded on first use, so that importing the package costs
nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from designlab.evaluation.evaluate import Score
    from designlab.measurement.light_probe.ball import LightProbe
    from designlab.measurement.light_probe.picture import light_probe
    from designlab.optimization.study.sweep import optimise, sweep
    from designlab.optimization.tolerance import tolerance
    from designlab.report.evaluation_folder import evaluate
    from designlab.sensor.design import Design, load, preset
    from designlab.simulation.contact.press import Press
    from designlab.simulation.contact.surface import Surface
    from designlab.simulation.simulator import render
    from geometries.probes import Probe, sphere, star, triangle

__version__ = "0.1.0"

_HOMES = {
    "Design": "designlab.sensor.design",
    "load": "designlab.sensor.design",
    "preset": "designlab.sensor.design",
    "LightProbe": "designlab.measurement.light_probe.ball",
    "light_probe": "designlab.measurement.light_probe.picture",
    "Press": "designlab.simulation.contact.press",
    "Surface": "designlab.simulation.contact.surface",
    "render": "designlab.simulation.simulator",
    "Score": "designlab.evaluation.evaluate",
    "evaluate": "designlab.report.evaluation_folder",
    "sweep": "designlab.optimization.study",
    "optimise": "designlab.optimization.study",
    "tolerance": "designlab.optimization.tolerance",
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


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'designlab' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__
