"""From a measurement to what a model can be compared with: linear signals, their noise, poses and splits."""

from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from designlab.core.types import Array, Mask
from designlab.measurement.depths import by_circle
from designlab.measurement.frames import FULL_SCALE, MeasuredFrame, Measurement, MeasurementError, alike
from designlab.measurement.light import ball_of
from designlab.measurement.light_probe.ball import LightProbe
from designlab.measurement.sizes import check_leds
from designlab.mechanics.contact import NotConverged
from designlab.sensor.camera import View
from designlab.sensor.design import Design
from designlab.simulation.contact.press import Press
from designlab.simulation.imaging import Capture, noise_sigma
from geometries.probes import Probe

Use = Literal["background", "light_probe", "train", "select", "final", "dark"]

POSE = ("x_mm", "y_mm", "depth_mm", "yaw_deg")
DEFAULT_SIGMA = (0.1, 0.1, 0.05, 1.0)  # mm, mm, mm, deg: a press placed by hand, where the set states nothing
DEFAULT_FORCE_SHARE = 0.05  # of a force, whose doubt the set does not state
ROUND = ("sphere", "cone")  # probes of revolution look the same at every yaw
PROBE_COLUMNS = 160  # of a light probe
BURIED = 0.02  # of the stated variance of dark values: less is no noise but a cut
APART_PX = 4
LEAST_LIGHT = 0.01  # of full scale, that rounding is compared with
LEFT_OUT = {
    "flat_field": "a flat_field frame shows lens and camera alone, not the sensor's light",
    "light_probe": "a light_probe frame shows the light without the gel: it is for calibrate",
}
CLIPPED_SHARE = 0.02  # of dark values at zero, above which the camera is taken to clip there


@dataclass(frozen=True, eq=False)
class Shot:
    """One thing that was photographed; repeats are averaged.

    Attributes
    ----------
    files : tuple of str
        The frames averaged.
    rounding : float
        Error that rounding to whole counts leaves, relative to the light, in the median.
    press : Press or None
        Nominal indentation; None for the untouched gel.
    pose_sigma : array, shape (4,)
        Prior standard deviations of x, y, depth (mm) and yaw (deg); zero where fixed, as the depth of a press
        by force is.
    lit : array, shape (groups,)
        Relative exposure times whether a group is on.
    signal, variance : array, shape (rows, columns, 3)
        Linear signal above the black level and its variance, as shares of full scale.
    photon : array, shape (3,)
        By how much the variance rises with the signal.
    valid : bool array, shape (rows, columns, 3)
        Values that are not saturated.
    dark_sigma : array, shape (3,)
        Noise of counts without light, as a share of full scale.
    ball : LightProbe or None
        Of a light probe: the ball in the place of the gel; its pose is x, y and lowest point.
    gel_rotation_deg : float
        By how much the gel is turned against the rest.
    clips : tuple of 3 bool
        Channels that are seen to be clipped at zero.
    force_n, force_sigma_n : float
        Measured force of a press whose depth is known too, and its standard deviation (N); infinite where
        it was not measured.
    """

    files: tuple[str, ...]
    use: Use
    press: Press | None
    pose_sigma: Array
    lit: Array
    view: View
    signal: Array
    variance: Array
    valid: Mask
    dark_sigma: Array
    ball: LightProbe | None = None
    gel_rotation_deg: float = 0.0
    clips: tuple[bool, bool, bool] = (False, False, False)
    force_n: float = 0.0
    force_sigma_n: float = np.inf
    photon: Array = field(default_factory=lambda: np.zeros(3))
    rounding: float = 0.0

    def variance_at(self, signal: Array) -> Array:
        """Variance where the signal is what a model says, (rows, columns, 3).

        Weights by the noisy signal itself favour values that noise has lowered, and bias a fit by that.
        """
        return np.asarray(
            self.variance + self.photon * (np.maximum(signal, 0.0) - np.maximum(self.signal, 0.0))
        )

    @property
    def clip_sigma(self) -> Array:
        """Noise without light of channels clipped at zero, zero of others, shape (3,)."""
        return np.where(self.clips, self.dark_sigma, 0.0)


