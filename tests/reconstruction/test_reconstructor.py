"""From balls to one calibration file, and from pictures to shapes: made pictures whose shape is known."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter, label

from designlab.app import cli
from designlab.core.images import read_image, write_image
from designlab.mechanics.grid_response import symbol
from designlab.mechanics.layer import ElasticLayer
from designlab.mechanics.surface_pressure import pressure_under
from designlab.reconstruction.calibration_file import CalibrationFileError, load_calibration
from designlab.reconstruction.contact_pressure import contact_of
from designlab.reconstruction.height import border_surface, gradients_of, integrate
from designlab.reconstruction.markers import Markers
from designlab.reconstruction.reconstructor import Reconstructor
from tests.helpers.ball_pictures import exposed, pressed
from tests.helpers.browser import faults, opened
from tests.reconstruction.test_lab import BACKGROUND, BALLS, SHAPE, SURFACE

PRESS_RADIUS_MM = 1.2


@pytest.mark.slow
def test_balls_left_out_are_found_and_the_verdict_is_good(ball_calibration):
    assert ball_calibration.mean.contact_deg < 2.0
    assert ball_calibration.mean.height_mm < 0.02
    assert ball_calibration.verdict() == ("good", ())
    assert ball_calibration.kept.about["balls"] == len(BALLS)


@pytest.mark.slow
def test_a_file_gives_back_the_same_maps(ball_calibration, calibration_file):
    again = load_calibration(calibration_file)
    image = pressed()
    ours, theirs = (Reconstructor(kept)(image, pressure=False) for kept in (ball_calibration.kept, again))
    assert np.abs(ours.height_mm - theirs.height_mm).max() < 1e-6


@pytest.mark.slow
def test_a_press_has_its_depth_contact_and_force(calibration_file):
    shape = Reconstructor.load(calibration_file)(pressed())
    truth = SURFACE.depth_mm(PRESS_RADIUS_MM)
    assert shape.depth_mm == pytest.approx(truth, rel=0.06)
    assert shape.contact_area_mm2 == pytest.approx(np.pi * PRESS_RADIUS_MM**2, rel=0.25)
    assert shape.warnings == ()
    assert shape.force_n(0.5) == pytest.approx(0.5 * shape.force_n(1.0))
    value, low, high = shape.force_range(0.5, 0.05)
    assert value == shape.force_n(0.5)
    assert low < value / 1.2 < value * 1.2 < high


@pytest.mark.slow
@pytest.mark.faults
@pytest.mark.parametrize(
    ("image", "warning"),
    [
        (exposed(BACKGROUND), "nothing touches the gel"),
        (exposed(BACKGROUND)[:, ::-1] * [1.0, 0.2, 0.2], "colours that no ball showed"),
        (np.where(pressed() > pressed().mean(), 1.0, pressed()), "at full scale and say nothing"),
        (pressed((8, 60), 16.0), "reaches the border"),
    ],
)
def test_what_speaks_against_a_shape_is_said(calibration_file, image, warning):
    shape = Reconstructor.load(calibration_file)(image, pressure=False)
    assert any(warning in text for text in shape.warnings), shape.warnings


@pytest.mark.slow
@pytest.mark.faults
def test_a_gel_that_has_moved_or_light_that_has_changed_is_said(calibration_file):
    reconstructor = Reconstructor.load(calibration_file)
    textured = exposed(BACKGROUND * (1 + 0.1 * np.random.default_rng(0).normal(size=(*SHAPE, 1))))
    on = reconstructor.on(textured)
    assert on.drift(textured) == ()
    assert any("moved by +3 px" in text for text in on.drift(np.roll(textured, 3, axis=1)))
    assert any("brighter by" in text for text in on.drift(0.8 * textured))
    half = textured * np.linspace(0.8, 1.2, SHAPE[1])[:, None]
    assert any("has changed by" in text for text in on.drift(half))


@pytest.mark.slow
def test_printed_markers_are_no_change_of_light(calibration_file):
    rows, columns = np.indices(SHAPE)
    away = np.hypot(rows % 24 - 12, columns % 24 - 12)
    marked = exposed(BACKGROUND) * gaussian_filter(np.where(away < 4, 0.1, 1.0), 0.5)[..., None]
    markers = Markers.found_in(marked)
    assert markers is not None
    made = Reconstructor.load(calibration_file)
    kept = made.kept._replace(about={**made.kept.about, "markers": markers.plain()})
    on = replace(made, kept=kept)
    assert on.drift(marked) == ()
    assert any("brighter by -20%" in text for text in on.drift(0.8 * marked))


@pytest.mark.slow
@pytest.mark.faults
def test_other_sizes_and_other_files_are_refused(calibration_file, tmp_path):
    reconstructor = Reconstructor.load(calibration_file)
    with pytest.raises(ValueError, match=r"must be 140 x 120 pixels of 3 channels, .* got 70 x 120 pixels"):
        reconstructor(pressed()[:, :70])
    with pytest.raises(ValueError, match="background: must be 140 x 120"):
        reconstructor.on(exposed(BACKGROUND)[:50])
    other = tmp_path / "other.npz"
    np.savez(other, x=np.zeros(3))
    (tmp_path / "text.npz").write_text("no archive")
    for wrong in (other, tmp_path / "text.npz", tmp_path):
        with pytest.raises(CalibrationFileError, match="is no calibration"):
            load_calibration(wrong)
    with pytest.raises(CalibrationFileError, match="no such file"):
        load_calibration(tmp_path / "absent.npz")


@pytest.mark.faults
@pytest.mark.parametrize(
    ("files", "options", "line"),
    [
        ({}, (), "needs a picture of the untouched gel"),
        ({"background.exr": SHAPE}, (), "diameter of the ball is unknown; give it with --ball-mm"),
        ({"background.exr": SHAPE}, ("--ball-mm", "6"), "size of a pixel at the gel is unknown"),
        (
            {"background.exr": SHAPE, "a.exr": (60, 70)},
            ("--ball-mm", "6", "--mm-per-px", "0.1"),
            "a.exr: must have the size of background.exr, 140 x 120 pixels, got 70 x 60",
        ),
        (
            {"background.exr": SHAPE, "a.exr": SHAPE},
            ("--ball-mm", "6", "--mm-per-px", "0.1"),
            "a.exr: no ball found",
        ),
        (
            {"background-1.exr": SHAPE, "background-2.exr": (60, 70)},
            ("--ball-mm", "6", "--mm-per-px", "0.1"),
            "background-2.exr: must have the size of background-1.exr",
        ),
        ({"background.exr": SHAPE}, ("--crop-px", "0,0,9,9"), "--crop-px: is for --design MODEL"),
        (
            {"background.exr": SHAPE},
            ("--ball-mm", "6", "--design", "digit360-like"),
            "must have the proportions of the camera's whole picture",
        ),
        (
            {"background.exr": (120, 160)},
            ("--ball-mm", "6", "--mm-per-px", "3", "--design", "default"),
            "--mm-per-px: pictures of ",
        ),
    ],
)
def test_what_balls_lack_is_said(tmp_path, files, options, line, capsys):
    for name, shape in files.items():
        write_image(tmp_path / name, np.full((*shape, 3), 0.5, np.float32))
    assert cli.main(["calibrate", "--balls", str(tmp_path), *options, "--out", str(tmp_path / "out")]) == 2
    assert line in capsys.readouterr().err


@pytest.mark.slow
def test_the_commands_write_shapes_once_and_pages_that_hold(calibration_file, ball_folder, tmp_path, capsys):
    presses, out = tmp_path / "presses", tmp_path / "shapes"
    presses.mkdir()
    write_image(presses / "one.exr", pressed())
    write_image(presses / "two.exr", pressed((80, 70), 10.0))
    command = [
        "reconstruct",
        str(presses),
        "--calibration",
        str(calibration_file),
        "--gel",
        "solaris",
        "--out",
        str(out),
    ]
    assert cli.main(command) == 0
    said = capsys.readouterr().out
    assert "one.exr" in said
    assert "report: " in said
    names = {path.name for path in out.iterdir()}
    kinds = (".png", ".ply", "-height.npy", "-height.tiff", "-height.exr", "-normals.npy", "-contact.png")
    assert {f"{name}{kind}" for name in ("one", "two") for kind in kinds} <= names
    height = np.load(out / "one-height.npy")
    assert height.shape == SHAPE
    assert np.abs(read_image(out / "one-height.exr")[..., 0] - height).max() < 1e-3
    before = {path.name: path.stat().st_mtime_ns for path in out.glob("*-height.npy")}
    write_image(presses / "three.exr", pressed((40, 80), 9.0))
    assert cli.main(command) == 0
    after = {path.name: path.stat().st_mtime_ns for path in out.glob("*-height.npy")}
    assert {name: after[name] for name in before} == before
    assert "three-height.npy" in after
    with opened() as browser:
        assert faults(browser, out / "report.html") == []


@pytest.mark.slow
@pytest.mark.faults
def test_pictures_of_usual_formats_are_read_and_others_refused_one_by_one(calibration_file, tmp_path, capsys):
    image = np.round(255 * pressed()).astype(np.uint8)
    for suffix in ("jpg", "bmp", "webp", "tif"):
        Image.fromarray(image).save(tmp_path / f"good.{suffix}")
    np.save(tmp_path / "good.npy", pressed())
    np.save(tmp_path / "counts.npy", 255 * pressed())
    Image.fromarray(image).convert("CMYK").save(tmp_path / "inks.jpg")
    (tmp_path / "text.png").write_text("no picture")
    command = ["reconstruct", str(tmp_path), "--calibration", str(calibration_file), "--mesh", "none"]
    assert cli.main([*command, "--out", str(tmp_path / "out"), "--json"]) == 1
    said = json.loads(capsys.readouterr().out)
    assert len(said["shapes"]) == 5
    assert all(0.2 < row["depth_mm"] < 0.4 for row in said["shapes"])
    told = {each["file"].rpartition("/")[2]: each["reason"] for each in said["refused"]}
    assert set(told) == {"counts.npy", "inks.jpg", "text.png"}
    assert "values must lie between 0 and 1" in told["counts.npy"]
    assert "CMYK" in told["inks.jpg"]


@pytest.mark.measured
@pytest.mark.slow
@pytest.mark.full
def test_real_presses_by_the_two_commands(measured_dir, tmp_path, capsys):
    """Depth of the cap of a real ball and of a real prism; figures in docs/validation.md."""
    thu, out = measured_dir / "thu", tmp_path / "calibrated"
    assert cli.main(["calibrate", "--balls", str(thu), "--out", str(out)]) == 0
    depths = ("0.25", "0.5", "0.75", "1.0")
    for name in (f"{kind}_{depth}" for kind in ("sphere", "prism") for depth in depths):
        shape = Reconstructor.load(out / "calibration.npz")(
            read_image(thu / f"press_{name}.png"), pressure=False
        )
        print(name, shape.depth_mm)
        assert shape.depth_mm == pytest.approx(float(name.partition("_")[2]), abs=0.1)


@pytest.mark.parametrize(("specks", "noise_um"), [(0, 0.0), (6, 2.0), (12, 4.0)])
@pytest.mark.parametrize("second_px", [None, 5.0])
def test_specks_are_no_contacts(specks, noise_um, second_px):
    """What a point of the blurred picture or noise presses in is none; a small contact is one."""
    random = np.random.default_rng(specks)
    rows, columns = np.indices((90, 120))
    layer, pitch_mm = ElasticLayer(1.0, 0.49, 2.0), 0.1
    pressure = np.where(np.hypot(columns - 45, rows - 40) < 12, 0.2, 0.0)
    if second_px is not None:
        pressure[np.hypot(columns - 90, rows - 60) < second_px] = 0.2
    for row, column in zip(random.integers(30, 60, specks), random.integers(60, 75, specks), strict=True):
        pressure[row, column] = 0.05
    spectrum = np.fft.rfft2(pressure, s=(180, 240)) * symbol(layer, pitch_mm, 180, 240, "zz")
    height = np.fft.irfft2(spectrum, s=(180, 240))[:90, :120]
    height += noise_um / 1000 * gaussian_filter(random.normal(size=height.shape), 1.0) * 3.5
    found = pressure_under(height, poisson=0.49, thickness_mm=2.0, pitch_mm=pitch_mm)
    contact = contact_of(found, (180, 240), 0.1, 2.0)
    assert label(contact, np.ones((3, 3)))[1] == (1 if second_px is None else 2)
    assert contact[80, 90]
    assert second_px is None or contact[120, 180]


@pytest.mark.parametrize(("x_px", "y_px"), [(60, 45), (30, 40), (95, 70)])
@pytest.mark.parametrize(("thickness_mm", "poisson"), [(2.0, 0.49), (6.0, 0.4999)])
def test_the_border_is_as_high_as_the_gel_is_there(x_px, y_px, thickness_mm, poisson):
    """Slopes of a layer's surface, whose far slopes and bulge reach the border of a picture."""
    layer, pitch_mm, (rows, columns) = ElasticLayer(1.0, poisson, thickness_mm), 0.1, (90, 120)
    at = np.indices((3 * rows, 3 * columns))  # the gel goes on beyond the picture
    distance = np.hypot(at[1] - columns - x_px, at[0] - rows - y_px)
    pressure = 0.2 * np.sqrt(np.maximum(1 - (distance / 14) ** 2, 0))
    spectrum = np.fft.rfft2(pressure, s=(6 * rows, 6 * columns))
    spectrum *= symbol(layer, pitch_mm, 6 * rows, 6 * columns, "zz")
    truth = np.fft.irfft2(spectrum, s=(6 * rows, 6 * columns))[rows : 2 * rows, columns : 2 * columns]
    held = integrate(*gradients_of(truth, pitch_mm=pitch_mm), pitch_mm=pitch_mm, boundary="dirichlet")
    height = held
    for _ in range(2):
        found = pressure_under(height, poisson=poisson, thickness_mm=thickness_mm, pitch_mm=pitch_mm)
        height = held + border_surface(found.surface_mm)
    before, after = (np.abs(h - truth).max() for h in (held, height))
    assert before > 0.015 * truth.max()
    assert after < max(0.15 * before, 0.015 * truth.max())


def test_a_border_surface_is_harmonic():
    y, x = np.mgrid[0:30, 0:40] / 10
    for harmonic in (1 + 2 * x - 3 * y, x**2 - y**2, x * y):
        bumpy = harmonic.copy()
        bumpy[5:20, 8:30] += np.random.default_rng(1).normal(size=(15, 22))
        np.testing.assert_allclose(border_surface(bumpy), harmonic, atol=1e-9)
