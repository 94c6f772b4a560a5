"""Figures that boards are drawn with: land patterns, resistors, holes, and what board makers keep."""

import tomllib
from importlib.resources import files
from typing import Any, NamedTuple


class LandPattern(NamedTuple):
    """Copper of one package: pads as name to (x, y, width, height) in mm about its middle, y up."""

    name: str
    source: str
    body_mm: tuple[float, float]
    pads: dict[str, tuple[float, float, float, float]]
    drill_mm: float = 0.0
    pitch_mm: float = 0.0

    def row(self, count: int) -> "LandPattern":
        """Pattern of `count` of its single pads in a row along x, numbered from 1."""
        _, _, width, height = self.pads["1"]
        first = -(count - 1) / 2 * self.pitch_mm
        pads = {str(k + 1): (first + k * self.pitch_mm, 0.0, width, height) for k in range(count)}
        body = (count * self.pitch_mm, self.body_mm[1])
        return self._replace(name=self.name.replace("_P", f"_1x{count:02d}_P", 1), body_mm=body, pads=pads)


def _read(name: str) -> dict[str, Any]:
    return tomllib.loads(files(__package__).joinpath(f"{name}.toml").read_text(encoding="utf-8"))


LAND_PATTERNS = {
    name: LandPattern(
        name,
        entry["source"],
        (entry["body_mm"][0], entry["body_mm"][1]),
        {pad: tuple(figures) for pad, figures in entry["pads"].items()},
        entry.get("drill_mm", 0.0),
        entry.get("pitch_mm", 0.0),
    )
    for name, entry in _read("land_patterns").items()
}
"""Land patterns by name, from `land_patterns.toml`."""
STOCK = _read("stock")
"""Resistors, holes and boards, from `stock.toml`."""
TRACK_MM: float = STOCK["board"]["track_mm"]
CLEARANCE_MM: float = STOCK["board"]["clearance_mm"]
EDGE_MM: float = STOCK["board"]["edge_mm"]
VIA_MM: float = STOCK["board"]["via_mm"]
VIA_DRILL_MM: float = STOCK["board"]["via_drill_mm"]
HOLE_MM: float = STOCK["hole"]["diameter_mm"]
HEADER, WIRE_PAD = (
    LAND_PATTERNS[name] for name in ("PinHeader_P1.27mm_Vertical", "SolderWirePad_1x01_SMD_1x2mm")
)
