"""A design as the generator sees it: rectangles that shine or reflect, reflectances, smoothing, camera."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.camera import Camera
from designlab.design import Design
from geometries.elastomer import Elastomer
from geometries.leds import Body, Emitter, bodies, emitters

Array = NDArray[np.float64]


class Rectangles(NamedTuple):
    """Flat rectangles: group (n,), centre, unit vectors (n, 3), half sizes (n, 2); mm, sensor frame."""

    group: NDArray[np.int64]
    centre: Array
    normal: Array
    across: Array
    down: Array
    half: Array


class Cells(NamedTuple):
    """Points that stand for pieces of rectangles; area in mm2, `half_down` half the extent downwards."""

    group: NDArray[np.int64]
    centre: Array
    normal: Array
    half_down: Array
    area: Array


@dataclass(frozen=True, eq=False)
class Rig:
    """Everything that decides a picture, free to be changed by an effect."""

    emitters: Rectangles
    boards: Rectangles
    flux_mw: Array
    wavelength_nm: Array
    albedo: Array
    board_reflectance: Array
    mixing: Array
    group_names: tuple[str, ...]
    elastomer: Elastomer
    kernel_length_mm: float
    kernel_m: float
    path_length: int
    camera: Camera
    sensing_area_mm: tuple[float, float]

    @classmethod
    def of(cls, design: Design) -> "Rig":
        """Take a design apart.

        Raises
        ------
        ValueError
            If light refracts in the design, or an LED is not Lambertian: rays are traced through air only.
        """
        if design.optics.light_path != "air":
            raise ValueError(
                "optics.light_path: measurements are generated for light in air only, "
                f"got {design.optics.light_path!r}"
            )
        if not all(design.leds.profile_of(k).is_lambertian for k in range(len(design.leds.groups))):
            raise ValueError("leds.profile: measurements are generated for Lambertian LEDs only")
        if design.elastomer.shape == "freeform":
            raise ValueError(
                "elastomer.shape: measurements are generated for flat gels and domes, got 'freeform'"
            )
        strips, boxes = emitters(design.leds), bodies(design.leds)
        fronts = [np.asarray(box.centre_mm) + box.half_mm[2] * np.asarray(box.normal) for box in boxes]
        return cls(
            emitters=Rectangles(
                np.array([strip.group for strip in strips]),
                np.array([strip.centre_mm for strip in strips]),
                *_axes(strips),
                np.array([(strip.half_width_mm, strip.half_height_mm) for strip in strips]),
            ),
            boards=Rectangles(
                np.array([box.group for box in boxes]),
                np.array(fronts),
                *_axes(boxes),
                np.array([box.half_mm[:2] for box in boxes]),
            ),
            flux_mw=np.array([group.flux_mw for group in design.leds.groups]),
            wavelength_nm=np.array([group.wavelength_nm for group in design.leds.groups]),
            albedo=np.array(design.per_group("membrane_albedo")),
            board_reflectance=np.array(design.per_group("board_reflectance")),
            mixing=design.mixing_matrix,
            group_names=design.group_names,
            elastomer=design.elastomer,
            kernel_length_mm=design.contact.kernel_length_mm,
            kernel_m=design.contact.kernel_m,
            path_length=design.optics.path_length,
            camera=design.camera,
            sensing_area_mm=design.sensing_area_mm,
        )


def _axes(parts: Sequence[Emitter] | Sequence[Body]) -> tuple[Array, Array, Array]:
    """Normals, directions across and down of LED parts, (n, 3) each."""
    return (
        np.array([part.normal for part in parts]),
        np.array([part.across for part in parts]),
        np.array([part.down for part in parts]),
    )


def cells(rectangles: Rectangles, *, spacing_mm: float) -> Cells:
    """Cut rectangles into Gauss-Legendre nodes about `spacing_mm` apart, at least two in each direction.

    The weights of the nodes are the areas of their pieces, so sums over the pieces are integrals over the
    rectangles, exact for integrands that are polynomials of twice the number of nodes.
    """
    pieces = []
    for group, centre, normal, across, down, half in zip(*rectangles, strict=True):
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
            )
        )
    return Cells(*(np.concatenate(parts) for parts in zip(*pieces, strict=True)))
