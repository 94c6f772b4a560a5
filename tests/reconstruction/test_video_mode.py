"""Mode video against mode accurate, on made presses whose surface is known."""

import resource

import numpy as np
import pytest

from designlab.core.metrics import normal_error_deg
from designlab.reconstruction import video
from designlab.reconstruction.calibration_file import load_calibration
from designlab.reconstruction.colour_table import OUTPUTS, ColourTable
from designlab.reconstruction.height import READ_SHARE, blended, gradients_of, integrate, normals
from designlab.reconstruction.markers import FILLED, Markers
from designlab.reconstruction.reconstructor import Reconstructor
from tests.helpers.ball_pictures import UNTOUCHED, coin, exposed, pressed, pressed_twice
from tests.reconstruction.test_lab import PITCH_MM, RADIUS_MM, SHAPE, SURFACE, picture, slopes

BOTH = ("accurate", "video")


@pytest.fixture(scope="module")
def both(calibration_file):
    return {mode: Reconstructor.load(calibration_file, mode=mode) for mode in BOTH}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("centre", "contact_px"), [((55, 45), 12.0), ((80, 70), 10.0), ((40, 80), 14.0), ((100, 40), 8.0)]
)
def test_a_frame_is_nearly_as_good_as_a_picture(both, centre, contact_px):
    p, q, r_px = slopes(centre, contact_px)
    near = r_px < 1.5 * contact_px
    truth_mm = integrate(p, q, pitch_mm=PITCH_MM, boundary="dirichlet")
    angle, off_mm, force = {}, {}, {}
    for mode, reconstructor in both.items():
        shape = reconstructor(exposed(picture(p, q, noise=0.01)))
        angle[mode] = normal_error_deg(shape.normals.astype(float), normals(p, q))[near].mean()
        off_mm[mode] = np.sqrt(((shape.height_mm - truth_mm)[near] ** 2).mean())
        force[mode] = shape.force_n(1.0)
        touched = r_px < contact_px
        assert (shape.contact & touched).sum() > 0.55 * (shape.contact | touched).sum()
        assert shape.warnings == ()
    assert angle["video"] < 1.15 * angle["accurate"] + 0.05
    assert off_mm["video"] < 1.15 * off_mm["accurate"] + 0.001
    assert force["video"] == pytest.approx(force["accurate"], rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("mode", BOTH)
@pytest.mark.parametrize(
    ("first", "second"),
    [
        (((40, 40), 9.0), ((100, 80), 9.0)),
        (((35, 60), 11.0), ((105, 60), 8.0)),
        (((40, 90), 7.0), ((95, 30), 10.0)),
    ],
)
def test_two_contacts_are_two(both, mode, first, second):
    shape = both[mode](pressed_twice(first, second))
    # a Gaussian mean of the cap of a ball is lower by the square of its standard deviation over the radius
    blur_mm = both[mode].calibration.setup.smoothing_px * PITCH_MM
    for (column, row), radius_px in (first, second):
        assert shape.contact[row, column]
        expected = SURFACE.depth_mm(radius_px * PITCH_MM) - blur_mm**2 / RADIUS_MM
        assert shape.height_mm[row, column] == pytest.approx(expected, rel=0.06)
    between = tuple(np.mean([first[0], second[0]], axis=0).astype(int))
    assert not shape.contact[between[1], between[0]]


@pytest.mark.slow
def test_the_untouched_gel_is_flat_and_nothing_touches_it(both):
    shape = both["video"](UNTOUCHED)
    assert np.abs(shape.height_mm).max() < 1e-6
    assert not shape.contact.any()
    assert any("nothing touches" in text for text in shape.warnings)


@pytest.mark.slow
def test_another_background_keeps_the_table(both):
    lamp = np.array([1.0, 0.9, 1.05], dtype=np.float32)
    on = both["video"].on(UNTOUCHED * lamp)
    assert on.video.table is both["video"].video.table
    usual, today = both["video"](pressed()), on(pressed() * lamp)
    assert today.depth_mm == pytest.approx(usual.depth_mm, rel=0.02)


@pytest.mark.slow
@pytest.mark.faults
def test_what_mode_video_cannot_do_is_said(calibration_file, both):
    with pytest.raises(ValueError, match="mode: must be accurate or video, got 'fast'"):
        Reconstructor.load(calibration_file, mode="fast")
    with pytest.raises(ValueError, match="mask: mode video takes none"):
        both["video"](pressed(), mask=np.ones(SHAPE, dtype=bool))
    with pytest.raises(ValueError, match="must be 140 x 120 pixels of 3 channels"):
        both["video"](pressed()[..., :1])
    with pytest.raises(ValueError, match="needs pictures of 3 colours, got 1"):
        ColourTable.of(lambda colour, place: np.zeros((len(colour), OUTPUTS)), np.zeros((4, 1)))


@pytest.mark.parametrize(
    ("gain", "bend", "worst"),
    [((1.0, -2.0, 0.5), 0.0, 1e-5), ((0.3, 1.0, 1.0), 0.2, 0.004), ((2.0, 0, 1), 0.5, 0.01)],
)
def test_a_table_gives_back_what_it_was_made_of(gain, bend, worst):
    """Linear maps exactly; curved ones right on average, and exactly where nothing changes."""

    def outputs(colour, place):
        straight = colour @ np.array(gain) * (1 + 0.2 * place[0] - 0.1 * place[1])
        return np.repeat((straight + bend * (1 - np.cos(colour[:, 0])))[:, None], OUTPUTS, axis=1)

    random = np.random.default_rng(3)
    table = ColourTable.of(outputs, random.uniform(-2, 2, size=(200, 3)))
    change = random.uniform(-1.8, 1.8, size=(30, 40, 3)).astype(np.float32)
    change[4, 5] = 0
    found = table(change)
    y, x = np.meshgrid(np.linspace(1, -1, 30), np.linspace(-1, 1, 40), indexing="ij")
    truth = np.array(
        [
            [outputs(change[i, j][None].astype(float), (x[i, j], y[i, j]))[0] for j in range(40)]
            for i in range(30)
        ]
    )
    assert np.abs(found - truth).max() < max(worst, 2e-5)
    assert np.abs((found - truth).mean()) < worst / 10 + 1e-6
    assert (found[4, 5] == 0).all()


@pytest.mark.slow
@pytest.mark.full
def test_a_thousand_frames_take_no_memory(both):
    frames = [pressed((40 + at, 60), 8.0 + at / 10).astype(np.float32) for at in range(40)]
    held_mb = []
    for number in range(1000):
        both["video"](frames[number % len(frames)])
        if number in (100, 999):
            held_mb.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    assert held_mb[1] - held_mb[0] < 5


@pytest.mark.slow
def test_a_coin_has_its_relief_in_both_modes(both):
    p, q = coin(SHAPE)
    image = exposed(picture(p, q))
    heights = [both[mode](image, pressure=False).height_mm for mode in BOTH]
    assert np.corrcoef(heights[0].ravel(), heights[1].ravel())[0, 1] > 0.99


@pytest.mark.slow
@pytest.mark.parametrize(("centre", "contact_px"), [((55, 45), 12.0), ((80, 70), 10.0), ((40, 80), 14.0)])
def test_markers_are_followed_and_left_out_of_a_frame(calibration_file, centre, contact_px):
    rows, columns = np.indices(SHAPE)

    def dotted(image, moved_px=0.0):
        r = np.hypot((columns - moved_px + 8) % 16 - 8, (rows + 8) % 16 - 8)
        return (image * (1 - 0.85 * np.clip(4.0 - r, 0, 1))[..., None]).astype(np.float32)

    kept = load_calibration(calibration_file)
    markers = Markers.found_in(dotted(UNTOUCHED))
    assert markers is not None
    kept = kept._replace(about={**kept.about, "markers": markers.plain()})
    p, q, r_px = slopes(centre, contact_px)
    truth_mm = integrate(p, q, pitch_mm=PITCH_MM, boundary="dirichlet")
    image, near = dotted(exposed(picture(p, q)), moved_px=1.0), r_px < 1.5 * contact_px
    angle, off_mm = {}, {}
    for mode in BOTH:
        shape = Reconstructor(kept, mode)(image)
        angle[mode] = normal_error_deg(shape.normals.astype(float), normals(p, q))[near].mean()
        off_mm[mode] = np.sqrt(((shape.height_mm - truth_mm)[near] ** 2).mean())
    assert off_mm["video"] < 0.12 * truth_mm.max()
    assert angle["video"] < 1.15 * angle["accurate"] + 0.05
    assert off_mm["video"] < 1.15 * off_mm["accurate"] + 0.001
    assert shape.markers is not None
    assert len(shape.markers.places_mm) > 0.8 * len(markers.places_px)
    assert np.median(shape.markers.moved_mm, axis=0) == pytest.approx((PITCH_MM, 0.0), abs=0.02)


@pytest.mark.parametrize("shape", [(20, 31), (2, 5), (7, 2), (3, 3)])
def test_slopes_of_cells_blend_as_those_of_pixels(shape):
    """Few cells have details, so that none of them is noise."""
    random = np.random.default_rng(5)
    height = random.normal(size=shape).cumsum(axis=0).cumsum(axis=1).astype(np.float32)
    p, q = np.zeros((2, *shape), dtype=np.float32)
    p[4::9, 4::9], q[4::9, 4::9] = 0.4, -0.3
    p += 0.1
    filled = random.random(shape) < 0.2
    filled[0, 0] = True
    found = video._blended(np.array([p, q]), height, np.float32(0.2), np.zeros(shape, dtype=bool))
    np.testing.assert_allclose(found, blended(p, q, height, pitch_mm=0.2), rtol=1e-4, atol=1e-4)
    there = video._blended(np.array([p, q]), height, np.float32(0.2), filled)
    expected = np.where(filled, gradients_of(height, pitch_mm=0.2), found)
    np.testing.assert_allclose(there, expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("rough", "worst"), [(0.0, 0.014), (0.5, 0.0065)])
def test_heights_settle_where_cells_are_filled(rough, worst):
    """Against the same equations solved at once, with discs of filled cells on weights that differ."""
    random = np.random.default_rng(8)
    shape = 24, 32
    rows, columns = np.indices(shape)
    filled = np.hypot((rows + 4) % 8 - 4, (columns + 4) % 8 - 4) < 2.5
    weight = np.exp(-np.hypot(rows - 12, columns - 16) / 8 + rough * random.normal(size=shape))
    p, q = random.normal(size=(2, *shape)).astype(np.float32)
    counted = np.maximum(weight / weight.max(), video._LEAST_WEIGHT).astype(np.float32)
    counted[filled] *= FILLED
    source = np.empty(shape, dtype=np.float32)
    video._source(p, q, counted, source)
    matrix = np.empty((source.size, source.size))
    for cell, unit in enumerate(np.eye(source.size, dtype=np.float32)):
        step = np.empty(shape, dtype=np.float32)
        video._applied(unit.reshape(shape), counted, step)
        matrix[:, cell] = step.ravel()
    expected = 0.1 * np.linalg.solve(matrix, source.ravel()).reshape(shape)
    found = video._Poisson(shape, 0.1).weighted(p, q, weight.astype(np.float32), filled)
    assert np.abs(found - expected).mean() < worst * np.abs(expected).mean()


def test_noise_of_cells_is_left_out_as_that_of_pixels():
    """A ninth of the cells tells the noise to some per cent; without it every detail would be as read."""
    random = np.random.default_rng(6)
    rows, columns = np.indices((90, 120)) / 15
    height = (0.3 * np.exp(-((rows - 3) ** 2) - (columns - 4) ** 2)).astype(np.float32)
    down, p = np.gradient(height, 0.1)
    read = np.array([p, -down]) + 0.05 * random.normal(size=(2, *height.shape))
    filled = np.zeros(height.shape, dtype=bool)
    found = video._blended(read.astype(np.float32), height, np.float32(0.1), filled)
    expected = np.array(blended(*read, height, pitch_mm=0.1))
    assert np.abs(found - expected).mean() < 0.02 * np.abs(read - expected).mean()
    assert np.abs(found - read).mean() > 0.5 * 0.05
    # cells that were filled in have no noise, and say nothing of it
    filled[:, 60:] = True
    read[:, :, 60:] = np.array([p, -down])[:, :, 60:]
    half = video._blended(read.astype(np.float32), height, np.float32(0.1), filled)
    beside = np.s_[:, :, :58]
    assert np.abs(half - found)[beside].mean() < 0.02 * np.abs(read - found)[beside].mean()


@pytest.mark.parametrize("cell_px", [1, 2, 3])
def test_a_frame_has_the_slopes_of_its_cells_and_of_what_is_added(cell_px):
    """Even slopes; beyond them a plane that rises to the right and upwards."""
    rows, columns = np.indices((30, 42)).astype(np.float32)
    beyond = 0.1 * (0.2 * columns - 0.3 * rows)
    cells = np.broadcast_to(np.float32([[[0.1]], [[-0.2]]]), (2, -(-30 // cell_px), -(-42 // cell_px))).copy()
    shape = video.VideoShape(np.zeros_like(beyond), cells, cell_px, 0.1).raised(beyond)
    share = 1 - READ_SHARE
    expected = normals(np.full(beyond.shape, 0.1 + share * 0.2), np.full(beyond.shape, -0.2 + share * 0.3))
    np.testing.assert_allclose(shape.normals(), expected, atol=1e-5)
    np.testing.assert_allclose(shape.height_mm, beyond)
