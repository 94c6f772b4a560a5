"""The page about two designs, scored with the same presses and random numbers, side by side."""

from collections.abc import Mapping
from pathlib import Path

from designlab.core.store import write_atomic
from designlab.evaluation.paired_comparison import Difference
from designlab.evaluation.score import Score
from designlab.report.page import (
    Column,
    Html,
    Lead,
    Section,
    difference_text,
    facts,
    link,
    page,
    pair,
    paragraph,
    picture,
    rounded,
    table,
    unbroken,
    word,
)
from designlab.report.yardsticks import HEADLINES, YARDSTICKS, row

PLACES = ("first", "second")
NO_DIFFERENCE = "no difference seen"
_SHOWN = {
    "background.png": "untouched gel",
    "uniformity.png": "light of each LED group over its mean",
    "information.png": "least tilt that camera noise makes up",
    "errors.png": "errors of normals and heights",
}


def verdict(name: str, difference: Difference) -> str:
    """Which of two designs is better in a score: "first", "second", "differs" or `NO_DIFFERENCE`."""
    if not difference.differs:
        return NO_DIFFERENCE
    rising = YARDSTICKS[name].rising if name in YARDSTICKS else None
    if rising is None:
        return "differs"
    return "second" if (difference.value > 0) == rising else "first"


def comparison_report(
    scores: Mapping[str, Score], found: Mapping[str, Difference], folders: Mapping[str, Path], target: Path
) -> Path:
    """Write the page about two designs.

    Parameters
    ----------
    scores : mapping of str to Score
        Of the ``first`` and the ``second`` design.
    found : mapping of str to Difference
        Differences of their scores, see `designlab.evaluation.paired_comparison.differences`.
    folders : mapping of str to Path
        Their evaluations, with pictures and pages.
    target : Path
        HTML file to write.
    """
    first, second = (scores[place] for place in PLACES)
    called = dict(zip(PLACES, _names(first, second), strict=True))
    main = [name for name in HEADLINES if name in found]
    others = [name for name in found if name not in main]
    sections = [
        Section("Main scores", (_differences(scores, found, main, called),)),
        Section("Side by side", _pictures(folders, called)),
        Section("All other scores", (_differences(scores, found, others, called),), folded=True),
        Section("How it was made", (_settings(scores, called),), folded=True),
    ]
    links = [
        link((folders[place] / "report.html").relative_to(target.parent).as_posix(), called[place])
        for place in PLACES
    ]
    title = f"{called['first']} against {called['second']}"
    return write_atomic(target, page(title, sections, lead=_lead(found, main, called, folders), links=links))


def _names(first: Score, second: Score) -> tuple[str, str]:
    """Names of the two designs, told apart where they are alike."""
    if first.design != second.design:
        return first.design, second.design
    return f"{first.design} (first)", f"{second.design} (second)"


def _lead(
    found: Mapping[str, Difference],
    main: list[str],
    called: Mapping[str, str],
    folders: Mapping[str, Path],
) -> Lead:
    """Which design is better in which of the main scores, and by how much."""
    better: dict[str, list[str]] = {place: [] for place in PLACES}
    for name in main:
        place = verdict(name, found[name])
        if place in better:
            better[place].append(f"{_title(name, found[name])} by {_size(found[name])}")
    told = [f"{called[place]} is better in {'; '.join(names)}." for place, names in better.items() if names]
    alike = sum(verdict(name, found[name]) == NO_DIFFERENCE for name in main)
    told.append(f"In {alike} of {len(main)} main scores no difference is seen.")
    ahead = [place for place in PLACES if better[place]]
    said = "no difference seen"
    if len(ahead) == 1:
        said = f"{called[ahead[0]]} is better"
    elif ahead:
        said = "each is better in some scores"
    shown = [folders[place] / "background.png" for place in PLACES]
    return Lead(
        question="Which sensor is better, and in what?",
        answer=tuple(map(paragraph, told)),
        picture=pair(*(picture(path, called[p]) for p, path in zip(PLACES, shown, strict=True)))
        if all(path.is_file() for path in shown)
        else None,
        next_words="Search for something better than both:",
        next_command="designlab study run study.toml",
        word=said,
        kind="good" if len(ahead) == 1 else "fair",
    )


def _title(name: str, difference: Difference) -> str:
    title: str = row(name, {"value": difference.value, "se": difference.se, "unit": difference.unit})["title"]
    return title.partition(" (")[0]


def _size(difference: Difference) -> str:
    """Size of a difference with unit and interval."""
    size = abs(difference.value)
    unit = "" if difference.unit == "1" else f" {difference.unit.replace('um', 'µm')}"
    number, ends = difference_text(
        size, size - difference.least, size + difference.least, signed=False
    ).split(" ", 1)
    return f"{number}{unit} {ends}"


def _differences(
    scores: Mapping[str, Score],
    found: Mapping[str, Difference],
    names: list[str],
    called: Mapping[str, str],
) -> Html:
    rows = []
    for name in names:
        difference, place = found[name], verdict(name, found[name])
        ends = difference.value - difference.least, difference.value + difference.least
        values = {p: rounded(scores[p].scores[name].value, scores[p].scores[name].se) for p in PLACES}
        title = row(name, {"value": 0.0, "se": 0.0, "unit": difference.unit})["title"]
        rows.append(
            {
                "score": title,
                **values,
                "difference": unbroken(difference_text(difference.value, *ends)),
                "verdict": word(f"{called[place]} better", "good") if place in called else place,
            }
        )
    columns = [
        Column("score", "score"),
        Column("first", called["first"]),
        Column("second", called["second"]),
        Column("difference", "difference (interval)"),
        Column("verdict", ""),
    ]
    caption = "Values with standard errors. Intervals hold all together in 95 of 100 comparisons."
    return table(rows, columns, caption=caption)


def _pictures(folders: Mapping[str, Path], called: Mapping[str, str]) -> tuple[Html, ...]:
    blocks = []
    for name, text in _SHOWN.items():
        paths = [folders[place] / name for place in PLACES]
        if all(path.is_file() for path in paths):
            each = (picture(path, f"{called[p]}: {text}") for p, path in zip(PLACES, paths, strict=True))
            blocks.append(pair(*each))
    return tuple(blocks)


def _settings(scores: Mapping[str, Score], called: Mapping[str, str]) -> Html:
    first = scores["first"]
    made = {called[place]: scores[place].made_from for place in PLACES}
    return facts({"presses": first.press_plan.text(), "fidelity": first.fidelity, "seed": first.seed, **made})
