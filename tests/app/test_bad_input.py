"""Bad input ends with one line naming file, field, value and rule, not with a traceback or half a file."""

import errno
import json
import math
import os
import re
import tomllib

import numpy as np
import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from designlab.app import cli
from designlab.core.images import write_image
from designlab.sensor.design import DesignError, dumps, loads, preset, preset_names, preset_text
from designlab.simulation.effects import SensorModel
from geometries import elastomer, gelcore, housing, leds

pytestmark = pytest.mark.faults

FLAT = "gelsight-2020-flat"


@pytest.fixture
def refused(capfd):
    """Run a command that must fail, with and without --json; return its exit status and its one line."""

    def runner(*arguments):
        words = [str(argument) for argument in arguments]
        capfd.readouterr()
        status = cli.main(words)
        out, err = capfd.readouterr()
        assert out == ""
        lines = [line for line in re.split(r"[\r\n]", err) if line.startswith("designlab: ")]
        assert len(lines) == 1, err
        assert "Traceback" not in err
        assert "defect" not in lines[0], lines[0]
        assert cli.main([*words, "--json"]) == status
        answer = json.loads(capfd.readouterr().out)
        assert answer["exit_status"] == status
        assert f"designlab: {answer['error']}" == lines[0]
        return status, lines[0]

    return runner


def written(path, text):
    path.write_text(text, encoding="utf-8")
    return path


class TestDesigns:
    @pytest.mark.parametrize(
        ("old", "new", "words"),
        [
            ("tilt_deg = 19.0", "tilt_degs = 19.0", ["leds.tilt_degs", "unknown field"]),
            ("tilt_deg = 19.0", 'tilt_deg = "steep"', ["leds.tilt_deg", "number", "'steep'"]),
            ("tilt_deg = 19.0", "tilt_deg = 120.0", ["leds.tilt_deg", "less than or equal to 90", "120"]),
            ("tilt_deg = 19.0", "tilt_deg = nan", ["leds.tilt_deg", "finite", "nan"]),
            ("tilt_deg = 19.0", "tilt_deg = [19.0]", ["leds.tilt_deg", "number", "[19.0]"]),
            ("width_px = 2592", "width_px = 2592.5", ["camera.width_px", "integer", "2592.5"]),
            (
                'gelcore_material = "resin-2020"',
                'gelcore_material = "cheese"',
                ["gelcore_material", "cheese", "acrylic"],
            ),
            (
                "membrane_albedo = [0.506, 0.397, 0.453]",
                "membrane_albedo = [1.5]",
                ["membrane_albedo", "between 0 and 1", "1.5"],
            ),
            (
                "membrane_albedo = [0.506, 0.397, 0.453]",
                "membrane_albedo = [0.5, 0.5]",
                ["membrane_albedo", "3 LED groups", "2"],
            ),
            ('name = "green"', 'name = "red"', ["leds", "names must differ", "red"]),
            ("[camera]", "[camera", ["not valid TOML"]),
        ],
    )
    def test_a_wrong_field_is_named(self, refused, tmp_path, old, new, words):
        text = preset_text(FLAT)
        assert old in text
        path = written(tmp_path / "mine.toml", text.replace(old, new, 1))
        for command in (["evaluate", path], ["render", path, "-o", tmp_path / "x.exr"]):
            status, line = refused(*command)
            assert status == 2
            for word in [str(path), *words]:
                assert word in line

    def test_impossible_geometry_is_named_with_its_rule_and_size(self, refused, tmp_path):
        design = preset("default").replace({"elastomer.thickness_mm": 0.3})
        path = written(tmp_path / "thin.toml", dumps(design))
        for command in (
            ["evaluate", path, "--out", tmp_path / "e"],
            ["render", path, "-o", tmp_path / "x.png"],
            ["export", path, "--out", tmp_path / "p"],
        ):
            status, line = refused(*command)
            assert status == 2
            assert re.search(rf"{re.escape(str(path))}: .*minimum_gel: .* \(violated by [0-9.]+ mm\)", line)
        assert not (tmp_path / "x.png").exists()
        assert not (tmp_path / "p").exists()

    @pytest.mark.parametrize("command", ["evaluate", "export", "render"])
    def test_a_missing_file_is_named_with_what_there_is(self, refused, tmp_path, command):
        output = ["-o", tmp_path / "x.exr"] if command == "render" else ["--out", tmp_path / "out"]
        status, line = refused(command, tmp_path / "nothing.toml", *output)
        assert status == 2
        assert str(tmp_path / "nothing.toml") in line
        assert FLAT in line

    def test_files_that_are_no_text(self, refused, tmp_path):
        path = tmp_path / "binary.toml"
        path.write_bytes(bytes(range(256)))
        for wrong in (path, tmp_path):
            status, line = refused("evaluate", wrong)
            assert status == 2
            assert str(wrong) in line

    def test_models_of_another_format_or_edited_by_hand(self, refused, tmp_path):
        text = SensorModel(design=preset(FLAT)).dumps()
        later = written(tmp_path / "later.toml", text.replace("format = 2", "format = 3"))
        status, line = refused("evaluate", later)
        assert status == 2
        assert "field format" in line
        edited = written(tmp_path / "edited.toml", text.replace("tilt_deg = 19.0", "tilt_deg = 20.0"))
        status, line = refused("evaluate", edited)
        assert status == 2
        assert "field digest" in line


