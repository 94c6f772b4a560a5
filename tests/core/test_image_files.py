"""Picture files as they are stored: formats, alpha, orientation, palettes, and what is refused by name."""

import io
import sys

import numpy as np
import pytest
import tifffile
from PIL import Image as Pillow

from designlab.core.image_files import ImageError, format_of, read_stored
from designlab.core.images import read_image

ROWS, COLUMNS = 24, 33


@pytest.fixture
def colours():
    """A smooth picture of 8 bits with noise, none of its sides alike."""
    row, column = np.indices((ROWS, COLUMNS))
    planes = np.stack([60 + 3 * column, 190 - 4 * column, 40 + 5 * row], axis=-1)
    return (planes + np.random.default_rng(2).integers(-8, 8, planes.shape)).astype(np.uint8)


def saved(path, pixels, **options):
    Pillow.fromarray(pixels).save(path, **options)
    return path


def turned(number):
    exif = Pillow.Exif()
    exif[0x0112] = number
    return exif


class TestCompression:
    @pytest.mark.parametrize(
        "compression", ["raw", "tiff_lzw", "packbits", "tiff_adobe_deflate", "tiff_deflate", "zstd", "lzma"]
    )
    def test_compressed_tiff_of_8_bits(self, colours, tmp_path, compression):
        for name, pixels in (("colour", colours), ("grey", colours[..., 0])):
            file = saved(tmp_path / f"{name}.tif", pixels, compression=compression)
            found = read_stored(file)
            assert (found.format, found.full_scale, found.depth) == ("TIFF", 255.0, "8 bits")
            np.testing.assert_array_equal(found.values.squeeze(), pixels)

    @pytest.mark.parametrize(("kind", "full"), [(np.uint16, 65535.0), (np.float32, None)])
    @pytest.mark.parametrize("channels", [1, 3])
    def test_lzw_of_more_bits(self, colours, tmp_path, kind, full, channels):
        cv2 = pytest.importorskip("cv2")
        pixels = (colours[..., :channels] * 37 + 5).astype(kind)
        cv2.imwrite(str(tmp_path / "a.tif"), pixels[..., ::-1], [cv2.IMWRITE_TIFF_COMPRESSION, 5])
        found = read_stored(tmp_path / "a.tif")
        assert found.full_scale == full
        np.testing.assert_array_equal(found.values, pixels)

    @pytest.mark.faults
    def test_without_opencv_it_is_said_what_to_do(self, colours, tmp_path, monkeypatch):
        cv2 = pytest.importorskip("cv2")
        cv2.imwrite(str(tmp_path / "a.tif"), colours.astype(np.uint16), [cv2.IMWRITE_TIFF_COMPRESSION, 5])
        monkeypatch.setitem(sys.modules, "cv2", None)
        with pytest.raises(ImageError, match=r"a\.tif: compressed by LZW with 16 bits .* pip install opencv"):
            read_stored(tmp_path / "a.tif")


class TestAlpha:
    @pytest.mark.parametrize("name", ["a.png", "a.tif"])
    def test_an_opaque_one_is_left_out_with_a_note(self, colours, tmp_path, name):
        Pillow.fromarray(colours).convert("RGBA").save(tmp_path / name)
        found = read_stored(tmp_path / name)
        np.testing.assert_array_equal(found.values, colours)
        assert found.notes == ("its alpha channel is opaque and left out",)

    def test_grey_and_alpha_and_arrays(self, colours, tmp_path):
        grey = colours[..., 0]
        saved(tmp_path / "la.png", np.dstack([grey, np.full_like(grey, 255)]))
        np.save(tmp_path / "a.npy", np.dstack([colours / 255, np.ones((ROWS, COLUMNS))]))
        np.testing.assert_array_equal(read_stored(tmp_path / "la.png").values[..., 0], grey)
        np.testing.assert_array_equal(read_stored(tmp_path / "a.npy").values, colours / 255)

    @pytest.mark.faults
    @pytest.mark.parametrize("name", ["mask.png", "mask.tif", "mask.webp", "mask.npy"])
    def test_a_mask_is_refused_with_the_fix(self, colours, tmp_path, name):
        row, column = np.indices((ROWS, COLUMNS))
        inside = (row - ROWS / 2) ** 2 + (column - COLUMNS / 2) ** 2 < 100
        pixels = np.dstack([colours, (255 * inside).astype(np.uint8)])
        if name.endswith("npy"):
            np.save(tmp_path / name, pixels)
        else:
            saved(tmp_path / name, pixels, **({"lossless": True} if name.endswith("webp") else {}))
        with pytest.raises(ImageError, match=rf"{name}: must be opaque.*% of the pixels.*without alpha"):
            read_stored(tmp_path / name)


