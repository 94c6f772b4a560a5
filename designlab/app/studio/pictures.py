"""Pictures of a design, coarse ones first: what is linear in light is only mixed again.

Light is baked with few photons first and with more while one looks. A press is shaded from light that is
kept. Colour, power, white balance and the camera's own steps are applied to pictures that are kept.
"""

import io
import math
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from designlab.app.studio.messages import Picture, PictureJob, Relief, Rest
from designlab.app.studio.newest import Superseded
from designlab.core.backend import activate
from designlab.core.images import png_bytes, to_srgb
from designlab.core.metrics import normal_error_deg
from designlab.core.store import digest
from designlab.core.types import Array
from designlab.evaluation.protocol import EvaluationProtocol, error_region
from designlab.mechanics.contact import NotConverged
from designlab.reconstruction import blended, normals
from designlab.report.live_maps import height_colours, normal_pixels
from designlab.sensor.camera import EXPOSING
from designlab.sensor.design import LABELS, Design
from designlab.simulation.contact.press import Press
from designlab.simulation.render.session import SESSION
from designlab.simulation.simulator import GRAIN_PX, Frame, Simulator, exposure
from geometries.elastomer import base_gradient

Thing = TypeVar("Thing")

SEED = 0  # as `designlab evaluate`, whose light fields are shared so
FULL_REST_S, REST_S = 0.15, 0.3  # for which nothing newer must come before a full picture, and all else
QUALITY = 95  # of JPEG: its own noise is 0.4 % of full scale (preset default)
GRID = 9  # places of a picture, along each side, whose points on the membrane are told
FRAMES_KEPT, SIMULATORS_KEPT, LEVELS_KEPT = 24, 5, 8

SRGB = np.asarray(np.round(255 * to_srgb(np.linspace(0.0, 1.0, 2**16))), dtype=np.uint8)
"""Linear shares in 2^16 steps as an eye sees them: the curve itself takes ten times as long."""

MIXED_CAMERA = (
    *EXPOSING,
    "full_well_e",
    "read_noise_e",
    "black_level",
    "bit_depth",
    "response",
    "sensitivity",
    "filter",
)
MIXED_GROUP = ("flux_mw", "drive", "width_nm", "spectrum", "filter", "name")
"""Fields of the camera and of LED groups that act after light was traced: frames that are kept stay right."""


class Fineness(NamedTuple):
    """Columns of a picture, and distance of points of the membrane (mm), None for what they suit."""

    columns: int
    pitch_mm: float | None


class Effort(NamedTuple):
    """Samples of each refinement, the words for it, and the fineness of first and of full pictures."""

    samples: tuple[int, ...]
    coarse: Fineness
    full: Fineness


JIT = Effort((4, 16, 48), Fineness(160, 0.1), Fineness(320, None))
SCALAR = Effort((1, 8), Fineness(64, 0.2), Fineness(96, None))  # where each picture is traced slowly


def light_key(design: Design) -> str:
    """Digest of all that a picture depends on before it is mixed."""
    content = design.model_dump(mode="json", exclude={**LABELS, "mixing": True}, exclude_none=True)
    for group in content["leds"]["groups"]:
        for name in MIXED_GROUP:
            group.pop(name, None)
    for name in MIXED_CAMERA:
        content["camera"].pop(name, None)
    return digest("light of the studio", content)


