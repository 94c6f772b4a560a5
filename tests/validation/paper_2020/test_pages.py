"""The page and the Markdown about a reproduction, from figures that no experiment made."""

import html.parser
import json
import re

import pytest

from designlab.report.page import rounded
from designlab.validation.paper_2020 import comparison, tables
from designlab.validation.paper_2020.content import Illustration, Table, sections
from designlab.validation.paper_2020.markdown import markdown_page
from designlab.validation.paper_2020.page import html_page

FLAT = "gelsight-2020-flat"


class Tables(html.parser.HTMLParser):
    """Cells of every table of a page, and its tags, which must match."""

    def __init__(self, text):
        super().__init__()
        self.tables, self.open, self.images, self.words = [], [], 0, []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "link", "img", "br"):
            self.open.append(tag)
        self.images += tag == "img"
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)
        if "td" in self.open or "th" in self.open:
            self.tables[-1][-1][-1] += data


def rows_of(result):
    return {row.name: row for row in comparison.comparison(result["stages"])}


def test_both_pages_have_every_row_of_every_table(result, tmp_path):
    content = sections(result, tmp_path)
    shown = [block for part in content for block in part.blocks if isinstance(block, Table)]
    page = Tables(html_page(result, content))
    text = markdown_page(result, content)
    written = re.findall(r"(?:^\|.*\n?)+", text, re.MULTILINE)
    assert len(page.tables) == len(written) == len(shown) == 10
    for block, cells, lines in zip(shown, page.tables, written, strict=True):
        assert len(cells) == len(block.rows) + 1
        assert len(lines.splitlines()) == len(block.rows) + 2
        for line in lines.splitlines():
            assert len(re.findall(r"(?<!\\)\|", line)) == len(block.columns) + 1
        for row, own in zip(block.rows, cells[1:], strict=True):
            assert own[0] == str(row[block.columns[0].key])
    for part in content:
        assert f"## {part.title}" in text
        assert part.title in page.words


def test_rows_name_the_papers_figures(result):
    rows = rows_of(result)
    assert rows["MSE, mean of pictures"].paper == "0.001710"
    assert rows["SNR"].paper == "6.72 dB"
    assert rows["SNR"].ours == "flat 30.25 dB; dome 30.25 dB"
    assert [rows[name].paper for name in ("SMAPE", "SSIM")] == ["0.47", "0.80"]
    assert rows["SSIM, directional and diffuse"].paper == "0.42"
    assert rows["SSIM, directional and Phong"].paper == "0.40"
    assert "477.44" in rows["SNR, directional and Phong"].why
    assert (
        rows["Radiance of the lights"].paper == "R [5.23, 0.0, 0.0]; G [0.17, 6.73, 0.0]; B [0.0, 0.0, 6.83]"
    )
    assert (
        "3 % of what the green one gets of green light (paper: 2.526 %)"
        in rows["Radiance of the lights"].ours
    )
    assert rows["Time, 600 x 600, 8 samples"].paper == "95 ms (RTX 2080 Ti)"
    assert not any("64 x 64" in name for name in rows), "the paper has no such picture"
    assert all(row.why for row in rows.values())


def test_targets_are_met_or_not(result):
    rows = rows_of(result)
    met = {name: row.met for name, row in rows.items() if row.target}
    assert met == {
        "Radiance of the lights": "no",
        "Registration of presses": "yes",
        "Uncertainty": "yes",
        "Light probe": "yes",
    }
    result["stages"]["recovery"]["errors"]["y_mm"]["largest"] = 0.06
    result["stages"]["recovery"]["covered"]["share"] = 0.995
    result["stages"]["probe"]["strips"][0]["solid_angle_ratio"] = 0.97
    assert [rows_of(result)[name].met for name in met] == ["no"] * 4
    table = {row["number"]: row for row in tables.recovery(result["stages"]["recovery"])}
    product = table["light times reflectance"]
    assert (product["largest"], product["target"], product["met"]) == (1.23, 1.0, "in the median")
    assert table["y of a press"]["met"] == "in the median"
    assert "target" not in table["reflectance"]
    coverage = tables.coverage(result["stages"]["recovery"])
    assert [row["met"] for row in coverage] == ["no", "no"]


def test_margins_are_differences_in_db_for_every_data_set_and_channel(result):
    accuracy = result["stages"]["accuracy"]
    rows = tables.margins(accuracy)
    assert [(row["sensor"], row["dataset"]) for row in rows[::4]] == [
        ("flat", "1"),
        ("flat", "2"),
        ("flat", "both"),
        ("dome", "1"),
    ]
    for row in rows:
        assert row["snr_db directional, diffuse"] == pytest.approx(12.0)
        assert row["structure_snr_db directional, Phong"] == pytest.approx(10.5)
    green = accuracy["sensors"][FLAT]["models"]["directional, diffuse"]["held_out"]["channels"]["G"]
    green["snr_db"] += 3.0
    text = tables.headline(FLAT, accuracy["sensors"][FLAT])
    assert "+12.0 dB over directional, diffuse (least in channel G, +9.0 dB" in text
    assert len(tables.accuracy(accuracy, channels=True)) == 3 * len(tables.accuracy(accuracy, channels=False))


def test_sentences_on_failures_name_the_largest_share(result):
    (first, *_) = tables.failures(result["stages"]["accuracy"])
    assert first.startswith(f"Flat gel, directional, diffuse: {rounded(10**1.2)} times the squared error")
    assert "most of it (60 %) in a smooth field" in first
    for row in tables.error_shares(result["stages"]["accuracy"]):
        assert row["smooth"] + row["edges"] + row["rest"] == pytest.approx(100)


def test_a_constant_picture_is_spoken_of_with_numbers_where_there_are_some(result, tmp_path):
    text = markdown_page(result, sections(result, tmp_path))
    assert "a constant has an SNR of 10.0 dB and an SSIM of 0.54" in text
    result["stages"]["real"] = {"left_out": "left out: no folder"}
    text = markdown_page(result, sections(result, tmp_path))
    assert "a constant has" not in text
    assert "Left out: no folder." in text


def test_pictures_that_are_there_are_shown_in_the_page_alone(result, tmp_path):
    from PIL import Image

    for name in ("probe/light-map.png", "real/residual.png", "accuracy/flat/comparison.png"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (4, 4)).save(tmp_path / name)
    result["stages"]["accuracy"]["sensors"][FLAT]["pictures"] = {"comparison": "flat/comparison.png"}
    content = sections(result, tmp_path)
    assert sum(isinstance(block, Illustration) for part in content for block in part.blocks) == 3
    page = html_page(result, content)
    assert Tables(page).images == 3
    assert str(tmp_path) not in page
    assert "![" not in markdown_page(result, content)


def test_hostile_names_are_escaped_and_the_reduced_size_says_so(result, tmp_path):
    result["size"] = "reduced"
    page = html_page(result, sections(result, tmp_path))
    assert "<fast>" not in page
    assert "Quote the figures of the full size." in page
    assert json.loads(json.dumps(result)) == result
