"""One body gives one picture, whatever its format, its unit and the side that presses."""

import json

import numpy as np
import pytest
import trimesh

from designlab.app.cli import main
from designlab.core.images import read_image

DESIGN = "gelsight-2020-flat"
FORMS = {
    "mm.stl": (1.0, 0, ()),
    "inch.obj": (1 / 25.4, 0, ("--probe-unit", "inch")),
    "down.ply": (0.1, 180, ("--probe-unit", "cm", "--probe-side", "-z")),
    "ahead.glb": (1e-3, -90, ("--probe-side", "+y")),
}


def knob(scale, degrees):
    """A plate with a ball off its middle, turned about x."""
    plate = trimesh.creation.box((12.0, 10.0, 3.0))
    ball = trimesh.creation.icosphere(subdivisions=3, radius=2.5)
    ball.apply_translation((1.2, -0.7, 2.0))
    body = trimesh.util.concatenate([plate, ball])
    body.apply_transform(trimesh.transformations.rotation_matrix(np.radians(degrees), (1, 0, 0)))
    body.apply_scale(scale)
    return body


@pytest.mark.renders
@pytest.mark.slow
def test_one_body_gives_one_picture(tmp_path, capsys):
    pictures = {}
    for name, (scale, degrees, options) in FORMS.items():
        knob(scale, degrees).export(tmp_path / name)
        words = ["render", DESIGN, "--probe", str(tmp_path / name), "--depth-mm", "0.6", *options]
        words += ["--columns", "32", "--samples", "2", "--json", "-o", str(tmp_path / "picture.exr")]
        assert main(words) == 0
        (said,) = json.loads(capsys.readouterr().out)["understood"]
        assert sorted(said["extents_mm"]) == pytest.approx([6.0, 10.0, 12.0], rel=1e-4)
        pictures[name] = read_image(tmp_path / "picture.exr")
    assert main(["render", DESIGN, *words[-7:-1], str(tmp_path / "gel.exr")]) == 0
    first = pictures["mm.stl"]
    assert np.abs(first - read_image(tmp_path / "gel.exr")).max() > 0.05 * first.max()
    for picture in pictures.values():
        assert np.abs(picture - first).max() < 1e-3 * first.max()
