"""Places and depths that nobody noted, read off the pictures before anything is fitted or compared."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from designlab.core.progress import silent
from designlab.core.types import Array, Progress
from designlab.inference.calibration.imaging import Rendered
from designlab.inference.calibration.problem import CalibrationState, Problem
from designlab.inference.calibration.solve import fit
from designlab.measurement import MeasuredFrame, Measurement, MeasurementError
from designlab.measurement.depths import by_circle, cap_depth_mm
from designlab.measurement.frames import PoseSigma, alike
from designlab.measurement.shots import ROUND, Shot, observe
from designlab.measurement.sizes import check_leds, check_size
from designlab.mechanics.contact import NotConverged
from designlab.reconstruction.balls import find_contact_circle
from designlab.reconstruction.pictures import smoothed
from designlab.sensor.design import Design
from designlab.simulation.contact.press import Press
from designlab.simulation.optics.viewing_rays import rays
from designlab.simulation.simulator import RenderFailed
from geometries.probes import Probe, is_mesh

SEEN_COLUMNS = 160  # that a contact is looked for in
COLUMNS, SAMPLES = 48, 24  # of the pictures that a press is registered by
SHARES = (0.05, 0.6)  # of the gel's thickness: depths of a press of which nothing is known
MOST_SHARE = 0.95  # of the thickness, where contact ends
DEPTHS, YAWS = 5, 8  # that are tried before a pose is fitted
STEPS = 4  # of that fit
PERIOD_DEG = {"triangle": 120.0, "star": 72.0, "prism": 180.0, "cylinder": 180.0}  # yaws look alike then
FOUND_MM = 0.4  # standard deviation of a place found in the picture, before it is registered
PLACE_MM, YAW_DEG = 0.15, 3.0  # of a pose read off the picture
OF_RANGE = 4.0  # standard deviations that a stated range is taken for: 95 % lie in it
CONTRAST = 3.0  # strongest change over that of most of the picture, from which a contact is seen
SMOOTHING_PX = 1.5


class Posed(NamedTuple):
    """A measurement whose presses have places and depths, what to say of that, and files that were read."""

    measurement: Measurement
    notes: tuple[str, ...]
    files: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Wanted:
    """What is not known of a press: its place, and the range of its depth."""

    frame: MeasuredFrame
    place: bool
    range_mm: tuple[float, float] | None

    @property
    def yaw(self) -> bool:
        """Whether its yaw is to be read too."""
        return self.place and self.frame.yaw_deg is None


def posed(measurement: Measurement, design: Design, *, seed: int = 0, progress: Progress = silent) -> Posed:
    """Give every press a place and a depth, read off the pictures where the measurement states none.

    A place is found where a press differs from the untouched gel; then the pose under which the design gives
    the picture is fitted, its light free. A depth of which nothing is stated lies in `depth_range_mm`, or
    between shares of the gel's thickness; what is known of it stays as wide as that. A measurement that
    states all is returned as it is.

    Parameters
    ----------
    measurement : Measurement
        A loaded measurement folder.
    design : Design
        The sensor that it is compared with.
    seed : int
        Seed of the light transport.
    progress : callable, optional
        Called with what is being done, the presses done and their number.

    Raises
    ------
    MeasurementError
        If a stated range is deeper than the gel, a place lies outside its picture, or a picture does not fit
        the design's camera.
    """
    scaled = _scaled(measurement, design)
    wanted = [w for frame in scaled.frames if (w := _wanted(scaled, frame, design)) is not None]
    if not wanted or measurement.response == "unknown":
        return Posed(scaled, ())
    for frame in scaled.frames:
        check_size(scaled, frame, design)
        check_leds(scaled, frame, design)
    of_frame = {w.frame.file: w for w in wanted}
    groups = [g for g in _repeats([w.frame for w in wanted]) if scaled.image(g[0]).shape[-1] == 3]
    read: dict[str, MeasuredFrame] = {}
    notes = []
    for number, same in enumerate(groups):
        progress("reading poses off the pictures", number, len(groups))
        try:
            fields, said = _read(scaled, of_frame[same[0].file], design, seed=seed)
        except (ValueError, NotConverged, RenderFailed) as error:
            notes.append(f"{same[0].file}: its pose cannot be read off the picture: {error}")
            continue
        read |= {frame.file: frame.model_copy(update=fields) for frame in same}
        notes += [f"{frame.file}: {text}" for frame in same for text in said]
    frames = tuple(read.get(frame.file, frame) for frame in scaled.frames)
    return Posed(scaled.model_copy(update={"frames": frames}), tuple(notes), tuple(read))


def _repeats(frames: Sequence[MeasuredFrame]) -> list[list[MeasuredFrame]]:
    """Frames by themselves, those that are said to be repeats of one press together."""
    repeated = [frame for frame in frames if frame.repeat is not None]
    return [*([frame] for frame in frames if frame.repeat is None), *alike(repeated)]


def _scaled(measurement: Measurement, design: Design) -> Measurement:
    """Turn pixels into mm by the design's camera where the measurement has no scale."""
    if measurement.mm_per_px is not None:
        return measurement
    frames = []
    for frame in measurement.frames:
        changes: dict[str, object] = {}
        if frame.kind == "press":
            seen = rays(design, measurement.view(frame, design)) if _in_pixels(frame) else None
            if seen is not None and frame.centre_px is not None and frame.centre_mm is None:
                column, row = frame.centre_px
                rows, columns = seen.x_mm.shape
                if not (0 <= column < columns and 0 <= row < rows):
                    raise measurement.error(frame, "centre_px: lies in the picture", list(frame.centre_px))
                at = int(row), int(column)
                changes |= {"centre_mm": (float(seen.x_mm[at]), float(seen.y_mm[at]))}
            diameter_px = frame.contact_diameter_px
            if frame.contact_radius_px is not None:
                diameter_px = 2 * frame.contact_radius_px
            needed = frame.depth_mm is None and frame.force_n is None
            if seen is not None and diameter_px is not None and needed:
                across = float(np.mean(seen.pitch_mm)) * diameter_px
                none = {"contact_radius_px": None, "contact_diameter_px": None}
                changes |= {"contact_diameter_mm": across, **none}
        frames.append(frame.model_copy(update=changes) if changes else frame)
    if frames == list(measurement.frames):
        return measurement
    return measurement.model_copy(update={"frames": tuple(frames)})


