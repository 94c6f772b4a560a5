"""What is suspicious about pictures: by name, with evidence, cause and remedy, and when work stops for it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from designlab.measurement.frames import Measurement, MeasurementError

NAMES = (
    "no_pose",
    "damaged",
    "copied",
    "saturated",
    "nonlinear",
    "not_additive",
    "channels",
    "colourless",
    "mirrored",
    "odd",
    "probe",
    "place",
    "markers",
)
FILES_SHOWN = 3


class SuspiciousFrames(MeasurementError):
    """Frames that are probably not as stated; `names` are those of the suspicions that work stops for."""

    def __init__(self, text: str, names: Sequence[str]) -> None:
        super().__init__(text)
        self.names = tuple(names)


@dataclass(frozen=True)
class Suspicion:
    """Something about frames that is probably not as stated.

    Attributes
    ----------
    name : str
        One of `NAMES`; what a caller trusts to go on nevertheless.
    files : tuple of str
        Frames that it is about.
    evidence : str
        What was seen, with numbers.
    cause : str
        What probably happened.
    remedy : str
        What to do.
    strong : bool
        Whether results would be wrong, so that work stops; else it is only noted.
    """

    name: str
    files: tuple[str, ...]
    evidence: str
    cause: str
    remedy: str
    strong: bool = True

    def __str__(self) -> str:
        shown = ", ".join(self.files[:FILES_SHOWN])
        more = len(self.files) - FILES_SHOWN
        where = f"{shown} and {more} more" if more > 0 else shown
        return f"{self.name}: {where}: {self.evidence}; suspected cause: {self.cause}; remedy: {self.remedy}"


def refuse(
    measurement: Measurement, suspicions: Iterable[Suspicion], trust: Sequence[str] = ()
) -> tuple[str, ...]:
    """Stop for what is suspicious, unless it is trusted.

    Parameters
    ----------
    measurement : Measurement
        The set, for its name in the error.
    suspicions : iterable of Suspicion
        What was found.
    trust : sequence of str
        Names of suspicions that are known and right as they are.

    Returns
    -------
    tuple of str
        Notes: what was trusted, and what is too weak to stop for.

    Raises
    ------
    SuspiciousFrames
        Naming files, evidence, cause, remedy and the way on.
    ValueError
        If `trust` has a name that is none.
    """
    unknown = [name for name in trust if name not in NAMES]
    if unknown:
        raise ValueError(f"trust: one of {', '.join(NAMES)}, got {unknown[0]!r}")
    found = list(suspicions)
    stops = [each for each in found if each.strong and each.name not in trust]
    if stops:
        stopping = tuple(dict.fromkeys(each.name for each in stops))
        names = " ".join(f"--trust {name}" for name in stopping)
        text = f"{measurement.folder}: {'. '.join(map(str, stops))}. To go on nevertheless: {names}"
        raise SuspiciousFrames(text, stopping)
    return tuple(f"trusted although {each}" if each.strong else str(each) for each in found)
