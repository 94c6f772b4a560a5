"""Pages: complete in one file, escaped, with rounded numbers, units and working figures."""

import base64
import gzip
import html.parser
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

from designlab.evaluation.illumination_scores import SCORES
from designlab.optimization.study import Parameter, Study, run_study
from designlab.report.evaluation import evaluation_report
from designlab.report.page import (
    Column,
    Lead,
    Section,
    facts,
    gallery,
    label,
    link,
    listed,
    page,
    paragraph,
    picture,
    plotly_figure,
    prose,
    rounded,
    table,
)
from designlab.report.study import study_report
from designlab.report.yardsticks import ALARMS, HEADLINES, YARDSTICKS
from designlab.sensor.design import preset
from tests.helpers.studies import BARE

VOID = {"meta", "link", "img", "br", "hr", "input"}


class Checker(html.parser.HTMLParser):
    """Collects what a page refers to and holds, and refuses tags that do not match."""

    def __init__(self):
        super().__init__()
        self.open, self.references, self.text, self.images = [], [], [], []

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name in ("src", "href"):
                self.references.append(value)
        if tag == "img":
            self.images.append(dict(attrs))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "script" not in self.open and "style" not in self.open:
            self.text.append(data)


def check(text):
    checker = Checker()
    checker.feed(text)
    assert checker.open == []
    assert all(reference.startswith("data:") for reference in checker.references)
    return checker


def words(text):
    return " ".join(" ".join(check(text).text).split())


PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)


@pytest.mark.parametrize(
    ("value", "se", "text"),
    [
        (12.3456, 0.0213, "12.346 ± 0.021"),
        (12.3456, 4.2, "12.3 ± 4.2"),
        (1234.5, 42.0, "1234 ± 42"),
        (0.98765, None, "0.9877"),
        (0.98765, 0.0, "0.9877"),
        (123456.0, None, "123456"),
        (math.nan, 0.1, "–"),
    ],
)
def test_numbers_are_rounded_to_their_standard_error(value, se, text):
    assert rounded(value, se) == text


@pytest.mark.parametrize(
    ("text", "html"),
    [
        ("see `designlab info`", "see <code>designlab info</code>"),
        ("off by 12 um, not 3 umbrellas", "off by 12 µm, not 3 umbrellas"),
        ("`a 5 um` and 5 um", "<code>a 5 um</code> and 5 µm"),
        ("one ` alone, 2 um <b>", "one ` alone, 2 µm &lt;b&gt;"),
        ("`a` and ` alone", "<code>a</code> and ` alone"),
    ],
)
def test_messages_are_set_as_prose(text, html):
    assert prose(text) == html
    assert html in paragraph(text)
    assert f"<li>{html}</li>" in listed([text])


def test_labels_carry_the_unit_in_brackets():
    assert label("normal_error_median_deg", "deg") == "normal error median (deg)"
    assert label("height_mae_um", "um") == "height mae (um)"
    assert label("leds.tilt_deg", "deg") == "leds.tilt (deg)"
    assert label("leds.groups.0.flux_mw", "mW") == "leds.groups.0.flux (mW)"
    assert label("uniformity_u0", "1") == "uniformity u0"


def test_a_page_needs_no_other_file_and_escapes_what_it_shows():
    hostile = "<script>alert('1')</script> & \"x\""
    rows = [{"name": hostile, "value": 1.25, "error": 0.1}, {"name": "b", "value": np.float64("nan")}]
    text = page(
        hostile,
        [
            Section(hostile, (paragraph(hostile), facts({hostile: hostile}))),
            Section(
                "Table", (table(rows, ["name", Column("value", hostile, "mm", "error")], caption=hostile),)
            ),
            Section("Picture", (gallery([picture(PIXEL, hostile)]),)),
            Section("Empty", ()),
        ],
        subtitle=hostile,
        lead=Lead(hostile, (paragraph(hostile),), None, hostile, hostile, hostile, "good"),
        links=[link(f"data:{hostile}", hostile)],
    )
    assert "<script>alert" not in text
    assert text.count("<script") == 1  # what opens pictures large
    checker = check(text)
    assert "Empty" not in " ".join(checker.text)
    assert "1.25" in words(text)
    assert "± 0.10" in words(text)
    (image,) = checker.images
    assert base64.b64decode(image["src"].partition(",")[2]) == PIXEL
    assert image["alt"] == hostile


