"""Fits against pictures of the same simulator with other random numbers, known poses, gains and effects."""

import numpy as np
import pytest

from designlab.design import preset
from designlab.effects.model import AppliedEffect, SensorModel
from designlab.gap.basis import Renders
from designlab.gap.fit import fit, free_parameters, screen
from designlab.gap.floor import floor, problem
from designlab.gap.problem import Problem, State, mixed, moved
from designlab.gap.where import geometry, regions, where
from designlab.measurement.shots import Shot
from designlab.press import Press
from designlab.simulate import Simulator
from geometries.probes import parse

DESIGN = preset("gelsight-2020-flat")
VIEW = DESIGN.view(40)
GAINS = np.array([1.07, 0.95, 1.02])
POSE = np.array([0.045, -0.035, 0.02, 0.0])
BALL = Press(probe=parse("sphere:4"), depth_mm=0.6, centre_mm=(1.5, -1.0))
SIGMA = 0.01  # of the camera, relative


def start(*effects: AppliedEffect) -> State:
    return State(SensorModel(design=DESIGN, effects=effects), np.ones(3), {})


def shot(press: Press | None, truth: State, pose: np.ndarray, *, use: str, seed: int) -> Shot:
    """A picture of the truth with camera noise; its own render noise is far below that of the fits."""
    simulator = Simulator(truth.model, view=VIEW, samples=4096, seed=seed, estimator="path")
    basis = simulator.frame(moved(press, pose)).basis.astype(float)
    light = mixed(truth.model.effective_design().mixing_matrix * flux(truth) * truth.gains, basis)
    noise = SIGMA * light * np.random.default_rng(seed).standard_normal(light.shape)
    return Shot(
        files=(f"{seed}.exr",),
        use=use,  # type: ignore[arg-type]
        press=press,
        pose_sigma=np.array([0.05, 0.05, 0.02, 0.0]) if press else np.zeros(4),
        lit=np.ones(3),
        view=VIEW,
        signal=light + noise,
        variance=(SIGMA * light) ** 2,
        valid=np.ones(light.shape, dtype=bool),
        clip_sigma=np.zeros(3),
    )


def flux(truth: State) -> np.ndarray:
    return np.array([group.flux_mw for group in truth.model.design.leds.groups])


def shots(truth: State, *, pressed: bool = True) -> tuple[Shot, ...]:
    background = shot(None, truth, np.zeros(4), use="background", seed=901)
    return (background, shot(BALL, truth, POSE, use="train", seed=902)) if pressed else (background,)


@pytest.fixture(scope="module")
def renders(tmp_path_factory) -> Renders:
    return Renders(tmp_path_factory.mktemp("renders"), samples=64, seed=1)


@pytest.fixture(scope="module")
def plain(renders) -> tuple[Problem, State]:
    truth = State(SensorModel(design=DESIGN), GAINS, {})
    return problem(renders, shots(truth), start())


def test_gains_and_pose_are_found(plain) -> None:
    compared, state = plain
    found = fit(compared, state, shots=[0, 1]).state
    np.testing.assert_allclose(found.gains, GAINS, rtol=3e-3)
    np.testing.assert_allclose(found.pose(1)[:3], POSE[:3], atol=0.006)
    assert (compared.residual(found, 1) ** 2).mean() < 1.1 < (compared.residual(state, 1) ** 2).mean()


def test_a_right_model_is_at_the_floor(plain) -> None:
    compared, state = plain
    found = fit(compared, state, shots=[0, 1]).state
    least = floor(compared, found, [0, 1], [s.valid for s in compared.shots], seed=0)
    reached = np.mean([(compared.residual(found, n) ** 2).mean() for n in (0, 1)])
    assert least.mean < least.envelope
    assert reached < least.envelope
    assert reached == pytest.approx(least.mean, rel=0.08)


def test_screening_tells_the_right_effect(renders) -> None:
    truth = State(start(AppliedEffect(name="contact_kernel", values={"length_ratio": 1.8})).model, GAINS, {})
    compared, state = problem(renders, shots(truth), start())
    registered = fit(compared, state, shots=[0, 1]).state
    predicted = {
        name: screen(compared, registered, free=free_parameters(registered, [name]), shots=[0, 1]).predicted
        for name in ("contact_kernel", "colour_mixing")
    }
    assert predicted["contact_kernel"] > 10 * predicted["colour_mixing"]
    free = free_parameters(registered, ["contact_kernel"])
    found = fit(compared, registered, free=free, shots=[0, 1])
    assert found.values("contact_kernel")["length_ratio"] == pytest.approx(1.8, rel=0.05)
    assert not found.at_bound()


