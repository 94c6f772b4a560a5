"""The render cache computes each picture of a model under a press once, and keeps it."""

import importlib.metadata
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path

from designlab.core.memory import remembered
from designlab.core.progress import Work
from designlab.core.store import digest, read_cache, write_cache
from designlab.core.types import Single
from designlab.sensor.camera import EXPOSING, View
from designlab.sensor.design import LABELS, Design
from designlab.simulation.contact.press import Press
from designlab.simulation.effects.base import Effect
from designlab.simulation.effects.model import SensorModel, effect
from designlab.simulation.render.session import LIGHTFIELD_VERSION
from designlab.simulation.simulator import Simulator

PICTURES_VERSION = 1  # raise when a change of shading or of steps on light makes kept pictures wrong
SIMULATORS_KEPT = 4
NEXT_SEED = 1000  # between the seeds of repeated pictures: light transport counts on from a seed


@dataclass(frozen=True)
class Quality:
    """How well a picture is computed, relative to what is usual.

    Attributes
    ----------
    mesh : float
        Points of the membrane mesh along each side.
    samples : float
        Samples per pixel and LED group.
    """

    mesh: float = 1.0
    samples: float = 1.0

    @property
    def cost(self) -> float:
        """About the time that a picture takes, over that of a usual one."""
        return (1.0 + self.mesh**2) / 2


USUAL = Quality()
FINE = Quality(mesh=2.0)
DRAFT = Quality(mesh=0.5, samples=0.25)
"""Of pictures that only tell how light changes: errors that all drafts share cancel in their differences."""


@dataclass
class Renders:
    """Renders on demand and remembers.

    Models that differ in mixing, LED power or camera noise only share their light transport, so that effects
    of the camera cost no rendering.

    Parameters
    ----------
    folder : Path
        Where pictures are kept, so that an interrupted run does not repeat them.
    samples : int
        Samples per pixel and LED group.
    seed : int
        Seed of the light transport.
    work : Work, optional
        What pictures are a part of; its unit is a usual picture.
    """

    folder: Path
    samples: int
    seed: int
    work: Work = field(default_factory=Work)
    rendered: int = 0
    _kept: dict[str, Single] = field(default_factory=dict)
    _simulators: dict[str, Simulator] = field(default_factory=dict)

    def basis(
        self,
        model: SensorModel,
        press: Press | None,
        view: View,
        *,
        quality: Quality = USUAL,
        repeat: int = 0,
        like: SensorModel | None = None,
    ) -> Single:
        """Radiance of every LED group at unit flux, shape (groups, rows, columns).

        All pictures of one `repeat` share their random numbers, so that differences have little noise.

        Parameters
        ----------
        model : SensorModel
            The sensor.
        press : Press or None
            The indentation.
        view : View
            The part of the camera's sensor.
        quality : Quality
            Mesh of the membrane and samples.
        repeat : int
            The same picture with other random numbers for every number.
        like : SensorModel, optional
            Whose photons it shares, see `designlab.simulation.simulator.Simulator`.
        """
        like = None if like is None or like.digest == model.digest else like
        settings = (list(view), self._samples(quality), self._seed(repeat), quality.mesh)
        shared = [] if like is None else [_transport(like, None)]
        mesh = None if press is None or press.probe.file is None else Path(press.probe.file).read_bytes()
        key = digest(_transport(model, press), press, mesh, *settings, _versions(), *shared)
        if key not in self._kept:
            stored = read_cache(key, folder=self.folder)
            if stored:
                self.work.skip(quality.cost)
            else:
                self.rendered += 1
                simulator = self.simulator(model, view, quality=quality, repeat=repeat, like=like)
                stored = {"basis": simulator.frame(press).basis}
                write_cache(key, stored, folder=self.folder)
                self.work.step(quality.cost)
            self._kept[key] = stored["basis"]
        return self._kept[key]

    def simulator(
        self,
        model: SensorModel,
        view: View,
        *,
        quality: Quality = USUAL,
        repeat: int = 0,
        like: SensorModel | None = None,
    ) -> Simulator:
        """Simulator of a model."""
        shared = [] if like is None else [_transport(like, None)]
        contact = model.effective_design().contact
        key = digest(_transport(model, None), contact, list(view), asdict(quality), repeat, *shared)

        def made() -> Simulator:
            seed = self._seed(repeat)
            samples = self._samples(quality)
            simulator = Simulator(model, view=view, samples=samples, seed=seed, like=like)
            simulator.pitch_mm /= quality.mesh
            return simulator

        return remembered(self._simulators, key, made, most=SIMULATORS_KEPT)

    def _samples(self, quality: Quality) -> int:
        return max(1, round(quality.samples * self.samples))

    def _seed(self, repeat: int) -> int:
        return self.seed + NEXT_SEED * repeat


def _transport(model: SensorModel, press: Press | None) -> list[object]:
    """What decides light transport: not mixing, power or camera noise, and no contact without a press."""
    design: Design = model.effective_design()
    # What is absent does not count: fields that a later version adds leave kept pictures as they are.
    left_out = {**LABELS, "mixing": True, "housing": True}
    content = design.model_dump(mode="json", exclude=left_out, exclude_none=True)
    if design.camera.pixel_aspect == 1.0:
        del content["camera"]["pixel_aspect"]
    bright = any(design.per_group("housing_reflectance"))
    # Seats and a part of one's own stand in the light; a black tube does not.
    if bright or design.housing.seats is not None or design.housing.step is not None:
        content["housing"] = design.housing.model_dump(mode="json", exclude_none=True)
    if press is None:
        del content["contact"]
    for group in content["leds"]["groups"]:
        del group["flux_mw"]
        group.pop("drive", None)
    if design.camera.mirror is not None:
        del content["camera"]["mirror"]["reflectance"]
    for name in (*EXPOSING, "full_well_e", "read_noise_e", "black_level", "bit_depth", "response"):
        content["camera"].pop(name, None)
    acting = [
        [applied.name, applied.values]
        for applied in model.effects
        if _changes_light(effect(applied.name)) and applied.values != effect(applied.name).null(model.design)
    ]
    return [content, acting]


def _changes_light(applied: Effect) -> bool:
    """Whether an effect changes light otherwise than by the design."""
    return not {"design", "signal"}.issuperset(applied.changes)


@cache
def _versions() -> list[str]:
    programs = [importlib.metadata.version(package) for package in ("designlab", "mitsuba")]
    return [*programs, str(LIGHTFIELD_VERSION), str(PICTURES_VERSION)]
