"""Lens files: one lens by every kind of file is one lens; what cannot be read is refused in a line."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from designlab.app import cli
from designlab.measurement.importing.lens_calibration import read_calibration
from designlab.measurement.importing.lens_file import lens_fields
from designlab.measurement.importing.lens_formats import LensError
from designlab.sensor.design import load, preset

SIZE = (640, 480)
DESIGN = preset("gelsight-2020-flat").replace({"camera.width_px": 1280, "camera.height_px": 960})

BARREL = {"fx": 512.25, "fy": 512.25, "cx": 322.5, "cy": 236.75, "d": [-0.31, 0.12, 0.0011, -0.0005, -0.01]}
UNEQUAL = {"fx": 501.5, "fy": 498.5, "cx": 311.0, "cy": 241.25, "d": [-0.3, 0.12, 1e-05, -0.0005, 0.0]}
PLAIN = {"fx": 801.0, "fy": 799.0, "cx": 319.5, "cy": 239.5, "d": [0.0, 0.0, 0.0, 0.0, 0.0]}
FISHEYE = {"fx": 301.5, "fy": 300.25, "cx": 325.0, "cy": 236.0, "d": [-0.02, 0.01, 0.004, -0.002]}
WIDE = {"fx": 250.0, "fy": 250.0, "cx": 318.0, "cy": 244.5, "d": [0.03, -0.012, 0.004, -0.001]}
PINHOLES = {"barrel": BARREL, "unequal": UNEQUAL, "plain": PLAIN}
FISHEYES = {"fisheye": FISHEYE, "wide": WIDE}


def matrix(lens):
    return [[lens["fx"], 0.0, lens["cx"]], [0.0, lens["fy"], lens["cy"]], [0.0, 0.0, 1.0]]


def is_fisheye(lens):
    return len(lens["d"]) == 4


def opencv(path, lens):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Sat Nov 28 10:00:00 2026")
    storage.write("image_width", SIZE[0])
    storage.write("image_height", SIZE[1])
    storage.write("fisheye_model", int(is_fisheye(lens)))
    storage.write("camera_matrix", np.array(matrix(lens)))
    storage.write("distortion_coefficients", np.array(lens["d"]).reshape(-1, 1))
    storage.write("image_points", np.zeros((2, 6, 2), dtype=np.float32))
    storage.release()


def ros1(lens, *, model="distortion_model"):
    flat = [value for row in matrix(lens) for value in row]
    name = "equidistant" if is_fisheye(lens) else "plumb_bob"
    return (
        f"image_width: {SIZE[0]}\nimage_height: {SIZE[1]}\ncamera_name: narrow_stereo\n"
        f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {flat}\n"
        f"{model}: {name}\n"
        f"distortion_coefficients:\n  rows: 1\n  cols: {len(lens['d'])}\n  data: {lens['d']}\n"
        "rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
        "projection_matrix:\n  rows: 3\n  cols: 4\n  data: [9, 0, 9, 0, 0, 9, 9, 0, 0, 0, 1, 0]\n"
    )


def ros2(lens):
    """What `ros2 topic echo` prints: one message after the other."""
    message = {
        "header": {"stamp": {"sec": 17, "nanosec": 5}, "frame_id": "fisheye_link"},
        "height": SIZE[1],
        "width": SIZE[0],
        "distortion_model": "equidistant" if is_fisheye(lens) else "plumb_bob",
        "d": lens["d"],
        "k": np.ravel(matrix(lens)).tolist(),
        "r": np.eye(3).ravel().tolist(),
        "p": np.eye(3, 4).ravel().tolist(),
        "binning_x": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }
    later = message | {"header": {"stamp": {"sec": 18, "nanosec": 6}, "frame_id": "fisheye_link"}}
    return "---\n".join(yaml.safe_dump(each, sort_keys=False) for each in (message, later)) + "---\n"


def wrapped(lens):
    (fx, _, cx), (_, fy, cy), _ = matrix(lens)
    k = ", ".join(map(str, lens["d"][:2])) + ",\n    " + ", ".join(map(str, lens["d"][2:]))
    model = "kannala_brandt" if is_fisheye(lens) else "radtan"
    return (
        f"# by hand\n---\nimage_size: [{SIZE[0]},\n   {SIZE[1]}]\n"
        f"camera_matrix: [{fx}, 0, {cx},\n  0, {fy}, {cy},\n  0, 0, 1]\n"
        f"dist_coeffs: [\n    {k}]\nmodel: '{model}'  # of the calibration\n...\n"
    )


def kalibr(lens):
    # Kalibr's radtan has four coefficients.
    d = lens["d"] if is_fisheye(lens) or lens["d"][4] else lens["d"][:4]
    camera = {
        "cam_overlaps": [],
        "camera_model": "pinhole",
        "distortion_coeffs": d,
        "distortion_model": "equidistant" if is_fisheye(lens) else "radtan",
        "intrinsics": [lens[name] for name in ("fx", "fy", "cx", "cy")],
        "resolution": list(SIZE),
        "rostopic": "/cam0/image_raw",
        "T_cam_imu": np.eye(4).tolist(),
    }
    return yaml.safe_dump({"cam0": camera})


def values(lens):
    order = ("k1", "k2", "k3", "k4") if is_fisheye(lens) else ("k1", "k2", "p1", "p2", "k3")
    own = {name: lens[name] for name in ("fx", "fy", "cx", "cy")}
    return own | dict(zip(order, lens["d"], strict=True))


def model_of(lens):
    return {"model": "fisheye"} if is_fisheye(lens) else {}


def fx_fy(lens):
    return values(lens) | {"width": SIZE[0], "height": SIZE[1]} | model_of(lens)


def nested(lens):
    named = values(lens)
    return {
        "camera": {
            "intrinsics": {name: named[name] for name in ("fx", "fy", "cx", "cy")},
            "distortion": {n: v for n, v in named.items() if n[0] in "kp"}
            | {"type": "equidistant" if is_fisheye(lens) else "radtan"},
            "resolution": {"width": SIZE[0], "height": SIZE[1]},
        }
    }


def lists(lens):
    named = model_of(lens) or {"model": "radtan"}
    return {"K": matrix(lens), "D": [lens["d"]], "rms": 0.3, "image_size": list(SIZE), **named}


def colmap(lens):
    # COLMAP counts from the edge of the first pixel.
    order = [lens["fx"], lens["fy"], lens["cx"] + 0.5, lens["cy"] + 0.5]
    if is_fisheye(lens):
        model, rest = "OPENCV_FISHEYE", lens["d"]
    else:
        model, rest = "FULL_OPENCV", [*lens["d"], 0, 0, 0]
    numbers = " ".join(map(str, [*order, *rest]))
    return f"# Camera list with one line of data per camera:\n1 {model} {SIZE[0]} {SIZE[1]} {numbers}\n"


def npz(path, lens):
    d = np.array(lens["d"])
    corners = np.array([np.zeros(3), "x"], dtype=object)  # what scripts save beside it
    if is_fisheye(lens):
        np.savez(path, DIM=SIZE, K=np.array(matrix(lens)), D=d[:, None], corners=corners)
    else:
        np.savez(path, mtx=matrix(lens), dist=d[None], image_shape=SIZE[::-1], corners=corners)


def text(make, *, coding="utf-8", newline="\n"):
    def write(path, lens):
        Path(path).write_bytes(make(lens).replace("\n", newline).encode(coding))

    return write


KINDS = {
    "opencv.yml": (opencv, "OpenCV FileStorage YAML"),
    "opencv.xml": (opencv, "OpenCV FileStorage XML"),
    "opencv.json": (opencv, "OpenCV FileStorage JSON"),
    "ros1.yaml": (text(ros1), "ROS camera_info"),
    "model.yaml": (text(lambda lens: ros1(lens, model="camera_model")), "ROS camera_info"),
    "bom.yaml": (text(ros1, coding="utf-8-sig"), "ROS camera_info"),
    "wide.yaml": (text(ros1, coding="utf-16"), "ROS camera_info"),
    "crlf.yaml": (text(ros1, newline="\r\n"), "ROS camera_info"),
    "ros2.yaml": (text(ros2), "ROS camera_info"),
    "wrapped.yaml": (text(wrapped), "YAML"),
    "kalibr.yaml": (text(kalibr), "Kalibr camchain"),
    "blocks.yaml": (text(lambda lens: yaml.safe_dump(lists(lens))), "YAML"),
    "flow.yaml": (text(lambda lens: yaml.safe_dump(fx_fy(lens), default_flow_style=True)), "YAML"),
    "nested.yaml": (text(lambda lens: yaml.safe_dump(nested(lens))), "YAML"),
    "fxfy.json": (text(lambda lens: json.dumps(fx_fy(lens))), "JSON"),
    "lists.json": (text(lambda lens: json.dumps(lists(lens), indent=2)), "JSON"),
    "bom.json": (text(lambda lens: json.dumps([lists(lens)]), coding="utf-8-sig"), "JSON"),
    "cameras.txt": (text(colmap), "COLMAP cameras.txt"),
    "arrays.npz": (npz, "NumPy archive"),
}


def written(folder, name, lens):
    path = folder / name
    KINDS[name][0](path, lens)
    return path


def camera_of(path, **options):
    changes, _ = lens_fields(path, DESIGN.camera, **options)
    return DESIGN.replace(changes).camera


POINTS = np.array([[x, y, 1.0] for x in np.linspace(-0.5, 0.5, 7) for y in np.linspace(-0.38, 0.38, 5)])


class TestOneLens:
    @pytest.mark.parametrize("lens", (PINHOLES | FISHEYES).values(), ids=PINHOLES | FISHEYES)
    @pytest.mark.parametrize("name", KINDS)
    def test_every_kind_of_file_says_the_same(self, name, lens, tmp_path):
        path = written(tmp_path, name, lens)
        found = read_calibration(path)
        assert found.kind == KINDS[name][1]
        assert found.size_px == SIZE
        changes, _ = lens_fields(path, DESIGN.camera)
        expected = {
            "camera.lens": "fisheye" if is_fisheye(lens) else "pinhole",
            "camera.principal_point_px": [2 * lens["cx"] + 1, 2 * lens["cy"] + 1],
            "camera.pixel_aspect": lens["fy"] / lens["fx"],
        }
        expected |= {f"camera.distortion.{n}": v for n, v in values(lens).items() if n[0] in "kp"}
        for field, value in expected.items():
            assert changes[field] == pytest.approx(value, abs=1e-6), field
        camera = DESIGN.replace(changes).camera
        assert camera.focal_px == pytest.approx(2 * lens["fx"], rel=1e-9)

    @pytest.mark.parametrize("lens", (PINHOLES | FISHEYES).values(), ids=PINHOLES | FISHEYES)
    def test_points_fall_where_opencv_projects_them(self, lens, tmp_path):
        camera = camera_of(written(tmp_path, "opencv.yml", lens))
        k, d = np.array(matrix(lens)), np.array(lens["d"])
        project = cv2.fisheye.projectPoints if is_fisheye(lens) else cv2.projectPoints
        true, _ = project(POINTS[:, None], np.zeros(3), np.zeros(3), k, d)
        column, row = camera.project(POINTS[:, 0], -POINTS[:, 1])
        # Pictures of half the size; OpenCV counts from the centre of the first pixel.
        np.testing.assert_allclose(column / 2 - 0.5, true[..., 0].ravel(), atol=1e-8)
        np.testing.assert_allclose(row / 2 - 0.5, true[..., 1].ravel(), atol=1e-8)
        right, up, forward = camera.unproject(column, row)
        np.testing.assert_allclose(right / forward, POINTS[:, 0], atol=1e-8)
        np.testing.assert_allclose(up / forward, -POINTS[:, 1], atol=1e-8)

    @pytest.mark.parametrize("lens", (PINHOLES | FISHEYES).values(), ids=PINHOLES | FISHEYES)
    def test_every_kind_of_file_gives_the_same_picture_of_points(self, lens, tmp_path):
        first, *others = (camera_of(written(tmp_path, name, lens)) for name in KINDS)
        seen = np.array(first.project(POINTS[:, 0], POINTS[:, 1]))
        for camera in others:
            np.testing.assert_allclose(camera.project(POINTS[:, 0], POINTS[:, 1]), seen, atol=1e-3)

    def test_square_pixels_stay_square(self, tmp_path):
        assert camera_of(written(tmp_path, "ros1.yaml", BARREL)).pixel_aspect == 1.0

    @pytest.mark.parametrize(
        ("line", "d"),
        [
            ("SIMPLE_PINHOLE 640 480 500 320 240", {}),
            ("PINHOLE 640 480 500 490 320 240", {}),
            ("SIMPLE_RADIAL 640 480 500 320 240 -0.2", {"k1": -0.2}),
            ("RADIAL 640 480 500 320 240 -0.2 0.05", {"k1": -0.2, "k2": 0.05}),
            ("OPENCV 640 480 500 490 320 240 -0.2 0.05 0.001 0.002", {"k1": -0.2, "p1": 0.001, "p2": 0.002}),
            ("OPENCV_FISHEYE 640 480 500 490 320 240 0.02 0.01 0 -0.001", {"k2": 0.01, "k4": -0.001}),
        ],
    )
    def test_models_of_colmap(self, line, d, tmp_path):
        path = tmp_path / "cameras.txt"
        path.write_text(f"# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n7 {line}\n", encoding="utf-8")
        camera = camera_of(path)
        assert camera.focal_px == pytest.approx(1000.0)
        assert camera.principal_point_px == (640.0, 480.0)
        assert camera.pixel_aspect == (0.98 if " 490 " in line else 1.0)
        for name, value in d.items():
            assert getattr(camera.distortion, name) == value


class TestSize:
    @pytest.mark.parametrize(
        "stated",
        [
            {"image_width": 640, "image_height": 480},
            {"imageWidth": "640", "imageHeight": 480.0},
            {"w": 640, "h": 480},
            {"resolution": [640, 480]},
            {"resolution": "640x480"},
            {"image_size": {"width": 640, "height": 480}},
            {"size": [[640], [480]]},
            {"img_shape": [480, 640]},
            {"shape": [480, 640, 3]},
            {"DIM": [640, 480]},
        ],
    )
    def test_it_is_read_by_any_name(self, stated, tmp_path):
        path = tmp_path / "lens.json"
        path.write_text(json.dumps({"K": matrix(BARREL), "D": BARREL["d"], **stated}), encoding="utf-8")
        assert read_calibration(path).size_px == SIZE

    @pytest.mark.parametrize("name", ["lens.npz", "lens.json", "lens.yml"])
    def test_a_file_without_one_asks_for_it(self, name, tmp_path):
        path = tmp_path / name
        if name == "lens.npz":
            np.savez(path, camera_matrix=matrix(BARREL), dist_coeffs=BARREL["d"])
        else:
            content = {"mtx": matrix(BARREL), "dist": BARREL["d"]}
            path.write_text(json.dumps(content), encoding="utf-8")
        with pytest.raises(LensError, match=rf"{name}: states no picture size; .* --lens-size 640x480"):
            read_calibration(path)
        assert camera_of(path, size_px=SIZE).focal_px == pytest.approx(2 * BARREL["fx"])
        with pytest.raises(LensError, match="proportion of the full sensor"):
            camera_of(path, size_px=(640, 400))

    def test_turned_sizes_are_told(self, tmp_path):
        path = tmp_path / "lens.json"
        path.write_text(json.dumps(fx_fy(BARREL) | {"width": 480, "height": 640}), encoding="utf-8")
        with pytest.raises(LensError, match="seem to be exchanged"):
            camera_of(path)

    def test_an_archive_may_hold_single_values(self, tmp_path):
        path = tmp_path / "lens.npz"
        np.savez(path, K=matrix(WIDE), D=WIDE["d"], width=640, height=480, model="equidistant", tuple=(1, 2))
        found = read_calibration(path)
        assert (found.size_px, found.fisheye, found.model) == (SIZE, True, "equidistant")

    def test_two_sizes_are_refused(self, tmp_path):
        path = written(tmp_path, "lists.json", BARREL)
        assert read_calibration(path, size_px=SIZE).size_px == SIZE
        with pytest.raises(LensError, match="field image_size: says 640 x 480, but --lens-size differs"):
            read_calibration(path, size_px=(1280, 960))


class TestModel:
    @pytest.mark.parametrize(
        "field", ["model", "distortion_model", "camera_model", "lens_type", "kind", "type"]
    )
    @pytest.mark.parametrize("word", ["equidistant", "fisheye", "Kannala-Brandt", "kannala_brandt4", "KB4"])
    def test_a_fisheye_is_never_read_as_a_pinhole(self, field, word, tmp_path):
        path = tmp_path / "lens.json"
        content = {"K": matrix(FISHEYE), "D": FISHEYE["d"], "image_size": SIZE, field: word}
        path.write_text(json.dumps(content), encoding="utf-8")
        found = read_calibration(path)
        assert found.fisheye
        assert found.model == word
        assert found.coefficients == {"k1": -0.02, "k2": 0.01, "k3": 0.004, "k4": -0.002}

    @pytest.mark.parametrize(
        "word", ["plumb_bob", "radtan", "Brown Conrady", "rational_polynomial", "pinhole"]
    )
    def test_pinholes(self, word, tmp_path):
        path = tmp_path / "lens.json"
        content = {"K": matrix(BARREL), "D": [-0.2, 0.1, 0, 0, 0.01, 0, 0, 0], "image_size": SIZE}
        path.write_text(json.dumps(content | {"distortion_model": word}), encoding="utf-8")
        found = read_calibration(path)
        assert (found.fisheye, found.model, found.notes) == (False, word, ())

    def test_four_coefficients_without_a_model_are_noted(self, tmp_path):
        content = {"K": matrix(BARREL), "D": [-0.2, 0.1, 0.001, 0.0]}
        for size, fish, said in (
            ("size", False, "k1 k2 p1 p2 of a pinhole; give --fisheye"),
            ("DIM", True, "DIM"),
        ):
            path = tmp_path / f"{size}.json"
            path.write_text(json.dumps(content | {size: SIZE}), encoding="utf-8")
            found = read_calibration(path)
            assert found.fisheye == fish
            assert said in found.notes[0]
        assert read_calibration(tmp_path / "size.json", fisheye=True).notes == ()


K = [[500.0, 0, 320.0], [0, 500.0, 240.0], [0, 0, 1]]
GOOD = {"camera_matrix": K, "dist_coeffs": [-0.3, 0.12, 0.001, -0.0005, 0.0], "image_size": [640, 480]}
FOUR = {"dist_coeffs": [0.01, 0.0, 0.0, 0.0]}
FLAT = {"fx": 500, "fy": 500, "cx": 320, "cy": 240, "width": 640, "height": 480}


@pytest.mark.faults
class TestRefusals:
    @pytest.mark.parametrize(
        ("content", "words"),
        [
            (GOOD | {"distortion_model": "omni"}, "field distortion_model: 'omni' is not known"),
            (GOOD | {"camera_model": "ds"}, "field camera_model: 'ds' is not known; known are plumb_bob"),
            (GOOD | {"model": "inverse_brown_conrady"}, "field model: 'inverse_brown_conrady'"),
            (GOOD | {"model": "plumb_bob", "fisheye": True}, "contradicts itself about the lens"),
            (
                GOOD | {"dist_coeffs": [0, 0, 0, 0, 0, 0.2, 0.1, 0], "model": "rational_polynomial"},
                "field dist_coeffs: .* got also k4 = 0.2, k5 = 0.1",
            ),
            (FLAT | {"k1": -0.1, "k2": 0.0, "k3": 0.0, "k6": 0.3}, "got also k6 = 0.3"),
            (FLAT | {"k1": 0.1, "p1": 0.01, "p2": 0.01, "model": "fisheye"}, "got also p1 = 0.01, p2"),
            (FLAT | {"k2": 0.1}, "field k1: missing, there is k2"),
            (FLAT | {"k1": 0.1, "p2": 0.0}, "field p1: missing, there is p2"),
            (GOOD | {"dist_coeffs": [0.1, 0.0, 0.0]}, "4 or 5 or 8 .* got 3"),
            (GOOD | {"model": "fisheye"}, "fisheye lens has 4 coefficients .* got 5"),
            (GOOD | {"model": "none"}, "must be 0 for the model 'none'"),
            (GOOD | {"k1": 0.1}, "field dist_coeffs: states distortion that k1 states too"),
            (
                {"camera_matrix": K, "image_size": [640, 480], "distortion_params": [0.1, 0.0]},
                "field distortion_params: is not known",
            ),
            (GOOD | {"image_size": [640, 48]}, "cy must lie in the middle half of the picture"),
            (
                GOOD | {"image_size": [64, 48]},
                "cx must lie in the middle half .* got 320; is 64 x 48 the size",
            ),
            (FLAT | {"cx": -320}, "field fx, fy, cx, cy: cx must lie in the middle half"),
            (FLAT | {"cy": 400}, "cy must lie in the middle half .* 119.5 to 359.5 px of 480, got 400"),
            (FLAT | {"fx": 3.6, "fy": 3.6}, "fx 3.6 px .* field of view of 178.7 deg"),
            (FLAT | {"fx": 9000, "fy": 9000}, "field of view of 4.073 deg, must be 5 to 170 deg"),
            (
                FLAT | {"fx": 3.6, "fy": 3.6, "model": "fisheye"},
                "must be 5 to 200 deg; fx and fy are in pixels",
            ),
            (FLAT | {"fy": 700}, "fy over fx must be 0.8 to 1.25, got 700 / 500 = 1.4"),
            (FLAT | {"fx": "wide"}, "field fx: must be numbers, got 'wide'"),
            (FLAT | {"fx": True}, "field fx: must be numbers, got True"),
            (FLAT | {"cy": float("inf")}, "field cy: must be .*numbers"),
            (FLAT | {"fx": [500, 500]}, "field fx: must be one number"),
            (FLAT | {"fx": 0, "fy": 0}, "fx and fy must be positive"),
            (FLAT | {"width": 640.5}, "field width: must be a whole number of pixels"),
            (FLAT | {"width": None}, "field image_width: missing, there is only height"),
            ({name: value for name, value in FLAT.items() if name != "fy"}, "field fy: missing; has fx, cx"),
            (GOOD | {"camera_matrix": np.transpose(K).tolist()}, "is it transposed"),
            (GOOD | {"camera_matrix": [[1, 2], [3, 4]]}, "field camera_matrix: must be 3 x 3, got 4"),
            (GOOD | {"camera_matrix": [[500, "x", 1]]}, "field camera_matrix: must be numbers"),
            (GOOD | {"fx": 400}, "says fx 500, the file also says 400"),
            (GOOD | {"dist_coeffs": [[[[[[0.1]]]]]]}, "field dist_coeffs: must be numbers"),
            (GOOD | {"dist_coeffs": [-200, 0, 0, 0, 0]}, "field dist_coeffs: .*k1"),
            ({"left": GOOD, "right": GOOD | FOUR}, "several cameras .left, right.; keep that of this sensor"),
            ({"cam0": {"T_cam_imu": K}}, "missing, and there is no fx either; is it a lens calibration"),
            ({"M1": K, "D1": [0, 0, 0, 0]}, "It has M1, D1"),
        ],
    )
    @pytest.mark.parametrize("suffix", [".json", ".yaml"])
    def test_a_lens_that_cannot_be_is_refused_in_a_line(self, content, words, suffix, tmp_path):
        path = tmp_path / f"lens{suffix}"
        dumped = json.dumps(content) if suffix == ".json" else yaml.safe_dump(content, sort_keys=False)
        path.write_text(dumped, encoding="utf-8")
        if suffix == ".yaml" and "got True" in words:
            words = "field fx: must be numbers, got 'true'"
        with pytest.raises(LensError, match=words) as caught:
            camera_of(path)
        assert str(caught.value).startswith(f"{path}: ")
        assert "\n" not in str(caught.value)

    @pytest.mark.parametrize(
        ("name", "content", "words"),
        [
            ("a.yml", b"", "is empty"),
            ("a.yml", b"camera_matrix: [1, 2\nb: 3\n", "cannot be read as YAML: .* in line"),
            ("a.yml", b"%YAML:1.0\n---\nK: [1, 2\n", "cannot be read as YAML: .* in line"),
            ("a.yml", b"just words\n", "holds no names with values"),
            ("a.yml", b"K: " + b"[" * 1200, "cannot be read"),
            ("a.json", b'{"K": [1, 2}', "cannot be read as JSON: .*line 1"),
            ("a.json", b'{"K": ' + b"[" * 200_000, "cannot be read"),
            (
                "a.yml",
                yaml.dump({"K": np.eye(3)}).encode(),
                r"holds Python objects, such as NumPy arrays; write lists of numbers .\.tolist",
            ),
            ("a.txt", b"[image]\n\nwidth\n640\n", "cannot be read as YAML"),
            ("a.xml", b"<opencv_storage><K>", "cannot be read as XML"),
            ("a.xml", b"<opencv_storage></opencv_storage>", "holds no names"),
            ("a.npz", b"PK\x03\x04 cut", "no NumPy archive"),
            ("a.npz", b"words", "no NumPy archive"),
            ("a.npy", b"\x93NUMPY\x01\x00", "holds one array"),
            ("a.dat", b"\xff\x00\x01", "is no text in UTF-8"),
            ("a.txt", b"1 FOV 640 480 1 1 1 1 1", "camera model FOV is not known; known are SIMPLE_PINHOLE"),
            ("a.txt", b"1 PINHOLE 640 480 500 500 320", "has 4 parameters .fx fy cx cy., got 3"),
            ("a.txt", b"1 PINHOLE 640 480 500 five 320 240", "field fy: must be numbers, got 'five'"),
            (
                "a.txt",
                b"1 PINHOLE 640 480 500 500 320 240\n2 PINHOLE 640 480 510 500 320 240",
                "several cameras .1, 2.",
            ),
        ],
    )
    def test_a_file_that_cannot_be_read_is_named(self, name, content, words, tmp_path):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(LensError, match=words) as caught:
            read_calibration(path)
        assert str(caught.value).startswith(f"{path}: ")

    def test_a_missing_file_is_named(self, tmp_path):
        with pytest.raises(LensError, match=r"none\.yml: cannot be read: No such file"):
            read_calibration(tmp_path / "none.yml")

    @pytest.mark.parametrize("lens", [UNEQUAL, FISHEYE], ids=["pinhole", "fisheye"])
    @pytest.mark.parametrize("name", KINDS)
    def test_damaged_files_are_refused_or_stay_sane(self, name, lens, tmp_path):
        path = written(tmp_path, name, lens)
        good = path.read_bytes()
        random = np.random.default_rng(sum(map(ord, name)) + len(lens["d"]))
        for _ in range(50):
            data = bytearray(good)
            for _ in range(random.integers(1, 4)):
                place = int(random.integers(len(data) + 1)) % max(1, len(data))
                match random.integers(4):
                    case 0:
                        data[place : place + 1] = bytes([random.integers(256)])
                    case 1:
                        del data[place : place + int(random.integers(1, 20))]
                    case 2:
                        data[place:place] = bytes(random.choice(list(b"0123456789.-e:,[]{} \n"), 2).tolist())
                    case _:
                        data = data[: max(1, place)] if random.random() < 0.2 else data
            path.write_bytes(bytes(data))
            refused = ""
            try:
                found = read_calibration(path)
                changes, _ = lens_fields(path, DESIGN.camera)
            except LensError as error:
                refused = str(error)
            if refused:
                assert refused.startswith(f"{path}: ")
                assert "\n" not in refused
                continue
            camera = DESIGN.replace(changes).camera
            assert 5 <= camera.horizontal_fov_deg <= 200
            assert 0.25 <= camera.centre_px[0] / 1280 <= 0.75
            assert 0.25 <= camera.centre_px[1] / 960 <= 0.75
            assert np.isfinite(found.matrix).all()


class TestCommand:
    def run(self, capsys, *words):
        status = cli.main([*map(str, words), "--json"])
        captured = capsys.readouterr()
        return status, json.loads(captured.out), captured.err

    @pytest.mark.parametrize(
        ("name", "lens", "said"),
        [
            (
                "ros1.yaml",
                UNEQUAL,
                "ros1.yaml: ROS camera_info, 640 x 480, fx 501.5 fy 498.5 px, cx 311.0 cy 241.2, "
                "65.1 deg wide, plumb_bob k1 -0.3 k2 0.12 p1 1e-05 p2 -0.0005",
            ),
            (
                "kalibr.yaml",
                WIDE,
                "kalibr.yaml: Kalibr camchain, 640 x 480, fx 250.0 fy 250.0 px, cx 318.0 cy 244.5, ",
            ),
            (
                "cameras.txt",
                PLAIN,
                "cameras.txt: COLMAP cameras.txt, 640 x 480, fx 801.0 fy 799.0 px, cx 319.5 cy 239.5, ",
            ),
        ],
    )
    def test_what_was_understood_is_said(self, name, lens, said, tmp_path, capsys):
        path = written(tmp_path, name, lens)
        assert cli.main(["lens", str(path)]) == 0
        assert capsys.readouterr().out.startswith(said)
        status, data, _ = self.run(capsys, "lens", path)
        assert status == 0
        (understood,) = data["understood"]
        assert understood["file"] == str(path)
        assert understood["as"] == KINDS[name][1]
        assert understood["size"] == [640, 480]
        assert understood["fy"] == lens["fy"]
        assert understood["lens"] == ("fisheye" if is_fisheye(lens) else "pinhole")

    def test_a_design_is_written_with_the_lens(self, tmp_path, capsys):
        DESIGN.save(tmp_path / "design.toml")
        np.savez(tmp_path / "lens.npz", mtx=K, dist=[[-0.3, 0.12, 0.001, -0.0005, 0.0]])
        words = (
            "lens",
            tmp_path / "lens.npz",
            "--design",
            tmp_path / "design.toml",
            "--out",
            tmp_path / "new.toml",
        )
        status, data, error = self.run(capsys, *words)
        assert (status, "states no picture size" in data["error"], "--lens-size" in error) == (2, True, True)
        assert not (tmp_path / "new.toml").exists()
        status, data, _ = self.run(capsys, *words, "--lens-size", "640x480")
        assert status == 0
        camera = load(tmp_path / "new.toml").camera
        assert camera.horizontal_fov_deg == pytest.approx(65.24, abs=0.01)
        assert camera.distortion.k1 == -0.3
        assert data["fields"]["camera.pixel_aspect"] == 1.0

    def test_import_says_what_it_understood(self, tmp_path, capsys):
        DESIGN.save(tmp_path / "design.toml")
        np.save(tmp_path / "a.npy", np.full((48, 64, 3), 0.2, dtype=np.float32))
        np.savez(tmp_path / "lens.npz", mtx=K, dist=[[-0.3, 0.12, 0.001, -0.0005, 0.0]])
        words = ("import", tmp_path / "a.npy", "--kind", "background", "--out", tmp_path / "m", "--black", 0)
        words = (*words, "--sensor", tmp_path / "design.toml", "--lens", tmp_path / "lens.npz")
        status, data, _ = self.run(capsys, *words)
        assert (status, "--lens-size" in data["error"]) == (2, True)
        assert not (tmp_path / "m").exists()
        status, data, _ = self.run(capsys, *words, "--lens-size", "640x480")
        assert status == 0
        assert [each["as"] for each in data["understood"]][1:] == ["NumPy archive"]  # after the picture
        assert load(tmp_path / "m" / "design.toml").camera.focal_px == pytest.approx(1000.0)

    @pytest.mark.parametrize("size", ["640", "640x", "axb", "640,480", "0x0", "-1x5"])
    def test_a_size_that_is_none_is_refused(self, size, tmp_path, capsys):
        np.savez(tmp_path / "lens.npz", mtx=K, dist=[0.0] * 5)
        status, data, _ = self.run(capsys, "lens", tmp_path / "lens.npz", f"--lens-size={size}")
        assert status == 2
        assert "--lens-size" in data["error"]
