"""What real sensors have and no design can say: one line that names it, whoever asks."""

import json

import pytest

from designlab.app.cli import main
from designlab.sensor.design import DesignError, dumps, loads, preset, preset_text

pytestmark = pytest.mark.faults
TEXT = dumps(preset("default"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            "elastomer_scattering_per_mm = 0.5",
            ["optics.elastomer_scattering_per_mm", "translucent", "9DTact"],
        ),
        ("elastomer_scattering_per_mm = [1.0, 1.0, 1.0]", ["optics.elastomer_scattering_per_mm"]),
        ("elastomer_anisotropy = 0.9", ["optics.elastomer_anisotropy", "not simulated"]),
    ],
)
def test_a_translucent_gel_is_refused_by_name(change, words):
    with pytest.raises(DesignError) as refused:
        loads(TEXT.replace("[optics]", f"[optics]\n{change}"))
    assert "\n" not in str(refused.value)
    for word in words:
        assert word in str(refused.value)


@pytest.mark.parametrize("heading", ["[[camera]]", "[[cameras]]", "[cameras.left]"])
def test_several_cameras_are_refused_by_name(heading):
    text = TEXT.replace("[camera]", heading).replace("[camera.", "[unused.")
    with pytest.raises(DesignError, match=r"cameras?: a design has one camera, several are not simulated"):
        loads(text)


@pytest.mark.parametrize("name", ["9dtact", "DTact", "9DTact-like", "omnitact", "gelsight-svelte"])
def test_a_sensor_that_cannot_be_said_is_refused_with_the_reason(name, capsys):
    with pytest.raises(DesignError, match=r"simulated|one camera"):
        preset_text(name)
    for command in (["presets", name], ["evaluate", name], ["export", name, "--out", "nowhere"]):
        assert main([*command, "--json"]) == 2
        told = json.loads(capsys.readouterr().out)["error"]
        assert "simulated" in told or "one camera" in told
