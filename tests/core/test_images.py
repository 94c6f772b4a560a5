import numpy as np
import pytest
from PIL import Image as Pillow

from designlab.core.images import (
    ImageError,
    from_srgb,
    read_image,
    resize_area,
    to_srgb,
    tone_map,
    write_image,
)

RANDOM = np.random.default_rng(3)


@pytest.mark.parametrize("suffix", [".exr", ".tif", ".tiff"])
@pytest.mark.parametrize("channels", [1, 3])
def test_float_files_return_the_same_floats(tmp_path, suffix, channels):
    array = RANDOM.normal(size=(13, 9, channels)).astype(np.float32) * 100
    write_image(tmp_path / f"a{suffix}", array)
    read = read_image(tmp_path / f"a{suffix}")
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read, array)


def test_half_floats_are_stored_as_half_floats(tmp_path):
    import OpenEXR

    array = RANDOM.random((6, 5, 3)).astype(np.float16)
    write_image(tmp_path / "a.exr", array)
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        assert file.channels()["G"].pixels.dtype == np.float16
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), array.astype(np.float32))


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 3])
def test_counts_are_read_as_a_share_of_full_scale(tmp_path, suffix, dtype, channels):
    full = np.iinfo(dtype).max
    counts = RANDOM.integers(0, full + 1, size=(8, 11, channels)).astype(dtype)
    counts.flat[:2] = 0, full
    write_image(tmp_path / f"a{suffix}", counts)
    read = read_image(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(np.round(read.astype(float) * full), counts)
    assert read.min() == 0
    assert read.max() == 1


def test_another_program_sees_the_same_8_bit_png(tmp_path):
    counts = RANDOM.integers(0, 256, size=(8, 11, 3)).astype(np.uint8)
    write_image(tmp_path / "a.png", counts)
    np.testing.assert_array_equal(np.asarray(Pillow.open(tmp_path / "a.png")), counts)


@pytest.mark.parametrize("bits", [8, 16])
def test_floats_in_a_png_are_rounded_to_half_a_step(tmp_path, bits):
    array = RANDOM.random((7, 6, 3))
    write_image(tmp_path / "a.png", array, bits=bits)
    error = np.abs(read_image(tmp_path / "a.png") - array).max()
    assert 0 < error <= 0.5 / (2**bits - 1) + 1e-7


def test_row_0_is_the_top_of_the_picture(tmp_path):
    picture = np.zeros((4, 3, 3), dtype=np.uint8)
    picture[0, 2] = 255, 128, 0
    Pillow.fromarray(picture).save(tmp_path / "a.png")
    read = read_image(tmp_path / "a.png")
    np.testing.assert_allclose(read[0, 2], [1, 128 / 255, 0], atol=1e-7)
    assert read.sum() == pytest.approx(1 + 128 / 255)


def test_palette_and_opaque_alpha_are_accepted_and_transparency_is_not(tmp_path):
    colours = RANDOM.integers(0, 2, size=(5, 5, 3)).astype(np.uint8) * 255
    picture = Pillow.fromarray(colours)
    picture.quantize(8).save(tmp_path / "palette.png")
    picture.convert("RGBA").save(tmp_path / "opaque.png")
    for name in ("palette.png", "opaque.png"):
        np.testing.assert_allclose(read_image(tmp_path / name), colours / 255)
    picture.putalpha(40)
    picture.save(tmp_path / "clear.png")
    with pytest.raises(ImageError, match=r"clear\.png: must be opaque"):
        read_image(tmp_path / "clear.png")


def test_the_content_and_not_the_name_tells_the_format(tmp_path):
    array = RANDOM.random((4, 4, 3)).astype(np.float32)
    write_image(tmp_path / "a.exr", array)
    (tmp_path / "a.exr").rename(tmp_path / "a.png")
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), array)


def test_a_file_that_is_no_image_is_refused(tmp_path):
    (tmp_path / "notes.png").write_text("not an image")
    with pytest.raises(
        ImageError, match=r"notes\.png: must be an EXR, PNG or TIFF image, its first bytes are 6e 6f"
    ):
        read_image(tmp_path / "notes.png")
    (tmp_path / "empty.exr").touch()
    with pytest.raises(ImageError, match=r"empty\.exr: .* its first bytes are missing"):
        read_image(tmp_path / "empty.exr")
    with pytest.raises(ImageError, match=r"absent\.exr: no such file"):
        read_image(tmp_path / "absent.exr")
    with pytest.raises(ImageError, match="no such file"):
        read_image(tmp_path)


