"""The imaging chain: its order, its noise against closed forms, and that all of the program runs it."""

import numpy as np
import pytest

import designlab as dl
from designlab.evaluation.protocol import EvaluationProtocol
from designlab.inference.calibration import calibrate
from designlab.inference.calibration.problem import Problem
from designlab.inference.diagnosis.emulator.forward import Forward
from designlab.inference.diagnosis.emulator.rendering import fill
from designlab.inference.diagnosis.emulator.state import State
from designlab.measurement import MeasuredFrame, Measurement, load_measurement, write_measurement
from designlab.measurement.shots import observe
from designlab.sensor.camera import Camera, Vignetting
from designlab.sensor.design import preset
from designlab.simulation import imaging
from designlab.simulation.effects import AppliedEffect, SensorModel
from designlab.simulation.imaging import Capture, Image, ImagingStep, Mixing
from designlab.simulation.render_cache import Renders, _transport
from designlab.simulation.simulator import Simulator

DESIGN = preset("gelsight-2020-flat")
SIDE = 24
DRAWS = 4000


def test_steps_stand_in_the_order_of_the_light() -> None:
    assert [step.name for step in imaging.CHAIN] == [
        "lens",
        "vignetting",
        "effects on light",
        "mixing",
        "exposure",
        "noise",
        "black level",
        "effects on the signal",
        "response",
        "quantisation",
        "linearisation",
    ]


@pytest.mark.parametrize(("reflectance", "counts"), [(0.0, False), (0.05, True), (0.5, True)])
def test_kept_pictures_go_by_the_tube_where_it_is_bright(reflectance: float, counts: bool) -> None:
    """Light that meets a black tube is lost, as is light that meets nothing."""
    design = DESIGN.replace({"optics.housing_reflectance": (reflectance,)})
    wider = design.replace({"housing.inner_radius_mm": design.housing.inner_radius_mm + 1.0})
    kept = [_transport(SensorModel.of(each), None) for each in (design, wider)]
    assert (kept[0] != kept[1]) == counts


@pytest.mark.parametrize("curve", ["linear", "gamma"])
@pytest.mark.parametrize("binned", [1.0, 9.0])
def test_moments_are_those_of_the_closed_form_and_of_many_pictures(curve, binned) -> None:
    camera = Camera(
        full_well_e=4700, read_noise_e=8, black_level=0.05, bit_depth=10, response={"curve": curve}
    )
    radiance = np.broadcast_to(np.array([0.1, 0.3, 0.6]), (1, 1, 3))
    mean, variance = imaging.moments(radiance, np.zeros(radiance.shape), Capture(camera, binned=binned))
    if curve == "linear":
        # Photons, read-out and rounding of each sensor pixel, averaged (Janesick, Photon Transfer, 2007).
        electrons, well, step = radiance * 4700, 4700, 1 / (2**10 - 1)
        closed = np.sqrt(((electrons + 8**2) / well**2 + step**2 / 12) / binned)
        np.testing.assert_allclose(np.sqrt(variance), closed, rtol=1e-9)
    many = imaging.reported(np.repeat(radiance, DRAWS, axis=0), Capture(camera, seed=1, binned=binned))
    found = many.astype(float).reshape(DRAWS, 3)
    # Sample mean and variance at four standard errors; a curve's slope stands for the curve to a per cent.
    np.testing.assert_allclose(
        found.mean(axis=0), mean[0, 0], atol=4 * np.sqrt(variance.max() / DRAWS) + 1e-4
    )
    share = 4 * np.sqrt(2 / DRAWS) + (0.01 if curve == "gamma" else 0.0)
    np.testing.assert_allclose(found.var(axis=0), variance[0, 0], rtol=share)