class Bench:
    """Keeps what pictures are made of: simulators, frames, and how well the light of a design is known."""

    def __init__(self) -> None:
        self.effort = JIT if activate().is_jit else SCALAR
        SESSION.least_written = self.effort.samples[-1]
        self._simulators: OrderedDict[Hashable, Simulator] = OrderedDict()
        self._frames: OrderedDict[Hashable, Any] = OrderedDict()
        self._levels: OrderedDict[str, int] = OrderedDict()
        self._light: tuple[Design, str] | None = None

    def light(self, design: Design) -> str:
        """What `light_key` gives; steps of a job ask for it again and again."""
        if self._light is None or self._light[0] is not design:
            self._light = design, light_key(design)
        return self._light[1]

    def known(self, light: str) -> int:
        """Best refinement of a light that is kept; the coarsest where none is."""
        return self._levels.get(light, 0)

    def baked(self, light: str, level: int) -> None:
        """Note that a light was baked as well as this."""
        self._levels[light] = max(level, self._levels.pop(light, 0))
        while len(self._levels) > LEVELS_KEPT:
            self._levels.popitem(last=False)

    def simulator(self, design: Design, fineness: Fineness, samples: int) -> Simulator:
        """Simulator of a design; of its mixing and camera steps that of a like one may be another."""
        key = self.light(design), fineness, samples

        def made() -> Simulator:
            return Simulator(
                design,
                columns=fineness.columns,
                pitch_mm=fineness.pitch_mm,
                samples=samples,
                seed=SEED,
                estimator="fast",
            )

        return _remembered(self._simulators, key, made, SIMULATORS_KEPT)

    def frame(
        self, design: Design, fineness: Fineness, samples: int, press: Press | None, half: int | None = None
    ) -> Frame:
        """A frame, from light that is kept where possible, mixed for this design."""
        key = self.light(design), fineness, samples, None if press is None else press.model_dump_json(), half

        def made() -> Frame:
            return self.simulator(design, fineness, samples).frame(press, half=half)

        kept = _remembered(self._frames, key, made, FRAMES_KEPT)
        return replace(kept, weights=design.transfer_mw)

    def has_frame(self, design: Design, fineness: Fineness, samples: int, press: Press | None) -> bool:
        """Whether a frame is kept."""
        key = self.light(design), fineness, samples, None if press is None else press.model_dump_json(), None
        return key in self._frames

    def protocol(self, design: Design, fineness: Fineness, samples: int) -> EvaluationProtocol:
        """Camera of a design with its exposure, which is set by the untouched gel."""
        untouched = self.frame(design, fineness, samples, None)

        def smooth() -> Any:
            return gaussian_filter(untouched.basis, (0, GRAIN_PX, GRAIN_PX), mode="nearest")

        # To smooth before mixing gives the same exposure, and can be kept.
        key = self.light(design), fineness, samples, "smooth"
        even = replace(untouched, basis=_remembered(self._frames, key, smooth, FRAMES_KEPT))
        return EvaluationProtocol(design, exposure(design, even, grain_px=0.0), SEED)

    def slope_response(self, design: Design, fineness: Fineness, samples: int) -> Array:
        """What `Simulator.slope_response` gives."""
        key = self.light(design), fineness, samples, "slope response"
        simulator = self.simulator(design, fineness, samples)
        return np.asarray(_remembered(self._frames, key, simulator.slope_response, FRAMES_KEPT))


def steps(
    bench: Bench, job: PictureJob, waits: Callable[[], bool] = lambda: False
) -> Iterator[Picture | Relief | Rest]:
    """Pictures of a job, each better than the last, and a relief as soon as the first full one is there.

    What takes longer waits until the knob rests: while it is turned, only first pictures are made. Better
    light and reliefs are given up as soon as `waits` says that something else is to come first.

    Raises
    ------
    Superseded
        If it was given up.
    """
    design, press, effort = job.design, job.press, bench.effort
    light = bench.light(design)
    start = bench.known(light)
    last = len(effort.samples) - 1
    while start < last and bench.has_frame(design, effort.full, effort.samples[start + 1], press):
        start += 1
    for level in range(start, last + 1):
        samples = effort.samples[level]
        there = bench.has_frame(design, effort.full, samples, press)
        if level == start and not there:
            yield _picture(bench, job, effort.coarse, samples, _words(level, last, coarse=True))
            bench.baked(light, level)
            if job.quick:
                return
        if not there:
            yield Rest(FULL_REST_S if level == start else REST_S)
        with nullcontext() if level == start else unless(waits):
            picture = _picture(bench, job, effort.full, samples, _words(level, last, coarse=False))
        yield picture
        bench.baked(light, level)
        if job.quick:
            return
        if level in (start, last):
            yield Rest(REST_S)
            if (found := _relief(bench, job, samples, waits)) is not None:
                yield found


@contextmanager
def unless(waits: Callable[[], bool]) -> Iterator[None]:
    """Bake light unless something waits that comes first: `Superseded` is raised then."""
    before, SESSION.between = SESSION.between, partial(_give_way, waits)
    try:
        yield
    finally:
        SESSION.between = before


def _give_way(waits: Callable[[], bool]) -> None:
    if waits():
        raise Superseded


def _words(level: int, last: int, *, coarse: bool) -> str:
    light = "full light" if level == last else f"light {level + 1} of {last + 1}"
    return f"coarse, {light}" if coarse else light


