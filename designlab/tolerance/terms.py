"""The terms of a tolerance run as a TOML file: what a copy must score, and what differs between copies."""

import tomllib
from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError

from designlab.bounds import Bound
from designlab.design import explain
from designlab.tolerance.spreads import Spread
from geometries.spec import Spec

FORMAT_VERSION: Literal[1] = 1


class Terms(Spec):
    """What scores a copy must reach, and what differs between copies."""

    version: Literal[1] = Field(1, description="Version of this format.")
    spec: dict[str, Bound] = Field({}, description="Scores, and what each must at least or at most be.")
    spread: tuple[Spread, ...] | None = Field(
        None, description="What differs between copies; the usual spreads of the design when absent."
    )


def load_terms(path: str | Path) -> Terms:
    """Read the terms of a tolerance run from a TOML file.

    Raises
    ------
    ValueError
        If the file cannot be read, is of another format version, or breaks a rule.
    """
    file = Path(path)
    try:
        content = tomllib.loads(file.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{file}: not valid TOML: {error}") from None
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ValueError(f"{file}: cannot be read: {reason}") from None
    version = content.get("version")
    if version != FORMAT_VERSION:
        found = "no format version" if version is None else f"format version {version!r}"
        raise ValueError(f"{file}: field version: has {found}, this designlab reads {FORMAT_VERSION}")
    try:
        return Terms.model_validate(content)
    except ValidationError as error:
        raise ValueError(f"{file}: {explain(error)}") from None
