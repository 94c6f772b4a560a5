"""A rig is a design as the generator sees it: rectangles that shine or reflect, smoothing, camera."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.sensor.camera import Camera
from designlab.sensor.contact import KernelContact, LayerContact
from designlab.sensor.design import Design
from designlab.sensor.led_mounting import seated
from designlab.validation.synthetic.coat import Coat
from designlab.validation.synthetic.elastic_surface import TrueGel
from designlab.validation.synthetic.glass import ImmersedParts
from geometries.elastomer import Elastomer
from geometries.leds import Body, Emitter, LedArray, bodies, emitters, joined_groups


class Rectangles(NamedTuple):
    """Flat rectangles: group (n,), centre, unit vectors (n, 3), half sizes (n, 2); mm, sensor frame."""

    group: NDArray[np.int64]
    centre: Array
    normal: Array
    across: Array
    down: Array
    half: Array


class Cells(NamedTuple):
    """Points that stand for pieces of rectangles.

    `half_down` is half the extent downwards, `area` in mm2, `exponent` that of the cosine law of intensity,
    `rectangle` the number of the rectangle that a piece is cut from.
    """

    group: NDArray[np.int64]
    centre: Array
    normal: Array
    half_down: Array
    area: Array
    exponent: Array
    rectangle: NDArray[np.int64]


@dataclass(frozen=True)
class TrueContact:
    """How the gel is really touched, other than a press states.

    Attributes
    ----------
    tail_share, tail_mm : float
        Height of the gel's bulge at the outline of the contact over the depth, and the length over which it
        decays outside.
    deeper_mm : float
        Depth that every press has beyond its stated one.
    probe_scale, edge_mm : float
        Size of the probe over its stated one, and what the radius of its edges has more than stated.
    wrong : float
        Share to which every probe is of another kind.
    second : tuple of float, optional
        Place (x, y), diameter and depth (mm) of a ball that touches during every press and is not stated.
    """

    tail_share: float = 0.0
    tail_mm: float = 0.7
    deeper_mm: float = 0.0
    probe_scale: float = 1.0
    edge_mm: float = 0.0
    wrong: float = 0.0
    second: tuple[float, float, float, float] | None = None


@dataclass(frozen=True)
class TrueLens:
    """What happens to light between the membrane and the pixels, beyond what the design says of its lens.

    Attributes
    ----------
    radial, magnification : float
        A point imaged at a distance d from the principal point appears at d (1 + magnification + radial r^2),
        r = d over half the diagonal of the full sensor.
    blur_um : float
        Root mean square radius of the blur for each axis, on the plane z = 0.
    corner_loss : float
        Brightness lost at r = 1.
    glare : float
        Share of the light spread all over the picture.
    colour_shift : float
        Red is magnified by this, blue reduced.
    drop : tuple of float, optional
        Centre (x, y), radius, shift (in widths of the picture) of what a drop on the lens covers.
    ghost : float
        Brightness of mirror images of the LEDs over the mean of the picture.
    """

    radial: float = 0.0
    magnification: float = 0.0
    blur_um: float = 0.0
    corner_loss: float = 0.0
    glare: float = 0.0
    colour_shift: float = 0.0
    drop: tuple[float, float, float, float] | None = None
    ghost: float = 0.0


@dataclass(frozen=True)
class Sensor:
    """What happens to light that has arrived on the pixels.

    Attributes
    ----------
    black : tuple of float
        Added to the signal of each channel, share of full scale.
    exponent : float
        Reported value = signal to this power.
    pattern_rms, drift_rms : float
        Spread of the pixels' sensitivities, and of the frames' brightness.
    banding, period_rows : float
        Amplitude of the flicker, and its period in rows of the full sensor.
    smear : float
        Share of the mean of its column that is added to every pixel.
    sag : float
        Share of light lost when all groups are on, for want of current.
    moire : float
        Amplitude of coloured fringes.
    jpeg : float
        Coarseness of a block transform that the picture went through; 0 for none.
    grain_rms, grain_px : float
        Relative grain that a state of the sensor has alone, the same in repeats, and the blur it went through
        (standard deviation, output pixels).
    sampling_rms : float
        Likewise, white and of the size of photon noise: relative at the mean light of a frame.
    """

    black: tuple[float, float, float] = (0.0, 0.0, 0.0)
    exponent: float = 1.0
    pattern_rms: float = 0.0
    drift_rms: float = 0.0
    banding: float = 0.0
    period_rows: float = 400.0
    smear: float = 0.0
    sag: float = 0.0
    moire: float = 0.0
    jpeg: float = 0.0
    grain_rms: float = 0.0
    grain_px: float = 0.0
    sampling_rms: float = 0.0


@dataclass(frozen=True, eq=False)
class Rig:
    """Everything that decides a picture, free to be changed by an effect.

    `face_flux` is the flux of every emitting rectangle over its nominal one, `exponent` that of the cosine
    law of each group's intensity, `turn` the rotation of the camera (3, 3) about its centre of projection;
    `waves` are ripples of the membrane: rows of wave numbers (x, y; 1/mm), amplitude (mm) and phase;
    `grain` is the place (x, y), radius and height (mm) of a grain that lies on the gel; `light_waves` are
    smooth departures of each group's light over the gel, fixed to the housing: (groups, waves) rows of wave
    numbers (x, y; 1/mm), relative amplitude and phase. `carrier` is the number of the board on which each
    emitting rectangle lies; a board has the group of its first.
    """

    emitters: Rectangles
    boards: Rectangles
    carrier: NDArray[np.int64]
    flux_mw: Array
    face_flux: Array
    exponent: Array
    wavelength_nm: Array
    albedo: Array
    board_reflectance: Array
    mixing: Array
    group_names: tuple[str, ...]
    elastomer: Elastomer
    kernel_length_mm: float
    kernel_m: float
    gel: TrueGel
    path_length: int
    camera: Camera
    sensing_area_mm: tuple[float, float]
    coat: Coat
    turn: Array = field(default_factory=lambda: np.eye(3))
    contact: TrueContact = field(default_factory=TrueContact)
    lens: TrueLens = field(default_factory=TrueLens)
    sensor: Sensor = field(default_factory=Sensor)
    waves: Array = field(default_factory=lambda: np.zeros((0, 4)))
    light_waves: Array = field(default_factory=lambda: np.zeros((0, 0, 4)))
    grain: tuple[float, float, float, float] | None = None
    glass: ImmersedParts | None = None
    exposure: float | None = None

    @classmethod
    def of(cls, design: Design) -> "Rig":
        """Take a design apart.

        Raises
        ------
        InfeasibleDesign
            If a part has no shape.
        ValueError
            If an LED's profile is a table, the membrane has a pattern, the gel is freeform, or it is elastic
            and rubs.
        """
        design.require_shapes()
        if design.optics.marker_pitch_mm or design.optics.albedo_image:
            raise ValueError(
                "optics.marker_pitch_mm, optics.albedo_image: measurements are generated for plain membranes"
            )
        if design.elastomer.shape == "freeform":
            raise ValueError(
                "elastomer.shape: measurements are generated for flat gels and domes, got 'freeform'"
            )
        # Of an elastic gel no kernel is used.
        kernel = design.contact if isinstance(design.contact, KernelContact) else KernelContact()
        glass = ImmersedParts.of(design) if design.optics.light_path == "core" else None
        strips: Sequence[Emitter]
        boxes: Sequence[Body]
        boxes, strips = (bodies(design.leds), emitters(design.leds)) if glass is None else seated(design)
        fronts = [np.asarray(box.centre_mm) + box.half_mm[2] * np.asarray(box.normal) for box in boxes]
        return cls(
            emitters=Rectangles(
                np.array([strip.group for strip in strips]),
                np.array([strip.centre_mm for strip in strips]),
                *_axes(strips),
                np.array([(strip.half_width_mm, strip.half_height_mm) for strip in strips]),
            ),
            boards=Rectangles(
                np.array([box.groups[0] for box in boxes]),
                np.array(fronts),
                *_axes(boxes),
                np.array([box.half_mm[:2] for box in boxes]),
            ),
            carrier=np.array([strip.body for strip in strips]),
            flux_mw=design.flux_mw,
            face_flux=np.ones(len(strips)),
            exponent=_exponents(design.leds),
            wavelength_nm=np.array([group.wavelength_nm for group in design.leds.groups]),
            albedo=np.array(design.per_group("membrane_albedo")),
            board_reflectance=np.array(design.per_group("board_reflectance")),
            mixing=design.mixing_matrix,
            group_names=design.group_names,
            elastomer=design.elastomer,
            kernel_length_mm=kernel.kernel_length_mm,
            kernel_m=kernel.kernel_m,
            gel=_gel(design),
            path_length=design.optics.path_length,
            camera=design.camera.unfolded,
            sensing_area_mm=design.sensing_area_mm,
            coat=Coat(
                half_mm=(design.sensing_area_mm[0] / 2, design.sensing_area_mm[1] / 2),
                specular=design.optics.coating_specular,
                roughness=design.optics.coating_roughness,
                transmittance=design.optics.coating_transmittance,
                behind=design.optics.object_reflectance if design.optics.coating_transmittance else 0.5,
                open_air=design.optics.sent_back,
            ),
            glass=glass,
            exposure=design.fixed_exposure,
        )

    def turned(self, angle_deg: float) -> "Rig":
        """Turn the gel, and all that sits on it, about the z axis, counter-clockwise seen by the camera."""
        turn = np.exp(1j * np.radians(angle_deg))
        waves, grain = self.waves.copy(), self.grain
        number = turn * (waves[:, 0] + 1j * waves[:, 1])
        waves[:, 0], waves[:, 1] = number.real, number.imag
        if grain is not None:
            place = turn * complex(*grain[:2])
            grain = (place.real, place.imag, *grain[2:])
        return replace(self, coat=replace(self.coat, turn_deg=angle_deg), waves=waves, grain=grain)

    def light_share(self, x: Array, y: Array) -> Array | float:
        """Light of each group over what its LEDs send to points of the membrane, (groups, points)."""
        if not self.light_waves.size:
            return 1.0
        along_x, along_y, rise, phase = (part[..., None] for part in np.moveaxis(self.light_waves, -1, 0))
        return np.asarray(1 + (rise * np.cos(along_x * x + along_y * y + phase)).sum(axis=1))

    def carried(self, board: int) -> set[int]:
        """Groups whose LEDs a board carries."""
        return set(self.emitters.group[self.carrier == board].tolist())

    @property
    def joined(self) -> list[tuple[int, ...]]:
        """Groups that share boards, and so move together."""
        return joined_groups(self.carried(board) for board in np.unique(self.carrier).tolist())

    @property
    def gel_is_patterned(self) -> bool:
        """Whether a turn of the gel shows."""
        return self.coat.is_patterned or len(self.waves) > 0 or self.grain is not None


def _gel(design: Design) -> TrueGel:
    """How elastic the gel of a design is; of one whose contact is a kernel, how it would be."""
    elastic = isinstance(design.contact, LayerContact)
    contact = design.contact if isinstance(design.contact, LayerContact) else LayerContact()
    if contact.friction:
        raise ValueError(
            "contact.friction: measurements are generated for contacts without friction, "
            f"got {contact.friction:g}"
        )
    thickness_mm = design.elastomer.thickness_mm
    poisson = contact.layer(thickness_mm=thickness_mm).poisson
    return TrueGel(float(elastic), thickness_mm, poisson, contact.skin_length_mm)


def _exponents(leds: LedArray) -> Array:
    """Exponent of each group's cosine law."""
    powers = [leds.profile_of(group).power for group in range(len(leds.groups))]
    if any(power is None for power in powers):
        raise ValueError("leds.profile: measurements are generated for powers of the cosine, got a table")
    return np.array(powers, dtype=float)


