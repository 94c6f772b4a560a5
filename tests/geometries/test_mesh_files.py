"""Mesh files that users bring: one body in every form gives one surface, and what is wrong is said."""

import io
import struct
import time
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from geometries import mesh_files, probes
from geometries.mesh_files import MeshNote, load
from geometries.probes import Probe, from_file, mesh_text, parse, profile_mm, understood

X, Y = np.meshgrid(np.linspace(-3, 3, 41), np.linspace(-3, 3, 43))
UNITS_MM = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}


def knob(scale: float = 1.0) -> trimesh.Trimesh:
    """A plate of 12 x 10 x 3 mm with a crooked pyramid on it: no two of its sides are alike."""
    plate = trimesh.creation.box((12.0, 10.0, 3.0))
    plate.apply_translation((0, 0, -3.5))
    corners = [(-2.5, -2, -2), (2.5, -1.5, -2), (2, 2.5, -2), (-2, 1.5, -2), (0.5, 0.3, 0)]
    faces = [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4), (0, 2, 1), (0, 3, 2)]
    body = trimesh.util.concatenate([plate, trimesh.Trimesh(corners, faces, process=False)])
    body.apply_scale(scale)
    return body


def expected() -> np.ndarray:
    """Surface of the knob in mm, seen from +z, from its planes."""
    corners, tip = np.array([(-2.5, -2), (2.5, -1.5), (2, 2.5), (-2, 1.5)]), np.array([0.5, 0.3])
    found = np.full(X.shape, -2.0)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        side = np.column_stack([a - tip, b - tip])
        u, v = np.einsum("ij,jkl->ikl", np.linalg.inv(side), np.stack([X - tip[0], Y - tip[1]]))
        inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1)
        found = np.where(inside, -2.0 * (u + v), found)
    return found


def as_bytes(body: trimesh.Trimesh, file_type: str) -> bytes:
    data = body.export(file_type=file_type)
    return data if isinstance(data, bytes) else str(data).encode()


def as_3mf(body: trimesh.Trimesh, unit: str = "millimeter", *, apart: bool = False) -> bytes:
    """A package as slicers write it; `apart`: its object in a file of its own, moved and moved back."""
    points = body.vertices + ((5, 0, 0) if apart else (0, 0, 0))
    vertices = "".join(f'<vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>' for x, y, z in points)
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in body.faces)
    core = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
    made = (
        f'<object id="1" type="model"><mesh><vertices>{vertices}</vertices>'
        f"<triangles>{triangles}</triangles></mesh></object>"
    )
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as package:
        inside, item = made, '<item objectid="1"/>'
        if apart:
            package.writestr(
                "3D/Objects/a.model", f'<model xmlns="{core}"><resources>{made}</resources></model>'
            )
            inside = (
                '<object id="2" type="model"><components><component p:path="/3D/Objects/a.model" '
                'objectid="1" transform="1 0 0 0 1 0 0 0 1 -5 0 0"/></components></object>'
            )
            item = '<item objectid="2"/>'
        package.writestr(
            "3D/3dmodel.model",
            f'<model unit="{unit}" xmlns="{core}" '
            'xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06">'
            f"<resources>{inside}</resources><build>{item}</build></model>",
        )
    return file.getvalue()


def as_step(unit: str = "MM") -> bytes:
    """The knob as a CAD program writes it."""
    import cadquery
    from OCP.Interface import Interface_Static
    from OCP.STEPControl import STEPControl_AsIs, STEPControl_Writer

    body = knob()
    solids = []
    for part in body.split(only_watertight=False):
        faces = []
        for corners in part.triangles:
            wire = cadquery.Wire.makePolygon([cadquery.Vector(*point) for point in corners], close=True)
            faces.append(cadquery.Face.makeFromWires(wire))
        solids.append(cadquery.Solid.makeSolid(cadquery.Shell.makeShell(faces)))
    writer = STEPControl_Writer()
    Interface_Static.SetCVal_s("write.step.unit", unit)
    try:
        writer.Transfer(cadquery.Compound.makeCompound(solids).wrapped, STEPControl_AsIs)
        path = Path("knob.step").absolute()
        writer.Write(str(path))
    finally:
        Interface_Static.SetCVal_s("write.step.unit", "MM")
    data = path.read_bytes()
    path.unlink()
    return data


