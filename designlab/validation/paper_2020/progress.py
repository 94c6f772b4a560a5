"""How an experiment tells what it is doing."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called with what is done, how many parts are done, and how many there are."""


def named(progress: Progress | None, name: str) -> Progress | None:
    """Tell of a part of an experiment under its name."""
    return None if progress is None else lambda what, done, of: progress(f"{name}{what}", done, of)