class TestArguments:
    @pytest.mark.parametrize(
        ("words", "named"),
        [
            ([], ["COMMAND"]),
            (["evalute", FLAT], ["evalute", "evaluate"]),
            (["evaluate"], ["DESIGN"]),
            (["evaluate", FLAT, "--fidelity", "best"], ["--fidelity", "best", "fast"]),
            (["evaluate", FLAT, "--seed", "-1"], ["--seed", "-1", "0"]),
            (["evaluate", FLAT, "--sed", "1"], ["--sed"]),
            (["render", FLAT], ["--output"]),
            (["render", FLAT, "-o", "x.jpg"], ["--output", "x.jpg", ".png"]),
            (["render", FLAT, "-o", "x.png", "--depth-mm", "1"], ["--probe", "--depth-mm"]),
            (["render", FLAT, "-o", "x.png", "--probe", "sphere:4"], ["--depth-mm"]),
            (["render", FLAT, "-o", "x.png", "--probe", "ball:4", "--depth-mm", "1"], ["ball", "sphere"]),
            (
                ["render", FLAT, "-o", "x.png", "--probe", "sphere:x", "--depth-mm", "1"],
                ["sphere:x", "number"],
            ),
            (["render", FLAT, "-o", "x.png", "--probe", "no.stl", "--depth-mm", "1"], ["no.stl"]),
            (["render", FLAT, "-o", "x.png", "--probe-side", "-z"], ["--probe", "--probe-side"]),
            (
                [
                    "render",
                    FLAT,
                    "-o",
                    "x.png",
                    "--probe",
                    "sphere:4",
                    "--probe-unit",
                    "m",
                    "--depth-mm",
                    "1",
                ],
                ["--probe-unit", "mesh"],
            ),
            (
                ["render", FLAT, "-o", "x.png", "--probe", "a.stl", "--probe-side", "z", "--depth-mm", "1"],
                ["--probe-side", "'z'", "-z"],
            ),
            (
                ["render", "default", "-o", "x.png", "--probe", "sphere:6", "--depth-mm", "3.5"],
                ["press.depth_mm", "2 mm", "3.5 mm"],
            ),
            (
                ["render", FLAT, "-o", "x.png", "--probe", "sphere:6", "--depth-mm", "3.5"],
                ["press.depth_mm", "2 mm", "3.5 mm"],
            ),
            (["export", "default", "--out", "x", "--probe", "star", "--probe-side", "-z"], ["--probe-side"]),
            (["render", FLAT, "-o", "x.png", "--probe", "sphere", "--depth-mm", "-1"], ["depth_mm", "-1"]),
            (
                ["render", FLAT, "-o", "x.png", "--probe", "sphere", "--depth-mm", "1", "--at", "3"],
                ["--at", "'3'"],
            ),
            (["render", FLAT, "-o", "x.png", "--columns", "1"], ["--columns", "16"]),
            (["presets", "nope"], ["nope", FLAT]),
            (["init", "x", "--preset", "nope"], ["nope", FLAT]),
            (["export", "default", "--out", "x", "--probe", "ball:4"], ["ball", "sphere"]),
            (["export", FLAT, "--out", "x"], ["not buildable as published", "gelcore", "default"]),
            (["gap", "plant", "--effect", "magic", "--out", "x"], ["magic", "led_position"]),
            (
                ["gap", "plant", "--effect", "led_position:up=1", "--out", "x"],
                ["led_position", "up", "radial_mm"],
            ),
            (["gap", "plant", "--effect", "led_position:radial_mm=9", "--out", "x"], ["radial_mm", "9", "3"]),
            (
                ["gap", "plant", "--effect", "led_position:radial_mm=a", "--out", "x"],
                ["radial_mm", "'a'", "number"],
            ),
            (["gap", "plant", "--effect", "led_position:radial_mm", "--out", "x"], ["NAME[:PARAMETER=VALUE"]),
            (
                ["gap", "plant", "--effect", "vignetting:corner_loss=0.9", "--out", "x"],
                ["corner_loss", "0.8"],
            ),
            (
                ["gap", "plant", "--effect", "vignetting", "--strength", "9", "--out", "x"],
                ["vignetting", "9"],
            ),
            (["gap", "plant", "--outside", "fog", "--out", "x"], ["fog", "printed_markers"]),
            (["gap", "plant", "--outside", "moire:much", "--out", "x"], ["moire", "'much'", "number"]),
            (["gap", "plant", "--outside", "moire:7", "--out", "x"], ["moire", "between 0 and 2", "7"]),
            (["gap", "plant", "--kit-seed", "-1", "--out", "x"], ["--kit-seed", "-1"]),
        ],
    )
    def test_what_is_wrong_is_named(self, refused, tmp_path, monkeypatch, words, named):
        monkeypatch.chdir(tmp_path)
        status, line = refused(*words)
        assert status == 2
        for word in named:
            assert word in line
        assert list(tmp_path.iterdir()) == [], "nothing is written before the input is known to be good"