def quads() -> bytes:
    """OBJ as modellers write it: quads, texture places, a material that is missing, counting backwards."""
    lines = ["mtllib lost.mtl", "o knob", "usemtl steel", "vt 0 0"]
    for x, y, z in knob().vertices:
        lines.append(f"v {x:.9g} {y:.9g} {z:.9g}")
    box = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    lines += [f"f {' '.join(f'{corner + 1}/1' for corner in face)}" for face in box]
    pyramid = knob().faces[12:]
    lines += [f"f {' '.join(str(int(corner) - 13) for corner in face)}" for face in pyramid]
    return "\n".join(lines).encode()


def ascii_stl(*, upper: bool = False, comma: bool = False) -> bytes:
    text = as_bytes(knob(), "stl_ascii").decode()
    text = text.replace(".", ",") if comma else text
    return (text.upper() if upper else text).replace("\n", "\r\n").encode()


def with_gltf(folder: Path) -> bytes:
    """A glTF whose buffers are files beside it."""
    files = knob(1e-3).export(file_type="gltf")
    for name, data in files.items():
        if name != "model.gltf":
            (folder / name).write_bytes(data)
    return files["model.gltf"]


def stl(scale: float = 1.0) -> bytes:
    return as_bytes(knob(scale), "stl")


FORMS: dict[str, Any] = {
    "binary.stl": lambda _: stl(),
    "UPPER.STL": lambda _: stl(),
    "solid.stl": lambda _: b"solid made by CAD".ljust(80) + stl()[80:],
    "trailing.stl": lambda _: stl() + bytes(37),
    "ascii.stl": lambda _: ascii_stl(),
    "shouted.stl": lambda _: ascii_stl(upper=True),
    "comma.stl": lambda _: ascii_stl(comma=True),
    "quads.obj": lambda _: quads(),
    "triangles.obj": lambda _: as_bytes(knob(), "obj"),
    "binary.ply": lambda _: as_bytes(knob(), "ply"),
    "ascii.ply": lambda _: knob().export(file_type="ply", encoding="ascii"),
    "body.off": lambda _: as_bytes(knob(), "off"),
    "metres.glb": lambda _: as_bytes(knob(1e-3), "glb"),
    "millimetres.glb": lambda _: as_bytes(knob(), "glb"),
    "beside.gltf": with_gltf,
    "body.3mf": lambda _: as_3mf(knob()),
    "inch.3mf": lambda _: as_3mf(knob(1 / 25.4), "inch"),
    "apart.3mf": lambda _: as_3mf(knob(), apart=True),
    "body.step": lambda _: as_step(),
    "inch.stp": lambda _: as_step("INCH"),
}


def slow_if_step(name: str) -> Any:
    """STEP files are read by a process of their own, which loads OpenCASCADE."""
    return pytest.mark.slow if name.endswith(("step", "stp")) else ()


