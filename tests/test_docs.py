"""What README and docs promise is there: links, commands, fields, designs, and the script, which runs."""

import ast
import contextlib
import functools
import importlib.util
import json
import re
import shlex
import subprocess
import sys
import tomllib

import numpy as np
import pytest
import tomli_w
from PIL import Image

from designlab.app.cli import arguments
from designlab.sensor.camera import Camera, Vignetting
from designlab.sensor.contact import KernelContact, LayerContact
from designlab.sensor.design import Design, dumps, loads, preset, preset_names, preset_text
from designlab.sensor.gel_materials import MATERIALS as GELS
from designlab.sensor.led_catalogue import PARTS
from designlab.sensor.lens import Distortion
from designlab.sensor.optical_constants import MATERIALS
from designlab.sensor.optical_properties import AlbedoImage, Optics
from designlab.sensor.response_curve import Response
from designlab.sensor.spectra import SENSITIVITIES, Sensitivity
from designlab.simulation.effects import CATALOGUE
from geometries.elastomer import Elastomer
from geometries.emission import AngularProfile
from geometries.gelcore import Gelcore
from geometries.housing import Housing
from geometries.leds import LedArray, LedGroup
from tests import ROOT

PAGES = [
    *(ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
]
SCRIPTS = sorted(
    path
    for folder in ("benchmarks", "notebooks", "scripts", "studies", "designlab/app/templates")
    for path in (ROOT / folder).glob("*.*")
    if path.suffix in (".py", ".ipynb")
)
ROOMS = sorted(path.name for path in (ROOT / "designlab").iterdir() if (path / "__init__.py").is_file())
WORDS = r"(?:\.[A-Za-z_]\w*)+"
FOLDERS = ("designlab", "geometries", "tests", "scripts", "benchmarks", "studies", "notebooks", "docs")
REFERENCE = ROOT / "docs" / "reference"
README = (ROOT / "README.md").read_text(encoding="utf-8")
OPTICS = (ROOT / "docs" / "optics.md").read_text(encoding="utf-8")
OWN_PARTS = "# my-parts.toml\n"
BLOCKS = re.findall(r"^```toml\n(.*?)^```", OPTICS, re.DOTALL | re.MULTILINE)
EXAMPLES = [block for block in BLOCKS if not block.startswith(OWN_PARTS)]
KEPT_BY_THE_PROGRAM = {"rows", "columns", "pixels"}
TABLES = {"gelcore", "elastomer", "leds", "housing", "contact", "optics", "camera"}  # of a design
DESCRIBED = (
    ("leds", LedArray),
    ("leds.groups", LedGroup),
    ("leds.profile", AngularProfile),
    ("gelcore", Gelcore),
    ("elastomer", Elastomer),
    ("housing", Housing),
    ("contact", LayerContact),
    ("contact", KernelContact),
    ("optics", Optics),
    ("optics.albedo_image", AlbedoImage),
    ("camera", Camera),
    ("camera.distortion", Distortion),
    ("camera.vignetting", Vignetting),
    ("camera.response", Response),
    ("camera.sensitivity", Sensitivity),
    ("design", Design),
)
IES = """IESNA:LM-63-2002
TILT=NONE
1 1000 1 3 1 1 2 0 0 0 1 1 50
0 45 90
0
8 5 0
"""


def anchors(page):
    """Headings of a page as links name them."""
    for heading in re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE):
        yield re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#]*)#?([^)]*)\)", page.read_text(encoding="utf-8")):
        there = page.parent / target if target else page
        assert there.exists(), target
        if anchor:
            assert anchor in anchors(there), f"{target}#{anchor}"


def named(name):
    """What a dotted name stands for: a module, or something in one."""
    words = name.split(".")
    for size in range(len(words), 0, -1):
        with contextlib.suppress(ModuleNotFoundError):
            module = importlib.import_module(".".join(words[:size]))
            return functools.reduce(getattr, words[size:], module)
    raise AssertionError(name)