class TestOrientation:
    @pytest.mark.parametrize("number", [2, 3, 6, 8])
    @pytest.mark.parametrize(
        ("name", "options"),
        [
            ("a.jpg", {"quality": 100, "subsampling": 0}),
            ("a.png", {}),
            ("a.webp", {"lossless": True}),
            ("a.tif", {}),
            ("lzw.tif", {"compression": "tiff_lzw"}),
        ],
    )
    def test_it_is_told_and_not_applied(self, colours, tmp_path, name, options, number):
        file = saved(tmp_path / name, colours, exif=turned(number), **options)
        found = read_stored(file)
        assert found.orientation == number
        assert found.values.shape == (ROWS, COLUMNS, 3)
        np.testing.assert_allclose(found.values, colours, atol=4 if name == "a.jpg" else 0)

    def test_of_a_png_of_16_bits(self, colours, tmp_path):
        file = saved(tmp_path / "a.png", colours[..., 0].astype(np.uint16) * 200, exif=turned(6))
        assert read_stored(file).orientation == 6
        assert read_stored(file).full_scale == 65535

    def test_nonsense_counts_as_upright(self, colours, tmp_path):
        assert read_stored(saved(tmp_path / "a.png", colours, exif=turned(77))).orientation == 1


class TestArrays:
    @pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32, np.float64, ">u2", ">f4"])
    def test_channels_that_stand_first_are_moved(self, colours, tmp_path, kind):
        np.save(tmp_path / "a.npy", np.moveaxis(colours, -1, 0).astype(kind))
        found = read_stored(tmp_path / "a.npy")
        np.testing.assert_array_equal(found.values, colours)
        assert "its channels stand first (3, 24, 33)" in found.notes[0]

    def test_a_single_plane(self, colours, tmp_path):
        for shape in ((ROWS, COLUMNS), (1, ROWS, COLUMNS), (ROWS, COLUMNS, 1)):
            np.save(tmp_path / "a.npy", colours[..., 0].reshape(shape))
            np.testing.assert_array_equal(read_stored(tmp_path / "a.npy").values, colours[..., :1])

    @pytest.mark.parametrize("kind", [np.int16, np.int64, np.uint32, np.float32])
    def test_types_that_tell_no_full_scale(self, colours, tmp_path, kind):
        np.save(tmp_path / "a.npy", colours.astype(kind))
        assert read_stored(tmp_path / "a.npy").full_scale is None

    @pytest.mark.faults
    @pytest.mark.parametrize(
        ("array", "said"),
        [
            (np.zeros((5, 9, 8, 3)), r"got shape \(5, 9, 8, 3\): a stack of 5 pictures"),
            (np.zeros((9, 8, 7)), "a stack of pictures"),
            (np.zeros(7), r"got shape \(7,\)"),
            (np.zeros((0, 4)), "got shape"),
            (np.zeros((4, 4), dtype=bool), "integers or floats, got bool"),
            (np.zeros((4, 4), dtype=complex), "got complex128"),
            (np.array([[1, "a"]], dtype=object), "damaged or of an unsupported kind"),
        ],
    )
    def test_what_is_no_picture_is_refused(self, tmp_path, array, said):
        np.save(tmp_path / "a.npy", array)
        with pytest.raises(ImageError, match=rf"a\.npy: .*{said}"):
            read_stored(tmp_path / "a.npy")


