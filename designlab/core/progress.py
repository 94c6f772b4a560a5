"""How long work tells what it is doing, and the bar that shows it."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from designlab.core.types import Progress

THOUSANDTHS = 1000
IN_PERCENT = "{desc}: {percentage:.0f} % |{bar}| {elapsed} passed, about {remaining} left"
"""Format of a bar for work that tells of itself in thousandths."""


def silent(stage: str, done: int, total: int) -> None:
    """Tell nobody."""


def named(progress: Progress, name: str) -> Progress:
    """Tell of a part of some work under its name, which comes before what the part says of itself."""
    return lambda stage, done, total: progress(f"{name}{stage}", done, total)


def part_of(progress: Progress, title: str, *, begun: float, cost: float, total: float) -> Progress:
    """Tell of a part of some work in thousandths of the whole.

    Parameters
    ----------
    title : str
        What the part is called.
    begun, cost, total : float
        Effort spent before the part, that of the part and that of everything, in one unit.
    """

    def tell(stage: str, done: int, of: int) -> None:
        share = (begun + cost * min(done / max(of, 1), 1.0)) / total
        progress(f"{title}: {stage}" if stage else title, round(THOUSANDTHS * share), THOUSANDTHS)

    return tell


@contextmanager
def bar(
    unit: str = "step", form: str | None = None, *, begun: int = 0, keep: bool = False, shown: bool = True
) -> Iterator[Progress]:
    """Show a bar with the time left on stderr, and give the function that long work calls.

    Parameters
    ----------
    unit : str
        What a step is called.
    form : str, optional
        Format of the bar, as tqdm reads it.
    begun : int
        Steps that were done before, which tell nothing of how fast it goes.
    keep : bool
        Whether the bar stays when the work has ended.
    shown : bool
        Whether there is a bar at all.
    """
    from tqdm import tqdm

    # A terminal gets a bar that moves; a log file a line now and then.
    interval_s = 0.1 if sys.stderr.isatty() else 10.0
    with tqdm(
        initial=begun,
        unit=unit,
        bar_format=form,
        file=sys.stderr,
        leave=keep,
        disable=not shown,
        mininterval=interval_s,
        delay=0.0 if keep else interval_s,
    ) as line:

        def update(stage: str, done: int, total: int) -> None:
            line.total = total
            line.set_description_str(stage, refresh=False)
            line.update(done - line.n)

        yield update
