"""The camera: where its pixels look, and from linear radiance on the sensor to digital counts."""

from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from designlab.core.types import Array
from designlab.sensor.lens import Distortion, Fisheye, Lens, Pinhole
from designlab.sensor.mirror import Mirror, turned, unfolded
from designlab.sensor.response_curve import Response
from designlab.sensor.spectra import Sensitivity
from geometries.spec import Spec, quantity
from geometries.spectrum import Filter

Coordinate = Annotated[float, Field(ge=-4000.0, le=4000.0)]  # mm: beyond, views are parallel to rounding
Tilt = Annotated[float, Field(ge=-180.0, le=180.0)]  # deg
STEEPEST_TILT_DEG = 45.0  # of the view onto the membrane
WIDEST_PINHOLE_DEG = 170.0
PIXEL_ASPECTS = 0.8, 1.25  # beyond, pictures were stretched rather than pixels made so
UNSAID: tuple[tuple[str, Any], ...] = (
    ("pixel_aspect", 1.0),
    *((name, None) for name in ("mirror", "filter", "exposure_time_ms", "gain_db", "quantum_efficiency")),
)
"""Fields of later versions, at values that change nothing."""
EXPOSING = ("exposure", "exposure_time_ms", "gain_db", "quantum_efficiency")
"""Fields that scale the signal, and change no light."""
CURVE_STEPS = 1024  # signals at which noise behind a response curve is tabulated
DEVIATES = np.linspace(-6.0, 6.0, 241)  # of the Gaussian that stands for noise there


