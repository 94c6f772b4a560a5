"""Every known effect, in one place."""

from designlab.effects.base import Effect
from designlab.effects.camera import (
    Banding,
    BlackLevel,
    ColourMixing,
    ExposureDrift,
    FixedPattern,
    ResponseCurve,
)
from designlab.effects.contact import ContactKernel, ContactProfile, DepthOffset
from designlab.effects.emission import LedPosition, LedProfile, LedSpread, LedTilt
from designlab.effects.geometry import CameraPose
from designlab.effects.lens import LensDistortion, PointSpread, VeilingGlare, Vignetting
from designlab.effects.material import AlbedoField, SpecularCoat, Translucency
from designlab.effects.transport import (
    Absorption,
    CoreScatter,
    Delamination,
    GelcoreIndex,
    Interreflection,
)

CATALOGUE: tuple[Effect, ...] = (
    CameraPose(),
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
    ContactKernel(),
    ContactProfile(),
    DepthOffset(),
    LensDistortion(),
    PointSpread(),
    Vignetting(),
    VeilingGlare(),
    Banding(),
    ExposureDrift(),
    FixedPattern(),
    ColourMixing(),
    BlackLevel(),
    ResponseCurve(),
)
"""Every known effect, in pipeline order: geometry, emission, transport, material, contact, camera."""
