"""The light probe: a chrome ball in a sensor without its gel shows from where light arrives.

P. Debevec, SIGGRAPH 1998; for tactile sensors A. Agarwal, T. Man and W. Yuan, arXiv 2012.13184.
"""

from designlab.measurement.light_probe.ball import LightProbe
from designlab.measurement.light_probe.comparison import LightDifference, LobeDifference, compare_light
from designlab.measurement.light_probe.lobes import Lobe, Lobes, lobes
from designlab.measurement.light_probe.outline import Outline, find_outline, locate
from designlab.measurement.light_probe.panels import Panel, Panels, panels
from designlab.measurement.light_probe.picture import ProbePicture, light_probe
from designlab.measurement.light_probe.polar import PolarMap, polar_map
from designlab.measurement.light_probe.sight import probe_view
from designlab.measurement.light_probe.unwrap import Unwrapped, unwrap

__all__ = [
    "LightDifference",
    "LightProbe",
    "Lobe",
    "LobeDifference",
    "Lobes",
    "Outline",
    "Panel",
    "Panels",
    "PolarMap",
    "ProbePicture",
    "Unwrapped",
    "compare_light",
    "find_outline",
    "light_probe",
    "lobes",
    "locate",
    "panels",
    "polar_map",
    "probe_view",
    "unwrap",
]
