"""The folder of a study: its definition, the record of its trials, and the lock of the run that writes.

The record may lie in a database instead, which runs on several machines share.
"""

import contextlib
import math
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from designlab.core.run_folder import locked
from designlab.core.store import read_json, read_toml, remove_partial, write_atomic
from designlab.optimization.study.definition import BASE, Study, StudyError, dumps_study, load_study

if TYPE_CHECKING:
    import optuna

RECORD_FILE = "study.db"
DEFINITION_FILE = "study.toml"
TRIALS_FOLDER = "trials"
SCORE_FILE = "score.json"
CONFIRMED_FOLDER = "confirmed"
CREATING_TRIES, CREATING_S = 5, 1.0

METHOD = "method"
"""Attribute of a trial with the name of the sampler that drew it."""

SCORE = "score"
"""Attribute of a trial in a shared record with all that is otherwise kept in the folder."""

_RECORD_NAME = "study"
_PARTS = ("", "-wal", "-shm")  # endings of the files of one SQLite database
REBUILD = "`study run --rebuild` makes a new one of all that was finished"


def trial_folder(folder: Path, number: int) -> Path:
    """Where the design and the score of an evaluated trial are kept."""
    return folder / TRIALS_FOLDER / f"{number:04d}"


@contextlib.contextmanager
def opened(
    folder: Path,
    study: Study,
    *,
    storage: str | None = None,
    rebuild: bool = False,
) -> Iterator["optuna.Study"]:
    """Open the record of a study for writing; start it if there is none.

    Parameters
    ----------
    storage : str, optional
        URL of a database that holds the record; without it, it lies in the folder, for one run alone.
    rebuild : bool
        Whether to set the record in the folder aside and start a new one.

    Raises
    ------
    StudyError
        If the folder holds another study, or there is no such database.
    RuntimeError
        If another run is writing there.
    OSError
        If folder or database cannot be written.
    """
    import optuna

    spelt: dict[str, Literal["maximize", "minimize"]] = {"maximise": "maximize", "minimise": "minimize"}
    with contextlib.ExitStack() as stack:
        stack.enter_context(locked(folder, kind="study"))
        _claim(folder, study)
        if rebuild:
            _set_aside(folder, storage)
        else:
            _one_record(folder, storage)
        stack.enter_context(_quiet())
        record = stack.enter_context(_storage(folder, storage))
        remove_partial(folder / TRIALS_FOLDER)
        try:
            yield optuna.create_study(
                study_name=_record_name(study, storage),
                storage=record,
                directions=[spelt[way] for way in study.objectives.values()],
                load_if_exists=True,
            )
        except optuna.exceptions.StorageInternalError as error:
            raise _broken("write", folder, storage, error) from error


@contextlib.contextmanager
def reading(folder: Path, storage: str | None = None) -> Iterator[tuple[Study, "optuna.Study"]]:
    """Open definition and record of an existing study, also while a run is writing there.

    Raises
    ------
    StudyError
        If the folder holds no study, or its record lies elsewhere.
    """
    import optuna

    definition, own = folder / DEFINITION_FILE, folder / RECORD_FILE
    if not definition.is_file():
        raise StudyError(f"{folder}: holds no study ({DEFINITION_FILE} is expected)")
    study = load_study(definition)
    if storage is None and not own.is_file():
        raise StudyError(
            f"{folder}: holds no record of trials ({RECORD_FILE}): if it lies in a database, give its URL; "
            f"if it is lost, {REBUILD}"
        )
    with _quiet(), _storage(folder, storage) as record:
        try:
            try:
                loaded = optuna.load_study(study_name=_record_name(study, storage), storage=record)
            except KeyError:
                raise StudyError(f"{folder}: the study was not started yet") from None
            yield study, loaded
        except optuna.exceptions.StorageInternalError as error:
            raise _broken("read", folder, storage, error) from error


def _record_name(study: Study, storage: str | None) -> str:
    """Name of a record; a database may hold those of many studies."""
    return _RECORD_NAME if storage is None else f"{study.name} {study.digest[:16]}"


@contextlib.contextmanager
def _storage(folder: Path, url: str | None = None) -> Iterator["optuna.storages.RDBStorage"]:
    storage = _own_storage(folder) if url is None else _database(url)
    try:
        yield storage
    finally:
        storage.remove_session()
        storage.engine.dispose()


def _database(url: str) -> "optuna.storages.RDBStorage":
    """Open a database that several runs share."""
    from optuna.storages import RDBStorage
    from sqlalchemy.exc import (
        ArgumentError,
        IntegrityError,
        NoSuchModuleError,
        ProgrammingError,
        SQLAlchemyError,
    )

    try:
        for _ in range(CREATING_TRIES):
            # Runs that begin at once in an empty database all create its tables; one of them does.
            with contextlib.suppress(IntegrityError, ProgrammingError):
                return RDBStorage(url)
            time.sleep(CREATING_S)
        return RDBStorage(url)
    except (ArgumentError, NoSuchModuleError) as error:
        raise StudyError(f"storage: must be the URL of a database: {_first_line(error)}") from None
    except ImportError as error:
        raise StudyError(
            f"storage: {_shown(url)}: its driver is not installed ({error}); for PostgreSQL: "
            "pip install 'designlab[postgresql]'"
        ) from None
    except SQLAlchemyError as error:
        raise OSError(f"cannot use {_shown(url)}: {_first_line(getattr(error, 'orig', error))}") from error
    except RuntimeError as error:
        raise StudyError(f"storage: {_shown(url)}: is of another version: {_first_line(error)}") from error


