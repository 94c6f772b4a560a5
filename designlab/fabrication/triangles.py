"""Triangle meshes for the printer: repaired, thinned with a known error, and written as STL and 3MF."""

import zipfile
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from geometries.mesh import from_solid, open_edges

if TYPE_CHECKING:
    import cadquery
    import trimesh

MESH_TOLERANCE_MM, MESH_TOLERANCE_DEG = 0.0025, 2.0
"""Largest distance of the fine mesh to the CAD surface, and angle between its facets."""
THINNING_MM = 0.02
"""Largest Hausdorff distance of a thinned mesh to the fine one: half a layer of a fine print."""
OPTICAL_THINNING_MM = 0.005
"""The same for parts whose surface light or touch meets; on a radius of 35 mm facets differ by 2 deg then."""

_KEPT_SHARES = (0.1, 0.2, 0.4, 0.7)
_SMALLEST_TO_THIN = 1000
_SAMPLES = 20_000
_NAMESPACE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_PARTS = {"[Content_Types].xml": "content_types.xml", "_rels/.rels": "relationships.xml"}
"""Parts of every 3MF package, and the files beside this module that hold them."""


def printable(shape: "cadquery.Shape", *, bound_mm: float) -> tuple["trimesh.Trimesh", dict[str, Any]]:
    """Triangulate a part for printing; with PyMeshLab also repair it and thin it out.

    Parameters
    ----------
    shape : cadquery.Shape
        One solid or a compound of several (mm).
    bound_mm : float
        Largest Hausdorff distance (mm) that thinning may cause.

    Returns
    -------
    mesh : trimesh.Trimesh
        Closed mesh in mm.
    report : dict
        ``tool``, ``triangles_fine``, ``triangles``, ``hausdorff_mm`` (both directions, sampled; 0 when the
        mesh is the fine one), ``hausdorff_bound_mm`` and ``note``.
    """
    import cadquery

    solids = cadquery.Workplane().newObject(shape.Solids())
    fine = from_solid(solids, tolerance_mm=MESH_TOLERANCE_MM, angular_tolerance_deg=MESH_TOLERANCE_DEG)
    report: dict[str, Any] = {
        "tool": "trimesh",
        "triangles_fine": len(fine.faces),
        "triangles": len(fine.faces),
        "hausdorff_mm": 0.0,
        "hausdorff_bound_mm": bound_mm,
        "note": "",
    }
    try:
        import pymeshlab
    except ImportError as error:
        report["note"] = f"not thinned: PyMeshLab is not installed (pip install 'designlab[mesh]'; {error})"
        return fine, report
    report["tool"] = "pymeshlab"
    if len(fine.faces) < _SMALLEST_TO_THIN:
        report["note"] = f"not thinned: fewer than {_SMALLEST_TO_THIN} triangles"
        return fine, report
    least = 0.0
    for share in _KEPT_SHARES:
        if share < least:
            continue
        thin, distance = _thinned(pymeshlab, fine, share)
        if distance <= bound_mm and open_edges(thin) == 0:
            return thin, report | {"triangles": len(thin.faces), "hausdorff_mm": distance}
        # The distance falls as the number of triangles grows: shares before that are not worth a try.
        least = min(share * distance / bound_mm, _KEPT_SHARES[-1])
    report["note"] = f"not thinned: no reduction stayed within {bound_mm:g} mm and closed"
    return fine, report


def write_3mf(mesh: "trimesh.Trimesh", path: Path, *, name: str) -> None:
    """Write one mesh as a 3MF package (core specification 1.3: one object, one build item, millimetres)."""
    vertices = "".join(f'<vertex x="{x:.7g}" y="{y:.7g}" z="{z:.7g}"/>' for x, y, z in mesh.vertices.tolist())
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in mesh.faces.tolist())
    model = (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<model unit="millimeter" xml:lang="en-US" xmlns="{_NAMESPACE}"><resources>'
        f'<object id="1" type="model" name="{name}"><mesh><vertices>{vertices}</vertices>'
        f"<triangles>{triangles}</triangles></mesh></object></resources>"
        '<build><item objectid="1"/></build></model>'
    )
    texts = {part: files(__package__).joinpath(file).read_text("utf-8") for part, file in _PARTS.items()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as package:
        for entry, text in (texts | {"3D/3dmodel.model": model}).items():
            # A fixed date keeps equal parts equal, byte for byte.
            package.writestr(zipfile.ZipInfo(entry), text, compress_type=zipfile.ZIP_DEFLATED)


def read(path: Path) -> "trimesh.Trimesh":
    """Read an STL file, its corners merged, or the one mesh of a 3MF package as it stands in the file."""
    import trimesh

    if path.suffix != ".3mf":
        return trimesh.load_mesh(path)
    with zipfile.ZipFile(path) as package:
        root = ElementTree.fromstring(package.read("3D/3dmodel.model"))
    vertices = [[float(v.attrib[axis]) for axis in "xyz"] for v in root.iter(f"{{{_NAMESPACE}}}vertex")]
    corners = ("v1", "v2", "v3")
    faces = [[int(t.attrib[corner]) for corner in corners] for t in root.iter(f"{{{_NAMESPACE}}}triangle")]
    return trimesh.Trimesh(vertices=vertices, faces=faces, process=False)


def _thinned(pymeshlab: Any, fine: "trimesh.Trimesh", share: float) -> tuple["trimesh.Trimesh", float]:
    """Repair and decimate by quadric edge collapse; return the mesh and its Hausdorff distance (mm)."""
    import trimesh

    work = pymeshlab.MeshSet()
    work.add_mesh(pymeshlab.Mesh(fine.vertices, fine.faces), "fine")
    work.add_mesh(pymeshlab.Mesh(fine.vertices, fine.faces), "thin")
    work.meshing_remove_duplicate_vertices()
    work.meshing_remove_duplicate_faces()
    work.meshing_remove_null_faces()
    # Splitting, not removing faces: bodies that touch along an edge stay whole.
    work.meshing_repair_non_manifold_edges(method="Split Vertices")
    work.meshing_decimation_quadric_edge_collapse(
        targetfacenum=max(4, int(share * len(fine.faces))),
        qualitythr=0.3,
        preservenormal=True,
        preservetopology=True,
        planarquadric=True,
    )
    work.meshing_repair_non_manifold_edges(method="Split Vertices")
    work.meshing_remove_unreferenced_vertices()
    mesh = work.current_mesh()
    thin = trimesh.Trimesh(vertices=mesh.vertex_matrix(), faces=mesh.face_matrix(), process=False)
    distance = 0.0
    for sampled, target in ((0, 1), (1, 0)):
        found = work.get_hausdorff_distance(
            sampledmesh=sampled,
            targetmesh=target,
            sampleface=True,
            samplenum=_SAMPLES,
            maxdist=pymeshlab.PercentageValue(100),
        )
        distance = max(distance, float(found["max"]))
    return thin, distance
