"""Pages as a reader meets them: opened in a real browser, their first screen and their widths measured."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.numbers import unitless

SCREEN = {"width": 1300, "height": 900}
WIDTHS = (400, 800, 1300)
LARGEST_BYTES = 3_000_000
FIRST = (
    ".lead .question",
    ".lead p:not(.question):not(.next)",
    ".lead figure img, .lead .plotly",
    ".lead .next",
)
PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@contextmanager
def opened() -> Iterator[Any]:
    """A browser; the test is skipped, with the reason, where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip("no browser: install chromium (Debian: apt-get install chromium)")
    with playwright.sync_playwright() as session:
        browser = session.chromium.launch(executable_path=program, args=["--no-sandbox"])
        try:
            yield browser
        finally:
            browser.close()


def faults(browser: Any, path: Path) -> list[str]:
    """What is wrong with a page: first screen, units of numbers, widths, links, console, size."""
    found: list[str] = []
    if path.stat().st_size > LARGEST_BYTES:
        found.append(f"{path.stat().st_size} bytes")
    page = browser.new_page(viewport=SCREEN)
    page.on("console", lambda said: found.append(f"console: {said.text}") if said.type == "error" else None)
    page.on("pageerror", lambda error: found.append(f"error: {error}"))
    page.on("request", lambda asked: found.append(f"request: {asked.url}") if _outside(asked.url) else None)
    page.goto(path.as_uri())
    page.wait_for_timeout(1500)
    for selector in FIRST:
        boxes = [box for each in page.query_selector_all(selector) if (box := each.bounding_box())]
        if not boxes:
            found.append(f"first screen: no {selector}")
        elif boxes[0]["y"] + boxes[0]["height"] > SCREEN["height"]:
            found.append(f"first screen: {selector} ends at {boxes[0]['y'] + boxes[0]['height']:.0f} px")
    found += unitless(page)
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": SCREEN["height"]})
        page.wait_for_timeout(200)
        wide = page.evaluate("document.documentElement.scrollWidth")
        if wide > width:
            found.append(f"{wide} px wide in a window of {width}")
    for link in page.query_selector_all("a[href]"):
        target = link.get_attribute("href")
        if not target.startswith(("http", "#", "data:")) and not (path.parent / target).exists():
            found.append(f"dead link: {target}")
    page.close()
    return found


def _outside(url: str) -> bool:
    return not url.startswith(("file:", "data:", "blob:"))
