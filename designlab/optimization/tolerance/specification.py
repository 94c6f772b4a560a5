"""The terms of a tolerance run say what a copy must score and what differs between copies."""

from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError

from designlab.core.store import read_toml, require_version
from designlab.optimization.constraint import Bound
from designlab.optimization.tolerance.distributions import Spread
from designlab.sensor.field_errors import explain
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
    content = read_toml(path)
    require_version(content, path, FORMAT_VERSION, error=ValueError)
    try:
        return Terms.model_validate(content)
    except ValidationError as error:
        raise ValueError(f"{path}: {explain(error)}") from None
