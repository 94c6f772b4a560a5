"""A studio in a process of its own, as the command line starts it, and pages of it in a browser."""

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from designlab.core.images import write_image
from tests import ROOT
from tests.helpers.browser import opened
from tests.helpers.studies import make, run

PROGRAM = """
import sys
from designlab.app.cli import main
if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
"""
QUICK_SENSOR = "gelsight-2020-flat"  # in air
DIAGNOSIS = ROOT / "tests" / "regression" / "written_before" / "diagnosis"
MEASUREMENT = f"""
name = "made up"
sensor = "{QUICK_SENSOR}"
response = "linear"
[[frame]]
file = "background.exr"
kind = "background"
[[frame]]
file = "press.exr"
kind = "press"
probe = "sphere:4.0"
depth_mm = 0.6
centre_mm = [1.0, -1.0]
"""
START_S, PICTURE_MS = 120, 120_000
SCREEN = {"width": 1280, "height": 800}
FULL = "document.getElementById('picture-now')?.dataset.step?.endsWith('full light')"


class Studio:
    """A running studio: its address, its process, and what it says."""

    def __init__(self, folder, *arguments):
        program = folder.parent / f"{folder.name}-program.py"
        program.write_text(PROGRAM)
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        self.folder = folder
        self.process = subprocess.Popen(
            [sys.executable, program, "studio", *arguments],
            cwd=folder,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.lines = []
        self._said = threading.Condition()
        threading.Thread(target=self._listen, daemon=True).start()
        with self._said:
            assert self._said.wait_for(lambda: self.address is not None, START_S), self.lines
        self.wait_until_it_answers()

    @property
    def address(self):
        found = re.search(r"http://\S+", "\n".join(self.lines))
        return found and found[0]

    def wait_until_it_answers(self):
        import urllib.error
        import urllib.request

        end = time.monotonic() + START_S
        while time.monotonic() < end:
            try:
                urllib.request.urlopen(self.address.replace("0.0.0.0", "127.0.0.1"), timeout=5).close()
                return
            except urllib.error.HTTPError:
                return
            except OSError:
                time.sleep(0.2)
        raise AssertionError(f"no answer: {self.lines}")

    def children(self):
        """Worker processes that it has started, by whichever of its threads."""
        threads = Path(f"/proc/{self.process.pid}/task")
        found = [child for file in threads.glob("*/children") for child in file.read_text().split()]
        return [int(child) for child in found if "spawn_main" in Path(f"/proc/{child}/cmdline").read_text()]

    def stop(self):
        self.process.send_signal(signal.SIGINT)
        try:
            return self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()

    def _listen(self):
        for line in self.process.stderr:
            with self._said:
                self.lines.append(line.strip())
                self._said.notify()


def fill(folder, background, press):
    """Put a finished study, a diagnosis and its measurement, of two pictures, into a folder."""
    run(make(trials=4), folder / "study")
    shutil.copytree(DIAGNOSIS, folder / "diagnosis")
    measurement = folder / "measurement"
    measurement.mkdir()
    (measurement / "measurement.toml").write_text(MEASUREMENT)
    for name, image in (("background", background), ("press", press)):
        write_image(measurement / f"{name}.exr", np.asarray(image, dtype=np.float32))


@contextmanager
def pages(studio):
    """Gives a function that opens a page of the studio; at the end none may have complained."""
    faults = []
    with opened() as browser:

        def page(query="", *, picture=True, watch="", **more):
            found = browser.new_page(**{"viewport": SCREEN, **more})
            if watch:
                found.add_init_script(watch)
            found.on("console", lambda said: faults.append(said.text) if said.type == "error" else None)
            found.on("pageerror", lambda error: faults.append(str(error)))
            found.on("dialog", lambda dialog: faults.append(dialog.message))
            found.on(
                "request",
                lambda asked: (
                    None
                    if asked.url.startswith((studio.address, "data:", "blob:"))
                    else faults.append(f"outside: {asked.url[:200]}")
                ),
            )
            found.goto(studio.address + query)
            if picture:
                found.wait_for_function(
                    "document.getElementById('picture-now')?.dataset.digest", timeout=PICTURE_MS
                )
            return found

        yield page
    assert faults == [], faults
