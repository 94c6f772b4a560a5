"""The jobs of the command line as calls, and objects as people type and read them."""

import numpy as np
import pytest

import designlab as dl
from designlab.core.images import write_image
from designlab.evaluation.score import Score
from designlab.sensor.design import (
    DesignError,
    InfeasibleDesign,
    differences,
    dumps,
    load,
    loads,
    preset_text,
)


def test_a_press_takes_its_probe_as_text():
    assert dl.Press(probe="triangle:5:r0.2", depth_mm=0.5).probe == dl.triangle(5, edge_radius_mm=0.2)
    with pytest.raises(ValueError, match=r"unknown 'ball'.*sphere"):
        dl.Press(probe="ball:4", depth_mm=0.5)


@pytest.mark.parametrize("kind", ["sphere", "cylinder", "cone", "prism", "dots", "bars", "wave", "star"])
def test_every_probe_is_made_with_its_size_alone(kind):
    assert getattr(dl, kind)(3.5).text == f"{kind}:3.5"


@pytest.mark.parametrize(
    ("path", "meant"),
    [
        ("leds.tilt", "leds.tilt_deg"),
        ("leds.hight_mm", "leds.height_mm"),
        ("leds.groups.0.flux", "leds.groups.flux_mw"),
        ("thickness_mm", "elastomer.thickness_mm"),
    ],
)
def test_a_mistyped_field_is_answered_with_the_nearest(path, meant):
    with pytest.raises(DesignError, match=f"no field '{path}'.*did you mean '{meant}'"):
        dl.preset("default").replace({path: 1.0})


def test_the_help_of_a_design_lists_every_field_with_unit_range_and_default():
    text = dl.Design.__doc__
    assert "leds.tilt_deg\n" in text
    assert "[deg, -90 to 90, default 0.0]" in text
    assert "optics.light_path" in text
    assert "air | core" in text or "core | air" in text


def test_a_design_is_written_with_a_comment_to_each_field_and_read_again():
    changes = {"leds.groups.1.flux_mw": 5.0, "description": 'an open [ and a "quote"'}
    design = dl.preset("gelsight-2020-flat-elastic").replace(changes)
    text = dumps(design)
    assert loads(text) == design
    lines = text.splitlines()
    fields = [n for n, line in enumerate(lines) if " = " in line and line[0] not in " #"]
    commented = sum(lines[n - 1].startswith("# ") for n in fields)
    assert commented == len(fields) > 60


def test_a_changed_design_has_a_name_and_knows_what_it_was_made_from(tmp_path):
    design = dl.preset("default")
    changed = design.replace({"leds.tilt_deg": 5.0, "leds.height_mm": 4.0})
    assert changed.name == "default with leds.height_mm 4, leds.tilt_deg 5"
    assert changed.parent == "default"
    assert changed.changes == {"leds.height_mm": (6.0, 4.0), "leds.tilt_deg": (0.0, 5.0)}
    assert changed.lineage == "made from preset default: leds.height_mm 6 -> 4; leds.tilt_deg 0 -> 5"
    assert changed.replace({"leds.tilt_deg": 0.0, "leds.height_mm": 6.0}) == design
    assert design.replace({"leds.tilt_deg": 0.0}).name == "default"  # nothing changed
    own = design.replace({"name": "gel with dots"})  # a name of one's own is kept whole
    assert own.replace({"leds.tilt_deg": 5.0}).name == "gel with dots with leds.tilt_deg 5"
    named = design.replace({"leds.tilt_deg": 5.0, "name": "mine"})
    assert (named.name, named.lineage) == ("mine", "made from preset default: leds.tilt_deg 0 -> 5")
    file = tmp_path / "mine.toml"
    file.write_text(preset_text("default").replace("tilt_deg = 0.0", "tilt_deg = 3.0"))
    edited = load(file)  # a copy of a preset that was edited does not pass for it
    assert (edited.name, edited.parent) == ("mine", "default")
    assert differences(edited, design) == {"leds.tilt_deg": (0.0, 3.0)}


def test_labels_do_not_change_what_a_design_is():
    design = dl.preset("gelsight-2020-flat")
    assert design.leds.relative_flux
    assert design.replace({"leds.relative_flux": False}).digest == design.digest
    assert "Design('default': flat gel 2 mm, LEDs red 3, green 3, blue 3" in repr(dl.preset("default"))


def test_a_replay_of_a_publication_is_not_exported_unless_told(tmp_path):
    with pytest.raises(InfeasibleDesign, match=r"not buildable as published.*gelcore.*allow"):
        dl.export("gelsight-2020-flat", tmp_path / "parts")
    assert not (tmp_path / "parts").exists()


def test_images_are_compared_by_their_files(tmp_path):
    for name, scale in (("a.exr", 1.0), ("b.exr", 0.9)):
        write_image(tmp_path / name, np.full((8, 8, 3), scale, dtype=np.float32))
    assert dl.compare(tmp_path / "a.exr", tmp_path / "b.exr")["mse"] == pytest.approx(0.01)
    with pytest.raises(ValueError, match="is an image, which takes an image"):
        dl.compare(dl.preset("default"), tmp_path / "a.exr")


def test_a_score_is_short_in_print_and_a_table_in_a_notebook():
    from tests.evaluation.test_paired_comparison import presses, score

    found = score(presses(0))
    assert isinstance(found, Score)
    assert len(repr(found)) < 80
    assert "<table" in found._repr_html_()
    assert list(found.table().columns) == ["value", "se", "unit"]


@pytest.mark.renders
def test_a_frame_shows_itself():
    frame = dl.render(dl.preset("gelsight-2020-flat"), columns=24, samples=4)
    assert "24 x" in repr(frame)
    assert frame._repr_html_().startswith("<img alt=")
    assert len(frame.show().axes) == 3  # two pictures and the scale of heights
