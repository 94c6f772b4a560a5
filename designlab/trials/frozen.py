"""The commit that froze the thresholds: what runs must be what was frozen."""

import subprocess
from pathlib import Path

CODE = ("designlab", "geometries")
ROOT = Path(__file__).parents[2]


def frozen(commit: str, *, root: Path = ROOT) -> str:
    """Full hash of a commit, if the code is as it was there.

    Parameters
    ----------
    commit : str
        The commit, in any form that git knows.
    root : Path
        The working tree.

    Raises
    ------
    ValueError
        If this is no git checkout, the commit is unknown, or the code has changed since.
    """
    full = _git(root, "rev-parse", "--verify", "--end-of-options", f"{commit}^{{commit}}")
    if full is None:
        raise ValueError(f"--frozen: must be a commit of this checkout, got {commit!r}")
    changed = _git(root, "diff", "--name-only", full, "--", *CODE)
    new = _git(root, "ls-files", "--others", "--exclude-standard", "--", *CODE)
    files = [*(changed or "").split("\n"), *(new or "").split("\n")]
    different = [file for file in files if file]
    if different:
        raise ValueError(
            f"--frozen: the code is not what {commit} froze: {len(different)} files differ, "
            f"{different[0]} is one; check that commit out, or freeze anew"
        )
    return full


def _git(root: Path, *arguments: str) -> str | None:
    """What git prints; None if it fails or is not there."""
    try:
        done = subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=False)
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None