@dataclass(frozen=True)
class Observations:
    """All shots, where their noise is known from, and what was left out or weakens the result."""

    shots: tuple[Shot, ...]
    black_level: Array
    noise_source: str
    repeats: bool
    dark: bool
    notes: tuple[str, ...]

    def of(self, *uses: Use) -> list[int]:
        """Numbers of the shots of some uses."""
        return [number for number, shot in enumerate(self.shots) if shot.use in uses]

    @property
    def presses(self) -> list[Press]:
        """What was pressed, shot by shot."""
        return [shot.press for shot in self.shots if shot.press is not None]


class _Noise(NamedTuple):
    """Variance of a value: `read` + `photon` times signal, for each channel."""

    read: Array
    photon: Array


def observe(
    measurement: Measurement,
    design: Design,
    *,
    columns: int,
    light_probes: bool = False,
    apart: bool = False,
) -> Observations:
    """Check the measurement chain and gather the shots.

    Parameters
    ----------
    measurement : Measurement
        A loaded measurement folder.
    design : Design
        The sensor it is compared with; says which part of the camera's sensor a frame shows.
    columns : int
        Wider frames are binned by a whole number to at most this many columns.
    light_probes : bool
        Whether to gather light probes too; they are left out otherwise.
    apart : bool
        Whether every frame is a shot of its own, dark frames and a turned gel among them, with all that lies
        under its light; otherwise repeats are averaged and the black level is subtracted.

    Raises
    ------
    MeasurementError
        If the response is unknown, or no frame with LEDs on can be used; the text says which and why.
    """
    require_response(measurement)
    notes: list[str] = []
    usable = [
        frame
        for frame in measurement.frames
        if _usable(measurement, frame, design, light_probes, notes, turned=apart)
    ]
    for frame in usable:
        check_leds(measurement, frame, design)
    if not any(frame.lit for frame in usable):
        reasons = "; ".join(dict.fromkeys(notes)) or "all LEDs are off in every frame"
        raise MeasurementError(
            f"{measurement.folder}: field frame: none with LEDs on can be used ({reasons})"
        )
    black, has_dark = _black_level(measurement, usable, design, notes)
    noise, source, repeats = _noise(measurement, usable, design, notes)
    uses = {frame.file: use for use, frames in measurement.split().items() for frame in frames}
    shots = []
    together = [[f] for f in usable] if apart else alike(f for f in usable if f.lit)
    for same in together:
        use: Use = uses.get(same[0].file, "background" if same[0].lit else "dark")
        if same[0].kind == "light_probe":
            use = "light_probe"
        shot = _shot(measurement, same, design, use, black, noise, columns, notes)
        # The black level is put back under the signal where all light is wanted.
        shots.append(replace(shot, signal=shot.signal + black) if apart else shot)
    notes += _saturated(shots)
    return Observations(tuple(shots), black, source, repeats, has_dark, tuple(dict.fromkeys(notes)))


def within(mask: Mask | None, shots: tuple[Shot, ...]) -> tuple[Shot, ...]:
    """Take values outside a mask of the files' pixels for not valid.

    Raises
    ------
    ValueError
        If the mask has not the size of a shot's files.
    """
    if mask is None:
        return shots
    found = []
    for shot in shots:
        factor = mask.shape[0] // shot.signal.shape[0]
        kept = binned(mask.astype(float)[..., None], factor) == 1.0
        if kept.shape[:2] != shot.signal.shape[:2]:
            raise ValueError(f"mask: must have the size of {shot.files[0]}, got {mask.shape}")
        found.append(replace(shot, valid=shot.valid & kept))
    return tuple(found)


def require_response(measurement: Measurement) -> None:
    """Refuse a set of unknown response.

    Raises
    ------
    MeasurementError
        With the remedy.
    """
    if measurement.response == "unknown":
        raise MeasurementError(
            f"{measurement.folder}: field response: must be known, since linear light is compared; "
            "remedy: linear for raw files, srgb for JPEG and PNG made for eyes, or `designlab import` with "
            "an exposure ladder"
        )


