"""Every effect of the catalogue: null, bounds, and what it does, against closed forms."""

from collections.abc import Mapping
from typing import get_args

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from designlab.sensor.camera import View, Vignetting
from designlab.sensor.design import Design, DesignError, preset
from designlab.sensor.led_mounting import sides
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from designlab.simulation.contact.surface import Surface
from designlab.simulation.effects import (
    CATALOGUE,
    AppliedEffect,
    Effect,
    ModelError,
    SensorModel,
    Sight,
    load_model,
)
from designlab.simulation.effects.base import Part
from designlab.simulation.effects.material import albedo_field
from designlab.simulation.effects.model import effect
from designlab.simulation.scene.scene import LED_FACE_GAP_MM, Scene, build
from geometries.probes import parse
from tests.helpers.shared_packages import AIR, APART, shared
from tests.helpers.shared_packages import CORE as SMALL

DESIGN = preset("gelsight-2020-flat")
CORE = preset("gelsight-2020-flat-core")
# Its skin as thin as that of the gel which `contact_layer` brings, so that edges show.
ELASTIC = preset("gelsight-2020-flat-elastic").replace({"contact.skin_length_mm": 0.05})
TRIANGLE = Press(probe=parse("triangle:4"), depth_mm=0.4, yaw_deg=10.0)
BALL = Press(probe=parse("sphere:4"), depth_mm=0.6, centre_mm=(1.0, -0.5))
PICTURE = np.linspace(0.1, 0.4, 12).reshape(2, 2, 3)
LED_MOVE = {"radial_mm": 0.4, "height_mm": -0.3, "tangential_mm": 0.2}
NAMES = (
    "black_level colour_mixing response_curve vignetting point_spread veiling_glare lens_distortion "
    "fixed_pattern exposure_drift banding led_spread led_profile led_tilt led_position interreflection "
    "gelcore_index delamination absorption core_scatter albedo_field specular_coat translucency "
    "contact_kernel contact_profile depth_offset camera_pose contact_layer gel_thickness friction "
    "skin_length probe_edge probe_size wetting"
)
EVERYWHERE = [(e, d) for d in (DESIGN, CORE, ELASTIC) for e in CATALOGUE]
everywhere = pytest.mark.parametrize(
    ("candidate", "design"),
    [pytest.param(e, d, marks=pytest.mark.slow if d is ELASTIC else ()) for e, d in EVERYWHERE],
    ids=[f"{e.name}-{d.optics.light_path}-{d.contact.model}" for e, d in EVERYWHERE],
)


def surface(design: Design, press: Press | None = BALL) -> Surface:
    return indent(design.elastomer, design.contact, press, area_mm=(8.0, 8.0), pitch_mm=0.05)


def scene(design: Design) -> Scene:
    return build(design, surface(design), design.view(24))


def sight(design: Design = DESIGN, *, columns: int = 24, turn_deg: float = 0.0) -> Sight:
    """Of the membrane at z = 0, seen straight from above."""
    view = design.view(columns)
    right, up, forward = design.camera.unproject(*view.centres())
    x, y, z = design.camera.position_mm
    seen = x + z * right / forward, y + z * up / forward
    pitch = float(seen[0][0, 1] - seen[0][0, 0]), float(seen[1][0, 0] - seen[1][1, 0])
    shape = view.rows, view.columns
    own = {
        "fixed_pattern": np.random.default_rng(0).standard_normal(shape),
        "exposure_drift": np.array(0.7),
        "banding": np.array(0.3),
    }
    return Sight(design, view, seen, pitch, turn_deg, own)


def light(seen: Sight) -> np.ndarray:
    shape = len(seen.design.group_names), seen.view.rows, seen.view.columns
    return np.random.default_rng(1).uniform(0.5, 1.5, shape)


def applied(name: str, design: Design = DESIGN, **values: float) -> SensorModel:
    known = effect(name).null(design)
    return SensorModel(design=design, effects=(AppliedEffect(name=name, values=known | values),))


def on_light(name: str, seen: Sight, values: Mapping[str, float]) -> np.ndarray:
    """Factor by which an effect changes light."""
    before = light(seen)
    return effect(name).on_light(before, effect(name).null(seen.design) | values, seen) / before


def state(candidate: Effect, design: Design, values: Mapping[str, float]) -> list[object]:
    """What every hook makes of fixed inputs."""
    seen = sight(design)
    return [
        *(candidate.on_press(press, values).model_dump_json() for press in (BALL, TRIANGLE)),
        candidate.on_design(design, values).digest,
        candidate.on_surface(surface(design), design, BALL, values).height_mm.tobytes(),
        candidate.on_scene(scene(design), values).digest,
        candidate.on_light(light(seen), values, seen).tobytes(),
        candidate.on_signal(PICTURE, values).tobytes(),
    ]


def test_the_catalogue_is_complete_and_in_the_order_of_the_pipeline() -> None:
    names = [e.name for e in CATALOGUE]
    assert sorted(names) == sorted(NAMES.split())
    stages = ("geometry", "emission", "transport", "material", "contact", "camera")
    order = [stages.index(e.stage) for e in CATALOGUE]
    assert order == sorted(order)


@everywhere
def test_null_is_the_identity_through_every_hook(candidate: Effect, design: Design) -> None:
    seen = sight(design)
    plain: list[object] = [BALL.model_dump_json(), TRIANGLE.model_dump_json(), design.digest]
    plain += [surface(design).height_mm.tobytes(), scene(design).digest]
    plain += [light(seen).tobytes(), PICTURE.tobytes()]
    assert state(candidate, design, candidate.null(design)) == plain


@everywhere
def test_each_parameter_alone_changes_something(candidate: Effect, design: Design) -> None:
    parameters, null = candidate.parameters(design), candidate.null(design)
    assert bool(parameters) == (not of_other_designs(candidate, design))
    for p in parameters:
        base = dict(null)
        if p.shape:
            main = next(other for other in parameters if not other.shape)
            base[main.name] = main.null + main.sd
        assert state(candidate, design, base | {p.name: p.null + p.sd}) != state(candidate, design, base)
        assert candidate.acts(base | {p.name: p.null + p.sd}, design)
        assert not candidate.acts(null, design)