@pytest.mark.slow
def test_the_script_of_figures_is_in_the_page_once():
    import plotly.graph_objects as go
    from plotly.offline import get_plotlyjs

    figures = [plotly_figure(go.Figure(go.Scatter(x=[1, 2], y=[3, 4])), f"figure {k}") for k in range(2)]
    with_figures = page("a", [Section("Figures", tuple(figures))])
    packed = re.findall(r'atob\("([^"]+)"\)', with_figures)
    assert len(packed) == 1
    assert gzip.decompress(base64.b64decode(packed[0])).decode() == get_plotlyjs()
    assert 1e6 < len(with_figures) < 3e6
    assert with_figures.count('<script type="text/figure">') == 2
    assert len(page("a", [Section("Text", (paragraph("b"),))])) < 1e4
    assert not re.search(r"<script[^>]*\ssrc=", with_figures)


def test_pictures_of_unknown_kind_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"scan\.exr: a page takes pictures as \.png"):
        picture(tmp_path / "scan.exr", "")


def closed_form(design, *, fidelity, seed):
    tilt = design.leds.tilt_deg
    return SimpleNamespace(
        scores={
            "uniformity_u0": SimpleNamespace(
                value=math.cos(math.radians(tilt)), se=0.01, bias_bound=None, unit="1"
            ),
            "normal_error_median_deg": SimpleNamespace(
                value=1 + abs(tilt - 25) / 50, se=0.05, bias_bound=None, unit="deg"
            ),
        }
    )


def make(**changes):
    content = {
        "name": "ring & co",
        "base": preset("gelsight-2020-flat"),
        "parameters": {
            "leds.tilt_deg": Parameter(low=-20, high=60),
            "leds.height_mm": Parameter(low=1, high=14),
            "optics.gelcore_material": Parameter(choices=("acrylic", "resin-2020")),
        },
        "trials": 14,
        **BARE,
    }
    return Study.model_validate(content | changes)


@pytest.mark.slow
def test_the_page_of_a_study_shows_its_front_its_start_and_its_rejections(tmp_path):
    results = run_study(make(), out=tmp_path, progress=False, evaluator=closed_form)
    number = int(results.picks.iloc[0]["trial"])
    (tmp_path / "trials" / f"{number:04d}" / "view.png").write_bytes(PIXEL)
    path = study_report(tmp_path, pictures=False)
    assert path == tmp_path / "report.html"
    text = path.read_text(encoding="utf-8")
    shown = words(text)
    assert "Study: ring & co" in shown
    assert "14 designs evaluated, starting from gelsight-2020-flat" in shown
    assert f"On the Pareto front: {len(results.pareto)} of 14 evaluated designs." in shown
    assert f"trial {number} best uniformity U0" in shown
    assert "leds.tilt (deg)" in shown
    assert f"± {0.01:.3f}" in shown
    (image,) = check(text).images
    assert image["alt"] == f"trial {number}: view"
    for rule, count in results.rejections().items():
        assert re.search(rf"{rule} .*? {count}", shown)
    best = results.frame["uniformity_u0"].max()
    assert rounded(best, 0.01).partition(" ")[0] in shown


@pytest.mark.slow
def test_a_study_with_one_objective_or_none_evaluated_has_a_page(tmp_path):
    study = make(objectives={"uniformity_u0": "maximise"}, trials=3)
    results = run_study(study, out=tmp_path / "one", progress=False, evaluator=closed_form)
    assert "uniformity U0" in words(
        study_report(results, tmp_path / "one.html", pictures=False).read_text("utf-8")
    )

    def stop(design, *, fidelity, seed):
        raise KeyError("stop")

    with pytest.raises(KeyError, match="stop"):
        run_study(study, out=tmp_path / "none", progress=False, evaluator=stop)
    shown = words(study_report(tmp_path / "none", pictures=False).read_text("utf-8"))
    assert "No design has been evaluated yet." in shown