def _saturated(shots: list[Shot]) -> list[str]:
    """Say how much is left out for saturation."""
    shares = {shot.files[0]: 1 - float(shot.valid.mean()) for shot in shots if not shot.valid.all()}
    if not shares:
        return []
    worst = max(shares, key=lambda file: shares[file])
    others = f", less of {len(shares) - 1} other frames" if len(shares) > 1 else ""
    return [f"{worst}: {shares[worst]:.1%} of the values are saturated and left out{others}"]


def _usable(
    measurement: Measurement,
    frame: MeasuredFrame,
    design: Design,
    light_probes: bool,
    notes: list[str],
    *,
    turned: bool,
) -> bool:
    """Whether a frame can be simulated; if not, a note says why."""
    if frame.kind == "flat_field" or (frame.kind == "light_probe" and not light_probes):
        notes.append(f"{frame.file}: left out, {LEFT_OUT[frame.kind]}")
        return False
    if frame.gel_rotation_deg and not turned:
        notes.append(f"{frame.file}: left out, pictures of a turned gel are used by gap diagnose only")
        return False
    if measurement.image(frame).shape[-1] != 3:
        notes.append(f"{frame.file}: left out, it has no three colour channels")
        return False
    if frame.crop_px is None:
        notes.append("frames without crop_px are taken to show the whole sensor")
    if frame.kind == "press":
        try:
            press, _ = press_of(measurement, frame, design)
        except (ValueError, NotConverged) as error:
            notes.append(f"{frame.file}: left out, {error}")
            return False
        if press is not None and press.depth_mm is None and design.contact.model == "kernel":
            notes.append(
                f"{frame.file}: left out, its depth_mm is unknown and contact by the smoothing kernel knows "
                "no force: use a design with contact.model = 'layer', or state depth_mm or depth_range_mm "
                "in place of force_n"
            )
            return False
    return True


def _black_level(
    measurement: Measurement, frames: list[MeasuredFrame], design: Design, notes: list[str]
) -> tuple[Array, bool]:
    """Level of the dark frames for each channel, else the black level of the camera's description."""
    dark = [measurement.linear(frame).astype(float) for frame in frames if not frame.lit]
    if not dark:
        notes.append(
            "no frame with the LEDs off: the black level is the camera's stated one, and an additive "
            "floor cannot be told from other effects"
        )
        return np.full(3, design.camera.black_level), False
    return _dark_levels(dark), True


def _dark_levels(dark: list[Array]) -> Array:
    """Level of each channel over dark frames, which may show different crops."""
    values = np.concatenate([frame.reshape(-1, 3) for frame in dark])
    return np.array([_dark_level(values[:, channel]) for channel in range(3)])


def _dark_level(values: Array) -> float:
    """Mean of dark values; their median where counts are clipped at zero, for the cut moves the mean."""
    return float(np.median(values) if _clipped(values) else values.mean())


def _clipped(values: Array) -> bool:
    """Whether values are cut at zero; where a black level was subtracted, some are below."""
    return bool((values <= 0).mean() > CLIPPED_SHARE and values.min() >= 0)


def _read_variance(values: Array) -> float:
    """Variance of dark values (rows, columns)."""
    level = _dark_level(values)
    if _clipped(values):
        above = values[values > level] - level
        return float((above**2).mean()) if above.size else 0.0
    # Half the squared difference of neighbours: blind to a floor that varies slowly across the picture.
    return float((np.diff(values, axis=1) ** 2).mean() / 2)


