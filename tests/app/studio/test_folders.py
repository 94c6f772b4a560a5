"""Studies and diagnoses in the studio."""

import pytest

from designlab.optimization.study import load_results
from designlab.sensor.camera import View
from designlab.sensor.design import load, preset
from designlab.simulation.contact.press import Press
from designlab.simulation.effects import AppliedEffect, SensorModel
from designlab.simulation.simulator import Simulator, automatic_exposure
from tests.helpers.studio import PICTURE_MS, QUICK_SENSOR, Studio, fill, pages

pytestmark = [pytest.mark.renders, pytest.mark.slow]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A finished study, and a diagnosis beside its measurement: vignetting that the model lacks."""
    found = tmp_path_factory.mktemp("studio")
    design = preset(QUICK_SENSOR)
    camera = design.camera
    model = SensorModel(
        design=design, effects=(AppliedEffect(name="vignetting", values={"corner_loss": 0.5}),)
    )
    view = View(0.0, 0.0, camera.width_px, camera.height_px, 64, 48)
    simulator = Simulator(model, view=view, samples=16, seed=3)
    scale = automatic_exposure(simulator.frame(None).mixed)
    press = Press(probe="sphere:4", depth_mm=0.6, centre_mm=(1.0, -1.0))
    fill(found, *(scale * simulator.frame(what).mixed for what in (None, press)))
    return found


@pytest.fixture(scope="module")
def studio(folder):
    pytest.importorskip("nicegui", reason="NiceGUI is not installed")
    found = Studio(folder, "diagnosis", "--port", "0")
    yield found
    assert found.stop() == 0


@pytest.fixture
def page(studio):
    with pages(studio) as opened:
        yield opened


def settled(tab):
    tab.wait_for_function(
        "document.getElementById('gap-state').textContent.startsWith('Brightness')", timeout=PICTURE_MS
    )


def residuals(tab):
    """Root mean square of the residual as given and with effects, percent."""
    words = tab.inner_text("#gap-rms").replace("%", "").split()
    return [float(word) for word in words if word.replace(".", "").isdigit()]


def test_a_gap_is_flicked_and_its_effect_switched_off(page):
    tab = page("", picture=False)  # what the studio was opened with
    settled(tab)
    before, after = residuals(tab)
    assert after < 0.8 * before
    seen = set()
    for key in "123":
        tab.keyboard.press(key)
        tab.wait_for_timeout(400)
        seen.add(tab.get_attribute("#gap-picture", "src"))
    assert len(seen) == 3
    tab.locator('[data-effect="vignetting"]').click()
    tab.wait_for_function(
        "document.getElementById('gap-rms').textContent.split('%')[0].split(' ').pop() === "
        "document.getElementById('gap-rms').textContent.split('%')[1].split(' ').pop()",
        timeout=PICTURE_MS,
    )


def test_a_trial_of_a_study_is_put_on_the_bench(page, folder):
    tab = page("?view=study&folder=study", picture=False)
    tab.get_by_text("4 of 4 designs evaluated").wait_for(timeout=PICTURE_MS)
    tab.locator("#front .js-plotly-plot").wait_for(timeout=PICTURE_MS)
    row = tab.locator("tbody tr").first
    trial = int(row.locator("td").first.inner_text())
    row.get_by_role("button").focus()
    tab.wait_for_function("document.getElementById('trial-picture').src", timeout=PICTURE_MS)
    assert f"Trial {trial}," in tab.inner_text("#trial-words")
    row.click()
    wanted = load(folder / "study" / "trials" / f"{trial:04d}" / "design.toml")
    assert wanted.digest == load_results(folder / "study").design(trial).digest
    tab.wait_for_function(
        f"document.getElementById('picture-now').dataset.digest === {wanted.digest!r}", timeout=PICTURE_MS
    )
    assert f"trials/{trial:04d}/design.toml" in tab.url
