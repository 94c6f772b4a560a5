"""Solids to meshes, meshes to heights."""

import numpy as np
import pytest
import trimesh

from geometries import mesh, probes
from geometries.raster import height_map


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
    np.testing.assert_allclose(height_map(soup, x, y), expected, atol=1e-9)


def test_height_map_has_no_gaps_along_shared_edges(box: trimesh.Trimesh) -> None:
    x, y = np.meshgrid(np.linspace(-2, 2, 81), np.linspace(-1, 1, 41))  # on the diagonal and the rim as well
    np.testing.assert_allclose(height_map(box, x, y), 0.5)
    assert np.isneginf(height_map(box, 2.001, 0.0))


def test_height_map_of_a_turned_box(box: trimesh.Trimesh) -> None:
    angle = 0.5
    box.apply_transform(trimesh.transformations.rotation_matrix(angle, (0, 0, 1)))
    x, y = np.meshgrid(np.linspace(-3, 3, 301), np.linspace(-3, 3, 299))
    along, aside = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
    inside = (np.abs(along) < 2) & (np.abs(aside) < 1)
    np.testing.assert_array_equal(height_map(box, x, y), np.where(inside, height_map(box, 0, 0), -np.inf))


@pytest.mark.parametrize("points", [0, 1, 2])
def test_height_map_of_few_points(box: trimesh.Trimesh, points: int) -> None:
    assert height_map(box, np.zeros(points), np.zeros(points)).tolist() == [0.5] * points
