"""Export: every file is read again here by another way than the export's own checks use."""

import csv
import hashlib
import json
import os
import stat
import struct
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cadquery
import numpy as np
import pytest
import trimesh

import designlab.fabrication as fabricate
from designlab.fabrication import export, led_colour, parts
from designlab.fabrication.boards import boards
from designlab.fabrication.boards.orders import solid as board_solid
from designlab.fabrication.checks import FileCheck, check_overlaps, mesh_checks, overlap_mm3, require
from designlab.fabrication.tables import CLEAR_STOCK, led_rows
from designlab.fabrication.triangles import printable, read, write_3mf
from designlab.sensor.design import Design, InfeasibleDesign, load, preset
from designlab.sensor.optical_constants import MATERIALS
from geometries.elastomer import base_mm
from geometries.mesh import from_solid, open_edges
from geometries.probes import parse

PRESETS = ("default", "gelsight-2020-flat", "gelsight-2020-dome")
SENSOR = ("gelcore", "elastomer", "led_array", "housing")
THREEMF = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"


def tube(name: str) -> Design:
    """A preset in a plain tube: seats have tests of their own."""
    return preset(name).replace({"housing.seats": None, "name": name})


@pytest.fixture(scope="session")
def exports(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Folder of the export of each preset, made once; the default one with a probe."""
    base = tmp_path_factory.mktemp("exports")
    for name in PRESETS:
        probes = ["cone:4"] if name == "default" else ()
        export(tube(name), base / name, probes=probes, allow_infeasible=name != "default")
    return {name: base / name for name in PRESETS}


@pytest.fixture
def folder(exports: dict[str, Path], request: pytest.FixtureRequest) -> Path:
    return exports[request.param]


@pytest.fixture
def cheap(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the mould out: what becomes of the folder does not depend on it."""
    real = parts

    def few(design: Design, **options: Any) -> dict[str, Any]:
        return {name: shape for name, shape in real(design, **options).items() if "mould" not in name}

    monkeypatch.setattr(fabricate, "parts", few)
    monkeypatch.setattr(fabricate, "CASTING_PARTS", ())


def stl_triangles(path: Path) -> np.ndarray:
    """Corners of a binary STL file, read byte by byte as the format is defined; shape (n, 3, 3)."""
    data = path.read_bytes()
    (count,) = struct.unpack_from("<I", data, 80)
    assert len(data) == 84 + 50 * count
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    return np.frombuffer(data, record, count, 84)["corners"].astype(float)


def signed_volume(triangles: np.ndarray) -> float:
    """Divergence theorem: the sum of the tetrahedra between the origin and each triangle."""
    return float(np.einsum("ij,ij->i", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])).sum() / 6)


@pytest.mark.slow
@pytest.mark.parametrize("folder", PRESETS, indirect=True)
def test_every_stl_is_closed_and_has_the_volume_of_its_step(folder: Path) -> None:
    names = sorted(path.stem for path in (folder / "stl").iterdir())
    assert {*SENSOR, "mould_cavity", "mould_lid"} <= set(names)
    for name in names:
        triangles = stl_triangles(folder / "stl" / f"{name}.stl")
        solid = cadquery.importers.importStep(str(folder / "step" / f"{name}.step")).val()
        assert solid.isValid(), name
        assert signed_volume(triangles) == pytest.approx(solid.Volume(), rel=5e-3), name
        # On a closed surface the area vectors of the triangles cancel.
        area = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) / 2
        assert np.abs(area.sum(axis=0)).max() < 1e-4 * np.abs(area).sum(), name
        box = solid.BoundingBox(0.001)
        assert triangles.min(axis=(0, 1)) == pytest.approx([box.xmin, box.ymin, box.zmin], abs=0.05), name
        assert triangles.max(axis=(0, 1)) == pytest.approx([box.xmax, box.ymax, box.zmax], abs=0.05), name


