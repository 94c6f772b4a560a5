"""Pictures laid on the membrane: domes and lenses that bend, against closed forms."""

import numpy as np
import pytest

from designlab.core.metrics import normal_error_deg
from designlab.inference.calibration.ball_set import BallSet, _on_grid
from designlab.inference.calibration.balls import calibrate_balls
from designlab.reconstruction.ball_surface import BallSurface
from designlab.reconstruction.ball_view import ball_view, touched_px
from designlab.reconstruction.balls import BallPress
from designlab.reconstruction.calibration_file import load_calibration, save_calibration
from designlab.reconstruction.height import normals
from designlab.reconstruction.membrane import Membrane
from designlab.reconstruction.methods import Kernel
from designlab.reconstruction.reconstructor import Reconstructor
from designlab.reconstruction.setup import Setup
from tests.reconstruction.test_lab import TOWARD

ROWS, COLUMNS, PITCH_MM = 110, 140, 0.1
BALL_MM, THICKNESS_MM = 3.0, 1.5


def seen(lens, dome_mm=np.inf, eye_mm=np.inf):
    """What pixels see: places, height and slopes of a dome, slopes of rays, and where the gel is."""
    rows, columns = np.indices((ROWS, COLUMNS))
    x, y = (columns - (COLUMNS - 1) / 2) * PITCH_MM, ((ROWS - 1) / 2 - rows) * PITCH_MM
    x, y = lens(x, y)
    if np.isinf(dome_mm):
        height = p = q = np.zeros_like(x)
    else:
        deep = np.sqrt(dome_mm**2 - x**2 - y**2)
        height, p, q = dome_mm - deep, x / deep, y / deep
    sight = (-x / eye_mm, -y / eye_mm)
    return (x, y), height, (p, q), sight, np.hypot(x, y) < 20


LENSES = {
    "even": lambda x, y: (x, y),
    "shifted": lambda x, y: (1.1 * x + 0.3, 1.1 * y - 0.2),
    "barrel": lambda x, y: (x * (1 + 0.004 * (x**2 + y**2)), y * (1 + 0.004 * (x**2 + y**2))),
    "sheared": lambda x, y: (x + 0.1 * y, y),
}


@pytest.mark.parametrize("name", LENSES)
@pytest.mark.parametrize("dome_mm", [np.inf, 20.0])
def test_a_picture_is_laid_where_it_belongs(name, dome_mm):
    places, *rest = seen(LENSES[name], dome_mm)
    membrane = Membrane.of(places, *rest)
    x, y = membrane.laid_out(places[0]), membrane.laid_out(places[1])
    step = membrane.mm_per_px
    inner = membrane.seen
    assert inner.mean() > 0.75
    assert np.diff(x, axis=1)[inner[:, 1:] & inner[:, :-1]] == pytest.approx(step, rel=0.02)
    assert -np.diff(y, axis=0)[inner[1:] & inner[:-1]] == pytest.approx(step, rel=0.02)
    if np.isfinite(dome_mm):
        exact = dome_mm - np.sqrt(dome_mm**2 - x**2 - y**2)
        assert np.abs(membrane.height_mm - exact)[inner].max() < 0.002


