"""The studio under random events, while its worker is killed again and again."""

import contextlib
import os
import signal
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

from designlab.app.studio.session import Session
from designlab.app.studio.url_state import address_of
from designlab.sensor.design import preset
from tests.helpers.studio import PICTURE_MS, QUICK_SENSOR, Studio, pages

pytestmark = [
    pytest.mark.renders,
    pytest.mark.slow,
    pytest.mark.faults,
    pytest.mark.skipif(sys.platform != "linux", reason="reads /proc"),
]
GROWTH_MB = {"server": 40, "worker": 150}
"""Most that a process may grow by from event 400 to 1,000. In the server, a leak of each picture sent,
some 100 kB, is 60 MB. In the worker, a leak of each frame made, some megabytes, is a gigabyte; which of its
caches are full differs by some 100 MB from time to time."""

ENDED_S = 10.0  # after which no process may be left
WATCH = """
  window.lies = 0;
  window.looks = 0;
  const look = () => {
    const stage = document.getElementById("stage"), image = document.getElementById("picture-now");
    if (!stage || !image || image.hidden || !image.dataset.digest || !stage.dataset.expected) return;
    window.looks += 1;
    const old = image.dataset.digest !== stage.dataset.expected;
    if (old && !stage.classList.contains("stale")) window.lies += 1;
  };
  new MutationObserver(look).observe(document, { subtree: true, childList: true, attributes: true });
  const frame = () => { look(); requestAnimationFrame(frame); };
  frame();
  window.write = (path, value) => {
    const entry = [...document.querySelectorAll(`[data-path="${path}"] input`)].pop();
    entry.value = value;
    entry.dispatchEvent(new Event("input", { bubbles: true }));
    entry.dispatchEvent(new Event("change", { bubbles: true }));
  };
  window.press = (id) => document.getElementById(id).click();
"""


def random_event(random):
    """Something a hand may do, as a line of the page's script."""
    x, y, share = random.uniform(0.2, 0.8, 3)
    where = f"{{place: [{x:.3f}, {y:.3f}], going_on: {str(share < 0.7).lower()}}}"
    kinds = [
        (8, f"emitEvent('studio_touch', {where})"),
        (3, f"emitEvent('studio_push', {{steps: {random.choice([-1, 1])}}})"),
        (2, "emitEvent('studio_nudge', {steps: [1, 0], large: false})"),
        (6, f"write('leds.groups.0.flux_mw', {10 * share:.3f})"),
        (4, f"write('leds.height_mm', {7 + 4 * share:.2f})"),
        (2, f"write('leds.tilt_deg', {30 * share:.1f})"),
        (1, "write('leds.tilt_deg', 'steep')"),
        (1, "write('leds.radius_mm', -3)"),
        (3, "press('undo')"),
        (2, "press('redo')"),
        (1, "press('pin')"),
        (1, f"studio.wipe({100 * share:.0f})"),
        (1, "document.querySelectorAll('.stage-bar .q-btn-group .q-btn')[Math.round(Math.random())].click()"),
    ]
    weights = np.array([weight for weight, _ in kinds], dtype=float)
    return kinds[random.choice(len(kinds), p=weights / weights.sum())][1]


def memory_mb(pid):
    """Resident memory of a process."""
    told = Path(f"/proc/{pid}/status").read_text()
    return int(told.partition("VmRSS:")[2].split()[0]) / 1024


def the_worker(studio, *, other_than=0):
    """The worker process, once there is one."""
    end = time.monotonic() + PICTURE_MS / 1000
    while time.monotonic() < end:
        found = [pid for pid in studio.children() if pid != other_than]
        if len(found) == 1:
            return found[0]
        time.sleep(0.05)
    raise AssertionError(f"workers: {studio.children()}")


def settled(tab):
    """Wait for the picture of what stands in the address, and compare it with the design that this states."""
    tab.wait_for_function(
        "(() => { const i = document.getElementById('picture-now').dataset;"
        "return i.digest === document.getElementById('stage').dataset.expected && i.step === 'full light'"
        "&& !document.getElementById('stage').classList.contains('stale'); })()",
        timeout=PICTURE_MS,
    )
    tab.wait_for_timeout(1500)
    tab.wait_for_function(
        "/^(fidelity|No scores)/.test(document.getElementById('score-state').textContent)",
        timeout=2 * PICTURE_MS,
    )
    stated = address_of(urlsplit(tab.url).query)
    session = Session(stated.design, preset(stated.design))
    session.restore(stated.edits)
    assert tab.get_attribute("#picture-now", "data-digest") == session.design.digest


def left_behind(folder):
    """What processes run that work in a folder, some seconds after its studio has ended."""
    end = time.monotonic() + ENDED_S
    while found := list(working_in(folder)):
        if time.monotonic() > end:
            break
        time.sleep(0.2)
    return found


def working_in(folder):
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if process.joinpath("cwd").resolve() == folder.resolve():
                yield process.joinpath("cmdline").read_text().replace("\0", " ")


@pytest.mark.parametrize(("events", "kills"), [(60, 2), pytest.param(1000, 20, marks=pytest.mark.full)])
def test_random_events_and_a_worker_that_is_killed_leave_the_page_alive(tmp_path, events, kills, capsys):
    pytest.importorskip("nicegui", reason="NiceGUI is not installed")
    folder = tmp_path / "root"
    folder.mkdir()
    random = np.random.default_rng(0)
    warm = events // 5  # all kills come before: what is measured afterwards is one process
    killed = set(np.linspace(warm // (kills + 1), warm - 1, kills).astype(int).tolist())
    measured = [n - 1 for n in range(2 * warm, events + 1, warm)] if events >= 1000 else [events - 1]
    studio = Studio(folder, QUICK_SENSOR, "--port", "0")
    memory = {}
    try:
        with pages(studio) as opened:
            tab = opened(watch=WATCH)
            tab.get_by_text("LED group red").click()
            tab.wait_for_selector('[data-path="leds.groups.0.flux_mw"] input')
            for number in range(events):
                tab.evaluate(random_event(random))
                tab.wait_for_timeout(float(random.exponential(120)))
                if number in killed:
                    worker = the_worker(studio)
                    os.kill(worker, signal.SIGKILL)
                    tab.get_by_text("was started again").first.wait_for(timeout=PICTURE_MS)
                    assert the_worker(studio, other_than=worker) != worker
                if number in measured:
                    settled(tab)
                    pids = {"server": studio.process.pid, "worker": the_worker(studio)}
                    memory[number] = {name: memory_mb(pid) for name, pid in pids.items()}
            assert tab.evaluate("window.looks") > events
            assert tab.evaluate("window.lies") == 0
    finally:
        status = studio.stop()
    with capsys.disabled():
        print("\nMB after events:", {n: {k: round(v) for k, v in m.items()} for n, m in memory.items()})
    assert status == 0
    assert "Traceback" not in "\n".join(studio.lines)
    assert left_behind(folder) == []
    if events >= 1000:  # caches fill first
        for name, most in GROWTH_MB.items():
            assert memory[events - 1][name] - memory[2 * warm - 1][name] < most, memory
