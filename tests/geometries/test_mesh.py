"""Solids to meshes, meshes to heights, and the files users bring."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from geometries import mesh, probes
from geometries.probes import parse, profile_mm


@pytest.fixture
def box() -> trimesh.Trimesh:
    return trimesh.creation.box((4.0, 2.0, 1.0))


def test_from_solid_obeys_its_tolerance_whatever_was_meshed_before() -> None:
    """OpenCASCADE keeps triangulations on a shape; asking finely first must not make the coarse mesh fine."""
    ball = probes.solid(probes.sphere(diameter_mm=10))
    coarse = [mesh.from_solid(ball, tolerance_mm=0.2, angular_tolerance_deg=30)]
    fine = mesh.from_solid(ball, tolerance_mm=0.01, angular_tolerance_deg=5)
    coarse.append(mesh.from_solid(ball, tolerance_mm=0.2, angular_tolerance_deg=30))
    assert len(fine.faces) > 4 * len(coarse[0].faces)
    np.testing.assert_array_equal(coarse[0].faces, coarse[1].faces)
    np.testing.assert_array_equal(coarse[0].vertices, coarse[1].vertices)
    tip = fine.vertices[fine.vertices[:, 2] > -5]
    np.testing.assert_allclose(np.linalg.norm(tip - [0, 0, -5], axis=1), 5.0, atol=1e-6)


def test_from_solid_takes_bare_shapes_and_refuses_open_ones() -> None:
    import cadquery

    block = cadquery.Solid.makeBox(1, 2, 3)
    assert mesh.from_solid(block).volume == pytest.approx(6.0)
    with pytest.raises(ValueError, match="solid: does not give a closed mesh"):
        mesh.from_solid(cadquery.Face.makePlane(1, 1))
    with pytest.raises(ValueError, match="tolerance_mm: must be positive, is 0"):
        mesh.from_solid(block, tolerance_mm=0.0)
    with pytest.raises(ValueError, match="angular_tolerance_deg: must be positive, is -1"):
        mesh.from_solid(block, angular_tolerance_deg=-1.0)


def highest(triangles: np.ndarray, x: float, y: float) -> float:
    """Highest crossing of one vertical line, triangle by triangle, by Cramer's rule."""
    best = -np.inf
    for a, b, c in triangles:
        system = np.column_stack([b[:2] - a[:2], c[:2] - a[:2]])
        if np.linalg.det(system) != 0:
            u, v = np.linalg.solve(system, np.array([x, y]) - a[:2])
            if u >= 0 and v >= 0 and u + v <= 1:
                best = max(best, float(a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])))
    return best