@pytest.mark.parametrize("name", LENSES)
@pytest.mark.parametrize("centre_px", [(70.0, 55.0), (40.0, 70.0), (2.0, 60.0), (100.0, 107.0)])
def test_a_circle_that_was_stated_lies_where_the_picture_shows_it(name, centre_px):
    """Also one whose greater part lies beyond the border: its middle and size are those of the whole."""
    membrane = Membrane.of(*seen(LENSES[name], 20.0))
    (column, row), radius = _on_grid(membrane, centre_px, 9.0)
    x, y = LENSES[name](
        (centre_px[0] - (COLUMNS - 1) / 2) * PITCH_MM, ((ROWS - 1) / 2 - centre_px[1]) * PITCH_MM
    )
    # what the middle of the grid shows gives its origin
    height, width = membrane.columns.shape
    places = [membrane.laid_out(each) for each in seen(LENSES[name], 20.0)[0]]
    left = places[0][height // 2, width // 2] - width // 2 * membrane.mm_per_px
    top = places[1][height // 2, width // 2] + height // 2 * membrane.mm_per_px
    assert left + column * membrane.mm_per_px == pytest.approx(x, abs=0.05)
    assert top - row * membrane.mm_per_px == pytest.approx(y, abs=0.05)
    step = 0.5
    corners = np.array([[step, 0.0], [0.0, step]])
    around = [
        LENSES[name](
            (centre_px[0] + right - (COLUMNS - 1) / 2) * PITCH_MM,
            ((ROWS - 1) / 2 - centre_px[1] - down) * PITCH_MM,
        )
        for right, down in (*corners, *-corners)
    ]
    across, along, back_x, back_y = map(np.array, around)
    area = abs(np.linalg.det([across - back_x, along - back_y])) / (2 * step) ** 2
    assert radius * membrane.mm_per_px == pytest.approx(9.0 * np.sqrt(area), rel=0.03)


@pytest.mark.parametrize(("dome_mm", "x_mm"), [(20.0, 2.0), (35.0, -3.0), (12.0, 1.0)])
def test_a_ball_touches_a_dome_beside_its_axis(dome_mm, x_mm):
    """The axis lies further out than the contact, by the ball's radius over the dome's."""
    membrane = Membrane.of(*seen(LENSES["even"], dome_mm))
    middle = (membrane.columns.shape[1] - 1) / 2, (membrane.columns.shape[0] - 1) / 2
    axis = middle[0] + x_mm * (1 + BALL_MM / dome_mm) / membrane.mm_per_px, middle[1]
    touched = membrane.touched_from(axis, BALL_MM / membrane.mm_per_px)
    assert (touched[0] - middle[0]) * membrane.mm_per_px == pytest.approx(x_mm, abs=0.01)
    assert membrane.axis_of(touched, BALL_MM / membrane.mm_per_px) == pytest.approx(axis, abs=0.1)
    assert membrane.curvature_at(touched) == pytest.approx(1 / dome_mm, rel=0.02)


@pytest.mark.parametrize("contact_mm", [0.4, 1.0, 1.6])
def test_a_ball_that_is_pressed_in_touches_nearer_to_its_axis(contact_mm):
    """The middle of the contact lies on the line between the centres of ball and dome."""
    dome_mm = 20.0
    membrane = Membrane.of(*seen(LENSES["even"], dome_mm))
    middle, pitch = (membrane.columns.shape[1] - 1) / 2, membrane.mm_per_px
    axis = middle + 2.3 / pitch, (membrane.columns.shape[0] - 1) / 2
    ball = BallPress(np.zeros((*membrane.columns.shape, 3)), axis, contact_mm / pitch)
    setup = Setup(BALL_MM, pitch, thickness_mm=THICKNESS_MM, label_bias=0.0)
    equal = BallSurface(1 / (1 / BALL_MM + 1 / dome_mm), THICKNESS_MM, setup.poisson)
    exact = 2.3 * dome_mm / (dome_mm + BALL_MM - equal.depth_mm(contact_mm))
    found = touched_px(ball, setup, membrane)
    assert (found[0] - middle) * pitch == pytest.approx(exact, abs=0.005)


@pytest.mark.faults
@pytest.mark.parametrize("shape", [(ROWS, COLUMNS + 1, 3), (ROWS - 1, COLUMNS, 3), (10, 10, 3)])
def test_a_picture_of_another_size_is_refused(shape):
    membrane = Membrane.of(*seen(LENSES["even"]))
    with pytest.raises(ValueError, match=f"must be {COLUMNS} x {ROWS} pixels"):
        membrane.laid_out(np.zeros(shape))


@pytest.fixture(scope="module")
def on_dome():
    """A dome, presses of a ball on it as a camera near by sees them, and a calibration on them."""
    membrane = Membrane.of(*seen(LENSES["even"], 20.0, eye_mm=25.0))
    shape, pitch = membrane.columns.shape, membrane.mm_per_px
    setup = Setup(BALL_MM, pitch, thickness_mm=THICKNESS_MM, label_bias=0.0)
    places = [(c * shape[1], r * shape[0]) for c in (0.25, 0.5, 0.75) for r in (0.27, 0.5, 0.73)]

    def truth(place, contact_px):
        ball = BallPress(np.zeros((*shape, 3)), membrane.axis_of(place, BALL_MM / pitch), contact_px)
        view = ball_view(ball, setup, membrane)
        (p, q), r_px, gel = view.ball_slopes, view.r_px, view.gel_slopes()
        inside = r_px < contact_px
        slopes = [
            np.where(inside, own, base + more)
            for own, base, more in zip((p, q), (membrane.p, membrane.q), gel, strict=True)
        ]
        return ball, slopes, r_px

    def taken(slopes, seed):
        noise = 0.004 * np.random.default_rng(seed).normal(size=(*shape, 3))
        return np.clip((np.maximum(normals(*slopes) @ TOWARD, 0) + noise) / 1.4, 0, 1)

    background = taken((membrane.p, membrane.q), 99)
    balls = []
    for seed, place in enumerate(places):
        _, slopes, r_px = truth(place, 13.0)
        rows, columns = np.nonzero(r_px < 13.0)  # what a circle is read off
        axis = membrane.axis_of((float(columns.mean()), float(rows.mean())), BALL_MM / pitch)
        balls.append(BallPress(taken(slopes, seed), axis, 13.0))
    given = BallSet(tuple(map(str, places)), balls, background, BALL_MM, pitch, membrane=membrane)
    found = calibrate_balls(given, thickness_mm=THICKNESS_MM, method=Kernel(features=200, ridge=1e-4))
    return membrane, found, truth, taken


@pytest.mark.slow
def test_a_dome_is_calibrated_on_balls(on_dome):
    _, found, _, _ = on_dome
    assert found.mean.contact_deg < 2.0
    assert found.mean.height_mm < 0.02


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "contact_px"), [((0.4, 0.4), 12.0), ((0.65, 0.6), 10.0), ((0.3, 0.65), 14.0)]
)
def test_a_press_on_a_dome_is_reconstructed(on_dome, tmp_path, share, contact_px):
    """Pictures of the even camera lie on the grid as they are; the file keeps the membrane."""
    membrane, found, truth, taken = on_dome
    file = save_calibration(tmp_path / "calibration.npz", found.kept)
    kept = load_calibration(file)
    assert kept.membrane is not None
    shape = membrane.columns.shape
    ball, slopes, r_px = truth((share[0] * shape[1], share[1] * shape[0]), contact_px)
    image = taken(slopes, 7)
    whole = np.zeros((*membrane.picture_px, 3))
    whole[:] = found.balls.background.mean(axis=(0, 1))
    whole[: shape[0], : shape[1]] = image
    pressed = Reconstructor(kept)(whole)
    told = normals(
        membrane.p - pressed.normals[..., 0] / pressed.normals[..., 2],
        membrane.q - pressed.normals[..., 1] / pressed.normals[..., 2],
    )
    inside = r_px < contact_px
    assert normal_error_deg(told, normals(*slopes))[inside].mean() < 3.0
    assert pressed.contact[round(touched_px(ball, kept.calibration.setup, membrane)[1])].any()
