"""Results that are asked for again are kept in memory, the latest few of them."""

from collections.abc import Callable
from typing import TypeVar

Key = TypeVar("Key")
Value = TypeVar("Value")


def remembered(kept: dict[Key, Value], key: Key, compute: Callable[[], Value], *, most: int) -> Value:
    """Return what is kept under a key, computed where nothing is; beyond `most` the oldest gives way."""
    if key not in kept:
        if len(kept) >= most:
            del kept[next(iter(kept))]
        kept[key] = compute()
    return kept[key]