class TestNetpbm:
    @pytest.mark.parametrize(("white", "order"), [(255, ">u1"), (1023, ">u2"), (4095, ">u2"), (4095, "<u2")])
    def test_full_scale_is_the_files_own(self, colours, tmp_path, white, order):
        counts = (colours[..., 0].astype(int) * white // 255).astype(order)
        header = f"P5\n# from a camera\n{COLUMNS} {ROWS}\n{white}\n".encode()
        (tmp_path / "a.pgm").write_bytes(header + counts.tobytes())
        found = read_stored(tmp_path / "a.pgm")
        np.testing.assert_array_equal(found.values[..., 0], counts.astype(int))
        assert found.full_scale == white
        assert bool(found.notes) == (order == "<u2")

    def test_numbers_as_text(self, colours, tmp_path):
        numbers = " ".join(str(value) for value in colours.ravel())
        (tmp_path / "a.ppm").write_text(f"P3\n{COLUMNS} {ROWS} # size\n255\n{numbers}\n", encoding="ascii")
        np.testing.assert_array_equal(read_stored(tmp_path / "a.ppm").values, colours)

    @pytest.mark.faults
    @pytest.mark.parametrize(
        ("content", "said"),
        [
            (b"P5 4 4 255\n\0\0", "ends before its 4 x 4 pixels"),
            (b"P2 2 2 255\n1 2 3", "ends before its 2 x 2 pixels"),
            (b"P2 2 1 99\n1 100", "within 0 and 99, got 1 to 100"),
            (b"P5 2 1 9\n\0\x0a", "must not exceed 9"),
            (b"P5 0 4 255\n", "header"),
            (b"P5 4 x", "header"),
            (b"P5 99999 99999 255\n", "at most 150000000 pixels"),
        ],
    )
    def test_damaged_ones(self, tmp_path, content, said):
        (tmp_path / "a.pgm").write_bytes(content)
        with pytest.raises(ImageError, match=rf"a\.pgm: .*{said}"):
            read_stored(tmp_path / "a.pgm")


class TestTiff:
    def test_palette_white_at_zero_and_planes(self, colours, tmp_path):
        few = colours // 64 * 64
        Pillow.fromarray(few).quantize(64).save(tmp_path / "palette.tif")
        found = read_stored(tmp_path / "palette.tif")
        assert "palette" in found.notes[0]
        assert np.abs(found.values.astype(int) - few).mean() < 4
        tifffile.imwrite(tmp_path / "white.tif", 255 - colours[..., 0], photometric="miniswhite")
        np.testing.assert_array_equal(read_stored(tmp_path / "white.tif").values, colours[..., :1])
        planes = np.moveaxis(colours, -1, 0)
        tifffile.imwrite(tmp_path / "p.tif", planes, photometric="rgb", planarconfig="separate")
        np.testing.assert_array_equal(read_stored(tmp_path / "p.tif").values, colours)

    @pytest.mark.faults
    @pytest.mark.parametrize(
        ("mode", "name", "said"),
        [
            ("CMYK", "a.tif", "CMYK"),
            ("CMYK", "lzw.tif", "CMYK"),
            ("CMYK", "a.jpg", "CMYK"),
            ("LAB", "a.tif", "CIE Lab"),
        ],
    )
    def test_other_colours_are_refused_by_name(self, colours, tmp_path, mode, name, said):
        more = {"compression": "tiff_lzw"} if name == "lzw.tif" else {}
        Pillow.fromarray(colours).convert("RGB").convert(mode).save(
            tmp_path / name, **more
        ) if mode == "CMYK" else Pillow.new("LAB", (COLUMNS, ROWS)).save(tmp_path / name)
        with pytest.raises(ImageError, match=rf"{name}: its colours are {said}"):
            read_stored(tmp_path / name)

    def test_a_preview_beside_the_picture_is_passed_over(self, colours, tmp_path):
        with tifffile.TiffWriter(tmp_path / "a.tif") as file:
            file.write(colours, photometric="rgb")
            file.write(np.ascontiguousarray(colours[::4, ::4]), photometric="rgb", subfiletype=1)
        np.testing.assert_array_equal(read_stored(tmp_path / "a.tif").values, colours)


@pytest.mark.parametrize(
    ("written", "name"),
    [("PNG", "a.jpg"), ("JPEG", "b.png"), ("TIFF", "c.png"), ("WebP", "d.tif"), ("BMP", "e.jpg")],
)
def test_the_content_tells_the_format_and_a_wrong_name_is_noted(colours, tmp_path, written, name):
    Pillow.fromarray(colours).save(tmp_path / name, format=written)
    assert format_of(tmp_path / name) == written
    assert f"named {name[1:]}, but it is {written} and read so" in read_stored(tmp_path / name).notes


@pytest.mark.faults
@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\0\0\0\x18ftypheic" + bytes(20), "is a HEIC or AVIF picture"),
        (b"\0\0\0\x18ftypisom" + bytes(20), "is a video"),
        (b"GIF89a" + bytes(20), "is a GIF"),
        (b"PK\x03\x04" + bytes(20), "numpy.save"),
        (b"%PDF-1.7", "is a PDF"),
        (b"hello world", "its first bytes are 68 65"),
    ],
)
def test_other_files_are_named(tmp_path, content, said):
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(ImageError, match=rf"a\.png: must be an EXR, PNG, TIFF.*{said}"):
        read_stored(tmp_path / "a.png")


