"""Small good files of every kind that the command line reads."""

import io
import json
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from designlab.core.images import write_image
from designlab.sensor.design import dumps, preset

DESIGN = "gelsight-2020-flat"  # contact by a kernel and light through air: rendered in a moment


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
