"""Design, simulate, score and diagnose camera-based tactile sensors.

The names below are the public interface. Each is loaded on first use, so that importing the package costs
nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from designlab.core import __version__ as __version__

if TYPE_CHECKING:
    from designlab.app.python import compare as compare
    from designlab.app.python import diagnose as diagnose
    from designlab.app.python import draw as draw
    from designlab.app.python import export as export
    from designlab.evaluation.score import Score as Score
    from designlab.measurement.light_probe.ball import LightProbe as LightProbe
    from designlab.measurement.light_probe.picture import light_probe as light_probe
    from designlab.optimization.study.sweep import optimise as optimise
    from designlab.optimization.study.sweep import sweep as sweep
    from designlab.optimization.tolerance import tolerance as tolerance
    from designlab.reconstruction.reconstructor import Reconstructor as Reconstructor
    from designlab.report.evaluation_folder import evaluate as evaluate
    from designlab.sensor.design import Design as Design
    from designlab.sensor.design import load as load
    from designlab.sensor.design import preset as preset
    from designlab.simulation.contact.press import Press as Press
    from designlab.simulation.contact.surface import Surface as Surface
    from designlab.simulation.simulator import render as render
    from geometries.probes import Probe as Probe
    from geometries.probes import bars as bars
    from geometries.probes import cone as cone
    from geometries.probes import cylinder as cylinder
    from geometries.probes import dots as dots
    from geometries.probes import from_file as from_file
    from geometries.probes import prism as prism
    from geometries.probes import sphere as sphere
    from geometries.probes import star as star
    from geometries.probes import triangle as triangle
    from geometries.probes import wave as wave

_HOMES = {
    "compare": "designlab.app.python",
    "diagnose": "designlab.app.python",
    "draw": "designlab.app.python",
    "export": "designlab.app.python",
    "Design": "designlab.sensor.design",
    "load": "designlab.sensor.design",
    "preset": "designlab.sensor.design",
    "LightProbe": "designlab.measurement.light_probe.ball",
    "light_probe": "designlab.measurement.light_probe.picture",
    "Press": "designlab.simulation.contact.press",
    "Surface": "designlab.simulation.contact.surface",
    "render": "designlab.simulation.simulator",
    "Score": "designlab.evaluation.score",
    "Reconstructor": "designlab.reconstruction.reconstructor",
    "evaluate": "designlab.report.evaluation_folder",
    "sweep": "designlab.optimization.study",
    "optimise": "designlab.optimization.study",
    "tolerance": "designlab.optimization.tolerance",
    "Probe": "geometries.probes",
    "bars": "geometries.probes",
    "cone": "geometries.probes",
    "cylinder": "geometries.probes",
    "dots": "geometries.probes",
    "from_file": "geometries.probes",
    "prism": "geometries.probes",
    "sphere": "geometries.probes",
    "star": "geometries.probes",
    "triangle": "geometries.probes",
    "wave": "geometries.probes",
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'designlab' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__
