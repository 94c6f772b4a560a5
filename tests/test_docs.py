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
from typing import get_args

import annotated_types
import numpy as np
import pytest
import tomli_w
from PIL import Image

from designlab.app.cli import arguments
from designlab.sensor.camera import Camera, Vignetting
from designlab.sensor.contact import KernelContact, LayerContact
from designlab.sensor.design import Design, dumps, loads, preset, preset_names, preset_text
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
    *sorted((ROOT / "docs").glob("*.md")),
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
README = (ROOT / "README.md").read_text(encoding="utf-8")
OPTICS = (ROOT / "docs" / "optics.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^```toml\n(.*?)^```", OPTICS, re.DOTALL | re.MULTILINE)
KEPT_BY_THE_PROGRAM = {"rows", "columns", "pixels"}
TABLES = {"gelcore", "elastomer", "leds", "housing", "contact", "optics", "camera"}  # of a design
DESCRIBED = (
    ("leds", LedArray, set(LedArray.model_fields)),
    ("leds.groups", LedGroup, set(LedGroup.model_fields)),
    ("leds.profile", AngularProfile, set(AngularProfile.model_fields)),
    ("gelcore", Gelcore, set(Gelcore.model_fields)),
    ("elastomer", Elastomer, set(Elastomer.model_fields)),
    ("housing", Housing, set(Housing.model_fields)),
    ("contact", LayerContact, set(LayerContact.model_fields)),
    ("contact", KernelContact, set(KernelContact.model_fields)),
    ("optics", Optics, set(Optics.model_fields)),
    ("optics.albedo_image", AlbedoImage, set(AlbedoImage.model_fields) - KEPT_BY_THE_PROGRAM),
    ("camera", Camera, set(Camera.model_fields)),
    ("camera.distortion", Distortion, set(Distortion.model_fields)),
    ("camera.vignetting", Vignetting, set(Vignetting.model_fields)),
    ("camera.response", Response, set(Response.model_fields)),
    ("camera.sensitivity", Sensitivity, set(Sensitivity.model_fields)),
    ("design", Design, set(Design.model_fields) - TABLES),
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
    inside = re.findall(rf"`((?:{'|'.join(ROOMS)})(?!\.(?:toml|html|json)`){WORDS})`", text)
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


def row(prefix, name, field):
    """Row of a field in the tables of docs/optics.md, from the field itself."""
    unit = (field.json_schema_extra or {}).get("unit", "")
    bounds = {}
    for rule in field.metadata:
        if isinstance(rule, annotated_types.Ge | annotated_types.Le):
            bounds[type(rule).__name__[0]] = f"{getattr(rule, type(rule).__name__.lower()):g}"
        elif isinstance(rule, annotated_types.Gt | annotated_types.Lt):
            word = "above" if isinstance(rule, annotated_types.Gt) else "below"
            bounds[type(rule).__name__[0]] = f"{word} {getattr(rule, type(rule).__name__.lower()):g}"
    choices = [text for text in get_args(field.annotation) if isinstance(text, str)]
    values = ", ".join(choices) or " to ".join(bounds[key] for key in "GL" if key in bounds)
    default = "" if field.is_required() or field.default_factory else field.default
    absent = (
        "" if default in ("", (), None) else json.dumps(default) if isinstance(default, tuple) else default
    )
    path = name if prefix == "design" else f"{prefix}.{name}"
    cells = f"`{path}`", unit if unit != "1" else "", values, absent, " ".join(field.description.split())
    return "| " + " | ".join(map(str, cells)) + " |"


@pytest.mark.parametrize(("prefix", "model", "names"), DESCRIBED, ids=[prefix for prefix, _, _ in DESCRIBED])
def test_every_field_of_a_design_has_its_row(prefix, model, names):
    """A row that is missing or out of date is printed as it should stand."""
    rows = [*OPTICS.splitlines(), *(ROOT / "docs" / "geometry.md").read_text(encoding="utf-8").splitlines()]
    for name in names:
        assert row(prefix, name, model.model_fields[name]) in rows


def test_every_rule_of_a_design_is_listed():
    told = (ROOT / "docs" / "geometry.md").read_text(encoding="utf-8")
    for rule in preset("default").margins():
        assert f"| `{rule}` |" in told


def test_every_effect_is_listed_with_its_parameters():
    """In the order of the catalogue, with summary, kind, parameters and their usual size."""
    told = (ROOT / "docs" / "gap.md").read_text(encoding="utf-8")
    rows = [
        line.strip("| ").split(" | ")
        for line in told.splitlines()
        if re.match(r"\| `[a-z_]+` \| .* \| (unit|design)( \*)? \|", line)
    ]
    assert [line[0].strip("`") for line in rows] == [each.name for each in CATALOGUE]
    designs = preset("gelsight-2020-flat-core"), preset("gelsight-2020-flat-elastic")
    for each, (_, summary, parameters, kind) in zip(CATALOGUE, rows, strict=True):
        assert summary == each.summary
        assert kind == ("design" if each.transferable else "unit") + each.by_name * " *"
        for p in (p for design in designs for p in each.parameters(design)):
            name = p.name.replace(p.group, "GROUP") if p.group else p.name
            name = re.sub(r"^[RGB]_from_\w+$", "C_from_GROUP", re.sub(r"_\d+$", "_1", name))
            assert f"`{name}`" in parameters, (each.name, name)
            usual = re.search(rf"`{name}`[^±;]*±([\d.]+)", parameters)
            assert p.shape or (usual and float(usual[1]) == p.sd), (each.name, name)


def test_every_material_part_and_camera_that_is_known_is_listed():
    for name in (*MATERIALS, *PARTS, *SENSITIVITIES):
        assert f"| `{name}` |" in OPTICS


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
    (name,) = re.findall(r"^# changes to ([\w-]+)", example)
    assert name in preset_names()
    before = tomllib.loads(preset_text(name))
    design = loads(tomli_w.dumps(merged(before, tomllib.loads(example))), folder=tmp_path)
    design.require_feasible()
    assert design != loads(preset_text(name))
    assert loads(dumps(design)) == design


def gallery():
    path = ROOT / "scripts" / "gallery.py"
    module = importlib.util.module_from_spec(importlib.util.spec_from_file_location("gallery", path))
    sys.modules["gallery"] = module
    module.__spec__.loader.exec_module(module)
    return module


def test_every_panel_of_the_gallery_is_a_design_of_its_own():
    script = gallery()
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    for name, figure in script.FIGURES.items():
        assert f"(images/gallery/{name}.jpg)" in page
        panels = [script.changed(figure.preset, figure.always, panel) for panel in figure.panels]
        for panel in panels:
            panel.require_feasible()
        assert len({panel.digest for panel in panels}) == len(panels) > 1


@pytest.mark.renders
@pytest.mark.slow
def test_the_script_runs(tmp_path):
    (script,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len([line for line in script.splitlines() if line.strip()]) <= 12
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stderr
    for word in ("uniformity", "normal error", "deg", "radiance", "leds.height_mm"):
        assert word in done.stdout
    assert list(tmp_path.iterdir()) == []


INSIDE = re.findall(
    r"^\| ([a-z ]+) \| [a-z ]+ \|$",
    (ROOT / "docs" / "writing.md").read_text(encoding="utf-8").partition("## Words that stay inside")[2],
    re.MULTILINE,
)[1:]
FOR_USERS = (
    "api",
    "contact",
    "fabrication",
    "gallery",
    "gap",
    "geometry",
    "how-it-works",
    "measuring",
    "optics",
)
SHOWN = sorted(
    [
        *(ROOT / "docs" / f"{name}.md" for name in (*FOR_USERS, "presets", "scale", "studies")),
        ROOT / "README.md",
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
