"""Light along given rays within the gel, in a scene of the rendering engine.

The generator's own scene, the engine's unchanged integrators, started at the membrane; and in their place
`clear` and `spreading`, which leave less to chance. Up to three LED groups share a scene, one in each colour
channel.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.simulation.scene.materials import Dielectric, Diffuse, Shape
from designlab.validation.synthetic import clear
from designlab.validation.synthetic.beams import Face
from designlab.validation.synthetic.clear import Follower, Stuff
from designlab.validation.synthetic.generator_sensor import Rig
from designlab.validation.synthetic.glass import Disc, ImmersedParts, interface_z
from designlab.validation.synthetic.meshes import SEGMENTS, Mesh, joining_mm, membrane, package, sheet
from designlab.validation.synthetic.spreading import LARGER, Spreader, Target

Look = Callable[[Any, Any], Any]  # what a sampler and rays make of a scene

CHANNELS = 3
WAVEFRONT = 4_000_000  # rays traced at once; bounds memory
FACE_MM = 1e-3  # emitting faces stand this far before their board
GAP_MM = 0.02  # of air, where the gel has come off
COLATITUDES, AZIMUTHS = 36, 108  # cells of equal solid angle over the upper half-space
UP = np.array([0.0, 0.0, 1.0])
LOWER, TALLER = (
    5.5,
    4.0,
)  # image of a board in a hollow interface, in its half height; rules noise, not the mean
R2 = (0.7548776662466927, 0.5698402909980532)
LEAST_PER_MM = 1e-6
MOST_LOST = 1e-4  # share of paths whose radiance is no number
LEAST_ALBEDO = 1e-7  # of what only absorbs: the engine divides by a throughput of zero
# boundaries between gel and core
BETWEEN = {"interface": clear.INTERFACE, "gap-above": clear.GAP_ABOVE, "gap-below": clear.GAP_BELOW}
CAMERA_SEGMENTS = 3  # of a path, from the membrane through interface and window to the camera


class Glow(NamedTuple):
    """Radiance (groups, rows, columns) of the membrane at centred nodes `pitch_mm` apart, rows ascending."""

    radiance: Array
    pitch_mm: float

    def place(self, vertices: Array) -> Array:
        """Texture coordinates of vertices: centres of texels are the nodes, the first row is at v = 0."""
        _, rows, columns = self.radiance.shape
        return 0.5 + vertices[:, :2] / self.pitch_mm / (columns, rows)

    def emitter(self) -> dict[str, Any]:
        """Area emitter for the engine's dictionary of a scene."""
        groups, rows, columns = self.radiance.shape
        values = np.zeros((rows, columns, CHANNELS), dtype=np.float32)
        values[..., :groups] = np.moveaxis(self.radiance, 0, -1)
        texture = {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": True, "wrap_mode": "clamp"}
        return {"type": "area", "radiance": texture}


class Tracer:
    """Scene of one sensor, untouched, to be looked at from within its gel.

    Parameters
    ----------
    rig : Rig
        A sensor with glass.
    groups : sequence of int
        At most three LED groups, each at unit flux.
    glow : Glow, optional
        Radiance of the membrane, which then shines in place of the LEDs.

    spreading : bool
        Without it all that spreads light is black but for boards: ground and painted sides, housing, haze.
    far : bool
        Whether `clear` and `spread` follow rays beyond the boundary of gel and core. Where haze spreads light
        they cannot: there `spread` is all light, from that boundary on.

    The membrane itself is always black.
    """

    def __init__(
        self,
        rig: Rig,
        groups: tuple[int, ...],
        *,
        glow: "Glow | None" = None,
        spreading: bool = True,
        far: bool = True,
    ) -> None:
        glass = rig.glass
        if glass is None:
            raise ValueError("rig.glass: light behind glass needs a core")
        _activate()

        self._channels = len(groups)
        self._spreading = spreading
        self._media = {
            "core": _medium(
                glass.core_absorption_per_mm, groups, glass.scattering_per_mm, glass.anisotropy, spreading
            ),
            "gel": _medium(glass.gel_absorption_per_mm, groups, 0.0, 0.0, True),
            "air": None,
        }
        content: dict[str, Any] = {"type": "scene"}
        content["membrane"] = _loaded(membrane(rig), _diffuse(np.zeros(len(groups))), glow=glow)
        for shape in glass.walls:
            content[shape.name] = self._wall(shape, glass, groups)
        content |= self._interface(glass)
        leds = _leds(rig, glass, groups, lit=glow is None)
        self._scene = mi.load_dict(content | leds)
        kind = "path" if glass.clear else "volpath"
        depth = max(rig.path_length - CAMERA_SEGMENTS, 1)
        self._integrator = mi.load_dict({"type": kind, "max_depth": depth, "rr_depth": 1000})
        # From the core on: the way through the gel is one segment.
        self._onward = mi.load_dict({"type": kind, "max_depth": max(depth - 1, 1), "rr_depth": 1000})
        self.far = far and not (spreading and glass.scattering_per_mm)
        kinds = {shape.name: self._kind(shape) for shape in glass.walls} | dict.fromkeys(leds, clear.SPREADS)
        self._follower = Follower(
            self._scene,
            kinds | BETWEEN,
            Stuff(glass.gel_index, glass.core_index, *_extinction(glass, groups)),
            longest=depth,
            far=self.far,
        )
        self._spreader = Spreader(self._scene, self._follower, _targets(rig, glass, groups))

    def radiance(
        self, origin: Array, direction: Array, *, seed: int, within: str = "gel"
    ) -> NDArray[np.float32]:
        """Radiance that arrives against rays, shape (groups, n), one path each.

        Parameters
        ----------
        origin, direction : array (n, 3)
            Where the rays start (mm), and their unit directions.
        within : {"gel", "core", "air"}
            What they start in.
        seed : int
            Seed of the paths; equal seeds give equal random numbers in every scene.
        """

        def rays(part: slice) -> Any:
            o, d = (np.ascontiguousarray(a[part].T, dtype=np.float32) for a in (origin, direction))
            return mi.RayDifferential3f(mi.Point3f(*o), mi.Vector3f(*d))

        return self._traced(
            rays, len(origin), seed, 1, lambda sampler, ray: self._by_chance(sampler, ray, within)
        )

    def cells(self, nodes: Array, index: NDArray[np.uint32], *, paths: int, seed: int) -> NDArray[np.float32]:
        """Mean radiance that arrives at nodes within cells of direction, shape (groups, n).

        Parameters
        ----------
        nodes : array (m, 3)
            Places within the gel (mm).
        index : array (n,)
            Cells, counted within nodes.
        paths : int
            Paths for each of them. They share what is drawn at every boundary evenly (multi-jittered), and
            within the cell their first directions follow the additive recurrence R2 (Roberts 2018).
        """
        return self._mean(nodes, index, paths, seed, self._by_chance)

    def clear(self, nodes: Array, index: NDArray[np.uint32], *, paths: int, seed: int) -> NDArray[np.float32]:
        """Part of `cells` that has met mirrors and clear boundaries only, nothing but directions drawn."""
        return self._mean(nodes, index, paths, seed, lambda _, ray: self._follower.follow(ray, 0.5).direct)

    def spread(
        self, nodes: Array, index: NDArray[np.uint32], *, paths: int, seed: int
    ) -> NDArray[np.float32]:
        """All of `cells` but `clear`: light that something has spread."""
        return self._mean(nodes, index, paths, seed, self._beyond)

    def _mean(
        self, nodes: Array, index: NDArray[np.uint32], paths: int, seed: int, look: Look
    ) -> NDArray[np.float32]:

        place = [mi.Float(np.ascontiguousarray(nodes[:, axis], dtype=np.float32)) for axis in range(3)]
        count = COLATITUDES * AZIMUTHS

        def rays(part: slice) -> Any:
            lane = dr.arange(mi.UInt32, part.stop - part.start)
            cell, number = mi.UInt32(index[part.start // paths : part.stop // paths]), lane % paths
            at, number = dr.gather(mi.UInt32, cell, lane // paths), mi.Float(number)
            node = at // count
            row, column = (at % count) // AZIMUTHS, at % AZIMUTHS
            down = mi.sample_tea_float32(at, mi.UInt32(2 * seed)) + R2[0] * number
            along = mi.sample_tea_float32(at, mi.UInt32(2 * seed + 1)) + R2[1] * number
            rise = (mi.Float(row) + down - dr.floor(down)) / COLATITUDES
            turn = (mi.Float(column) + along - dr.floor(along)) * (2 * np.pi / AZIMUTHS)
            level = dr.safe_sqrt(1.0 - rise * rise)
            origin = mi.Point3f(*(dr.gather(mi.Float, axis, node) for axis in place))
            return mi.RayDifferential3f(origin, mi.Vector3f(level * dr.cos(turn), level * dr.sin(turn), rise))

        found = self._traced(rays, len(index) * paths, seed, paths, look)
        return np.asarray(found.reshape(len(found), len(index), paths).mean(axis=2))

    def _by_chance(self, sampler: Any, ray: Any, within: str = "gel") -> Any:
        """One path of the engine along every ray."""
        stuff = self._media[within]
        medium = {} if stuff is None else {"medium": mi.MediumPtr(stuff)}
        return self._integrator.sample(self._scene, sampler, ray, **medium)[0]

    def _beyond(self, sampler: Any, ray: Any) -> Any:
        """What each ray sees of things that spread light; in haze by one path of the engine."""
        if self.far:
            return self._spreader.seen(ray, sampler)
        found = self._follower.follow(ray, sampler.next_1d())
        onward, seen = mi.RayDifferential3f(found.ray), dr.max(found.worth) > 0
        total = mi.Color3f(0.0)
        for name, passed in (("core", clear.CORE), ("gel", clear.GEL)):
            mine = seen & (found.passing == passed)
            medium = {} if self._media[name] is None else {"medium": self._media[name]}
            light, _, _ = self._onward.sample(self._scene, sampler, onward, active=mine, **medium)
            total += dr.select(mine, found.worth * mi.Color3f(light), 0.0)
        return total

    def _traced(self, rays: Any, size: int, seed: int, together: int, look: Look) -> NDArray[np.float32]:
        """What `look` finds along each ray; `together` neighbours share what is drawn evenly."""
        found = np.empty((self._channels, size), dtype=np.float32)
        step = WAVEFRONT // together * together
        for number, start in enumerate(range(0, size, step)):
            part = slice(start, min(start + step, size))
            count = part.stop - part.start
            kind = (
                {"type": "multijitter", "sample_count": together} if together > 1 else {"type": "independent"}
            )
            sampler = mi.load_dict(kind)
            sampler.set_samples_per_wavefront(together)
            sampler.seed(int(np.random.SeedSequence([seed, number]).generate_state(1)[0]), count)
            spectrum = look(sampler, rays(part))
            found[:, part] = np.asarray(spectrum).reshape(CHANNELS, count)[: self._channels]
        # In haze the engine divides zero by zero once in millions of paths; such a path brings nothing.
        lost = ~np.isfinite(found)
        if lost.mean() > MOST_LOST:
            raise RuntimeError(f"{lost.mean():.2g} of the paths within the gel end without a number")
        found[lost] = 0.0
        return found

    def _kind(self, shape: Shape) -> int:
        """What a wall is to clear light."""
        rough = isinstance(shape.material, Dielectric) and shape.material.roughness
        if isinstance(shape.material, Dielectric) and not rough:
            return clear.SIDE
        bright = rough or (isinstance(shape.material, Diffuse) and any(shape.material.reflectance))
        return clear.SPREADS if self._spreading and bright else clear.BLACK

    def _wall(self, shape: Shape, glass: ImmersedParts, groups: tuple[int, ...]) -> "mi.Mesh":
        mesh = Mesh(shape.vertices, shape.faces.astype(np.int64), shape.normals)
        if isinstance(shape.material, Dielectric) and (self._spreading or not shape.material.roughness):
            return self._boundary(mesh, glass, "core", "air", shape.material.roughness)
        if isinstance(shape.material, Diffuse) and self._spreading:
            return _loaded(mesh, _diffuse(np.array(shape.material.reflectance)[list(groups)]))
        return _loaded(mesh, _diffuse(np.zeros(len(groups))))

    def _boundary(
        self, mesh: Mesh, glass: ImmersedParts, below: str, above: str, roughness: float = 0.0
    ) -> "mi.Mesh":
        """Clear boundary whose normals point from the stuff `below` into that `above`."""
        index = {"core": glass.core_index, "gel": glass.gel_index, "air": 1.0}
        bsdf: dict[str, Any] = {"type": "dielectric", "int_ior": index[below], "ext_ior": index[above]}
        if roughness:
            bsdf |= {"type": "roughdielectric", "distribution": "ggx", "alpha": float(roughness)}
        sides = {"interior": self._media[below], "exterior": self._media[above]}
        return _loaded(mesh, bsdf, {side: medium for side, medium in sides.items() if medium is not None})

    def _interface(self, glass: ImmersedParts) -> dict[str, "mi.Mesh"]:
        """Boundary of gel and core, with a gap of air where the gel has come off."""
        gap = glass.gap
        whole = sheet(glass.outline, gap, lambda x, y: interface_z(glass, x, y), glass.interface_radius_mm)
        if gap is None:
            return {"interface": self._boundary(whole, glass, "gel", "core")}

        def lower(x: Array, y: Array) -> Array:
            return interface_z(glass, x, y) - GAP_MM * (np.hypot(x - gap.x_mm, y - gap.y_mm) < rim)

        rim = gap.radius_mm * (1 - 1e-6)
        turn = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
        edge = np.column_stack([np.cos(turn), np.sin(turn)]) * gap.radius_mm + (gap.x_mm, gap.y_mm)
        middle = Disc(gap.x_mm, gap.y_mm, 0.0)
        above = sheet(edge, middle, lambda x, y: interface_z(glass, x, y), glass.interface_radius_mm)
        below = sheet(edge, middle, lower, None)
        return {
            "interface": self._boundary(whole, glass, "gel", "core"),
            "gap-above": self._boundary(above, glass, "air", "core"),
            "gap-below": self._boundary(below, glass, "gel", "air"),
        }


def _activate() -> None:
    """Set a just-in-time variant of the engine unless one is set.

    Raises
    ------
    RuntimeError
        If this machine has none.
    """
    if mi.variant() is None:
        # Choosing a compiler that does not crash is no physics: the one thing shared with the renderer.
        from designlab.core.backend import activate

        activate()
    if mi.variant().startswith("scalar"):
        raise RuntimeError(
            "optics.light_path: measurements behind glass need LLVM 17 or newer, or CUDA "
            "(see `designlab doctor`)"
        )


def _extinction(glass: ImmersedParts, groups: tuple[int, ...]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Extinction (1/mm) of gel and core in every colour channel."""
    lost = glass.gel_absorption_per_mm, glass.core_absorption_per_mm + glass.scattering_per_mm
    gel, core = (
        tuple(float(v) for v in np.pad(per_mm[list(groups)], (0, CHANNELS - len(groups)))) for per_mm in lost
    )
    return gel, core


def _rgb(values: Array) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(v) for v in values] + [0.0] * (CHANNELS - len(values))}


def _diffuse(reflectance: Array) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": _rgb(reflectance)}


def _medium(
    absorption: Array, groups: tuple[int, ...], scattering: float, anisotropy: float, spreading: bool
) -> Any:
    """Homogeneous medium, nothing where light passes undimmed; unless spreading, what it scatters is lost."""
    extinction = absorption[list(groups)] + scattering
    if extinction.max() == 0:
        return None
    # Distances are drawn for one channel at a time: none may be endless.
    extinction = np.maximum(np.pad(extinction, (0, CHANNELS - len(groups))), LEAST_PER_MM)
    content: dict[str, Any] = {
        "type": "homogeneous",
        "sigma_t": _rgb(extinction),
        "albedo": _rgb(np.maximum(spreading * scattering / extinction, LEAST_ALBEDO)),
    }
    if scattering:
        content["phase"] = {"type": "hg", "g": float(anisotropy)}
    return mi.load_dict(content)


def _loaded(
    mesh: Mesh, bsdf: dict[str, Any], media: dict[str, Any] | None = None, *, glow: "Glow | None" = None
) -> "mi.Mesh":

    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    for side, medium in (media or {}).items():
        properties[side] = medium
    smooth = mesh.normals is not None
    if not smooth:
        properties["face_normals"] = True
    if glow is not None:
        properties["emitter"] = mi.load_dict(glow.emitter())
    loaded = mi.Mesh(
        "part",
        len(mesh.vertices),
        len(mesh.faces),
        has_vertex_normals=smooth,
        has_vertex_texcoords=glow is not None,
        props=properties,
    )
    parameters = mi.traverse(loaded)
    parameters["vertex_positions"] = np.ascontiguousarray(mesh.vertices, dtype=np.float32).ravel()
    parameters["faces"] = np.ascontiguousarray(mesh.faces, dtype=np.uint32).ravel()
    if mesh.normals is not None:
        parameters["vertex_normals"] = np.ascontiguousarray(mesh.normals, dtype=np.float32).ravel()
    if glow is not None:
        parameters["vertex_texcoords"] = np.ascontiguousarray(glow.place(mesh.vertices), np.float32).ravel()
    parameters.update()
    return loaded


def _leds(rig: Rig, glass: ImmersedParts, groups: tuple[int, ...], *, lit: bool) -> dict[str, Any]:
    """Boards and emitting faces; bonded ones joined to the core's side, wherever they were moved."""
    boards, faces = rig.boards, rig.emitters
    paint = _diffuse(rig.board_reflectance[list(groups)])
    area = np.array([4 * faces.half[faces.group == g].prod(axis=1).sum() for g in range(len(rig.flux_mw))])
    content: dict[str, Any] = {}
    for board in range(len(boards.group)):
        way_mm = joining_mm(boards, board, glass) if glass.bonded else 0.0
        content[f"board-{board}"] = _loaded(package(boards, board, way_mm, glass.package_mm), paint)
        for number in np.flatnonzero(rig.carrier == board).tolist():
            group = int(faces.group[number])
            if group not in groups or not lit:
                continue
            radiance = np.zeros(CHANNELS)
            radiance[groups.index(group)] = rig.face_flux[number] / (np.pi * area[group])
            content[f"face-{number}"] = Face(
                centre=faces.centre[number] + (way_mm + FACE_MM) * boards.normal[board],
                half_across=faces.half[number, 0] * boards.across[board],
                half_down=faces.half[number, 1] * boards.down[board],
                normal=boards.normal[board],
                axis=faces.normal[number],
                exponent=float(rig.exponent[group]),
                radiance=radiance,
            ).entry(paint)
    return content


def _targets(rig: Rig, glass: ImmersedParts, groups: tuple[int, ...]) -> list[Target]:
    """Boards of some groups, and their images in the window and in the boundary of gel and core."""
    boards, found = rig.boards, []
    for number in range(len(boards.group)):
        if rig.carried(number) & set(groups):
            way_mm = joining_mm(boards, number, glass) if glass.bonded else 0.0
            centre = boards.centre[number] + way_mm * boards.normal[number]
            across = LARGER * boards.half[number, 0] * boards.across[number]
            down = LARGER * boards.half[number, 1] * boards.down[number]
            found.append(Target(centre, across, down))
    over = np.array([1.0, 1.0, -1.0])
    window, interface = (np.array([0.0, 0.0, 2 * z]) for z in (glass.window_mm, glass.thickness_mm))
    above = [Target(window + over * t.centre, over * t.across, over * t.down) for t in found]
    below = [Target(interface + over * t.centre, over * t.across, over * t.down) for t in found]
    if glass.interface_radius_mm is not None:  # in a hollow mirror they are seen lower and larger
        below = [Target(t.centre - LOWER * abs(t.down[2]) * UP, t.across, TALLER * t.down) for t in below]
    return found + above + below
