"""A folder that appears whole or not at all."""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

MANIFEST = "manifest.json"
KIND = "designlab export"


@contextmanager
def replaced_folder(out: Path) -> Iterator[Path]:
    """Yield a temporary sibling of `out`, which takes its place when the block ends without an exception.

    Parameters
    ----------
    out : Path
        Folder to make. It may be absent or empty, or an earlier export, which is replaced as a whole.

    Raises
    ------
    ValueError
        If `out` is a file, or holds anything an earlier export did not write.
    """
    out = out.resolve()
    _require_replaceable(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    work = out.parent / f".{out.name}.{uuid4().hex[:8]}.partial"
    work.mkdir()
    try:
        yield work
        _require_replaceable(out)  # somebody may have written there meanwhile
        _swap(work, out)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _require_replaceable(out: Path) -> None:
    if not out.exists():
        return
    rule = "the folder must be absent, empty or an earlier export"
    if not out.is_dir():
        raise ValueError(f"{out}: {rule}, it is a file")
    if not os.access(out, os.W_OK | os.X_OK):
        raise PermissionError(f"{out}: the folder is read-only")
    present = {path.relative_to(out).as_posix() for path in out.rglob("*") if not path.is_dir()}
    if not present and not any(out.iterdir()):
        return
    try:
        manifest = json.loads((out / MANIFEST).read_text(encoding="utf-8"))
        known = set(manifest["files"]) | {MANIFEST} if manifest["kind"] == KIND else None
    except (OSError, ValueError, KeyError, TypeError):
        known = None
    if known is None:
        raise ValueError(f"{out}: {rule}, it has no {MANIFEST} of one")
    foreign = sorted(present - known)
    if foreign:
        raise ValueError(f"{out}: {rule}, it also holds {foreign[0]!r}, which no export wrote")


def _swap(work: Path, out: Path) -> None:
    """Put `work` in the place of `out`; on failure the earlier folder stays."""
    if not out.exists():
        work.rename(out)
        return
    earlier = work.with_suffix(".earlier")
    out.rename(earlier)
    try:
        work.rename(out)
    except BaseException:
        earlier.rename(out)
        raise
    shutil.rmtree(earlier, ignore_errors=True)