@pytest.mark.parametrize("name", ["a.exr", "a.png", "a.tif", "b.png"])
def test_a_damaged_file_is_refused(tmp_path, name):
    array = RANDOM.random((40, 40, 3)).astype(np.float32)
    write_image(tmp_path / name, array, bits=16 if name == "b.png" else 8)
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(content[: len(content) // 2])
    with pytest.raises(ImageError, match=rf"{name}: the file is damaged"):
        read_image(tmp_path / name)


def test_other_exr_channels_are_named(tmp_path):
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    plane = np.zeros((3, 3), dtype=np.float32)
    with OpenEXR.File(header, {"Z": plane, "U": plane}) as file:
        file.write(str(tmp_path / "depth.exr"))
    with pytest.raises(ImageError, match=r"depth\.exr: channels must be R, G, B or Y, got U, Z"):
        read_image(tmp_path / "depth.exr")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_located(tmp_path, value):
    array = np.ones((5, 6, 3), dtype=np.float32)
    array[3, 4, 1] = value
    with pytest.raises(
        ImageError, match=r"a\.exr: values must be finite, 1 are not, .* at row 3, column 4, channel 1"
    ):
        write_image(tmp_path / "a.exr", array)
    import tifffile

    tifffile.imwrite(tmp_path / "a.tif", array, photometric="rgb")
    with pytest.raises(ImageError, match=r"a\.tif: values must be finite, 1 are not"):
        read_image(tmp_path / "a.tif")


def test_two_pages_are_refused(tmp_path):
    import tifffile

    tifffile.imwrite(tmp_path / "a.tif", np.zeros((2, 8, 8), dtype=np.uint8), photometric="minisblack")
    with pytest.raises(ImageError, match="must hold one page, got 2"):
        read_image(tmp_path / "a.tif")


def test_what_a_file_cannot_hold_is_refused_and_leaves_nothing(tmp_path):
    good = np.zeros((4, 4, 3))
    with pytest.raises(ImageError, match=r"suffix must be one of .*, got '\.jpg'"):
        write_image(tmp_path / "a.jpg", good)
    with pytest.raises(ImageError, match=r"got 0\.\.1\.5; scale or clip"):
        write_image(tmp_path / "a.png", np.where(np.eye(4)[..., None], 1.5, good))
    with pytest.raises(ImageError, match="must have 1 or 3 channels, got 5"):
        write_image(tmp_path / "a.png", np.zeros((4, 4, 5)))
    with pytest.raises(ImageError, match="unsigned integers or floats, got int64"):
        write_image(tmp_path / "a.exr", np.zeros((4, 4, 3), dtype=np.int64))
    with pytest.raises(FileNotFoundError, match="no such folder"):
        write_image(tmp_path / "missing" / "a.png", good)
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_keeps_the_old_file(tmp_path, monkeypatch):
    target = tmp_path / "a.png"
    write_image(target, np.zeros((4, 4, 3)))
    before = target.read_bytes()
    monkeypatch.setattr("png.Writer.write", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        write_image(target, np.ones((4, 4, 3)))
    assert target.read_bytes() == before
    assert list(tmp_path.iterdir()) == [target]


def test_srgb_at_published_points():
    # IEC 61966-2-1: the two branches meet at 0.0031308 -> 0.04045; middle grey 0.214041 -> 0.5
    np.testing.assert_allclose(
        to_srgb([0.0, 0.0031308, 0.21404114, 1.0]), [0.0, 0.0404500, 0.5, 1.0], atol=2e-6
    )
    values = np.linspace(-0.2, 1.5, 1001)
    # the published constants leave a step of 3e-8 between the branches
    np.testing.assert_allclose(from_srgb(to_srgb(values)), values, atol=1e-7)


def test_tone_map_sends_white_to_255_and_black_to_0():
    np.testing.assert_array_equal(tone_map(np.array([0.0, 1.0, 2.0, 9.0]), white=2.0), [0, 188, 255, 255])
    assert tone_map(np.linspace(0, 7, 100)).max() == 255
    assert tone_map(np.zeros((2, 2))).max() == 0
    with pytest.raises(ImageError, match="white: must be positive, got -1"):
        tone_map(np.ones(3), white=-1.0)


def test_area_binning_by_whole_blocks_is_the_block_mean():
    image = RANDOM.random((12, 20, 3))
    expected = image.reshape(4, 3, 5, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(resize_area(image, 4, 5), expected, atol=1e-12)


def test_area_binning_splits_pixels_exactly():
    # three pixels into two: each new one takes a whole pixel and half the middle one
    np.testing.assert_allclose(resize_area(np.array([[1.0, 4.0, 7.0]]), 1, 2), [[2.0, 6.0]])
    image = RANDOM.random((13, 17)).astype(np.float32)
    binned = resize_area(image, 7, 5)
    assert binned.shape == (7, 5)
    assert binned.dtype == np.float32
    assert binned.mean() == pytest.approx(image.mean(), rel=1e-6)
    with pytest.raises(ImageError, match="at least 1, got 0 x 5"):
        resize_area(image, 0, 5)


@pytest.mark.measured
def test_the_published_half_float_picture_is_read(measured_dir):
    picture = read_image(measured_dir / "gelsight-flat" / "tri0u.exr")
    assert picture.shape == (600, 600, 3)
    # every value is a half float, so nothing was rescaled
    np.testing.assert_array_equal(picture, picture.astype(np.float16))
    assert 0 < picture.min() < picture.max() < 1