@pytest.mark.faults
def test_a_jpeg_among_measured_frames_is_sent_to_the_import(colours, tmp_path):
    saved(tmp_path / "a.png", colours, format="JPEG")
    with pytest.raises(ImageError, match="is JPEG; convert it with `designlab import`"):
        read_image(tmp_path / "a.png")


@pytest.mark.faults
def test_several_pictures_in_a_file_are_refused(colours, tmp_path):
    pictures = [Pillow.fromarray(colours), Pillow.fromarray(colours[::-1])]
    pictures[0].save(tmp_path / "a.webp", save_all=True, append_images=pictures[1:], lossless=True)
    tifffile.imwrite(tmp_path / "a.tif", np.moveaxis(colours, -1, 0), photometric="minisblack")
    for name in ("a.webp", "a.tif"):
        with pytest.raises(
            ImageError, match=rf"{name}: must hold one (picture|page), got .*one picture a file"
        ):
            read_stored(tmp_path / name)


def valid_files():
    """One small valid file of each kind, as bytes."""
    colours = (np.random.default_rng(5).random((9, 11, 3)) * 255).astype(np.uint8)
    files = {}

    def keep(name, kind, pixels, **options):
        stream = io.BytesIO()
        Pillow.fromarray(pixels).save(stream, kind, **options)
        files[name] = stream.getvalue()

    keep("a.png", "PNG", colours)
    keep("16.png", "PNG", colours[..., 0].astype(np.uint16) * 250)
    keep("a.jpg", "JPEG", colours, exif=turned(6))
    keep("a.webp", "WEBP", colours, lossless=True)
    keep("a.bmp", "BMP", colours)
    keep("a.tif", "TIFF", colours)
    keep("lzw.tif", "TIFF", colours, compression="tiff_lzw")
    stream = io.BytesIO()
    np.save(stream, colours)
    files["a.npy"] = stream.getvalue()
    files["a.pgm"] = b"P5 11 9 4095\n" + (colours[..., 0].astype(">u2") * 16).tobytes()
    files["a.ppm"] = b"P3 11 9 255\n" + b" ".join(b"%d" % value for value in colours.ravel())
    return files


@pytest.mark.faults
@pytest.mark.parametrize("name", [*valid_files(), "a.exr"])
def test_damaged_bytes_give_a_picture_or_a_clear_error(tmp_path, name):
    """Up to four bytes changed, or the end cut off, 100 times."""
    if name == "a.exr":
        from designlab.core.images import write_image

        write_image(tmp_path / name, np.random.default_rng(1).random((9, 11, 3)).astype(np.float32))
        content = (tmp_path / name).read_bytes()
    else:
        content = valid_files()[name]
    rng = np.random.default_rng(sum(name.encode()))
    file = tmp_path / f"x{name}"
    for _ in range(100):
        changed = bytearray(content)
        reach = len(content) if rng.random() < 0.5 else min(64, len(content))
        for place in rng.integers(0, reach, rng.integers(1, 5)):
            changed[place] = rng.integers(256)
        if rng.random() < 0.2:
            del changed[rng.integers(len(changed)) :]
        file.write_bytes(bytes(changed))
        said = None
        try:
            values = read_stored(file).values
        except ImageError as error:
            said = str(error)
        if said is None:
            assert (values.ndim, values.shape[-1]) in ((3, 1), (3, 3))
            assert values.dtype.kind in "uif"
        else:
            assert said.startswith(str(file))
            assert "\n" not in said
