"""What README and docs promise is there: links, commands, and the script, which runs."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from designlab.cli import arguments

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_example_commands_exist(page):
    """Lines of code blocks that call designlab, without the explanation to their right, are valid calls."""
    blocks = re.findall(r"^```\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    for block in blocks:
        for call in re.findall(r"^designlab (.+?)(?: {2,}.*)?$", block, re.MULTILINE):
            arguments.parse(shlex.split(call))


def test_every_command_of_the_table_exists():
    calls = re.findall(r"^\| `designlab (\S+)", README, re.MULTILINE)
    assert {"evaluate", "render", "compare", "export", "study", "gap"} <= set(calls)
    listed = arguments.parser().format_help()
    for call in calls:
        assert re.search(rf"^    {call}\b", listed, re.MULTILINE)


def test_folders_of_the_tree_exist():
    tree = README.split("## Where things are")[1].split("```")[1]
    names = re.findall(r"^( *)(\S+/)", tree, re.MULTILINE)
    assert len(names) >= 6
    for indent, name in names:
        assert (ROOT / ("designlab" if indent else "") / name).is_dir(), name


def test_pictures_are_small():
    for picture in (ROOT / "docs" / "images").iterdir():
        assert picture.stat().st_size < 300_000


@pytest.mark.slow
def test_the_script_runs(tmp_path):
    (script,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len([line for line in script.splitlines() if line.strip()]) <= 12
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stderr
    for word in ("uniformity", "normal error", "deg", "radiance", "leds.tilt_deg"):
        assert word in done.stdout
    assert list(tmp_path.iterdir()) == []