class TestImages:
    @pytest.fixture
    def good(self, tmp_path):
        path = tmp_path / "good.png"
        write_image(path, np.random.default_rng(0).random((32, 32, 3)))
        return path

    def test_a_png_that_is_not_an_image(self, refused, good, tmp_path):
        for path in (
            written(tmp_path / "text.png", "this is text"),
            tmp_path / "cut.png",
            tmp_path / "empty.png",
            tmp_path / "missing.png",
        ):
            if path.name == "cut.png":
                path.write_bytes(good.read_bytes()[:60])
            elif path.name == "empty.png":
                path.touch()
            for pair in ((path, good), (good, path)):
                status, line = refused("compare", *pair)
                assert status == 2
                assert str(path) in line

    def test_images_that_do_not_fit_together(self, refused, good, tmp_path):
        other = tmp_path / "other.png"
        write_image(other, np.random.default_rng(0).random((32, 31, 3)))
        status, line = refused("compare", other, good)
        assert status == 2
        for word in (str(other), str(good), "(32, 32, 3)", "(32, 31, 3)"):
            assert word in line

    def test_an_image_where_a_design_is_expected(self, refused, good, tmp_path):
        status, line = refused("evaluate", good)
        assert status == 2
        assert str(good) in line
        status, line = refused("compare", FLAT, good)
        assert status == 2
        assert FLAT in line


