"""The tutorial: its own commands and code, one after the other, and its pages in a browser."""

import re
import shlex

import pytest

from designlab.app import cli
from tests import ROOT
from tests.helpers.browser import faults, opened

TUTORIAL = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```$", TUTORIAL, re.DOTALL | re.MULTILINE)
IN_AIR = "gelsight-2020-flat"  # rehearsed in half a minute, a sensor with a core in several
SMALLER = {
    "--budget 4min": "--trials 2 --no-confirm",
    "--columns 96": "--columns 64",
    "gap plant --design my-sensor/design.toml": f"gap plant --design {IN_AIR}",
    "gap diagnose measurement --model my-sensor/design.toml": f"gap diagnose measurement --model {IN_AIR}",
}
PAGES = ("first", "compared", "compared/first", "compared/second", "study", "diagnosis")


def steps():
    """Commands of designlab and Python code, in the order of the tutorial."""
    for kind, block in BLOCKS:
        if kind == "python":
            yield kind, block
        elif not kind:
            yield from (("command", line) for line in block.splitlines() if line.startswith("designlab "))


def test_the_tutorial_goes_all_the_way():
    verbs = [shlex.split(step)[1] for kind, step in steps() if kind == "command"]
    assert verbs == ["doctor", "init", "evaluate", "evaluate", "study", "study", "export", "gap", "gap"]
    for long in SMALLER:
        assert long in TUTORIAL


@pytest.mark.renders
@pytest.mark.slow
def test_the_tutorial_works_as_written_and_its_pages_hold(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    said = ""
    for kind, step in steps():
        if kind == "python":
            exec(compile(step, "tutorial", "exec"), {})
            continue
        for long, short in SMALLER.items():
            step = step.replace(long, short)
        assert cli.main(shlex.split(step)[1:]) == 0, step
        said = capsys.readouterr().out
    assert "verdict: named" in said
    assert "colour_mixing" in said
    assert (tmp_path / "my-sensor" / "low-leds.toml").is_file()
    assert list((tmp_path / "parts" / "stl").glob("*sphere*.stl"))
    with opened() as browser:  # skipped here, with the reason, where there is none
        for name in PAGES:
            assert faults(browser, tmp_path / name / "report.html") == [], name
