"""Light files: the same lamp in both formats gives the same profile; damaged ones are refused by line."""

import numpy as np
import pytest

from designlab.sensor.design import DesignError, dumps, load, loads
from geometries import eulumdat, ies
from geometries.emission import AngularProfile
from geometries.intensity_table import LightFileError
from geometries.light_file import read

POLAR = np.arange(0, 181, 7.5)


def oval(turn_deg, polar_deg):
    """Beam with two mirror planes."""
    turn, polar = np.radians(turn_deg)[:, None], np.radians(polar_deg)[None]
    power = 2 + 5 * np.sin(turn) ** 2
    return 900 * np.maximum(np.cos(polar), 0) ** power


def leaning(turn_deg, polar_deg):
    """Beam that leans towards azimuth 0: one mirror plane, C0-C180."""
    return oval(turn_deg, polar_deg) * (
        1 + 0.5 * np.sin(np.radians(polar_deg))[None] * np.cos(np.radians(turn_deg))[:, None]
    )


def sideways(turn_deg, polar_deg):
    """Beam that leans towards azimuth 90: one mirror plane, C90-C270."""
    return oval(turn_deg, polar_deg) * (
        1 + 0.5 * np.sin(np.radians(polar_deg))[None] * np.sin(np.radians(turn_deg))[:, None]
    )


def askew(turn_deg, polar_deg):
    """Beam without symmetry."""
    return leaning(turn_deg, polar_deg) * (
        1 + 0.3 * np.sin(np.radians(polar_deg))[None] * np.sin(np.radians(turn_deg + 20))[:, None]
    )


def round_beam(turn_deg, polar_deg):
    return np.repeat(oval(np.zeros(1), polar_deg), len(turn_deg), axis=0)