@pytest.mark.slow
def test_volumes_are_those_of_closed_forms(exports: dict[str, Path]) -> None:
    design = preset("default")
    volumes = {
        name: part["volume_mm3"]
        for name, part in json.loads((exports["default"] / "manifest.json").read_text())["parts"].items()
    }
    hexagon = np.sqrt(3) / 2 * design.gelcore.width_mm**2
    assert volumes["gelcore"] == pytest.approx(hexagon * design.gelcore.height_mm, rel=1e-9)
    assert volumes["elastomer"] == pytest.approx(hexagon * design.elastomer.thickness_mm, rel=1e-9)
    leds, housing = design.leds, design.housing
    # On their boards LEDs are those that are bought: Kingbright APTF1616, 1.6 x 1.6 x 0.7 mm.
    assert volumes["led_array"] == pytest.approx(9 * 1.6 * 1.6 * 0.7, rel=1e-9)
    drawn = leds.body_width_mm * leds.body_height_mm * leds.body_thickness_mm
    assert parts(design)["led_array"].Volume() == pytest.approx(9 * drawn, rel=1e-9)
    inner, outer = housing.inner_radius_mm, housing.inner_radius_mm + housing.wall_mm
    tube = np.pi * (outer**2 - inner**2) * (housing.top_mm - housing.bottom_mm)
    plate = np.pi * (outer**2 - (housing.camera_hole_mm / 2) ** 2) * housing.plate_mm
    assert volumes["housing"] == pytest.approx(tube + plate, rel=1e-9)
    assert volumes["probe_cone_4mm"] > np.pi * 2**2 * 2 / 3


@pytest.mark.slow
def test_thinned_dome_stays_on_its_sphere(exports: dict[str, Path]) -> None:
    """Corners and edge middles of the gel's outer side lie within both tolerances of the sphere."""
    gel = preset("gelsight-2020-dome").elastomer
    assert gel.radius_mm is not None
    triangles = stl_triangles(exports["gelsight-2020-dome"] / "stl" / "elastomer.stl")
    centre = triangles.mean(axis=1)
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    from_middle = centre - [0, 0, gel.radius_mm]
    faces_outwards = np.einsum("ij,ij->i", normal, from_middle) > 0
    outer = faces_outwards & (np.hypot(*centre[:, :2].T) < gel.width_mm / 2 - 0.2)
    assert outer.sum() > 500
    edges = (triangles[outer] + np.roll(triangles[outer], 1, axis=1)) / 2
    for points in (triangles[outer].reshape(-1, 3), edges.reshape(-1, 3)):
        off = np.linalg.norm(points - [0, 0, gel.radius_mm], axis=1) - gel.radius_mm
        assert np.abs(off).max() < 0.005 + 0.0025
    assert base_mm(gel, 10.0, 0.0) == pytest.approx(35 - np.sqrt(35**2 - 10**2))


@pytest.mark.slow
def test_thinned_meshes_keep_their_bound_by_another_measure(exports: dict[str, Path]) -> None:
    """Distances from points of the STL to the CAD surface, by the CAD kernel instead of the mesh library."""
    folder = exports["gelsight-2020-dome"]
    report = json.loads((folder / "manifest.json").read_text())["parts"]
    rng = np.random.default_rng(0)
    for name in ("housing", "mould_cavity"):
        mesh = report[name]["mesh"]
        if mesh["tool"] == "pymeshlab":
            assert mesh["triangles"] < mesh["triangles_fine"]
        triangles = stl_triangles(folder / "stl" / f"{name}.stl")
        chosen = triangles[rng.choice(len(triangles), 60)]
        points = np.einsum("nij,ni->nj", chosen, rng.dirichlet([1, 1, 1], 60))
        solid = cadquery.importers.importStep(str(folder / "step" / f"{name}.step")).val()
        surface = cadquery.Compound.makeCompound(solid.Shells())
        off = max(cadquery.Vertex.makeVertex(*point).distance(surface) for point in points.tolist())
        assert off < mesh["hausdorff_bound_mm"] + 0.0025, name


