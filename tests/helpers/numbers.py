"""Numbers of a page as a reader meets them: each with its unit, or of a quantity that has none."""

import re
from typing import Any

from designlab.report.yardsticks import YARDSTICKS

UNITS = (
    r"%|mm²?|µm|um|nm|m|deg|px|mm/px|mN|N|MPa|kPa|dB|sd|ms|s|min|h|mW/sr|mW|W|lm|kB|MB|GB|GiB|mm per pixel"
    r"|times|pixels?|grey levels|of full scale"
)
NUMBER = r"(?<![\w.:/_(=-])[-+−]?\d+\.\d+(?:e[-+]\d+)?(?![\w:/_.]*[\w:/_])"
UNIT = re.compile(rf"[)\s]*(?:{UNITS})(?![\w/])")
STATED = re.compile(rf"(?:^|[\s(])(?:{UNITS})(?:$|[\s)])")
FURTHER = re.compile(r"(?:\s|±|to|and|or|,|\(|\)|not|x)+[-+−]?\d+(?:\.\d+)?")
TITLED = re.compile(rf"\((?:{UNITS})\)[^,;]*$")
BRACKETED = re.compile(rf"\d\s?(?:{UNITS})\s\([^)]*$")
# of these, numbers are ratios, shares or counts of noise
BARE = (
    "share", "confidence", "in units of", "squared residual", "excess", "evidence", "ratio", "factor",
    "index", "exponent", "correlation", "probability", "per noise", "floor", "usual", "before", "after",
    "version", "designlab", "doi", "arXiv", "least / greatest", "U0", "importance", "significance",
    "p-value", "SNR", "gamma", "reflectance", "distortion",
)  # fmt: skip
DIMENSIONLESS = tuple(
    each.title
    for name, each in YARDSTICKS.items()
    if each.title and not name.endswith(("_deg", "_um", "_mm", "_n", "_mn"))
)

READ = """() => {
  const said = each => [...each.childNodes].map(node => node.textContent.trim()).filter(Boolean).join(' ');
  const texts = [...document.querySelectorAll('p, li, figcaption, dd')]
    .filter(each => !each.closest('table, .plotly, script, style, .next'))
    .map(each => [
      each.tagName === 'DD' ? said(each.previousElementSibling) : '',
      each.textContent.trim(),
      (each.closest('section, details') || each).textContent,
    ]);
  const cells = [];
  for (const table of document.querySelectorAll('table')) {
    const section = (table.closest('section, details') || table).textContent;
    const heads = [...table.querySelectorAll('thead th')].map(said);
    for (const row of table.querySelectorAll('tbody tr')) {
      const own = [...row.children].map(said);
      const unit = own[heads.indexOf('unit')] === undefined ? '' : 'unit';
      own.forEach((text, i) => cells.push([text, heads[i] || '', own[0], own[1] || '', unit, section]));
    }
  }
  return [texts, cells];
}"""
EXPLAINED = "Values without a unit are"  # a section may say of all its values what they are


def unitless(page: Any) -> list[str]:
    """Sentences and cells of an opened page that hold a decimal without saying what it counts."""
    texts, cells = page.evaluate(READ)
    found = [
        f"no unit: {number} in {text[:160]!r}"
        for about, text, section in texts
        if EXPLAINED not in section and not _has_none(about)
        for number in bare_numbers(text)
    ]
    for text, head, *names, section in cells:
        about = " ".join([head, *names[:-1]])
        if EXPLAINED in section or names[-1] or STATED.search(about) or _has_none(about):
            continue
        found += [
            f"no unit: {number} in the column {head!r} of {names[0]!r}" for number in bare_numbers(text)
        ]
    return found


def bare_numbers(text: str) -> list[str]:
    """Decimals of a sentence that no unit follows, and that are not of a quantity without one.

    A unit may follow an interval or a list, or stand in brackets in the name of the quantity; an interval in
    brackets may follow a unit.

    Examples
    --------
    >>> bare_numbers("off by 3.46 ± 0.54 deg (2.9 to 4.1), at (-1.5, 2.5) mm")
    []
    >>> bare_numbers("uniformity U0 is 0.41; the height is 1.25")
    ['1.25']
    """
    found = []
    for match in re.finditer(NUMBER, text):
        rest, before = text[match.end() :], text[: match.start()]
        while not UNIT.match(rest) and (more := FURTHER.match(rest)):
            rest = rest[more.end() :]
        of = re.split(r"[;.]\s", before)[-1]
        said = UNIT.match(rest) or BRACKETED.search(before) or TITLED.search(of)
        if not said and not _has_none(of):
            found.append(match.group())
    return found


def _has_none(about: str) -> bool:
    return any(word.lower() in about.lower() for word in (*BARE, *DIMENSIONLESS))