def _axes(parts: Sequence[Emitter] | Sequence[Body]) -> tuple[Array, Array, Array]:
    """Normals, directions across and down of LED parts, (n, 3) each."""
    return (
        np.array([part.normal for part in parts]),
        np.array([part.across for part in parts]),
        np.array([part.down for part in parts]),
    )


def cells(rectangles: Rectangles, *, spacing_mm: float, exponent: Array | None = None) -> Cells:
    """Cut rectangles into Gauss-Legendre nodes about `spacing_mm` apart, at least two in each direction.

    The weights of the nodes are the areas of their pieces, so sums over the pieces are integrals over the
    rectangles, exact for integrands that are polynomials of twice the number of nodes. `exponent` holds that
    of each group's cosine law, 1 when absent.
    """
    pieces = []
    for number, (group, centre, normal, across, down, half) in enumerate(zip(*rectangles, strict=True)):
        counts = [max(2, int(np.ceil(2 * length / spacing_mm))) for length in half]
        (u, weight_u), (v, weight_v) = (np.polynomial.legendre.leggauss(count) for count in counts)
        grid_u, grid_v = (grid.ravel() for grid in np.meshgrid(u, v))
        share_u, share_v = (grid.ravel() for grid in np.meshgrid(weight_u / 2, weight_v / 2))
        offset = half[0] * grid_u[:, None] * across + half[1] * grid_v[:, None] * down
        pieces.append(
            Cells(
                np.full(len(offset), group),
                centre + offset,
                np.broadcast_to(normal, offset.shape),
                half[1] * share_v[:, None] * down,
                4 * half[0] * half[1] * share_u * share_v,
                np.full(len(offset), 1.0 if exponent is None else exponent[group]),
                np.full(len(offset), number),
            )
        )
    return Cells(*(np.concatenate(parts) for parts in zip(*pieces, strict=True)))
