"""What the studio is opened with: a design, the folder of a study, or that of a diagnosis."""

from pathlib import Path
from typing import NamedTuple

from designlab.app.studio.confinement import inside, shown
from designlab.app.studio.url_state import Address
from designlab.sensor.design import load, preset_names

STUDY_FILE, REPORT_FILE = "study.toml", "report.json"


class Opened(NamedTuple):
    """What was given on the command line, as an address states it, and the folder that all lies in."""

    root: Path
    address: Address


def opened(thing: str, root: Path) -> Opened:
    """Tell what is to be opened.

    Parameters
    ----------
    thing : str
        Preset, design file, folder of a study or folder of a diagnosis.
    root : Path
        Folder that the studio may read and write.

    Raises
    ------
    DesignError
        If it is a design that cannot be read.
    ValueError
        If it lies elsewhere, or is a folder of neither.
    """
    if thing in preset_names():
        return Opened(root, Address(design=thing))
    path = inside(root, thing)
    if path.is_dir():
        for view, file in (("study", STUDY_FILE), ("gap", REPORT_FILE)):
            if (path / file).is_file():
                return Opened(root, Address(view=view, folder=shown(root, path)))
        raise ValueError(
            f"{thing}: holds neither a study ({STUDY_FILE}) nor a diagnosis ({REPORT_FILE}); give a design, "
            "or a folder with one of these"
        )
    _ = load(thing if not path.exists() else path)
    return Opened(root, Address(design=shown(root, path)))
