"""The studio in a browser."""

import base64
import urllib.error
import urllib.request

import pytest

from designlab.sensor.design import load, preset
from tests.helpers.studio import FULL, PICTURE_MS, Studio, pages

pytestmark = [pytest.mark.renders, pytest.mark.slow]
NAME = "gelsight-2020-flat"  # in air, which is quick
ORDER = """
() => {
  window.order = [];
  window.addEventListener("studio-picture", () => order.push("picture"));
  const socket = window.socket.io.engine.transport.ws;
  socket.addEventListener("message", (event) => {
    if (String(event.data).startsWith('42["update"')) order.push("page");
  });
}
"""
FOLLOW = """
() => {
  window.asked = [];
  window.followed = [];
  const expect = studio.expect;
  studio.expect = (digest, request) => { asked.push(request); expect(digest, request); };
  window.addEventListener("studio-picture", (event) => {
    if (event.detail.slot !== "now") return;
    const digest = document.getElementById("picture-now").dataset.digest;
    const facts = document.getElementById("facts")?.textContent;
    followed.push({ digest, facts, request: event.detail.request, step: event.detail.step });
  });
}
"""
STALE = "document.getElementById('stage').classList.contains('stale')"


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    pytest.importorskip("nicegui", reason="NiceGUI is not installed")
    folder = tmp_path_factory.mktemp("studio")
    found = Studio(folder, NAME, "--port", "0")
    yield found
    assert found.stop() == 0
    assert "Traceback" not in "\n".join(found.lines)


@pytest.fixture
def page(studio):
    with pages(studio) as opened:
        yield opened


def digest(tab):
    return tab.get_attribute("#picture-now", "data-digest")


def turn(tab, path, value):
    """Write a value into a field of the design."""
    entry = tab.locator(f'[data-path="{path}"] input').last
    entry.fill(str(value))
    entry.press("Enter")


def new_picture(tab, before):
    """Wait for a picture of another design."""
    tab.wait_for_function(
        f"document.getElementById('picture-now').dataset.digest !== {before!r} && !{STALE}",
        timeout=PICTURE_MS,
    )


def test_an_led_that_is_moved_changes_the_picture_and_undo_brings_it_back(page):
    tab = page()
    before = digest(tab)
    assert before == preset(NAME).digest
    picture = tab.get_attribute("#picture-now", "src")
    turn(tab, "leds.height_mm", preset(NAME).leds.height_mm + 1)
    new_picture(tab, before)
    assert tab.get_attribute("#picture-now", "src") != picture
    assert "set=leds.height_mm" in tab.evaluate(
        "() => new Promise(done => setTimeout(() => done(location.href), 1500))"
    )
    moved = digest(tab)
    tab.click("#undo")
    new_picture(tab, moved)
    assert digest(tab) == before


def test_the_probe_is_dragged_pushed_and_moved_by_keys(page):
    tab = page()
    x = tab.get_by_label("x (mm)")
    before = int(tab.get_attribute("#picture-now", "data-request"))
    box = tab.locator("#pictures").bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    tab.mouse.move(*middle)
    tab.mouse.down()
    for step in range(1, 6):
        tab.mouse.move(middle[0] + 20 * step, middle[1] - 5 * step)
    tab.mouse.up()
    tab.wait_for_function(  # a full one comes when nothing moves any more
        f"(({{request, step}}) => +request > {before} && !step.startsWith('coarse'))"
        "(document.getElementById('picture-now').dataset)",
        timeout=PICTURE_MS,
    )
    moved = float(x.input_value())
    assert moved > 1.0
    assert float(tab.get_by_label("y (mm)").input_value()) > 0.2
    tab.locator("#pictures").focus()
    tab.keyboard.press("Shift+ArrowLeft")
    tab.wait_for_function(
        f"Math.abs(document.querySelector('[aria-label=\"x (mm)\"]').value - {moved - 1}) < 0.01"
    )
    depth = float(tab.get_by_label("depth (mm)").input_value())
    tab.keyboard.press("+")
    tab.wait_for_function(f"document.querySelector('[aria-label=\"depth (mm)\"]').value > {depth}")
    assert digest(tab) == preset(NAME).digest