class TestMeasurements:
    @pytest.fixture
    def folder(self, tmp_path):
        folder = tmp_path / "set"
        folder.mkdir()
        write_image(folder / "a.exr", np.random.default_rng(0).random((60, 60, 3)).astype(np.float32))
        frame = {"file": "a.exr", "kind": "press", "probe": "sphere:4", "depth_mm": 0.5, "centre_mm": [0, 0]}
        content = {
            "sensor": FLAT,
            "response": "linear",
            "frame": [frame | {"crop_px": [1024, 670, 600, 600]}],
        }
        (folder / "measurement.toml").write_text(tomli_w.dumps(content))
        return folder

    @pytest.mark.parametrize(
        ("old", "new", "words"),
        [
            ("depth_mm = 0.5", "depth = 0.5", ["frame 1 (a.exr)", "depth", "unknown field"]),
            ("depth_mm = 0.5", "depth_mm = -1", ["frame 1 (a.exr)", "depth_mm", "greater than 0", "-1"]),
            ('kind = "press"', 'kind = "push"', ["frame 1 (a.exr)", "kind", "push"]),
            ('file = "a.exr"', 'file = "b.exr"', ["b.exr"]),
            ('response = "linear"', 'response = "log"', ["response", "log"]),
            ('response = "linear"', 'response = "unknown"', ["response"]),
            (f'sensor = "{FLAT}"', 'sensor = "nothing.toml"', ["sensor", "nothing.toml"]),
            (
                f'sensor = "{FLAT}"',
                'sensor = "gelsight-2021"',
                ["sensor: must be a preset", "'gelsight-2021'"],
            ),
            ("centre_mm = [\n    0,\n    0,\n]\n", "", ["a.exr", "centre_mm"]),
            ("depth_mm = 0.5", "depth_range_mm = [0.5, 0.2]", ["frame 1 (a.exr)", "depth_range_mm"]),
            (
                "depth_mm = 0.5",
                "depth_mm = 0.5\ndepth_range_mm = [0.2, 0.5]",
                ["depth_range_mm", "leave one"],
            ),
            ("depth_mm = 0.5", "depth_range_mm = [2.5, 3.0]", ["depth_range_mm", "thickness of 2 mm"]),
            (
                "depth_mm = 0.5",
                "contact_diameter_mm = 2\ncontact_diameter_px = 9",
                ["contact_diameter_px", "says the same"],
            ),
            ("depth_mm = 0.5", "contact_diameter_mm = 5.0", ["a.exr", "ball's radius of 2 mm"]),
        ],
    )
    def test_a_wrong_field_is_named(self, refused, folder, old, new, words):
        path = folder / "measurement.toml"
        assert old in path.read_text()
        path.write_text(path.read_text().replace(old, new, 1))
        status, line = refused("compare", FLAT, folder)
        assert status == 2
        for word in [str(folder), *words]:
            assert word in line

    @pytest.mark.renders
    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("old", "new", "words"),
        [
            ("    0,\n    0,\n", "    0,\n    900,\n", "does not touch"),
            ("    0,\n    0,\n", "    1e30,\n    0,\n", "does not touch"),
            ("depth_mm = 0.5", "depth_mm = 2.5", "press.depth_mm: must be less than the gel is thick"),
        ],
    )
    def test_a_press_that_cannot_be_is_named_by_its_frame(self, refused, folder, old, new, words):
        path = folder / "measurement.toml"
        assert old in path.read_text()
        path.write_text(path.read_text().replace(old, new, 1))
        for command in (["compare", FLAT, folder], ["calibrate", folder, "--model", FLAT, "--out", "none"]):
            status, line = refused(*command)
            assert status == 2
            assert f"{folder}: frame a.exr: " in line
            assert words in line

    def test_no_measurement_there(self, refused, tmp_path):
        for command in (
            ["compare", FLAT, tmp_path],
            ["gap", "diagnose", tmp_path, "--model", FLAT, "--out", tmp_path],
        ):
            status, line = refused(*command)
            assert status == 2
            assert str(tmp_path) in line
            assert "measurement.toml" in line


class TestStudies:
    STUDY = """
version = 1
base = "gelsight-2020-flat"
trials = 3
[parameters.leds.tilt_deg]
low = 0.0
high = 40.0
"""

    @pytest.mark.parametrize(
        ("old", "new", "words"),
        [
            ("version = 1", "version = 7", ["version", "7", "1"]),
            ("version = 1\n", "", ["version"]),
            ('base = "gelsight-2020-flat"', 'base = "nothing"', ["base", "nothing", FLAT]),
            ("leds.tilt_deg", "leds.tilt", ["leds.tilt", "no field"]),
            ("high = 40.0", "high = 400.0", ["leds.tilt_deg", "400", "90"]),
            ("low = 0.0", "low = 50.0", ["leds.tilt_deg", "50", "40"]),
            ("trials = 3", "trials = 0", ["trials", "0"]),
            ("trials = 3", 'sampler = "guess"', ["sampler", "guess", "tpe"]),
            ("trials = 3", "tirals = 3", ["tirals", "unknown field"]),
            ("trials = 3", "plan.promoted = -1", ["plan.promoted", "-1", "0"]),
            ("trials = 3", "constraints.glow.least = 1", ["constraints", "'glow'", "coverage"]),
            ("trials = 3", 'objectives.glow = "maximise"', ["objectives", "'glow'", "coverage"]),
        ],
    )
    def test_a_wrong_field_is_named(self, refused, tmp_path, old, new, words):
        assert old in self.STUDY
        path = written(tmp_path / "mine.toml", self.STUDY.replace(old, new, 1))
        status, line = refused("study", "run", path)
        assert status == 2
        for word in [str(path), *words]:
            assert word in line
        assert sorted(entry.name for entry in tmp_path.iterdir()) == ["mine.toml"]

    @pytest.mark.parametrize("action", ["run", "status", "report"])
    def test_no_study_there(self, refused, tmp_path, action):
        for wrong in (tmp_path / "nothing.toml", tmp_path):
            status, line = refused("study", action, wrong)
            assert status == 2
            assert str(wrong).removesuffix(".toml") in line


