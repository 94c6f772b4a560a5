"""Triangles of a STEP file, read in a process of its own: OpenCASCADE may crash on a damaged file."""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

SAG_MM = 5e-4
"""Distance of triangles from the surface; on large bodies `SAG` of their extent."""
SAG = 1e-5
TURN_DEG = 10.0  # between neighbouring triangles; where surfaces curve gently the sag decides
LONGEST_S = 300.0


def read(data: bytes) -> NDArray[np.float64]:
    """Triangulate all bodies and faces of a file.

    Parameters
    ----------
    data : bytes
        Content of the file.

    Returns
    -------
    corners : array, shape (triangles, 3, 3)
        Corners of the triangles in mm, whatever the unit of the file.

    Raises
    ------
    ValueError
        If the file is damaged or takes too long.
    """
    with tempfile.TemporaryDirectory() as folder:
        source, found = Path(folder) / "body.step", Path(folder) / "triangles.npy"
        source.write_bytes(data)
        call = [sys.executable, "-P", __file__, str(source), str(found)]
        try:
            subprocess.run(call, capture_output=True, timeout=LONGEST_S, check=False)
        except subprocess.TimeoutExpired:
            raise ValueError(f"it was not read within {LONGEST_S:g} s") from None
        if not found.is_file():
            raise ValueError("OpenCASCADE cannot read it")
        return np.asarray(np.load(found, allow_pickle=False))


def _triangulate(source: str, found: str) -> None:
    import cadquery

    triangles = [np.zeros((0, 3, 3))]
    for shape in cadquery.importers.importStep(source).vals():
        if isinstance(shape, cadquery.Shape):
            sag_mm = max(SAG_MM, SAG * shape.BoundingBox().DiagonalLength)
            points, faces = shape.tessellate(sag_mm, np.deg2rad(TURN_DEG))
            if faces:
                triangles.append(np.array([point.toTuple() for point in points])[np.array(faces)])
    partial = Path(found).with_suffix(".part.npy")
    np.save(partial, np.concatenate(triangles))
    partial.rename(found)


if __name__ == "__main__":
    _triangulate(*sys.argv[1:])
