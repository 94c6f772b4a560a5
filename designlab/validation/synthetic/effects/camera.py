"""Effects of the camera: its pose, its lens, its sensor."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from designlab.validation.synthetic.effects.base import Planted, PlantedParameter, of_fields
from designlab.validation.synthetic.effects.colour import CHANNELS
from designlab.validation.synthetic.generator_sensor import Rig


def _pose_parameters(rig: Rig) -> dict[str, PlantedParameter]:
    moved = {f"{axis}_mm": PlantedParameter(0.0, 0.3, -3.0, 3.0, "mm") for axis in "xyz"}
    return moved | {f"tilt_{axis}_deg": PlantedParameter(0.0, 1.0, -10.0, 10.0, "deg") for axis in "xy"}


def _pose(rig: Rig, values: Mapping[str, float]) -> Rig:
    """Move the camera, turn it about its x axis and then about the y axis that went with it."""
    x, y, z = rig.camera.position_mm
    place = (x + values["x_mm"], y + values["y_mm"], z + values["z_mm"])
    # Looking along -z, a right-handed turn about y goes towards -x.
    turn = Rotation.from_euler("XY", [values["tilt_x_deg"], -values["tilt_y_deg"]], degrees=True)
    moved = rig.camera.model_copy(update={"position_mm": place})
    return replace(rig, camera=moved, turn=rig.turn @ np.asarray(turn.as_matrix()))


def _black(rig: Rig, values: Mapping[str, float]) -> Rig:
    red, green, blue = (values[channel] for channel in CHANNELS)
    return replace(rig, sensor=replace(rig.sensor, black=(red, green, blue)))


GEOMETRY = {"camera_pose": Planted(_pose_parameters, _pose)}
CAMERA = {
    "lens_distortion": of_fields(
        "lens",
        radial=("radial", PlantedParameter(0.0, 0.02, -0.2, 0.2)),
        magnification=("magnification", PlantedParameter(0.0, 0.02, -0.2, 0.2)),
    ),
    "point_spread": of_fields("lens", sigma_um=("blur_um", PlantedParameter(0.0, 75.0, 0.0, 300.0, "um"))),
    "vignetting": of_fields("lens", corner_loss=("corner_loss", PlantedParameter(0.0, 0.25, 0.0, 0.8))),
    "veiling_glare": of_fields("lens", share=("glare", PlantedParameter(0.0, 0.015, 0.0, 0.2))),
    "banding": of_fields(
        "sensor",
        amplitude=("banding", PlantedParameter(0.0, 0.015, 0.0, 0.3)),
        period_rows=("period_rows", PlantedParameter(400.0, 100.0, 40.0, 2000.0, "px", shape=True)),
    ),
    "exposure_drift": of_fields("sensor", rms=("drift_rms", PlantedParameter(0.0, 0.02, 0.0, 0.3))),
    "fixed_pattern": of_fields("sensor", rms=("pattern_rms", PlantedParameter(0.0, 0.01, 0.0, 0.1))),
    "black_level": Planted(
        lambda _: {channel: PlantedParameter(0.0, 0.015, -1.0, 1.0) for channel in CHANNELS}, _black
    ),
    "response_curve": of_fields("sensor", exponent=("exponent", PlantedParameter(1.0, 0.08, 0.4, 2.5))),
}