def test_mixing_is_found_without_rendering(renders) -> None:
    values = {"R_from_green": 0.15, "R_from_blue": -0.05, "G_from_red": 0.1, "G_from_blue": 0.0}
    values |= {"B_from_red": 0.02, "B_from_green": 0.12}
    truth = State(start(AppliedEffect(name="colour_mixing", values=values)).model, GAINS, {})
    compared, state = problem(renders, shots(truth, pressed=False), start())
    before = renders.rendered
    found = fit(compared, state, free=free_parameters(state, ["colour_mixing"]), shots=[0])
    assert renders.rendered == before
    # With all groups on in one picture, only the shape of their light tells them apart.
    for name, value in found.values("colour_mixing").items():
        assert value == pytest.approx(values[name], abs=4 * found.deviation("colour_mixing")[name] + 0.005)
    np.testing.assert_allclose(found.state.gains, GAINS, rtol=0.02)


def test_parameters_stop_at_their_bounds(renders) -> None:
    # Five times the largest response that is physical.
    mixing = np.eye(3)
    mixing[0, 1] = 3.5
    strong = DESIGN.replace({"mixing": tuple(map(tuple, mixing.tolist()))})
    truth = State(SensorModel(design=strong), np.ones(3), {})
    compared, state = problem(renders, shots(truth, pressed=False), start())
    found = fit(compared, state, free=free_parameters(state, ["colour_mixing"]), shots=[0], iterations=8)
    assert "R_from_green" in found.at_bound()


def test_renders_are_kept_on_disk_and_shared(renders, plain) -> None:
    compared, state = plain
    again = Renders(renders.folder, samples=64, seed=1)
    picture = again.basis(state.model, None, VIEW, stream=0)
    np.testing.assert_array_equal(picture, compared.basis(state, 0))
    brighter = state.model.design.replace({"leds.groups.0.flux_mw": 5.0, "camera.read_noise_e": 9.0})
    kernel = state.with_values({"contact_kernel": {"length_ratio": 1.3}, "led_position": still()})
    for model in (SensorModel(design=brighter), kernel.model):
        again.basis(model, None, VIEW, stream=0)
    assert again.rendered == 0
    again.basis(kernel.model, BALL, VIEW, stream=2)
    assert again.rendered == 1


def still() -> dict[str, float]:
    return dict.fromkeys(("radial_mm", "height_mm", "tangential_mm"), 0.0)


def test_regions_part_the_picture(plain) -> None:
    compared, state = plain
    frame = geometry(compared, state, 1)
    for channel in range(3):
        count = sum(place.astype(int) for place in regions(frame, DESIGN, channel).values())
        np.testing.assert_array_equal(count, 1)


def test_lit_walls_lie_towards_the_leds(plain) -> None:
    compared, state = plain
    frame = geometry(compared, state, 1)
    x, y = frame.seen_mm
    for channel, group in enumerate(DESIGN.leds.groups):
        azimuth = np.radians(group.azimuth_deg[0])
        atlas = regions(frame, DESIGN, channel)
        along = (x - BALL.centre_mm[0]) * np.cos(azimuth) + (y - BALL.centre_mm[1]) * np.sin(azimuth)
        assert along[atlas["wall facing the channel's LEDs"]].min() > 0.2
        assert along[atlas["wall facing away from the channel's LEDs"]].max() < -0.2
        near, far = (atlas[f"gel {where_} the channel's LEDs"] for where_ in ("near", "far from"))
        assert along[near].min() > along[far].max()


def test_where_points_at_the_excess(plain) -> None:
    compared, state = plain
    found = fit(compared, state, shots=[0, 1]).state
    frame = geometry(compared, found, 1)
    target = regions(frame, DESIGN, 2)["contact plateau"] | regions(frame, DESIGN, 2)["wall facing sideways"]
    spoiled = compared.shots[1].signal.copy()
    spoiled[..., 2][target] *= 1.3
    shown = Problem(
        compared.renders,
        (compared.shots[0], Shot(**(vars(compared.shots[1]) | {"signal": spoiled}))),
        compared.sigma,
        compared.spread,
        compared.budget,
    )
    places = where(shown, found, [0, 1])
    top = {(place.region, place.channel, place.frames) for place in places if place.share > 0.1}
    assert top <= {("contact plateau", "B", "press"), ("wall facing sideways", "B", "press")}
    assert places[0].mean_z > 3
    assert sum(place.share for place in places) == pytest.approx(1.0, abs=0.1)
