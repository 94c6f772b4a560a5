"""Damage to files: bytes, numbers, words and lines changed, cut out, doubled; ends cut off."""

import io
import math
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

Draw = np.random.Generator
NUMBERS = (
    "0",
    "-1",
    "1e30",
    "-1e30",
    "1e-30",
    "nan",
    "inf",
    "1e999",
    "99999999999",
    "0.5",
    "''",
    "true",
    "[]",
)
NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")
WORD = re.compile(rb"[A-Za-z_]{2,}")
FLOATS = (0.0, -1.0, 1e30, -1e30, 1e-30, math.nan, math.inf, 1e6)
TEXTS = {".obj", ".off", ".yaml", ".yml", ".xml", ".json", ".txt", ".ies", ".ldt", ".toml", ".gltf", ".ppm"}


def mutated(data: bytes, name: str, draw: Draw) -> bytes:
    """A copy with something wrong, or two or three things."""
    if zipfile.is_zipfile(io.BytesIO(data)) and draw.random() < 0.7:
        return _repacked(data, draw)
    text = Path(name).suffix in TEXTS or name.startswith("text")
    kinds = _WORDS if text else _NUMBERS
    for _ in range(draw.choice((1, 2, 3), p=(0.7, 0.2, 0.1))):
        data = kinds[draw.integers(len(kinds))](data, draw) if data else data
    return data


def _repacked(data: bytes, draw: Draw) -> bytes:
    """An archive one of whose members is damaged, with its checksum made good."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(made, "w") as new:
        members = old.namelist()
        chosen = members[draw.integers(len(members))]
        for member in members:
            content = old.read(member)
            inner = f"text{member}" if b"<" in content[:100] else member
            new.writestr(member, mutated(content, inner, draw) if member == chosen else content)
    return made.getvalue()


def _cut(data: bytes, draw: Draw) -> bytes:
    return data[: draw.integers(len(data))]


def _some_bytes(data: bytes, draw: Draw) -> bytes:
    copy = bytearray(data)
    for place in draw.integers(len(copy), size=draw.integers(1, 5)):
        copy[place] = draw.integers(256)
    return bytes(copy)


def _without(data: bytes, draw: Draw) -> bytes:
    at = int(draw.integers(len(data)))
    return data[:at] + data[at + int(draw.integers(1, 200)) :]


def _twice(data: bytes, draw: Draw) -> bytes:
    at, many = int(draw.integers(len(data))), int(draw.integers(1, 200))
    return data[: at + many] + data[at:]


def _number_inside(data: bytes, draw: Draw) -> bytes:
    """Another number of four bytes, where one may stand."""
    at = int(draw.integers(max(1, len(data) - 3)))
    value = FLOATS[draw.integers(len(FLOATS))]
    return data[:at] + np.float32(value).tobytes() + data[at + 4 :]


def _scaled_inside(data: bytes, draw: Draw) -> bytes:
    """A number of four bytes times another: a corner of a body far from the others, for instance."""
    at = int(draw.integers(max(1, len(data) // 4))) * 4
    value = np.frombuffer(data[at : at + 4].ljust(4, b"\0"), np.float32)
    with np.errstate(all="ignore"):
        scaled = value * np.float32(draw.choice((-1.0, 0.5, 2.0, 10.0, 1000.0)))
    return data[:at] + scaled.tobytes() + data[at + 4 :]


def _other_number(data: bytes, draw: Draw) -> bytes:
    return _replaced(data, NUMBER, NUMBERS[draw.integers(len(NUMBERS))].encode(), draw)


def _scaled_number(data: bytes, draw: Draw) -> bytes:
    places = list(NUMBER.finditer(data))
    if not places:
        return data
    match = places[draw.integers(len(places))]
    value = float(match[0]) * float(draw.choice((-1.0, 0.5, 0.9, 1.1, 2.0, 10.0, 100.0, 1e4, 1e-3)))
    return data[: match.start()] + f"{value:.6g}".encode() + data[match.end() :]


def _other_word(data: bytes, draw: Draw) -> bytes:
    words = WORD.findall(data)
    return _replaced(data, WORD, words[draw.integers(len(words))], draw) if words else data


def _lines(data: bytes, draw: Draw) -> bytes:
    """A line less, twice, or somewhere else."""
    lines = data.split(b"\n")
    line = lines.pop(int(draw.integers(len(lines))))
    for _ in range(draw.integers(3)):
        lines.insert(int(draw.integers(len(lines) + 1)), line)
    return b"\n".join(lines)


def _coded(data: bytes, draw: Draw) -> bytes:
    """The same text in another coding."""
    text = data.decode("utf-8", "replace")
    codings = ("utf-16", "utf-8-sig", "utf-32", "cp037")
    return text.encode(codings[draw.integers(len(codings))], "replace")


def _replaced(data: bytes, what: re.Pattern[bytes], new: bytes, draw: Draw) -> bytes:
    places = list(what.finditer(data))
    if not places:
        return data
    match = places[draw.integers(len(places))]
    return data[: match.start()] + new + data[match.end() :]


_Change = Callable[[bytes, Draw], bytes]
_NUMBERS: tuple[_Change, ...] = (_cut, _some_bytes, _without, _twice, _number_inside, *[_scaled_inside] * 3)
_WORDS: tuple[_Change, ...] = (
    *(_cut, _some_bytes, _without, _twice, _coded),
    *(_other_number, _other_number, _other_word, _lines),
    *[_scaled_number] * 5,
)
