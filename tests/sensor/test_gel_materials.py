"""The table of gels: against the figures of its sources, and as the documentation lists it."""

import numpy as np
import pytest

from designlab.mechanics.contact import press
from designlab.mechanics.layer import ElasticLayer
from designlab.sensor.gel_materials import MATERIALS, GelMaterial, gel_material
from geometries.probes import profile_mm, sphere

MINI = {0.5: 1.6503, 1.0: 5.9641, 1.5: 13.5257, 2.0: 23.2532}
"""Depth (mm) and force (N) of a ball of 15 mm on a pad of 4 mm (feats-ai/feats)."""

DIGIT = {
    "solaris-slacker-1-1-1": [
        {0.4675: 0.5002, 0.5395: 0.6801, 0.7250: 1.1854, 0.8598: 1.8267, 1.0296: 2.6937},
        {0.5054: 0.7404, 0.7052: 1.6520, 0.8972: 2.6630, 1.0162: 3.6409},
    ],
    "solaris-slacker-1-1-2": [{0.5405: 0.9660, 0.7312: 1.8339, 0.8863: 2.6850}],
    "solaris-slacker-1-1-4": [
        {0.5228: 0.6539, 0.7207: 1.2908, 0.8785: 1.9848, 0.9570: 2.3747},
        {0.5323: 0.8269, 0.7208: 1.6475, 0.9098: 2.7396},
    ],
}
"""The same of a ball of 4 mm on gels of 2 mm, part of the steps measured on each (hqhan03/VBTS_test)."""

CURVES = {
    "dragon-skin-10": [(0.0446, 0.00199), (0.0908, 0.01013), (0.1591, 0.01761), (0.2500, 0.02643)],
    "dragon-skin-20": [(0.0446, 0.00934), (0.0908, 0.02606), (0.1591, 0.04643), (0.2500, 0.07215)],
    "ecoflex-00-30": [(0.0446, -0.00071), (0.0908, 0.00343), (0.1591, 0.00621), (0.2500, 0.00856)],
}
"""Engineering strain and stress (MPa) of some points of tensile curves (Soft Robotics Materials Database)."""


def forces_n(gel: GelMaterial, thickness_mm: float, diameter_mm: float, depths_mm: list[float]) -> np.ndarray:
    """Forces of a ball on a bonded layer of a gel, without friction."""
    layer = ElasticLayer(gel.modulus_mpa, gel.poisson, thickness_mm)
    ball = sphere(diameter_mm=diameter_mm)
    reach = min(1.2 * np.sqrt(diameter_mm / 2 * max(depths_mm)) + 0.5, diameter_mm / 2)
    pitch = thickness_mm / 40
    axis = np.arange(-np.ceil(reach / pitch), np.ceil(reach / pitch) + 1) * pitch
    gap = -profile_mm(ball, *np.meshgrid(axis, axis))
    return np.array([press(gap, layer, pitch_mm=pitch, depth_mm=depth).force_n for depth in depths_mm])


@pytest.mark.physics
def test_forces_of_a_mini_pad_are_those_measured() -> None:
    """Within 10 % up to half of the thickness; the linear layer is one modulus for all depths."""
    found = forces_n(gel_material("gelsight-mini"), 4.0, 15.0, list(MINI))
    np.testing.assert_allclose(found, list(MINI.values()), rtol=0.1)


@pytest.mark.physics
@pytest.mark.parametrize("name", DIGIT)
def test_moduli_of_slacker_mixes_are_those_of_their_gels(name: str) -> None:
    """One modulus by least squares for each gel; their mean is in the table, each of them in the range."""
    gel = gel_material(name)
    fitted = []
    for measured in DIGIT[name]:
        depth, force = list(measured), np.array(list(measured.values()))
        unit = forces_n(gel, 2.0, 4.0, depth) / gel.modulus_mpa
        fitted.append(float(unit @ force / (unit @ unit)))
    assert np.mean(fitted) == pytest.approx(gel.modulus_mpa, rel=0.03)
    assert gel.range_mpa is not None
    assert 0.97 * gel.range_mpa[0] < min(fitted) <= max(fitted) < gel.range_mpa[1]


@pytest.mark.physics
@pytest.mark.parametrize("name", CURVES)
def test_tensile_moduli_are_slopes_of_their_curves(name: str) -> None:
    """True stress over true strain, from where grips and slack have settled, at 4 %, to 25 % of strain."""
    strain, stress = np.array(CURVES[name]).T
    slope = np.polyfit(np.log1p(strain), stress * (1 + strain), 1)[0]
    assert gel_material(name).modulus_mpa == pytest.approx(slope, rel=0.3)


def test_modulus_of_sylgard_falls_with_its_ratio() -> None:
    """20 MPa over the ratio, as its source fits; the ends are the figures measured there."""
    for ratio in (5, 10, 20, 33):
        assert gel_material(f"sylgard-184-{ratio}-1").modulus_mpa == pytest.approx(20 / ratio, rel=0.08)


def test_hardness_tells_the_modulus_within_a_factor_of_2_6_only() -> None:
    """Gent's relation (1958) from Shore A, in MPa: why no conversion is offered."""
    ratio = {}
    for name, gel in MATERIALS.items():
        scale, _, hardness = gel.shore.partition(" ")
        if scale == "A":
            by_gent = 0.0981 * (56 + 7.66 * float(hardness)) / (0.137505 * (254 - 2.54 * float(hardness)))
            ratio[name] = by_gent / gel.modulus_mpa
    assert len(ratio) == 7
    assert 1.0 < min(ratio.values()) < 1.1
    assert 2.5 < max(ratio.values()) < 2.6


def test_every_gel_has_a_source_and_lies_in_its_range() -> None:
    for gel in MATERIALS.values():
        low, high = gel.range_mpa or (gel.modulus_mpa, gel.modulus_mpa)
        assert low <= gel.modulus_mpa <= high
        assert gel.source


def test_an_unknown_gel_is_refused_with_those_known() -> None:
    with pytest.raises(ValueError, match=r"gel: unknown 'jelly'; known are gelsight-mini, solaris, "):
        gel_material("jelly")