@pytest.mark.parametrize("name", PRESETS)
def test_closed_mould_leaves_the_gel(name: str) -> None:
    """Fill a block with the closed mould: what stays free below the lid is the gel, pin feet and grooves."""
    shapes = parts(preset(name))
    cavity, lid, gel = shapes["mould_cavity"], shapes["mould_lid"], shapes["elastomer"]
    assert overlap_mm3(cavity, gel) == pytest.approx(0, abs=1e-6)
    assert overlap_mm3(lid, gel) == pytest.approx(0, abs=1e-6)
    assert overlap_mm3(cavity, lid) == pytest.approx(0, abs=1e-6)
    box, bottom = lid.BoundingBox(), cavity.BoundingBox().zmin
    block = cadquery.Workplane("XY", origin=(0, 0, bottom)).box(
        box.xlen, box.ylen, box.zmax - bottom, centered=(True, True, False)
    )
    free = block.cut(cadquery.Workplane(cavity)).cut(cadquery.Workplane(lid))
    # Around a pin of 3 mm: a hole of 3.2 mm that is 0.5 mm deeper.
    pins = 4 * np.pi * (1.6**2 * 3.5 - 1.5**2 * 3.0)
    gel_box, depth = gel.BoundingBox(), min(0.5, preset(name).elastomer.thickness_mm / 2)
    grooves = (box.xlen - gel_box.xlen + box.ylen - gel_box.ylen) * 1.0 * depth
    rest = free.val().Volume() - gel.Volume() - pins
    assert rest == pytest.approx(
        grooves, abs=0.2
    )  # at a corner or a round edge a groove starts a little earlier
    for point in ((0.0, 0.0, bottom + 1), (0.0, 0.0, box.zmax - 1)):
        assert cavity.isInside(point) or lid.isInside(point)


@pytest.mark.slow
def test_assembly_names_and_colours_every_part(exports: dict[str, Path]) -> None:
    path = exports["default"] / "assembly.step"
    text = path.read_text()
    design = tube("default")
    carried = boards(design).boards
    for name in ("gelcore", "elastomer", "housing", "led_001_red", "led_004_green", "led_009_blue"):
        assert f"'{name}'" in text
    assert "COLOUR_RGB" in text
    loaded = cadquery.importers.importStep(str(path))
    total = sum(solid.Volume() for shape in loaded.vals() for solid in shape.Solids())
    built = parts(design, boards=carried)
    made = sum(built[name].Volume() for name in SENSOR)
    made += sum(board_solid(board).Volume() for board in carried)
    assert total == pytest.approx(made, rel=1e-6)


@pytest.mark.slow
def test_3mf_holds_the_triangles_of_the_stl(exports: dict[str, Path]) -> None:
    """Read the package with nothing but zip and XML; the object must be closed by vertex numbers alone."""
    folder = exports["default"]
    assert sorted(path.stem for path in (folder / "3mf").iterdir()) == [
        "housing",
        "mould_cavity",
        "mould_lid",
        "probe_cone_4mm",
    ]
    with zipfile.ZipFile(folder / "3mf" / "housing.3mf") as package:
        assert {"[Content_Types].xml", "_rels/.rels", "3D/3dmodel.model"} == set(package.namelist())
        root = ElementTree.fromstring(package.read("3D/3dmodel.model"))
    assert root.attrib["unit"] == "millimeter"
    vertices = np.array([[float(v.attrib[a]) for a in "xyz"] for v in root.iter(f"{THREEMF}vertex")])
    faces = np.array(
        [[int(t.attrib[a]) for a in ("v1", "v2", "v3")] for t in root.iter(f"{THREEMF}triangle")]
    )
    stl = stl_triangles(folder / "stl" / "housing.stl")
    assert vertices[faces] == pytest.approx(stl, abs=1e-5)
    edges = {(a, b) for face in faces.tolist() for a, b in zip(face, [*face[1:], face[0]], strict=True)}
    assert edges == {(b, a) for a, b in edges}