def _in_pixels(frame: MeasuredFrame) -> bool:
    lengths = (frame.centre_px, frame.contact_radius_px, frame.contact_diameter_px)
    return any(length is not None for length in lengths)


def _wanted(measurement: Measurement, frame: MeasuredFrame, design: Design) -> _Wanted | None:
    """What is to be read of a frame; None where nothing is, or its probe has no size."""
    if frame.kind != "press" or frame.probe is None or not (is_mesh(frame.probe) or ":" in frame.probe):
        return None
    place = measurement.centre_mm(frame) is None
    range_mm = None if frame.depth_told else _range(measurement, frame, design)
    return _Wanted(frame, place, range_mm) if place or range_mm is not None else None


def _range(measurement: Measurement, frame: MeasuredFrame, design: Design) -> tuple[float, float]:
    """Least and greatest depth of a press that states none."""
    thickness = design.elastomer.thickness_mm
    low, high = frame.depth_range_mm or (SHARES[0] * thickness, SHARES[1] * thickness)
    if low >= MOST_SHARE * thickness:
        rule = f"depth_range_mm: begins below {MOST_SHARE:g} of the gel's thickness of {thickness:g} mm"
        raise measurement.error(frame, rule, [low, high])
    return low, min(high, MOST_SHARE * thickness)