class View(NamedTuple):
    """A rectangle of the full sensor, in its pixels, shown by `columns` x `rows` output pixels."""

    x_px: float
    y_px: float
    width_px: float
    height_px: float
    columns: int
    rows: int

    @classmethod
    def around(cls, places_px: Sequence[tuple[float, float]], columns: int) -> "View":
        """The smallest rectangle of square output pixels around places (column, row), `columns` of them wide.

        Its height is a whole number of rows: it differs by less than half a row from that of the places.
        """
        (left, top), (right, bottom) = np.min(places_px, axis=0), np.max(places_px, axis=0)
        rows = max(1, round(columns * (bottom - top) / (right - left)))
        height_px = (right - left) * rows / columns
        corner = float(left), float((top + bottom - height_px) / 2)
        return cls(*corner, float(right - left), float(height_px), columns, rows)

    def centres(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Column and row on the full sensor of the output pixels' centres, shape (rows, columns)."""
        columns = self.x_px + (np.arange(self.columns) + 0.5) * self.width_px / self.columns
        rows = self.y_px + (np.arange(self.rows) + 0.5) * self.height_px / self.rows
        grid_columns, grid_rows = np.meshgrid(columns, rows)
        return grid_columns, grid_rows

    def finer(self, times: int) -> "View":
        """The same rectangle by more output pixels, `times` as many along each side."""
        return self._replace(columns=self.columns * times, rows=self.rows * times)

    def grown(self, pixels: int, camera: "Camera") -> tuple["View", tuple[slice, slice]]:
        """Widen by up to so many output pixels a side, as far as the sensor goes.

        Returns
        -------
        view, place : View, (slice, slice)
            The wider view, and where this one lies in it (rows, columns).
        """
        across, down = self.width_px / self.columns, self.height_px / self.rows
        left, right, top, bottom = (
            int(np.clip(room // pixel, 0, pixels))
            for room, pixel in (
                (self.x_px, across),
                (camera.width_px - self.x_px - self.width_px, across),
                (self.y_px, down),
                (camera.height_px - self.y_px - self.height_px, down),
            )
        )
        columns, rows = left + self.columns + right, top + self.rows + bottom
        wider = View(
            self.x_px - left * across, self.y_px - top * down, columns * across, rows * down, columns, rows
        )
        return wider, (slice(top, top + self.rows), slice(left, left + self.columns))


class Vignetting(Spec):
    """Fall of brightness from the centre of the picture: cos(t)^power (1 + a1 r^2 + a2 r^4 + a3 r^6).

    t is the angle to the axis (power 4 is the natural law of a simple lens), r the distance from it in
    the picture over half the diagonal of the full sensor.
    """

    cosine_power: float = quantity(0.0, unit="1", ge=0, le=20)
    """Power of the cosine; 4 is natural vignetting."""
    a1: float = quantity(0.0, unit="1", ge=-100, le=100)
    """Coefficient of r^2."""
    a2: float = quantity(0.0, unit="1", ge=-100, le=100)
    """Coefficient of r^4."""
    a3: float = quantity(0.0, unit="1", ge=-100, le=100)
    """Coefficient of r^6."""

    def factor(self, cosine: Array, radius: Array) -> Array:
        """Brightness over that at the centre, from the cosine of t and from r."""
        square = radius**2
        polynomial = 1 + square * (self.a1 + square * (self.a2 + square * self.a3))
        return np.asarray(np.maximum(cosine, 0.0) ** self.cosine_power * polynomial)


class Camera(Spec):
    """Camera with a lens and a noise model. Untilted it looks along -z, image up is +y, image right is +x."""

    position_mm: tuple[Coordinate, Coordinate, Coordinate] = (0.0, 0.0, 30.0)
    """Centre of projection in the sensor frame (mm)."""
    tilt_deg: tuple[Tilt, Tilt] = (0.0, 0.0)
    """Turned about its x axis, so that it looks towards +y, then about its y axis, so that it looks towards
    +x (deg); up to 45 deg, with a mirror behind it."""
    mirror: Mirror | None = None
    """Flat mirror that the camera looks into; its picture is turned back, so that image up is +y."""
    width_px: int = Field(1640, ge=16, le=20000)
    """Columns of the full sensor."""
    height_px: int = Field(1232, ge=16, le=20000)
    """Rows of the full sensor."""
    pixel_aspect: float = quantity(1.0, unit="1", ge=PIXEL_ASPECTS[0], le=PIXEL_ASPECTS[1])
    """Width over height of a pixel: fy over fx of a calibration. Above 1 a circle is more rows high than
    columns wide. The field of view and all lengths in px count columns."""
    horizontal_fov_deg: float = quantity(62.2, unit="deg", gt=1, lt=300)
    """Full horizontal field of view of the full sensor, in air: for a fisheye the true one, distortion
    included; for a pinhole (below 170 deg) that of its focal length, before distortion."""
    lens: Literal["pinhole", "fisheye"] = "pinhole"
    """Projection: perspective, or equidistant as of a fisheye lens."""
    distortion: Distortion = Field(default_factory=lambda: Distortion())
    """OpenCV's coefficients: k1 k2 p1 p2 k3 of a pinhole, k1 to k4 of a fisheye."""
    principal_point_px: tuple[float, float] | None = None
    """Column and row of the full sensor that the axis meets, 0.5 more than OpenCV's cx and cy; the middle
    when absent."""
    vignetting: Vignetting = Field(default_factory=lambda: Vignetting())
    """Fall of brightness towards the corners."""
    focus_mm: float | None = quantity(None, unit="mm", gt=0, le=1e5)
    """Distance of the sharp plane below the lens, in air; all is sharp when absent."""
    aperture_mm: float | None = quantity(None, unit="mm", gt=0, le=100)
    """Diameter of the lens opening (entrance pupil)."""
    f_number: float | None = quantity(None, unit="1", gt=0.3, le=100)
    """Focal length over opening; instead of aperture_mm."""
    focal_length_mm: float | None = quantity(None, unit="mm", gt=0, le=1000)
    """Focal length that f_number refers to."""
    body_radius_mm: float = quantity(4.0, unit="mm", gt=0, le=100)
    """Radius of the lens barrel."""
    sensitivity: Sensitivity | None = None
    """Spectral sensitivity of the channels, from which the design's mixing follows when it is absent: the
    name of a published set, or a table."""
    filter: Filter | None = None
    """Colour filter before the camera: the name of a published one, or a table. It acts through
    camera.sensitivity."""
    exposure: float | None = quantity(None, unit="1", gt=0)
    """Signal as a share of full scale per unit of mixed radiance; chosen automatically from the untouched gel
    when absent."""
    exposure_time_ms: float | None = quantity(None, unit="ms", gt=0, le=1e5)
    """Time for which pixels collect light, instead of `exposure`. With lens opening, quantum_efficiency and
    the fluxes of the LEDs it gives the signal."""
    gain_db: float | None = quantity(None, unit="dB", ge=0, le=60)
    """Gain before the converter: 6.02 dB double the signal and halve the electrons at full scale; 0 when
    absent. Where the exposure is automatic, only the noise changes."""
    quantum_efficiency: float | None = quantity(None, unit="1", gt=0, le=1)
    """Electrons per photon where camera.sensitivity is highest; without one, where mixing is 1. For
    exposure_time_ms."""
    full_well_e: float = quantity(4700.0, unit="e-", gt=10, le=1e7)
    """Photo-electrons at full scale, without gain; sets the photon noise."""
    read_noise_e: float = quantity(5.0, unit="e-", ge=0, le=1e5)
    """Standard deviation of the read noise."""
    black_level: float = quantity(0.0, unit="1", ge=0, lt=1)
    """Signal without light, as a share of full scale."""
    bit_depth: int = Field(10, ge=1, le=16)
    """Bits of the analogue-digital converter."""
    response: Response = Field(default_factory=lambda: Response())
    """Curve between the signal and its quantisation."""

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """Name all fields but later ones that say nothing, so that digests of scenes stay what they were."""
        for name, value in super().__repr_args__():
            if (name, value) not in UNSAID:
                yield name, value

    @model_validator(mode="after")
    def _looks_down(self) -> Self:
        for angle in self._eye[1]:
            if abs(angle) > STEEPEST_TILT_DEG:
                seen = "in the mirror " if self.mirror else ""
                raise ValueError(
                    f"tilt_deg: the camera must look down {seen}within {STEEPEST_TILT_DEG:g} deg, "
                    f"looks {angle:.4g} deg off"
                )
        return self

    @model_validator(mode="after")
    def _lens_can_be_used(self) -> Self:
        foreign = ("k4",) if self.lens == "pinhole" else ("p1", "p2")
        for name in foreign:
            if value := getattr(self.distortion, name):
                raise ValueError(f"distortion.{name}: is no coefficient of a {self.lens} lens, got {value:g}")
        if self.lens == "pinhole" and self.horizontal_fov_deg >= WIDEST_PINHOLE_DEG:
            raise ValueError(
                f"horizontal_fov_deg: must be below {WIDEST_PINHOLE_DEG:g} deg for a pinhole lens, "
                f"got {self.horizontal_fov_deg:g} deg"
            )
        x, y = self.centre_px
        if not (0 <= x <= self.width_px and 0 <= y <= self.height_px):
            raise ValueError(f"principal_point_px: must lie on the sensor, got ({x:g}, {y:g})")
        try:
            _, _, forward = self._own_direction(*self._picture())
        except ValueError as error:
            raise ValueError(f"distortion: must be invertible over the picture; {error}") from None
        if self.vignetting.cosine_power > 0 and forward.min() <= 0:
            raise ValueError(
                "vignetting.cosine_power: must be 0 where the picture reaches 90 deg from the axis, "
                f"got {self.vignetting.cosine_power:g}"
            )
        radius = np.linspace(0.0, float(self._radius(*self._picture()).max()), 1001)
        darkest = float(self.vignetting.factor(np.ones(1), radius).min())
        if darkest <= 0:
            raise ValueError(
                f"vignetting: must stay above 0 over the picture, its polynomial falls to {darkest:.3g}"
            )
        return self

    @model_validator(mode="after")
    def _exposure_is_complete(self) -> Self:
        if self.exposure_time_ms is None:
            return self
        if self.exposure is not None:
            raise ValueError("exposure_time_ms: give it or exposure, got both")
        if self.quantum_efficiency is None:
            raise ValueError("quantum_efficiency: needed with exposure_time_ms, is absent")
        if self.opening_mm is None:
            raise ValueError(
                "aperture_mm: it, or f_number with focal_length_mm, is needed with exposure_time_ms; absent"
            )
        return self

    @model_validator(mode="after")
    def _focus_is_complete(self) -> Self:
        if (self.f_number is None) != (self.focal_length_mm is None):
            missing = "focal_length_mm" if self.focal_length_mm is None else "f_number"
            raise ValueError(f"{missing}: f_number and focal_length_mm go together, got only one")
        if self.f_number is not None and self.aperture_mm is not None:
            raise ValueError("aperture_mm: give it or f_number with focal_length_mm, got both")
        if self.focus_mm is not None and self.opening_mm is None:
            raise ValueError("focus_mm: needs aperture_mm, or f_number and focal_length_mm, got neither")
        return self

    @property
    def _eye(self) -> tuple[tuple[float, float, float], tuple[float, float]]:
        """Place and tilt from which the camera sees, behind its mirror if it has one."""
        if self.mirror is None:
            return self.position_mm, self.tilt_deg
        return unfolded(self.position_mm, self.tilt_deg, self.mirror)

    @property
    def eye_mm(self) -> tuple[float, float, float]:
        """Centre of projection from which the picture is seen (mm): behind the mirror, if there is one."""
        return self._eye[0]

    @property
    def eye_tilt_deg(self) -> tuple[float, float]:
        """Tilt that belongs to `eye_mm`, as `tilt_deg`."""
        return self._eye[1]

    @property
    def unfolded(self) -> "Camera":
        """The camera that sees the same picture without a mirror; itself where it has none."""
        if self.mirror is None:
            return self
        place, tilt = self._eye
        return self.model_copy(update={"position_mm": place, "tilt_deg": tilt, "mirror": None})

    @property
    def focal_px(self) -> float:
        """Focal length in columns of the full sensor (fx), at the centre of the picture."""
        half = np.radians(self.horizontal_fov_deg) / 2
        if self.lens == "fisheye":
            return self.width_px / 2 / Fisheye(self.distortion).distance(float(half))
        return self.width_px / 2 / float(np.tan(half))

    @property
    def focal_rows_px(self) -> float:
        """Focal length in rows of the full sensor (fy), at the centre of the picture."""
        return self.focal_px * self.pixel_aspect

    @property
    def pixel_sr(self) -> float:
        """Solid angle that a pixel of the full sensor sees at the centre of the picture, in air."""
        return 1.0 / (self.focal_px * self.focal_rows_px)

    @property
    def gain(self) -> float:
        """Factor of `gain_db` on the signal."""
        return 1.0 if self.gain_db is None else float(10.0 ** (self.gain_db / 20))

    @property
    def full_scale_e(self) -> float:
        """Photo-electrons at full scale, gain included."""
        return self.full_well_e / self.gain

    @property
    def half_diagonal_px(self) -> float:
        """Half the diagonal of the full sensor, in widths of a pixel."""
        return float(np.hypot(self.width_px, self.height_px / self.pixel_aspect)) / 2

    def radius_px(self, column: Array, row: Array) -> Array:
        """Distance of places on the full sensor from the axis of the lens, in widths of a pixel."""
        x_c, y_c = self.centre_px
        return np.asarray(np.hypot(column - x_c, (row - y_c) / self.pixel_aspect))

    @property
    def centre_px(self) -> tuple[float, float]:
        """Column and row of the full sensor that the axis of the lens meets."""
        return self.principal_point_px or (self.width_px / 2, self.height_px / 2)

    @property
    def is_plain(self) -> bool:
        """Whether the projection is a perspective along -z on square pixels, without distortion."""
        undistorted = self.lens == "pinhole" and self.distortion == Distortion()
        return undistorted and self.eye_tilt_deg == (0.0, 0.0) and self.pixel_aspect == 1.0

    @property
    def opening_mm(self) -> float | None:
        """Diameter of the lens opening, where it is stated."""
        if self.f_number is not None and self.focal_length_mm is not None:
            return self.focal_length_mm / self.f_number
        return self.aperture_mm

    @property
    def defocus(self) -> tuple[float, float] | None:
        """Radius of the opening and distance of the sharp plane (mm); None where all is sharp."""
        if self.focus_mm is None or self.opening_mm is None:
            return None
        return self.opening_mm / 2, self.focus_mm

    @property
    def _unit_lens(self) -> Lens:
        return Pinhole(self.distortion) if self.lens == "pinhole" else Fisheye(self.distortion)

    def _picture(self) -> tuple[Array, Array]:
        """Places all over the full sensor, its outline and corners among them (px)."""
        across, down = np.linspace(0, self.width_px, 33), np.linspace(0, self.height_px, 33)
        column, row = np.meshgrid(across, down)
        return column, row

    def project(
        self,
        right: NDArray[np.floating] | float,
        up: NDArray[np.floating] | float,
        forward: NDArray[np.floating] | float = 1.0,
    ) -> tuple[Array, Array]:
        """Where light from a direction falls on the full sensor.

        Parameters
        ----------
        right, up, forward : array or float
            Components of the direction from the camera, along the sensor frame's x, y and -z, on any common
            scale. With `forward` left at 1, the others are tangents of angles to -z.

        Returns
        -------
        column, row : array
            Fractional; pixel centres lie at .5. Not a number where a pinhole cannot look. Directions beyond
            the range in which the lens can be inverted are continued outward, outside the picture.
        """
        seen = np.broadcast_arrays(*(np.asarray(c, dtype=float) for c in (right, up, forward)))
        x, y, z = seen if self._turn is None else np.einsum("ab,b...->a...", self._turn.T, np.stack(seen))
        seen_x, seen_y = self._unit_lens.image(x, -y, z)
        x_c, y_c = self.centre_px
        return x_c + self.focal_px * seen_x, y_c + self.focal_rows_px * seen_y

    def unproject(
        self, column: NDArray[np.floating] | float, row: NDArray[np.floating] | float
    ) -> tuple[Array, Array, Array]:
        """Direction that a place on the full sensor sees.

        Parameters
        ----------
        column, row : array or float
            Fractional; pixel centres lie at .5.

        Returns
        -------
        right, up, forward : array
            Components along the sensor frame's x, y and -z. The `forward` of an untilted pinhole is 1, so
            that the others are tangents; a fisheye's direction has unit length.

        Raises
        ------
        ValueError
            If the lens shows no direction there (never inside the picture).
        """
        own = self._own_direction(column, row)
        if self._turn is None:
            return own
        right, up, forward = np.einsum("ab,b...->a...", self._turn, np.stack(own))
        return right, up, forward

    def _own_direction(
        self, column: NDArray[np.floating] | float, row: NDArray[np.floating] | float
    ) -> tuple[Array, Array, Array]:
        """Direction that a place sees, along the camera's own right, up and axis."""
        columns, rows = np.broadcast_arrays(np.asarray(column, dtype=float), np.asarray(row, dtype=float))
        x_c, y_c = self.centre_px
        right, down, forward = self._unit_lens.direction(
            (columns - x_c) / self.focal_px, (rows - y_c) / self.focal_rows_px
        )
        return right, -down, forward

    @property
    def _turn(self) -> Array | None:
        """Rotation from the camera's own right, up and axis to x, y and -z; None where it is not tilted."""
        if self.eye_tilt_deg == (0.0, 0.0):
            return None
        return turned(self.eye_tilt_deg)

    def vignette(self, view: View) -> Array:
        """Brightness of every output pixel over that at the centre of the picture, shape (rows, columns)."""
        column, row = view.centres()
        right, up, forward = self._own_direction(column, row)
        cosine = forward / np.sqrt(right**2 + up**2 + forward**2)
        return self.vignetting.factor(cosine, self._radius(column, row))

    def _radius(self, column: Array, row: Array) -> Array:
        """Distance from the axis of the lens over half the diagonal of the full sensor."""
        return np.asarray(self.radius_px(column, row) / self.half_diagonal_px)

    def full_view(self) -> View:
        """The whole sensor at its own resolution."""
        return View(0.0, 0.0, float(self.width_px), float(self.height_px), self.width_px, self.height_px)

    def pixel_noise(self, signal: Array, binned: float) -> Array:
        """Standard deviation of photon and read noise of a linear signal, black level included.

        Parameters
        ----------
        signal : array
            As a share of full scale.
        binned : float
            Sensor pixels averaged into one output pixel.
        """
        electrons = np.clip(signal - self.black_level, 0.0, None) * self.full_scale_e * binned
        return np.asarray(np.sqrt(electrons + self.read_noise_e**2 * binned) / (self.full_scale_e * binned))

    def behind_curve(
        self, signal: NDArray[np.floating], curve: Callable[[Array], Array] | None = None
    ) -> tuple[Array, Array]:
        """Mean and standard deviation of one sensor pixel behind a curve, before quantisation.

        The curve's slope alone would not do: near black a gamma curve is steeper than the noise is small. So
        the Gaussian of photon and read noise is integrated over the curve, clipping included.

        Parameters
        ----------
        signal : array
            Linear signal as a share of full scale, black level included.
        curve : callable, optional
            The curve, from signals to answers of the same shape; the response when absent.
        """
        levels = 1.2 * np.linspace(0.0, 1.0, CURVE_STEPS) ** 2
        weights = np.exp(-(DEVIATES**2) / 2)
        weights /= weights.sum()
        answers = (curve or self.response.encode)(
            levels[:, None] + self.pixel_noise(levels, 1.0)[:, None] * DEVIATES
        )
        mean = answers @ weights
        sigma = np.sqrt(((answers - mean[:, None]) ** 2) @ weights)
        return np.interp(signal, levels, mean), np.interp(signal, levels, sigma)
