"""Every known effect, in one place."""

from designlab.simulation.effects.base import Effect
from designlab.simulation.effects.camera import (
    Banding,
    BlackLevel,
    ColourMixing,
    ExposureDrift,
    FixedPattern,
    ResponseCurve,
)
from designlab.simulation.effects.contact import (
    ContactKernel,
    ContactLayer,
    ContactProfile,
    DepthOffset,
    Friction,
    ProbeEdge,
    ProbeSize,
    SkinLength,
)
from designlab.simulation.effects.emission import LedPosition, LedProfile, LedSpread, LedTilt
from designlab.simulation.effects.geometry import CameraPose, GelThickness
from designlab.simulation.effects.lens import LensDistortion, PointSpread, VeilingGlare, VignettingEffect
from designlab.simulation.effects.material import AlbedoField, SpecularCoat, Translucency, Wetting
from designlab.simulation.effects.transport import (
    Absorption,
    CoreScatter,
    Delamination,
    GelcoreIndex,
    Interreflection,
)

CATALOGUE: tuple[Effect, ...] = (
    CameraPose(),
    GelThickness(),
    LedSpread(),
    LedProfile(),
    LedTilt(),
    LedPosition(),
    Interreflection(),
    GelcoreIndex(),
    Delamination(),
    Absorption(),
    CoreScatter(),
    AlbedoField(),
    SpecularCoat(),
    Translucency(),
    Wetting(),
    ContactKernel(),
    ContactProfile(),
    ContactLayer(),
    Friction(),
    SkinLength(),
    ProbeEdge(),
    ProbeSize(),
    DepthOffset(),
    LensDistortion(),
    PointSpread(),
    VignettingEffect(),
    VeilingGlare(),
    Banding(),
    ExposureDrift(),
    FixedPattern(),
    ColourMixing(),
    BlackLevel(),
    ResponseCurve(),
)
"""Every known effect, in pipeline order: geometry, emission, transport, material, contact, camera."""

UNASKED: tuple[str, ...] = tuple(effect.name for effect in CATALOGUE if not effect.by_name)
"""Names of those that a diagnosis tries without being asked."""