@pytest.mark.parametrize("seed", range(3))
def test_height_map_of_any_triangles(seed: int) -> None:
    """Random overlapping triangles, long and small, against one line at a time."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, (60, 1, 3)) + rng.uniform(-1, 1, (60, 3, 3)) * rng.choice(
        [0.1, 1.0, 3.0], (60, 1, 1)
    )
    soup = trimesh.Trimesh(corners.reshape(-1, 3), np.arange(180).reshape(-1, 3), process=False)
    x, y = rng.uniform(-3, 3, (2, 400))
    expected = [highest(corners, *point) for point in zip(x, y, strict=True)]
    np.testing.assert_allclose(mesh.height_map(soup, x, y), expected, atol=1e-9)


def test_height_map_has_no_gaps_along_shared_edges(box: trimesh.Trimesh) -> None:
    x, y = np.meshgrid(np.linspace(-2, 2, 81), np.linspace(-1, 1, 41))  # on the diagonal and the rim as well
    np.testing.assert_allclose(mesh.height_map(box, x, y), 0.5)
    assert np.isneginf(mesh.height_map(box, 2.001, 0.0))


def test_height_map_of_a_turned_box(box: trimesh.Trimesh) -> None:
    angle = 0.5
    box.apply_transform(trimesh.transformations.rotation_matrix(angle, (0, 0, 1)))
    x, y = np.meshgrid(np.linspace(-3, 3, 301), np.linspace(-3, 3, 299))
    along, aside = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
    inside = (np.abs(along) < 2) & (np.abs(aside) < 1)
    np.testing.assert_array_equal(
        mesh.height_map(box, x, y), np.where(inside, mesh.height_map(box, 0, 0), -np.inf)
    )


@pytest.mark.parametrize("points", [0, 1, 2])
def test_height_map_of_few_points(box: trimesh.Trimesh, points: int) -> None:
    assert mesh.height_map(box, np.zeros(points), np.zeros(points)).tolist() == [0.5] * points


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".STL"])
def test_load_centres_and_scales(tmp_path: Path, box: trimesh.Trimesh, suffix: str) -> None:
    box.apply_translation((10.0, -20.0, 30.0))
    path = tmp_path / f"part{suffix}"
    path.write_bytes(as_bytes(box, suffix.lower()[1:]))
    np.testing.assert_allclose(mesh.load(path).bounds, [(-2, -1, -1), (2, 1, 0)], atol=1e-5)
    np.testing.assert_allclose(mesh.load(path, size_mm=8.0).bounds, [(-4, -2, -2), (4, 2, 0)], atol=1e-5)


def as_bytes(body: trimesh.Trimesh, file_type: str) -> bytes:
    data = body.export(file_type=file_type)
    return data if isinstance(data, bytes) else str(data).encode()


def test_the_side_that_faces_plus_z_in_the_file_presses(tmp_path: Path) -> None:
    """A cone with its tip up presses with its tip; the same cone upside down presses with its flat base."""
    cone = trimesh.creation.cone(radius=2.0, height=3.0, sections=64)
    path = tmp_path / "cone.stl"
    cone.export(path)
    np.testing.assert_allclose(profile_mm(parse(str(path)), [0.0, 1.0], 0.0), [0.0, -1.5], atol=1e-5)
    cone.apply_transform(np.diag([1.0, -1.0, -1.0, 1.0]))
    cone.export(path)
    np.testing.assert_allclose(profile_mm(parse(str(path)), [0.0, 1.0], 0.0), 0.0, atol=1e-5)


def test_a_library_probe_written_to_a_file_is_the_same_probe(tmp_path: Path) -> None:
    star = probes.star(diameter_mm=4)
    path = tmp_path / "star.stl"
    probes.mesh(star).export(path)
    read = parse(f"{path}:8")
    assert read == probes.Probe(kind="mesh", size_mm=8.0, file=str(path))
    x, y = np.meshgrid(np.linspace(-2, 2, 101), np.linspace(-2, 2, 101))
    # the mesh is centred on its bounding box, the star on the centre of its circle
    bounds = probes.mesh(star).bounds
    scale = 8.0 / (bounds[1, 0] - bounds[0, 0])
    meshed = profile_mm(read, scale * x, scale * (y - bounds[:, 1].mean()))
    agree = np.isfinite(meshed) == np.isfinite(profile_mm(star, x, y))
    assert agree.mean() > 0.998


@pytest.mark.parametrize(
    ("break_it", "note"),
    [
        (lambda body: body.update_faces(np.arange(len(body.faces)) != 3), "holes were filled"),
        (lambda body: body.invert(), "normals were turned outwards"),
    ],
)
def test_small_defects_are_repaired_and_reported(
    tmp_path: Path, box: trimesh.Trimesh, break_it: Callable[[trimesh.Trimesh], None], note: str
) -> None:
    break_it(box)
    path = tmp_path / "part.stl"
    box.export(path)
    with pytest.warns(UserWarning, match=f"part.stl: {note}"):
        body = mesh.load(path)
    assert body.metadata["notes"] == [note]
    assert body.is_watertight
    assert body.volume == pytest.approx(8.0)


def not_finite() -> bytes:
    data = bytearray(as_bytes(trimesh.creation.box((4.0, 2.0, 1.0)), "stl"))
    data[96:100] = struct.pack("<f", float("nan"))  # the first corner of the first triangle
    return bytes(data)


def scaled_box(scale: float) -> bytes:
    return as_bytes(trimesh.creation.box((4 * scale, 2 * scale, scale)), "stl")


def without_thickness() -> bytes:
    box = trimesh.creation.box((4.0, 2.0, 1.0))
    box.vertices *= (1.0, 1.0, 0.0)
    return as_bytes(box, "stl")


def half_box() -> bytes:
    """Two opposite sides of a box, each whole: no hole to fill between them."""
    box = trimesh.creation.box((4.0, 2.0, 1.0))
    box.update_faces(np.abs(box.face_normals[:, 0]) > 0.5)
    return as_bytes(box, "stl")


def tilted_sheet() -> bytes:
    """A flat square at 45 deg: it has extent along all axes, but encloses nothing."""
    corners = [(0, 0, 0), (1, 0, 1), (1, 1, 1), (0, 1, 0)]
    faces = [(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)]
    return as_bytes(trimesh.Trimesh(corners, faces, process=False), "stl")


PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d49484452000000010000000108060000001f15c4890000000d49444154789c6360000002"
    "000001e221bc330000000049454e44ae426082"
)

BAD_FILES = {
    "empty": (b"", ".stl", "the file is empty"),
    "blank": (b"  \n", ".obj", "the file is empty"),
    "garbage stl": (np.random.default_rng(1).bytes(5000), ".stl", "not a valid STL file"),
    "garbage obj": (np.random.default_rng(1).bytes(5000), ".obj", "not a valid OBJ file"),
    "prose": (b"hello world", ".stl", "not a valid STL file"),
    "picture": (PNG, ".stl", "not a valid STL file"),
    "cut short": (scaled_box(1.0)[:300], ".stl", "not a valid STL file"),
    "count of four billion": (
        bytes(80) + struct.pack("<I", 4_000_000_000) + bytes(50),
        ".stl",
        "not a valid STL",
    ),
    "points only": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", ".obj", "holds no triangles"),
    "index beyond the vertices": (b"v 0 0 0\nv 1 0 0\nv 0 1 1\nf 1 2 9\n", ".obj", "not a valid OBJ file"),
    "not a number": (not_finite(), ".stl", "vertices that are not finite numbers"),
    "no thickness": (without_thickness(), ".stl", "the body has no thickness, its extents are 4 x 2 x 0 mm"),
    "both sides of a sheet": (tilted_sheet(), ".stl", "encloses no volume"),
    "half a box": (half_box(), ".stl", "the surface is not closed"),
    "metres": (
        scaled_box(1e-3),
        ".stl",
        "is 0.004 mm; the file's unit is taken as mm, give a size to scale it",
    ),
    "nanometres": (scaled_box(1e6), ".stl", "must lie between 0.05 and 1000 mm, is 4e+06 mm"),
    "other type": (b"ply", ".ply", "a mesh file ends in .stl or .obj, not '.ply'"),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("case", list(BAD_FILES))
def test_bad_files_are_refused_by_name_and_rule(tmp_path: Path, case: str) -> None:
    data, suffix, rule = BAD_FILES[case]
    path = tmp_path / f"part{suffix}"
    path.write_bytes(data)
    with pytest.raises(ValueError) as refusal:  # noqa: PT011 (the text is compared below, brackets and all)
        mesh.load(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert rule in str(refusal.value)


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"gone.stl: cannot be read \(No such file or directory\)"):
        mesh.load(tmp_path / "gone.stl")
    (tmp_path / "folder.stl").mkdir()
    with pytest.raises(ValueError, match=r"folder.stl: cannot be read \(Is a directory\)"):
        mesh.load(tmp_path / "folder.stl")


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "part.stl"
    path.write_bytes(scaled_box(1.0))
    assert parse(str(path)).size_mm == pytest.approx(4.0)
    path.write_bytes(scaled_box(2.0))
    assert parse(str(path)).size_mm == pytest.approx(8.0)
