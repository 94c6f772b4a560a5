"""Whether a set of frames can be compared with a model, as far as that shows without a simulation."""

from collections.abc import Sequence
from dataclasses import replace

from designlab.measurement.frames import Measurement, MeasurementError
from designlab.measurement.quality.checks import check
from designlab.measurement.quality.suspicion import refuse
from designlab.measurement.shots import LEFT_OUT, require_response
from designlab.sensor.design import Design
from designlab.simulation.effects.model import SensorModel


def check_comparable(
    measurement: Measurement, model: SensorModel, trust: Sequence[str] = ()
) -> tuple[str, ...]:
    """Stop where frames cannot be compared with a model, or are suspicious by themselves.

    Frames that are not compared may be as they are. Light that does not add up is only noted: black level,
    stray light and response curve, which the model may lack, show so.

    Returns
    -------
    tuple of str
        Notes about what was trusted, or is too weak to stop for.

    Raises
    ------
    MeasurementError
        Naming files, evidence, cause and remedy.
    """
    design = model.effective_design()
    _same_sensor(measurement, model.design)
    require_response(measurement)
    compared = tuple(frame for frame in measurement.frames if frame.kind not in LEFT_OUT)
    found = [
        replace(each, strong=False) if each.name == "not_additive" else each
        for each in check(measurement.model_copy(update={"frames": compared}), design)
    ]
    return refuse(measurement, found, trust)


def _same_sensor(measurement: Measurement, design: Design) -> None:
    """Check that the sensor a set names could be the model's: the same but for numbers."""
    stated = measurement.design()
    if stated is None:
        return
    for what, theirs, ours in (
        ("gel", stated.elastomer.shape, design.elastomer.shape),
        ("LED groups", ", ".join(stated.group_names), ", ".join(design.group_names)),
        ("camera", _size(stated), _size(design)),
    ):
        if theirs != ours:
            raise MeasurementError(
                f"{measurement.folder}: field sensor: {measurement.sensor} and the model "
                f"{design.name or 'given'} are not the same sensor: {what} {theirs}, of the model {ours}; "
                "remedy: give the model of the sensor that was measured, or correct sensor in "
                "measurement.toml"
            )


def _size(design: Design) -> str:
    return f"{design.camera.width_px} x {design.camera.height_px} px"
