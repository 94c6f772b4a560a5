"""A record that grows line by line, of which a killed process or a full disk loses at most the last line."""

import errno
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from designlab.core.store import writing


class Journal:
    """Lines of JSON in a file, each on the disk when `append` returns.

    Parameters
    ----------
    path : Path
        The file; its folder must exist. A last line that was cut off is taken away.

    Attributes
    ----------
    rows : list of dict
        What the file holds.
    """

    def __init__(self, path: Path) -> None:
        self._path, self.rows = path, read_journal(path)
        with writing(path):
            self._file = path.open("ab", buffering=0)
            self._file.truncate(_whole(path.read_bytes()))

    def append(self, row: Mapping[str, Any]) -> None:
        """Add a line.

        Raises
        ------
        OSError
            If it cannot be written; the text names the file.
        """
        line = (json.dumps(dict(row), allow_nan=False) + "\n").encode()
        with writing(self._path):
            if self._file.write(line) < len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(self._file.fileno())
        self.rows.append(dict(row))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *of: object) -> None:
        with writing(self._path):
            self._file.close()


def read_journal(path: Path) -> list[dict[str, Any]]:
    """Lines of a journal that are whole; none of an absent file.

    Raises
    ------
    ValueError
        If a line that is not the last is damaged.
    """
    if not path.is_file():
        return []
    content = path.read_bytes()
    try:
        return [json.loads(line) for line in content[: _whole(content)].splitlines()]
    except ValueError as error:
        raise ValueError(f"{path}: is damaged, delete it and go on: {error}") from None


def _whole(content: bytes) -> int:
    """Bytes up to the end of the last whole line."""
    return content.rfind(b"\n") + 1
