"""The page about two designs: which is better, in what, by how much, and where nothing is seen."""

from types import SimpleNamespace

import pytest

from designlab.evaluation.paired_comparison import Difference
from designlab.report.comparison import NO_DIFFERENCE, comparison_report, verdict
from tests.helpers.browser import faults, opened
from tests.report.test_pages import PIXEL, check, words


@pytest.mark.parametrize(
    ("name", "value", "least", "better"),
    [
        ("uniformity_u0", 0.2, 0.1, "second"),
        ("uniformity_u0", -0.2, 0.1, "first"),
        ("uniformity_u0", 0.2, 0.3, NO_DIFFERENCE),
        ("height_rmse_um", 5.0, 2.0, "first"),  # a larger error is worse
        ("height_rmse_um", -5.0, 2.0, "second"),
        ("press_depth_mm", 0.3, 0.1, "differs"),  # neither deeper nor shallower is better
    ],
)
def test_the_better_design_is_told_by_the_way_a_score_is_better(name, value, least, better):
    assert verdict(name, Difference(value, least / 2, least, "1")) == better


def fake(design, u0, rmse):
    scores = {
        "uniformity_u0": SimpleNamespace(value=u0, se=0.01, unit="1"),
        "height_rmse_um": SimpleNamespace(value=rmse, se=1.0, unit="um"),
        "coverage": SimpleNamespace(value=1.0, se=0.0, unit="1"),
    }
    plan = SimpleNamespace(text=lambda: "0.8 mm deep")
    return SimpleNamespace(
        design=design, scores=scores, press_plan=plan, fidelity="fast", seed=1, made_from="preset default"
    )


def test_the_page_says_who_is_better_in_what_and_links_to_both(tmp_path):
    folders = {place: tmp_path / place for place in ("first", "second")}
    for folder in folders.values():
        folder.mkdir()
        (folder / "background.png").write_bytes(PIXEL)
    scores = {"first": fake("flat", 0.31, 24.0), "second": fake("high", 0.49, 24.5)}
    found = {
        "uniformity_u0": Difference(0.18, 0.015, 0.04, "1"),
        "height_rmse_um": Difference(0.5, 1.4, 3.5, "um"),
        "coverage": Difference(0.0, 0.0, 0.0, "1"),
    }
    page = comparison_report(scores, found, folders, tmp_path / "report.html").read_text("utf-8")
    shown = words(page.replace('href="first/report.html"', "").replace('href="second/report.html"', ""))
    assert page.count('href="first/report.html"') == page.count('href="second/report.html"') == 1
    assert "high is better in uniformity U0 by 0.180 (0.140 to 0.220)." in shown
    assert "In 1 of 2 main scores no difference is seen." in shown
    assert "0.310 ± 0.010 0.490 ± 0.010 +0.180 (+0.140 to +0.220) high better" in shown
    assert "24.0 ± 1.0 24.5 ± 1.0 +0.5 (-3.0 to +4.0) no difference seen" in shown
    (_, _, large, _) = check(page.replace('"first/', '"data:').replace('"second/', '"data:')).images
    assert large["alt"] == "flat: untouched gel"


@pytest.mark.slow
def test_the_page_holds_in_a_browser(tmp_path):
    test_the_page_says_who_is_better_in_what_and_links_to_both(tmp_path)
    for place in ("first", "second"):
        (tmp_path / place / "report.html").write_text("<p>evaluation</p>")
    with opened() as browser:
        assert faults(browser, tmp_path / "report.html") == []