def code_of(page):
    """Text of a page without files of earlier commits."""
    return re.sub(r"\b[0-9a-f]{7,40}:\S+", "", page.read_text(encoding="utf-8"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_modules_and_names_exist(page):
    """Names that begin with designlab or geometries; those in code quotes may begin with a room."""
    text = code_of(page)
    whole = re.findall(rf"(?<![\w/.-])((?:designlab|geometries){WORDS})", text)
    inside = re.findall(rf"`((?:{'|'.join(ROOMS)})(?!\.(?:[a-z]+\.)?(?:toml|html|json)`){WORDS})`", text)
    for name in [*whole, *(f"designlab.{name}" for name in inside)]:
        named(name)


def code_in(path):
    """Python code of a page's examples, of a notebook, or of a script."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    if path.suffix == ".ipynb":
        return ["".join(cell["source"]) for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"]
    return [text]


@pytest.mark.parametrize("path", [*PAGES, *SCRIPTS], ids=lambda path: path.name)
def test_imports_of_examples_exist(path):
    for code in code_in(path):
        for line in ast.walk(ast.parse(code)):
            if isinstance(line, ast.ImportFrom) and line.module.split(".")[0] in ("designlab", "geometries"):
                for name in line.names:
                    named(f"{line.module}.{name.name}")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_paths_exist(page):
    for path in re.findall(rf"(?<![\w/.-])((?:{'|'.join(FOLDERS)})/[\w./*-]*\w)", code_of(page)):
        assert list(ROOT.glob(path)), path


def test_functions_of_the_two_paths_are_where_the_map_says():
    """A module in code quotes, a colon, and names in it."""
    map_ = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    found = re.findall(rf"`((?:{'|'.join(ROOMS)})[\w.]*)`: ((?:`[\w.]+`(?:, )?)+)", map_)
    assert len(found) > 15
    for module, names in found:
        for name in re.findall(r"`([\w.]+)`", names):
            named(f"designlab.{module}.{name}")


def test_the_map_shows_the_import_contract():
    """The rows of the house, and those within its rooms, are those that imports are checked by."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    orders = [each["layers"] for each in project["tool"]["importlinter"]["contracts"] if "layers" in each]
    map_ = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    house, *inner = orders
    assert "\n".join(["```", *house, "```"]) in map_
    for layers in inner:
        assert " > ".join(f"`{layer}`" for layer in layers) in map_


def test_words_of_our_own_are_in_the_code():
    """The last column of the nomenclature names what carries each word."""
    sources = [path for package in ("designlab", "geometries") for path in (ROOT / package).rglob("*.py")]
    library = "".join(path.read_text(encoding="utf-8") for path in sources)
    page = (ROOT / "docs" / "nomenclature.md").read_text(encoding="utf-8")
    cells = [line.split(" | ")[-1] for line in page.splitlines() if line.startswith("| ")]
    words = [word for cell in cells for word in re.findall(r"`([\w.]+)`", cell)]
    assert len(words) > 40
    for word in words:
        if not word.startswith(("designlab.", "geometries.")):
            assert re.search(rf"\b{word.split('.')[-1]}\b", library), word


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


def test_pictures_are_small_and_shown():
    pages = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    pictures = [path for path in (ROOT / "docs" / "images").rglob("*") if path.is_file()]
    sizes = {picture: picture.stat().st_size for picture in pictures}
    assert max(sizes.values()) < 300_000
    assert sum(sizes.values()) < 2_000_000
    for picture in pictures:
        assert picture.relative_to(ROOT / "docs").as_posix() in pages


@functools.cache
def script(name):
    """A program of the folder scripts, as a module."""
    path = ROOT / "scripts" / f"{name}.py"
    module = importlib.util.module_from_spec(importlib.util.spec_from_file_location(name, path))
    sys.modules[name] = module
    module.__spec__.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["design", "catalogue", "effects", "scores", "api"])
def test_generated_pages_are_what_the_code_says(name):
    """`python scripts/reference.py` writes them anew."""
    assert (REFERENCE / f"{name}.md").read_text(encoding="utf-8") == script("reference").PAGES[name]()


def test_every_command_and_option_is_in_the_reference():
    """The help's layout differs between versions of Python, its commands and options do not."""
    told = (REFERENCE / "commands.md").read_text(encoding="utf-8")
    for command in script("reference").parsers(arguments.parser()):
        _, _, own = told.partition(f"## {command.prog}\n")
        for option in re.findall(r"--[a-z][\w-]*", command.format_help()):
            assert option in own.partition("\n## ")[0], (command.prog, option)


@pytest.mark.parametrize(("table", "model"), DESCRIBED, ids=[table for table, _ in DESCRIBED])
def test_every_field_of_a_design_is_in_its_table(table, model):
    told = (REFERENCE / "design.md").read_text(encoding="utf-8").partition(f"\n## {table}\n")[2]
    for name in model.model_fields:
        if name not in KEPT_BY_THE_PROGRAM | TABLES:
            path = name if table == "design" else f"{table}.{name}"
            assert f"`{path}`" in told.partition("\n## ")[0] or f"\n## {path}\n" in told, path


def test_every_rule_of_a_design_is_listed():
    told = (ROOT / "docs" / "geometry.md").read_text(encoding="utf-8")
    for rule in preset("default").margins():
        assert f"| `{rule}` |" in told


def test_every_effect_is_listed_with_its_parameters():
    told = (REFERENCE / "effects.md").read_text(encoding="utf-8").splitlines()
    designs = preset("gelsight-2020-flat-core"), preset("gelsight-2020-flat-elastic")
    for effect in CATALOGUE:
        (line,) = [line for line in told if line.startswith(f"| `{effect.name}` | {effect.summary} |")]
        for p in (p for design in designs for p in effect.parameters(design)):
            name = p.name.replace(p.group, "GROUP") if p.group else p.name
            name = re.sub(r"^[RGB]_from_\w+$", "C_from_GROUP", re.sub(r"_\d+$", "_N", name))
            assert re.search(rf"`{name}`[^±;]*±{re.escape(format(p.sd, 'g'))}\b", line), (effect.name, name)


def test_every_material_part_and_camera_that_is_known_is_listed():
    told = (REFERENCE / "catalogue.md").read_text(encoding="utf-8")
    for name in (*MATERIALS, *GELS, *PARTS, *SENSITIVITIES):
        assert f"| `{name}` |" in told


def merged(content, change):
    """Tables are merged, anything else is replaced."""
    both = isinstance(content, dict) and isinstance(change, dict)
    if not both:
        return change
    return content | {key: merged(content.get(key), value) for key, value in change.items()}


@pytest.mark.parametrize("example", EXAMPLES, ids=range(1, len(EXAMPLES) + 1))
def test_every_example_makes_a_design_that_can_be_built(example, tmp_path):
    """Each block is written into the preset that its first line names."""
    (tmp_path / "led.ies").write_text(IES, encoding="ascii")
    Image.fromarray(np.full((30, 40), 200, dtype=np.uint8)).save(tmp_path / "albedo.png")
    (parts,) = (block for block in BLOCKS if block.startswith(OWN_PARTS))
    (tmp_path / "my-parts.toml").write_text(parts, encoding="utf-8")
    (name,) = re.findall(r"^# changes to ([\w-]+)", example)
    assert name in preset_names()
    before = tomllib.loads(preset_text(name))
    design = loads(tomli_w.dumps(merged(before, tomllib.loads(example))), folder=tmp_path)
    design.require_feasible()
    assert design != loads(preset_text(name))
    assert loads(dumps(design)) == design


def test_every_panel_of_the_gallery_is_a_design_of_its_own():
    drawn = script("gallery")
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    for name, figure in drawn.FIGURES.items():
        assert f"(images/gallery/{name}.jpg)" in page
        panels = [drawn.changed(figure.preset, figure.always, panel) for panel in figure.panels]
        for panel in panels:
            panel.require_feasible()
        assert len({panel.digest for panel in panels}) == len(panels) > 1


@pytest.mark.renders
@pytest.mark.slow
def test_the_script_runs(tmp_path):
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len([line for line in code.splitlines() if line.strip()]) <= 12
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stderr
    for word in ("uniformity", "normal error", "deg", "radiance", "leds.height_mm"):
        assert word in done.stdout
    assert list(tmp_path.iterdir()) == []


@pytest.mark.renders
@pytest.mark.slow
@pytest.mark.parametrize("name", ["contact", "fabrication", "reconstruct"])
def test_code_of_a_page_runs_from_top_to_bottom(name, tmp_path, monkeypatch):
    """That of README, tutorial and CONTRIBUTING has tests of its own."""
    monkeypatch.chdir(tmp_path)
    known = {}
    blocks = code_in(ROOT / "docs" / f"{name}.md")
    assert blocks
    for block in blocks:
        exec(compile(block, name, "exec"), known)


def test_every_page_with_code_is_run():
    run = {"README.md", "CONTRIBUTING.md", "tutorial.md", "contact.md", "fabrication.md", "reconstruct.md"}
    assert {page.name for page in PAGES if code_in(page)} == run


INSIDE = re.findall(
    r"^\| ([a-z ]+) \| [a-z ]+ \|$",
    (ROOT / "docs" / "writing.md").read_text(encoding="utf-8").partition("## Words that stay inside")[2],
    re.MULTILINE,
)[1:]
FOR_USERS = (
    "contact",
    "fabrication",
    "gallery",
    "gap",
    "geometry",
    "how-it-works",
    "measuring",
    "optics",
    "reconstruct",
    "tutorial",
)
SHOWN = sorted(
    [
        *(ROOT / "docs" / f"{name}.md" for name in (*FOR_USERS, "presets", "scale", "studies")),
        ROOT / "README.md",
        *REFERENCE.glob("*.md"),
        *(ROOT / "designlab" / "report").glob("*.toml"),
        *(ROOT / "designlab" / "report").glob("*.html"),
        *(ROOT / "designlab" / "app" / "templates").glob("*.md"),
        ROOT / "designlab" / "report" / "gap_text.py",
        *(ROOT / "designlab" / "app" / "cli").glob("*.py"),
    ]
)


@pytest.mark.parametrize("path", SHOWN, ids=lambda path: path.name)
def test_what_people_read_has_no_word_that_stays_inside(path):
    assert len(INSIDE) > 5
    text = " ".join(re.sub(r"`[^`]*`", "", path.read_text(encoding="utf-8")).split()).lower()
    assert [word for word in INSIDE if word in text] == []


def test_fifteen_sentences_are_shown_before_and_after():
    told = (ROOT / "docs" / "writing.md").read_text(encoding="utf-8")
    rows = told.partition("## Before and after")[2].partition("## ")[0]
    assert len(re.findall(r"^\| (?!before|---)", rows, re.MULTILINE)) == 15
