"""The public names: as a notebook types them, as help shows them, and as docs/reference/api.md lists them."""

import ast
import inspect
import pydoc
import re
import subprocess
import sys
from pathlib import Path

import pytest

import designlab
from tests import ROOT

API = (ROOT / "docs" / "reference" / "api.md").read_text(encoding="utf-8")
UNITS = {"_mm": "mm", "_deg": "deg"}

APP = Path(designlab.__file__).parent / "app"
PROVE = ("cli/gap.py", "cli/reproduce.py", "demo/run.py")
"""What generates measurements, or runs the proof of the tool, where it is asked to."""


def sections(name):
    """Sections of a docstring by title; the text before them has none."""
    title, found = "", {"": []}
    lines = inspect.getdoc(getattr(designlab, name)).splitlines()
    for line, below in zip(lines, [*lines[1:], ""], strict=True):
        if below and set(below) == {"-"}:
            title, found[line] = line, []
        elif not line or set(line) != {"-"}:
            found[title].append(line)
    return {title: "\n".join(lines) for title, lines in found.items()}


def described(text):
    """Description of each name in a section of parameters; names before a comma share theirs."""
    entries = re.findall(r"^(\w[\w, ]*?)(?: :.*)?\n((?: +.+\n?|\n)*)", text, re.MULTILINE)
    return {name: meaning for names, meaning in entries for name in names.split(", ")}


def test_dir_gives_the_public_names_and_no_other():
    assert dir(designlab) == sorted(designlab.__all__) == list(designlab.__all__)
    for name in designlab.__all__:
        assert callable(getattr(designlab, name)), name


def test_help_shows_every_public_name():
    shown = pydoc.plain(pydoc.render_doc(designlab))
    for name in designlab.__all__:
        assert re.search(rf"^    (class )?{name}\(", shown, re.MULTILINE), name


def test_no_row_names_anything_else():
    assert re.findall(r"^\| `(\w+)`", API, re.MULTILINE) == designlab.__all__


@pytest.mark.parametrize("name", designlab.__all__)
def test_docstrings_say_parameters_units_results_and_errors(name):
    found = sections(name)
    assert re.match(r"[A-Z].*\.$", found[""].strip(), re.DOTALL)
    meanings = described(found.get("Parameters") or found["Attributes"])
    for parameter in inspect.signature(getattr(designlab, name)).parameters:
        assert parameter in meanings
        for ending, unit in UNITS.items():
            if parameter.endswith(ending):
                assert unit in meanings[parameter], parameter
    if inspect.isfunction(getattr(designlab, name)):
        assert found["Returns"].strip()
        assert found["Raises"].strip()


@pytest.mark.slow
def test_functions_are_not_hidden_by_modules_of_the_same_name():
    program = (
        "import designlab, designlab.simulation.simulator, designlab.evaluation.evaluate;"
        "from designlab import render, evaluate;"
        "assert callable(designlab.render) and callable(designlab.evaluate) and render is designlab.render"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_importing_the_package_loads_nothing_heavy():
    program = (
        "import sys, designlab, designlab.app.cli;"
        "heavy = {'numpy', 'pydantic', 'scipy', 'mitsuba', 'cadquery', 'optuna'} & set(sys.modules);"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


@pytest.mark.slow
def test_the_product_loads_nothing_of_its_proof():
    """What evaluates, renders, exports, calibrates, searches and diagnoses, as far as it loads at once."""
    modules = [f"designlab.app.cli.{path.stem}" for path in (APP / "cli").glob("[a-z]*.py")]
    modules.append("designlab.inference.diagnosis.diagnose")
    program = (
        "import importlib, sys, designlab;"
        "[getattr(designlab, name) for name in designlab.__all__];"
        f"[importlib.import_module(name) for name in {modules}];"
        "proof = [name for name in sys.modules if name.startswith('designlab.validation')];"
        "assert not proof, proof"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_only_commands_that_prove_import_the_proof_where_they_run():
    importers = {
        path.relative_to(APP).as_posix()
        for path in APP.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("designlab.validation")
    }
    assert importers == set(PROVE)
