"""How an experiment tells what it is doing."""

from designlab.core.types import Progress


def named(progress: Progress | None, name: str) -> Progress | None:
    """Tell of a part of an experiment under its name."""
    return None if progress is None else lambda what, done, of: progress(f"{name}{what}", done, of)
