"""Pictures as labs have them: range, what a file was taken for, turn, colour; one picture in every format."""

import json

import numpy as np
import pytest
import tifffile
from PIL import Image

from designlab.app import cli
from designlab.core.images import to_srgb, write_image
from designlab.measurement import Conversion, check, import_frames, load_measurement
from designlab.measurement.importing.import_frames import items
from designlab.sensor.design import dumps, preset
from designlab.sensor.response_curve import Response

ROWS, COLUMNS = 30, 40
SRGB = Response(curve="srgb")


@pytest.fixture
def scene():
    """Smooth linear picture in colour with its values between 0.02 and 0.6."""
    row, column = np.indices((ROWS, COLUMNS)) / COLUMNS
    return np.stack([0.02 + 0.5 * column, 0.05 + 0.4 * (1 - column), 0.1 + 0.3 * row], axis=-1)


def run(capsys, *words):
    status = cli.main(["import", *map(str, words), "--json"])
    captured = capsys.readouterr()
    return status, json.loads(captured.out), captured.err


def lzw(path, counts):
    Image.fromarray(counts).save(path, compression="tiff_lzw")


def opaque(path, counts):
    Image.fromarray(np.dstack([counts, np.full_like(counts[..., 0], 255)])).save(path)


def netpbm(path, counts):
    kind = ">u2" if counts.dtype == np.uint16 else "u1"
    header = f"P6 {COLUMNS} {ROWS} {np.iinfo(counts.dtype).max}\n".encode()
    path.write_bytes(header + counts.astype(kind).tobytes())


def planes(path, counts):
    np.save(path, np.moveaxis(counts, -1, 0))


def pillow(path, counts):
    Image.fromarray(counts).save(path, **({"lossless": True} if path.suffix == ".webp" else {}))


def tiff(path, counts):
    tifffile.imwrite(path, counts, photometric="rgb")


def floats_of(step):
    """Write floats that run up to a full scale of `step`, rounded to whole numbers."""
    return lambda path, counts: np.save(path, counts.astype(np.float32) if step > 1 else counts / 255)


WAYS = [
    ("a.png", write_image, 8, None),
    ("a.png", write_image, 16, None),
    ("a.tif", tiff, 8, None),
    ("a.tif", tiff, 16, None),
    ("lzw.tif", lzw, 8, None),
    ("rgba.png", opaque, 8, None),
    ("a.bmp", pillow, 8, None),
    ("a.webp", pillow, 8, None),
    ("a.ppm", netpbm, 8, None),
    ("a.ppm", netpbm, 16, None),
    ("a.npy", np.save, 8, None),
    ("a.npy", np.save, 16, None),
    ("chw.npy", planes, 8, None),
    ("chw.npy", planes, 16, None),
    ("float1.npy", floats_of(1), 8, None),
    ("float255.npy", floats_of(255), 8, 255),
    ("float65535.npy", floats_of(65535), 16, 65535),
    ("int.npy", lambda path, counts: np.save(path, counts.astype(np.int32)), 16, 65535),
    ("float255.tif", lambda path, counts: tiff(path, counts.astype(np.float32)), 8, 255),
    ("a.exr", lambda path, counts: write_image(path, counts / np.float32(255)), 8, None),
    ("255.exr", lambda path, counts: write_image(path, counts.astype(np.float32)), 8, 255),
]


@pytest.mark.parametrize("response", [Response(), SRGB], ids=["linear", "srgb"])
@pytest.mark.parametrize(("name", "write", "bits", "white"), WAYS)
def test_one_picture_in_every_format_gives_the_same_light(
    scene, tmp_path, name, write, bits, white, response
):
    full = 2**bits - 1
    write(tmp_path / name, np.round(full * response.encode(scene)).astype(f"u{bits // 8}"))
    conversion = Conversion(response, black=0, white=white)
    import_frames(items([tmp_path / name], kind="background"), conversion, out=tmp_path / "m")
    measurement = load_measurement(tmp_path / "m")
    found = measurement.linear(measurement.frames[0])
    slope = response.decode(response.encode(scene) + 0.5 / full) - scene
    assert (np.abs(found - scene) <= 1.1 * slope + 1e-6).all()


