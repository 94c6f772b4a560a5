"""What several commands need: progress on stderr, folders for results, tables for people."""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def bar(unit: str = "step", form: str | None = None) -> Iterator[Callable[[str, int, int], None]]:
    """Give the function that a long task calls with what it does now, steps done, and steps in all."""
    from tqdm import tqdm

    # A terminal gets a bar that moves; a log file a line now and then.
    interval_s = 0.1 if sys.stderr.isatty() else 10.0
    with tqdm(
        unit=unit,
        bar_format=form,
        file=sys.stderr,
        leave=False,
        mininterval=interval_s,
        delay=interval_s,
    ) as shown:

        def update(what: str, done: int, total: int) -> None:
            shown.total = total
            shown.set_description_str(what, refresh=False)
            shown.update(done - shown.n)

        yield update


@contextmanager
def source_named(source: str) -> Iterator[None]:
    """Put the name of the file or preset in front of what is said about an infeasible design."""
    from designlab.sensor.design import InfeasibleDesign

    try:
        yield
    except InfeasibleDesign as error:
        raise InfeasibleDesign(f"{source}: {error}") from None


def results_folder(folder: str | Path | None, *, made_with: str | None = None) -> None:
    """Try to write into a folder for results, so that a long run does not end with a refusal.

    Parameters
    ----------
    folder : path, optional
        The folder; nothing happens without one.
    made_with : str, optional
        File that an earlier run leaves there; a folder with other content is refused then, since the results
        replace the folder as a whole. Without one, the folder is there afterwards.

    Raises
    ------
    ValueError
        If it is a file, or the folder holds something else.
    OSError
        If nothing can be written there; the text names the folder.
    """
    if folder is None:
        return
    import tempfile

    path = Path(folder)
    if path.exists() and not path.is_dir():
        raise ValueError(f"{path}: must be a folder, is a file")
    if path.is_dir() and made_with and any(path.iterdir()) and not (path / made_with).is_file():
        raise ValueError(
            f"{path}: must be absent, empty or of an earlier run; it has files but no {made_with}"
        )
    made = [each for each in (path, *path.parents) if not each.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
        if made_with:  # the results bring the folder; input that is refused leaves nothing
            for each in made:
                each.rmdir()
    except OSError as error:
        raise OSError(error.errno, f"cannot write into {path}: {error.strerror or error}") from None


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lay out columns for people: the first to the left, the others to the right."""
    widths = [max(len(row[column]) for row in (header, *rows)) for column in range(len(header))]
    lines = []
    for row in (header, *rows):
        cells = [f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True)]
        lines.append("  ".join([f"{row[0]:<{widths[0]}}", *cells[1:]]).rstrip())
    return "\n".join(lines)
