"""Damaged files through the command line, in one warm process: refused in a line, or a picture of something.

    python benchmarks/fuzz_files.py [--files 1000] [--seed 0] [--first N] [--keep DIR] [--million]

Good files of every kind (meshes, lenses, lights, pictures, designs, measurements, parts) are mutated: bytes,
numbers, words and lines changed, cut out, doubled; ends cut off. Each is given to the command that reads it.
Faults are: an exception or a traceback, what the command line calls a defect, a status other than 0 and 2,
exit 0 with a picture that shows nothing, a refusal of many lines or without the name of its file. `--first N`
begins with the N-th file, `--keep DIR` keeps files at fault, `--million` presses a million triangles.
"""

import argparse
import contextlib
import io
import json
import math
import re
import resource
import shutil
import sys
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
from PIL import Image

from designlab.app.cli import main as designlab
from designlab.core.images import read_image, write_image
from designlab.sensor.design import dumps, preset

Draw = np.random.Generator
DESIGN = "gelsight-2020-flat"  # contact by a kernel and light through air: rendered in a moment
SHARES = {"mesh": 30, "lens": 20, "picture": 18, "light": 12, "design": 10, "measurement": 6, "parts": 4}
RARE = {".step"}  # read by a process of its own, which takes seconds to start
RARELY = 0.1
RENDERED = 0.25  # of the designs and light files: the others are read only
SMALL = ("--columns", "16", "--samples", "1", "--json")
NUMBERS = (
    "0",
    "-1",
    "1e30",
    "-1e30",
    "1e-30",
    "nan",
    "inf",
    "1e999",
    "99999999999",
    "0.5",
    "''",
    "true",
    "[]",
)
NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")
WORD = re.compile(rb"[A-Za-z_]{2,}")
FLOATS = (0.0, -1.0, 1e30, -1e30, 1e-30, math.nan, math.inf, 1e6)
TEXTS = {".obj", ".off", ".yaml", ".yml", ".xml", ".json", ".txt", ".ies", ".ldt", ".toml", ".gltf", ".ppm"}
NOTHING_MM = 1e-6
FULL_OF_WORDS = 2000  # letters of a refusal


class Case(NamedTuple):
    """A mutated file: its number, kind, name and content."""

    number: int
    kind: str
    name: str
    data: bytes


class Outcome(NamedTuple):
    """What came of a case: exit status (None: an exception), seconds, and the fault, if any."""

    case: Case
    status: int | None
    seconds: float
    fault: str


def bodies() -> dict[str, bytes]:
    """A knob on a plate in every mesh format."""
    import cadquery

    plate = trimesh.creation.box((12.0, 10.0, 3.0))
    ball = trimesh.creation.icosphere(subdivisions=2, radius=2.5)
    ball.apply_translation((0.5, -0.4, 2.0))
    body = trimesh.util.concatenate([plate, ball])
    found = {}
    for name, form in {
        "binary.stl": "stl",
        "text.stl": "stl_ascii",
        "a.obj": "obj",
        "a.ply": "ply",
        "a.off": "off",
        "a.glb": "glb",
    }.items():
        data = body.export(file_type=form)
        found[name] = data if isinstance(data, bytes) else str(data).encode()
    found["text.ply"] = body.export(file_type="ply", encoding="ascii")
    found["a.3mf"] = _3mf(body)
    solid = cadquery.Workplane().box(12, 10, 3).union(cadquery.Workplane("XY", (0, 0, 2)).sphere(2.5))
    with tempfile.TemporaryDirectory() as folder:
        cadquery.exporters.export(solid, str(Path(folder) / "a.step"))
        found["a.step"] = (Path(folder) / "a.step").read_bytes()
    return found


def _3mf(body: trimesh.Trimesh) -> bytes:
    """A package as slicers write it."""
    vertices = "".join('<vertex x="{:.6g}" y="{:.6g}" z="{:.6g}"/>'.format(*point) for point in body.vertices)
    triangles = "".join('<triangle v1="{}" v2="{}" v3="{}"/>'.format(*corners) for corners in body.faces)
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as package:
        package.writestr(
            "3D/3dmodel.model",
            '<model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">'
            f'<resources><object id="1" type="model"><mesh><vertices>{vertices}</vertices>'
            f"<triangles>{triangles}</triangles></mesh></object></resources>"
            '<build><item objectid="1"/></build></model>',
        )
    return made.getvalue()