class TestRange:
    @pytest.mark.faults
    @pytest.mark.parametrize(
        ("array", "said"),
        [
            (np.full((8, 8, 3), 186, dtype=np.float32), "186 (NPY, 3 channels of 32-bit floats)"),
            (np.full((8, 8), 300.0), "as --white 1023 (or 4095, 16383, 65535,"),
            (np.full((8, 8, 3), 70000, dtype=np.int64), "as --white V, where V is the value of a saturated"),
            (np.full((8, 8, 3), 1.7, dtype=np.float32), "as --white V, where V is the value of a saturated"),
            (np.linspace(-40, 86, 192).reshape(8, 8, 3), "must not be negative, they run from -40 to 86"),
            (np.linspace(-1, 1, 192, dtype=np.float32).reshape(8, 8, 3), "must not be negative"),
        ],
    )
    def test_it_is_said_and_asked_for(self, tmp_path, capsys, array, said):
        np.save(tmp_path / "a.npy", array)
        words = (tmp_path / "a.npy", "--kind", "background", "--out", tmp_path / "m")
        status, data, error = run(capsys, *words)
        assert status == 2
        assert said in data["error"]
        assert "a.npy: values" in error
        assert not (tmp_path / "m").exists()

    @pytest.mark.parametrize("kind", ["f4", "f8", "i2", "i8", "u4"])
    def test_a_stated_full_scale_counts(self, scene, tmp_path, capsys, kind):
        np.save(tmp_path / "a.npy", np.round(1023 * scene).astype(kind))
        words = (tmp_path / "a.npy", "--kind", "background", "--white", 1023, "--black", 0)
        status, data, _ = run(capsys, *words, "--out", tmp_path / "m")
        assert status == 0
        assert data["understood"][0]["full_scale"] == 1023
        measurement = load_measurement(tmp_path / "m")
        np.testing.assert_allclose(measurement.image(measurement.frames[0]), scene, atol=0.51 / 1023)

    def test_values_beyond_a_stated_one_and_below_zero_are_noted(self, scene, tmp_path, capsys):
        write_image(tmp_path / "a.png", np.round(4095 * scene).astype(np.uint16))
        write_image(tmp_path / "b.exr", (scene - 0.03).astype(np.float32))
        words = ("--kind", "background", "--response", "linear", "--out", tmp_path / "m")
        _, data, _ = run(capsys, tmp_path / "a.png", *words, "--white", 1023)
        assert any("a.png: values up to" in note and "full scale of 1023" in note for note in data["notes"])
        _, data, _ = run(capsys, tmp_path / "b.exr", *words)
        assert any("b.exr: values below zero, down to -0.01" in note for note in data["notes"])

    def test_bits_shifted_up_are_said(self, scene, tmp_path, capsys):
        write_image(tmp_path / "a.png", np.round(4095 * scene).astype(np.uint16) << 4)
        words = ("--kind", "background", "--response", "linear", "--out", tmp_path / "m")
        _, data, _ = run(capsys, tmp_path / "a.png", *words)
        assert data["understood"][0]["as"] == "PNG, 3 channels of 16 bits (in steps of 16)"


