"""Angular profiles: their normalisation, what they refuse, and IES files."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import dblquad

from designlab.sensor.design import DesignError, dumps, load, loads, preset
from geometries import ies
from geometries.emission import AngularProfile
from geometries.leds import LedArray

# A file in the published layout (LM-63-2002) with two planes of symmetry; numbers wrap across lines.
SAMPLE = """IESNA:LM-63-2002
[TEST] of the reader
[TESTLAB] none
[ISSUEDATE] 1-JAN-2026
[MANUFAC] none
[LUMINAIRE] small LED with an oval beam
TILT=NONE
1 -1 2.0 7 3 1 2 0.002 0.001 0
1.0 1.0 0.1
0 15 30 45
60 75 90
0, 45, 90
100 95 80 60 35 12 0
100 90 65 40
20 5 0
100 85 50 25 10 2 0
"""


def integral(profile):
    """Flux share by adaptive quadrature, in pieces between the nodes."""
    nodes = np.radians(profile.polar_deg)
    turns, _ = profile.planes

    def density(polar, turn):
        return float(profile.share_per_sr(np.degrees(polar), turn)) * np.sin(polar)

    return sum(
        dblquad(density, a, b, low, high)[0] * np.pi / 180
        for a, b in pairwise(turns)
        for low, high in pairwise(nodes)
    )


@pytest.mark.slow
@given(exponent=st.floats(0, 500))
def test_a_power_of_the_cosine_is_normalised(exponent):
    profile = AngularProfile(exponent=exponent)
    cosine = np.linspace(0, 1, 200_001)
    density = 2 * np.pi * profile.share_per_sr(np.degrees(np.arccos(cosine)))
    assert np.trapezoid(density, cosine) == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize("beam_deg", [1.0, 10.0, 60.0, 120.0, 150.0])
def test_half_the_axial_intensity_lies_at_half_the_beam(beam_deg):
    profile = AngularProfile(beam_deg=beam_deg)
    assert profile.share_per_sr(beam_deg / 2) == pytest.approx(profile.share_per_sr(0.0) / 2, rel=1e-9)
    assert profile.is_lambertian == (beam_deg == 120.0)


@pytest.mark.slow
def test_a_table_is_normalised_and_linear_between_its_angles():
    profile = AngularProfile(**ies.parse(SAMPLE, name="sample.ies")._asdict())
    assert integral(profile) == pytest.approx(1.0, rel=1e-9)
    # plane at 22.5 deg, halfway between polar 30 and 45: mean of 80, 60, 65 and 40
    expected = (80 + 60 + 65 + 40) / 4 / profile.flux
    for turn in (22.5, 157.5, 202.5, 337.5):  # its mirror images
        assert profile.share_per_sr(37.5, turn) == pytest.approx(expected, rel=1e-12)
    assert profile.share_per_sr(90.5, 10.0) == 0.0


def test_a_table_of_the_cosine_is_the_cosine():
    polar = tuple(np.linspace(0, 90, 181).tolist())
    profile = AngularProfile(polar_deg=polar, intensity=(tuple(np.cos(np.radians(polar)).tolist()),))
    assert profile.flux == pytest.approx(np.pi, rel=1e-4)
    np.testing.assert_allclose(
        profile.share_per_sr([0, 33.3, 71.7]), np.cos(np.radians([0, 33.3, 71.7])) / np.pi, rtol=2e-4
    )


@pytest.mark.parametrize(
    ("fields", "rule"),
    [
        ({"exponent": -1.0}, "greater than or equal to 0"),
        ({"exponent": 1.0, "beam_deg": 20.0}, "give one of"),
        ({"exponent": 1.0, "polar_deg": (0, 90), "intensity": (1, 1)}, "give one of"),
        ({"beam_deg": 180.0}, "less than 180"),
        ({"polar_deg": (0, 50, 40), "intensity": (1, 1, 1)}, "polar_deg: must rise, 40 deg follows 50"),
        ({"polar_deg": (0, 50, 91), "intensity": (1, 1, 1)}, "polar_deg: must run from 0 to at most 90"),
        ({"polar_deg": (5, 50), "intensity": (1, 1)}, "polar_deg: must run from 0"),
        ({"polar_deg": (0, 50), "intensity": (1, -1)}, "intensity: must not be negative, got -1"),
        ({"polar_deg": (0, 50), "intensity": (0, 0)}, "intensity: at least one"),
        ({"polar_deg": (0, 50), "intensity": (1, 1, 1)}, "intensity: needs 1 row"),
        ({"polar_deg": (0, 50)}, "intensity: needs 1 row"),
        ({"intensity": (1, 1)}, "polar_deg: needs at least two"),
        (
            {"polar_deg": (0, 50), "azimuth_deg": (0, 70), "intensity": ((1, 1), (1, 1))},
            "azimuth_deg: must end at 90, 180 or 360 deg, ends at 70",
        ),
    ],
)
def test_a_profile_that_is_refused_says_why(fields, rule):
    with pytest.raises(ValueError, match=rule):
        AngularProfile(**fields)


def test_a_spot_needs_a_narrow_beam():
    group = {"name": "red", "azimuth_deg": [90.0]}
    with pytest.raises(ValueError, match="package: a spot has a beam narrower than 120 deg"):
        LedArray.model_validate({"package": "spot", "groups": [group]})
    array = LedArray.model_validate({"package": "spot", "groups": [group], "profile": {"beam_deg": 15.0}})
    assert array.profile_of(0).power == pytest.approx(np.log(0.5) / np.log(np.cos(np.radians(7.5))))


def test_a_group_may_have_its_own_profile():
    groups = [{"name": n, "azimuth_deg": [90.0]} for n in ("red", "green")]
    groups[1]["profile"] = {"exponent": 3.0}
    array = LedArray.model_validate({"groups": groups})
    assert [array.profile_of(k).power for k in (0, 1)] == [1.0, 3.0]


DESIGN = """
mixing = [[1.0], [0.5], [0.2]]
[leds]
profile = { ies = "lamps/sample.ies" }
[[leds.groups]]
name = "white"
azimuth_deg = [90.0]
"""


def test_a_design_keeps_the_table_of_its_ies_file(tmp_path):
    (tmp_path / "lamps").mkdir()
    (tmp_path / "lamps" / "sample.ies").write_text(SAMPLE)
    (tmp_path / "mine.toml").write_text(DESIGN)
    design = load(tmp_path / "mine.toml")
    assert design.leds.profile.ies == "lamps/sample.ies"
    assert design.leds.profile.intensity[1] == (100, 90, 65, 40, 20, 5, 0)
    (tmp_path / "lamps" / "sample.ies").unlink()
    again = loads(dumps(design))
    assert again == design
    assert again.digest == design.digest
    assert again.replace({"leds.tilt_deg": 5.0}).leds.profile == design.leds.profile


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("TILT=NONE", "TILT=INCLUDE", ["line 7", "TILT must be NONE", "INCLUDE"]),
        ("TILT=NONE", "TILT=lamp.tlt", ["line 7", "lamp.tlt"]),
        ("TILT=NONE\n", "", ["no TILT= line"]),
        ("IESNA:LM-63-2002", "IESNA:LM-99", ["line 1", "no known edition"]),
        ("7 3 1 2", "7 3 2 2", ["line 8", "type C", "type B"]),
        ("7 3 1 2", "7.5 3 1 2", ["line 8", "number of vertical angles", "7.5"]),
        ("2.0 7 3", "0 7 3", ["line 8", "multiplier must be positive"]),
        ("15 30 45", "15 30 30", ["line 10", "vertical angles must rise, 30 deg follows 30"]),
        ("0, 45, 90", "0, 45, 80", ["horizontal angles must end at 0, 90, 180 or 360", "80"]),
        ("20 5 0", "20 five 0", ["line 15", "candela value", "'five'"]),
        ("20 5 0", "20 -5 0", ["must not be negative", "-5"]),
        ("20 5 0", "20 inf 0", ["line 15", "finite"]),
        ("25 10 2 0\n", "25 10\n", ["line 16", "ends where a number is due"]),
        ("25 10 2 0\n", "25 10 2 0 9\n", ["line 16", "table is complete", "'9'"]),
        ("0 15 30 45\n60 75 90", "0 30 60 90\n120 150 180", ["beyond 90 deg"]),
    ],
)
def test_a_broken_ies_file_is_named_with_line_and_rule(tmp_path, old, new, words):
    assert old in SAMPLE
    (tmp_path / "lamps").mkdir()
    (tmp_path / "lamps" / "sample.ies").write_text(SAMPLE.replace(old, new, 1))
    (tmp_path / "mine.toml").write_text(DESIGN)
    with pytest.raises(DesignError) as caught:
        load(tmp_path / "mine.toml")
    for word in ("mine.toml", "leds.profile", "lamps/sample.ies", *words):
        assert word in str(caught.value)


def test_a_missing_ies_file_is_named(tmp_path):
    (tmp_path / "mine.toml").write_text(DESIGN)
    with pytest.raises(
        DesignError, match=r"mine\.toml: field leds\.profile: lamps/sample\.ies: cannot be read"
    ):
        load(tmp_path / "mine.toml")


def test_files_of_every_edition_and_symmetry_are_read():
    plain = "my lamp, 1986\nTILT=NONE\n1 1000 1 5 1 1 1 0 0 0 1 1 50 0 60 89 91 180 0 9 3 0.02 0 0"
    profile = AngularProfile(**ies.parse(plain, name="old")._asdict())
    assert profile.azimuth_deg == ()
    assert profile.polar_deg == (0.0, 60.0, 89.0, 90.0)
    assert profile.intensity == ((9.0, 3.0, 0.02, 0.01),)  # cut at 90 deg, between 89 and 91
    turn = "IESNA91\nTILT=NONE\n1 1000 1 2 4 1 1 0 0 0 1 1 50 0 90 0 90 180 270 8 0 6 0 4 0 2 0"
    profile = AngularProfile(**ies.parse(turn, name="whole")._asdict())
    assert profile.azimuth_deg == (0, 90, 180, 270, 360)
    assert profile.intensity[-1] == profile.intensity[0]
    np.testing.assert_allclose(
        profile.share_per_sr(0.0, [0, 45, 90, 225, 315]) * profile.flux, [8, 7, 6, 3, 5]
    )
    half = "IES:LM-63-2019\nTILT=NONE\n1 1000 1 2 2 1 1 0 0 0 1 1 50 0 90 0 180 8 0 4 0"
    profile = AngularProfile(**ies.parse(half, name="half")._asdict())
    np.testing.assert_allclose(profile.share_per_sr(0.0, [0, 90, 180, 270]) * profile.flux, [8, 6, 4, 6])


def test_the_default_is_lambertian():
    for name in ("default", "gelsight-2020-flat"):
        array = preset(name).leds
        assert all(array.profile_of(k).is_lambertian for k in range(3))
        assert array.coupling == "air_gap"
