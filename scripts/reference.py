"""Write the tables of docs/reference from the code: fields, catalogues, effects, scores, commands, names.

python scripts/reference.py          write them
python scripts/reference.py --check  print the pages that are out of date, and exit with 1 if there are any
"""

import argparse
import inspect
import json
import os
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import designlab
from designlab.app.cli import arguments
from designlab.evaluation.illumination_scores import SCORES
from designlab.report.yardsticks import YARDSTICKS, score_label
from designlab.sensor.design import Design, preset
from designlab.sensor.design_fields import fields
from designlab.sensor.gel_materials import MATERIALS as GELS
from designlab.sensor.led_catalogue import PARTS
from designlab.sensor.optical_constants import MATERIALS
from designlab.sensor.spectra import EMISSION, FILTERS, SENSITIVITIES
from designlab.simulation.effects import CATALOGUE
from designlab.simulation.effects.base import Effect, EffectParameter

os.environ["COLUMNS"] = "100"  # of the help texts
ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "docs" / "reference"
LIMITS = ROOT / "designlab" / "validation" / "blind" / "limits.json"


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Rows as a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines) + "\n"


def page(title: str, *parts: str) -> str:
    """A page with its title and parts."""
    return "\n".join([f"# {title}\n", *parts])


def design_page() -> str:
    """Every field of a design, one table for each of its own."""
    tables: dict[str, list[tuple[str, ...]]] = {}
    for line in fields(Design):
        where = line.path.rpartition(".")[0] or "design"
        unit = "" if line.unit == "1" else line.unit
        cells = (f"`{line.path}`", unit, line.values.replace(" | ", ", "), line.default, line.meaning)
        rows = tables.setdefault(where, [])
        if cells not in rows:
            rows.append(cells)
    head = ("field", "unit", "values", "default", "meaning")
    return page(
        "Fields of a design",
        "`designlab presets default` prints a complete design. *Values* are bounds or choices; "
        "*default* is what holds where a field is left out. Where it is empty, the field is off, or "
        "its meaning says what takes its place. Fields of `leds.groups` stand in a `[[leds.groups]]` "
        "table for each group; a dotted path names one by its number, from 0: "
        "`leds.groups.0.flux_mw`. What the fields mean is explained in [geometry.md](../geometry.md) "
        "and [optics.md](../optics.md).\n",
        *(f"## {where}\n\n{table(head, rows)}" for where, rows in tables.items()),
    )


def catalogue_page() -> str:
    """Materials, gels, LEDs and cameras that are known by name."""
    losses = {name: "by wavelength" if each.absorption else "none" for name, each in MATERIALS.items()}
    materials = [(f"`{n}`", f"{m.index:g}", losses[n], m.source) for n, m in MATERIALS.items()]
    gels = [
        (
            f"`{name}`",
            f"{gel.modulus_mpa:g}",
            "{:g} to {:g}".format(*gel.range_mpa) if gel.range_mpa else "",
            f"{gel.poisson:g}",
            gel.shore,
            gel.mixing_ratio,
            gel.method,
            gel.source,
        )
        for name, gel in GELS.items()
    ]
    parts = [
        (
            f"`{name}`",
            f"{part.maker} {part.number}",
            ", ".join(part.chips),
            f"{part.viewing_deg:g}" if part.viewing_deg else "",
            part.source,
        )
        for name, part in PARTS.items()
    ]
    cameras = [(f"`{name}`", curves.source) for name, curves in SENSITIVITIES.items()]
    return page(
        "Materials, gels, LEDs and cameras",
        "Each figure was read in the source beside it, or is marked as an assumption.\n",
        "## Clear materials\n\nFor `optics.gelcore_material` and `optics.elastomer_material`.\n",
        table(("material", "index", "losses", "source"), materials),
        "## Gels\n\nFor `contact.gel`. The method says what a modulus is worth; "
        "[geometry.md](../geometry.md#gels) tells how.\n",
        table(
            ("gel", "modulus (MPa)", "range (MPa)", "Poisson's ratio", "hardness", "mix", "method", "source"),
            gels,
        ),
        "## LEDs\n\nFor `leds.part`. `designlab parts NAME` prints all figures of one.\n",
        table(("part", "maker's number", "colours", "viewing angle (deg)", "source"), parts),
        "## Cameras\n\nFor `camera.sensitivity`.\n",
        table(("set", "source"), cameras),
        "## White LEDs\n\nFor `leds.groups.spectrum`: light of blue chips behind phosphor.\n",
        table(("spectrum", "source"), [(f"`{name}`", curve.source) for name, curve in EMISSION.items()]),
        "## Colour filters\n\nFor `camera.filter` and `leds.groups.filter`.\n",
        table(("filter", "source"), [(f"`{name}`", curve.source) for name, curve in FILTERS.items()]),
    )


def parameter_text(found: Sequence[EffectParameter]) -> str:
    """Names of parameters with their value without effect and usual size; alike ones together."""
    texts: dict[str, list[str]] = {}
    for p in found:
        name = p.name.replace(p.group, "GROUP") if p.group else p.name
        name = re.sub(r"^[RGB]_from_\w+$", "C_from_GROUP", re.sub(r"(?<=_)\d+$", "N", name))
        size = f"{p.null:g} ±{p.sd:g}" if p.null else f"±{p.sd:g}"
        unit = "" if p.unit in ("", "1") else f" {p.unit}"
        names = texts.setdefault(size + unit, [])
        if f"`{name}`" not in names:
            names.append(f"`{name}`")
    return "; ".join(f"{', '.join(names)} {size}" for size, names in texts.items())