def _read(
    measurement: Measurement, wanted: _Wanted, design: Design, *, seed: int
) -> tuple[dict[str, object], list[str]]:
    """Fields of a frame as read off its picture, and what to say of them."""
    frame, range_mm = wanted.frame, wanted.range_mm
    guess = dict(centre_mm=(0.0, 0.0)) if wanted.place else {}
    depth_mm = None if range_mm is None else float(np.mean(range_mm))
    start = frame.model_copy(update=guess | ({} if depth_mm is None else {"depth_mm": depth_mm}))
    untouched = _untouched(measurement, frame)
    if wanted.place and not untouched:
        raise MeasurementError(
            "it states no place, and no picture of the untouched gel with the same LEDs is there to compare "
            "with; add one as a background, or state centre_mm"
        )
    dark = [f for f in measurement.frames if not f.lit]
    part = measurement.model_copy(update={"frames": (*dark, *untouched, start)})
    shots = _shots(part, start, design, SEEN_COLUMNS)
    press = shots[-1].press
    assert press is not None
    seen = _contact(shots, press.probe, design) if untouched else None
    if wanted.place:
        if seen is None:
            raise MeasurementError("no contact is seen in its difference to the untouched gel")
        press = press.model_copy(update={"centre_mm": seen[0]})
    depths = [] if range_mm is None else _depths(press, design, range_mm, None if seen is None else seen[1])
    shots = _shots(part, start, design, COLUMNS)
    sigma = _sigmas(wanted, shots[-1].pose_sigma)
    shots = [*shots[:-1], replace(shots[-1], press=press, pose_sigma=sigma)]
    found = _registered(shots, design, depths, _yaws(wanted, press.probe), seed=seed)
    return _told(wanted, found, untouched)


def _untouched(measurement: Measurement, frame: MeasuredFrame) -> list[MeasuredFrame]:
    """Pictures of the untouched gel in the light of a press."""
    return [
        f
        for f in measurement.frames
        if f.kind == "background"
        and not f.gel_rotation_deg
        and (f.leds, f.crop_px, f.exposure) == (frame.leds, frame.crop_px, frame.exposure)
    ]


def _shots(part: Measurement, frame: MeasuredFrame, design: Design, columns: int) -> list[Shot]:
    """Shots of the untouched gel, and last that of a press."""
    seen = observe(part, design, columns=columns)
    own = [shot for shot in seen.shots if frame.file in shot.files]
    if not own:
        left_out = [note for note in seen.notes if note.startswith(f"{frame.file}: left out")]
        raise MeasurementError(left_out[0].partition("left out, ")[2] if left_out else "it is left out")
    return [*(shot for shot in seen.shots if shot.use == "background"), *own]


def _contact(
    shots: Sequence[Shot], probe: Probe, design: Design
) -> tuple[tuple[float, float], float | None] | None:
    """Place of a contact (mm), of a ball its radius too, where a press differs from the untouched gel."""
    gel, pressed = shots[0].signal, shots[-1].signal
    radius = None
    if probe.kind == "sphere":
        try:
            circle = find_contact_circle(pressed, gel)
        except ValueError:
            return None
        column, row = circle.centre_px
        radius = circle.radius_px
    else:
        level = np.maximum(gel, 0.05 * gel.mean(axis=(0, 1)))
        change = smoothed((pressed - gel) / level, SMOOTHING_PX)
        change -= np.median(change, axis=(0, 1))
        strength = np.sqrt((change**2).sum(axis=-1))
        most = float(np.percentile(strength, 99.8))
        if not most > 2 * CONTRAST * float(np.median(strength)):
            return None
        from skimage.morphology import convex_hull_image

        hull = convex_hull_image(strength > most / 2)
        row, column = (float(axis.mean()) for axis in np.nonzero(hull))
    seen = rays(design, shots[-1].view)
    rows, columns = seen.x_mm.shape
    at = int(np.clip(round(row), 0, rows - 1)), int(np.clip(round(column), 0, columns - 1))
    radius_mm = None if radius is None else radius * float(np.mean(seen.pitch_mm))
    return (float(seen.x_mm[at]), float(seen.y_mm[at])), radius_mm


def _depths(
    press: Press, design: Design, range_mm: tuple[float, float], radius_mm: float | None
) -> list[float]:
    """Depths to try: spread over the range, and that of the circle of a ball."""
    low, high = range_mm
    found = [float(depth) for depth in np.linspace(low, high, DEPTHS + 2)[1:-1]]
    if radius_mm is not None and radius_mm < press.probe.size_mm / 2:
        cap = press.model_copy(update={"depth_mm": cap_depth_mm(press.probe, radius_mm)})
        with suppress(ValueError, NotConverged):  # deeper than the gel can take: the range alone is tried
            found.append(float(np.clip(by_circle(cap, design, radius_mm)[0].stated_depth_mm, low, high)))
    return found


