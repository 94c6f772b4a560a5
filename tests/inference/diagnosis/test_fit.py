"""Fits against pictures of the same simulator at values, gains and poses between those it has rendered."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.fft import idctn

from designlab.inference.diagnosis.emulator.forward import Forward
from designlab.inference.diagnosis.emulator.rendering import around, fill, moved, resized
from designlab.inference.diagnosis.emulator.snapshots import POSE_STEP, Bank
from designlab.inference.diagnosis.emulator.state import FRINGES, SIZE, State, Unknown
from designlab.inference.diagnosis.likelihood.empirical_errors import dirt_sd, unlisted_sd
from designlab.inference.diagnosis.likelihood.fit import DIRTY, FRINGES_SD, SIZE_SD, Fit, Fitter
from designlab.inference.diagnosis.likelihood.noise import SHOT_BUDGET, spectrum
from designlab.inference.diagnosis.likelihood.normal_equations import System
from designlab.inference.diagnosis.likelihood.repeats import shot_error
from designlab.inference.diagnosis.selection.recentring import (
    beyond,
    exact_fitter,
    looks_elsewhere,
    placed,
    standing,
)
from designlab.inference.diagnosis.verdict.localise import localise
from designlab.simulation.contact.press import Press
from designlab.simulation.effects import AppliedEffect, SensorModel, effect
from designlab.simulation.render_cache import DRAFT, Quality, Renders
from designlab.simulation.simulator import Simulator
from designlab.validation.synthetic.electronics import Converter
from designlab.validation.synthetic.generator_sensor import Rig
from designlab.validation.synthetic.lens import colour_shifted
from geometries.probes import parse
from tests.helpers.small_sensor import (
    DESIGN,
    ERRORS,
    GAINS,
    NOISE,
    PRESSES,
    SAMPLES,
    SEED,
    VALUES,
    VIEW,
    applied,
    seeing,
    shots,
    taken,
)

pytestmark = pytest.mark.renders

NAMES = ("led_position", "albedo_field", "translucency", "contact_kernel", "depth_offset")
NAMES += ("vignetting", "colour_mixing")


@pytest.fixture(scope="module")
def bank(renders) -> Bank:
    return fill(renders, SensorModel.of(DESIGN), shots(SensorModel.of(DESIGN))[:3], NAMES)


@pytest.mark.parametrize("name", VALUES)
def test_combined_pictures_are_those_rendered_at_the_same_values(bank, name) -> None:
    forward = Forward(bank)
    state = State(GAINS, {name: VALUES[name]})
    for number, press in [(0, None), (1, PRESSES[0])]:
        combined, picture = forward.predict(state, number), bank.of(number)
        frame = Simulator(applied(name), view=picture.view, samples=SAMPLES, seed=SEED).frame(press)
        basis = frame.basis[:, *picture.place].astype(float)
        rendered = np.einsum("cg,grk->rkc", frame.weights * GAINS, basis)
        assert np.sqrt(((combined - rendered) ** 2).mean()) < 0.01 * np.sqrt((rendered**2).mean())
        without = forward.predict(State(GAINS), number)
        assert (
            np.sqrt(((combined - rendered) ** 2).mean())
            <= 0.2 * np.sqrt(((without - rendered) ** 2).mean()) + 1e-9
        )


def test_pictures_about_values_found_are_those_rendered_there(renders) -> None:
    far = {"radial_mm": 0.9, "height_mm": -0.8, "tangential_mm": 0.7}
    near = {"radial_mm": 1.0, "height_mm": -0.9, "tangential_mm": 0.6}
    model = SensorModel.of(DESIGN)
    bank = fill(renders, model, shots(model)[:1], ["led_position"], origin={"led_position": far})
    combined = Forward(bank).predict(State(GAINS, {"led_position": near}), 0)
    moved_leds = SensorModel(design=DESIGN, effects=(AppliedEffect(name="led_position", values=near),))
    frame = Simulator(moved_leds, view=VIEW, samples=SAMPLES, seed=SEED).frame(None)
    rendered = np.einsum("cg,grk->rkc", frame.weights * GAINS, frame.basis.astype(float))
    assert np.sqrt(((combined - rendered) ** 2).mean()) < 0.003 * np.sqrt((rendered**2).mean())


def test_pictures_of_large_tilts_are_combined_closely(renders) -> None:
    model, group = SensorModel.of(DESIGN), DESIGN.group_names[0]
    tilt = {**effect("led_tilt").null(DESIGN), f"{group}_tilt_deg": -8.0, f"{group}_turn_deg": 5.0}
    tilted = SensorModel(design=DESIGN, effects=(AppliedEffect(name="led_tilt", values=tilt),))
    frame = Simulator(tilted, view=VIEW, samples=SAMPLES, seed=SEED).frame(None)
    rendered = np.einsum("cg,grk->rkc", frame.weights * GAINS, frame.basis.astype(float))
    forward = Forward(fill(renders, model, shots(model)[:1], ["led_tilt"]))
    combined = forward.predict(State(GAINS, {"led_tilt": tilt}), 0)
    change = np.sqrt(((rendered - forward.predict(State(GAINS), 0)) ** 2).mean())
    assert np.sqrt(((combined - rendered) ** 2).mean()) < 0.1 * change


@pytest.mark.slow
def test_drafts_tell_how_light_changes(renders) -> None:
    bare, view = SensorModel.of(DESIGN), shots(SensorModel.of(DESIGN))[0].view

    def change(press: Press | None, **how: Quality) -> np.ndarray:
        ends = (renders.basis(model, press, view, **how) for model in (applied("led_position"), bare))
        return np.subtract(*ends)

    for press in (None, PRESSES[0]):
        usual, drafted = change(press), change(press, quality=DRAFT)
        assert (usual != drafted).any()
        assert np.sqrt(((drafted - usual) ** 2).mean()) < 0.1 * np.sqrt((usual**2).mean())


def test_one_side_of_null_gives_the_chord_to_its_nearer_end(bank, renders) -> None:
    model = SensorModel.of(DESIGN)
    one = fill(renders, model, shots(model)[:3], NAMES, both=False)
    for picture, whole in zip(one.pictures, bank.pictures, strict=True):
        assert picture.changes.keys() == whole.changes.keys()
        for key, chord in picture.changes.items():
            assert not chord.second.any()
            curved = whole.changes[key]
            ends = np.zeros((2, *picture.light.shape), dtype=np.float32)
            chord.added(ends[0], chord.reach)
            curved.added(ends[1], chord.reach)
            assert np.abs(ends[0] - ends[1]).max() <= 1e-5 * np.abs(picture.light).max()
    known = one.with_changes(bank)
    for picture, whole in zip(known.pictures, bank.pictures, strict=True):
        assert all(picture.changes[key] is whole.changes[key] for key in whole.changes)


def test_turning_a_ball_takes_no_pictures() -> None:
    for probe, turned in (("sphere:4", 0), ("triangle:4", 2)):
        press = Press(probe=parse(probe), depth_mm=0.5)
        there = [moved.yaw_deg for _, moved in around(press)]
        assert np.count_nonzero(there) == turned


def test_the_untouched_gel_of_a_shot_is_that_of_its_own_part_of_the_sensor(tmp_path) -> None:
    model = SensorModel.of(DESIGN)
    (whole, *_) = shots(model)
    beside = VIEW._replace(x_px=VIEW.x_px + VIEW.width_px / 8, width_px=VIEW.width_px * 7 / 8)
    seen = (whole, replace(whole, view=beside))
    forward = Forward(fill(Renders(tmp_path, 2, SEED), model, seen, [], finer=False))
    state = State(GAINS)
    np.testing.assert_array_equal(forward.untouched(state, 1), forward.predict(state, 1))
    assert np.abs(forward.untouched(state, 1) - forward.predict(state, 0)).max() > 0.01


@pytest.mark.parametrize("yaw_deg", [360.0, -360.0, 359.5, 20.0])
def test_a_press_can_be_turned_further_from_any_angle(yaw_deg) -> None:
    press = Press(probe=parse("triangle:4"), depth_mm=0.5, yaw_deg=yaw_deg)
    for turn in (-1.0, 1.0):
        there = moved(press, np.array([0.0, 0.0, 0.0, turn]))
        assert (there.yaw_deg - yaw_deg - turn) % 360.0 == pytest.approx(0.0, abs=1e-9)


def test_what_the_given_model_adds_to_the_signal_is_predicted(bank) -> None:
    lifted = SensorModel.of(DESIGN).with_effect(
        AppliedEffect(name="black_level", values={"R": 0.01, "G": 0.02, "B": 0.03})
    )
    above = Forward(replace(bank, model=lifted)).predict(State(GAINS), 0)
    expected = np.broadcast_to([0.01, 0.02, 0.03], above.shape)
    np.testing.assert_allclose(above - Forward(bank).predict(State(GAINS), 0), expected, atol=1e-9)


def test_columns_are_the_derivatives_of_what_is_predicted(bank) -> None:
    fitter = Fitter(bank)
    state = State(GAINS, {name: VALUES[name] for name in VALUES}, {1: ERRORS[0]})
    unknowns = fitter.unknowns(state, NAMES, [1])
    _, columns = fitter.forward.linear(state, 1, unknowns)
    for place, unknown in enumerate(unknowns):
        step = np.zeros(len(unknowns))
        step[place] = 1e-2
        ends = [fitter.forward.predict(fitter.moved(state, unknowns, s), 1) for s in (step, -step)]
        slope = (ends[0] - ends[1]) / 2e-2
        assert np.abs(columns[place] - slope).max() <= 0.02 * np.abs(slope).max() + 1e-7, unknown


def test_poses_and_gains_are_found_without_any_effect(bank) -> None:
    fitter = seeing(bank, SensorModel.of(DESIGN))
    found = fitter.fit(fitter.start([0, 1, 2]), (), [0, 1, 2]).state
    np.testing.assert_allclose(found.gains, GAINS, rtol=2e-3)
    for number in (1, 2):
        np.testing.assert_allclose(found.pose(number)[:3], ERRORS[number - 1][:3], atol=0.004)


def test_a_probe_of_another_size_than_stated_is_found(bank, renders) -> None:
    """With all that the pictures tell, few and coarse as they are; light combined for it is that rendered."""
    larger = 0.017
    away = [
        taken(SensorModel.of(DESIGN), resized(press, larger), error, "train", 30 + k)
        for k, (press, error) in enumerate(zip(PRESSES[:2], ERRORS[:2], strict=True))
    ]
    stated = [replace(shot, press=press) for shot, press in zip(away, PRESSES[:2], strict=True)]
    fitter = Fitter(replace(bank, shots=(bank.shots[0], *stated)))
    fitter.alike = 1.0
    found = fitter.fit(fitter.start([0, 1, 2]), (), [0, 1, 2])
    place = [k for k, u in enumerate(found.system.unknowns) if u.effect == SIZE]
    information, _ = found.system.reduced(place)
    error = SIZE_SD / np.sqrt(1.0 + information.item())
    assert error < 0.2 * larger
    assert found.state.sizes == {"sphere:4": pytest.approx(larger, abs=3 * error)}
    for number in (1, 2):
        np.testing.assert_allclose(found.state.pose(number)[:3], ERRORS[number - 1][:3], atol=0.004)
    simulator = Simulator(SensorModel.of(DESIGN), view=bank.of(1).view, samples=SAMPLES, seed=SEED)
    there = simulator.frame(resized(PRESSES[0], larger)).basis
    state = State(GAINS, sizes={"sphere:4": larger})
    combined, without = (fitter.forward.light(s, 1) - there for s in (state, State(GAINS)))
    assert np.sqrt((combined**2).mean()) < 0.1 * np.sqrt((without**2).mean())
    exact = exact_fitter(renders, fitter, state, [1]).forward.light(state, 1)
    np.testing.assert_allclose(exact, there, rtol=1e-5, atol=1e-5 * float(there.max()))


@pytest.mark.parametrize("share", [0.004, -0.004])
def test_lateral_colour_of_a_lens_is_found(bank, share) -> None:
    """Against pictures that the generator of measurements has resampled."""
    shifted = [
        replace(shot, signal=colour_shifted(shot.signal, DESIGN.camera, VIEW, shift=share))
        for shot in bank.shots
    ]
    predict = Fitter(bank).forward.predict
    with_it, without = (predict(State(GAINS, fringes=value), 1) for value in (share, 0.0))
    expected = colour_shifted(without, DESIGN.camera, VIEW, shift=share) - without
    assert np.sqrt(((with_it - without - expected) ** 2).mean()) < 0.2 * np.sqrt((expected**2).mean())
    fitter = Fitter(replace(bank, shots=tuple(shifted)))
    fitter.alike = 1.0
    found = fitter.fit(fitter.start([0, 1, 2]), (), [0, 1, 2])
    place = [k for k, u in enumerate(found.system.unknowns) if u.effect == FRINGES]
    information, _ = found.system.reduced(place)
    error = FRINGES_SD / np.sqrt(1.0 + information.item())
    assert error < 0.2 * abs(share)
    assert found.state.fringes == pytest.approx(share, abs=3 * error)


def test_values_are_unlikely_only_where_what_no_catalogue_lists_cannot_have_moved_them_there(bank) -> None:
    fitter = Fitter(bank)
    p = next(p for p in fitter.forward.parameters["vignetting"] if not p.shape)
    moved = unlisted_sd("vignetting", p.name, shape=False)
    for usual, expected in ((3.0, ()), (3.0 + moved, ()), (3.0 + 3.0 * moved, (p.name,))):
        state = State(GAINS).with_values("vignetting", {p.name: p.null + usual * p.sd})
        found = Fit(state, System((), np.zeros((0, 0)), np.zeros(0), 0.0, np.zeros(0)), 0.0)
        assert fitter.beyond_prior(found, "vignetting") == expected


def test_on_a_sensor_with_dirt_an_effect_counts_beyond_what_dirt_makes_of_it(bank, monkeypatch) -> None:
    fitter, by_itself, stated = Fitter(bank), dirt_sd("vignetting"), 0.05
    assert by_itself > 0.2
    p = next(p for p in fitter.forward.parameters["vignetting"] if not p.shape)
    unknowns = (Unknown("vignetting", p.name, p.sd), Unknown("gain", "red", 1.0))
    information = np.diag([stated**-2 - 1.0, 10.0])  # beside the prior
    system = System(unknowns, information, np.zeros(2), 0.0, np.zeros(2))
    three = 3.0 * np.hypot(by_itself, stated)

    def counts(usual: float) -> bool:
        state = State(GAINS).with_values("vignetting", {p.name: p.null + usual * p.sd})
        return fitter.beyond_dirt(Fit(state, system, 0.0), "vignetting")

    assert counts(0.1)
    monkeypatch.setattr(Fitter, "of_smooth", lambda *_: 2.0 * DIRTY)
    assert [counts(usual) for usual in (0.1, 0.98 * three, 1.02 * three)] == [False, False, True]
    found = Fit(State(GAINS), system, 0.0)
    assert fitter.unlisted_sd(found, "vignetting", p) > unlisted_sd("vignetting", p.name, shape=False)
    assert fitter.beyond_dirt(found, "black_level")  # dirt does not look like one
    monkeypatch.setattr(Fitter, "of_smooth", lambda *_: 0.5 * DIRTY)
    assert counts(0.1)


def test_presses_far_from_where_they_were_stated_are_rendered_there(bank, renders) -> None:
    away = np.array([0.13, -0.08, 0.02, 0.0])  # two steps
    shot = taken(SensorModel.of(DESIGN), PRESSES[0], away, "train", 20)
    shot = replace(shot, pose_sigma=np.array([0.1, 0.1, 0.02, 0.0]))
    fitter = Fitter(replace(bank, shots=(bank.shots[0], shot, bank.shots[2])))
    near = placed(renders, fitter, [0, 1], [2])
    assert [picture.stand is not None for picture in near.bank.pictures] == [False, True, False]
    stand = near.bank.of(1).stand
    assert stand is not None
    pose = stand.pose * POSE_STEP
    assert pose[:3] == pytest.approx(away[:3], abs=0.01)
    rendered = Simulator(SensorModel.of(DESIGN), view=bank.of(1).view, samples=SAMPLES, seed=SEED)
    there = rendered.frame(moved(PRESSES[0], pose)).basis
    state = State(GAINS, poses={1: pose})
    combined, exact = (np.abs(f.forward.light(state, 1) - there).max() for f in (fitter, near))
    assert exact < 0.02 * combined
    stated = State(GAINS)
    np.testing.assert_array_equal(near.forward.light(stated, 1), fitter.forward.light(stated, 1))
    # Derivatives are those of what is predicted, also on the way.
    for share in (0.6, 1.1):
        at, step = share * pose, 1e-4
        ends = (
            near.forward.light(State(GAINS, poses={1: at + sign * step * np.eye(4)[0]}), 1).astype(float)
            for sign in (-1, 1)
        )
        low, high = ends
        unknown = Unknown("pose", "x_mm", 1.0, 1)
        slope = near.forward._light_slope(State(GAINS, poses={1: at}), 1, unknown, near.bank.of(1))
        assert slope is not None
        difference = (high - low) / (2 * step)
        assert np.abs(slope - difference).max() < 0.02 * np.abs(difference).max()


def test_pictures_are_exact_where_a_press_stands_far_off(bank, renders) -> None:
    """Also with an effect beside it; a press that stands elsewhere in another model is rendered anew."""
    fitter = seeing(bank, SensorModel.of(DESIGN))
    far, farther = np.array([0.09, -0.02, 0.03, 0.0]), np.array([0.11, 0.1, 0.0, 0.0])
    state = State(GAINS, {"contact_kernel": {"length_ratio": 1.1}}, {1: far})
    assert beyond(fitter, state, [0, 1, 2]) == [1]
    near = standing(renders, fitter, state, [1])
    model = SensorModel(
        design=DESIGN, effects=(AppliedEffect(name="contact_kernel", values={"length_ratio": 1.1}),)
    )
    rendered = (
        Simulator(model, view=bank.of(1).view, samples=SAMPLES, seed=SEED).frame(moved(PRESSES[0], far)).basis
    )
    np.testing.assert_allclose(near.forward.light(state, 1), rendered, rtol=1e-3, atol=1e-5)
    assert not beyond(near, state, [0, 1, 2])
    other = replace(state, poses={1: farther})
    assert beyond(near, other, [1]) == [1]
    again = standing(renders, near, other, [1])
    elsewhere = moved(PRESSES[0], farther)
    rendered = Simulator(model, view=bank.of(1).view, samples=SAMPLES, seed=SEED).frame(elsewhere).basis
    np.testing.assert_allclose(again.forward.light(other, 1), rendered, rtol=1e-3, atol=1e-5)
    # At the stated pose nothing has changed.
    stated = replace(state, poses={})
    np.testing.assert_array_equal(again.forward.light(stated, 1), fitter.forward.light(stated, 1))


def test_a_lens_that_shows_more_sees_what_lies_beside_the_picture(renders) -> None:
    """A press that the edge of the picture cuts must not speak against a wrong lens."""
    values = {"radial": 0.0, "magnification": -0.06}
    wrong = SensorModel(design=DESIGN, effects=(AppliedEffect(name="lens_distortion", values=values),))
    press = Press(probe=parse("sphere:4"), depth_mm=0.7, centre_mm=(-7.0, 0.0))
    shot = taken(SensorModel.of(DESIGN), press, np.zeros(4), "train", 30)
    forward = Forward(fill(renders, SensorModel.of(DESIGN), (shot,), []))
    seen = forward.predict(State(GAINS, {"lens_distortion": values}), 0)
    frame = Simulator(wrong, view=VIEW, samples=SAMPLES, seed=SEED).frame(press)
    rendered = np.einsum("cg,grk->rkc", frame.weights * GAINS, frame.basis.astype(float))
    change = np.abs(rendered - forward.predict(State(GAINS), 0)).max()
    assert np.abs(seen - rendered)[:, :2].max() < 0.1 * change
    assert np.abs(seen - rendered).max() < 0.2 * change


def test_edges_move_as_they_should_where_a_lens_looks_elsewhere(tmp_path) -> None:
    """By resampling alone an edge within a pixel blurs; in sharper pictures, where it stands, it does not."""
    samples = 256
    renders = Renders(tmp_path, samples, SEED)
    lens = {"radial": -0.05, "magnification": 0.02}
    away = np.array([0.06, -0.04, 0.0, 0.0])
    punch = Press(probe=parse("triangle:5"), depth_mm=0.5, centre_mm=(0.5, -0.3))
    shot = taken(SensorModel.of(DESIGN), punch, np.zeros(4), "train", 40)
    shot = replace(shot, view=DESIGN.view(96))  # as diagnoses have; only what is predicted counts here
    bank = fill(renders, SensorModel.of(DESIGN), (shot,), ["lens_distortion"])
    state = State(GAINS, {"lens_distortion": lens}, {0: away})
    model = SensorModel(design=DESIGN, effects=(AppliedEffect(name="lens_distortion", values=lens),))
    frame = Simulator(model, view=bank.of(0).view, samples=samples, seed=SEED).frame(moved(punch, away))
    basis = frame.basis[:, *bank.of(0).place].astype(float)
    rendered = np.einsum("cg,grk->rkc", frame.weights * GAINS, basis)

    fitter = Fitter(bank)
    exact = exact_fitter(renders, fitter, state, [0])
    (picture,) = exact.bank.pictures
    blurred = Forward(replace(exact.bank, pictures=(replace(picture, sharp=None),)))
    soft, sharp = (forward.predict(state, 0) for forward in (blurred, exact.forward))
    edges = np.abs(sharp - soft) > np.quantile(np.abs(sharp - soft), 0.97)
    off = [float(np.sqrt(((seen - rendered)[edges] ** 2).mean())) for seen in (soft, sharp)]
    assert off[1] < 0.4 * off[0]
    assert looks_elsewhere(fitter, state, [0])
    assert not looks_elsewhere(exact, state, [0])
    # A lens that is all but right needs no picture of its own.
    near = state.with_values("lens_distortion", {"radial": 0.005, "magnification": 0.0})
    assert not looks_elsewhere(fitter, near, [0])


def test_a_common_offset_of_the_depth_is_counted_once(bank, renders) -> None:
    """It is part of where a press stands, so that rendering it there must not add it again."""
    fitter = seeing(bank, SensorModel.of(DESIGN))
    fitter.measure(State(GAINS))
    state = State(GAINS, {"depth_offset": {"offset_mm": -0.08}})
    deeper = moved(PRESSES[0], np.array([0.0, 0.0, -0.08, 0.0]))
    rendered = (
        Simulator(SensorModel.of(DESIGN), view=bank.of(1).view, samples=SAMPLES, seed=SEED)
        .frame(deeper)
        .basis
    )
    assert beyond(fitter, state, [1]) == [1]
    for near in (standing(renders, fitter, state, [1]), exact_fitter(renders, fitter, state, [1])):
        np.testing.assert_allclose(near.forward.light(state, 1), rendered, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("bands", [0.0, 0.01])
@pytest.mark.parametrize("error", [0.0, 0.001, 0.003])
def test_repeats_tell_how_much_light_moves_from_frame_to_frame(bank, error, bands) -> None:
    """But for the bands that each was found to have, elsewhere in every one."""
    untouched = taken(SensorModel.of(DESIGN), None, np.zeros(4), "background", 1)
    rng = np.random.default_rng(5)
    place = (*(bank.place[0],) * 5, *bank.place[1:])
    bank = replace(bank, shots=(*(untouched,) * 5, *bank.shots[1:]), place=place)
    state = State(GAINS)
    if bands:
        turns = 2 * np.pi * rng.random(5)
        waves = {n: bands * np.array([np.cos(turn), np.sin(turn)]) for n, turn in enumerate(turns)}
        values = {"banding": {"amplitude": bands, "period_rows": 400.0}}
        state = replace(state, values=values, drawn={"banding": waves})
    repeats = []
    for number in range(5):
        light = Forward(bank).predict(state, number)
        power = np.sqrt(spectrum(light.shape[:2]))[..., None]
        moves = idctn(power * rng.standard_normal(light.shape), axes=(0, 1), norm="ortho")
        noisy = light * (1 + error * moves + NOISE * rng.standard_normal(light.shape))
        drift = 1 + 0.02 * rng.standard_normal()
        repeats.append(replace(untouched, signal=drift * noisy))
    fitter = Fitter(replace(bank, shots=(*repeats, *bank.shots[5:])))
    fitter.measure(state)
    found = shot_error(fitter, state, range(5))
    assert found == pytest.approx(error, rel=0.25) if error else found < 2e-4
    assert shot_error(fitter, state, [0, 1, 5]) == SHOT_BUDGET  # too few


def test_a_group_that_cannot_have_made_the_picture_is_refused_by_name(bank) -> None:
    dark = tuple(replace(shot, signal=shot.signal * np.array([1.0, -1.0, 1.0])) for shot in bank.shots)
    with pytest.raises(ValueError, match="LED group 'green' fits the measurement only with a negative gain"):
        Fitter(replace(bank, shots=dark)).start([0, 1, 2])


def test_a_change_of_the_contact_is_found_at_the_contact(bank, renders) -> None:
    fitter = seeing(bank, applied("contact_kernel"))
    start = fitter.fit(fitter.start([0, 1, 2]), (), [0, 1, 2]).state
    fitter.measure(start)
    found = localise(fitter, renders, start, [0, 1, 2])
    assert sum(place.share for place in found if "imprint" in place.region) > 0.8
    assert all(place.frames == "press" for place in found[:3])


def test_pixels_answer_by_a_curve_before_their_noise_is_averaged(bank) -> None:
    """In the dark the mean of what pixels report is not what a pixel without noise would report."""
    binned, camera = 64.0, DESIGN.camera
    level = np.array([1e-3, 4e-3, 0.1])  # the read noise of a pixel is 1.2e-3
    light = np.broadcast_to(level, (300, 200, 3))
    converter = Converter(camera, replace(Rig.of(DESIGN).sensor, exponent=0.85), binned=binned)
    reported = converter.report(light, np.random.default_rng(2), correlated=False).mean(axis=(0, 1))
    forward = Forward(bank)
    state = State(GAINS).with_values("response_curve", {"exponent": 0.85})
    predicted = forward.answers.reported(state.values, level)
    without_noise = (level + camera.black_level) ** 0.85
    np.testing.assert_allclose(predicted, reported, rtol=0.01)
    assert abs(without_noise[0] / reported[0] - 1) > 0.05


@pytest.mark.parametrize("exponent", [1.0, 0.85])
def test_the_black_level_lifts_what_is_left_of_light_and_its_noise(bank, exponent) -> None:
    """Light is cut at nothing before the black level is added, the noise about it only behind."""
    black, light = np.array([0.01, 0.007, -0.002]), np.array([-0.02, 0.0, 0.1])
    sensor = replace(Rig.of(DESIGN).sensor, exponent=exponent, black=tuple(black))
    converter = Converter(DESIGN.camera, sensor, binned=64.0)
    shown = np.broadcast_to(light, (300, 200, 3))
    reported = converter.report(shown, np.random.default_rng(2), correlated=False).mean(axis=(0, 1))
    state = State(GAINS).with_values("black_level", dict(zip("RGB", black, strict=True)))
    state = state.with_values("response_curve", {"exponent": exponent})
    np.testing.assert_allclose(Forward(bank).answers.reported(state.values, light), reported, rtol=0.01)


def test_edges_that_are_remembered_are_those_of_the_camera_of_each_state(bank) -> None:
    remembers = Forward(bank)
    for tilt in (0.3, -0.8, 0.3):
        for number in range(len(bank.shots)):
            values = {"x_mm": 0.1, "y_mm": 0.0, "z_mm": 0.0, "tilt_x_deg": tilt, "tilt_y_deg": 0.0}
            state = State(GAINS * (1.0 + tilt), {"camera_pose": values})
            found = remembers.predict(state, number)
            assert np.array_equal(found, Forward(bank).predict(state, number))