@pytest.mark.filterwarnings("ignore::geometries.mesh_files.MeshNote")
@pytest.mark.parametrize("name", [pytest.param(name, marks=slow_if_step(name)) for name in FORMS])
def test_one_body_in_every_format_has_one_surface(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / name
    path.write_bytes(FORMS[name](tmp_path))
    probe = parse(str(path))
    assert probe.size_mm == pytest.approx(12.0, rel=1e-5)
    np.testing.assert_allclose(profile_mm(probe, X, Y), expected(), atol=1e-3)
    said = understood(probe)
    assert said is not None
    assert said.extents_mm == pytest.approx((12, 10, 5), rel=1e-5)
    assert said.form.lower() == {"stp": "step"}.get(ending := path.suffix[1:].lower(), ending)


@pytest.mark.parametrize("unit", UNITS_MM)
@pytest.mark.parametrize("by", ["argument", "text"])
def test_one_body_in_every_unit_has_one_surface(unit: Any, by: str, tmp_path: Path) -> None:
    path = tmp_path / "knob.stl"
    path.write_bytes(stl(1 / UNITS_MM[unit]))
    probe = parse(str(path), unit=unit) if by == "argument" else parse(f"{path}:{unit}")
    np.testing.assert_allclose(profile_mm(probe, X, Y), expected(), atol=1e-3)
    assert understood(probe).unit == unit


# Turns of the body after which this side of it shows what +z showed, x staying in the plane of the turn.
TURNS: dict[str, tuple[float, tuple[int, int, int]]] = {
    "+z": (0, (1, 0, 0)),
    "-z": (180, (1, 0, 0)),
    "+x": (90, (0, 1, 0)),
    "-x": (-90, (0, 1, 0)),
    "+y": (-90, (1, 0, 0)),
    "-y": (90, (1, 0, 0)),
}


@pytest.mark.parametrize("side", TURNS)
@pytest.mark.parametrize("form", ["stl", "ply", "obj"])
def test_one_body_pressed_with_any_side_has_one_surface(side: Any, form: str, tmp_path: Path) -> None:
    degrees, axis = TURNS[side]
    body = knob()
    body.apply_transform(trimesh.transformations.rotation_matrix(np.radians(degrees), axis))
    body.apply_translation((7, -3, 20))
    path = tmp_path / f"knob.{form}"
    path.write_bytes(as_bytes(body, form))
    probe = parse(f"{path}:{side}")
    np.testing.assert_allclose(profile_mm(probe, X, Y), expected(), atol=1e-3)
    assert probe == from_file(path, side=side) == parse(str(path), side=side)
    again = parse(probe.text)
    assert again.side == side
    np.testing.assert_allclose(profile_mm(again, X, Y), expected(), atol=1e-3)
    assert f"pressed with its {side} side" in str(understood(probe))


UNITS_3MF = {"um": "micron", "mm": "millimeter", "cm": "centimeter", "m": "meter", "inch": "inch"}


@pytest.mark.filterwarnings("ignore::geometries.mesh_files.MeshNote")
@pytest.mark.parametrize("form", ["stl", "stl_ascii", "obj", "ply", "off", "glb", "3mf"])
def test_format_unit_and_side_together_change_nothing(form: str, tmp_path: Path) -> None:
    units: list[Any] = list(UNITS_MM)
    for number, (side, (degrees, axis)) in enumerate(TURNS.items()):
        unit = units[(number + len(form)) % len(units)]
        body = knob(1 / UNITS_MM[unit])
        body.apply_transform(trimesh.transformations.rotation_matrix(np.radians(degrees), axis))
        path = tmp_path / f"knob-{number}.{form.partition('_')[0]}"
        if form == "3mf":  # states its unit itself
            path.write_bytes(as_3mf(body, UNITS_3MF[unit]))
            probe = parse(f"{path}:{side}")
        else:
            path.write_bytes(as_bytes(body, form))
            probe = parse(f"{path}:{unit}:{side}")
        np.testing.assert_allclose(profile_mm(probe, X, Y), expected(), atol=1e-3)
        assert understood(probe).unit == unit


@pytest.mark.slow
def test_every_side_of_a_step_file_is_that_of_the_mesh(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "inch.stp").write_bytes(FORMS["inch.stp"](tmp_path))
    (tmp_path / "knob.stl").write_bytes(stl())
    for side in TURNS:
        step, mesh = (parse(f"{tmp_path / file}:{side}") for file in ("inch.stp", "knob.stl"))
        np.testing.assert_allclose(profile_mm(step, X, Y), profile_mm(mesh, X, Y), atol=1e-3)


@pytest.mark.parametrize("part", ["hole", "scan", "one wall missing", "inside out"])
def test_only_the_side_that_presses_counts(part: str, tmp_path: Path) -> None:
    body = knob()
    up = body.face_normals[:, 2]
    if part == "hole":
        body.update_faces(np.arange(len(body.faces)) != int(np.flatnonzero(up < -0.9)[0]))
    elif part == "scan":
        body.update_faces(up > 0.1)
    elif part == "one wall missing":
        body.update_faces(body.face_normals[:, 0] < 0.9)
    else:
        body.invert()
    path = tmp_path / "knob.stl"
    path.write_bytes(as_bytes(body, "stl"))
    np.testing.assert_allclose(profile_mm(parse(str(path)), X, Y), expected(), atol=1e-3)


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".STL"])
def test_load_centres_and_scales(tmp_path: Path, suffix: str) -> None:
    box = trimesh.creation.box((4.0, 2.0, 1.0))
    box.apply_translation((10.0, -20.0, 30.0))
    path = tmp_path / f"part{suffix}"
    path.write_bytes(as_bytes(box, suffix.lower()[1:]))
    np.testing.assert_allclose(load(path).bounds, [(-2, -1, -1), (2, 1, 0)], atol=1e-5)
    np.testing.assert_allclose(load(path, size_mm=8.0).bounds, [(-4, -2, -2), (4, 2, 0)], atol=1e-5)


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
    ("spoil", "note"),
    [
        (lambda body: body.update_faces(np.arange(len(body.faces)) != 3), "holes were filled"),
        (lambda body: body.invert(), "normals were turned outwards"),
    ],
)
def test_small_defects_are_repaired_to_be_made(tmp_path: Path, spoil: Any, note: str) -> None:
    body = trimesh.creation.box((4.0, 2.0, 1.0))
    spoil(body)
    path = tmp_path / "part.stl"
    body.export(path)
    repaired, notes = mesh_files.closed(load(path))
    assert notes == (note,)
    assert repaired.is_watertight
    assert repaired.volume == pytest.approx(8.0)


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("behind.stl", stl() + bytes(120), "120 bytes behind its last triangle are left out"),
        ("commas.stl", ascii_stl(comma=True), "decimal commas are read as points"),
        ("mm.glb", as_bytes(knob(), "glb"), "metres by their standard, which makes 12 x 10 x 5 m"),
        ("inch.stl", stl(1 / 25.4 * 5), "in inch it would be 60 x 50 x 25 mm"),
    ],
)
def test_what_was_guessed_or_left_out_is_said(name: str, data: bytes, said: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.warns(MeshNote, match=said):
        probe = parse(str(path))
    assert name in {"inch.stl"} or any(said in note for note in understood(probe).notes)


def ball(scale: float) -> bytes:
    return as_bytes(trimesh.creation.icosphere(subdivisions=2, radius=2 * scale), "stl")


@pytest.mark.faults
@pytest.mark.parametrize(
    ("data", "words"),
    [
        (ball(1e-3), ["0.004 x 0.004 x 0.004", "too small", "--probe-unit", "m (4 x 4 x 4 mm)"]),
        (stl(1e-3), ["0.012 x 0.01 x 0.005", "m (12 x 10 x 5 mm)"]),
        (ball(0.1), ["too small", "cm (4 x 4 x 4 mm)", "inch (10.16 x 10.16 x 10.16 mm)"]),
        (stl(1e3), ["1.2e+04", "too large", "um (12 x 10 x 5 mm)"]),
        (ball(1e9), ["too large", "plausible: none", "FILE:SIZE"]),
    ],
)
def test_implausible_bodies_are_refused_with_the_fix(data: bytes, words: list[str], tmp_path: Path) -> None:
    path = tmp_path / "body.stl"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"body\.stl: ") as refusal:
        parse(str(path))
    assert all(word in str(refusal.value) for word in words)
    assert parse(f"{path}:4").size_mm == 4.0  # a stated size needs no unit