def _yaws(wanted: _Wanted, probe: Probe) -> list[float]:
    """Yaws to try (deg), counted from 0."""
    if not wanted.yaw or probe.kind in ROUND:
        return []
    period = PERIOD_DEG.get(probe.kind, 360.0)
    return [float(yaw) for yaw in np.arange(YAWS) * period / YAWS]


def _sigmas(wanted: _Wanted, stated: Array) -> Array:
    """What is known of the pose before it is registered."""
    sigma = stated.copy()
    if wanted.place:
        sigma[:2] = FOUND_MM
    if wanted.range_mm is not None:
        sigma[2] = (wanted.range_mm[1] - wanted.range_mm[0]) / OF_RANGE
    if wanted.yaw and sigma[3] > 0:
        sigma[3] = PERIOD_DEG["triangle"] / YAWS
    return sigma


def _registered(
    shots: Sequence[Shot], design: Design, depths: Sequence[float], yaws: Sequence[float], *, seed: int
) -> Press:
    """The press under which the design gives the picture best, its light free."""
    problem = Problem(Rendered(design, SAMPLES), tuple(shots), (), seed=seed)
    numbers, own = range(len(shots)), len(shots) - 1
    press = shots[own].press
    assert press is not None
    pose = np.zeros(4)

    def at(there: Array) -> CalibrationState:
        state = replace(problem.start(), poses={own: there})
        return problem.lit_best(state, problem.bases(state, numbers))

    def best(axis: int, offsets: Sequence[float]) -> Array:
        tried = [pose + offset * np.eye(4)[axis] for offset in offsets]
        return min(tried, key=lambda there: _misfit(problem, at(there), numbers))

    if depths:
        pose = best(2, [depth - press.stated_depth_mm for depth in depths])
    if yaws:
        pose = best(3, [yaw - press.yaw_deg for yaw in yaws])
    # Priors count from the start: what was tried is no more likely for it.
    state, there = at(pose), press.moved(*(float(v) for v in pose))
    problem.shots = (*problem.shots[:-1], replace(problem.shots[own], press=there))
    state = replace(state, poses={})
    problem.weigh(state, problem.bases(state, numbers))
    state, _ = fit(problem, state, numbers, steps=STEPS)
    return there.moved(*(float(v) for v in state.pose(own)))


def _misfit(problem: Problem, state: CalibrationState, numbers: Sequence[int]) -> float:
    """Squared rest of the pictures alone."""
    bases = problem.bases(state, numbers)
    return sum(float((problem.residual(state, n, basis) ** 2).sum()) for n, basis in bases.items())


def _told(
    wanted: _Wanted, press: Press, untouched: Sequence[MeasuredFrame]
) -> tuple[dict[str, object], list[str]]:
    """Fields of a frame that was read, with how well they are known, and sentences about them."""
    frame, said = wanted.frame, []
    fields: dict[str, object] = {}
    stated = {} if frame.sigma is None else frame.sigma.model_dump(exclude_none=True)
    if wanted.place:
        x, y = (round(float(v), 4) for v in press.centre_mm)
        fields["centre_mm"] = (x, y)
        stated.setdefault("centre_mm", PLACE_MM)
        turned = ""
        if wanted.yaw and press.probe.kind not in ROUND:
            fields["yaw_deg"] = round(float(press.yaw_deg), 3)
            stated.setdefault("yaw_deg", YAW_DEG)
            turned = f" and turned by {press.yaw_deg:.3g} deg"
        said.append(
            f"no place is stated; read off its difference to {untouched[0].file}: at ({x:.2f}, {y:.2f}) mm"
            f"{turned}, give or take {stated['centre_mm']:g} mm"
        )
    if wanted.range_mm is not None:
        low, high = wanted.range_mm
        depth = round(float(np.clip(press.stated_depth_mm, low, high)), 4)
        fields["depth_mm"] = depth
        stated["depth_mm"] = round((high - low) / OF_RANGE, 4)
        why = "as stated" if frame.depth_range_mm else "from the thickness of the gel"
        said.append(
            f"its depth is not known; {depth:.2g} mm fits the picture best, between {low:.2g} and {high:.2g} "
            f"mm ({why}) it is free: what goes with depth, as contact, thickness and scale do, has wider "
            "intervals"
        )
        fields["depth_range_mm"] = None
    fields["sigma"] = PoseSigma.model_validate(stated)
    return fields, said