def test_a_pedestal_keeps_the_noise_of_dark_pixels_from_being_cut_at_zero() -> None:
    # A Gaussian cut at zero has the mean sigma / sqrt(2 pi); lifted by ten sigma it is whole.
    camera = Camera(read_noise_e=20.0, full_well_e=10_000.0, black_level=0.0, bit_depth=16)
    sigma = 20.0 / 10_000.0
    level = 10 * sigma
    dark = np.zeros((200, 200, 3))
    cut = imaging.reported(dark, Capture(camera, seed=3))
    assert cut.mean() == pytest.approx(sigma / np.sqrt(2 * np.pi), rel=0.01)
    applied = AppliedEffect(name="black_level", values=dict.fromkeys("RGB", level))
    lifted = imaging.reported(dark, Capture(camera, SensorModel(design=DESIGN, effects=(applied,)), seed=3))
    assert lifted.mean() == pytest.approx(level, rel=0.002)
    assert lifted.std() == pytest.approx(sigma, rel=0.01)


def test_of_averaged_pixels_each_answers_by_an_effect_s_curve_with_its_own_noise() -> None:
    camera = Camera(read_noise_e=100.0, full_well_e=10_000.0, black_level=0.02, bit_depth=16)
    bent = SensorModel(
        design=DESIGN, effects=(AppliedEffect(name="response_curve", values={"exponent": 0.5}),)
    )
    light = np.full((120, 120, 3), 0.01)
    together = imaging.reported(light, Capture(camera, bent, seed=5, binned=16.0))
    single = imaging.reported(np.full((480, 480, 3), 0.01), Capture(camera, bent, seed=6))
    averaged = single.reshape(120, 4, 120, 4, 3).mean(axis=(1, 3))
    assert together.mean() == pytest.approx(averaged.mean(), rel=0.002)
    assert together.std() == pytest.approx(averaged.std(), rel=0.03)


def test_dark_averaged_pixels_are_cut_at_the_range_one_by_one() -> None:
    camera = Camera(read_noise_e=100.0, full_well_e=10_000.0, black_level=0.0, bit_depth=16)
    bent = SensorModel(
        design=DESIGN, effects=(AppliedEffect(name="response_curve", values={"exponent": 0.5}),)
    )
    together = imaging.reported(np.zeros((120, 120, 3)), Capture(camera, bent, seed=5, binned=16.0))
    single = imaging.reported(np.zeros((480, 480, 3)), Capture(camera, bent, seed=6))
    assert together.mean() == pytest.approx(single.mean(), rel=0.01)


@pytest.mark.parametrize("level", [0.0, 0.05])
def test_a_camera_without_read_noise_has_rounding_noise_in_the_dark(level) -> None:
    camera = Camera(read_noise_e=0.0, black_level=level, bit_depth=8, response={"curve": "gamma"})
    sigma = imaging.noise_sigma(np.zeros(3), Capture(camera, binned=4.0))
    slope = camera.response.slope(np.array(level))
    assert sigma == pytest.approx(1 / 255 / np.sqrt(12 * 4) / float(slope), rel=1e-6)


def test_steps_that_are_said_to_be_linear_add_up() -> None:
    rng = np.random.default_rng(4)
    capture = Capture(
        DESIGN.camera.model_copy(update={"black_level": 0.1, "vignetting": Vignetting(cosine_power=4)}),
        view=DESIGN.view(16),
        defocus_px=np.full((12, 16), 1.5),
        weights=rng.uniform(0, 1, (3, 3)),
    )
    for step in imaging.CHAIN:
        if step.linear:
            a, b = rng.uniform(0.1, 0.5, (2, 3, 12, 16))
            none, both = step.apply(np.zeros_like(a), capture), step.apply(a + b, capture)
            parts = step.apply(a, capture) + step.apply(b, capture) - none
            np.testing.assert_allclose(both, parts, rtol=1e-5, err_msg=step.name)