def lenses() -> dict[str, bytes]:
    """One lens as OpenCV, ROS, Kalibr and scripts write it."""
    k, d = [1500.5, 0.0, 811.0, 0.0, 1499.5, 620.0, 0.0, 0.0, 1.0], [-0.21, 0.1, 0.001, -0.0005, 0.01]
    rows = [k[:3], k[3:6], k[6:]]
    matrix = f"!!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: {k}\n"
    ros = "image_width: 1640\nimage_height: 1230\ncamera_name: a\ncamera_matrix:\n"
    ros += f"  rows: 3\n  cols: 3\n  data: {k}\n"
    ros += f"distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: {d}\n"
    kalibr = "cam0:\n  camera_model: pinhole\n  intrinsics: [1500.5, 1499.5, 811.0, 620.0]\n"
    kalibr += "  distortion_coeffs: [-0.02, 0.01, 0.004, -0.002]\n  distortion_model: equidistant\n"
    arrays = io.BytesIO()
    np.savez(arrays, K=np.array(rows), D=np.array([d]), DIM=(1640, 1230))
    flat = dict(zip(("k1", "k2", "p1", "p2", "k3"), d, strict=True))
    flat |= {"fx": 1500.5, "fy": 1499.5, "cx": 811.0, "cy": 620.0, "width": 1640, "height": 1230}
    head = "%YAML:1.0\n---\nimage_width: 1640\nimage_height: 1230\n"
    xml_matrix = f"<rows>3</rows><cols>3</cols><dt>d</dt><data>{' '.join(map(str, k))}</data>"
    return {
        "opencv.yml": f"{head}camera_matrix: {matrix}".encode(),
        "opencv.xml": (
            '<?xml version="1.0"?>\n<opencv_storage><image_width>1640</image_width><image_height>1230'
            f'</image_height><camera_matrix type_id="opencv-matrix">{xml_matrix}</camera_matrix>'
            "</opencv_storage>"
        ).encode(),
        "ros.yaml": ros.encode(),
        "kalibr.yaml": (kalibr + "  resolution: [1640, 1230]\n").encode(),
        "lists.json": json.dumps({"K": rows, "D": d, "image_size": [1640, 1230], "model": "radtan"}).encode(),
        "flat.json": json.dumps(flat).encode(),
        "a.npz": arrays.getvalue(),
        "cameras.txt": b"1 OPENCV 1640 1230 1500.5 1499.5 811 620 -0.2 0.1 0.001 -0.0005\n",
    }


def lights() -> dict[str, bytes]:
    """One beam as IES LM-63 and EULUMDAT."""
    polar, turn = np.arange(0, 91, 7.5), np.arange(0, 91, 15)
    power = 2 + 5 * np.sin(np.radians(turn))[:, None] ** 2
    candela = 900 * np.cos(np.radians(polar))[None] ** power
    lines = [" ".join(f"{value:.2f}" for value in row) for row in (polar, turn, *candela)]
    head = ["IESNA:LM-63-2002", "TILT=NONE", f"1 1000 1 {len(polar)} {len(turn)} 1 2 0 0 0 1 1 1"]
    planes = np.arange(24) * 15
    numbers: list[Any] = [
        "Maker",
        1,
        4,
        24,
        15,
        len(polar),
        7.5,
        "report",
        "name",
        "12",
        "a.ldt",
        "28-NOV-2026",
    ]
    numbers += [3, 3, 1, 2, 2, 0, 0, 0, 0, 100, 100, 1, 0, 1, 1, "LED", 100, "4000 K", "80", 0.5, *[0.5] * 10]
    numbers += [*planes, *polar, *(f"{value:.2f}" for value in candela.ravel())]
    return {"a.ies": "\n".join([*head, *lines]).encode(), "a.ldt": "\r\n".join(map(str, numbers)).encode()}


