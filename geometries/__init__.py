"""Parametric CAD models of the parts of a camera-based tactile sensor.

One part per module: a frozen, validated specification (`Gelcore`, `Elastomer`, `LedArray`, `Housing`,
`Probe`) and `solid(spec)`, which builds it with CadQuery. `mesh` is the only way from a solid to arrays.
Nothing here knows of light, cameras or scores.
"""

from geometries.elastomer import Elastomer
from geometries.gelcore import Gelcore
from geometries.housing import Housing
from geometries.leds import Body, Emitter, LedArray, LedGroup
from geometries.probes import Probe
from geometries.spec import Spec

__all__ = ["Body", "Elastomer", "Emitter", "Gelcore", "Housing", "LedArray", "LedGroup", "Probe", "Spec"]
