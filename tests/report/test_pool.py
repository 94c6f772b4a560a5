"""The page about a pool of planted sets."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.image import imread

from designlab.report.figures import write_figure
from designlab.report.pool import pool_report
from designlab.report.pool_plots import limits_plot, reliability_plot
from designlab.validation.blind import Outcome, Trial, score
from designlab.validation.blind.pool import AIR
from tests.helpers.outcomes import outcome


def small_pool() -> list[Outcome]:
    found = [outcome(Trial("n", AIR[0], 1), verdict="at_floor", sets=[])]
    for k, (strength, first) in enumerate([(0.25, "led_tilt"), (0.5, "vignetting"), (1.0, "vignetting")]):
        trial = Trial(f"s{k}", AIR[0], 2 + k, {"vignetting": strength})
        sets = [[first, "albedo_field"]] if k == 2 else [[first]]
        found += [outcome(trial, verdict="named", sets=sets, confidence=0.5 + 0.1 * k) for _ in range(4)]
    missing = Trial("l", AIR[0], 9, {"led_tilt": 3.0}, without=("led_tilt",))
    return [*found, outcome(missing, verdict="partial", sets=[["banding"]])]


def test_the_page_shows_rates_confidence_limits_and_every_set(tmp_path: Path) -> None:
    scored = score(small_pool())
    text = pool_report(scored, tmp_path / "report.html", title="Pool <x>").read_text(encoding="utf-8")
    assert "Pool &lt;x&gt;" in text
    for words in (
        "the right name first</td><td>66.7%",
        "34.9% to 90.1%",  # Clopper and Pearson's interval of 8 of 12
        "led tilt, not in the catalogue",
        "vignetting 8, led tilt 4",
        "albedo_field",
        "over 13 names",
    ):
        assert words in text, words
    assert text.count("<img") == 2
    assert {path.name for path in tmp_path.iterdir()} == {"report.html", "reliability.png", "limits.png"}
    bare = pool_report(score(small_pool()[:1]), tmp_path / "bare" / "report.html", title="Nothing")
    assert "<img" not in bare.read_text(encoding="utf-8")
    assert "The code changed" not in text
    mixed = [*small_pool(), replace(small_pool()[0], code="76543210dcba")]
    text = pool_report(score(mixed), tmp_path / "report.html", title="Two").read_text(encoding="utf-8")
    assert "2 versions: 0123abcd4567, 76543210dcba" in text


def test_marks_stand_where_the_numbers_say(tmp_path: Path) -> None:
    """Of two bins, one on the line of agreement and one far below it, the drawing tells which."""
    bins = [
        {"confidence": 0.9, "right": r, "low": r - 0.05, "high": r + 0.05, "names": 9} for r in (0.1, 0.9)
    ]
    drawn = [
        imread(write_figure(reliability_plot([b]), tmp_path / f"{k}.png"))[..., :3]
        for k, b in enumerate(bins)
    ]
    rows = [np.mean(np.nonzero(_blue(image))[0]) for image in drawn]
    assert rows[0] - rows[1] > 0.5 * drawn[0].shape[0]
    limits = {
        kind: {"strength": s, "low": low, "high": None, "tried": [(0.25, False, "flat"), (2.0, True, "flat")]}
        for kind, s, low in (("small", 0.3, 0.2), ("large", 1.5, 1.0))
    }
    image = imread(write_figure(limits_plot(limits), tmp_path / "limits.png"))[..., :3]
    rows_, columns = np.nonzero(_blue(image)[60:])  # below the legend
    upper = rows_ < rows_.mean()
    assert columns[upper].min() < columns[~upper].min()  # the smallest limit stands on top


def _blue(image: np.ndarray) -> np.ndarray:
    return (image[..., 2] - image[..., 0]) > 0.3
