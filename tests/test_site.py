"""The documentation: short pages, and a site that builds without a warning and asks for nothing outside."""

import re
import subprocess
import sys

import pytest

import designlab
from tests import ROOT
from tests.helpers.browser import WIDTHS, opened

DOCS = ROOT / "docs"
GENERATED = {"presets.md", "reproduction.md"}  # with all of docs/reference
MOST_WORDS = 30_000


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    out = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "sphinx",
            "-W",
            "--keep-going",
            "-q",
            "-b",
            "html",
            "-d",
            out / "state",
            DOCS,
            out,
        ],
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    return out


def test_what_was_written_by_hand_is_short():
    pages = [ROOT / "README.md", *(page for page in DOCS.glob("*.md") if page.name not in GENERATED)]
    words = {page.name: len(page.read_text(encoding="utf-8").split()) for page in pages}
    assert sum(words.values()) <= MOST_WORDS, words


def test_every_page_has_its_place_in_the_site():
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    listed = re.findall(
        r"^([\w/-]+)$", "\n".join(re.findall(r"```{toctree}(.*?)```", index, re.DOTALL)), re.MULTILINE
    )
    pages = {page.relative_to(DOCS).with_suffix("").as_posix() for page in DOCS.rglob("*.md")}
    assert set(listed) == pages - {"index"}


@pytest.mark.slow
def test_docstrings_of_every_public_name_are_in_the_site(site):
    told = (site / "reference" / "docstrings.html").read_text(encoding="utf-8")
    for name in designlab.__all__:
        assert f'id="designlab.{name}"' in told, name


@pytest.mark.slow
def test_pages_ask_for_nothing_outside_fit_their_window_and_filter_their_tables(site):
    with opened() as browser:
        page = browser.new_page()
        asked = []
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: asked.append(f"error: {error}"))
        for name in (
            "index",
            "tutorial",
            "how-it-works",
            "validation",
            "reference/design",
            "reference/docstrings",
        ):
            page.goto((site / f"{name}.html").as_uri())
            for width in WIDTHS:
                page.set_viewport_size({"width": width, "height": 900})
                assert page.evaluate("document.documentElement.scrollWidth") <= width, (name, width)
        assert [url for url in asked if not url.startswith(("file:", "data:"))] == []
        page.goto((site / "reference" / "design.html").as_uri())
        page.locator("input.filter").fill("photo-electrons")
        rows = page.locator("article tbody tr")
        assert [row.is_visible() for row in rows.all()].count(True) == 1
