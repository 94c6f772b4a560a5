"""How long work tells what it is doing, and the bar that shows it."""

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from designlab.core.types import Progress

THOUSANDTHS = 1000
IN_PERCENT = "{desc}{percentage:.0f} % |{bar}| {elapsed} passed, about {remaining} left"
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
        What the part is called; where it is empty, the part says what it is by itself.
    begun, cost, total : float
        Effort spent before the part, that of the part and that of everything, in one unit.
    """

    def tell(stage: str, done: int, of: int) -> None:
        share = (begun + cost * min(done / max(of, 1), 1.0)) / total
        said = f"{title}: {stage}" if title and stage else title or stage
        progress(said, round(THOUSANDTHS * share), THOUSANDTHS)

    return tell


class Work:
    """Work of several parts, which tells what is being done and what share of the whole is done.

    The share only rises, whatever parts turn out to cost, and is 1 at the end alone. A part may cost more
    than was expected: a step at most halves what seems to be left of it, so that some always is.

    Parameters
    ----------
    progress : callable
        Called with what is being done, and the share that is done in thousandths.
    costs : mapping of str to float
        What the parts are called, in their order, and what each is expected to cost, all in one unit.
    """

    def __init__(self, progress: Progress = silent, costs: Mapping[str, float] | None = None) -> None:
        self._progress, self._spent = progress, 0.0
        self._left = dict(costs or {"": 1.0})
        self._what = next(iter(self._left))

    def begin(self, part: str) -> None:
        """Begin a part: those before it are over, whatever they were expected to cost."""
        while (first := next(iter(self._left))) != part:
            del self._left[first]
        self.tell(part)

    def tell(self, what: str) -> None:
        """Tell what is being done."""
        self._what = what
        share = self._spent / max(self._spent + sum(self._left.values()), 1e-9)
        self._progress(what, min(int(THOUSANDTHS * share), THOUSANDTHS - 1), THOUSANDTHS)

    def step(self, cost: float = 1.0) -> None:
        """Count something of the part that was begun last as done."""
        self._spent += cost
        self.skip(cost)

    def skip(self, cost: float = 1.0) -> None:
        """Expect less of the part that was begun last: what is there already takes no time."""
        part, left = next(iter(self._left.items()))
        self._left[part] = max(left - cost, left / 2)
        self.tell(self._what)

    def end(self) -> None:
        """Tell that all is done."""
        self._progress("done", THOUSANDTHS, THOUSANDTHS)


def of_thousand(progress: Progress) -> Progress:
    """Tell of steps before a long work, which are too few to count: what is done, and none of the whole."""

    def told(what: str, done: int, total: int) -> None:
        progress(f"{what} ({done + 1} of {total})", 0, THOUSANDTHS)

    return told


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
    live = sys.stderr.isatty()
    interval_s, said = 0.1 if live else 10.0, ""
    with tqdm(
        initial=begun,
        unit=unit,
        bar_format=form,
        file=sys.stderr,
        leave=keep,
        disable=not shown,
        mininterval=interval_s,
        miniters=0,
        smoothing=0.0,  # the time left follows from all that was done: steps differ, one alone tells little
        delay=0.0 if keep else interval_s,
    ) as line:

        def update(stage: str, done: int, total: int) -> None:
            nonlocal said
            begins, said = stage != said, stage
            line.total = total
            line.set_description(stage, refresh=False)
            line.update(done - line.n)
            if live and keep and begins:
                line.refresh()  # what begins now may take long

        yield update