def of_other_designs(candidate: Effect, design: Design) -> bool:
    if design.contact.model not in candidate.contact_models:
        return True
    if design.optics.light_path != "core":
        return candidate.name in ("gelcore_index", "delamination", "absorption", "core_scatter")
    return candidate.name == "led_tilt"  # bonded LEDs cannot tilt


@everywhere
def test_null_and_prior_lie_within_the_bounds(candidate: Effect, design: Design) -> None:
    names = [p.name for p in candidate.parameters(design)]
    assert len(set(names)) == len(names)
    for p in candidate.parameters(design):
        assert p.low < p.high
        assert p.low <= p.null < p.null + p.sd <= p.high
        assert p.one_sided == (p.low == p.null)
        assert p.one_sided or p.low <= p.null - p.sd


def test_effects_of_one_picture_do_nothing_where_it_is_not_known() -> None:
    known = sight()
    blind = Sight(known.design, known.view, known.seen_mm, known.pitch_mm)
    for name in ("fixed_pattern", "exposure_drift", "banding"):
        values = {p.name: p.null + p.sd for p in effect(name).parameters(DESIGN)}
        np.testing.assert_array_equal(effect(name).on_light(light(known), values, blind), light(known))


def test_a_black_level_lies_under_every_picture() -> None:
    level = effect("black_level")
    seen = level.on_signal(PICTURE, {"R": 0.01, "G": 0.0, "B": -0.02})
    np.testing.assert_allclose(seen - PICTURE, np.broadcast_to([0.01, 0.0, -0.02], PICTURE.shape), atol=1e-12)


def test_colour_mixing_adds_to_the_foreign_entries_alone() -> None:
    model = applied("colour_mixing", R_from_green=0.2, B_from_red=-0.1)
    added = model.effective_design().mixing_matrix - DESIGN.mixing_matrix
    expected = np.zeros((3, 3))
    expected[0, 1], expected[2, 0] = 0.2, -0.1  # rows R, G, B; columns red, green, blue, each of response 1
    np.testing.assert_allclose(added, expected, atol=1e-12)


def test_colour_mixing_is_relative_to_the_channels_response_to_its_own_group() -> None:
    matrix = ((1.0, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 2.0))
    design = DESIGN.replace({"mixing": matrix})
    values = effect("colour_mixing").null(design) | {"R_from_green": 0.2, "G_from_blue": 0.1}
    changed = effect("colour_mixing").on_design(design, values).mixing_matrix
    assert changed[0, 1] == pytest.approx(0.2 * 1.0)
    assert changed[1, 2] == pytest.approx(0.1 * 0.5)


def test_colour_mixing_leaves_light_transport_alone() -> None:
    changed = applied("colour_mixing", R_from_green=0.2).effective_design()
    assert scene(changed).digest == scene(DESIGN).digest


def test_contact_kernel_scales_the_smoothing_length_alone() -> None:
    changed = applied("contact_kernel", length_ratio=1.7).effective_design()
    assert changed.contact.kernel_length_mm == pytest.approx(1.7 * DESIGN.contact.kernel_length_mm)
    back = changed.replace({"contact.kernel_length_mm": DESIGN.contact.kernel_length_mm})
    assert back.digest == DESIGN.digest


def test_contact_kernel_widens_the_rim_and_keeps_the_volume() -> None:
    nominal = surface(DESIGN)
    smoother = surface(applied("contact_kernel", length_ratio=2.0).effective_design())
    assert smoother.height_mm.sum() == pytest.approx(nominal.height_mm.sum(), rel=1e-3)
    # A kernel adds its own variance to that of a shape, and its variance grows with its length squared.
    spread = [second_moment(s) for s in (surface(sharp()), nominal, smoother)]
    assert spread[2] - spread[0] == pytest.approx(4 * (spread[1] - spread[0]), rel=0.03)


def sharp() -> Design:
    return DESIGN.replace({"contact.kernel_length_mm": 0.0})


def second_moment(shape: Surface) -> float:
    x, y = np.meshgrid(shape.x_mm - BALL.centre_mm[0], shape.y_mm - BALL.centre_mm[1])
    return float((shape.height_mm * (x**2 + y**2)).sum() / shape.height_mm.sum())


def test_contact_kernel_leaves_the_untouched_gel_alone() -> None:
    changed = applied("contact_kernel", length_ratio=2.0).effective_design()
    assert not surface(changed, None).height_mm.any()


def elastic(name: str, press: Press = BALL, **values: float) -> Surface:
    """Membrane of an elastic gel that has an effect."""
    model = applied(name, ELASTIC, **values)
    return surface(model.effective_design(), model.on_press(press))


def test_effects_act_on_designs_of_their_model_of_contact_alone() -> None:
    kernel = {"contact_kernel", "contact_profile", "contact_layer"}
    layer = {"gel_thickness", "friction", "skin_length"}
    assert {e.name for e in CATALOGUE if e.contact_models == ("kernel",)} == kernel
    assert {e.name for e in CATALOGUE if e.contact_models == ("layer",)} == layer
    assert not any(effect(name).parameters(ELASTIC) for name in kernel)
    assert not any(effect(name).parameters(DESIGN) for name in layer)
    with pytest.raises(ValueError, match=r"effects\.contact_kernel\.values: needs exactly"):
        SensorModel(
            design=ELASTIC, effects=(AppliedEffect(name="contact_kernel", values={"length_ratio": 1.5}),)
        )


def test_gels_stay_thicker_than_presses_are_deep() -> None:
    thickness_mm = ELASTIC.elastomer.thickness_mm
    deep = BALL.model_copy(update={"depth_mm": 0.6 * thickness_mm})
    (ratio,) = effect("gel_thickness").parameters_under(ELASTIC, [BALL, deep])
    (usual,) = effect("gel_thickness").parameters_under(ELASTIC, [BALL])
    assert usual.low < ratio.low < ratio.null
    # A gel of half its thickness is thinner than the press is deep, that at the bound is not.
    with pytest.raises(ValueError, match=r"press\.depth_mm: must be less than the gel is thick"):
        elastic("gel_thickness", deep, thickness_ratio=usual.low)
    assert elastic("gel_thickness", deep, thickness_ratio=ratio.low).contact.any()


