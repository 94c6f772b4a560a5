"""The camera's picture of the ball, simulated."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.measurement.light_probe.ball import LightProbe
from designlab.measurement.light_probe.sight import probe_view
from designlab.measurement.light_probe.unwrap import Unwrapped, unwrap
from designlab.sensor.camera import View
from designlab.sensor.design import Design
from designlab.simulation.effects import Sight
from designlab.simulation.effects.model import SensorModel, effect
from designlab.simulation.imaging import Capture, mixed, through_optics
from designlab.simulation.optics.viewing_rays import rays
from designlab.simulation.render import path
from designlab.simulation.scene.scene import without_gel
from designlab.simulation.simulator import RenderFailed


@dataclass(frozen=True, eq=False)
class ProbePicture:
    """Simulated picture of a ball in a sensor without its gel.

    Attributes
    ----------
    basis : array, shape (groups, rows, columns)
        Radiance of each LED group at unit flux (mW/mm2/sr per mW).
    weights : array, shape (3, groups)
        Mixing matrix times flux: what turns the basis into camera channels.
    """

    design: Design
    probe: LightProbe
    view: View
    basis: NDArray[np.float32]
    weights: Array

    @property
    def mixed(self) -> NDArray[np.float32]:
        """Linear radiance of the camera channels, shape (rows, columns, 3)."""
        return np.asarray(mixed(self.basis, self.weights), dtype=np.float32)

    def unwrap(self) -> Unwrapped:
        """Light of each LED group at unit flux that arrives at the ball."""
        return unwrap(
            self.basis.transpose(1, 2, 0),
            design=self.design,
            probe=self.probe,
            view=self.view,
            names=self.design.group_names,
            groups=range(len(self.design.group_names)),
        )


def light_probe(
    model: Design | SensorModel,
    probe: LightProbe | None = None,
    *,
    columns: int = 400,
    samples: int = 64,
    seed: int = 0,
    view: View | None = None,
) -> ProbePicture:
    """Simulate the picture of a chrome ball in a sensor without its gel.

    Light goes from the LEDs, through the gelcore where it is in the path of light, to the ball and back to
    the camera; it is path-traced without bias. LEDs are areas, so that a mirror meets them.

    Parameters
    ----------
    model : Design or SensorModel
        The sensor.
    probe : LightProbe, optional
        The ball; one of 4 mm on the plane z = 0 when absent.
    columns : int
        Width of the picture in pixels where no view is given; it then shows the ball and a narrow border.
    samples : int
        Samples per pixel and LED group; best a power of four.
    seed : int
        Seed of the light transport.
    view : View, optional
        Part of the camera's sensor.

    Returns
    -------
    ProbePicture
        The picture in linear radiance (mW/mm2/sr), with the ball and the view that it shows.

    Raises
    ------
    ValueError
        If the ball touches other parts, or the camera does not see it.
    RenderFailed
        If no light of any LED group reaches the camera.
    """
    sensor = SensorModel.of(model)
    design, probe = sensor.effective_design(), probe or LightProbe()
    probe.require_room(design)
    seen = probe_view(design, probe, columns=columns) if view is None else view
    scene = without_gel(probe.around(design), probe.ball(design), seen)
    for applied in sensor.effects:
        scene = effect(applied.name).on_scene(scene, applied.values)
    basis = path.radiance(scene, samples=samples, seed=seed)
    if not basis.any():
        raise RenderFailed(
            "the rendered light probe is black; light that enters a plane gelcore by its sides does not "
            "leave it into air, so light_probe.immersed may be needed"
            if design.optics.light_path == "core"
            else "the rendered light probe is black; no light of the LEDs reaches the ball"
        )
    basis = through_optics(basis, _capture(sensor, design, seen)).astype(np.float32)
    return ProbePicture(design, probe, seen, basis, design.transfer_mw)


def _capture(sensor: SensorModel, design: Design, view: View) -> Capture:
    """How the camera takes the picture; effects on the membrane have nothing to act on."""
    acting = tuple(applied for applied in sensor.effects if effect(applied.name).stage == "camera")
    seen = rays(design, view)
    sight = Sight(design, view, (seen.x_mm, seen.y_mm), seen.pitch_mm) if acting else None
    effects = SensorModel(design=sensor.design, effects=acting)
    return Capture(design.camera, effects, view=view, sight=sight)
