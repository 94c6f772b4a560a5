"""What goes between the page and its worker process: jobs one way, replies the other."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from designlab.sensor.design import Design
from designlab.simulation.contact.press import Press


@dataclass(frozen=True)
class PictureJob:
    """What the camera sees of a design under a press, and what is read off it; untouched where it is None.

    Of a quick one the first picture is enough.
    """

    design: Design
    press: Press | None
    quick: bool = False


@dataclass(frozen=True)
class ScoreJob:
    """Scores of a design."""

    design: Design


@dataclass(frozen=True)
class ModelJob:
    """Three-dimensional model of the sensor, or of its rear half."""

    design: Design
    section: bool = False


@dataclass(frozen=True)
class ExportJob:
    """Files to make a design, written into a folder."""

    design: Design
    out: Path


@dataclass(frozen=True)
class StudyJob:
    """State of a study: its front and its trials."""

    folder: Path


@dataclass(frozen=True)
class GapJob:
    """A frame of a measurement beside the model, with and without the effects that a diagnosis named.

    Attributes
    ----------
    folder : Path
        Folder of the diagnosis.
    measurement : Path
        Folder of the measurement.
    frame : int
        Number of the frame.
    off : frozenset of str
        Effects that are left out.
    values : mapping of str to float
        Values of parameters by ``effect.parameter``, instead of those that were found.
    """

    folder: Path
    measurement: Path
    frame: int
    off: frozenset[str] = frozenset()
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class UploadJob:
    """A picture of a real sensor, to be read as a relief.

    Attributes
    ----------
    data : bytes
        Content of the file.
    suffix : str
        End of its name.
    calibration : Path, optional
        Calibration of the sensor; the light of the design counts when absent.
    background : bytes, optional
        Picture of the untouched gel, of a file whose name ends in `background_suffix`.
    """

    design: Design
    data: bytes
    suffix: str
    calibration: Path | None = None
    background: bytes | None = None
    background_suffix: str = ".png"


@dataclass(frozen=True)
class Request:
    """A job of one tab.

    Attributes
    ----------
    client : str
        The tab.
    lane : str
        What it is for: of a lane only the newest request of a tab counts.
    number : int
        Ascending over all requests.
    digest : str
        Of the design of the job; of the one that was shown when it was asked for where the job has none.
    """

    client: str
    lane: str
    number: int
    digest: str
    job: Any
    priority: int = 0


@dataclass(frozen=True)
class Reply:
    """A step of a request's answer; `error` is told where there is none, `last` where nothing follows."""

    client: str
    lane: str
    number: int
    digest: str
    content: Any = None
    error: str = ""
    last: bool = False


def still_shown(reply: Reply, newest: Request) -> bool:
    """Whether a reply is shown though a newer request of its lane has come: a picture of the same design is.

    The picture follows a probe that is dragged so, faster than pictures are made.
    """
    return isinstance(reply.content, Picture) and reply.digest == newest.digest


class Rest(NamedTuple):
    """Nothing yet: what follows is worth doing only if nothing newer comes for so long (s)."""

    seconds: float


class Picture(NamedTuple):
    """Picture of one step.

    Attributes
    ----------
    file : bytes
        JPEG file of high quality: white is full scale of the camera. A PNG takes ten times as long to pack,
        and what is not packed takes longer on its way.
    shape : tuple of int
        Columns and rows.
    pressed : bool
        Whether it shows the press; not where that cannot be made, which `note` says.
    columns_mm, rows_mm : array, shape (9, 9)
        Where on the membrane places of the picture lie, from its upper left corner to its lower right one.
    grain : float
        Random error of a pixel of the untouched gel, as a share of its light.
    step : str
        What is shown, in words.
    """

    file: bytes
    shape: tuple[int, int]
    pressed: bool
    columns_mm: NDArray[Any]
    rows_mm: NDArray[Any]
    grain: float
    step: str
    note: str = ""
    facts: Mapping[str, str] = {}


class Relief(NamedTuple):
    """What photometric stereo reads off the press: PNG files of normals and heights, and their scale."""

    normals: bytes
    height: bytes
    low_mm: float
    high_mm: float
    facts: Mapping[str, str]
