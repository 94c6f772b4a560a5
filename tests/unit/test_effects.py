import numpy as np
import pytest

from designlab.design import Design, preset
from designlab.effects import CATALOGUE, AppliedEffect, Effect, ModelError, SensorModel, load_model
from designlab.effects.model import effect
from designlab.mounting import sides
from designlab.press import Press, Surface, indent
from designlab.scene import LED_FACE_GAP_MM, Scene, build
from geometries.probes import parse

DESIGN = preset("gelsight-2020-flat")
BALL = Press(probe=parse("sphere:4"), depth_mm=0.6, centre_mm=(1.0, -0.5))
PICTURE = np.linspace(0.1, 0.4, 12).reshape(2, 2, 3)
LED_MOVE = {"radial_mm": 0.4, "height_mm": -0.3, "tangential_mm": 0.2}


def surface(design: Design, press: Press | None = BALL) -> Surface:
    return indent(design.elastomer, design.contact, press, area_mm=(8.0, 8.0), pitch_mm=0.05)


def scene(design: Design) -> Scene:
    return build(design, surface(design), design.view(24))


def applied(name: str, **values: float) -> SensorModel:
    known = effect(name).null(DESIGN)
    return SensorModel(design=DESIGN, effects=(AppliedEffect(name=name, values=known | values),))


@pytest.mark.parametrize("candidate", CATALOGUE, ids=lambda e: e.name)
def test_null_is_the_identity(candidate: Effect) -> None:
    null = candidate.null(DESIGN)
    assert candidate.on_design(DESIGN, null).digest == DESIGN.digest
    laid_out = scene(DESIGN)
    assert candidate.on_scene(laid_out, null).digest == laid_out.digest
    np.testing.assert_array_equal(candidate.on_signal(PICTURE, null), PICTURE)


@pytest.mark.parametrize("candidate", CATALOGUE, ids=lambda e: e.name)
def test_each_parameter_alone_changes_the_sensor(candidate: Effect) -> None:
    laid_out = scene(DESIGN)
    for parameter in candidate.parameters(DESIGN):
        values = candidate.null(DESIGN) | {parameter.name: parameter.null + parameter.sd}
        changed = candidate.on_design(DESIGN, values)
        moved = candidate.on_scene(laid_out, values)
        seen = candidate.on_signal(PICTURE, values)
        unchanged = (changed.digest, moved.digest) == (DESIGN.digest, laid_out.digest)
        assert not unchanged or not np.array_equal(seen, PICTURE), parameter.name


def test_a_black_level_lies_under_every_picture() -> None:
    level = effect("black_level")
    seen = level.on_signal(PICTURE, {"R": 0.01, "G": 0.0, "B": -0.02})
    np.testing.assert_allclose(seen - PICTURE, np.broadcast_to([0.01, 0.0, -0.02], PICTURE.shape), atol=1e-12)


@pytest.mark.parametrize("candidate", CATALOGUE, ids=lambda e: e.name)
def test_null_and_prior_lie_within_the_bounds(candidate: Effect) -> None:
    for p in candidate.parameters(DESIGN):
        assert p.low < p.null < p.high
        assert p.low <= p.null - p.sd
        assert p.null + p.sd <= p.high


def test_names_are_unique() -> None:
    names = [e.name for e in CATALOGUE]
    assert len(set(names)) == len(names)


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


def test_glued_leds_slide_along_the_side_but_stay_on_it() -> None:
    glued = preset("default").replace({"leds.coupling": "bonded", "leds.radius_mm": 13.0})
    assert [p.name for p in effect("led_position").parameters(glued)] == ["height_mm", "tangential_mm"]
    laid_out = scene(glued)
    moved = effect("led_position").on_scene(laid_out, {"height_mm": 0.3, "tangential_mm": -0.2})
    walls = sides(glued)
    before, after = (
        walls.distance_mm(np.array([light.centre_mm for light in s.lights])) for s in (laid_out, moved)
    )
    np.testing.assert_allclose(after, before, atol=1e-9)
    assert (after < 0).all()


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
    assert loaded.digest == model.digest
    assert loaded.effects == model.effects


def test_model_refuses_values_beyond_physical_bounds() -> None:
    with pytest.raises(ValueError, match=r"length_ratio: lies between 0.2 and 6 1, got 7"):
        applied("contact_kernel", length_ratio=7.0)


def test_model_refuses_unknown_effects() -> None:
    with pytest.raises(ValueError, match="'ether_wind' is unknown; known are led_position, contact_kernel"):
        AppliedEffect(name="ether_wind", values={})


def test_model_edited_by_hand_is_refused(tmp_path) -> None:
    path = tmp_path / "model.toml"
    text = applied("contact_kernel", length_ratio=1.5).dumps()
    path.write_text(text.replace("length_ratio = 1.5", "length_ratio = 1.6"), encoding="utf-8")
    with pytest.raises(ModelError, match="digest: does not match the content"):
        load_model(path)