def test_layers_tried_in_place_of_kernels_stay_thicker_than_presses_are_deep() -> None:
    deep = BALL.model_copy(update={"depth_mm": 0.6 * DESIGN.elastomer.thickness_mm})
    share, thickness, _ = effect("contact_layer").parameters_under(DESIGN, [BALL, deep])
    assert (share, thickness.null) == (
        effect("contact_layer").parameters(DESIGN)[0],
        DESIGN.elastomer.thickness_mm,
    )
    assert deep.stated_depth_mm < thickness.low < thickness.null


def test_presses_too_deep_for_a_gel_leave_its_thickness_no_range() -> None:
    deep = BALL.model_copy(update={"depth_mm": 0.9 * DESIGN.elastomer.thickness_mm})
    assert effect("contact_layer").parameters_under(DESIGN, [deep]) == ()
    assert effect("contact_layer").parameters_under(DESIGN, [BALL])


@pytest.mark.parametrize("candidate", CATALOGUE, ids=[e.name for e in CATALOGUE])
class TestWhatIsDeclared:
    """A diagnosis goes by what effects say of themselves."""

    def test_effects_have_the_hooks_of_what_they_say(self, candidate: Effect) -> None:
        def own(hook: str) -> bool:
            return getattr(type(candidate), hook) is not getattr(Effect, hook)

        assert set(candidate.changes) == {part for part in get_args(Part) if own(f"on_{part}")}
        assert candidate.recombines == own("on_mixing")
        assert (candidate.draws is not None) == own("waves")
        if candidate.recombines or candidate.warps:
            assert candidate.changes == ("design",)
        if candidate.reposes:
            assert candidate.changes == ("press",)
        assert candidate.needs_touch or candidate.stage != "contact"

    def test_parameters_that_are_named_exist(self, candidate: Effect) -> None:
        draws = candidate.draws
        named = {*candidate.reposes, candidate.per_pixel, candidate.scales} - {""}
        if draws is not None:
            named |= {draws.strength} | ({draws.scan.parameter} if draws.scan else set())
        assert named <= {p.name for p in candidate.parameters(DESIGN)}

    def test_light_is_only_mixed_otherwise_where_it_is_said_to_be(self, candidate: Effect) -> None:
        values = {p.name: p.null + p.sd for p in candidate.parameters(DESIGN)}
        mixing = candidate.on_mixing(DESIGN.mixing_matrix, DESIGN, values)
        if candidate.recombines or not values:
            np.testing.assert_array_equal(mixing, candidate.on_design(DESIGN, values).mixing_matrix)
        assert (mixing != DESIGN.mixing_matrix).any() == candidate.recombines

    def test_a_constant_is_the_same_in_every_picture(self, candidate: Effect) -> None:
        values = {p.name: p.null + p.sd for p in candidate.parameters(DESIGN)}
        added = candidate.on_signal(PICTURE, values) - PICTURE
        constant = "signal" in candidate.changes and np.ptp(added, axis=(0, 1)).max() < 1e-12
        assert candidate.constant == constant

    def test_poses_are_changed_as_it_is_said(self, candidate: Effect) -> None:
        for parameter, axis in candidate.reposes.items():
            moved = candidate.on_press(BALL, candidate.null(DESIGN) | {parameter: 0.03})
            assert getattr(moved, axis) == pytest.approx(getattr(BALL, axis) + 0.03)

    def test_waves_are_those_of_a_picture_of_its_own(self, candidate: Effect) -> None:
        """Amounts of a picture whose phase or draw is known add up to what the hook makes of it."""
        if candidate.draws is None:
            return
        seen, strength = sight(), candidate.draws.strength
        values = candidate.null(DESIGN) | {strength: 0.03}
        own = float(seen.own[candidate.name])
        turn = 2 * np.pi * own
        amounts = 0.03 * np.array([np.cos(turn), np.sin(turn)] if candidate.draws.count == 2 else [own])
        change = np.tensordot(amounts, candidate.waves(seen.view, values), axes=1)
        expected = np.broadcast_to(1 + change, light(seen).shape)
        np.testing.assert_allclose(on_light(candidate.name, seen, values), expected, rtol=1e-12)


def test_what_cannot_be_told_apart_is_declared_by_both() -> None:
    for one in CATALOGUE:
        for other in one.confounded_with:
            if "." in other:
                content = ELASTIC.model_dump()
                for part in other.split("."):
                    assert part in content
                    content = content[part]
            else:
                assert one.name in effect(other).confounded_with
    assert set(effect("gel_thickness").confounded_with) == {"friction", "depth_offset", "contact.poisson"}


def test_a_whole_share_of_the_layer_is_the_elastic_design() -> None:
    def pressed(share: float, **values: float) -> Surface:
        model = applied("contact_layer", share=share, **values)
        return model.on_surface(surface(DESIGN), BALL)

    stated = DESIGN.replace({"contact": ELASTIC.contact})
    np.testing.assert_array_equal(pressed(1.0).height_mm, surface(stated).height_mm)
    assert pressed(1.0).mechanics is not None
    half = (surface(DESIGN).height_mm + surface(stated).height_mm) / 2
    np.testing.assert_allclose(pressed(0.5).height_mm, half, atol=1e-12)
    assert half.min() < 0
    thin = stated.replace({"elastomer.thickness_mm": 1.5})
    np.testing.assert_array_equal(pressed(1.0, thickness_mm=1.5).height_mm, surface(thin).height_mm)
    skinned = stated.replace({"contact.skin_length_mm": 0.15})
    np.testing.assert_array_equal(pressed(1.0, skin_length_mm=0.15).height_mm, surface(skinned).height_mm)


def test_a_thinner_gel_is_touched_wider_and_pressed_harder() -> None:
    thin, thick = (elastic("gel_thickness", thickness_ratio=ratio) for ratio in (0.7, 1.4))
    assert thin.contact.sum() > thick.contact.sum()
    assert thin.mechanics is not None
    assert thick.mechanics is not None
    assert thin.mechanics.force_n > 1.2 * thick.mechanics.force_n


def test_friction_adds_force_and_hardly_moves_the_membrane() -> None:
    plain, rough = surface(ELASTIC), elastic("friction", added=1.0)
    assert plain.mechanics is not None
    assert rough.mechanics is not None
    assert 1.0 < rough.mechanics.force_n / plain.mechanics.force_n < 1.18
    assert 0 < np.abs(rough.height_mm - plain.height_mm).max() < 0.02