def _broken(what: str, folder: Path, storage: str | None, error: Exception) -> Exception:
    """What to raise where a record cannot be used: it is damaged, or its disk or server does not answer."""
    cause = error.__cause__ or error
    cause = getattr(cause, "orig", None) or cause
    place = folder / RECORD_FILE if storage is None else _shown(storage)
    damaged = isinstance(cause, sqlite3.DatabaseError) and not isinstance(cause, sqlite3.OperationalError)
    if storage is None and damaged:
        return StudyError(f"{place}: is damaged: {_first_line(cause)}; {REBUILD}")
    return OSError(f"cannot {what} {place}: {_first_line(cause)}")


def _shown(url: str) -> str:
    """URL of a database without its password."""
    from sqlalchemy.engine import make_url

    return make_url(url).render_as_string(hide_password=True)


def _first_line(error: object) -> str:
    return str(error).strip().partition("\n")[0]


def _own_storage(folder: Path) -> "optuna.storages.RDBStorage":
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
        return RDBStorage(f"sqlite:///{record}", engine_kwargs={"creator": connect})
    except (DatabaseError, sqlite3.DatabaseError) as error:
        raise _broken("use", folder, None, error) from error
    except RuntimeError as error:
        raise StudyError(f"{record}: is of another version: {_first_line(error)}") from error


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
    """Write the definition into the folder; refuse that of another study which has finished a design."""
    definition, text = folder / DEFINITION_FILE, dumps_study(study)
    if not definition.exists():
        if (folder / RECORD_FILE).exists():
            raise StudyError(f"{folder}: holds the record of a study whose {DEFINITION_FILE} is missing")
        write_atomic(definition, text)
        return
    present = load_study(definition)
    if present.digest != study.digest:
        if any(folder.glob(f"{TRIALS_FOLDER}/*/{SCORE_FILE}")):
            fields = ", ".join(present.differences(study))
            raise StudyError(
                f"{folder}: holds another study, {present.name!r}, which differs from {study.name!r} in "
                f"{fields}; choose another folder"
            )
        for suffix in _PARTS:  # drawn for what was asked for by mistake, none evaluated
            (folder / f"{RECORD_FILE}{suffix}").unlink(missing_ok=True)
    stated = "presses" in read_toml(definition, error=StudyError)
    if not (stated or _pressed_alike_before(study)) and any(folder.glob(f"{TRIALS_FOLDER}/*/{SCORE_FILE}")):
        raise StudyError(
            f"{folder}: holds a study without `presses`, whose designs were pressed as deep as their own gel "
            "is thick allows, and cannot be compared with what would follow; choose another folder"
        )
    if definition.read_text(encoding="utf-8") != text:  # name, number of trials or plan may change
        write_atomic(definition, text)


def _pressed_alike_before(study: Study) -> bool:
    """Whether designs are pressed as they were when each gel was pressed by 0.4 of its own thickness."""
    plan = study.presses
    return all(
        each.sensing_area_mm == plan.area_mm
        and plan.depth_mm is not None
        and math.isclose(min(0.4 * each.elastomer.thickness_mm, 0.8) * plan.scale, plan.depth_mm)
        for each in study.corners()
    )


def _one_record(folder: Path, storage: str | None) -> None:
    """Refuse a folder whose trials are those of another record."""
    own, trials = (folder / RECORD_FILE).is_file(), (folder / TRIALS_FOLDER).is_dir()
    if storage is not None and own:
        raise StudyError(
            f"{folder}: has a record of its own ({RECORD_FILE}); choose another folder for the database's"
        )
    if storage is None and trials and not own:
        raise StudyError(
            f"{folder}: holds trials without their record: if it lies in a database, give its URL; if "
            f"{RECORD_FILE} is lost, {REBUILD}"
        )


def _set_aside(folder: Path, storage: str | None) -> None:
    """Make room for a new record in the folder; the one that is there is kept under another name."""
    if storage is not None:
        raise StudyError("rebuild: only a record in the folder can be rebuilt, not one in a database")
    number = 1 + sum(1 for _ in folder.glob(f"{RECORD_FILE}.damaged-*[0-9]"))
    for suffix in _PARTS:
        with contextlib.suppress(FileNotFoundError):
            (folder / f"{RECORD_FILE}{suffix}").rename(folder / f"{RECORD_FILE}.damaged-{number}{suffix}")


def read_trial(folder: Path, trial: "optuna.trial.FrozenTrial") -> dict[str, Any] | None:
    """Return the score of a trial as plain data, or None if there is none."""
    if SCORE in trial.user_attrs:
        return dict(trial.user_attrs[SCORE])
    path = trial_folder(folder, trial.number) / SCORE_FILE
    return read_json(path) if path.is_file() else None


def confirmation_path(folder: Path, trial: int, design: str, fidelity: str, seed: int) -> Path:
    """Where the scores of a design, given by its digest, that was evaluated again are kept."""
    name = "base" if trial == BASE else f"{trial:04d}"
    return folder / CONFIRMED_FOLDER / f"{name}-{design[:12]}-{fidelity}-{seed}.json"


def read_confirmations(folder: Path) -> Iterator[dict[str, Any]]:
    """Return what designs scored when they were evaluated again, as plain data."""
    for path in sorted((folder / CONFIRMED_FOLDER).glob("*.json")):
        yield read_json(path)


def finished_trials(folder: Path) -> dict[int, dict[str, Any]]:
    """Return what is kept of each evaluated trial by its number, as plain data."""
    return {number: read_json(trial_folder(folder, number) / SCORE_FILE) for number in kept_numbers(folder)}


def kept_numbers(folder: Path) -> list[int]:
    """Numbers of the evaluated trials whose scores the folder keeps."""
    names = (path.parent.name for path in (folder / TRIALS_FOLDER).glob(f"*/{SCORE_FILE}"))
    return sorted(int(name) for name in names if name.isdigit())
