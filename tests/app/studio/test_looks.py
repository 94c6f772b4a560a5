"""Every view in two sizes and both themes: nothing overlaps, is clipped, pale, nameless or out of reach."""

import base64
import os
from pathlib import Path

import numpy as np
import pytest

from tests import ROOT
from tests.helpers.browser import opened
from tests.helpers.studio import FULL, PICTURE_MS, QUICK_SENSOR, Studio, fill, pages

pytestmark = [pytest.mark.renders, pytest.mark.slow]
AUDIT = (ROOT / "tests" / "helpers" / "page_audit.js").read_text()
SIZES = ((1280, 800), (1920, 1080))
THEMES = ("light", "dark")
SHOTS = os.environ.get("DESIGNLAB_SHOTS")  # folder for screenshots, to be looked at


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    pytest.importorskip("nicegui", reason="NiceGUI is not installed")
    folder = tmp_path_factory.mktemp("studio")
    found = Studio(folder, QUICK_SENSOR, "--port", "0")
    yield found
    assert found.stop() == 0


@pytest.fixture
def tab(studio):
    with pages(studio) as opened:
        yield opened("?view=study", picture=False)


def pictures():
    """The untouched gel and a press, made up."""
    x, y = np.meshgrid(np.linspace(-1, 1, 64), np.linspace(-1, 1, 48))
    rest = np.stack([0.5 + 0.1 * x, 0.5 - 0.1 * y, 0.5 + 0.1 * y], axis=-1)
    return rest, rest + 0.3 * (np.exp(-20 * (x**2 + y**2)) * x)[..., None]


def audited(tab, state):
    """Faults of a state of the page in all sizes and themes."""
    found = {}
    for width, height in SIZES:
        tab.set_viewport_size({"width": width, "height": height})
        for theme in THEMES:
            tab.emulate_media(color_scheme=theme)
            tab.mouse.move(1, 1)  # away from what shows a tip, which is pale while it fades
            tab.wait_for_timeout(400)
            tab.locator(".q-tooltip").first.wait_for(state="detached")
            if SHOTS:
                tab.screenshot(path=Path(SHOTS) / f"{state}-{width}-{theme}.png")
            for fault in tab.evaluate(AUDIT):
                found.setdefault(fault, []).append(f"{width} {theme}")
    return [f"{state}: {fault} ({', '.join(where)})" for fault, where in found.items()]


def view(tab, name):
    tab.get_by_role("tab", name=name).click()


def test_every_view_can_be_read_and_reached(tab, studio):
    """One page goes through all of them, empty ones first."""
    faults = audited(tab, "study-empty")
    view(tab, "Gap")
    faults += audited(tab, "gap-empty")
    view(tab, "Reconstruct")
    faults += audited(tab, "reconstruct-empty")
    fill(studio.folder, *pictures())
    view(tab, "Study")
    tab.get_by_text("4 of 4 designs evaluated").wait_for(timeout=PICTURE_MS)
    tab.locator("#front .js-plotly-plot .main-svg").first.wait_for(timeout=PICTURE_MS)
    faults += audited(tab, "study")
    view(tab, "Gap")
    tab.get_by_text("Brightness of each LED group is fitted").wait_for(timeout=PICTURE_MS)
    faults += audited(tab, "gap")
    view(tab, "Design")
    tab.wait_for_function(FULL, timeout=PICTURE_MS)
    tab.get_by_text("fidelity fast").wait_for(timeout=PICTURE_MS)
    faults += audited(tab, "design")
    picture = base64.b64decode(tab.get_attribute("#picture-now", "src").partition(",")[2])
    view(tab, "Reconstruct")
    dropped = {"name": "press.jpg", "mimeType": "image/jpeg", "buffer": picture}
    tab.locator("#drop-picture input[type=file]").set_input_files(dropped)
    tab.locator("#upload-state").filter(has_text="depth 0.").wait_for(timeout=PICTURE_MS)
    faults += audited(tab, "reconstruct")
    view(tab, "Design")
    tab.click("#pin")
    tab.get_by_text("LED group red").click()
    entry = tab.locator('[data-path="leds.radius_mm"] input').last
    for value in ("40", "wide"):
        entry.fill(value)
        entry.press("Enter")
    tab.locator(".knob .wrong").filter(has_text="must be a number").wait_for(timeout=PICTURE_MS)
    faults += audited(tab, "design-broken-pinned")
    for name in ("save", "export", "copy"):
        tab.click(f"#{name}")
        tab.locator(".q-dialog .q-card").wait_for()
        faults += audited(tab, f"design-{name}")
        tab.keyboard.press("Escape")
        tab.locator(".q-dialog .q-card").wait_for(state="detached")
    assert faults == [], "\n".join(faults)


HEALTHY = """
<p style="color: #333">Some words</p><button>press</button><label>depth <input value="0.5"></label>
<div style="overflow: hidden; width: 20rem">all of it is seen</div>
"""
FAULTS = {
    "overlap": "<p style='position: fixed; top: 200px'>one</p><p style='position: fixed; top: 204px'>two</p>",
    "clipped": "<div style='overflow: hidden; width: 3rem; white-space: nowrap'>more than has room</div>",
    "sideways": "<p style='width: 3000px'>wide</p>",
    "contrast 2": "<p style='color: #aaa'>pale</p>",
    "contrast 3": "<div style='background: #777'><p style='color: #fff; opacity: .9'>pale too</p></div>",
    "no name": "<input value='0.5'>",
    "not reached": "<div style='cursor: pointer' onclick='1'>press here</div>",
    "not reached: button": "<button tabindex='-1'>press here</button>",
}


@pytest.fixture(scope="module")
def bare():
    with opened() as browser:
        yield browser.new_page(viewport={"width": 1280, "height": 800})


def test_the_audit_lets_a_healthy_page_pass(bare):
    bare.set_content(HEALTHY)
    assert bare.evaluate(AUDIT) == []


@pytest.mark.parametrize("kind", FAULTS)
def test_the_audit_finds_a_fault_that_was_planted(bare, kind):
    bare.set_content(HEALTHY + FAULTS[kind])
    found = bare.evaluate(AUDIT)
    assert len(found) == 1
    assert found[0].startswith(kind)