@pytest.mark.slow
@pytest.mark.parametrize("folder", PRESETS, indirect=True)
def test_led_table_follows_from_the_angles(folder: Path) -> None:
    design = load(folder / "design.toml")
    assert design.digest == json.loads((folder / "manifest.json").read_text())["digest"]
    with (folder / "leds.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    leds = design.leds
    strips = len(leds.emitting_spans_mm)
    assert len(rows) == strips * sum(group.count * len(group.azimuth_deg) for group in leds.groups)
    tilt = np.radians(leds.tilt_deg)
    for group in leds.groups:
        mine = [row for row in rows if row["group"] == group.name]
        flux = "relative_flux" if leds.relative_flux else "flux_mw"
        assert sum(float(row[flux]) for row in mine) == pytest.approx(group.flux_mw, rel=1e-5)
        assert {float(row["wavelength_nm"]) for row in mine} == {group.wavelength_nm}
        azimuth = np.radians(group.azimuth_deg[0])
        radial = np.array([np.cos(azimuth), np.sin(azimuth)])
        for row in mine:
            normal = [float(row[f"normal_{axis}"]) for axis in "xyz"]
            assert normal == pytest.approx([*(-np.cos(tilt) * radial), -np.sin(tilt)], abs=1e-5)
        # The middle of a row's faces lies at the array's radius and height.
        middle = np.mean([[float(row[f"{axis}_mm"]) for axis in "xyz"] for row in mine], axis=0)
        span = np.mean([low + high for low, high in leds.emitting_spans_mm]) / 2
        expected = leds.radius_mm + span * np.sin(tilt), leds.height_mm - span * np.cos(tilt)
        assert (middle[:2] @ radial, middle[2]) == pytest.approx(expected, abs=1e-4)


def test_strips_share_flux_by_area() -> None:
    design = preset("default").replace({"leds.emitting_spans_mm": ((-1.2, -0.9), (0.0, 0.9))})
    first, second = led_rows(design)[:2]
    assert (first["led"], first["strip"], second["strip"]) == (1, 1, 2)
    assert second["flux_mw"] == pytest.approx(3 * first["flux_mw"], rel=1e-5)
    assert first["flux_mw"] + second["flux_mw"] == pytest.approx(10.0, rel=1e-5)


@pytest.mark.slow
def test_bill_of_materials(exports: dict[str, Path]) -> None:
    with (exports["default"] / "bom.csv").open(encoding="utf-8") as file:
        rows = {row["item"]: row for row in csv.DictReader(file)}
    gel_ml = np.sqrt(3) / 2 * 26**2 * 2 / 1000
    assert float(rows["elastomer"]["volume_ml"]) == pytest.approx(gel_ml, abs=1e-4)
    assert float(rows["elastomer"]["mass_g"]) == pytest.approx(1.03 * gel_ml, abs=1e-3)
    assert f"{np.sqrt(3) / 2 * 26**2:.0f} mm²" in rows["membrane"]["material"]
    assert [rows[f"led_{name}"]["count"] for name in ("red", "green", "blue")] == ["3", "3", "3"]
    # What is bought is one part; the design's own light is a note beside it.
    assert rows["led_red"]["material"].endswith("1.6 x 1.6 x 0.7 mm, lit in red")
    assert "light in the design: 10 mW each" in rows["led_red"]["note"]
    with (exports["gelsight-2020-flat"] / "bom.csv").open(encoding="utf-8") as file:
        relative = next(row for row in csv.DictReader(file) if row["item"] == "led_red")
    assert "relative, no power is known" in relative["material"] + relative["note"]
    assert "mW" not in relative["material"] + relative["note"]
    assert set(CLEAR_STOCK) == set(MATERIALS)


@pytest.mark.slow
@pytest.mark.parametrize("folder", PRESETS, indirect=True)
def test_manifest_lists_every_file_with_its_hash(folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    present = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert present == {*manifest["files"], "manifest.json"}
    for name, digest in manifest["files"].items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
    assert all(check["ok"] for check in manifest["checks"])
    assert json.loads((folder / "checks.json").read_text()) == manifest["checks"]
    assert manifest["walls"]["thinnest_mm"] >= manifest["walls"]["least_mm"]


@pytest.mark.slow
def test_overlap_of_panels_and_core_is_said_aloud(exports: dict[str, Path]) -> None:
    """The released scenes leave the core out, and their panels stand in the room of the core."""
    for name in PRESETS[1:]:
        manifest = json.loads((exports[name] / "manifest.json").read_text())
        told = "\n".join(manifest["warnings"])
        assert "not buildable as published: its light does not see the gelcore" in told
        assert "gelcore/led_array overlap" in told
        assert "gelcore/led_array overlap" in (exports[name] / "README.txt").read_text()
    # The default sensor can be built; what is said there is about the LED part, which it does not name.
    told = json.loads((exports["default"] / "manifest.json").read_text())["warnings"]
    assert all("kingbright-aptf1616" in warning for warning in told)


def test_overlap_volume_of_boxes() -> None:
    box = cadquery.Workplane("XY").box(2, 2, 2).val()
    moved = cadquery.Compound.makeCompound([box.translate((1.5, 0, 0)), box.translate((0, 0, 2))])
    assert overlap_mm3(box, moved) == pytest.approx(0.5 * 2 * 2)


def test_overlap_fails_where_light_crosses_the_core() -> None:
    design = preset("default")
    shapes = parts(design.replace({"leds.radius_mm": 12.0}))
    (check,) = check_overlaps(design, shapes, [("gelcore", "led_array")])
    assert not check.ok
    with pytest.raises(RuntimeError, match=r"gelcore/led_array: overlap is \d+\.\d+ mm3, bound 1"):
        require([check])
    (in_air,) = check_overlaps(
        design.replace({"optics.light_path": "air"}), shapes, [("gelcore", "led_array")]
    )
    assert in_air.ok
    assert "light_path is air" in in_air.note


@pytest.mark.slow
def test_infeasible_design_is_refused_unless_allowed(tmp_path: Path, cheap: None) -> None:
    design = tube("default").replace({"leds.radius_mm": 15.5})
    with pytest.raises(InfeasibleDesign, match="leds_inside_housing"):
        export(design, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    manifest = export(design, tmp_path / "out", allow_infeasible=True)
    assert any("leds_inside_housing" in warning for warning in manifest["warnings"])
    assert any("housing" in warning and "overlap" in warning for warning in manifest["warnings"])


@pytest.mark.slow
def test_export_replaces_only_an_export(tmp_path: Path, cheap: None) -> None:
    design, out = tube("default"), tmp_path / "deep" / "out"
    export(design, out, probes=["cone:3"])
    assert (out / "stl" / "probe_cone_3mm.stl").exists()
    steps: list[tuple[str, int, int]] = []
    export(design, out, progress=lambda *step: steps.append(step))
    assert not (out / "stl" / "probe_cone_3mm.stl").exists()
    assert [done for _, done, _ in steps] == list(range(len(steps)))
    assert steps[-1][1] == steps[-1][2]
    assert [path.name for path in out.parent.iterdir()] == ["out"]

    before = (out / "manifest.json").read_bytes()
    (out / "my-notes.txt").write_text("keep me")
    with pytest.raises(ValueError, match=r"out: the folder must be .* it also holds 'my-notes.txt'"):
        export(design, out)
    assert (out / "my-notes.txt").read_text() == "keep me"
    assert (out / "manifest.json").read_bytes() == before


@pytest.mark.parametrize("content", ["", "{}", "[1]", '{"kind": "something else", "files": {}}', "\x00"])
def test_foreign_folder_is_left_alone(tmp_path: Path, content: str) -> None:
    (tmp_path / "manifest.json").write_text(content)
    with pytest.raises(ValueError, match=r"must be absent, empty or an earlier export"):
        export(preset("default"), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["manifest.json"]


def test_file_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    with pytest.raises(ValueError, match="it is a file"):
        export(preset("default"), tmp_path / "out")
    assert (tmp_path / "out").read_text() == "a file"


@pytest.fixture
def unprivileged() -> Iterator[None]:
    """Permissions do not bind root, so act as nobody for a while."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def test_read_only_folders(tmp_path: Path, cheap: None, request: pytest.FixtureRequest) -> None:
    for path in (tmp_path, *tmp_path.parents[:2]):
        path.chmod(path.stat().st_mode | stat.S_IXOTH | stat.S_IROTH)
    out = tmp_path / "out"
    out.mkdir()
    out.chmod(0o555)
    request.getfixturevalue("unprivileged")
    with pytest.raises(PermissionError):
        export(preset("default"), out)
    with pytest.raises(PermissionError):
        export(preset("default"), tmp_path / "new")


@pytest.mark.slow
def test_failed_check_leaves_the_earlier_export(
    tmp_path: Path, cheap: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    export(tube("default"), out, boards=False)
    before = (out / "manifest.json").read_bytes()

    whole = trimesh.Trimesh.export

    def holed(mesh: trimesh.Trimesh, *args: Any, **options: Any) -> Any:
        mesh = mesh.copy()
        mesh.update_faces(np.arange(len(mesh.faces)) != 3)
        return whole(mesh, *args, **options)

    monkeypatch.setattr(trimesh.Trimesh, "export", holed)
    with pytest.raises(RuntimeError, match=r"gelcore gelcore\.stl: open edges is 3 1, bound 0"):
        export(tube("default"), out, boards=False)
    assert (out / "manifest.json").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_interruption_leaves_nothing(tmp_path: Path, cheap: None) -> None:
    def interrupt(name: str, done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export(preset("default"), tmp_path / "out", progress=interrupt)
    assert list(tmp_path.iterdir()) == []


def test_without_pymeshlab_the_fine_mesh_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymeshlab", None)
    shape = parts(preset("default"))["housing"]
    mesh, report = printable(shape, bound_mm=0.02)
    assert report["tool"] == "trimesh"
    assert "PyMeshLab is not installed" in report["note"]
    assert report["triangles"] == report["triangles_fine"] == len(mesh.faces)
    assert mesh.volume == pytest.approx(shape.Volume(), rel=1e-3)


@pytest.mark.slow
def test_mesh_probe_is_written_as_it_is(tmp_path: Path, cheap: None) -> None:
    source = tmp_path / "my probe.stl"
    from_solid(cadquery.Workplane("XY").box(3, 2, 1)).export(source)
    manifest = export(tube("default"), tmp_path / "out", boards=False, probes=[parse(f"{source}:6")])
    triangles = stl_triangles(tmp_path / "out" / "stl" / "probe_my_probe_6mm.stl")
    assert signed_volume(triangles) == pytest.approx(8 * 6, rel=1e-5)
    assert manifest["parts"]["probe_my_probe_6mm"]["size_mm"] == pytest.approx([6, 4, 2])


@pytest.mark.slow
def test_a_rounded_probe_is_written_beside_the_sharp_one(tmp_path: Path, cheap: None) -> None:
    manifest = export(
        tube("default"), tmp_path / "out", boards=False, probes=["triangle:5", "triangle:5:r0.3"]
    )
    sharp, rounded = (
        stl_triangles(tmp_path / "out" / "stl" / f"probe_triangle_5mm{edge}.stl")
        for edge in ("", "_edge_0.3mm")
    )
    assert (tmp_path / "out" / "step" / "probe_triangle_5mm_edge_0.3mm.step").exists()
    assert (tmp_path / "out" / "3mf" / "probe_triangle_5mm_edge_0.3mm.3mf").exists()
    # Beside a straight edge r^2 (1 - pi/4) is missing, of the upright corners r^2 (sqrt 3 - pi/3) each.
    along, upright = 0.3**2 * (1 - np.pi / 4), 0.3**2 * (np.sqrt(3) - np.pi / 3)
    lost = signed_volume(sharp) - signed_volume(rounded)
    assert lost == pytest.approx(3 * 5 * along + 3 * 5 * upright, rel=0.1)
    assert all(check["ok"] for check in manifest["checks"])


def test_probes_of_one_name_or_unknown_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    for path in (tmp_path / "p.stl", tmp_path / "a" / "p.stl"):
        from_solid(cadquery.Workplane("XY").box(3, 2, 1)).export(path)
    same = [parse(f"{tmp_path / 'p.stl'}:6"), parse(f"{tmp_path / 'a' / 'p.stl'}:6")]
    with pytest.raises(ValueError, match="probes: their names must differ, got probe_p_6mm, probe_p_6mm"):
        export(preset("default"), tmp_path / "out", probes=same)
    with pytest.raises(ValueError, match="spoon"):
        export(preset("default"), tmp_path / "out", probes=["spoon:3"])
    assert not (tmp_path / "out").exists()


def test_mesh_checks_find_each_fault() -> None:
    mesh = from_solid(cadquery.Workplane("XY").box(2, 3, 4))

    def failing(candidate: Any, volume: float = 24.0) -> set[str]:
        return {check.name for check in mesh_checks("p", "f", candidate, volume_mm3=volume) if not check.ok}

    assert failing(mesh) == set()
    inverted = mesh.copy()
    inverted.invert()
    assert failing(inverted) == {"signed volume", "volume error"}
    holed = mesh.copy()
    holed.update_faces(np.arange(len(mesh.faces)) != 0)
    assert "open edges" in failing(holed)
    twisted = mesh.copy()
    twisted.faces = np.vstack([twisted.faces[:1, ::-1], twisted.faces[1:]])
    assert "open edges" in failing(twisted)
    assert failing(mesh, volume=24.2) == {"volume error"}
    assert isinstance(mesh_checks("p", "f", mesh, volume_mm3=24.0)[0], FileCheck)


def test_bodies_that_touch_along_an_edge_are_closed(tmp_path: Path) -> None:
    first = cadquery.Workplane("XY").box(1, 1, 1)
    pair = cadquery.Compound.makeCompound([first.val(), first.translate((1, 1, 0)).val()])
    mesh, _ = printable(pair, bound_mm=0.01)
    mesh.export(tmp_path / "pair.stl", file_type="stl")
    merged = read(tmp_path / "pair.stl")
    assert not merged.is_watertight  # four triangles meet at the common edge, yet nothing is open
    assert open_edges(merged) == 0
    write_3mf(mesh, tmp_path / "pair.3mf", name="pair")
    assert read(tmp_path / "pair.3mf").volume == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("wavelength_nm", "strongest"), [(350, 2), (465, 2), (525, 1), (625, 0), (660, 0), (950, 0)]
)
def test_led_colour_is_what_one_sees(wavelength_nm: float, strongest: int) -> None:
    colour = led_colour(wavelength_nm)
    assert int(np.argmax(colour)) == strongest
    assert all(0 <= channel <= 1 for channel in colour)


@pytest.mark.slow
def test_what_a_preset_assumes_is_listed(tmp_path: Path) -> None:
    design = preset("gelslim-3-like").replace({"gelcore.height_mm": 8.2})
    manifest = export(design, tmp_path / "out")
    assert "elastomer.thickness_mm" in manifest["assumed"]
    assert "gelcore.height_mm" not in manifest["assumed"]  # it was stated
    assert "leds.pitch_mm" not in manifest["assumed"]  # it has a source
    text = " ".join((tmp_path / "out" / "README.txt").read_text(encoding="utf-8").split())
    assert "Assumed, for want of a published figure" in text
    assert "elastomer.thickness_mm" in text
