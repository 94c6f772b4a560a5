"""What the values of an effect mean in words: how much, which way, and between what."""

import math
import re
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from designlab.inference.diagnosis.result import Found

MOST_TOLD = 3  # values of an effect that a sentence names
MOST_DECIMALS = 4


def told(effect: Found) -> str:
    """What the largest sure values of an effect are, in words; empty if none is sure.

    Values count by prior standard deviations from the value without effect. One is sure if its interval
    holds no such value.
    """
    sure = [
        (abs(p.value - p.null) / p.sd, name)
        for name, p in effect.parameters.items()
        if p.low is not None and p.high is not None and not p.low <= p.null <= p.high
    ]
    texts = [_told(effect.name, name, effect.parameters[name]) for _, name in sorted(sure, reverse=True)]
    return "; ".join([text for text in texts if text][:MOST_TOLD])


def _told(effect: str, name: str, p: Any) -> str:
    """A value in words; empty for a parameter that only shapes an effect."""
    found = _phrases(effect, name)
    if found is None:
        return ""
    (more, less), filled = found
    phrase = more if p.value >= p.null else less
    for mark, text in filled.items():
        phrase = phrase.replace(mark, text)
    return phrase.format(
        value=_between(p, 1.0, "" if p.unit == "1" else f" {p.unit.replace('um', 'µm')}"),
        percent=_between(p, 100.0 / (p.null or 1.0), " %"),
        points=_between(p, 100.0, " %"),
        plain=f"{p.value:.3g} ({p.low:.3g} to {p.high:.3g})",
        number=name.rpartition("_")[2],
    )


def _between(p: Any, scale: float, unit: str) -> str:
    """Distance from the value without effect, with its unit and its 95 % interval."""
    low, high = sorted(abs(end - p.null) * scale for end in (p.low, p.high))
    digits = decimals(high - low)
    return f"{abs(p.value - p.null) * scale:.{digits}f}{unit} ({low:.{digits}f} to {high:.{digits}f})"


def decimals(width: float) -> int:
    """Decimals that show an interval of this width: to a digit of its half.

    Examples
    --------
    >>> decimals(1.9), decimals(0.2), decimals(22.0)
    (1, 1, 0)
    """
    return min(max(0, -math.floor(math.log10(width / 2))), MOST_DECIMALS) if width > 0 else MOST_DECIMALS


def _phrases(effect: str, name: str) -> tuple[tuple[str, str], dict[str, str]] | None:
    """Phrases of a parameter, and what stands for the marks in them."""
    for pattern, phrases in _table().get(effect, {}).items():
        form = re.escape(pattern).replace("GROUP", r"(?P<GROUP>\w+?)")
        form = re.sub(r"^C(?=$|_)", r"(?P<C>[RGB])", form)
        match = re.fullmatch(form + (r"\d+" if pattern.endswith("_") else ""), name)
        if match:
            return (phrases[0], phrases[1]), match.groupdict()
    return None


@cache
def _table() -> Mapping[str, Mapping[str, list[str]]]:
    return tomllib.loads(files(__package__).joinpath("effects.toml").read_text(encoding="utf-8"))
