"""The names of the package as a notebook types them."""

import subprocess
import sys

import designlab


def test_every_public_name_is_found():
    for name in designlab.__all__:
        assert callable(getattr(designlab, name)), name


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