@pytest.mark.faults
@pytest.mark.parametrize(
    ("text", "words"),
    [
        (":kg", "a unit"),
        (":4:m", "leave out one of them"),
        (":m:cm", "states its unit twice"),
        (":+z:-z", "states its side twice"),
        (":4:r0.2", "edges of its file"),
        (":-w", "a side"),
    ],
)
def test_texts_of_meshes_are_checked(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        mesh_text(f"knob.stl{text}")


@pytest.mark.faults
def test_what_is_said_beside_a_text_must_not_contradict_it(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="states the unit m, --probe-unit says cm"):
        parse("knob.stl:m", unit="cm")
    with pytest.raises(ValueError, match="--probe-side is for mesh files"):
        parse("sphere:4", side="-z")
    with pytest.raises(ValueError, match="side: only of a probe of kind mesh"):
        Probe(kind="sphere", size_mm=4, side="-z")
    assert mesh_text("a:b.stl:-x:m") == ("a:b.stl", None, "m", "-x")
    assert mesh_text(" knob.step:12.5 ", side="+y").text == "knob.step:12.5:+y"


def test_large_bodies_need_no_size(tmp_path: Path) -> None:
    path = tmp_path / "plate.stl"
    path.write_bytes(as_bytes(trimesh.creation.box((150, 140, 20)), "stl"))
    assert parse(str(path)).size_mm == 150
    with pytest.raises(ValueError, match="less than or equal to 100"):
        parse("sphere:150")


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
    """Two opposite walls of a box: nothing between them faces +z."""
    box = trimesh.creation.box((4.0, 2.0, 1.0))
    box.update_faces(np.abs(box.face_normals[:, 0]) > 0.5)
    return as_bytes(box, "stl")


PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d49484452000000010000000108060000001f15c4890000000d49444154789c6360000002"
    "000001e221bc330000000049454e44ae426082"
)

