"""Probe pressed into a bonded elastic block and dragged sideways, by finite elements in three dimensions.

It shares nothing with the elastic layer of `designlab.mechanics`: the block ends at free sides, and is solved
in space. Displacements are quadratic and pressures linear on hexahedra (Taylor and Hood), so that a gel which
keeps its volume does not lock. Strains are small. Nodes of the top touch a rigid probe without adhesion;
there they stick to it, or slide with a drag in proportion to their pressure (Coulomb).

A program and not a part of the library, as scikit-fem is installed for development only.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from finite_elements import graded
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator
from scipy.sparse import bmat, csc_matrix
from scipy.sparse.linalg import splu
from skfem import Basis, BilinearForm, ElementHex1, ElementHex2, ElementVector, MeshHex
from skfem.helpers import ddot, div, sym_grad

Array = NDArray[np.float64]

GROWTH = 2.0  # of the elements away from the probe
MOST_CHANGES = 60  # of the contact, until its nodes stay the same
SETTLED = 15  # changes, after which a node that left the probe stays away
TOUCH = 1e-9  # mm, within which a node touches
FOLLOWED = 4  # steps from where a point is to where it was
BETWEEN = 5  # points for one node, of the top as it is looked at
AT_ONCE = 64  # loads that are solved for together


@dataclass(frozen=True)
class Block:
    """Block of modulus 1 MPa on a rigid base, its sides free; lengths in mm."""

    thickness_mm: float
    width_mm: float = 20.0
    length_mm: float = 16.0
    poisson: float = 0.49


class Dragged(NamedTuple):
    """A block under a probe.

    Attributes
    ----------
    force_n : array, shape (3,)
        Of the probe on the gel: right, up, and into the block.
    moved_mm : array, shape (3, x, y)
        Displacement of the top's nodes, likewise.
    touching : bool array, shape (near,)
        Which of the nodes that may touch do.
    """

    force_n: Array
    moved_mm: Array
    touching: NDArray[np.bool_]


@BilinearForm
def _stiffness(u: Any, v: Any, w: Any) -> Any:
    return 2 * ddot(sym_grad(u), sym_grad(v))


@BilinearForm
def _volume(u: Any, q: Any, w: Any) -> Any:
    return div(u) * q


@BilinearForm
def _mass(p: Any, q: Any, w: Any) -> Any:
    return p * q


class LoadedBlock:
    """A block, and how its top gives way to forces on the nodes around one place.

    Parameters
    ----------
    block : Block
        The block.
    centre_mm : (float, float)
        Place of the probe, from the middle of the block.
    reach_mm : float
        Distance from it within which nodes may touch.
    fine_mm : float
        Side of the elements there; nodes are half as far apart.
    """

    def __init__(
        self, block: Block, *, centre_mm: tuple[float, float], reach_mm: float, fine_mm: float
    ) -> None:
        self.block, self.centre_mm, self.spacing_mm = block, centre_mm, fine_mm / 2
        sides = block.width_mm / 2, block.length_mm / 2
        across = [
            np.concatenate(
                [
                    at - graded(fine_mm, min(reach_mm, end + at), end + at, GROWTH)[:0:-1],
                    at + graded(fine_mm, min(reach_mm, end - at), end - at, GROWTH),
                ]
            )
            for at, end in zip(centre_mm, sides, strict=True)
        ]
        # small at the top, where the load is
        down = (
            block.thickness_mm
            - graded(fine_mm, min(fine_mm, block.thickness_mm), block.thickness_mm, GROWTH)[::-1]
        )
        self.basis = Basis(MeshHex.init_tensor(*across, down), ElementVector(ElementHex2()), intorder=4)
        self.shear_mpa = 1 / (2 * (1 + block.poisson))
        self.system = self._factored()
        places = self.basis.doflocs
        top = np.flatnonzero(places[2] > block.thickness_mm - 1e-9)
        # nodes by x, then y; of each the three directions
        order = np.lexsort((np.arange(len(top)), places[1, top].round(9), places[0, top].round(9)))
        self.top = top[order].reshape(-1, 3)
        x, y = places[:2, self.top[:, 0]]
        self.x_mm, self.y_mm = np.unique(x.round(9)), np.unique(y.round(9))
        self.near = np.flatnonzero(np.hypot(x - centre_mm[0], y - centre_mm[1]) < reach_mm + 1e-9)
        # from the probe
        self.places_mm = np.stack([x, y], axis=1)[self.near] - np.array(centre_mm)
        self.response = self._responses()

    def _factored(self) -> Any:
        """Solver of the block for forces over its shear modulus."""
        pressures = self.basis.with_element(ElementHex1())
        # shear modulus over Lame's first constant; 0 of a gel that keeps its volume
        compliance = (1 - 2 * self.block.poisson) / (2 * self.block.poisson)
        upper, lower = _stiffness.assemble(self.basis), _volume.assemble(self.basis, pressures)
        matrix = bmat([[upper, lower.T], [lower, -compliance * _mass.assemble(pressures)]], format="csr")
        held = self.basis.get_dofs(lambda at: at[2] < 1e-9).all()
        self.free = np.setdiff1d(np.arange(matrix.shape[0]), held)
        return splu(
            csc_matrix(matrix[self.free][:, self.free]),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.01,
            options={"SymmetricMode": True},
        )

    def _responses(self) -> Array:
        """Displacement of the top's nodes by forces on those near the probe (mm/N), (top, 3, near, 3)."""
        loaded = np.searchsorted(self.free, self.top[self.near].ravel())
        wanted = np.searchsorted(self.free, self.top.ravel())
        found = np.empty((len(wanted), len(loaded)))
        for first in range(0, len(loaded), AT_ONCE):
            some = loaded[first : first + AT_ONCE]
            forces = np.zeros((len(self.free), len(some)))
            forces[some, np.arange(len(some))] = 1 / self.shear_mpa
            found[:, first : first + AT_ONCE] = self.system.solve(forces)[wanted]
        return found.reshape(*self.top.shape, len(self.near), 3)

    def drag(
        self,
        gap_mm: Array,
        depth_mm: float,
        shear_mm: tuple[float, float],
        *,
        friction: float | None = None,
    ) -> Dragged:
        """Press a probe in and drag it.

        Parameters
        ----------
        gap_mm : array, shape (near,)
            How far its surface lies above its lowest point at `places_mm`; inf where it ends.
        depth_mm : float
            How far it is pressed in.
        shear_mm : (float, float)
            How far it then moves to the right and up; of a probe that slides its direction counts.
        friction : float, optional
            Coefficient, of a probe that slides everywhere; without, the gel sticks to it.

        Raises
        ------
        RuntimeError
            If no set of nodes in contact is found.
        """
        sink = depth_mm - gap_mm
        touching = sink > 0
        own = self.response[self.near]
        left = np.zeros_like(touching)
        for change in range(MOST_CHANGES):
            at = np.flatnonzero(touching)
            part = own[np.ix_(at, range(3), at, range(3))]
            force = np.zeros((len(self.near), 3))
            if friction is None:
                wanted = np.column_stack([np.tile(shear_mm, (len(at), 1)), -sink[at]])
                size = 3 * len(at)
                force[at] = np.linalg.solve(part.reshape(size, size), wanted.ravel()).reshape(-1, 3)
            else:
                drag = friction * np.array(shear_mm) / np.hypot(*shear_mm)
                ratio = np.array([*drag, -1.0])  # of a node's force to its pressure
                force[at] = np.linalg.solve(part[:, 2] @ ratio, -sink[at])[:, None] * ratio
            lowered = -np.einsum("njk,jk->n", own[:, 2], force)
            now = np.where(touching, force[:, 2] < 0, (lowered < sink - TOUCH) & ~left)
            if (now == touching).all():
                moved = np.einsum("nijk,jk->ni", self.response, force) * [1, 1, -1]
                shape = len(self.x_mm), len(self.y_mm), 3
                return Dragged(
                    force.sum(axis=0) * [1, 1, -1], np.moveaxis(moved.reshape(shape), 2, 0), touching
                )
            if change > SETTLED:
                # nodes that would touch and be pulled in turn
                left |= touching & ~now
            touching = now
        raise RuntimeError(f"no contact found in {MOST_CHANGES} steps")

    def at(self, dragged: Dragged, places_mm: Array) -> Array:
        """Displacement (mm), (places, 3), of points of the top, (places, 2), from the middle of the block."""
        # sharp edges press between the nodes, where smoother curves overshoot
        field = np.moveaxis(dragged.moved_mm, 0, 2)
        axes = []
        for axis, nodes in enumerate((self.x_mm, self.y_mm)):
            between = np.arange(BETWEEN * (len(nodes) - 1) + 1) / BETWEEN
            axes.append(np.interp(between, np.arange(len(nodes)), nodes))
            field = PchipInterpolator(nodes, field, axis=axis)(axes[-1])
        return RegularGridInterpolator(axes, field)(places_mm)

    def seen(self, dragged: Dragged, places_mm: Array) -> Array:
        """How far the top is pressed in (mm) at places, (places, 2), where its points have moved to."""
        origin = places_mm
        for _ in range(FOLLOWED):
            inside = np.clip(origin, [self.x_mm[0], self.y_mm[0]], [self.x_mm[-1], self.y_mm[-1]])
            moved = self.at(dragged, inside)
            origin = places_mm - moved[:, :2]
        return moved[:, 2]