def ldt(beam, symmetry, planes, *, sets=1, polar=POLAR, newline="\r\n", point=".", tilt="0"):
    """A EULUMDAT file of a beam, with the planes that its symmetry leaves."""
    turn = np.arange(planes) * 360 / planes
    stored = {
        0: turn,
        1: turn[:1],
        2: turn[: planes // 2 + 1],
        3: np.append(turn[3 * planes // 4 :], turn[: planes // 4 + 1]),
        4: turn[: planes // 4 + 1],
    }[symmetry]
    values = beam(stored, polar)
    head = ["Maker \x85 of lamps", 1, symmetry, planes, 360 / planes, len(polar), polar[1], "report", "name"]
    head += ["12", "lamp.ldt", "28-NOV-2026", 3, 3, 1, 2, 2, 0, 0, 0, 0, 100, 100, 1, tilt, sets]
    lamps = [line for _ in range(sets) for line in (1, "LED", 100, "4000 K", "80", 0.5)]
    lines = [*head, *lamps, *[0.5] * 10, *turn, *polar, *(f"{value:.2f}" for row in values for value in row)]
    text = newline.join(str(line) for line in lines) + newline
    return text if point == "." else text.replace(".", point)


def ies_text(beam, last, count, polar=POLAR):
    """The same as IES LM-63, with planes from 0 to the last."""
    turn = np.linspace(0, last, count)
    values = beam(turn, polar)
    numbers = [" ".join(f"{value:.2f}" for value in row) for row in values]
    return "\n".join(
        [
            "IESNA:LM-63-2002",
            "TILT=NONE",
            f"1 1000 1 {len(polar)} {len(turn)} 1 2 0 0 0 1 1 1",
            " ".join(f"{angle:g}" for angle in polar),
            " ".join(f"{angle:g}" for angle in turn),
            *numbers,
        ]
    )


CASES = [
    (oval, 4, 24, 90, 7),
    (oval, 2, 24, 180, 13),
    (leaning, 2, 36, 180, 19),
    (sideways, 3, 24, 360, 25),
    (askew, 0, 24, 360, 25),
    (round_beam, 1, 1, 0, 1),
    (round_beam, 1, 24, 0, 1),
]


@pytest.mark.parametrize(("beam", "symmetry", "planes", "last", "count"), CASES)
def test_a_lamp_in_both_formats_has_one_profile(tmp_path, beam, symmetry, planes, last, count):
    (tmp_path / "lamp.ldt").write_text(ldt(beam, symmetry, planes), encoding="latin-1", newline="")
    (tmp_path / "lamp.ies").write_text(ies_text(beam, last, count), encoding="ascii")
    found = [read(tmp_path / name, name=name) for name in ("lamp.ldt", "lamp.ies")]
    assert [file.format for file in found] == ["ldt", "ies"]
    first, second = (AngularProfile(**file.table._asdict()) for file in found)
    polar, turn = np.meshgrid(np.linspace(0, 90, 46), np.linspace(0, 360, 73))
    expected = second.share_per_sr(polar, turn)
    assert np.abs(first.share_per_sr(polar, turn) - expected).max() < 1e-3 * expected.max()


@pytest.mark.parametrize(
    "more",
    [{"newline": "\n"}, {"newline": "\r"}, {"point": ","}, {"sets": 3}, {"polar": np.arange(0, 91, 7.5)}],
)
def test_files_as_programs_write_them(more):
    table = eulumdat.parse(ldt(askew, 0, 24, **more), name="a.ldt")
    expected = eulumdat.parse(ldt(askew, 0, 24), name="b.ldt")
    np.testing.assert_allclose(table.intensity, expected.intensity)
    assert table.azimuth_deg == expected.azimuth_deg


@pytest.mark.faults
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({2: "7"}, ["line 3", "symmetry (Isym)", "from 0 to 4, is 7"]),
        ({3: "six"}, ["line 4", "number of C planes", "'six'"]),
        ({3: "18"}, ["line 4", "must divide by 4", "18"]),
        ({5: "1"}, ["line 6", "number of intensities"]),
        ({24: "15"}, ["line 25", "tilt", "15 deg"]),
        ({25: "400"}, ["line 26", "number of sets"]),
        ({42: "nan"}, ["line 43", "must be finite"]),
        ({44: "0"}, ["line 45", "must rise"]),
        ({-3: "-4"}, ["must not be negative", "-4"]),
        ({-3: ""}, ["the file ends where a number is due (intensity)"]),
    ],
)
def test_a_damaged_file_is_refused_by_line(change, words):
    lines = ldt(oval, 4, 24).split("\r\n")
    for line, text in change.items():
        lines[line] = text
    with pytest.raises(LightFileError) as raised:
        eulumdat.parse("\r\n".join(lines), name="a.ldt")
    for word in ("a.ldt", *words):
        assert word in str(raised.value)


@pytest.mark.faults
def test_too_few_lines_and_light_behind_are_refused():
    with pytest.raises(LightFileError, match=r"a\.ldt, line 2: the head of a EULUMDAT file has 26 lines"):
        eulumdat.parse("maker\n1", name="a.ldt")
    with pytest.raises(LightFileError, match="lies beyond 90 deg"):
        eulumdat.parse(ldt(lambda turn, polar: np.ones((len(turn), len(polar))), 4, 24), name="a.ldt")


DESIGN = """
mixing = [[1.0], [0.5], [0.2]]
[leds]
profile = { FIELD = "lamp" }
[[leds.groups]]
name = "white"
azimuth_deg = [90.0]
"""


@pytest.mark.parametrize("field", ["ies", "ldt"])
@pytest.mark.parametrize("written", ["ies", "ldt"])
def test_a_design_keeps_the_table_and_says_what_the_file_was(tmp_path, field, written):
    """The content tells the format, whichever field names the file."""
    text = ldt(oval, 4, 24) if written == "ldt" else ies_text(oval, 90, 7)
    (tmp_path / "lamp").write_text(text, encoding="latin-1", newline="")
    (tmp_path / "mine.toml").write_text(DESIGN.replace("FIELD", field))
    design = load(tmp_path / "mine.toml")
    profile = design.leds.profile
    assert getattr(profile, written) == "lamp"
    assert profile.understood["file"] == "lamp"
    assert profile.understood["as"].startswith("IES LM-63, 7" if written == "ies" else "EULUMDAT, 7 planes")
    assert profile.understood["size"] == [7, 13]
    (tmp_path / "lamp").unlink()
    assert loads(dumps(design)) == design


@pytest.mark.faults
def test_two_files_or_none_are_refused(tmp_path):
    (tmp_path / "mine.toml").write_text(DESIGN.replace('FIELD = "lamp"', 'ies = "a.ies", ldt = "a.ldt"'))
    with pytest.raises(DesignError, match=r"give one of .* ies and ldt"):
        load(tmp_path / "mine.toml")
    (tmp_path / "mine.toml").write_text(DESIGN.replace("FIELD", "ldt"))
    with pytest.raises(DesignError, match=r"field leds\.profile: lamp: cannot be read"):
        load(tmp_path / "mine.toml")


@pytest.mark.faults
@pytest.mark.parametrize("kind", ["ies", "ldt"])
def test_damaged_bytes_give_a_table_or_a_clear_error(tmp_path, kind):
    """Up to four characters changed, or the end cut off, 100 times."""
    text = ldt(askew, 0, 8) if kind == "ldt" else ies_text(askew, 360, 9)
    content = text.encode("latin-1")
    rng = np.random.default_rng(11)
    file = tmp_path / f"lamp.{kind}"
    for _ in range(100):
        changed = bytearray(content)
        for place in rng.integers(0, len(content) if rng.random() < 0.5 else 200, rng.integers(1, 5)):
            changed[place] = rng.integers(256)
        if rng.random() < 0.2:
            del changed[rng.integers(len(changed)) :]
        file.write_bytes(bytes(changed))
        said = None
        try:
            profile = AngularProfile(**read(file, name=file.name).table._asdict())
        except ValueError as error:
            said = str(error)
        assert said or profile.flux > 0


def test_ies_and_ldt_of_one_beam_agree_with_the_beam_itself():
    table = ies.parse(ies_text(oval, 90, 7), name="a.ies")
    other = eulumdat.parse(ldt(oval, 4, 24), name="a.ldt")
    assert table.azimuth_deg == other.azimuth_deg
    np.testing.assert_allclose(
        other.intensity, oval(np.array(other.azimuth_deg), other.polar_deg), atol=0.006
    )