def test_the_picture_follows_a_probe_that_is_dragged(page):
    tab = page("?design=default")
    tab.wait_for_function(FULL, timeout=PICTURE_MS)
    tab.evaluate(FOLLOW)
    box = tab.locator("#pictures").bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    tab.mouse.move(*middle)
    tab.mouse.down()
    for step in range(30):
        tab.mouse.move(middle[0] + 4 * step, middle[1] - 2 * step)
        tab.wait_for_timeout(50)
    during = tab.evaluate("followed.slice()")
    assert float(tab.get_by_label("x (mm)").input_value()) > 0.3  # numbers follow too
    tab.mouse.up()
    last = "followed.at(-1)?.request === asked.at(-1)"
    tab.wait_for_function(f"asked.length > 20 && {last}", timeout=PICTURE_MS)
    tab.wait_for_function(f"{last} && followed.at(-1).step === 'full light'", timeout=PICTURE_MS)
    numbers = tab.evaluate("followed.map((each) => each.request)")
    assert numbers == sorted(numbers)
    assert len({each["request"] for each in during}) >= 3
    assert {each["digest"] for each in during} == {preset("default").digest}
    assert not tab.evaluate(STALE)


def test_force_and_depth_beside_a_picture_are_those_of_its_press(page):
    from designlab.app.studio.views.design import DEEPER

    tab = page("?design=default")
    tab.wait_for_function(FULL, timeout=PICTURE_MS)
    depth_mm = float(tab.get_by_label("depth (mm)").input_value())
    first = int(tab.get_attribute("#picture-now", "data-request"))  # of which a fine picture may follow
    tab.evaluate(FOLLOW)
    for _ in range(12):
        tab.evaluate("emitEvent('studio_push', {steps: 1})")
        tab.wait_for_timeout(100)
    tab.wait_for_function("asked.length === 12 && followed.at(-1)?.request === asked[11]", timeout=PICTURE_MS)
    asked, followed = tab.evaluate("[asked, followed]")
    pushes = {request: count for count, request in enumerate([first, *asked])}
    for each in followed:
        told = float(each["facts"].partition("depth ")[2].partition(" mm")[0])
        assert told == pytest.approx(depth_mm * DEEPER ** pushes[each["request"]], abs=0.006)
    assert len({each["facts"] for each in followed}) >= 3


def test_a_broken_rule_is_told_beside_its_field_and_a_wrong_value_too(page):
    tab = page("?design=default")
    turn(tab, "leds.radius_mm", 25)
    wrong = tab.locator('[data-path="leds.radius_mm"] .wrong')
    wrong.filter(has_text="every LED body lies inside the housing").wait_for()
    assert "rule" in tab.inner_text("#banner")
    turn(tab, "leds.radius_mm", "wide")
    wrong.filter(has_text="must be a number").wait_for()
    turn(tab, "leds.radius_mm", -3)
    wrong.filter(has_text="greater than 0").wait_for()
    tab.click("#undo")
    tab.wait_for_function("!document.getElementById('banner').offsetParent")
    assert wrong.inner_text() == ""


def test_why_there_is_no_picture_stays_above_it(page):
    tab = page("?design=default")
    tab.get_by_text("Gel", exact=True).click()
    turn(tab, "elastomer.thickness_mm", 19)
    why = tab.locator("#banner").filter(has_text="z must be above the window")
    why.wait_for(timeout=PICTURE_MS)
    tab.wait_for_timeout(600)  # rules that are broken are told meanwhile
    assert why.is_visible()


def test_a_picture_is_shown_before_anything_else_on_the_page_changes(page):
    tab = page()
    tab.wait_for_function(FULL, timeout=PICTURE_MS)
    tab.get_by_text("LED group red").click()
    tab.locator('[data-path="leds.groups.0.flux_mw"] input').last.wait_for()
    tab.evaluate(ORDER)
    orders = []
    for number in range(12):
        before = digest(tab)
        tab.evaluate("order.length = 0")
        turn(tab, "leds.groups.0.flux_mw", 10 + number)
        new_picture(tab, before)
        tab.wait_for_function("order.includes('page')")  # soon: else scores were told next
        orders.append(tab.evaluate("order")[0])
    # Of a machine so busy that the picture takes long, the page does not wait for it.
    assert "picture" in orders