def test_the_page_of_an_evaluation_shows_scores_and_room_left(tmp_path):
    (tmp_path / "a.png").write_bytes(PIXEL)
    score = {
        "design": "mine",
        "fidelity": "fast",
        "seed": 3,
        "scores": {"height_mae_um": {"value": 12.34, "se": 1.2, "bias_bound": None, "unit": "um"}},
        "margins": {"minimum_gel": -1.5, "minimum_wall": 0.25},
        "seconds": {"test presses": 12.0},
    }
    path = evaluation_report(score, tmp_path / "page.html", pictures={tmp_path / "a.png": "a view"})
    shown = words(path.read_text("utf-8"))
    assert "Design: mine" in shown
    assert "height error, mean size (µm) 12.3 ± 1.2" in shown
    assert "minimum_wall housing walls are at least 0.8 mm thick -0.25 broken" in shown
    assert "minimum_gel the gel is at least 0.5 mm thick 1.5 kept" in shown
    assert "a view" in shown


def estimate(value, se=0.01, unit="1"):
    return {"value": value, "se": se, "bias_bound": None, "unit": unit}


def test_the_page_of_an_evaluation_starts_with_a_verdict_and_the_worst_place(tmp_path):
    names = ("background", "information", "errors", "uniformity", "relief", "sensor")
    for name in (*names, "press-01-sphere", "press-02-star"):
        (tmp_path / f"{name}.png").write_bytes(PIXEL)
    place = {"x_mm": 3.14, "y_mm": -2.0, "reason": "dark", "value_deg": 1.84, "times": 2.0, "detail": ""}
    score = {
        "design": "mine",
        "scores": {
            "normal_error_mean_deg": estimate(3.0, 0.2, "deg"),
            "uniformity_u0": estimate(0.2),
            "dynamic_range_use": estimate(0.251),
            "coverage": estimate(0.9),
            "stray_share": estimate(0.0),
        },
        "groups": {"red": {"u0": estimate(0.2)}, "blue": {"u0": estimate(0.35)}},
        "worst": {
            "gel": place | {"press": None},
            "press": place | {"reason": "shadowed", "detail": "star:6, red", "value_deg": 12.3, "press": 1},
        },
    }
    text = evaluation_report(score, tmp_path / "page.html").read_text("utf-8")
    shown = words(text)
    assert "2 of 4 main scores are good. Poor: uniformity U0, coverage." in shown
    assert shown.index("Main scores") < shown.index("Untouched gel: worst at (3.1, -2.0) mm, dark")
    assert "information limit 1.8 deg, 2.0 times the median" in shown
    assert "Test presses: worst at (3.1, -2.0) mm (star:6, red), shadowed" in shown
    assert "0.251 ± 0.010 good, borderline good at least 0.25, fair 0.125" in shown
    # what is in order is not in the verdict, but among all scores
    assert shown.count("stray light 0.000 ± 0.010 good") == 1
    assert shown.index("stray light") > shown.index("All scores")
    assert "red 0.200 ± 0.010 blue 0.350 ± 0.010" in shown
    assert "Surface normals are off by 3.00 ± 0.20 deg in the mean, on presses" in shown
    captions = [image["alt"] for image in check(text).images]
    assert captions[0].startswith("The press that it feels worst")  # with the answer
    assert captions[1].startswith("What the camera sees")
    assert captions[5:] == [
        "The sensor, cut open",
        "press 02 star: the press with the worst place",
        "press 01 sphere",
    ]


@pytest.mark.parametrize(
    ("name", "value", "se", "verdict"),
    [
        ("uniformity_u0", 0.6, 0.01, "good"),
        ("uniformity_u0", 0.54, 0.005, "fair"),
        ("uniformity_u0", 0.54, 0.02, "fair, borderline"),
        ("uniformity_u0", 0.1, 0.0, "poor"),
        ("height_rmse_um", 20, 1, "good"),
        ("height_rmse_um", 49, 2, "fair, borderline"),
        ("height_rmse_um", 60, 2, "poor"),
        ("uniformity_cv", 0.5, 0.1, ""),
    ],
)
def test_a_yardstick_turns_a_value_into_a_word(name, value, se, verdict):
    assert YARDSTICKS[name].verdict(value, se) == verdict  # U0: 0.55 and 0.3; height: 25 and 50 um


def test_every_main_score_has_a_yardstick():
    assert set(YARDSTICKS) == set(SCORES)
    for name in (*HEADLINES, *ALARMS):
        known = YARDSTICKS[name]
        assert known.good != known.fair
        assert known.reason
