"""Files that are never half-written, and a cache of arrays addressed by content."""

import contextlib
import hashlib
import json
import os
import shutil
import tomllib
import uuid
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

CACHE_VARIABLE = "DESIGNLAB_CACHE"
"""Environment variable that moves the cache to another folder."""

CACHE_LIMIT_BYTES = 4 * 2**30
"""Size above which the entries used longest ago are deleted."""

CACHE_SLACK = 0.01
"""Share of that size which a process writes before it measures the cache again.

A measurement looks at every entry, 0.03 s of processor time for 9000 of them; a small picture takes 0.4 s.
"""

_written: dict[Path, int] = {}  # by cache: bytes that this process has written since it measured it

_PARTIAL = ".partial"


def digest(*parts: Any) -> str:
    """SHA-256 of content, never of identity: equal content gives equal digests in every process.

    Parameters
    ----------
    *parts : Any
        None, bool, int, float, str, bytes, paths (by text), NumPy arrays and scalars (by element type,
        shape and bytes), pydantic models (by their fields), and mappings, lists and tuples of these.
        The order of a mapping's keys does not matter; lists and tuples are alike.

    Returns
    -------
    str
        64 hexadecimal digits.

    Raises
    ------
    TypeError
        If a part is of another type, whose content is not known.
    """
    sha = hashlib.sha256()
    for part in parts:
        _feed(sha, part)
    return sha.hexdigest()


def _feed(sha: "hashlib._Hash", part: Any) -> None:
    """Add one value, led by its kind and length, so that neighbours cannot run into each other."""
    match part:
        case np.ndarray() | np.generic():
            array = np.asarray(part)
            if array.dtype.hasobject:
                raise TypeError("an array of Python objects has no canonical content")
            array = array.astype(array.dtype.newbyteorder("<"), copy=False)
            _header(sha, "array", f"{array.dtype.str}{array.shape}")
            sha.update(array.tobytes())
        case BaseModel():
            _header(sha, "model", type(part).__name__)
            _feed(sha, part.model_dump(mode="json"))
        case Mapping():
            _header(sha, "mapping", len(part))
            for key in sorted(part):
                _feed(sha, key)
                _feed(sha, part[key])
        case list() | tuple():
            _header(sha, "sequence", len(part))
            for item in part:
                _feed(sha, item)
        case bytes():
            _header(sha, "bytes", len(part))
            sha.update(part)
        case str() | Path():
            text = str(part).encode()
            _header(sha, "str" if isinstance(part, str) else "path", len(text))
            sha.update(text)
        case None | bool() | int() | float():
            _header(sha, type(part).__name__, repr(part))
        case _:
            raise TypeError(f"no canonical content is known for a {type(part).__name__}")


def _header(sha: "hashlib._Hash", kind: str, detail: object) -> None:
    sha.update(f"{kind}:{detail};".encode())


def cache_dir() -> Path:
    """Return the cache's folder, which may not exist yet: DESIGNLAB_CACHE or the platform's place."""
    import platformdirs

    chosen = os.environ.get(CACHE_VARIABLE)
    return Path(chosen) if chosen else platformdirs.user_cache_path("designlab")


def write_atomic(path: str | Path, content: bytes | str) -> Path:
    """Write a file whole or not at all: under a temporary name beside it, then renamed.

    Parameters
    ----------
    path : str or Path
        Target; its folder is made if absent, an existing file is replaced.
    content : bytes or str
        Text is written as UTF-8.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    OSError
        If it cannot be written; the text names the path and the reason. Nothing is left behind.
    """
    target = Path(path)
    with _atomic_file(target) as file:
        file.write(content.encode() if isinstance(content, str) else content)
    return target