def into(place):
    """Every command that writes, told to write into a place."""
    return (
        ["init", place / "new"],
        ["demo", "--out", place / "new"],
        ["evaluate", FLAT, "--out", place / "new"],
        ["render", FLAT, "--columns", "16", "--samples", "1", "-o", place / "new" / "x.exr"],
        ["export", "default", "--out", place / "new"],
        ["study", "run", "STUDY", "--out", place / "new"],
        ["gap", "plant", "--kit", "small", "--columns", "8", "--out", place / "new"],
    )


class TestPlacesThatCannotBeWritten:
    @pytest.fixture
    def study(self, tmp_path):
        return written(tmp_path / "study.toml", TestStudies.STUDY)

    @pytest.mark.slow
    @pytest.mark.parametrize("number", range(7))
    def test_a_path_below_a_file(self, refused, study, tmp_path, number):
        place = written(tmp_path / "file", "kept")
        words = [study if word == "STUDY" else word for word in into(place)[number]]
        status, line = refused(*words)
        assert status == 1
        assert str(place) in line
        assert place.read_text() == "kept"

    def test_a_comparison_is_refused_before_anything_is_rendered(self, refused, tmp_path):
        text = preset_text("default")
        near = written(tmp_path / "near.toml", text.replace("radius_mm = 13.3", "radius_mm = 12.0"))
        status, line = refused("evaluate", "default", near, "--compare", "--out", tmp_path / "out")
        assert status == 2
        assert "near.toml" in line
        assert "leds_clear_of_core" in line
        (tmp_path / "mine").mkdir()
        written(tmp_path / "mine" / "report.txt", "mine")
        status, line = refused("evaluate", "default", FLAT, "--compare", "--out", tmp_path / "mine")
        assert status == 2
        assert "report.txt" in line
        assert not (tmp_path / "out").exists()

    def test_a_mistyped_field_of_a_file_is_answered_with_the_nearest(self, refused, tmp_path):
        text = preset_text("default").replace("tilt_deg = 0.0", "tlit_deg = 0.0")
        status, line = refused("evaluate", written(tmp_path / "mine.toml", text))
        assert status == 2
        assert "leds.tlit_deg: unknown field; did you mean 'leds.tilt_deg'?" in line

    @pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
    @pytest.mark.parametrize("number", range(7))
    def test_a_read_only_folder(self, refused, study, tmp_path, number):
        place = tmp_path / "locked"
        place.mkdir()
        place.chmod(0o555)
        words = [study if word == "STUDY" else word for word in into(place)[number]]
        status, line = refused(*words)
        assert status == 1
        assert str(place) in line
        assert list(place.iterdir()) == []

    def test_a_full_disk(self, refused, tmp_path, monkeypatch):
        def full(descriptor):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr(os, "fsync", full)
        status, line = refused("init", tmp_path / "new")
        assert status == 1
        assert "new" in line
        assert "No space left on device" in line
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.renders
    def test_a_disk_that_is_full_when_the_pictures_are_written(self, refused, tmp_path, monkeypatch):
        from designlab.core import images

        def full(path, pixels):
            path.write_bytes(b"half")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

        monkeypatch.setitem(images._ENCODERS, ".exr", full)
        words = ["--columns", "16", "--samples", "1", "-o", tmp_path / "x.exr"]
        status, line = refused("render", FLAT, *words)
        assert status == 1
        assert "No space left on device" in line
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.slow
    def test_a_folder_with_something_else_is_left_alone(self, refused, tmp_path):
        note = written(tmp_path / "note.txt", "mine")
        for words in (
            ["evaluate", FLAT],
            ["export", "default"],
            ["gap", "plant", "--kit", "small", "--columns", "8"],
        ):
            status, line = refused(*words, "--out", tmp_path)
            assert status in (1, 2)
            assert str(tmp_path) in line
        assert note.read_text() == "mine"
        assert list(tmp_path.iterdir()) == [note]


def leaves(content, path=()):
    """Every entry of nested tables and lists, by path."""
    entries = content.items() if isinstance(content, dict) else enumerate(content)
    for key, value in entries:
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from leaves(value, (*path, key))