def _noise(
    measurement: Measurement, frames: list[MeasuredFrame], design: Design, notes: list[str]
) -> tuple[_Noise, str, bool]:
    """Variance as read plus photon noise: from repeats, or from the camera's description without any."""
    # A probe that was put there again stands elsewhere by a little, which is no noise of the pixels.
    still = (frame for frame in frames if frame.lit and frame.kind != "press")
    pairs = [group for group in alike(still) if len(group) > 1]
    dark = [measurement.linear(frame).astype(float) for frame in frames if not frame.lit]
    first = next(frame for frame in frames if frame.lit)
    view = measurement.view(first, design)
    binned = view.width_px / view.columns * view.height_px / view.rows
    camera = design.camera
    stated = float(noise_sigma(np.zeros(1), Capture(camera, binned=binned))[0]) ** 2
    read = np.full(3, stated)
    black = np.full(3, camera.black_level)
    if dark:
        found = [[_read_variance(frame[..., channel]) for channel in range(3)] for frame in dark]
        measured = np.mean(found, axis=0)
        # A black level below zero leaves nothing of the dark noise to see.
        read, black = np.where(measured < BURIED * stated, stated, measured), _dark_levels(dark)
    if not pairs:
        notes.append(
            "no repeated frames: the noise is that of the camera's description, so the floor is assumed"
        )
        return _Noise(read, np.full(3, 1.0 / (camera.full_scale_e * binned))), "camera description", False
    variance, level = np.zeros(3), np.zeros(3)
    for group in pairs:
        stack = np.stack([measurement.linear(frame).astype(float) for frame in group])
        used = stack.max(axis=(0, -1)) < FULL_SCALE
        # Drift of the whole level between repeats is not noise of the pixels.
        levels = np.maximum(stack.mean(axis=(1, 2)), 1e-9)
        stack *= (levels.mean(axis=0) / levels)[:, None, None, :]
        variance += _spread(stack, used)
        level += (stack.mean(axis=0)[used] - black).mean(axis=0)
    photon = np.maximum(variance - len(pairs) * read, 0.0) / np.maximum(level, 1e-9)
    return _Noise(read, photon), "repeated frames", True


def _spread(stack: Array, used: Mask) -> Array:
    """Variance of the noise of repeated frames (frames, rows, columns, 3), for each channel.

    From differences along the rows, further apart than demosaicing reaches: bands that lie elsewhere in every
    frame are no noise of the pixels.
    """
    left = stack - stack.mean(axis=0)
    both = used[:, APART_PX:] & used[:, :-APART_PX]
    differences = (left[:, :, APART_PX:] - left[:, :, :-APART_PX])[:, both]
    return np.asarray((differences**2).mean(axis=1).sum(axis=0) / 2 / (len(stack) - 1))


def _shot(
    measurement: Measurement,
    same: list[MeasuredFrame],
    design: Design,
    use: Use,
    black: Array,
    noise: _Noise,
    columns: int,
    notes: list[str],
) -> Shot:
    frame = same[0]
    ball = ball_of(measurement, frame) if frame.kind == "light_probe" else None
    raw = np.mean([measurement.linear(f).astype(float) for f in same], axis=0)
    saturated = np.max([measurement.image(f) for f in same], axis=0) >= FULL_SCALE
    signal = raw - black
    variance = (noise.read + noise.photon * np.maximum(signal, 0.0)) / len(same)
    images = np.stack([measurement.image(f).astype(float) for f in same])
    # A few zeros in the darkest walls tell it too: the noise there is cut.
    red, green, blue = (bool((images >= 0).all() and (images[..., c] == 0).any()) for c in range(3))
    clips, dark_sigma = (red, green, blue), np.sqrt(noise.read)
    view = measurement.view(frame, design)
    # A ball mirrors LEDs with sharp edges, whose light coarse pixels do not hold.
    rounding = measurement.rounding(frame)
    factor = int(np.ceil(view.columns / (columns if ball is None else max(columns, PROBE_COLUMNS))))
    if factor > 1:
        notes.append(f"frames are binned {factor} x {factor} to at most {columns} columns")
    signal, valid = binned(signal, factor), binned(saturated.astype(float), factor) == 0
    variance = binned(variance, factor) / factor**2
    rows, width = signal.shape[:2]
    scale_x, scale_y = view.width_px / view.columns * factor, view.height_px / view.rows * factor
    view = view._replace(width_px=width * scale_x, height_px=rows * scale_y, columns=width, rows=rows)
    exposure = 1.0 if frame.exposure is None else frame.exposure
    on = [name in frame.leds if frame.leds is not None else True for name in design.group_names]
    press, doubt = press_of(measurement, frame, design) if ball is None else (None, None)
    sigma = np.zeros(4) if press is None else _pose_sigma(frame, press.probe, notes)
    if press is not None and doubt is not None:
        sigma[2] = doubt
        notes.append(
            f"{frame.file}: its depth is that of the contact circle, {press.stated_depth_mm:.3g} mm, give or "
            f"take {doubt:.2g}"
        )
    if ball is not None:
        sigma = _ball_sigma(frame, notes)
    lit = exposure * np.array(on, dtype=float)
    files = tuple(f.file for f in same)
    turn = frame.gel_rotation_deg or 0.0
    shot = Shot(
        files, use, press, sigma, lit, view, signal, variance, valid, dark_sigma, ball, turn, clips,
        photon=noise.photon / len(same) / factor**2,
        rounding=float(np.median(rounding / np.maximum(raw - black, LEAST_LIGHT))) / factor,
    )  # fmt: skip
    if frame.force_n is None or frame.depth_mm is None:
        return shot
    if design.contact.model == "kernel":
        notes.append(f"{frame.file}: its force_n is not used, contact by the smoothing kernel knows no force")
        return shot
    return replace(shot, force_n=frame.force_n, force_sigma_n=force_sigma_n(frame, frame.force_n, notes))