def test_number_and_rules_follow_a_slider_that_is_held(page):
    tab = page("?design=default")
    knob = tab.locator('[data-path="leds.radius_mm"]')
    box = knob.locator(".q-slider").first.bounding_box()
    y = box["y"] + box["height"] / 2
    tab.mouse.move(box["x"] + box["width"] / 2, y)
    tab.mouse.down()
    banner, shown = tab.locator("#banner"), set()
    for step in range(60):
        tab.mouse.move(box["x"] + box["width"] * (0.7 + 0.25 * (step % 10) / 10), y)
        tab.wait_for_timeout(50)
        shown.add(knob.locator("input").last.input_value())
    told = banner.is_visible() and "every LED body lies inside the housing" in banner.inner_text()
    tab.mouse.up()
    assert told
    assert len(shown) > 5


def test_what_is_refused_stays_while_the_change_before_it_is_shown(page):
    tab = page()
    before, height_mm = digest(tab), preset(NAME).leds.height_mm
    turn(tab, "leds.height_mm", height_mm + 0.7)
    turn(tab, "leds.height_mm", "wide")
    wrong = tab.locator('[data-path="leds.height_mm"] .wrong')
    wrong.filter(has_text="must be a number").wait_for()
    new_picture(tab, before)
    tab.wait_for_timeout(500)  # knobs and rules are shown some time after the picture at most
    assert "must be a number" in wrong.inner_text()
    assert tab.locator('[data-path="leds.height_mm"] input').last.input_value() == "wide"
    turn(tab, "leds.height_mm", height_mm + 0.7)  # as it is
    wrong.filter(has_text="must be").wait_for(state="detached")
    # There and back at once: the value last written counts.
    turn(tab, "leds.height_mm", height_mm + 1.3)
    turn(tab, "leds.height_mm", height_mm)
    tab.wait_for_function(
        f"document.getElementById('picture-now').dataset.digest === {before!r} && !{STALE}",
        timeout=PICTURE_MS,
    )
    assert wrong.inner_text() == ""


def test_a_pinned_design_is_shown_beside_the_present_one_and_a_mixed_one_at_once(page):
    tab = page()
    tab.wait_for_function(FULL, timeout=PICTURE_MS)
    tab.click("#pin")
    tab.wait_for_function("!document.getElementById('picture-pinned').hidden", timeout=PICTURE_MS)
    before = digest(tab)
    tab.get_by_text("LED group red").click()
    turn(tab, "leds.groups.0.flux_mw", preset(NAME).leds.groups[0].flux_mw / 2)
    new_picture(tab, before)
    # Light is only mixed again: the first picture is a full one.
    assert tab.get_attribute("#picture-now", "data-step") == "full light"
    assert tab.get_attribute("#picture-pinned", "data-digest") == before
    shares = []
    for _ in range(2):
        tab.click("#flick")
        shares.append(tab.evaluate("document.getElementById('stage').style.getPropertyValue('--wipe')"))
    assert set(shares) == {"0%", "100%"}


def test_a_design_is_saved_opened_again_and_a_reload_loses_nothing(page, studio):
    tab = page("?design=default&set=leds.height_mm=6.5&probe=star:5&depth_mm=0.3&at=1,2")
    wanted = preset("default").replace({"leds.height_mm": 6.5})
    assert digest(tab) == wanted.digest
    tab.click("#save")
    tab.get_by_label("file name").fill("higher")
    tab.get_by_label("comment").fill("LEDs 0.5 mm higher")
    tab.click("#save-now")
    tab.get_by_text("higher.toml written").wait_for()
    saved = load(studio.folder / "higher.toml")
    assert (saved.digest, saved.parent) == (wanted.digest, "default")
    assert saved.description == "LEDs 0.5 mm higher"
    tab.wait_for_url("**design=higher.toml*")
    tab.reload()
    tab.wait_for_function("document.getElementById('picture-now')?.dataset.digest", timeout=PICTURE_MS)
    assert digest(tab) == wanted.digest


