"""What an export writes about itself, by which a later one knows what it may replace."""

import os
from pathlib import Path

from designlab.core.store import read_json

MANIFEST = "manifest.json"
KIND = "designlab export"


def require_replaceable(out: Path) -> None:
    """Refuse a folder with content that no earlier export has written.

    Raises
    ------
    ValueError
        If it is a file, or holds anything that its manifest does not list.
    PermissionError
        If it cannot be written.
    """
    if not out.exists():
        return
    rule = "the folder must be absent, empty or an earlier export"
    if not out.is_dir():
        raise ValueError(f"{out}: {rule}, it is a file")
    if not os.access(out, os.W_OK | os.X_OK):
        raise PermissionError(f"{out}: the folder is read-only")
    if not any(out.iterdir()):
        return
    try:
        manifest = read_json(out / MANIFEST)
        known = set(manifest["files"]) | {MANIFEST} if manifest["kind"] == KIND else None
    except (ValueError, KeyError, TypeError):
        known = None
    if known is None:
        raise ValueError(f"{out}: {rule}, it has no {MANIFEST} of one")
    present = {path.relative_to(out).as_posix() for path in out.rglob("*") if not path.is_dir()}
    if foreign := sorted(present - known):
        raise ValueError(f"{out}: {rule}, it also holds {foreign[0]!r}, which no export wrote")