PRESETS = {name: tomllib.loads(dumps(preset(name))) for name in preset_names()}
# fields that no preset gives
PRESETS["freeform"] = tomllib.loads(
    dumps(
        preset("default").replace(
            {
                "elastomer": {
                    "shape": "freeform",
                    "outline": "round",
                    "width_mm": 24.0,
                    "thickness_mm": 3.0,
                    "profile_mm": ((0.0, 0.0), (4.0, 0.2), (8.0, 0.9), (12.0, 2.0)),
                },
                "optics.gelcore_index": 1.52,
                "optics.elastomer_index": 1.4,
                "optics.gelcore_absorption_per_mm": (0.01, 0.0, 0.02),
                "optics.elastomer_absorption_per_mm": (0.01,),
                "optics.gelcore_scattering_per_mm": 0.02,
                "optics.coating_specular": 0.3,
                "optics.coating_transmittance": 0.1,
                "optics.object_reflectance": 0.5,
                "optics.marker_pitch_mm": 1.5,
                "optics.housing_reflectance": (0.6,),
            }
        )
    )
)
PATHS = {name: list(leaves(content)) for name, content in PRESETS.items()}

numbers = st.one_of(
    st.floats(-100, 100),
    st.floats(),
    st.integers(-10, 300),
    st.integers(-(10**18), 10**18),
    st.sampled_from([0, 0.0, -0.0, 1e-300, 1e300, 1, 2, 0.5]),
)
texts = st.one_of(
    st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=8),
    st.sampled_from(
        [
            "flat",
            "dome",
            "freeform",
            "hexagonal",
            "air",
            "core",
            "ring",
            "edge",
            "smd",
            "panel",
            "acrylic",
            "red",
        ]
    ),
)
anything = st.recursive(
    st.one_of(numbers, st.booleans(), texts),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(texts, inner, max_size=3)),
    max_leaves=6,
)


@st.composite
def mutated(draw):
    """Text of a preset with a few entries changed a little, replaced by anything, deleted or added."""
    name = draw(st.sampled_from(sorted(PRESETS)))
    content = json.loads(json.dumps(PRESETS[name]))
    for _ in range(draw(st.integers(1, 4))):
        path = draw(st.sampled_from(PATHS[name]))
        node = content
        try:
            for key in path[:-1]:
                node = node[key]
            old = node[path[-1]]
        except (KeyError, IndexError, TypeError):
            continue  # an earlier change took it away
        action = draw(st.sampled_from(["scale", "replace", "delete", "add"]))
        if action == "scale" and isinstance(old, float | int) and not isinstance(old, bool):
            node[path[-1]] = old * draw(st.floats(-2, 4))
        elif action == "delete":
            del node[path[-1]]
        elif action == "add" and isinstance(node, dict):
            node[draw(texts)] = draw(anything)
        else:
            node[path[-1]] = draw(anything)
    return tomli_w.dumps(content)


def accepted(text):
    """The design that a text holds; None where it is refused with the field that is wrong."""
    try:
        return loads(text, source="mine.toml")
    except DesignError as error:
        reason = str(error)
    assert re.match(r"mine\.toml: field \S", reason), reason
    assert "\n" not in reason
    return None


class TestArbitraryDesigns:
    @pytest.mark.slow
    @settings(max_examples=400, suppress_health_check=[HealthCheck.too_slow])
    @given(text=mutated())
    def test_each_is_usable_or_refused_by_field(self, text):
        design = accepted(text)
        if design is None:
            return
        margins = design.margins()
        assert margins
        assert not any(math.isnan(margin) for margin in margins.values()), margins
        assert len(leds.emitters(design.leds)) > 0
        assert len(leds.bodies(design.leds)) > 0
        again = loads(dumps(design))
        assert again == design
        assert again.digest == design.digest

    @settings(max_examples=100)
    @given(text=st.text(st.characters(exclude_categories=["Cs"])))
    def test_arbitrary_text_is_refused(self, text):
        with pytest.raises(DesignError, match=r"^mine\.toml: (not valid TOML|field )"):
            loads(text, source="mine.toml")

    @pytest.mark.slow
    @settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much])
    @given(text=mutated())
    def test_what_is_feasible_has_solids(self, text):
        """Parts of an accepted design have volume, or its margins say why it cannot be built."""
        design = accepted(text)
        if design is None or any(margin > 0 for margin in design.margins().values()):
            return
        for part in (
            gelcore.solid(design.gelcore),
            elastomer.solid(design.elastomer),
            housing.solid(design.housing),
            leds.solid(design.leds),
        ):
            shape = part.val()
            assert shape.isValid()
            assert shape.Volume() > 0