def test_a_skin_smooths_by_a_normal_distribution() -> None:
    plain = surface(ELASTIC.replace({"contact.skin_length_mm": 0.0}))
    smoother = elastic("skin_length", added_mm=0.05)
    length_mm = ELASTIC.contact.skin_length_mm + 0.05
    by_hand = gaussian_filter(plain.height_mm, length_mm / plain.pitch_mm, mode="nearest")
    np.testing.assert_allclose(smoother.height_mm[20:-20, 20:-20], by_hand[20:-20, 20:-20], atol=2e-4)


def test_rounded_edges_are_less_steep_and_balls_stay_as_they_are() -> None:
    rounded = effect("probe_edge").on_press(TRIANGLE, {"radius_mm": 0.2})
    assert rounded.probe.text == "triangle:4:r0.2"
    assert effect("probe_edge").on_press(BALL, {"radius_mm": 0.2}) == BALL
    small = TRIANGLE.model_copy(update={"probe": parse("triangle:1")})
    most = effect("probe_edge").on_press(small, {"radius_mm": 1.0})
    assert parse(most.probe.text).edge_radius_mm == pytest.approx(most.probe.edge_radius_mm)  # can be made
    steepest = [
        max(np.abs(slope).max() for slope in s.indentation_gradient)
        for s in (elastic("probe_edge", TRIANGLE, radius_mm=r) for r in (0.0, 0.2))
    ]
    assert steepest[1] < 0.9 * steepest[0]


def test_larger_probes_touch_more() -> None:
    wide = [elastic("probe_size", TRIANGLE, size_ratio=r).contact.sum() for r in (0.9, 1.0, 1.1)]
    assert wide[0] / wide[1] == pytest.approx(0.81, rel=0.03)
    assert wide[2] / wide[1] == pytest.approx(1.21, rel=0.03)


def test_led_position_moves_rows_along_their_own_directions() -> None:
    laid_out = scene(DESIGN)
    moved = effect("led_position").on_scene(laid_out, LED_MOVE)
    for before, after in zip(laid_out.lights, moved.lights, strict=True):
        azimuth = np.radians(DESIGN.leds.groups[before.group].azimuth_deg[0])
        outward = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        around = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        shift = np.subtract(after.centre_mm, before.centre_mm)
        assert shift @ outward == pytest.approx(0.4)
        assert shift @ around == pytest.approx(0.2)
        assert shift[2] == pytest.approx(-0.3)
        assert (after.normal, after.radiance) == (before.normal, before.radiance)