class TestUnderstood:
    def test_each_file_in_json_and_each_kind_in_text(self, scene, tmp_path, capsys):
        for name in ("a.png", "b.png", "c.png"):
            write_image(tmp_path / name, np.round(255 * scene).astype(np.uint8))
        np.save(tmp_path / "d.npy", scene.astype(np.float32))
        files = [tmp_path / name for name in ("a.png", "b.png", "c.png", "d.npy")]
        words = ["--kind", "background", "--response", "linear", "--out"]
        _, data, _ = run(capsys, *files, *words, tmp_path / "m")
        assert [entry["file"] for entry in data["understood"]] == [file.name for file in files]
        first = data["understood"][0]
        assert first["as"] == "PNG, 3 channels of 8 bits"
        assert (first["size"], first["unit"], first["full_scale"]) == ([COLUMNS, ROWS], "px", 255)
        assert first["range"] == [5, 129]
        assert cli.main(["import", *map(str, [*files, *words, tmp_path / "n"])]) == 0
        lines = [line for line in capsys.readouterr().out.splitlines() if "understood as" in line]
        assert lines == [
            "a.png and 2 more: understood as PNG, 3 channels of 8 bits, 40 x 30 px, values 5 to 129 of 255",
            "d.npy: understood as NPY, 3 channels of 32-bit floats, 40 x 30 px, values 0.02 to 0.5075 of 1",
        ]

    @pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif", "a.webp"])
    def test_a_turned_picture_is_noted_whatever_the_format(self, scene, tmp_path, capsys, name):
        exif = Image.Exif()
        exif[0x0112] = 6
        Image.fromarray(np.round(255 * to_srgb(scene)).astype(np.uint8)).save(tmp_path / name, exif=exif)
        words = ("--kind", "background", "--response", "srgb", "--out", tmp_path / "m")
        _, data, _ = run(capsys, tmp_path / name, *words)
        assert data["understood"][0]["orientation"] == 6
        assert data["understood"][0]["size"] == [COLUMNS, ROWS]
        assert any("EXIF orientation 6" in note and "as the sensor saw it" in note for note in data["notes"])

    def test_a_mosaic_without_its_pattern_is_noted(self, scene, tmp_path, capsys):
        mosaic = np.zeros((ROWS, COLUMNS))
        for place, colour in enumerate((0, 1, 1, 2)):
            mosaic[place // 2 :: 2, place % 2 :: 2] = scene[place // 2 :: 2, place % 2 :: 2, colour]
        np.save(tmp_path / "a.npy", np.round(4095 * mosaic).astype(np.uint16))
        words = (tmp_path / "a.npy", "--kind", "background", "--out", tmp_path / "m")
        _, data, _ = run(capsys, *words)
        assert any("Bayer mosaic" in note and "--bayer" in note for note in data["notes"])
        _, data, _ = run(capsys, *words[:-1], tmp_path / "n", "--bayer", "RGGB")
        assert not any("Bayer mosaic" in note for note in data["notes"])
        assert data["understood"][0]["as"] == "NPY, 1 channel of 16 bits, RGGB mosaic"

    def test_files_of_a_folder_are_found_by_their_names(self, scene, tmp_path, capsys):
        for name in ("a.webp", "b.bmp"):
            pillow(tmp_path / name, np.round(255 * scene).astype(np.uint8))
        words = ("--kind", "background", "--response", "srgb", "--out", tmp_path / "m")
        assert run(capsys, tmp_path, *words)[1]["files"] == ["a.exr", "b.exr"]

    def test_the_content_asks_for_the_response(self, scene, tmp_path, capsys):
        Image.fromarray(np.round(255 * scene).astype(np.uint8)).save(tmp_path / "a.exr", format="JPEG")
        status, data, _ = run(capsys, tmp_path / "a.exr", "--kind", "background", "--out", tmp_path / "m")
        assert (status, "--response: required for" in data["error"]) == (2, True)


def white_light(kind, rng):
    """Linear pictures as white LEDs behind a diffuser, or a monochrome camera, give them."""
    row, column = np.indices((120, 160)) / 160 - 0.4
    level = 0.4 * (1 - 0.3 * (row**2 + column**2))
    tint = {"white": (1, 1, 1), "warm": (1, 0.8, 0.45), "grey": (1, 1, 1), "one": (1,)}[kind]
    picture = level[..., None] * np.array(tint) * (1 + 0.02 * column[..., None] * np.arange(len(tint)))
    if kind == "grey":
        picture = np.repeat(picture[..., :1] + 0.004 * rng.standard_normal((120, 160, 1)), 3, axis=-1)
        return picture
    return picture + 0.004 * rng.standard_normal(picture.shape)


def coloured_light(rng, crosstalk=0.0):
    """Red, green and blue from three sides."""
    row, column = np.indices((120, 160)) / 160 - 0.4
    planes = [0.3 + 0.4 * column, 0.3 - 0.2 * column + 0.3 * row, 0.3 - 0.2 * column - 0.3 * row]
    picture = np.stack(planes, axis=-1) @ ((1 - 3 * crosstalk) * np.eye(3) + crosstalk)
    return picture + 0.004 * rng.standard_normal(picture.shape)


def measured(tmp_path, pictures, design=None):
    """Measurement of linear pictures of the untouched gel, by name, with the LED groups that were on."""
    (tmp_path / "design.toml").write_text(dumps(design or preset("gelsight-mini-like")), encoding="utf-8")
    lines = ['sensor = "design.toml"', 'response = "linear"']
    for number, (picture, leds) in enumerate(pictures):
        write_image(tmp_path / f"{number}.exr", np.maximum(picture, 0).astype(np.float32))
        lines += ["[[frame]]", f'file = "{number}.exr"', 'kind = "background"']
        lines += [] if leds is None else [f"leds = {list(leds)}"]
    (tmp_path / "measurement.toml").write_text("\n".join(lines).replace("'", '"'), encoding="utf-8")
    return load_measurement(tmp_path)


def named(measurement):
    return [each for each in check(measurement) if each.name == "colourless"]


@pytest.fixture
def sensor():
    """A sensor of coloured LEDs with a camera of the pictures' proportion."""
    design = preset("gelsight-mini-like")
    return design.replace({"camera.width_px": 160, "camera.height_px": 120})


class TestColour:
    @pytest.mark.parametrize("kind", ["white", "warm", "grey", "one"])
    def test_a_picture_without_colour_is_said_and_stops_the_fit(self, tmp_path, capsys, sensor, kind):
        picture = white_light(kind, np.random.default_rng(3))
        write_image(tmp_path / "a.png", picture if kind != "one" else picture[..., 0], bits=16)
        words = ("--kind", "background", "--response", "linear", "--out", tmp_path / "m")
        _, data, _ = run(capsys, tmp_path / "a.png", *words)
        assert any("this picture has no colour: " in note for note in data["notes"])
        (found,) = named(measured(tmp_path, [(picture, None)], sensor))
        assert found.strong
        assert "red, green, blue" in found.cause

    @pytest.mark.parametrize("crosstalk", [0.0, 0.1, 0.2])
    def test_coloured_light_passes(self, tmp_path, capsys, sensor, crosstalk):
        picture = coloured_light(np.random.default_rng(4), crosstalk)
        write_image(tmp_path / "a.png", picture, bits=16)
        words = ("--kind", "background", "--response", "linear", "--out", tmp_path / "m")
        _, data, _ = run(capsys, tmp_path / "a.png", *words)
        assert not any("no colour" in note for note in data["notes"])
        assert named(measured(tmp_path, [(picture, None)], sensor)) == []

    def test_one_group_alone_or_white_leds_are_colourless_by_design(self, tmp_path, sensor):
        picture = white_light("white", np.random.default_rng(5))
        one = [(picture[..., :1], ("red",)), (picture[..., 1:2], ("green",))]
        assert named(measured(tmp_path, one, sensor)) == []
        white = sensor.replace({"mixing": [[1.0, 1.0, 1.0]] * 3})
        assert named(measured(tmp_path, [(picture, None)], white)) == []

    def test_packages_of_three_colours_all_around_are_white_together(self, tmp_path, sensor):
        groups = [group.model_copy(update={"azimuth_deg": (90, 210, 330)}) for group in sensor.leds.groups]
        around = sensor.model_copy(update={"leds": sensor.leds.model_copy(update={"groups": tuple(groups)})})
        measurement = measured(tmp_path, [(white_light("white", np.random.default_rng(6)), None)], sensor)
        assert [each for each in check(measurement, around) if each.name == "colourless"] == []

    def test_a_frame_saved_in_grey_among_coloured_ones_is_named(self, tmp_path, sensor):
        rng = np.random.default_rng(7)
        coloured = coloured_light(rng)
        grey = np.repeat(coloured.mean(axis=-1, keepdims=True), 3, axis=-1)
        (found,) = named(measured(tmp_path, [(coloured, None), (grey, None)], sensor))
        assert found.files == ("1.exr",)
        assert found.evidence == "no colour: its three channels are equal"

    @pytest.mark.slow  # loads the commands
    @pytest.mark.faults
    @pytest.mark.parametrize("command", ["calibrate", "gap"])
    @pytest.mark.parametrize("kind", ["white", "one"])
    def test_commands_refuse_it(self, tmp_path, capsys, sensor, command, kind):
        measured(tmp_path, [(white_light(kind, np.random.default_rng(8)), None)], sensor)
        words = [command, *(["diagnose"] if command == "gap" else []), str(tmp_path)]
        words += ["--model", str(tmp_path / "design.toml"), "--out", str(tmp_path / "out")]
        assert cli.main(words) == 2
        error = capsys.readouterr().err
        assert "colourless: 0.exr: no colour: " in error
        assert "--trust colourless" in error
