"""What several commands need: names of sources in what is said, tables for people."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager


@contextmanager
def source_named(source: str) -> Iterator[None]:
    """Put the name of the file or preset in front of what is said about an infeasible design."""
    from designlab.sensor.design import InfeasibleDesign

    try:
        yield
    except InfeasibleDesign as error:
        raise InfeasibleDesign(f"{source}: {error}", error.broken) from None


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lay out columns for people: the first to the left, the others to the right."""
    widths = [max(len(row[column]) for row in (header, *rows)) for column in range(len(header))]
    lines = []
    for row in (header, *rows):
        cells = [f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True)]
        lines.append("  ".join([f"{row[0]:<{widths[0]}}", *cells[1:]]).rstrip())
    return "\n".join(lines)