def pictures() -> dict[str, bytes]:
    """A smooth small picture in every format."""
    row, column = np.indices((24, 32))
    planes = np.stack([60 + 4 * column, 190 - 4 * column, 40 + 5 * row], axis=-1).astype(np.uint8)
    found = {}
    for name, form, options in (
        ("a.png", "PNG", {}),
        ("a.jpg", "JPEG", {}),
        ("a.tif", "TIFF", {"compression": "tiff_lzw"}),
        ("a.webp", "WEBP", {"lossless": True}),
        ("a.bmp", "BMP", {}),
        ("a.ppm", "PPM", {}),
    ):
        stream = io.BytesIO()
        Image.fromarray(planes).save(stream, form, **options)
        found[name] = stream.getvalue()
    for name, array in (("a.npy", planes), ("float.npy", (planes / 255).astype(np.float32))):
        stream = io.BytesIO()
        np.save(stream, array)
        found[name] = stream.getvalue()
    with tempfile.TemporaryDirectory() as folder:
        write_image(Path(folder) / "a.exr", (planes / 255).astype(np.float32))
        found["a.exr"] = (Path(folder) / "a.exr").read_bytes()
    return found


PARTS = b"""[leds.mine]
maker = "Lab"
number = "W-1"
viewing_deg = 100.0
size_mm = [1.6, 0.8]
chips.white = { spectrum = "phosphor", flux_mw = 12.0 }

[spectra.phosphor]
wavelength_nm = [400, 450, 500, 600, 700]
power = [0.0, 1.0, 0.3, 0.6, 0.0]

[filters.red]
wavelength_nm = [380, 590, 600, 780]
transmittance = [0.9, 0.9, 0.1, 0.1]

[gels.soft]
modulus_mpa = 0.12
method = "indentation"
source = "our press"
"""
MEASUREMENT = f"""sensor = "{DESIGN}"
response = "linear"

[[frame]]
file = "background.exr"
kind = "background"

[[frame]]
file = "press.exr"
kind = "press"
probe = "ball.stl:mm"
depth_mm = 0.4
centre_mm = [1.0, -0.5]
yaw_deg = 0.0
""".encode()


def seeds() -> dict[str, dict[str, bytes]]:
    """Good files by kind and name."""
    return {
        "mesh": bodies(),
        "lens": lenses(),
        "light": lights(),
        "picture": pictures(),
        "design": {
            f"{name}.toml": dumps(preset(name)).encode() for name in (DESIGN, "default", "gelsight-mini-like")
        },
        "measurement": {"measurement.toml": MEASUREMENT},
        "parts": {"parts.toml": PARTS},
    }


def mutated(data: bytes, name: str, draw: Draw) -> bytes:
    """A copy with something wrong, or two or three things."""
    if zipfile.is_zipfile(io.BytesIO(data)) and draw.random() < 0.7:
        return _repacked(data, draw)
    text = Path(name).suffix in TEXTS or name.startswith("text")
    kinds = _WORDS if text else _NUMBERS
    for _ in range(draw.choice((1, 2, 3), p=(0.7, 0.2, 0.1))):
        data = kinds[draw.integers(len(kinds))](data, draw) if data else data
    return data