POINTS_PLY = (
    b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    b"end_header\n0 0 0\n1 0 0\n0 1 1\n"
)

BAD_FILES = {
    "empty": (b"", ".stl", "the file is empty"),
    "blank": (b"  \n", ".obj", "the file is empty"),
    "garbage stl": (np.random.default_rng(1).bytes(5000), ".stl", "not a valid STL file"),
    "garbage obj": (np.random.default_rng(1).bytes(5000), ".obj", "not a valid OBJ file"),
    "prose": (b"hello world", ".stl", "not a valid STL file"),
    "picture": (PNG, ".stl", "not a valid STL file"),
    "cut short": (scaled_box(1.0)[:300], ".stl", "is cut short: its header states 12 triangles, 4 are there"),
    "count of four billion": (
        bytes(80) + struct.pack("<I", 4_000_000_000) + bytes(50),
        ".stl",
        "not a valid STL",
    ),
    "points only": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", ".obj", "holds no triangles"),
    "index beyond the vertices": (b"v 0 0 0\nv 1 0 0\nv 0 1 1\nf 1 2 9\n", ".obj", "not a valid OBJ file"),
    "not a number": (not_finite(), ".stl", "vertices that are not finite numbers"),
    "no thickness": (without_thickness(), ".stl", "the body has no thickness, its extents are 4 x 2 x 0"),
    "half a box": (half_box(), ".stl", "nothing of it faces its +z side"),
    "metres": (scaled_box(1e-3), ".stl", "too small for a probe in mm"),
    "nanometres": (scaled_box(1e6), ".stl", "too large for a probe in mm"),
    "other type": (b"iges", ".iges", "a mesh file ends in .stl, .obj, "),
    "points of a scan": (POINTS_PLY, ".ply", "holds no triangles"),
    "a picture as GLB": (PNG, ".glb", "not a valid GLB file"),
    "a text as 3MF": (b"hello", ".3mf", "not a valid 3MF file"),
    "3MF in ells": (as_3mf(knob(), "ell"), ".3mf", "its unit is 'ell'"),
    "glTF with a lost buffer": (
        b'{"buffers": [{"uri": "lost.bin"}]}',
        ".gltf",
        "lost.bin, which cannot be read",
    ),
    "glTF that looks around": (b'{"buffers": [{"uri": "../x.bin"}]}', ".gltf", "its own folder"),
    "text cut short": (ascii_stl()[:900], ".stl", "is cut short"),
    "text with a word": (ascii_stl().replace(b"6.0", b"six", 1), ".stl", "not a valid STL file"),
}


@pytest.mark.faults
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("case", list(BAD_FILES))
def test_bad_files_are_refused_by_name_and_rule(tmp_path: Path, case: str) -> None:
    data, suffix, rule = BAD_FILES[case]
    path = tmp_path / f"part{suffix}"
    path.write_bytes(data)
    with pytest.raises(ValueError) as refusal:  # noqa: PT011 (the text is compared below, brackets and all)
        parse(str(path)) if suffix in mesh_files.FORMATS else load(path)
    assert str(refusal.value).startswith(str(tmp_path))
    assert rule in str(refusal.value)