def binned(values: Array, factor: int) -> Array:
    """Average squares of `factor` x `factor` pixels; what fills no square at the right and bottom is cut."""
    if factor == 1:
        return values
    rows, columns = values.shape[0] // factor, values.shape[1] // factor
    cut = values[: rows * factor, : columns * factor]
    return np.asarray(cut.reshape(rows, factor, columns, factor, -1).mean(axis=(1, 3)))


def press_of(
    measurement: Measurement, frame: MeasuredFrame, design: Design
) -> tuple[Press | None, float | None]:
    """Press that a frame shows, and the doubt of its depth where the circle read off the image tells it.

    Raises
    ------
    ValueError, NotConverged
        If it cannot be simulated.
    """
    press, radius_mm = measurement.press(frame), measurement.contact_radius_mm(frame)
    if press is None or radius_mm is None or frame.depth_mm is not None or frame.force_n is not None:
        return press, None
    press, doubt = by_circle(press, design, radius_mm)
    stated = None if frame.sigma is None else frame.sigma.depth_mm
    return press, doubt if stated is None else stated


def _pose_sigma(frame: MeasuredFrame, probe: Probe, notes: list[str]) -> Array:
    stated = frame.sigma
    centre, depth, yaw = (
        (None, None, None) if stated is None else (stated.centre_mm, stated.depth_mm, stated.yaw_deg)
    )
    sigma = [
        default if given is None else given
        for given, default in zip((centre, centre, depth, yaw), DEFAULT_SIGMA, strict=True)
    ]
    if frame.depth_mm is None:
        depth = sigma[2] = 0.0
    if centre is None or depth is None:
        taken = f"{DEFAULT_SIGMA[0]:g} mm" + (
            "" if frame.depth_mm is None else f" and {DEFAULT_SIGMA[2]:g} mm in depth"
        )
        notes.append(f"{frame.file}: how well the pose is known is not stated; taken as {taken}")
    if probe.kind in ROUND:
        sigma[3] = 0.0
    elif frame.yaw_deg is None:
        notes.append(f"{frame.file}: the yaw of the probe is unknown and taken as 0 deg with 1 deg of doubt")
    return np.array(sigma, dtype=float)


def force_sigma_n(frame: MeasuredFrame, force_n: float, notes: list[str]) -> float:
    """Doubt of a measured force (N); a note says where it is not stated."""
    if frame.sigma is not None and frame.sigma.force_n is not None:
        return frame.sigma.force_n
    notes.append(
        f"{frame.file}: how well force_n is known is not stated; taken as {DEFAULT_FORCE_SHARE:.0%} of it"
    )
    return DEFAULT_FORCE_SHARE * force_n


def _ball_sigma(frame: MeasuredFrame, notes: list[str]) -> Array:
    """Doubt of a ball's x, y and lowest point; the last is taken as right where nothing is stated."""
    centre = None if frame.sigma is None else frame.sigma.centre_mm
    depth = None if frame.sigma is None else frame.sigma.depth_mm
    if centre is None:
        centre = DEFAULT_SIGMA[0]
        notes.append(
            f"{frame.file}: how well the ball's place is known is not stated; taken as {centre:g} mm"
        )
    return np.array([centre, centre, depth or 0.0, 0.0])