@pytest.mark.parametrize("name", ["default", "gelsight-2020-flat-core"])  # upright sides, and drafted ones
@pytest.mark.parametrize("height_mm", [0.6, -0.4])
def test_glued_leds_slide_along_the_side_and_glue_still_fills(name: str, height_mm: float) -> None:
    glued = preset(name)
    if name == "default":
        glued = glued.replace({"leds.coupling": "bonded", "leds.radius_mm": 13.0})
    assert [p.name for p in effect("led_position").parameters(glued)] == ["height_mm", "tangential_mm"]
    laid_out = scene(glued)
    values = {"height_mm": height_mm, "tangential_mm": -0.2}
    moved = effect("led_position").on_scene(laid_out, values)
    walls = sides(glued)
    fronts = [
        [shape.vertices for shape in s.shapes if shape.name.startswith("board")] for s in (laid_out, moved)
    ]
    for board, (before, after) in enumerate(zip(*fronts, strict=True)):
        normal = np.asarray(moved.lights[board * (len(moved.lights) // len(fronts[0]))].normal)
        np.testing.assert_allclose(walls.distance_mm(after), walls.distance_mm(before), atol=1e-9)
        shift = after.mean(axis=0) - before.mean(axis=0)
        np.testing.assert_allclose(after - before, np.broadcast_to(shift, after.shape), atol=1e-12)
        across = np.cross([0.0, 0.0, 1.0], -normal)
        across /= np.linalg.norm(across)
        assert shift @ across == pytest.approx(-0.2)
        # Besides what was asked the board moves along its normal alone.
        level = shift - height_mm * np.array([0.0, 0.0, 1.0]) + 0.2 * across
        np.testing.assert_allclose(np.cross(level, normal), 0.0, atol=1e-12)
    inside = walls.distance_mm(np.array([light.centre_mm for light in moved.lights]))
    assert (inside < 0).all()


def test_led_position_keeps_strips_on_their_boards_and_moves_nothing_else() -> None:
    laid_out = scene(DESIGN)
    moved = effect("led_position").on_scene(laid_out, LED_MOVE)
    for before, after in zip(laid_out.shapes, moved.shapes, strict=True):
        if before.name.startswith("board"):
            assert not np.allclose(before.vertices, after.vertices)
        else:
            np.testing.assert_array_equal(before.vertices, after.vertices)
    for light in moved.lights:
        gaps = [
            plane_distance(light.centre_mm, s.vertices) for s in moved.shapes if s.name.startswith("board")
        ]
        assert min(gaps) == pytest.approx(LED_FACE_GAP_MM, rel=1e-3)


def plane_distance(point: tuple[float, float, float], corners: np.ndarray) -> float:
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    return float(abs((np.asarray(point) - corners[0]) @ normal) / np.linalg.norm(normal))


def test_model_round_trip(tmp_path) -> None:
    model = applied("contact_kernel", length_ratio=1.5).with_effect(
        AppliedEffect(
            name="led_position", values=LED_MOVE, low=LED_MOVE, high=LED_MOVE, found_in="bench, first day"
        )
    )
    assert [a.name for a in model.effects] == ["led_position", "contact_kernel"]  # order of the pipeline
    path = tmp_path / "model.toml"
    path.write_text(model.dumps(), encoding="utf-8")
    loaded = load_model(path)
    assert loaded == model
    assert loaded.digest == model.digest


def test_models_of_elastic_gels_round_trip(tmp_path) -> None:
    values = {
        "gel_thickness": {"thickness_ratio": 1.2},
        "friction": {"added": 0.4},
        "skin_length": {"added_mm": -0.02},
        "probe_edge": {"radius_mm": 0.15},
        "probe_size": {"size_ratio": 1.02},
    }
    effects = tuple(AppliedEffect(name=name, values=own) for name, own in values.items())
    model = SensorModel(design=ELASTIC, effects=effects)
    layered = applied("contact_layer", share=0.8, thickness_mm=3.0, skin_length_mm=0.1)
    for number, one in enumerate((model, layered)):
        assert load_model(one.save(tmp_path / f"{number}.toml")) == one
    design = model.effective_design()
    assert design.elastomer.thickness_mm == pytest.approx(1.2 * ELASTIC.elastomer.thickness_mm)
    assert (design.contact.friction, design.contact.skin_length_mm) == pytest.approx((0.4, 0.03))


def test_model_refuses_values_beyond_physical_bounds() -> None:
    with pytest.raises(ValueError, match=r"length_ratio: lies between 0.2 and 6 1, got 7"):
        applied("contact_kernel", length_ratio=7.0)


def test_model_refuses_unknown_effects() -> None:
    with pytest.raises(ValueError, match="'ether_wind' is unknown; known are ") as caught:
        AppliedEffect(name="ether_wind", values={})
    assert all(e.name in str(caught.value) for e in CATALOGUE)


def test_model_edited_by_hand_is_refused(tmp_path) -> None:
    path = tmp_path / "model.toml"
    text = applied("contact_kernel", length_ratio=1.5).dumps()
    path.write_text(text.replace("length_ratio = 1.5", "length_ratio = 1.6"), encoding="utf-8")
    with pytest.raises(ModelError, match="digest: does not match the content"):
        load_model(path)


def test_what_one_face_has_more_of_a_groups_flux_its_last_has_less() -> None:
    laid_out = scene(DESIGN)
    values = effect("led_spread").null(DESIGN) | {"green_1": -0.25, "red_1": 0.4}
    found = effect("led_spread").on_scene(laid_out, values)
    ratio = [a.flux_mw / b.flux_mw for a, b in zip(found.lights, laid_out.lights, strict=True)]
    assert [light.group for light in found.lights] == [0, 0, 1, 1, 2, 2]
    assert ratio == pytest.approx([1.4, 0.6, 0.75, 1.25, 1.0, 1.0])


def test_faces_cannot_have_more_than_the_flux_of_their_group() -> None:
    design = preset("default")
    values = effect("led_spread").null(design)
    first = {name: 0.6 for name in list(values)[:2]}
    with pytest.raises(DesignError, match=r"led_spread: .*0\.6.*: nothing of the flux is left"):
        effect("led_spread").on_scene(scene(design), values | first)


@pytest.mark.parametrize("exponent", [0.6, 3.0])
def test_a_profile_keeps_its_flux_and_is_the_power_of_the_cosine(exponent: float) -> None:
    changed = applied("led_profile", blue_exponent=exponent).effective_design()
    profile = changed.leds.profile_of(2)
    assert profile.power == exponent
    assert changed.leds.profile_of(0) == DESIGN.leds.profile_of(0)
    before, after = (scene(d).lights[-1] for d in (DESIGN, changed))
    assert after.flux_mw == pytest.approx(before.flux_mw)


@pytest.mark.parametrize(("tilt", "turn"), [(7.0, 0.0), (0.0, -5.0), (4.0, 6.0)])
def test_led_tilt_turns_by_its_angles_and_keeps_faces_on_their_boards(tilt: float, turn: float) -> None:
    laid_out = scene(DESIGN)
    values = effect("led_tilt").null(DESIGN) | {"green_tilt_deg": tilt, "green_turn_deg": turn}
    moved = effect("led_tilt").on_scene(laid_out, values)
    boards = {s.name: s.vertices for s in moved.shapes if s.name.startswith("board")}
    before_boards = {s.name: s.vertices for s in laid_out.shapes if s.name.startswith("board")}
    for number, (before, after) in enumerate(zip(laid_out.lights, moved.lights, strict=True)):
        board = f"board-{number // 2}"
        if before.group != 1:
            assert after == before
            np.testing.assert_array_equal(boards[board], before_boards[board])
            continue
        normal, across, down = (np.array(v) for v in (before.normal, before.across, before.down))
        found = np.array(after.normal)
        cosine = np.cos(np.radians(tilt)) * np.cos(np.radians(turn))
        assert found @ normal == pytest.approx(cosine, abs=1e-12)
        assert found @ down == pytest.approx(np.sin(np.radians(tilt)), abs=1e-12)
        # Counter-clockwise from above: from the normal away from `across`, which is z x outwards.
        assert found @ across == pytest.approx(
            -np.sin(np.radians(turn)) * np.cos(np.radians(tilt)), abs=1e-12
        )
        assert plane_distance(after.centre_mm, boards[board]) == pytest.approx(LED_FACE_GAP_MM, rel=1e-6)
        middles = boards[board].mean(axis=0), before_boards[board].mean(axis=0)
        np.testing.assert_allclose(*middles, atol=1e-12)
        apart = [np.linalg.norm(np.array(v.centre_mm) - middles[0]) for v in (before, after)]
        assert apart[1] == pytest.approx(apart[0])


def test_vignetting_is_the_cameras_own_polynomial() -> None:
    camera = DESIGN.camera.model_copy(update={"vignetting": Vignetting(a1=-0.3)})
    for seen in (
        sight(),
        Sight(DESIGN, DESIGN.camera.full_view()._replace(columns=9, rows=7), *sight_rest()),
    ):
        expected = camera.vignette(seen.view)
        shape = 3, seen.view.rows, seen.view.columns
        found = effect("vignetting").on_light(np.ones(shape), {"corner_loss": 0.3}, seen)
        np.testing.assert_allclose(found, np.broadcast_to(expected, shape), rtol=1e-12)


def test_vignetting_of_another_power() -> None:
    seen = Sight(DESIGN, DESIGN.camera.full_view()._replace(columns=9, rows=7), *sight_rest())
    even = np.ones((3, 7, 9))
    square, other = (
        1 - effect("vignetting").on_light(even, {"corner_loss": 0.3} | power, seen)
        for power in ({}, {"power": 4.0})
    )
    np.testing.assert_allclose(other, square**2 / 0.3, atol=1e-12)


def sight_rest() -> tuple[tuple[np.ndarray, np.ndarray], tuple[float, float]]:
    return (np.zeros((7, 9)), np.zeros((7, 9))), (0.1, 0.1)


@pytest.mark.parametrize("columns", [40, 320])  # pixels wider and narrower than the blur
def test_a_blurred_edge_has_the_stated_variance_on_the_membrane(columns: int) -> None:
    seen = sight(columns=columns)
    rows = seen.view.rows
    edge = np.zeros((3, rows, columns))
    edge[:, :, columns // 2 :] = 1.0
    found = effect("point_spread").on_light(edge, {"sigma_um": 150.0}, seen)
    slope = np.diff(found[0, rows // 2])
    at = np.arange(len(slope)) * seen.pitch_mm[0]
    mean = (slope * at).sum() / slope.sum()
    variance = (slope * (at - mean) ** 2).sum() / slope.sum()
    assert slope.sum() == pytest.approx(1.0, abs=1e-5)
    assert np.sqrt(variance) == pytest.approx(0.150, rel=2e-4)


def test_a_blur_leaves_a_slope_alone_up_to_the_edge() -> None:
    seen = sight(columns=40)
    row, column = np.mgrid[: seen.view.rows, :40].astype(float)
    slope = np.stack([1 + 0.02 * column - 0.01 * row])
    found = effect("point_spread").on_light(slope, {"sigma_um": 300.0}, seen)
    np.testing.assert_allclose(found, slope, atol=1e-9)


def test_a_blur_of_many_pixels_is_the_gaussian() -> None:
    seen = sight(columns=320)
    spot = np.zeros((1, seen.view.rows, 320))
    spot[0, 120, 160] = 1.0
    found = effect("point_spread").on_light(spot, {"sigma_um": 300.0}, seen)[0, 120]
    at = (np.arange(320) - 160) * seen.pitch_mm[0]
    expected = np.exp(-(at**2) / (2 * 0.3**2))
    np.testing.assert_allclose(found / found.max(), expected, atol=5e-3)


def test_glare_keeps_the_mean_and_takes_contrast() -> None:
    seen = sight(columns=48)
    before = light(seen)
    found = effect("veiling_glare").on_light(before, {"share": 0.1}, seen)
    np.testing.assert_allclose(found.mean(axis=(1, 2)), before.mean(axis=(1, 2)), rtol=1e-3)
    assert found.std() / before.std() == pytest.approx(0.9, abs=0.01)


def test_glare_is_a_wide_gaussian_of_the_mirrored_picture() -> None:
    before = np.random.default_rng(0).uniform(size=(2, 18, 24))
    found = effect("veiling_glare").on_light(before, {"share": 1.0}, sight())
    mirrored = np.pad(before, ((0, 0), (36, 36), (48, 48)), mode="symmetric")
    width = 0.3 * 24
    veil = gaussian_filter(mirrored, (0, width, width), mode="constant", truncate=3.0)[:, 36:-36, 48:-48]
    np.testing.assert_allclose(found, veil, rtol=1e-12)


def test_albedo_field_has_no_mean_over_the_area_and_is_the_polynomial() -> None:
    width, height = DESIGN.sensing_area_mm
    x = (np.arange(400) + 0.5) / 400 * width - width / 2
    y = (np.arange(300) + 0.5) / 300 * height - height / 2
    place = np.meshgrid(x, y)
    seen = Sight(DESIGN, DESIGN.view(24), (place[0], place[1]), (0.04, 0.04))
    for term, corner in (("x", 1.0), ("y", 1.0), ("xx", 2 / 3), ("xy", 1.0), ("yy", 2 / 3)):
        found = albedo_field(effect("albedo_field").null(DESIGN) | {term: 0.2}, seen)
        assert found.mean() == pytest.approx(0.0, abs=1e-5)
        assert found[-1, -1] == pytest.approx(0.2 * corner, rel=0.02)


def test_a_blot_is_a_finer_form_of_an_uneven_coating() -> None:
    """A round blot of 2 mm (standard deviation) is made of the half waves and the quadratic."""
    width, height = DESIGN.sensing_area_mm
    place = np.meshgrid(np.linspace(-width / 2, width / 2, 80), np.linspace(-height / 2, height / 2, 60))
    seen = Sight(DESIGN, DESIGN.view(24), (place[0], place[1]), (0.2, 0.2))
    coat = effect("albedo_field")
    null = coat.null(DESIGN)
    names = [*null, *(p.name for p in coat.finer_parameters(DESIGN))]
    basis = np.stack([albedo_field(null | {name: 1.0}, seen).ravel() for name in names], axis=1)
    blot = np.exp(-((place[0] - 3.0) ** 2 + (place[1] - 1.5) ** 2) / 8).ravel()
    blot -= blot.mean()
    left = blot - basis @ np.linalg.lstsq(basis, blot)[0]
    of_quadratic = blot - basis[:, : len(null)] @ np.linalg.lstsq(basis[:, : len(null)], blot)[0]
    assert np.sqrt((left**2).mean()) < 0.12 * np.sqrt((blot**2).mean())
    assert np.sqrt((of_quadratic**2).mean()) > 0.5 * np.sqrt((blot**2).mean())


def test_albedo_field_turns_with_the_gel() -> None:
    values = effect("albedo_field").null(DESIGN) | {"x": 0.1, "xy": -0.05, "yy": 0.07, "wave_3_1": 0.05}
    x, y = np.array([[2.0, -3.0, 1.0]]), np.array([[1.0, 0.5, -4.0]])
    turn = np.exp(1j * np.radians(40.0))
    moved = turn * (x + 1j * y)
    view, pitch = DESIGN.view(24), (0.1, 0.1)
    still = albedo_field(values, Sight(DESIGN, view, (x, y), pitch))
    found = albedo_field(values, Sight(DESIGN, view, (moved.real, moved.imag), pitch, 40.0))
    np.testing.assert_allclose(found, still, atol=1e-12)


@pytest.mark.parametrize(("radial", "magnification"), [(0.0, 0.05), (-0.08, 0.0), (0.1, -0.06)])
@pytest.mark.parametrize("lens", ["pinhole", "fisheye"])
def test_points_appear_at_their_distorted_distance(lens: str, radial: float, magnification: float) -> None:
    design = DESIGN.replace({"camera.lens": lens, "camera.principal_point_px": (1300.0, 960.0)})
    changed = applied("lens_distortion", design, radial=radial, magnification=magnification)
    before, after = design.camera, changed.effective_design().camera
    tangent = np.linspace(-0.45, 0.45, 13)
    right, up = np.meshgrid(tangent, tangent * 0.7)
    (u, v), (found_u, found_v) = (camera.project(right, up) for camera in (before, after))
    x_c, y_c = before.centre_px
    r = np.hypot(u - x_c, v - y_c) / (np.hypot(before.width_px, before.height_px) / 2)
    scale = 1 + magnification + radial * r**2
    np.testing.assert_allclose(found_u, x_c + (u - x_c) * scale, atol=1e-6)
    np.testing.assert_allclose(found_v, y_c + (v - y_c) * scale, atol=1e-6)


def test_distortion_of_a_distorted_fisheye_keeps_its_focal_length() -> None:
    design = DESIGN.replace({"camera.lens": "fisheye", "camera.distortion.k1": 0.05})
    changed = applied("lens_distortion", design, radial=0.06, magnification=0.03).effective_design()
    assert changed.camera.focal_px == pytest.approx(1.03 * design.camera.focal_px, rel=1e-12)


def test_a_point_is_seen_where_a_moved_and_turned_camera_has_it() -> None:
    values = {"x_mm": 0.5, "y_mm": -0.4, "z_mm": 1.0, "tilt_x_deg": 3.0, "tilt_y_deg": -2.0}
    camera = applied("camera_pose", **values).effective_design().camera
    place = np.add(DESIGN.camera.position_mm, (0.5, -0.4, 1.0))
    assert camera.position_mm == pytest.approx(place)
    a, b = np.radians([3.0, -2.0])
    # Its own axes, first turned about x, so that it looks towards +y, then about y, towards +x.
    right = np.array([np.cos(b), 0.0, np.sin(b)])
    up = np.array([0.0, np.cos(a), np.sin(a)])
    up = np.array([up[2] * -np.sin(b), up[1], up[2] * np.cos(b)])
    point = np.array([2.0, -1.5, 0.3])
    away = point - place
    axis = np.cross(up, right)  # right x up points back to the camera
    depth = away @ axis
    expected = (
        camera.width_px / 2 + camera.focal_px * (away @ right) / depth,
        camera.height_px / 2 - camera.focal_px * (away @ up) / depth,
    )
    assert depth > 0
    found = camera.project(away[0], away[1], -away[2])
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_bands_repeat_after_their_period_on_the_full_sensor() -> None:
    view = View(300.0, 250.0, 1000.0, 1200.0, 4, 60)  # 20 sensor rows each
    seen = Sight(
        DESIGN, view, (np.zeros((60, 4)), np.zeros((60, 4))), (0.1, 0.1), own={"banding": np.array(0.1)}
    )
    values = {"amplitude": 0.2, "period_rows": 160.0}
    found = effect("banding").on_light(np.ones((3, 60, 4)), values, seen)[0] - 1
    np.testing.assert_allclose(found[8:], found[:-8], atol=1e-12)
    assert found[0] == pytest.approx(0.2 * np.sin(2 * np.pi * (260.0 / 160.0 + 0.1)))
    assert found.std() == pytest.approx(0.2 / np.sqrt(2), rel=0.05)


def test_factors_of_one_picture_are_what_was_drawn() -> None:
    seen = sight()
    drift = on_light("exposure_drift", seen, {"rms": 0.05})
    np.testing.assert_allclose(drift, 1 + 0.05 * 0.7, rtol=1e-12)
    pattern = on_light("fixed_pattern", seen, {"rms": 0.03})
    np.testing.assert_allclose(pattern, 1 + 0.03 * np.stack([seen.own["fixed_pattern"]] * 3), rtol=1e-12)


def test_response_is_a_power_mirrored_about_zero() -> None:
    found = effect("response_curve").on_signal(np.array([-0.04, 0.0, 0.25, 1.0]), {"exponent": 0.5})
    np.testing.assert_allclose(found, [-0.2, 0.0, 0.5, 1.0], atol=1e-12)


def test_interreflection_adds_to_boards_and_keeps_the_first_reflection() -> None:
    changed = applied("interreflection", boards=0.3, albedo_ratio=1.2).effective_design()
    assert changed.per_group("board_reflectance") == pytest.approx((0.4, 1.0, 0.4))
    for before, after in zip(DESIGN.leds.groups, changed.leds.groups, strict=True):
        group = DESIGN.group_names.index(before.name)
        albedo = [d.per_group("membrane_albedo")[group] for d in (DESIGN, changed)]
        assert albedo[1] == pytest.approx(1.2 * albedo[0])
        assert after.flux_mw * albedo[1] == pytest.approx(before.flux_mw * albedo[0])
    # Clipped to 1, and the flux with it.
    brightest = applied("interreflection", albedo_ratio=2.5).effective_design()
    assert max(brightest.per_group("membrane_albedo")) == 1.0
    assert brightest.leds.groups[0].flux_mw == pytest.approx(DESIGN.leds.groups[0].flux_mw * 0.506)


def test_effects_of_the_core_set_its_media() -> None:
    index = applied("gelcore_index", CORE, gelcore=0.03, elastomer=-0.02).effective_design().optics
    assert index.core_index == pytest.approx(CORE.optics.core_index + 0.03)
    assert index.gel_index == pytest.approx(CORE.optics.gel_index - 0.02)
    absorbing = applied("absorption", CORE, blue_per_mm=0.02).effective_design()
    before, after = (np.array(d.absorption_per_mm("gelcore")) for d in (CORE, absorbing))
    np.testing.assert_allclose(after - before, [0.0, 0.0, 0.02], atol=1e-12)
    hazy = applied("core_scatter", CORE, per_mm=0.015).effective_design().optics
    assert hazy.gelcore_scattering_per_mm == pytest.approx(CORE.optics.gelcore_scattering_per_mm + 0.015)
    assert hazy.gelcore_anisotropy == CORE.optics.gelcore_anisotropy


def test_delamination_cuts_a_disc_of_air_out_of_the_interface() -> None:
    design = applied("delamination", CORE, x_mm=2.0, y_mm=-1.0, radius_mm=1.5).effective_design()
    shapes = {s.name: s for s in scene(design).shapes}
    whole = next(s for s in scene(CORE).shapes if s.name == "interface")
    disc = np.pi * 1.5**2
    for name in ("gap-gel", "gap-core"):
        assert area(shapes[name]) == pytest.approx(disc, rel=2e-3)
        away = np.hypot(*(shapes[name].vertices[:, :2] - [2.0, -1.0]).T)
        assert away.max() == pytest.approx(1.5)
    assert area(shapes["interface"]) == pytest.approx(area(whole) - disc, rel=1e-4)
    media = {
        name: (s.material.inside.index, s.material.outside.index)
        for name, s in shapes.items()
        if "gap" in name
    }
    assert media == {
        "gap-gel": (CORE.optics.gel_index, pytest.approx(1.0, abs=1e-3)),
        "gap-core": (pytest.approx(1.0, abs=1e-3), CORE.optics.core_index),
    }


def area(shape) -> float:
    a, b, c = (shape.vertices[shape.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_a_gap_lies_between_core_and_gel_and_nowhere_else() -> None:
    z = {s.name: s.vertices[:, 2] for s in scene(CORE.replace({"optics.gap_radius_mm": 2.0})).shapes}
    assert z["gap-gel"] == pytest.approx(CORE.elastomer.thickness_mm)
    assert (z["gap-core"] > z["gap-gel"]).all()
    assert not {"gap-gel", "gap-core"} & {s.name for s in scene(CORE).shapes}


@pytest.mark.parametrize("away_mm", [0.1, 0.5, 1.4])
def test_the_tail_falls_exponentially_from_the_outline(away_mm: float) -> None:
    design = DESIGN.replace({"contact.kernel_length_mm": 0.0})
    changed = applied("contact_profile", design, tail_share=0.3, tail_mm=0.6).effective_design()
    assert (changed.contact.tail_share, changed.contact.tail_mm) == (0.3, 0.6)
    pressed = indent(changed.elastomer, changed.contact, BALL, area_mm=(9.0, 9.0), pitch_mm=0.02)
    outline = np.sqrt(2.0**2 - (2.0 - 0.6) ** 2)
    x, y = BALL.centre_mm
    for turn in (0.0, 0.9, 4.0):
        at = [np.array([c + (outline + away_mm) * f(turn)]) for c, f in ((x, np.cos), (y, np.sin))]
        found = pressed.sample(pressed.height_mm, *at)[0]
        assert found == pytest.approx(0.3 * 0.6 * np.exp(-away_mm / 0.6), rel=0.04)
    # Within the outline the higher of probe and tail stands.
    assert pressed.height_mm.max() == pytest.approx(0.6, abs=1e-3)
    near = pressed.sample(pressed.height_mm, np.array([x + outline - 0.05]), np.array([y]))[0]
    assert near == pytest.approx(0.3 * 0.6, rel=1e-6)


def test_depth_offset_presses_deeper_and_never_out_of_the_gel() -> None:
    offset = effect("depth_offset")
    assert offset.on_press(BALL, {"offset_mm": 0.07}).depth_mm == pytest.approx(0.67)
    shallow = BALL.model_copy(update={"depth_mm": 0.03})
    assert 0 < offset.on_press(shallow, {"offset_mm": -0.1}).depth_mm <= 0.03


def test_the_coat_gets_the_stated_gloss_and_leak() -> None:
    glossy = applied("specular_coat", share=0.1, roughness=0.25).effective_design().optics
    assert (glossy.coating_specular, glossy.coating_roughness) == (0.1, 0.25)
    thin = applied("translucency", transmittance=0.12, object=0.8).effective_design().optics
    assert (thin.coating_transmittance, thin.object_reflectance) == (0.12, 0.8)


def test_a_wetted_coat_ends_at_air_unless_the_design_says_otherwise() -> None:
    wet = applied("wetting", transmittance=0.2).effective_design().optics
    assert (wet.coating_transmittance, wet.object_reflectance) == (0.2, 0.0)
    assert wet.backing_reflectance == pytest.approx(0.536, abs=0.001)
    stated = DESIGN.replace({"optics.backing_reflectance": 0.3, "optics.coating_transmittance": 0.1})
    more = effect("wetting").on_design(stated, {"transmittance": 0.1}).optics
    assert (more.coating_transmittance, more.backing_reflectance) == (0.2, 0.3)


@pytest.mark.parametrize(
    "design", [shared(AIR), shared(SMALL), shared(SMALL, APART)], ids=["air", "core", "apart"]
)
@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("led_tilt", {"red_green_blue_tilt_deg": 6.0, "red_green_blue_turn_deg": -4.0}),
        ("led_position", LED_MOVE),
    ],
)
def test_groups_that_share_packages_move_with_them(
    design: Design, name: str, values: dict[str, float]
) -> None:
    assert {p.name for p in effect(name).parameters(design)} == set(values)
    assert all(p.group == "" for p in effect(name).parameters(design))
    before = scene(design)
    after = effect(name).on_scene(before, values)
    boards = {shape.name: shape for shape in after.shapes}
    for light, old in zip(after.lights, before.lights, strict=True):
        a, b, c = boards[light.board].vertices[:3]
        outward = np.cross(b - a, c - a) / np.linalg.norm(np.cross(b - a, c - a))
        outward *= np.sign(outward @ light.normal)
        np.testing.assert_allclose(outward, light.normal, atol=1e-9)
        assert (np.array(light.centre_mm) - a) @ outward == pytest.approx(LED_FACE_GAP_MM, abs=1e-9)
        assert light.centre_mm != old.centre_mm
        assert light.flux_mw == old.flux_mw


def test_groups_in_packages_of_their_own_tilt_apart() -> None:
    mixed = shared(SMALL, {"leds.groups.2.azimuth_deg": (30.0, 150.0, 270.0)})
    names = [p.name for p in effect("led_tilt").parameters(mixed)]
    assert names == [
        "red_green_tilt_deg", "red_green_turn_deg", "blue_tilt_deg", "blue_turn_deg",
    ]  # fmt: skip
    values = effect("led_tilt").null(mixed) | {"blue_tilt_deg": 5.0}
    before = scene(mixed)
    after = effect("led_tilt").on_scene(before, values)
    moved = {a.group for a, b in zip(after.lights, before.lights, strict=True) if a != b}
    assert moved == {2}
