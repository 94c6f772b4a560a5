"""The command line's jobs as calls, for scripts and notebooks: models and measurements may be named."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from designlab.core.progress import silent
from designlab.core.types import Progress
from designlab.sensor.design import Design
from designlab.simulation.effects.model import SensorModel, load_model

if TYPE_CHECKING:
    from designlab.inference.diagnosis.result import GapReport
    from designlab.measurement import Measurement
    from designlab.report.view3d import ViewPicture

PAGE = "report.html"
WRITING = 30  # thousandths of the time of a diagnosis that its report takes


def compare(
    simulated: Design | SensorModel | str | Path, real: str | Path, *, samples: int = 64, seed: int = 0
) -> dict[str, Any]:
    """Compare a model with a measurement, or two linear image files.

    Parameters
    ----------
    simulated : Design, SensorModel, str or Path
        A model, its file, or the name of a preset; an image file where `real` is one.
    real : str or Path
        A measurement folder, or an image file.
    samples : int
        Samples per pixel and LED group.
    seed : int
        Seed of the light transport.

    Returns
    -------
    dict
        Image metrics over all channels and of each, see `designlab.core.metrics.compare`.

    Raises
    ------
    ValueError
        If a file cannot be used, or the two do not fit together.
    """
    from designlab.inference.calibration.poses import posed
    from designlab.measurement import load_measurement
    from designlab.measurement.compare import compare_files, compare_model
    from designlab.simulation.directional_light import design_of, load_any_model

    folder = Path(real)
    if not (folder.is_dir() or folder.name == "measurement.toml"):
        if not isinstance(simulated, str | Path):
            raise ValueError(f"real: {real} is an image, which takes an image to compare with, not a model")
        return compare_files(simulated, real)
    model = load_any_model(simulated) if isinstance(simulated, str | Path) else simulated
    read = posed(load_measurement(folder), design_of(model), seed=seed)
    found = compare_model(model, read.measurement, samples=samples, seed=seed, backgrounds=True)
    return found.to_json() | ({"notes": list(read.notes)} if read.notes else {})


def export(
    design: Design | SensorModel | str | Path,
    out: str | Path,
    *,
    probes: Sequence[Any] = (),
    boards: bool = True,
    supply_v: float = 5.0,
    allow_infeasible: bool = False,
) -> dict[str, Any]:
    """Write everything needed to make a design into a folder.

    Parameters
    ----------
    design : Design, SensorModel, str or Path
        The sensor, its file, or the name of a preset.
    out : str or Path
        Folder that appears whole or not at all; an earlier export is replaced.
    probes : sequence of Probe or str
        Indenters to add, such as ``"sphere:4"``.
    boards : bool
        Whether to make LED boards too.
    supply_v : float
        Supply of the LED boards (V).
    allow_infeasible : bool
        Export a design that breaks its rules, or cannot be built as it is simulated, with warnings.

    Returns
    -------
    dict
        The manifest, see `designlab.fabrication.export`.

    Raises
    ------
    InfeasibleDesign
        If the design cannot be built and `allow_infeasible` is false.
    ValueError
        If `out` holds something else, a probe is unknown, or an LED board cannot be made.
    """
    from designlab.fabrication import export as write_files
    from designlab.report.build_guide import write as write_guide

    return write_files(
        _model(design),
        out,
        probes=probes,
        boards=boards,
        supply_v=supply_v,
        allow_infeasible=allow_infeasible,
        describe=write_guide,
    )


def draw(design: Design | SensorModel | str | Path, path: str | Path = "sensor.png") -> "ViewPicture":
    """Draw the sensor, its housing cut open, as a PNG file.

    Parameters
    ----------
    design : Design, SensorModel, str or Path
        The sensor, its file, or the name of a preset.
    path : str or Path
        File to write.

    Returns
    -------
    ViewPicture
        ``path`` of the picture, or None and the ``reason`` on a machine without OpenGL.

    Raises
    ------
    DesignError
        If the design cannot be read.
    """
    from designlab.report.view3d import render_view

    return render_view(_model(design).effective_design(), path)


def diagnose(
    measurement: str | Path,
    model: Design | SensorModel | str | Path,
    *,
    out: str | Path,
    seed: int = 0,
    effects: Sequence[str] | None = None,
    presses: int | None = None,
    trust: Sequence[str] = (),
    renders: str | Path | None = None,
    progress: Progress = silent,
) -> "GapReport":
    """Name the effects that a model lacks, and write the page about them.

    Parameters
    ----------
    measurement : str or Path
        Folder of the measurement.
    model : Design, SensorModel, str or Path
        The model to begin with, its file, or the name of a preset.
    out : str or Path
        Folder of page, report and corrected model; the same call again goes on there.
    seed : int
        Seed of everything random.
    effects : sequence of str, optional
        Effects to try; all that can act on the design when absent.
    presses : int, optional
        Of more presses, those that differ most are used; 20 when absent.
    trust : sequence of str
        Checks of the pictures to go on without.
    renders : str or Path, optional
        Folder of pictures that several diagnoses share.
    progress : callable, optional
        Called with what is done, and how much of all.

    Returns
    -------
    GapReport
        Verdict, effects with values and intervals, and what is left.

    Raises
    ------
    ValueError
        If the measurement cannot be used; names file, cause and remedy.
    """
    from designlab.measurement import load_measurement

    frames, given = load_measurement(measurement), _model(model)
    return diagnosed(
        frames,
        given,
        out,
        seed=seed,
        effects=effects,
        presses=presses,
        trust=trust,
        renders=renders,
        progress=progress,
    )[0]


def diagnosed(
    measurement: "Measurement",
    model: SensorModel,
    out: str | Path,
    *,
    seed: int,
    effects: Sequence[str] | None,
    presses: int | None,
    trust: Sequence[str],
    renders: str | Path | None,
    progress: Progress,
) -> tuple["GapReport", Mapping[str, Any]]:
    """What `diagnose` finds, and the content of its report."""
    from designlab.core.progress import THOUSANDTHS, part_of
    from designlab.inference.diagnosis import diagnose as find
    from designlab.report.diagnosis_folder import write_diagnosis

    finding = THOUSANDTHS - WRITING
    found = find(
        measurement,
        model,
        out=out,
        seed=seed,
        progress=part_of(progress, "", begun=0, cost=finding, total=THOUSANDTHS),
        renders=None if renders is None else Path(renders),
        trust=trust,
        catalogue=effects,
        presses=presses,
    )
    progress("writing the report", finding, THOUSANDTHS)
    content = write_diagnosis(found, page=Path(out) / PAGE)
    progress("done", THOUSANDTHS, THOUSANDTHS)
    return found, content


def _model(given: Design | SensorModel | str | Path) -> SensorModel:
    return load_model(given) if isinstance(given, str | Path) else SensorModel.of(given)