def test_defocus_takes_variance_from_a_picture_as_its_weights_say() -> None:
    lens = next(step for step in imaging.CHAIN if isinstance(step, imaging.Lens))
    capture = Capture(DESIGN.camera, defocus_px=np.full((80, 80), 2.5))
    noise = np.random.default_rng(2).standard_normal((40, 80, 80))
    inner = (slice(None), slice(10, 70), slice(10, 70))
    blurred = lens.apply(noise + 10.0, capture)[inner]
    _, variance = lens.moments(np.full((1, 80, 80), 10.0), np.ones((1, 80, 80)), capture)
    assert blurred.var() == pytest.approx(variance[inner].mean(), rel=0.05)
    assert variance[inner].mean() < 0.1  # a disc of 20 pixels


class Dust(ImagingStep):
    """A toy: dust on the lens dims the right half of every picture by a fifth."""

    name = "dust"

    def apply(self, image: Image, capture: Capture) -> Image:
        shade = np.ones(image.shape[-1])
        shade[image.shape[-1] // 2 :] = 0.8
        return np.asarray(image * shade, dtype=image.dtype)


class Leak(ImagingStep):
    """A toy: light leaks into the camera, three per cent of full scale in every channel."""

    name = "leak"

    def apply(self, image: Image, capture: Capture) -> Image:
        return image + 0.03


@pytest.fixture
def add(monkeypatch):
    """Put a step into the chain: in one place, before or behind a step that is there."""

    def added(step: ImagingStep, *, before: type[ImagingStep]) -> None:
        place = next(n for n, other in enumerate(imaging.CHAIN) if isinstance(other, before))
        chain = (*imaging.CHAIN[:place], step, *imaging.CHAIN[place:])
        monkeypatch.setattr(imaging, "CHAIN", chain)

    return added


def halves(picture: np.ndarray) -> tuple[float, float]:
    """Means of the left and the right half of a picture (..., rows, columns)."""
    middle = picture.shape[-1] // 2
    return float(picture[..., :middle].mean()), float(picture[..., middle:].mean())


def photographed(folder, model=DESIGN) -> Measurement:
    """A measurement of the untouched gel and a press, by the simulator."""
    view = DESIGN.view(SIDE)
    crop = tuple(round(v) for v in view[:4])
    view = view._replace(x_px=crop[0], y_px=crop[1], width_px=crop[2], height_px=crop[3])
    simulator = Simulator(model, view=view, samples=16, seed=7)
    frames = (
        MeasuredFrame(file="background.exr", kind="background", crop_px=crop),
        MeasuredFrame(
            file="press.exr", kind="press", probe="sphere:4", depth_mm=0.6, centre_mm=(0.5, 0.0), crop_px=crop
        ),
    )
    stated = Measurement(sensor="gelsight-2020-flat", response="linear", frames=frames)
    pictures = {}
    for frame in frames:
        press = dl.Press(probe=dl.sphere(diameter_mm=4), depth_mm=0.6, centre_mm=(0.5, 0.0))
        taken = simulator.frame(press if frame.kind == "press" else None)
        pictures[frame.file] = imaging.expected(
            taken.mixed, Capture(DESIGN.camera, exposure=float(DESIGN.camera.exposure or 1.0))
        ).astype(np.float32)
    return load_measurement(write_measurement(stated, pictures, folder))


def predictions(measurement: Measurement, folder) -> list[np.ndarray]:
    """What a diagnosis predicts for the frames of a measurement."""
    seen = observe(measurement, DESIGN, columns=SIDE)
    model = SensorModel.of(DESIGN)
    bank = fill(Renders(folder, 16, 7), model, seen.shots, (), finer=False)
    gains = np.full(3, float(DESIGN.camera.exposure or 1.0))
    return [Forward(bank).predict(State(gains), number) for number in range(len(seen.shots))]


@pytest.mark.renders
class TestAStepAddedInOnePlace:
    def test_is_seen_in_a_rendered_picture(self, add) -> None:
        plain = dl.render(DESIGN, columns=SIDE, samples=16, seed=7)
        add(Dust(), before=Mixing)
        dusty = dl.render(DESIGN, columns=SIDE, samples=16, seed=7)
        (left, right), (dusty_left, dusty_right) = halves(plain.basis), halves(dusty.basis)
        assert dusty_left == pytest.approx(left, rel=1e-6)
        assert dusty_right == pytest.approx(0.8 * right, rel=1e-6)

    @pytest.mark.slow
    def test_is_seen_in_a_score(self, add) -> None:
        plain = dl.evaluate(DESIGN, seed=1)
        add(Dust(), before=Mixing)
        dusty = dl.evaluate(DESIGN, seed=1)
        # The darkest place over the mean: the right half is darker by a fifth, the mean by a tenth.
        assert dusty.uniformity_u0.value < 0.95 * plain.uniformity_u0.value

    def test_is_seen_in_a_calibration(self, add, tmp_path, monkeypatch) -> None:
        # The pictures are the fast simulator's own, which exact ones would not correct but spoil.
        monkeypatch.setattr(Problem, "correct", lambda *_: None)
        add(Dust(), before=Mixing)
        measurement = photographed(tmp_path / "m")
        with_dust = calibrate(measurement, DESIGN, columns=SIDE, samples=16, seed=7, free=())
        assert all(frame.after["snr_db"] > 60 for frame in with_dust.frames)
        imaging.CHAIN = tuple(step for step in imaging.CHAIN if not isinstance(step, Dust))
        without = calibrate(measurement, DESIGN, columns=SIDE, samples=16, seed=7, free=())
        assert all(frame.after["snr_db"] < 25 for frame in without.frames)

    def test_is_seen_in_a_diagnosis(self, add, tmp_path) -> None:
        measurement = photographed(tmp_path / "m")
        plain = predictions(measurement, tmp_path / "plain")
        add(Dust(), before=Mixing)
        for before, after in zip(plain, predictions(measurement, tmp_path / "dusty"), strict=True):
            left, right = halves(np.moveaxis(before, -1, 0))
            assert halves(np.moveaxis(after, -1, 0)) == pytest.approx((left, 0.8 * right), rel=1e-5)

    def test_on_the_signal_is_seen_by_evaluation_and_inference_alike(self, add, tmp_path) -> None:
        frame = dl.render(DESIGN, columns=SIDE, samples=16, seed=7)
        protocol = EvaluationProtocol(DESIGN, float(DESIGN.camera.exposure or 1.0), 1)
        measurement = photographed(tmp_path / "m")
        picture, predicted = protocol.picture(frame, 0), predictions(measurement, tmp_path / "plain")
        add(Leak(), before=imaging.BlackLevel)
        step = 1 / (2**DESIGN.camera.bit_depth - 1)
        assert protocol.picture(frame, 0) - picture == pytest.approx(0.03, abs=1.01 * step)
        for before, after in zip(predicted, predictions(measurement, tmp_path / "leak"), strict=True):
            assert after - before == pytest.approx(0.03, abs=1e-6)


def test_noise_of_a_seed_is_the_same_whatever_was_drawn_between() -> None:
    """Deviates are kept, and Poisson's draws of dark pixels go on where they ended."""
    radiance = np.linspace(0.0, 0.4, 24 * 32 * 3).reshape(24, 32, 3)
    noise = next(step for step in imaging.CHAIN if isinstance(step, imaging.PixelNoise))
    electrons = radiance * Camera().full_scale_e
    few = electrons < imaging.FEW_ELECTRONS
    assert 0.1 < few.mean() < 0.9

    def taken(seed: int) -> Image:
        return noise.apply(radiance, imaging.Capture(Camera(), seed=seed))

    imaging._drawn.cache_clear()
    drawn, again = taken(3), taken(3)
    others = [taken(seed) for seed in range(10, 20)]
    for other in (again, taken(3)):
        np.testing.assert_array_equal(other, drawn)
    for other in others:
        assert (other != drawn)[few].mean() > 0.9
    random = np.random.default_rng(3)
    deviates = random.standard_normal(radiance.shape, dtype=np.float32)
    counted = drawn * Camera().full_scale_e - Camera().read_noise_e * deviates
    np.testing.assert_allclose(counted[few], random.poisson(electrons[few]), atol=1e-3)
