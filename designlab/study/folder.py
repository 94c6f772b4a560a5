"""The folder of a study: its definition, the record of its trials, and the lock of the run that writes."""

import contextlib
import os
import sqlite3
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from designlab.store import read_json, remove_partial, write_atomic
from designlab.study.definition import Study, StudyError, dumps_study, load_study

if TYPE_CHECKING:
    import optuna

RECORD_FILE = "study.db"
DEFINITION_FILE = "study.toml"
TRIALS_FOLDER = "trials"
CONFIRMED_FOLDER = "confirmed"
_RECORD_NAME = "study"


def trial_folder(folder: Path, number: int) -> Path:
    """Where the design and the score of an evaluated trial are kept."""
    return folder / TRIALS_FOLDER / f"{number:04d}"


@contextlib.contextmanager
def opened(folder: Path, study: Study) -> Iterator["optuna.Study"]:
    """Open the record of a study for writing, alone; start it if the folder holds none.

    Raises
    ------
    StudyError
        If the folder holds another study.
    RuntimeError
        If another run is writing there.
    OSError
        If the folder cannot be written.
    """
    import optuna
    from optuna.study import StudyDirection

    _claim(folder, study)
    sense = {"maximise": StudyDirection.MAXIMIZE, "minimise": StudyDirection.MINIMIZE}
    directions = [sense[way] for way in study.objectives.values()]
    with _locked(folder), _quiet(), _storage(folder) as storage:
        remove_partial(folder / TRIALS_FOLDER)
        try:
            yield optuna.create_study(
                study_name=_RECORD_NAME, storage=storage, directions=directions, load_if_exists=True
            )
        except optuna.exceptions.StorageInternalError as error:
            cause = error.__cause__ or error
            raise OSError(f"cannot write {folder / RECORD_FILE}: {getattr(cause, 'orig', cause)}") from error


@contextlib.contextmanager
def reading(folder: Path) -> Iterator[tuple[Study, "optuna.Study"]]:
    """Open definition and record of an existing study, also while a run is writing there.

    Raises
    ------
    StudyError
        If the folder holds no study.
    """
    import optuna

    definition, record = folder / DEFINITION_FILE, folder / RECORD_FILE
    if not definition.is_file() or not record.is_file():
        raise StudyError(f"{folder}: holds no study ({DEFINITION_FILE} and {RECORD_FILE} are expected)")
    study = load_study(definition)
    with _quiet(), _storage(folder) as storage:
        try:
            loaded = optuna.load_study(study_name=_RECORD_NAME, storage=storage)
        except KeyError:
            raise StudyError(f"{folder}: the study was not started yet") from None
        yield study, loaded


@contextlib.contextmanager
def _storage(folder: Path) -> Iterator["optuna.storages.RDBStorage"]:
    # SQLite, because its transactions survive a kill at any moment: in Optuna's journal file, a line cut off
    # by a kill makes the file useless to the next run.
    from optuna.storages import RDBStorage
    from sqlalchemy.exc import DatabaseError

    record = folder / RECORD_FILE

    def connect() -> sqlite3.Connection:
        # A write-ahead log can be read while it is written, and needs no wait for the disk at every step.
        connection = sqlite3.connect(record, timeout=60, check_same_thread=False)
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
        return connection

    try:
        storage = RDBStorage(f"sqlite:///{record}", engine_kwargs={"creator": connect})
    except (DatabaseError, sqlite3.DatabaseError) as error:
        _explain_damage(record, error)
        raise
    try:
        yield storage
    finally:
        storage.remove_session()
        storage.engine.dispose()


def _explain_damage(record: Path, error: Exception) -> None:
    cause = error if isinstance(error, sqlite3.Error) else error.__cause__
    if isinstance(cause, sqlite3.OperationalError):
        raise OSError(f"cannot use {record}: {cause}") from error
    if isinstance(cause, sqlite3.DatabaseError):
        raise StudyError(f"{record}: is not a record of trials: {cause}") from error


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Silence Optuna's own log for a while: it reports every trial on stderr."""
    import optuna

    before = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        yield
    finally:
        optuna.logging.set_verbosity(before)


def _claim(folder: Path, study: Study) -> None:
    """Write the definition into a new folder; refuse the folder of another study."""
    definition = folder / DEFINITION_FILE
    if not definition.exists():
        if (folder / RECORD_FILE).exists():
            raise StudyError(f"{folder}: holds the record of a study whose {DEFINITION_FILE} is missing")
        write_atomic(definition, dumps_study(study))
        return
    present = load_study(definition)
    if present.digest != study.digest:
        fields = ", ".join(present.differences(study))
        raise StudyError(
            f"{folder}: holds another study, {present.name!r}, which differs from {study.name!r} in "
            f"{fields}; choose another folder"
        )


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the folder; the system lets go of it when this process ends, however it ends."""
    import fcntl

    path = folder / ".lock"
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise OSError(error.errno, f"cannot write {path}: {error.strerror}") from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RuntimeError(f"{folder}: another run of this study is writing there") from None
        yield
    finally:
        os.close(descriptor)


def read_trial(folder: Path, number: int) -> dict[str, Any] | None:
    """Return the stored score of a trial as plain data, or None if there is none."""
    path = trial_folder(folder, number) / "score.json"
    if not path.is_file():
        return None
    return read_json(path)


def read_design(folder: Path, number: int) -> dict[str, Any]:
    """Return the stored design of an evaluated trial as plain data."""
    return tomllib.loads((trial_folder(folder, number) / "design.toml").read_text(encoding="utf-8"))


def confirmation_path(folder: Path, name: str) -> Path:
    """Where the scores of a design that was evaluated again are kept."""
    return folder / CONFIRMED_FOLDER / f"{name}.json"


def read_confirmations(folder: Path) -> Iterator[dict[str, Any]]:
    """Return what designs scored when they were evaluated again, as plain data."""
    for path in sorted((folder / CONFIRMED_FOLDER).glob("*.json")):
        yield read_json(path)
