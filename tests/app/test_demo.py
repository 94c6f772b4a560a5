"""The demo: its stages, its page, and how it goes on after an interruption."""

import html.parser
import json
import re
import time

import pytest

from designlab.app import cli
from designlab.app.demo import Demo
from designlab.app.demo import run as demo
from tests.helpers.browser import faults, opened


class Links(html.parser.HTMLParser):
    """Collects what a page links to and embeds."""

    def __init__(self, text):
        super().__init__()
        self.links, self.pictures = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        if tag == "a":
            self.links.append(attributes["href"])
        if tag == "img":
            self.pictures.append(attributes["src"])


@pytest.fixture
def quick(monkeypatch):
    """Stages that do nothing but tell that they ran."""
    ran = []

    def stage(name):
        def run(state, within):
            assert isinstance(state, Demo)
            ran.append(name)
            for step in range(4):
                within("working", step, 4)
            return {}

        return demo._Step(f"stage {name}", run)

    monkeypatch.setattr(demo, "_STEPS", {name: stage(name) for name in demo._STEPS})
    monkeypatch.setattr(demo, "index_page", lambda *_: "<html></html>")
    return ran


def test_stages_run_in_order_and_progress_only_grows(quick, tmp_path):
    told = []
    demo.demo(tmp_path / "out", progress=lambda what, done, of: told.append((what, done / of)))
    assert quick == list(demo._SECONDS)
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert ("stage gap: working", pytest.approx(0.9, abs=0.1)) in told


def test_a_stage_that_fails_is_named_and_ends_the_demo(quick, tmp_path, monkeypatch, capfd):
    def failing(state, within):
        raise ValueError("the disc is not round")

    monkeypatch.setitem(demo._STEPS, "parts", demo._Step("files to make it", failing))
    monkeypatch.setenv("COLUMNS", "80")
    status = cli.main(["demo", "--out", str(tmp_path / "out")])
    err = capfd.readouterr().err
    assert status == 1
    assert "designlab: demo, files to make it: the disc is not round" in err
    assert quick == ["evaluation"]
    assert not (tmp_path / "out" / "index.html").exists()


def test_folders_of_others_are_left_alone(quick, tmp_path):
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(ValueError, match="must be absent, empty or of an earlier run"):
        demo.demo(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["note.txt"]
    demo.demo(tmp_path / "out", seed=1)
    with pytest.raises(ValueError, match=r"holds a demo with another seed \(seed 1, .*; choose"):
        demo.demo(tmp_path / "out", seed=2)
    assert quick == list(demo._SECONDS)


@pytest.mark.renders
@pytest.mark.slow
@pytest.mark.full  # the tutorial's test walks the same way in every run
def test_the_whole_job_and_what_it_says(tmp_path, monkeypatch, capfd):
    (name,) = demo.HIDDEN
    monkeypatch.setattr(demo, "TRIED", (name, "vignetting", "black_level"))
    monkeypatch.setattr(demo, "TRIALS", 1)
    monkeypatch.delenv(demo.MEASURED_VARIABLE, raising=False)
    out = tmp_path / "out"
    assert cli.main(["demo", "--out", str(out)]) == 0
    said = capfd.readouterr().out
    assert str(out / "index.html") in said
    assert str(out / "parts") in said
    assert demo.MEASURED_VARIABLE in said

    page = Links((out / "index.html").read_text(encoding="utf-8"))
    assert len(page.links) >= 5
    for link in page.links:
        assert (out / link).is_file(), link
    assert len(page.pictures) == 3, "the sensor, its light, and a press"
    assert all(picture.startswith("data:image/") for picture in page.pictures)
    assert list((out / "parts" / "stl").glob("*.stl"))

    start = time.perf_counter()
    assert cli.main(["demo", "--out", str(out), "--json"]) == 0
    again = json.loads(capfd.readouterr().out)["stages"]
    assert time.perf_counter() - start < 20, "nothing is done twice"
    assert again["study"]["trials"]["complete"] == 1
    (effect,) = again["gap"]["effects"]
    assert effect["name"] == name
    for parameter, value in again["gap"]["hidden"][name].items():
        assert effect["parameters"][parameter]["value"] == pytest.approx(value, abs=0.02)
    assert re.search(r"Verdict of the\s+diagnosis: \w+", (out / "index.html").read_text(encoding="utf-8"))

    with opened() as browser:  # skipped here, with the reason, where there is none
        for name in ("index", "evaluation/report", "study/report", "diagnosis/report"):
            assert faults(browser, out / f"{name}.html") == [], name
