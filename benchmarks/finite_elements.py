"""Round probe pressed into a bonded neo-Hookean pad by axisymmetric finite elements.

It knows what the linear contact solver does not: finite strain and the pad's free edge. Displacements are
quadratic and pressures linear on quadrilaterals (Taylor and Hood), so that a gel which keeps its volume does
not lock. With the stored energy G/2 (tr C - 3) - G ln J + p ln J - p^2 / (2 lambda) the first Piola-Kirchhoff
stress is G F + (p - G) F^-T; for small strains it is Hooke's law. Contact is a penalty at points of the top,
which slide without friction or stay where they first touched the probe. Coulomb's law lies between both.

A program and not a part of the library, as scikit-fem is installed for development only.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bmat, csc_matrix, csr_matrix
from scipy.sparse.linalg import splu
from skfem import Basis, ElementQuad1, ElementQuad2, ElementVector, FacetBasis, MeshQuad

Array = NDArray[np.float64]

PENALTY = 5000.0  # moduli per thickness: a pressure of one modulus sinks the probe h / 5000 into the gel
INTEGRATION_ORDER = 5
CONTACT_ORDER = 11  # six points on a side: the contact may end anywhere within it
UNIT = np.array([1.0, 0.0, 0.0, 1.0, 1.0])  # of the deformation gradient: rr, rz, zr, zz, around the axis
MOST_ITERATIONS = 14
MOST_HALVINGS = 6
TOUCH = 1e-5  # gap that counts as touched, of the greatest one on the pad
CONVERGED = 1e-8  # of a Newton step in displacement (mm)


class RoundProbe(NamedTuple):
    """Ball, or a punch with a flat end and a rounded edge.

    A ball has `flat_mm = 0`; of a punch `flat_mm` is the radius of its flat end without the edge (mm).
    """

    edge_radius_mm: float
    flat_mm: float = 0.0

    def gap(self, place: Array, tip_z: float) -> tuple[Array, Array, Array]:
        """Signed distance (mm) of places (..., 2) from the probe, its gradient, and its curvature (1/mm)."""
        away = place - np.array([self.flat_mm, tip_z + self.edge_radius_mm])
        distance = np.hypot(away[..., 0], away[..., 1])
        edge = away[..., 0] > 0
        return (
            np.where(edge, distance - self.edge_radius_mm, tip_z - place[..., 1]),
            np.where(edge[..., None], away / distance[..., None], [0.0, -1.0]),
            np.where(edge, 1.0 / distance, 0.0),
        )


@dataclass(frozen=True)
class Pad:
    """Round pad that is bonded to a rigid base; its side is free.

    Attributes
    ----------
    thickness_mm, radius_mm : float
        Thickness, and radius of the pad; on a dome the length of arc from the apex (mm).
    modulus_mpa, poisson : float
        Young's modulus (MPa) and Poisson's ratio at small strain.
    dome_mm : float, optional
        Radius of curvature of the top, whose apex is pressed; flat without it (mm).
    """

    thickness_mm: float
    radius_mm: float
    modulus_mpa: float = 1.0
    poisson: float = 0.49
    dome_mm: float | None = None


@dataclass
class Pressed:
    """State of a pad at one depth.

    Attributes
    ----------
    depth_mm, force_n, contact_radius_mm : float
        Depth, force on the probe, and radius of the contact.
    r_mm, height_mm : array, shape (nodes,)
        Nodes of the top where they have gone to: distance from the axis, and height into the gel, negative
        where it bulges. On a dome the height is measured from the apex's plane.
    moved_mm : array, shape (nodes,)
        How far these nodes have moved away from the axis.
    """

    depth_mm: float
    force_n: float
    contact_radius_mm: float
    r_mm: Array
    height_mm: Array
    moved_mm: Array

    def surface_mm(self, r_mm: Array) -> Array:
        """Height at places in space, by interpolation between the nodes."""
        return np.asarray(np.interp(r_mm, self.r_mm, self.height_mm))


def graded(fine: float, until: float, end: float, growth: float = 1.25) -> Array:
    """Steps of `fine` until `until`, then growing by `growth` to `end`."""
    first = np.linspace(0.0, until, max(round(until / fine), 1) + 1)
    rest, step = [until], fine
    while rest[-1] < end:
        step *= growth
        rest.append(rest[-1] + step)
    # the last lines are drawn together so that they end where the pad does
    tail = until + (np.array(rest[1:]) - until) * (end - until) / (rest[-1] - until) if end > until else []
    return np.concatenate([first, tail])


def mesh_of(pad: Pad, fine_mm: float, until_mm: float) -> MeshQuad:
    """Quadrilaterals with sides of `fine_mm` at the top within `until_mm` of the axis."""
    across = graded(fine_mm, min(until_mm, pad.radius_mm), pad.radius_mm)
    along = np.linspace(0.0, pad.thickness_mm, round(pad.thickness_mm / fine_mm) + 1)
    mesh = MeshQuad.init_tensor(across, along)
    mesh = mesh.with_boundaries(
        {
            "axis": lambda x: x[0] < 1e-9,
            "base": lambda x: x[1] < 1e-9,
            "top": lambda x: x[1] > pad.thickness_mm - 1e-9,
        }
    )
    if pad.dome_mm is not None:
        angle, reach = mesh.p[0] / pad.dome_mm, pad.dome_mm - pad.thickness_mm + mesh.p[1]
        bent = np.stack([reach * np.sin(angle), reach * np.cos(angle) - pad.dome_mm + pad.thickness_mm])
        mesh = MeshQuad(bent, mesh.t, _boundaries=mesh.boundaries)
    return mesh


class PressedPad:
    """A pad, and a probe that is pressed into it step by step.

    Parameters
    ----------
    pad : Pad
        The pad.
    probe : RoundProbe
        The probe.
    sticks : bool
        Whether a point of the gel stays where it first touches the probe; else it slides without friction.
    fine_mm : float
        Side of the elements around the contact (mm).
    until_mm : float
        Distance from the axis to which they are so small (mm).
    """

    def __init__(self, pad: Pad, probe: RoundProbe, *, sticks: bool, fine_mm: float, until_mm: float) -> None:
        self.pad, self.probe, self.sticks = pad, probe, sticks
        self.shear = pad.modulus_mpa / (2 * (1 + pad.poisson))
        # 1 / Lame's first constant; 0 of a gel that keeps its volume
        self.compliance = (1 - 2 * pad.poisson) / (2 * self.shear * pad.poisson)
        self.mesh = mesh_of(pad, fine_mm, until_mm)
        self.basis = Basis(self.mesh, ElementVector(ElementQuad2()), intorder=INTEGRATION_ORDER)
        self.pressures = self.basis.with_element(ElementQuad1())
        self.top = FacetBasis(
            self.mesh, self.basis.elem, facets=self.mesh.boundaries["top"], intorder=CONTACT_ORDER
        )
        base, axis = self.basis.get_dofs("base"), self.basis.get_dofs("axis")
        fixed = np.concatenate([base.all(), axis.nodal["u^1"], axis.facet["u^1"]])
        self.free = np.setdiff1d(np.arange(self.basis.N + self.pressures.N), fixed)
        self.u, self.p = np.zeros(self.basis.N), np.zeros(self.pressures.N)
        self.tip = float(self.pad.thickness_mm)
        self._tabulate()
        self.held = np.zeros(self.top_weights.shape, dtype=bool)
        self.places = np.zeros(self.top_at.shape)
        top = self.basis.get_dofs("top")
        across = np.concatenate([top.nodal["u^1"], top.facet["u^1"]])
        upward = np.concatenate([top.nodal["u^2"], top.facet["u^2"]])
        order = np.argsort(self.basis.doflocs[0, across])
        self.top_r, self.top_z = across[order], upward[order]

    def _tabulate(self) -> None:
        """Keep the shape functions at the quadrature points, elements first."""
        r = np.asarray(self.basis.global_coordinates())[0]
        functions = [
            np.stack([*np.reshape(f.grad, (4, *r.shape)), np.asarray(f)[0] / r]) for (f,) in self.basis.basis
        ]
        self.strains = np.transpose(functions, (2, 0, 3, 1))  # elements, functions, points, components
        self.weights = self.basis.dx * r
        flat = (*self.strains.shape[:2], -1)
        weighted = self.shear * self.weights[:, None, :, None] * self.strains
        self.straight = self.strains.reshape(flat) @ weighted.reshape(flat).swapaxes(1, 2)
        self.shapes = np.transpose([np.broadcast_to(f, r.shape) for (f,) in self.pressures.basis], (1, 0, 2))
        products = (self.shapes * self.weights[:, None]) @ self.shapes.swapaxes(1, 2)
        self.mass = _assembled(self.pressures, self.pressures, products)
        self.top_shapes = np.transpose([np.asarray(f) for (f,) in self.top.basis], (2, 0, 3, 1))
        self.top_at = np.moveaxis(np.asarray(self.top.global_coordinates()), 0, 2)
        self.top_weights = self.top.dx * self.top_at[..., 0]

    def press(self, depths_mm: Iterable[float]) -> Iterator[Pressed]:
        """Press through increasing depths (mm), and yield the state at each.

        Where the gel sticks, what comes to touch within a step slides until its end: take small steps.

        Raises
        ------
        RuntimeError
            If Newton's method does not converge in steps 64 times smaller.
        """
        done, last, before = 0.0, 0.0, np.zeros(self.basis.N + self.pressures.N)
        for depth in depths_mm:
            halvings = 0
            while done < depth - 1e-12:
                step = (depth - done) / 2**halvings
                here = np.concatenate([self.u, self.p])
                ahead = (here - before) * (step / last) if last else 0.0
                if self._settle(here + ahead, done + step) or self._settle(here, done + step):
                    before, last, done = here, step, done + step
                    if self.sticks:
                        self._hold()
                    halvings = max(halvings - 1, 0)
                else:
                    self.u, self.p = here[: self.basis.N], here[self.basis.N :]
                    halvings += 1
                    if halvings > MOST_HALVINGS:
                        raise RuntimeError(f"no equilibrium beyond a depth of {done:.4g} mm")
            yield self._state(float(depth))

    def _settle(self, start: Array, depth: float) -> bool:
        """Newton's method from a start; whether it converged."""
        self.tip = self.pad.thickness_mm - depth
        self.u, self.p = start[: self.basis.N].copy(), start[self.basis.N :].copy()
        for _ in range(MOST_ITERATIONS):
            try:
                matrix, rest = self._system()
            except FloatingPointError:
                return False
            free = self.free
            change = np.zeros(len(start))
            change[free] = splu(
                csc_matrix(matrix[free][:, free]), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.01
            ).solve(-rest[free])
            self.u += change[: self.basis.N]
            self.p += change[self.basis.N :]
            size = float(np.abs(change[: self.basis.N]).max())
            if not size < 1e3:
                return False
            if size < CONVERGED:
                return True
        return False

    def _system(self) -> tuple[Any, Array]:
        """Tangent matrix and residual of displacements and pressures, with contact."""
        grad = np.einsum("ekqc,ek->eqc", self.strains, self.u[self.basis.element_dofs.T])
        pressure = np.einsum("ekq,ek->eq", self.shapes, self.p[self.pressures.element_dofs.T])
        f00, f01, f10, f11, hoop = np.moveaxis(grad + UNIT, 2, 0)
        plane = f00 * f11 - f01 * f10
        if not ((plane > 0).all() and (hoop > 0).all()):
            raise FloatingPointError("an element is turned inside out")
        # F^-1 dF of each shape function, components as those of `strains`
        g00, g01, g10, g11, round_ = np.moveaxis(self.strains, 3, 0)
        i00, i01, i10, i11 = ((part / plane)[:, None] for part in (f11, -f01, -f10, f00))
        turned = np.stack(
            [
                i00 * g00 + i01 * g10,
                i00 * g01 + i01 * g11,
                i10 * g00 + i11 * g10,
                i10 * g01 + i11 * g11,
                round_ / hoop[:, None],
            ],
            axis=3,
        )
        swelling = turned[..., 0] + turned[..., 3] + turned[..., 4]
        weight = self.weights[:, None]
        flat = (*turned.shape[:2], -1)
        less = (weight * (self.shear - pressure)[:, None])[..., None] * turned[..., [0, 2, 1, 3, 4]]
        stiffness = turned.reshape(flat) @ less.reshape(flat).swapaxes(1, 2) + self.straight
        coupling = self.shapes @ (weight * swelling).swapaxes(1, 2)
        inner = self.shear * np.einsum("ekqc,eqc,eq->ek", self.strains, grad + UNIT, self.weights)
        inner += np.einsum("ekq,eq->ek", swelling, (pressure - self.shear) * self.weights)
        volume = np.log(plane * hoop) - self.compliance * pressure
        touch = self._touch()
        tangent = np.einsum("fkqc,fqcd,flqd->fkl", self.top_shapes, touch[1], self.top_shapes, optimize=True)
        upper = _assembled(self.basis, self.basis, stiffness) + _assembled(self.top, self.top, tangent)
        lower = _assembled(self.pressures, self.basis, coupling)
        matrix = bmat([[upper, lower.T], [lower, -self.compliance * self.mass]], format="csr")
        rest = np.zeros(matrix.shape[0])
        np.add.at(rest, self.basis.element_dofs.T, inner)
        np.add.at(rest, self.top.element_dofs.T, np.einsum("fkqc,fqc->fk", self.top_shapes, touch[0]))
        np.add.at(
            rest,
            self.basis.N + self.pressures.element_dofs.T,
            np.einsum("ekq,eq->ek", self.shapes, volume * self.weights),
        )
        return matrix, rest

    def _touch(self) -> tuple[Array, Array]:
        """Force of the gel on the probe at points of the top (N/rad), and its derivative by their place."""
        place = self._top_points()
        gap, normal, curvature = self.probe.gap(place, self.tip)
        along = np.stack([-normal[..., 1], normal[..., 0]], axis=-1)
        touching = (gap < 0).astype(float)
        nn, na, _, aa = (
            one[..., :, None] * other[..., None, :] for one in (normal, along) for other in (normal, along)
        )
        drag = self._drag(place, along)
        force = touching[..., None] * (gap[..., None] * normal + drag[..., None] * along)
        # along the probe its normal turns by the curvature times the way
        turning = (gap * curvature)[..., None, None] * aa - (drag * curvature)[..., None, None] * na
        stiffness = touching[..., None, None] * (nn + turning + self.held[..., None, None] * aa)
        scale = PENALTY * self.pad.modulus_mpa / self.pad.thickness_mm * self.top_weights
        return scale[..., None] * force, scale[..., None, None] * stiffness

    def _top_points(self) -> Array:
        """Where the quadrature points of the top are, shape (sides, points, 2)."""
        return self.top_at + np.einsum("fkqc,fk->fqc", self.top_shapes, self.u[self.top.element_dofs.T])

    def _drag(self, place: Array, along: Array) -> Array:
        """How far points that are held have been dragged along the probe (mm)."""
        dragged = np.sum((place - self.places - np.array([0.0, self.tip])) * along, axis=-1)
        return np.where(self.held, dragged, 0.0)

    def _hold(self) -> None:
        """Hold points that have come to touch the probe where they are, and let go of those that left it."""
        place = self._top_points()
        gap, normal, _ = self.probe.gap(place, self.tip)
        touching = gap < 0
        foot = place - gap[..., None] * normal - np.array([0.0, self.tip])
        self.places = np.where((touching & ~self.held)[..., None], foot, self.places)
        self.held = touching

    @property
    def energy_mj(self) -> float:
        """Energy that gel and penalty hold (mJ); of a press without friction the force is its slope."""
        grad = np.einsum("ekqc,ek->eqc", self.strains, self.u[self.basis.element_dofs.T]) + UNIT
        pressure = np.einsum("ekq,ek->eq", self.shapes, self.p[self.pressures.element_dofs.T])
        log = np.log((grad[..., 0] * grad[..., 3] - grad[..., 1] * grad[..., 2]) * grad[..., 4])
        density = self.shear * (0.5 * np.sum(grad**2, axis=-1) - 1.5 - log)
        density += pressure * log - 0.5 * self.compliance * pressure**2
        gap = np.minimum(self.probe.gap(self._top_points(), self.tip)[0], 0.0)
        stiffness = PENALTY * self.pad.modulus_mpa / self.pad.thickness_mm
        return (
            2
            * np.pi
            * float(np.sum(density * self.weights) + 0.5 * stiffness * np.sum(gap**2 * self.top_weights))
        )

    def _state(self, depth: float) -> Pressed:
        force = 2 * np.pi * float(np.sum(self._touch()[0][..., 1]))
        place = np.stack([self.basis.doflocs[0, self.top_r], self.basis.doflocs[1, self.top_z]], axis=1)
        moved = np.stack([self.u[self.top_r], self.u[self.top_z]], axis=1)
        r, z = (place + moved).T
        radius = _contact_radius(r, self.probe.gap(np.stack([r, z], axis=1), self.tip)[0])
        return Pressed(depth, force, radius, r, self.pad.thickness_mm - z, moved[:, 0])


def _contact_radius(r: Array, gap: Array) -> float:
    """Contact radius from the free surface beside it, which leaves a probe as (r - a)^(3/2)."""
    first = int(np.flatnonzero(gap < TOUCH * gap.max()).max()) + 2
    beside = slice(first, first + 6)
    return float(np.polyfit(gap[beside] ** (2 / 3), r[beside], 2)[-1])


def _assembled(rows: Any, columns: Any, blocks: Array) -> Any:
    """Sparse matrix of the elements' blocks, shape (elements, rows, columns)."""
    down = np.broadcast_to(rows.element_dofs.T[:, :, None], blocks.shape)
    across = np.broadcast_to(columns.element_dofs.T[:, None, :], blocks.shape)
    return csr_matrix((blocks.ravel(), (down.ravel(), across.ravel())), shape=(rows.N, columns.N))