def _repacked(data: bytes, draw: Draw) -> bytes:
    """An archive one of whose members is damaged, with its checksum made good."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(made, "w") as new:
        members = old.namelist()
        chosen = members[draw.integers(len(members))]
        for member in members:
            content = old.read(member)
            inner = f"text{member}" if b"<" in content[:100] else member
            new.writestr(member, mutated(content, inner, draw) if member == chosen else content)
    return made.getvalue()


def _cut(data: bytes, draw: Draw) -> bytes:
    return data[: draw.integers(len(data))]


def _some_bytes(data: bytes, draw: Draw) -> bytes:
    copy = bytearray(data)
    for place in draw.integers(len(copy), size=draw.integers(1, 5)):
        copy[place] = draw.integers(256)
    return bytes(copy)


def _without(data: bytes, draw: Draw) -> bytes:
    at = int(draw.integers(len(data)))
    return data[:at] + data[at + int(draw.integers(1, 200)) :]


def _twice(data: bytes, draw: Draw) -> bytes:
    at, many = int(draw.integers(len(data))), int(draw.integers(1, 200))
    return data[: at + many] + data[at:]


def _number_inside(data: bytes, draw: Draw) -> bytes:
    """Another number of four bytes, where one may stand."""
    at = int(draw.integers(max(1, len(data) - 3)))
    value = FLOATS[draw.integers(len(FLOATS))]
    return data[:at] + np.float32(value).tobytes() + data[at + 4 :]


def _scaled_inside(data: bytes, draw: Draw) -> bytes:
    """A number of four bytes times another: a corner of a body far from the others, for instance."""
    at = int(draw.integers(max(1, len(data) // 4))) * 4
    value = np.frombuffer(data[at : at + 4].ljust(4, b"\0"), np.float32)
    with np.errstate(all="ignore"):
        scaled = value * np.float32(draw.choice((-1.0, 0.5, 2.0, 10.0, 1000.0)))
    return data[:at] + scaled.tobytes() + data[at + 4 :]


def _other_number(data: bytes, draw: Draw) -> bytes:
    return _replaced(data, NUMBER, NUMBERS[draw.integers(len(NUMBERS))].encode(), draw)


def _scaled_number(data: bytes, draw: Draw) -> bytes:
    places = list(NUMBER.finditer(data))
    if not places:
        return data
    match = places[draw.integers(len(places))]
    value = float(match[0]) * float(draw.choice((-1.0, 0.5, 0.9, 1.1, 2.0, 10.0, 100.0, 1e4, 1e-3)))
    return data[: match.start()] + f"{value:.6g}".encode() + data[match.end() :]


def _other_word(data: bytes, draw: Draw) -> bytes:
    words = WORD.findall(data)
    return _replaced(data, WORD, words[draw.integers(len(words))], draw) if words else data


def _lines(data: bytes, draw: Draw) -> bytes:
    """A line less, twice, or somewhere else."""
    lines = data.split(b"\n")
    line = lines.pop(int(draw.integers(len(lines))))
    for _ in range(draw.integers(3)):
        lines.insert(int(draw.integers(len(lines) + 1)), line)
    return b"\n".join(lines)


def _coded(data: bytes, draw: Draw) -> bytes:
    """The same text in another coding."""
    text = data.decode("utf-8", "replace")
    codings = ("utf-16", "utf-8-sig", "utf-32", "cp037")
    return text.encode(codings[draw.integers(len(codings))], "replace")


def _replaced(data: bytes, what: re.Pattern[bytes], new: bytes, draw: Draw) -> bytes:
    places = list(what.finditer(data))
    if not places:
        return data
    match = places[draw.integers(len(places))]
    return data[: match.start()] + new + data[match.end() :]


_Change = Callable[[bytes, Draw], bytes]
_NUMBERS: tuple[_Change, ...] = (_cut, _some_bytes, _without, _twice, _number_inside, *[_scaled_inside] * 3)
_WORDS: tuple[_Change, ...] = (
    *(_cut, _some_bytes, _without, _twice, _coded),
    *(_other_number, _other_number, _other_word, _lines),
    *[_scaled_number] * 5,
)


def case(number: int, good: dict[str, dict[str, bytes]], seed: int) -> Case:
    """The case of a number, which depends on it and the seed alone."""
    draw = np.random.default_rng([seed, number])
    shares = np.array(list(SHARES.values()), dtype=float)
    kind = list(SHARES)[draw.choice(len(shares), p=shares / shares.sum())]
    names = list(good[kind])
    weights = np.array([RARELY if Path(name).suffix in RARE else 1.0 for name in names])
    name = names[draw.choice(len(names), p=weights / weights.sum())]
    return Case(number, kind, name, mutated(good[kind][name], name, draw))


def prepared(folder: Path, good: dict[str, dict[str, bytes]]) -> None:
    """Write the good files that mutated ones are read together with."""
    preset("default").save(folder / "good.toml")
    (folder / "lens.json").write_bytes(good["lens"]["flat.json"])
    (folder / "ball.stl").write_bytes(good["mesh"]["binary.stl"])
    picture = np.full((24, 32, 3), 0.3, dtype=np.float32) + np.linspace(0, 0.2, 32, dtype=np.float32)[:, None]
    for name in ("background.exr", "press.exr"):
        write_image(folder / name, picture)


def commands(case: Case, file: Path) -> list[list[str]]:
    """Command lines that read the file; it is accepted where all end with 0."""
    folder, rendered = file.parent, np.random.default_rng(case.number + 1).random() < RENDERED
    picture, good, lens = (str(folder / name) for name in ("out.exr", "good.toml", "lens.json"))
    read = ["lens", lens, "--json", "--design"]
    if case.kind == "mesh":
        return [["render", DESIGN, "--probe", str(file), "--depth-mm", "0.4", "-o", picture, *SMALL]]
    if case.kind == "lens":
        return [["lens", str(file), "--design", good, "--out", str(folder / "new.toml"), "--json"]]
    if case.kind == "picture":
        how = ["--response", "linear", "--white", "1"] if case.name == "float.npy" else ["--response", "srgb"]
        out = str(folder / "set")
        return [
            ["import", str(file), "--kind", "background", *how, "--sensor", DESIGN, "--out", out, "--json"]
        ]
    if case.kind == "measurement":
        return [["compare", DESIGN, str(file), "--samples", "1", "--json"]]
    if case.kind == "parts":
        return [["parts", str(file), "--json"]]
    design = str(file)
    if case.kind == "light":
        design = str(folder / "lit.toml")
        field = case.name.partition(".")[2]
        text = f'mixing = [[1.0], [0.5], [0.2]]\n[leds]\nprofile = {{ {field} = "{file.name}" }}\n'
        text += '[[leds.groups]]\nname = "white"\nazimuth_deg = [90.0]\n'
        Path(design).write_text(text, encoding="utf-8")
    first = [*read, design]
    return [first, ["render", design, "-o", picture, *SMALL]] if rendered else [first]


def empty(words: list[str], data: dict[str, Any], folder: Path) -> str:
    """What is missing in a result of exit 0, if anything."""
    if words[0] == "render":
        light = data["mean_radiance"]
        if any(value is None or not math.isfinite(value) for value in light):
            return "picture with values that are no numbers"
        if max(light) <= 0:
            return "dark picture"
        told = any("touch" in warning or "picture" in warning for warning in data["warnings"])
        if "--probe" in words and not (data["deepest_mm"] or 0) > NOTHING_MM and not told:
            return "picture of the untouched gel"
    if words[0] == "import":
        values = read_image(folder / "set" / data["files"][0])
        if not np.isfinite(values).all():
            return "picture with values that are no numbers"
        if not values.max() > 0 and not data["notes"]:
            return "dark picture"
    if words[0] == "compare" and data["mse"] is None:
        return "figures that are no numbers"
    return ""


def tried(case: Case, folder: Path) -> Outcome:
    """Give a file to the command line."""
    file = folder / case.name
    if case.kind == "mesh" and file.suffix == ".stl":
        file = folder / f"probe-{case.name}"
    file.write_bytes(case.data)
    started = time.perf_counter()
    status: int | None = 0
    fault = ""
    for words in commands(case, file):
        out, error = io.StringIO(), io.StringIO()
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
                status = designlab(words)
        except BaseException as escaped:
            if isinstance(escaped, KeyboardInterrupt):
                raise
            status, fault = None, f"{type(escaped).__name__}: {escaped}"
            break
        said = error.getvalue()
        fault = judged(words, status, out.getvalue(), said, file, folder)
        if status or fault:
            break
    seconds = time.perf_counter() - started
    file.unlink(missing_ok=True)
    shutil.rmtree(folder / "set", ignore_errors=True)
    return Outcome(case, status, seconds, fault)


def judged(words: list[str], status: int, out: str, said: str, file: Path, folder: Path) -> str:
    """The fault of what a command did, if any."""
    own = [line for line in said.splitlines() if line.startswith("designlab: ")]
    refusals = [line for line in own if not line.startswith("designlab: note: ")]
    if "Traceback" in said or "a defect of designlab" in said:
        return said.strip().splitlines()[-1]
    if status not in (0, 2):
        return f"exit status {status}: {' '.join(refusals)}"
    if status == 2:
        if len(refusals) != 1:
            return f"{len(refusals)} lines of refusal"
        # A design stands for its light file, a folder for its set; a lens that fits no design is named.
        names = (file.name, "lit.toml", *(["lens.json"] if words[0] == "lens" else []))
        names = (str(folder),) if words[0] == "compare" else names
        if not any(name in refusals[0] for name in names):
            return f"the refusal does not name the file: {refusals[0]}"
        return "" if len(refusals[0]) < FULL_OF_WORDS else f"a refusal of {len(refusals[0])} letters"
    return empty(words, json.loads(out), folder)


def fuzz(files: int, *, seed: int = 0, first: int = 0, keep: Path | None = None) -> list[Outcome]:
    """Try mutated files, one after the other in this process."""
    good, found = seeds(), []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepared(folder, good)
        warm = [Case(-1, kind, file, data) for kind in good for file, data in good[kind].items()]
        for one in warm:  # good files are accepted; what is loaded or compiled once, is
            outcome = tried(one, folder)
            if outcome.status != 0 or outcome.fault:
                raise AssertionError(f"{one.kind} {one.name} is good: {outcome.status} {outcome.fault}")
        for number in range(first, first + files):
            outcome = tried(case(number, good, seed), folder)
            found.append(outcome)
            if outcome.fault:
                one = outcome.case
                print(f"{one.number} {one.kind} {one.name}: {outcome.fault}", flush=True)
                if keep is not None:
                    keep.mkdir(parents=True, exist_ok=True)
                    (keep / f"{one.number}-{one.name}").write_bytes(one.data)
    return found


def million(folder: Path) -> tuple[float, float]:
    """Seconds, on the clock and of the processor, in which `render` reads and presses a million triangles."""
    steps = np.linspace(-30, 30, 709)
    x, y = np.meshgrid(steps, steps)
    z = np.maximum(-(x**2 + y**2) / 8, -12) + 0.01 * np.sin(3 * x)
    at = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    body = trimesh.Trimesh(np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1), faces, process=False)
    body.export(folder / "million.stl")
    started, worked = time.perf_counter(), time.process_time()
    words = ["render", DESIGN, "--probe", str(folder / "million.stl"), "--depth-mm", "0.4"]
    with contextlib.redirect_stdout(io.StringIO()):
        status = designlab([*words, "-o", str(folder / "million.exr"), *SMALL])
    if status:
        raise SystemExit("the mesh of a million triangles was refused")
    return time.perf_counter() - started, time.process_time() - worked


def peak_gb() -> float:
    """Largest memory that this process or one that it started has held, in GB."""
    most = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return most * (1 if sys.platform == "darwin" else 1024) / 1e9


def main() -> None:
    """Print faults, and the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--million", action="store_true")
    args = parser.parse_args()
    found = fuzz(args.files, seed=args.seed, first=args.first, keep=args.keep)
    seconds = np.array([outcome.seconds for outcome in found])
    by_kind = Counter((one.case.kind, "accepted" if one.status == 0 else "refused") for one in found)
    for kind in SHARES:
        times = [one.seconds for one in found if one.case.kind == kind]
        accepted, refused = by_kind[kind, "accepted"], by_kind[kind, "refused"]
        slowest = max(times, default=0.0)
        print(f"{kind:12} {accepted:4} accepted {refused:4} refused, slowest {slowest:.1f} s")
    print(f"{len(found)} files, faults: {sum(bool(one.fault) for one in found)}")
    median, late = np.quantile(seconds, (0.5, 0.95))
    print(f"seconds a file: median {median:.2f}, 95th percentile {late:.2f}")
    print(f"memory: {peak_gb():.2f} GB")
    if args.million:
        with tempfile.TemporaryDirectory() as folder:
            wall, processor = million(Path(folder))
            print(f"a million triangles: {wall:.1f} s, {processor:.1f} s of the processor")


if __name__ == "__main__":
    main()
