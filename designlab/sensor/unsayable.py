"""What real sensors have and no design can say, refused by the names that people give it."""

from collections.abc import Mapping
from typing import Any

TRANSLUCENT = ("elastomer_scattering_per_mm", "elastomer_anisotropy")
TRANSLUCENT_GEL = (
    "a translucent gel over a black skin, in which depth shows as darkness (DTact, 9DTact), is not "
    "simulated: gels are clear, and light comes back from their coating"
)
UNSAYABLE = {
    "9dtact": TRANSLUCENT_GEL,
    "dtact": TRANSLUCENT_GEL,
    "dtactive": TRANSLUCENT_GEL,
    "omnitact": "a design has one camera, OmniTact has five; write a design for each",
    "gelsight-svelte": "curved mirrors are not simulated, camera.mirror is flat",
}
"""Sensors that people ask for and no design can say, and why."""


def refuse_unsayable(content: Mapping[str, Any]) -> None:
    """Refuse what real sensors have and no design can say, by the names that people give it."""
    if isinstance(content.get("camera"), list | tuple) or "cameras" in content:
        field = "cameras" if "cameras" in content else "camera"
        raise ValueError(
            f"{field}: a design has one camera, several are not simulated; write a design for each, of the "
            "part of the gel that it sees"
        )
    optics = content.get("optics")
    if isinstance(optics, Mapping):
        for field in TRANSLUCENT:
            if field in optics:
                raise ValueError(f"optics.{field}: {TRANSLUCENT_GEL}")