def test_an_led_group_is_added_and_taken_away(page):
    tab = page()
    before = digest(tab)
    tab.get_by_role("button", name="add an LED group").click()
    tab.get_by_text("LED group blue2").wait_for(timeout=PICTURE_MS)
    new_picture(tab, before)
    added = digest(tab)
    assert tab.locator('[data-path="leds.groups.3.azimuth_deg"] input').input_value() == "150"
    tab.wait_for_function(
        "decodeURIComponent(location.search).includes('set=leds.groups=')", timeout=PICTURE_MS
    )
    tab.reload()
    tab.wait_for_function("document.getElementById('picture-now')?.dataset.digest", timeout=PICTURE_MS)
    assert digest(tab) == added
    tab.get_by_text("LED group blue2").click()
    tab.locator('[data-change="remove group 3"]').click()
    new_picture(tab, added)
    assert tab.get_by_text("LED group blue2").count() == 0
    removed = digest(tab)
    assert removed == before
    tab.click("#undo")
    new_picture(tab, removed)
    assert digest(tab) == added


@pytest.mark.faults
def test_names_that_lead_out_or_hold_scripts_do_nothing(page, studio):
    script = "<img src=x onerror=alert(1)>"
    (studio.folder / f"{script}.toml").touch()
    tab = page(f"?design=../../etc/passwd&view={script}")
    tab.get_by_text("lies outside the folder").first.wait_for()
    tab.click("#save")
    for name in ("../out", "a/../../out", script, ""):
        tab.get_by_label("file name").fill(name)
        tab.click("#save-now")
        tab.locator(".q-dialog .wrong").filter(has_text="name: must be").wait_for()
    tab.keyboard.press("Escape")
    assert not list(studio.folder.parent.glob("out*"))
    tab.goto(f"{studio.address}?design={script}&set=parts=%22/etc/passwd%22")
    tab.wait_for_function("document.getElementById('picture-now')?.dataset.digest", timeout=PICTURE_MS)
    assert tab.evaluate("document.querySelectorAll('img[onerror]').length") == 0


def test_two_tabs_are_independent(page):
    first, second = page("?design=default"), page("?design=default")
    before = digest(first)
    turn(first, "leds.tilt_deg", 12)
    new_picture(first, before)
    assert digest(second) == before
    assert "set=" not in second.url


@pytest.mark.full
def test_a_picture_that_is_dropped_gives_its_relief(page):
    tab = page()
    tab.wait_for_function(FULL, timeout=PICTURE_MS)
    taken = base64.b64decode(tab.get_attribute("#picture-now", "src").partition(",")[2])
    tab.get_by_role("tab", name="Reconstruct").click()
    files = tab.locator("#drop-picture input[type=file]")
    files.set_input_files({"name": "press.jpg", "mimeType": "image/jpeg", "buffer": taken})
    tab.get_by_text("depth 0.").wait_for(timeout=PICTURE_MS)
    depth = float(tab.inner_text("#upload-state").split()[1])
    assert depth == pytest.approx(0.5, abs=0.2)
    files.set_input_files({"name": "press.png", "mimeType": "image/png", "buffer": b"no picture"})
    tab.get_by_text("press.png").first.wait_for()
    tab.wait_for_function(
        "document.getElementById('upload-state').textContent.includes('picture.png')", timeout=PICTURE_MS
    )


@pytest.mark.faults
def test_a_second_client_without_the_token_is_refused(tmp_path):
    pytest.importorskip("nicegui", reason="NiceGUI is not installed")
    folder = tmp_path / "mine"
    folder.mkdir()
    studio = Studio(folder, "default", "--host", "0.0.0.0", "--port", "0")
    try:
        address = studio.address.replace("0.0.0.0", "127.0.0.1")
        assert "?token=" in address
        with urllib.request.urlopen(address, timeout=60) as answer:
            assert answer.status == 200
        bare = address.partition("?")[0]
        for path in (
            "",
            "?token=guess",
            "studio/studio.js",
            "_nicegui_ws/socket.io/?EIO=4&transport=polling",
        ):
            with pytest.raises(urllib.error.HTTPError) as refused:
                urllib.request.urlopen(bare + path, timeout=60)
            assert refused.value.code == 403
    finally:
        assert studio.stop() == 0
