"""Records of sets that were run before hold one line of JSON each, see `score.record`."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from designlab.core.store import write_atomic
from designlab.validation.blind.frozen import code_digest
from designlab.validation.blind.pool import Trial

Key = tuple[str, int, str]
"""Name, seed and kit of a set."""


def key(trial: Trial) -> Key:
    """What tells the record of a trial from all others."""
    return trial.name, trial.seed, trial.kit


def read_records(path: Path) -> dict[Key, dict[str, Any]]:
    """Read records.

    Raises
    ------
    ValueError
        If the file is missing or damaged, or a record is of other code than this: rates of two states of the
        code say nothing of either.
    """
    found = {}
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise ValueError(f"--records: {path}: {error.strerror}") from None
    for number, line in enumerate(lines, start=1):
        try:
            row = json.loads(line)
            its, code = (row["set"], row["seed"], row["kit"]), row["code"]
        except (ValueError, KeyError, TypeError):
            raise ValueError(f"--records: {path}, line {number}: is no record of a set") from None
        if code != code_digest():
            raise ValueError(
                f"--records: {path}, line {number}: set {row['set']} was run by code {code}, this is "
                f"{code_digest()}; check out the commit that ran it"
            )
        found[its] = row
    return found


def write_records(path: Path, rows: Iterable[Mapping[str, Any]]) -> Path:
    """Write records, one a line."""
    return write_atomic(path, "".join(json.dumps(row) + "\n" for row in rows))


def missing(trials: Sequence[Trial], records: Mapping[Key, Mapping[str, Any]]) -> list[Trial]:
    """Trials that no record is of."""
    return [trial for trial in trials if key(trial) not in records]