def _picture(bench: Bench, job: PictureJob, fineness: Fineness, samples: int, step: str) -> Picture:
    design = job.design
    untouched = bench.frame(design, fineness, samples, None)
    protocol = bench.protocol(design, fineness, samples)
    note, shown = "", untouched
    if job.press is not None:
        try:
            shown = bench.frame(design, fineness, samples, job.press)
            note = "; ".join(shown.warnings)
        except (ValueError, NotConverged) as error:
            note = " ".join(str(error).split())
    pressed = shown is not untouched
    grid = [np.linspace(0, count - 1, GRID).round().astype(int) for count in untouched.rays.x_mm.shape]
    places = np.ix_(*grid)
    file, shape = camera_file(protocol.picture(shown, 10 if pressed else 0))
    return Picture(
        file=file,
        shape=shape,
        pressed=pressed,
        columns_mm=untouched.rays.x_mm[places],
        rows_mm=untouched.rays.y_mm[places],
        # Of a first picture the grain is seen, and telling it would delay it.
        grain=math.nan if fineness is bench.effort.coarse else _grain(bench, design, samples),
        step=step,
        note=note,
        facts=_facts(shown),
    )


def camera_file(linear: NDArray[np.floating]) -> tuple[bytes, tuple[int, int]]:
    """Picture of a camera, linear shares of full scale, as a JPEG file, with its columns and rows."""
    from PIL import Image

    steps = np.asarray(np.clip(linear, 0.0, 1.0) * (len(SRGB) - 1) + 0.5, dtype=np.uint16)
    written, picture = io.BytesIO(), Image.fromarray(SRGB[steps])
    picture.save(written, "JPEG", quality=QUALITY, subsampling=0)
    return written.getvalue(), picture.size


def _facts(frame: Frame) -> dict[str, str]:
    found = {}
    if frame.mechanics is not None:
        m = frame.mechanics
        found = {
            "force": f"{m.force_n:.2f} N",
            "depth": f"{m.depth_mm:.2f} mm",
            "contact": f"{m.contact_area_mm2:.2f} mm²",
        }
    return found


def _grain(bench: Bench, design: Design, samples: int) -> float:
    """Random error of the untouched gel's light, relative to it, from two halves of the light."""
    if not bench.simulator(design, bench.effort.coarse, samples).has_light_field:
        return math.nan
    halves = [bench.frame(design, bench.effort.coarse, samples, None, half).mixed for half in (0, 1)]
    mean = np.mean(halves)
    return float(np.sqrt(np.mean((halves[0] - halves[1]) ** 2)) / 2 / mean) if mean > 0 else math.nan


def _relief(bench: Bench, job: PictureJob, samples: int, waits: Callable[[], bool]) -> Relief | None:
    """Normals and heights as they are read off the picture by the light that is known; None without one."""
    design, fineness = job.design, bench.effort.coarse
    if job.press is None or not bench.simulator(design, fineness, samples).has_light_field:
        return None
    untouched = bench.frame(design, fineness, samples, None)
    try:
        frame = bench.frame(design, fineness, samples, job.press)
    except (ValueError, NotConverged):
        return None
    protocol = bench.protocol(design, fineness, samples)
    near = protocol.near_field(untouched, np.asarray(bench.slope_response(design, fineness, samples)))
    _give_way(waits)
    image = protocol.picture(frame, 10)
    pitch = frame.rays.pitch_mm
    first = near.estimate(image).height_mm(pitch_mm=pitch)
    _give_way(waits)
    shadowed = near.shadowed(first, pitch_mm=pitch)
    _give_way(waits)
    found = shadowed.estimate(image)
    _give_way(waits)
    height = found.height_mm(pitch_mm=pitch)
    base_p, base_q = (np.nan_to_num(part) for part in base_gradient(design.elastomer, *frame.seen_mm))
    p, q = blended(found.p, found.q, height, pitch_mm=pitch)
    field = normals(p + base_p, q + base_q)
    true_p, true_q = frame.gradient
    wrong = normal_error_deg(field, normals(true_p + base_p, true_q + base_q))
    region = error_region(frame)
    truth = frame.height_mm
    low, high = min(0.0, float(np.nanmin(truth))), float(np.nanmax(truth))
    told = {}
    if region.any():
        told = {
            "normal error here": f"{float(np.nanmedian(wrong[region])):.1f}° median",
            "height error here": f"{1000 * float(np.nanmean(np.abs(height - truth)[region])):.0f} µm mean",
        }
    return Relief(
        png_bytes(normal_pixels(field)), png_bytes(height_colours(height, (low, high))), low, high, told
    )


def _remembered(
    kept: OrderedDict[Hashable, Any], key: Hashable, make: Callable[[], Thing], most: int
) -> Thing:
    """What is kept under a key, made first where it is not; what was used longest ago gives way to it."""
    if key not in kept:
        made = make()
        while len(kept) >= most:
            kept.popitem(last=False)
        kept[key] = made
    kept.move_to_end(key)
    found: Thing = kept[key]
    return found