def effect_rows() -> Iterator[tuple[str, str, str, str]]:
    """Row of each effect, with the parameters that it has in designs with and without a kernel."""
    designs = preset("gelsight-2020-flat-core"), preset("gelsight-2020-flat-elastic")
    for effect in CATALOGUE:
        kind = ("design" if effect.transferable else "unit") + effect.by_name * " *"
        yield f"`{effect.name}`", effect.summary, parameter_text(of_designs(effect, designs)), kind


def of_designs(effect: Effect, designs: Sequence[Design]) -> list[EffectParameter]:
    """Parameters of an effect in several designs, each name once."""
    return list({p.name: p for design in designs for p in effect.parameters(design)}.values())


def effects_page() -> str:
    """Every effect that a diagnosis knows."""
    return page(
        "Effects that a diagnosis knows",
        "Before `±` stands the value without effect where it is not 0; after it the usual size (prior "
        "standard deviation). GROUP is an LED group, C one of R, G, B, N a number. An effect of the "
        "*design* holds for its next sensor, one of the *unit* for this one. Effects with * are tried "
        "on several presses only if `--effects` names them. [gap.md](../gap.md) tells how they are "
        "found.\n",
        table(("effect", "what the model lacks", "parameters", "kind"), list(effect_rows())),
        "## Detection limits\n",
        "Half of the sets with an effect of this strength, in units of its usual size, are named right "
        "(95 % interval).\n",
        table(("effect", "limit"), list(limit_rows())),
    )


def limit_rows() -> Iterator[tuple[str, str]]:
    """Strength from which an effect is found, the smallest first."""
    limits = json.loads(LIMITS.read_text(encoding="utf-8"))
    for name, of in sorted(limits.items(), key=lambda item: item[1]["strength"]):
        ends = f"{of['low']:.2g} to {of['high']:.2g}" if of["low"] is not None else f"below {of['high']:.2g}"
        yield f"`{name}`", f"{of['strength']:.2g} ({ends})"


def scores_page() -> str:
    """Every score of an evaluation."""
    rows = []
    for name, unit in SCORES.items():
        known = YARDSTICKS.get(name)
        limits = known.limits(unit) if known else ""
        rows.append((f"`{name}`", score_label(name, unit), known.meaning if known else "", limits))
    return page(
        "Scores",
        "What `evaluate` prints, and what studies can aim at. Limits say from where a score is good "
        "or fair, and why.\n",
        table(("name", "on pages (unit)", "meaning", "limits"), rows),
    )


def parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """Every command that does something, in the order of the help."""
    inner = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    if not inner:
        yield parser
    for each in inner:
        for command in each.choices.values():
            yield from parsers(command)


def commands_page() -> str:
    """Help of every command."""
    texts = (
        f"## {each.prog}\n\n```text\n{each.format_help().strip()}\n```\n"
        for each in parsers(arguments.parser())
    )
    return page("Commands", "What `--help` prints.\n", *texts)


def call(name: str) -> str:
    """How a public name is called: parameters with their defaults, and what comes back from a function."""
    thing = getattr(designlab, name)
    signature = inspect.signature(thing)
    words: list[str] = []
    for parameter in signature.parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and "*" not in words:
            words.append("*")
        default = "..." if "factory" in repr(parameter.default) else repr(parameter.default)
        if inspect.isfunction(parameter.default):
            default = parameter.default.__name__
        words.append(parameter.name + (f"={default}" if parameter.default is not parameter.empty else ""))
    back = signature.return_annotation
    back = f" -> {getattr(back, '__name__', back)}" if inspect.isfunction(thing) else ""
    return f"{name}({', '.join(words)}){back}"


def api_page() -> str:
    """Every public name with its first sentence and its call."""
    rows = []
    for name in designlab.__all__:
        summary = " ".join((inspect.getdoc(getattr(designlab, name)) or "").partition("\n\n")[0].split())
        rows.append((f"`{name}`", summary, f"`{call(name)}`"))
    return page(
        "Python API",
        "The public names, after `import designlab as dl`. Units, results and errors stand in the "
        "docstrings: `help(dl.evaluate)`, and on the site in [docstrings](docstrings.md). Names end "
        "in their unit: `_mm`, `_deg`, `_px`, `_nm`. Parameters after `*` are given by name; `...` "
        "stands for a default that is itself an object. Everything else may change from version to "
        "version.\n",
        table(("name", "what it is", "call"), rows),
    )


PAGES = {
    "design": design_page,
    "catalogue": catalogue_page,
    "effects": effects_page,
    "scores": scores_page,
    "commands": commands_page,
    "api": api_page,
}


def main() -> int:
    """Write the pages, or say which are out of date."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--check", action="store_true")
    check = parser.parse_args().check
    late = []
    for name, write in PAGES.items():
        path = FOLDER / f"{name}.md"
        text = write()
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            late.append(path.name)
            if not check:
                path.write_text(text, encoding="utf-8")
    print(("out of date: " if check else "written: ") + (", ".join(late) or "none"))
    return int(check and bool(late))


if __name__ == "__main__":
    sys.exit(main())
