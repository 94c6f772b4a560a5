"""The frozen code is that which ran a pool: for the test pool, the commit that froze the thresholds."""

import re
import subprocess
from functools import cache
from pathlib import Path

from designlab.core.store import digest

CODE = ("designlab", "geometries")
SETS = tuple(f"designlab/validation/blind/{name}" for name in ("sealed_pools.py", "pool.py", "limits.json"))
"""Files that decide which sets a pool has and what is hidden in them."""

ROOT = Path(__file__).parents[3]


def frozen(commit: str, *, again: bool = False, root: Path = ROOT) -> str:
    """Full hash of a commit, if the code is as it was there.

    Parameters
    ----------
    commit : str
        Its hash, 7 digits or more.
    again : bool
        Whether what decides the sets is enough: for a pool that was opened, run once more by later code.
    root : Path
        The working tree.

    Raises
    ------
    ValueError
        If `root` is no git checkout, the commit is unknown, or the code has changed since.
    """
    top = _git(root, "rev-parse", "--show-toplevel")
    if top is None or Path(top) != root.resolve():
        raise ValueError(f"--frozen: needs a git checkout of designlab, {root} is none")
    # Names such as HEAD move, and with them the seeds.
    number = re.fullmatch("[0-9a-f]{7,40}", commit)
    full = _git(root, "rev-parse", "--verify", f"{commit}^{{commit}}") if number else None
    if full is None:
        raise ValueError(f"--frozen: must be the hash of a commit of this checkout, got {commit!r}")
    files = SETS if again else CODE
    changed = _git(root, "diff", "--name-only", full, "--", *files)
    new = _git(root, "ls-files", "--others", "--exclude-standard", "--", *files)
    if changed is None or new is None:
        raise ValueError(f"--frozen: git cannot compare this checkout with {commit}")
    different = [*changed.split(), *new.split()]
    if different:
        raise ValueError(
            f"--frozen: the code is not what {commit} froze: {len(different)} files differ, "
            f"{different[0]} is one; check that commit out, or freeze anew"
        )
    return full


@cache
def code_digest(root: Path = ROOT) -> str:
    """First digits of a digest of the code, data files of the packages among it."""
    files = sorted(
        path
        for package in CODE
        for path in (root / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    )
    return digest({str(path.relative_to(root)): path.read_bytes() for path in files})[:12]


def _git(root: Path, *arguments: str) -> str | None:
    """What git prints; None if it fails or is not there."""
    try:
        done = subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=False)
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None
