"""Take the pictures of the studio in README and docs: a design, and two designs compared.

.venv/bin/python scripts/studio_pictures.py        writes docs/images/studio-design.jpg and studio-pinned.jpg
"""

import io
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tests.helpers.studio import FULL, PICTURE_MS, Studio, pages  # noqa: E402  of the checkout

TARGET = ROOT / "docs" / "images"
SENSOR = "default"
SCREEN = {"width": 1280, "height": 760}
QUALITY, MOST_BYTES = 85, 200_000
CHANGED = ('[data-path="leds.height_mm"] input', "4.5")
SCORED = "document.getElementById('score-state').textContent"
DRAWN = "document.getElementById('model-state').textContent.startsWith('drag')"


def ready(tab, scored: str) -> None:
    """Wait for the best picture, the relief, the scores and the drawing."""
    fresh = "!document.querySelector('.stale')"
    for condition in (f"{FULL} && {fresh}", f"{SCORED}.includes({scored!r})", DRAWN, fresh):
        tab.wait_for_function(condition, timeout=2 * PICTURE_MS)
    tab.mouse.move(640, 5)
    tab.wait_for_timeout(3000)


def take(tab, name: str) -> None:
    """Write what the page shows."""
    with Image.open(io.BytesIO(tab.screenshot())) as shown:
        path = TARGET / f"{name}.jpg"
        shown.convert("RGB").save(path, quality=QUALITY, optimize=True)
    if path.stat().st_size > MOST_BYTES:
        raise SystemExit(f"{path.name}: has {path.stat().st_size} bytes, at most {MOST_BYTES} are wanted")


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "root"
        folder.mkdir()
        studio = Studio(folder, SENSOR, "--port", "0")
        try:
            with pages(studio) as opened:
                tab = opened(
                    "?design=default&probe=star:6&depth_mm=0.5&at=1,0.5",
                    viewport=SCREEN,
                    color_scheme="light",
                )
                ready(tab, "fidelity")
                take(tab, "studio-design")
                tab.click("#pin")
                entry = tab.locator(CHANGED[0]).last
                entry.fill(CHANGED[1])
                entry.press("Enter")
                tab.wait_for_function("document.querySelector('.stale')", timeout=PICTURE_MS)
                tab.emulate_media(color_scheme="dark")
                ready(tab, "since the pin")
                take(tab, "studio-pinned")
        finally:
            studio.stop()


if __name__ == "__main__":
    main()
