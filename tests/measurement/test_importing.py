"""Import: planted pictures come back linear; lens files say what OpenCV says; wrong input is named."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from designlab.app import cli
from designlab.core.images import to_srgb, write_image
from designlab.measurement import Conversion, MeasurementError, import_frames, load_measurement
from designlab.measurement.importing.camera_files import read_camera_file, superpixels
from designlab.measurement.importing.import_frames import items, listed
from designlab.measurement.importing.ladder import (
    LadderError,
    estimate_response,
    read_table,
    table_text,
)
from designlab.measurement.importing.lens_file import LensError, lens_fields
from designlab.sensor.camera import Camera
from designlab.sensor.design import dumps, load, preset
from designlab.sensor.response_curve import Response

ROWS, COLUMNS = 48, 64
LINEAR = Response()
SRGB = Response(curve="srgb")


@pytest.fixture
def scene():
    """Smooth linear picture with all its values between 0.02 and 0.6."""
    row, column = np.indices((ROWS, COLUMNS)) / COLUMNS
    planes = [0.02 + 0.58 * (column**2 + row) / 2, 0.05 + 0.4 * (1 - column), 0.1 + 0.3 * row]
    return np.stack(planes, axis=-1)


def imported(paths, conversion, out, **known):
    import_frames(items(paths, **({"kind": "background"} | known)), conversion, out=out)
    measurement = load_measurement(out)
    assert measurement.response == "linear"
    return measurement


def ladder(response, seed, *, bits=8, well_e=5000.0, exposures=(1, 2, 4, 8)):
    """One scene of 60 x 80 pixels at several exposures, with photon noise and steps."""
    rng = np.random.default_rng(seed)
    scene = np.exp(rng.uniform(np.log(0.01), np.log(1.2), (60, 80, 1))) * np.array([1.0, 0.8, 0.5])
    pictures = []
    for exposure in exposures:
        signal = scene * exposure / max(exposures)
        signal = signal + np.sqrt(signal / well_e + (5 / well_e) ** 2) * rng.standard_normal(signal.shape)
        steps = 2**bits - 1
        pictures.append(np.round(response.encode(np.clip(signal, 0, 1)) * steps) / steps)
    return pictures, exposures


class TestResponse:
    @pytest.mark.parametrize("seed", range(3))
    @pytest.mark.parametrize(
        "response", [SRGB, Response(curve="gamma", gamma=2.2), Response(curve="gamma", gamma=1.6), LINEAR]
    )
    def test_an_exposure_ladder_tells_the_curve(self, response, seed):
        """Up to a common factor within 1.5 % everywhere from 2 to 90 % of full scale, 0.5 % in the mean."""
        found = estimate_response(*ladder(response, seed))
        true = np.linspace(0.02, 0.9, 200)
        ratio = found.decode(response.encode(true)) / true
        ratio /= np.exp(np.log(ratio).mean())
        assert np.abs(ratio - 1).max() < 0.015
        assert np.sqrt(np.mean((ratio - 1) ** 2)) < 0.005

    def test_two_pictures_are_enough_and_their_order_does_not_count(self):
        pictures, exposures = ladder(SRGB, 7, exposures=(4, 1))
        found = estimate_response(pictures, exposures)
        other = estimate_response(pictures[::-1], exposures[::-1])
        true = np.linspace(0.05, 0.9, 50)
        ratio = found.decode(to_srgb(true)) / true
        np.testing.assert_allclose(ratio / np.exp(np.log(ratio).mean()), 1.0, atol=0.02)
        np.testing.assert_allclose(other.linear, found.linear)

    def test_what_is_no_ladder_is_refused(self, scene):
        pictures, _ = ladder(SRGB, 1)
        for wrong, words in (
            ((pictures[:1], [1]), "at least 2 pictures"),
            ((pictures[:2], [1, 1]), "span a ratio"),
            (([pictures[0], pictures[1][:-2]], [1, 2]), "agree in size"),
            (([np.full((20, 20, 3), 0.001), np.full((20, 20, 3), 0.002)], [1, 2]), "too little of the scene"),
            (([pictures[0], pictures[2][::-1]], [1, 2]), "keep the camera still"),
            ((pictures[:3], [1, 2, 16]), "no curve explains"),
        ):
            with pytest.raises(LadderError, match=words):
                estimate_response(*wrong)

    def test_a_table_survives_its_file_and_broken_ones_are_named(self, tmp_path):
        found = estimate_response(*ladder(SRGB, 0))
        (tmp_path / "curve.csv").write_text(table_text(found), encoding="utf-8")
        again = read_table(tmp_path / "curve.csv")
        np.testing.assert_allclose(again.linear, found.linear, atol=1e-7)
        for text, words in (
            ("0,0\n1\n", "line 2"),
            ("0,0\n0.5,0.6\n", "from 0 to 1"),
            ("0,0\n.5,.9\n.7,.8\n1,1", "grow"),
        ):
            (tmp_path / "broken.csv").write_text(text, encoding="utf-8")
            with pytest.raises(LadderError, match=rf"broken\.csv.*{words}"):
                read_table(tmp_path / "broken.csv")


class TestConversion:
    def test_a_jpeg_of_high_quality_comes_back_linear(self, scene, tmp_path):
        counts = np.round(255 * to_srgb(scene)).astype(np.uint8)
        Image.fromarray(counts).save(tmp_path / "a.jpg", quality=98, subsampling=0)
        measurement = imported([tmp_path / "a.jpg"], Conversion(SRGB, black=0), tmp_path / "m")
        found = measurement.linear(measurement.frames[0])
        assert np.abs(found - scene).max() < 0.02  # three steps of 255 where the curve is steepest
        assert np.abs(found.mean(axis=(0, 1)) - scene.mean(axis=(0, 1))).max() < 5e-4

    def test_black_level_of_dark_frames_and_full_scale(self, scene, tmp_path):
        """12 bits in a file of 16, a level of 100 counts with noise: dark is 0 in the mean, full scale 1."""
        rng = np.random.default_rng(0)
        for name, light in (("a", scene), ("dark", np.zeros_like(scene))):
            counts = 100 + light * 3995 + 8 * rng.standard_normal(scene.shape)
            write_image(tmp_path / f"{name}.png", np.round(counts).astype(np.uint16))
        made = items([tmp_path / "a.png"], kind="background") + items([tmp_path / "dark.png"], kind="dark")
        done = import_frames(made, Conversion(LINEAR, white=4095), out=tmp_path / "m")
        assert done.black == pytest.approx([100 / 4095] * 3, abs=2e-4)
        measurement = load_measurement(tmp_path / "m")
        lit, dark = (measurement.image(frame) for frame in measurement.frames)
        assert abs(dark.mean()) < 1e-6
        assert dark.min() < 0  # noise is not cut
        assert np.abs(lit - scene).max() < 6 * 8 / 3995
        assert abs((lit - scene).mean()) < 2e-4

    def test_a_floor_below_zero_does_not_count_as_cut(self, scene, tmp_path):
        from designlab.measurement.shots import observe

        self.test_black_level_of_dark_frames_and_full_scale(scene, tmp_path)
        seen = observe(load_measurement(tmp_path / "m"), preset("gelsight-2020-flat"), columns=COLUMNS)
        assert not seen.shots[0].clip_sigma.any()
        assert np.abs(seen.black_level).max() < 1e-6

    @pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
    def test_a_mosaic_comes_back_at_half_its_size(self, scene, tmp_path, pattern):
        mosaic = np.zeros((2 * ROWS, 2 * COLUMNS))
        for place, colour in enumerate(pattern):
            mosaic[place // 2 :: 2, place % 2 :: 2] = scene[..., "RGB".index(colour)]
        counts = np.round(64 + mosaic * 959).astype(">u2")
        header = f"P5\n# a comment\n{2 * COLUMNS} {2 * ROWS}\n1023\n".encode()
        (tmp_path / "a.pgm").write_bytes(header + counts.tobytes())
        np.save(tmp_path / "b.npy", counts.astype(np.uint16))
        conversion = Conversion(LINEAR, black=64, white=1023, bayer=pattern)
        for name in ("a.pgm", "b.npy"):
            measurement = imported([tmp_path / name], conversion, tmp_path / f"of-{name}")
            np.testing.assert_allclose(measurement.image(measurement.frames[0]), scene, atol=0.51 / 959)

    def test_two_greens_are_averaged_and_an_odd_border_is_dropped(self):
        mosaic = np.arange(15.0).reshape(3, 5)
        np.testing.assert_array_equal(superpixels(mosaic, "RGGB"), [[[0, 3, 6], [2, 5, 8]]])

    def test_a_colour_matrix_is_undone_and_saturation_kept(self, scene, tmp_path):
        matrix = np.array([[1.7, -0.5, -0.2], [-0.3, 1.6, -0.3], [0.0, -0.6, 1.6]])
        grey = 0.3 + 0.4 * (scene - 0.3)  # light of little colour: nothing is cut at zero
        grey[:4, :5] = [0.9, 0.1, 0.1]
        sent = np.clip(grey @ matrix.T, 0, 1)
        write_image(tmp_path / "a.png", np.round(65535 * to_srgb(sent)).astype(np.uint16))
        measurement = imported([tmp_path / "a.png"], Conversion(SRGB, black=0, matrix=matrix), tmp_path / "m")
        found = measurement.image(measurement.frames[0])
        assert (found[:4, :5] == 1).all()  # red was cut at full scale, so nothing is known there
        scale = max(np.maximum(np.linalg.inv(matrix), 0).sum(axis=1).max(), 1)
        np.testing.assert_allclose(found[4:] * scale, grey[4:], atol=2e-4)
        assert found[4:].max() < 1

    def test_a_raw_file_brings_pattern_black_and_white(self, scene, tmp_path):
        pytest.importorskip("rawpy")
        file = tmp_path / "a.dng"
        dng(file, scene, black=256, white=4095)
        read = read_camera_file(file)
        assert (read.bayer, read.white) == ("RGGB", 4095)
        np.testing.assert_allclose(read.black, 256)
        measurement = imported([file], Conversion(LINEAR), tmp_path / "m")
        np.testing.assert_allclose(measurement.image(measurement.frames[0]), scene, atol=0.51 / 3839)

    def test_without_rawpy_it_is_said_how_to_get_it(self, tmp_path, monkeypatch, capsys):
        monkeypatch.setitem(sys.modules, "rawpy", None)
        (tmp_path / "a.dng").write_bytes(b"II*\0")
        words = ["import", str(tmp_path / "a.dng"), "--kind", "background", "--out", str(tmp_path / "m")]
        assert cli.main(words) == 1
        assert "pip install" in capsys.readouterr().err


def dng(path: Path, scene: np.ndarray, *, black: int, white: int) -> None:
    """Write the few tags that make a TIFF a DNG with a Bayer mosaic (Adobe DNG 1.4)."""
    import tifffile

    mosaic = np.zeros((2 * ROWS, 2 * COLUMNS))
    for place, colour in enumerate("RGGB"):
        mosaic[place // 2 :: 2, place % 2 :: 2] = scene[..., "RGB".index(colour)]
    counts = np.round(black + mosaic * (white - black)).astype(np.uint16)
    identity = [number for row in np.eye(3, dtype=int).tolist() for value in row for number in (value, 1)]
    tags = [
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, bytes([0, 1, 1, 2]), True),  # CFAPattern
        (50706, "B", 4, bytes([1, 4, 0, 0]), True),  # DNGVersion
        (50708, "s", 0, "Planted", True),  # UniqueCameraModel
        (50714, "H", 1, black, True),  # BlackLevel
        (50717, "H", 1, white, True),  # WhiteLevel
        (50721, "2i", 9, tuple(identity), True),  # ColorMatrix1
        (50778, "H", 1, 21, True),  # CalibrationIlluminant1
    ]
    tifffile.imwrite(path, counts, photometric=32803, extratags=tags, metadata=None)


MATRIX = np.array([[1650.3, 0.0, 831.2], [0.0, 1650.7, 610.4], [0.0, 0.0, 1.0]])
SIZE = (1640, 1232)
CAMERA = Camera(position_mm=(0, 0, 40), width_px=1640, height_px=1232)


def opencv_file(path, *, matrix=MATRIX, distortion, size=SIZE, **more):
    cv2 = pytest.importorskip("cv2")
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Sat Nov 21 10:00:00 2026")
    storage.write("image_width", size[0])
    storage.write("image_height", size[1])
    for name, value in more.items():
        storage.write(name, value)
    storage.write("camera_matrix", np.asarray(matrix, dtype=float))
    storage.write("distortion_coefficients", np.asarray(distortion, dtype=float))
    storage.write("avg_reprojection_error", 0.21)
    storage.release()
    return path


def with_lens(path, camera=CAMERA, **options):
    design = preset("gelsight-2020-flat").replace(
        {"camera.width_px": camera.width_px, "camera.height_px": camera.height_px}
    )
    changes, notes = lens_fields(path, design.camera, **options)
    return design.replace(changes).camera, notes


POINTS = np.array([[x, y, 1.0] for x in np.linspace(-0.45, 0.45, 7) for y in np.linspace(-0.33, 0.33, 5)])


class TestLens:
    @pytest.mark.parametrize("suffix", [".yml", ".yaml", ".xml", ".json"])
    def test_points_fall_where_opencv_projects_them(self, tmp_path, suffix):
        cv2 = pytest.importorskip("cv2")
        distortion = np.array([[-0.11, 0.04, 0.0011, -0.0007, 0.013]])
        file = opencv_file(tmp_path / f"lens{suffix}", distortion=distortion)
        camera, notes = with_lens(file)
        true, _ = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), MATRIX, distortion)
        column, row = camera.project(POINTS[:, 0], -POINTS[:, 1])
        # OpenCV counts from the centre of the first pixel.
        np.testing.assert_allclose(column - 0.5, true[:, 0, 0], atol=1e-8)
        np.testing.assert_allclose(row - 0.5, true[:, 0, 1], atol=1e-8)
        assert camera.pixel_aspect == pytest.approx(1650.7 / 1650.3, rel=1e-12)
        assert notes == ()

    def test_square_pixels_agree_to_rounding_at_any_binning(self, tmp_path):
        cv2 = pytest.importorskip("cv2")
        matrix = np.array([[825.0, 0.0, 415.25], [0.0, 825.0, 304.0], [0.0, 0.0, 1.0]])
        distortion = np.array([-0.11, 0.04, 0.0011, -0.0007])
        file = opencv_file(tmp_path / "lens.yml", matrix=matrix, distortion=distortion, size=(820, 616))
        camera, notes = with_lens(file)
        true, _ = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), matrix, distortion)
        column, row = camera.project(POINTS[:, 0], -POINTS[:, 1])
        np.testing.assert_allclose(column / 2 - 0.5, true[:, 0, 0], atol=1e-9)
        np.testing.assert_allclose(row / 2 - 0.5, true[:, 0, 1], atol=1e-9)
        assert any("binned" in note for note in notes)

    @pytest.mark.parametrize("flag", ["file", "argument"])
    def test_a_fisheye_agrees_to_rounding(self, tmp_path, flag):
        cv2 = pytest.importorskip("cv2")
        matrix = np.array([[600.0, 0.0, 820.5], [0.0, 600.0, 615.0], [0.0, 0.0, 1.0]])
        distortion = np.array([[0.03], [-0.012], [0.004], [-0.001]])
        more = {"fisheye_model": 1} if flag == "file" else {}
        file = opencv_file(tmp_path / "lens.yml", matrix=matrix, distortion=distortion, **more)
        camera, _ = with_lens(file, fisheye=True if flag == "argument" else None)
        assert camera.lens == "fisheye"
        points = POINTS * [2.5, 2.5, 1]
        true, _ = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), matrix, distortion)
        column, row = camera.project(points[:, 0], -points[:, 1])
        np.testing.assert_allclose(column - 0.5, true[:, 0, 0], atol=1e-8)
        np.testing.assert_allclose(row - 0.5, true[:, 0, 1], atol=1e-8)

    def test_plain_files_and_those_of_ros_say_the_same(self, tmp_path):
        matrix, distortion = (
            np.array([[900.0, 0, 800], [0, 900, 600], [0, 0, 1]]),
            [-0.1, 0.02, 0.0, 0.001, 0.0],
        )
        np.savez(tmp_path / "a.npz", camera_matrix=matrix, dist_coeffs=distortion)
        plain = {"camera_matrix": matrix.tolist(), "dist_coeffs": [distortion], "image_size": list(SIZE)}
        (tmp_path / "a.json").write_text(json.dumps(plain), encoding="utf-8")
        (tmp_path / "a.yaml").write_text(
            "image_width: 1640\nimage_height: 1232\ncamera_name: wrist\n"
            "camera_matrix:\n  rows: 3\n  cols: 3\n"
            "  data: [900.0, 0.0, 800.0, 0.0, 900.0, 600.0, 0.0, 0.0, 1.0]\n"
            "distortion_model: plumb_bob\n"
            "distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.1, 0.02, 0.0, 0.001, 0.0]\n"
            "rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n",
            encoding="utf-8",
        )
        sizes = {"a.npz": SIZE, "a.json": None, "a.yaml": None}
        found = [with_lens(tmp_path / name, size_px=size)[0] for name, size in sizes.items()]
        assert found[0] == found[1] == found[2]
        assert found[0].focal_px == pytest.approx(900.0)
        assert found[0].distortion.p2 == 0.001

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"matrix": MATRIX * [[1, 1, 1], [1, 1.32, 1], [1, 1, 1]]}, "fy over fx must be 0.8 to 1.25"),
            ({"matrix": MATRIX + np.diag([3.0, 0], 1)}, "no skew"),
            ({"distortion": [0.1, 0, 0, 0, 0, 0.2, 0.1, 0]}, "got also k4 = 0.2, k5 = 0.1"),
            ({"size": (1640, 1640)}, "proportion"),
            ({"distortion": [-3.0, 0, 0, 0]}, "turns back"),
            ({"matrix": np.eye(2)}, "3 x 3"),
        ],
    )
    def test_what_a_design_cannot_have_is_refused_by_name(self, tmp_path, changes, words):
        file = opencv_file(tmp_path / "lens.yml", **({"distortion": [0.0] * 5} | changes))
        with pytest.raises(LensError, match=rf"lens\.yml.*{words}"):
            with_lens(file)

    def test_a_file_without_a_calibration_is_refused(self, tmp_path):
        for name, text in (("a.yml", "width: 3\n"), ("a.xml", "<x>"), ("a.json", "{"), ("a.npz", "")):
            (tmp_path / name).write_text(text, encoding="utf-8")
            with pytest.raises(LensError, match=name):
                lens_fields(tmp_path / name, CAMERA)


class TestCommand:
    def run(self, capsys, *words):
        status = cli.main(["import", *map(str, words), "--json"])
        captured = capsys.readouterr()
        return status, json.loads(captured.out), captured.err

    def photo(self, path, light, response=SRGB):
        write_image(path, np.round(255 * response.encode(np.clip(light, 0, 1))).astype(np.uint8))
        return path

    def test_a_described_folder_becomes_a_measurement(self, scene, tmp_path, capsys):
        folder = tmp_path / "photos"
        folder.mkdir()
        for name, light in (("dark", 0 * scene), ("background", scene), ("ball", 0.9 * scene)):
            self.photo(folder / f"{name}.png", light)
        (tmp_path / "design.toml").write_text(dumps(preset("gelsight-2020-flat")), encoding="utf-8")
        (folder / "measurement.toml").write_text(
            'name = "first"\nsensor = "../design.toml"\nresponse = "srgb"\n'
            '[[frame]]\nfile = "dark.png"\nkind = "dark"\n'
            '[[frame]]\nfile = "background.png"\nkind = "background"\n'
            '[[frame]]\nfile = "ball.png"\nkind = "press"\nprobe = "sphere:4"\n'
            "depth_mm = 0.4\ncentre_mm = [1, 2]\n",
            encoding="utf-8",
        )
        status, data, _ = self.run(capsys, folder, "--out", tmp_path / "m")
        assert status == 0
        assert data["files"] == ["dark.exr", "background.exr", "ball.exr"]
        measurement = load_measurement(tmp_path / "m")
        assert (measurement.name, measurement.response, measurement.sensor) == (
            "first",
            "linear",
            "design.toml",
        )
        assert measurement.design() == preset("gelsight-2020-flat")
        assert measurement.frames[2].depth_mm == 0.4
        assert np.abs(measurement.linear(measurement.frames[1]) - scene).max() < 0.004

    @pytest.mark.parametrize(
        ("options", "text"),
        [
            ((), "knob.stl"),
            (("--probe-unit", "cm"), "knob.stl:cm"),
            (("--probe-side", "-z"), "knob.stl:-z"),
            (("--probe-unit", "inch", "--probe-side", "+x"), "knob.stl:inch:+x"),
        ],
    )
    def test_the_mesh_of_a_probe_is_copied_with_unit_and_side(
        self, scene, tmp_path, capsys, monkeypatch, options, text
    ):
        trimesh.creation.box((4, 3, 2)).export(tmp_path / "knob.stl")
        (tmp_path / "elsewhere").mkdir()
        for name in ("a", "b"):
            self.photo(tmp_path / f"{name}.png", scene)
        monkeypatch.chdir(tmp_path)
        what = ("--kind", "press", "--depth-mm", 0.5, "--at", "1,2", "--response", "srgb", "--out", "m")
        for picture, file in (("a.png", tmp_path / "knob.stl"), ("b.png", "knob.stl")):  # twice the same
            status, data, _ = self.run(capsys, picture, "--probe", file, *options, *what)
            assert status == 0
            (said,) = (each for each in data["understood"] if "extents_mm" in each)
            assert said["as"].startswith("STL, 12 triangles")
        (tmp_path / "knob.stl").unlink()
        measurement = load_measurement(tmp_path / "m")
        assert [frame.probe for frame in measurement.frames] == [text, text]
        press = measurement.press(measurement.frames[1])
        assert press.probe.file == str(tmp_path / "m" / "knob.stl")
        assert said["extents_mm"] == pytest.approx(
            {"cm": [40, 30, 20], "inch": [101.6, 76.2, 50.8]}.get(said["unit"], [4, 3, 2])
        )

    def test_the_part_that_pictures_show_and_the_direction_of_a_press_are_written(
        self, scene, tmp_path, capsys
    ):
        out = ("--crop-px", "40,30,160,120", "--response", "srgb", "--out", tmp_path / "m")
        for name, what in (
            ("gel", ("--kind", "background")),
            ("ball", ("--kind", "press", "--probe", "sphere:4", "--depth-mm", 0.4, "--direction", "normal")),
        ):
            dark = self.photo(tmp_path / f"dark-{name}.png", 0 * scene)
            status, _, _ = self.run(
                capsys, self.photo(tmp_path / f"{name}.png", scene), *what, *out, "--dark", dark
            )
            assert status == 0
        frames = load_measurement(tmp_path / "m").frames
        assert [frame.kind for frame in frames] == ["background", "dark", "press", "dark"]
        assert {frame.crop_px for frame in frames} == {(40, 30, 160, 120)}
        assert [frame.direction for frame in frames] == [None, None, "normal", None]

    @pytest.mark.faults
    def test_meshes_that_cannot_be_used_stop_an_import(self, scene, tmp_path, capsys):
        self.photo(tmp_path / "a.png", scene)
        what = (tmp_path / "a.png", "--kind", "press", "--response", "srgb", "--out", tmp_path / "m")
        trimesh.creation.box((4, 3, 2)).apply_scale(1e-3).export(tmp_path / "metres.stl")
        trimesh.creation.box((4, 3, 2)).export(tmp_path / "knob.stl")
        for probe, words in (
            (("metres.stl",), ("metres.stl", "--probe-unit", "m (4 x 3 x 2 mm)")),
            (("lost.stl",), ("lost.stl", "cannot be read")),
            (("knob.stl:m", "--probe-unit", "cm"), ("states the unit m",)),
            (("sphere:4", "--probe-side", "-z"), ("--probe-side: is for mesh files",)),
        ):
            name = probe[0] if ":4" in probe[0] else tmp_path / probe[0]
            status, data, _ = self.run(capsys, *what, "--probe", name, *probe[1:])
            assert status == 2
            assert all(word in data["error"] for word in words), data["error"]
            assert not (tmp_path / "m").exists()
        for folder, size in (("x", 4), ("y", 5)):
            (tmp_path / folder).mkdir()
            trimesh.creation.box((size, 3, 2)).export(tmp_path / folder / "knob.stl")
        self.photo(tmp_path / "b.png", scene)
        assert self.run(capsys, *what, "--probe", tmp_path / "x" / "knob.stl")[0] == 0
        second = (tmp_path / "b.png", *what[1:])
        status, data, _ = self.run(capsys, *second, "--probe", tmp_path / "y" / "knob.stl")
        assert (status, "has another knob.stl; rename it" in data["error"]) == (2, True)

    def test_meshes_of_a_described_folder_come_along(self, scene, tmp_path, capsys):
        """Also where pictures lie deeper, with the buffer of a glTF file."""
        folder = tmp_path / "photos"
        (folder / "raw").mkdir(parents=True)
        (folder / "probes").mkdir()
        self.photo(folder / "raw" / "a.png", scene)
        for name, data in trimesh.creation.box((4e-3, 3e-3, 2e-3)).export(file_type="gltf").items():
            (folder / "probes" / name.replace("model", "knob")).write_bytes(data)
        (folder / "measurement.toml").write_text(
            'response = "srgb"\nsensor = "gelsight-2020-flat"\n[[frame]]\nfile = "raw/a.png"\n'
            'kind = "press"\nprobe = "probes/knob.gltf:-y"\ndepth_mm = 0.4\ncentre_mm = [1, 2]\n',
            encoding="utf-8",
        )
        status, data, _ = self.run(capsys, folder, "--out", tmp_path / "m")
        assert status == 0, data
        assert data["understood"][-1]["unit"] == "m"
        measurement = load_measurement(tmp_path / "m")
        assert measurement.frames[0].probe == "probes/knob.gltf:-y"
        press = measurement.press(measurement.frames[0])
        assert (press.probe.side, round(press.probe.size_mm, 6)) == ("-y", 4.0)
        (mesh,) = measurement.meshes()
        assert str(mesh).endswith(
            "probes/knob.gltf: glTF, 12 triangles, in m: 4 x 3 x 2 mm, pressed with its -y side"
        )

    def test_call_by_call_frames_are_added(self, scene, tmp_path, capsys):
        for name, light in (("d0", 0 * scene), ("b0", scene), ("b1", scene), ("red", scene * [1, 0, 0])):
            self.photo(tmp_path / f"{name}.png", light)
        common = ("--response", "srgb", "--out", tmp_path / "m")
        first = ("--kind", "background", "--dark", tmp_path / "d0.png", "--sensor", "gelsight-2020-flat")
        assert self.run(capsys, tmp_path / "b0.png", tmp_path / "b1.png", *first, *common)[0] == 0
        one = (tmp_path / "red.png", "--kind", "background", "--leds", "red", *common)
        status, data, _ = self.run(capsys, *one)
        assert (status, "state the same" in data["error"]) == (2, True)
        assert self.run(capsys, *one, "--dark", tmp_path / "d0.png")[0] == 0  # named again for its level
        measurement = load_measurement(tmp_path / "m")
        assert [(f.file, f.repeat, f.leds) for f in measurement.frames] == [
            ("b0.exr", 0, None),
            ("b1.exr", 1, None),
            ("d0.exr", None, ()),
            ("red.exr", None, ("red",)),
        ]
        status, data, _ = self.run(capsys, *one, "--black", 0)
        assert (status, "is there already" in data["error"]) == (2, True)

    def test_a_ladder_gives_the_response_and_its_file(self, tmp_path, capsys):
        pictures, exposures = ladder(SRGB, 3)
        entries = []
        for picture, exposure in zip(pictures, exposures, strict=True):
            write_image(tmp_path / f"{exposure}.png", picture)
            entries.append(f"{tmp_path / f'{exposure}.png'}={exposure}")
        status, data, _ = self.run(capsys, "--ladder", *entries, "--save-response", tmp_path / "curve.csv")
        assert status == 0
        assert data["response"]["known"][0] < 0.1 < 0.9 < data["response"]["known"][1]
        words = (
            "--kind",
            "background",
            "--response",
            tmp_path / "curve.csv",
            "--black",
            0,
            "--out",
            tmp_path / "m",
        )
        assert self.run(capsys, tmp_path / "4.png", *words)[0] == 0
        measurement = load_measurement(tmp_path / "m")
        found = measurement.image(measurement.frames[0])
        true = SRGB.decode(pictures[2])
        used = (true > 0.02) & (true < 0.9)
        ratio = found[used] / true[used]
        assert np.abs(ratio / np.median(ratio) - 1).max() < 0.015

    def test_a_lens_goes_into_a_copy_of_the_design(self, scene, tmp_path, capsys):
        self.photo(tmp_path / "a.png", scene)
        matrix = MATRIX * [[2, 1, 2], [1, 2, 2], [1, 1, 1]]
        lens = opencv_file(
            tmp_path / "lens.yml", matrix=matrix, distortion=[-0.1, 0.02, 0, 0], size=(3280, 2464)
        )
        words = ("--kind", "background", "--response", "srgb", "--black", 0, "--out", tmp_path / "m")
        status, data, _ = self.run(capsys, tmp_path / "a.png", *words, "--lens", lens)
        assert (status, "sensor must be known" in data["error"]) == (2, True)
        assert not (tmp_path / "m").exists()
        full = ("--sensor", "gelsight-2020-flat", "--lens", lens)
        assert self.run(capsys, tmp_path / "a.png", *words, *full)[0] == 0
        design = load(tmp_path / "m" / "design.toml")
        assert design.camera.distortion.k1 == -0.1
        assert load_measurement(tmp_path / "m").design() == design

    def test_what_may_be_wrong_is_noted(self, scene, tmp_path, capsys):
        Image.fromarray(np.round(255 * scene).astype(np.uint8)).save(tmp_path / "a.jpg")
        write_image(tmp_path / "b.png", np.round(1023 * scene).astype(np.uint16))
        words = ("--kind", "background", "--response", "linear", "--out", tmp_path / "m")
        status, data, _ = self.run(capsys, tmp_path / "a.jpg", tmp_path / "b.png", *words)
        assert status == 0
        for said in (
            "a.jpg: a JPEG, which is hardly ever linear",
            "state its full scale as --white",
            "no black level",
        ):
            assert any(said in note for note in data["notes"]), said

    @pytest.mark.parametrize(
        ("words", "said"),
        [
            ([], "no pictures to import"),
            (["a.png"], "--kind: required"),
            (["a.png", "--kind", "background"], "--response: required for"),
            (["a.png", "--kind", "background", "--response", "log"], "response: one of linear, srgb"),
            (["a.png", "--kind", "press", "--response", "srgb"], "a press needs the probe"),
            (["none.png", "--kind", "background", "--response", "srgb"], "no such file"),
            (["a.txt", "--kind", "background", "--response", "srgb"], "suffix must be one of .exr .png"),
            (["a.png", "--kind", "dark", "--response", "srgb"], "suspected cause: LEDs were on"),
            (["a.png", "--kind", "background", "--response", "srgb", "--white", "0"], "white: must be above"),
            (
                ["a.png", "--kind", "background", "--response", "srgb", "--colour-matrix", "1,2"],
                "nine numbers",
            ),
            (["--ladder", "a.png"], "FILE=EXPOSURE"),
            (["--ladder", "a.png=1", "a.png=x"], "FILE=EXPOSURE"),
        ],
    )
    def test_wrong_input_ends_with_two_and_leaves_nothing(
        self, scene, tmp_path, monkeypatch, capsys, words, said
    ):
        monkeypatch.chdir(tmp_path)
        self.photo(Path("a.png"), scene)
        Path("a.txt").write_text("no picture", encoding="utf-8")
        status, data, error = self.run(capsys, *words, "--out", "m")
        assert status == 2
        assert said in data["error"]
        assert said in error
        assert not Path("m").exists()

    def test_files_and_folders_are_listed(self, scene, tmp_path):
        (tmp_path / "f").mkdir()
        self.photo(tmp_path / "f" / "a.png", scene)
        (tmp_path / "f" / "notes.txt").write_text("x", encoding="utf-8")
        assert listed([tmp_path / "f"]) == [tmp_path / "f" / "a.png"]
        (tmp_path / "empty").mkdir()
        with pytest.raises(MeasurementError, match="holds no pictures"):
            listed([tmp_path / "empty"])