@pytest.mark.slow
@pytest.mark.faults
@pytest.mark.parametrize("data", [b"ISO-10303-21;\nHEADER;\n", b"hello", bytes(200)])
def test_bad_step_files_are_refused(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "part.step"
    path.write_bytes(data + b"#")
    with pytest.raises(ValueError, match=r"part\.step: .*valid STEP file"):
        parse(str(path))


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"gone.stl: cannot be read \(No such file or directory\)"):
        load(tmp_path / "gone.stl")
    (tmp_path / "folder.stl").mkdir()
    with pytest.raises(ValueError, match=r"folder.stl: cannot be read \(Is a directory\)"):
        load(tmp_path / "folder.stl")


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "part.stl"
    path.write_bytes(scaled_box(1.0))
    assert parse(str(path)).size_mm == pytest.approx(4.0)
    path.write_bytes(scaled_box(2.0))
    assert parse(str(path)).size_mm == pytest.approx(8.0)


def mutations(data: bytes, count: int, seed: int) -> list[bytes]:
    """Copies with some bytes changed, cut out, doubled, or cut short."""
    draw, made = np.random.default_rng(seed), []
    for _ in range(count):
        copy, kind = bytearray(data), draw.integers(4)
        at = int(draw.integers(len(copy)))
        many = int(draw.integers(1, 40))
        if kind == 0:
            for place in draw.integers(len(copy), size=many):
                copy[place] = draw.integers(256)
        elif kind == 1:
            del copy[at : at + many]
        elif kind == 2:
            copy[at:at] = copy[at : at + many]
        else:
            del copy[at:]
        made.append(bytes(copy))
    return made


def sane_or_refused(path: Path) -> None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MeshNote)
            probe = parse(str(path))
        height = profile_mm(probe, X, Y)
    except ValueError as refusal:
        assert str(refusal).startswith(str(path))  # noqa: PT017
        assert type(refusal) is ValueError  # noqa: PT017
    else:
        assert not np.isnan(height).any()
        assert height.max() <= 1e-9


@pytest.mark.faults
@pytest.mark.parametrize(
    "name",
    ["binary.stl", "ascii.stl", "quads.obj", "binary.ply", "ascii.ply", "body.off", "metres.glb", "body.3mf"],
)
def test_damaged_files_are_read_sanely_or_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    for data in mutations(FORMS[name](tmp_path), 14, seed=len(name)):
        path.write_bytes(data)
        sane_or_refused(path)


@pytest.mark.slow
@pytest.mark.faults
@pytest.mark.parametrize("name", ["body.step", "beside.gltf", "apart.3mf"])
def test_damaged_files_of_slow_formats_too(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / name
    for data in mutations(FORMS[name](tmp_path), 5 if name == "body.step" else 30, seed=5):
        path.write_bytes(data)
        sane_or_refused(path)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["stl", "ply", "glb"])
def test_a_million_triangles_are_read_and_pressed_in_seconds(form: str, tmp_path: Path) -> None:
    steps = np.linspace(-30, 30, 709)
    x, y = np.meshgrid(steps, steps)
    z = np.maximum(-(x**2 + y**2) / 8, -12) + 0.01 * np.sin(3 * x)
    at = np.arange(x.size).reshape(x.shape)
    a, b, c, d = at[:-1, :-1].ravel(), at[:-1, 1:].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    body = trimesh.Trimesh(np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1), faces, process=False)
    assert len(body.faces) > 1e6
    path = tmp_path / f"relief.{form}"
    path.write_bytes(as_bytes(body, form))
    started = time.process_time()
    fine_x, fine_y = np.meshgrid(np.linspace(-7, 7, 840), np.linspace(-5.25, 5.25, 630))
    found = profile_mm(parse(f"{path}:mm"), fine_x, fine_y)
    assert time.process_time() - started < 10
    bowl = -(fine_x**2 + fine_y**2) / 8 + 0.01 * np.sin(3 * fine_x)
    np.testing.assert_allclose(found - found.max(), bowl - bowl.max(), atol=2e-3)