@contextlib.contextmanager
def _atomic_file(target: Path) -> Iterator[BinaryIO]:
    """Open a file that appears under its name, on the disk, when the block ends without an error."""
    temporary = _sibling(target)
    try:
        with writing(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            with temporary.open("xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(target)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_folder(path: str | Path, *, replace: bool = False) -> Iterator[Path]:
    """Fill a folder that appears under its name only when the block ends without an error.

    Parameters
    ----------
    path : str or Path
        Target folder.
    replace : bool
        Whether an existing folder gives way; otherwise only an empty one does.

    Yields
    ------
    Path
        Empty temporary folder beside the target, to be filled.

    Raises
    ------
    OSError
        If the target exists and must stay, or cannot be written; the text names the path.
    """
    target = Path(path).resolve()  # of a link, the folder it leads to gives way
    if not replace and (target.is_file() or (target.is_dir() and any(target.iterdir()))):
        raise FileExistsError(f"{path} exists already and is not empty")
    temporary = _sibling(target)
    try:
        with writing(path):
            temporary.mkdir(parents=True)
        yield temporary
        with writing(path):
            _take_place(temporary, target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _take_place(temporary: Path, target: Path) -> None:
    if not target.exists():
        temporary.rename(target)
        return
    old = _sibling(target)
    target.rename(old)
    try:
        temporary.rename(target)
    except OSError:
        old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)


def remove_partial(folder: str | Path) -> None:
    """Delete what writers that were killed left in a folder: temporary files and folders of this module."""
    for leftover in filter(is_partial, Path(folder).glob(".*")):
        if leftover.is_dir():
            shutil.rmtree(leftover, ignore_errors=True)
        else:
            leftover.unlink(missing_ok=True)


def is_partial(path: Path) -> bool:
    """Whether a file or folder is what a writer of this module has not finished, or was killed over."""
    return path.name.startswith(".") and path.name.endswith(_PARTIAL)


def read_cache(key: str, *, folder: str | Path | None = None) -> dict[str, NDArray[Any]] | None:
    """Return the arrays stored under a key, or None; a damaged entry counts as absent and is deleted.

    Parameters
    ----------
    key : str
        What `digest` gave for everything the arrays depend on: content, settings, versions.
    folder : str or Path, optional
        Cache folder; `cache_dir` when absent.
    """
    path = _entry(key, folder)
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        return None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
        return None
    with contextlib.suppress(OSError):  # a cache that may only be read is still of use
        os.utime(path)
    return arrays


def write_cache(
    key: str,
    arrays: Mapping[str, NDArray[Any]],
    *,
    folder: str | Path | None = None,
    limit_bytes: int = CACHE_LIMIT_BYTES,
) -> Path:
    """Store arrays under a key, and delete the entries used longest ago where the cache is above its limit.

    The cache is measured at the first write of a process and each time that it has written `CACHE_SLACK` of
    the limit.

    Parameters
    ----------
    key : str
        What `digest` gave for everything the arrays depend on.
    arrays : mapping of str to array
        Named arrays of plain numbers.
    folder : str or Path, optional
        Cache folder; `cache_dir` when absent.
    limit_bytes : int
        Largest total size when measured; the entry just written is kept even when it alone exceeds it.

    Raises
    ------
    OSError
        If the folder cannot be written; the text names it. Nothing is left behind.
    """
    path = _entry(key, folder)
    with _atomic_file(path) as file:
        np.savez(file, allow_pickle=False, **arrays)
        size = file.tell()
    written = _written.get(path.parent, limit_bytes) + size
    if written > CACHE_SLACK * limit_bytes:
        _prune(path.parent, keep=path, limit_bytes=limit_bytes)
        written = 0
    _written[path.parent] = written
    return path


def _entry(key: str, folder: str | Path | None) -> Path:
    if not key.isalnum():
        raise ValueError(f"a cache key consists of letters and digits, got {key!r}")
    return (Path(folder) if folder is not None else cache_dir() / "arrays") / f"{key}.npz"


def _prune(folder: Path, *, keep: Path, limit_bytes: int) -> None:
    entries = []
    with os.scandir(folder) as found:
        for entry in found:
            if entry.name.endswith(".npz"):
                with contextlib.suppress(FileNotFoundError):  # another process may be pruning as well
                    status = entry.stat()
                    entries.append((status.st_mtime, status.st_size, entry.path))
    total = sum(size for _, size, _ in entries)
    for _, size, path in sorted(entries):
        if total <= limit_bytes:
            return
        if path != str(keep):
            Path(path).unlink(missing_ok=True)
            total -= size


def write_json(path: str | Path, content: Any) -> Path:
    """Write plain data as indented JSON, whole or not at all; raises ValueError for NaN and infinities."""
    return write_atomic(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def read_json(path: str | Path) -> dict[str, Any]:
    """Read a JSON file that holds an object.

    Raises
    ------
    ValueError
        If it cannot be read, or holds something else.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:  # neither text nor JSON
        raise ValueError(f"{path}: is damaged, delete it and go on: {error}") from None
    if not isinstance(content, dict):
        raise ValueError(f"{path}: is damaged, delete it and go on: holds no record")
    return content


def read_toml(path: str | Path, *, error: type[ValueError] = ValueError) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    ValueError
        Or the kind of it that is given: if the file cannot be read.
    """
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as problem:
        raise error(f"{path}: not valid TOML: {problem}") from None
    except (OSError, UnicodeDecodeError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else problem
        raise error(f"{path}: cannot be read: {reason}") from None


def require_version(
    content: Mapping[str, Any], path: str | Path, known: int, *, error: type[ValueError]
) -> None:
    """Refuse the content of a file that states another format version than the one known."""
    version = content.get("version")
    if version != known:
        found = "no format version" if version is None else f"format version {version!r}"
        raise error(f"{path}: field version: has {found}, this designlab reads {known}")


def _sibling(target: Path) -> Path:
    return target.parent / f".{target.name}.{uuid.uuid4().hex}{_PARTIAL}"


@contextlib.contextmanager
def writing(path: str | Path) -> Iterator[None]:
    """Let an error of the file system name the path that is written."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, f"cannot write {path}: {error.strerror or error}") from error
