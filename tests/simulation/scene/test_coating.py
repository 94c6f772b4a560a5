"""The coating: closed forms against sums and quadrature, and what markers, images and contact do to it."""

import numpy as np
import pytest
from scipy.optimize import brentq

from designlab.core.images import write_image
from designlab.sensor.contact import LayerContact
from designlab.sensor.design import DesignError, dumps, load, loads, preset
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from designlab.simulation.scene.coating import backed, bare, coating, coating_brdf
from geometries.probes import parse

FLAT = preset("gelsight-2020-flat")
BALL = Press(probe=parse("sphere:6"), depth_mm=0.8, centre_mm=(2.0, 1.0))


def coating_of(changes, press=None, *, design=FLAT):
    changed = design.replace(changes)
    surface = indent(changed.elastomer, changed.contact, press, area_mm=(16.0, 12.0), pitch_mm=0.1)
    return coating(changed, surface)


def texel(texture, x_mm, y_mm, layer=0):
    rows, columns = texture.values.shape[1:]
    row = int((0.5 - y_mm / texture.height_mm) * rows)
    column = int((0.5 + x_mm / texture.width_mm) * columns)
    return texture.values[layer, row, column]


@pytest.mark.parametrize(
    ("albedo", "transmittance", "behind"), [(0.3, 0.5, 0.9), (0.0, 1.0, 0.4), (0.6, 0.4, 1.0)]
)
def test_a_backed_coating_is_the_sum_over_all_passes(albedo, transmittance, behind):
    # once through, k times between coating and object, once through again
    passes = [transmittance * behind * (albedo * behind) ** k * transmittance for k in range(200)]
    assert backed(albedo, transmittance, behind) == pytest.approx(albedo + sum(passes), rel=1e-12)
    assert backed(albedo, transmittance, behind) <= 1.0 + 1e-12


def test_a_clear_coating_shows_the_object_alone_and_a_tight_one_itself():
    assert backed(0.0, 1.0, 0.37) == pytest.approx(0.37)
    assert backed(0.4, 0.0, 0.9) == 0.4
    assert backed(0.4, 0.3, 0.0) == 0.4


@pytest.mark.parametrize(
    ("albedo", "transmittance", "behind"),
    [(0.3, 0.5, 0.9), (0.0, 1.0, 0.4), (0.6, 0.4, 0), (0.2, 0.3, 0.53)],
)
def test_a_coating_alone_is_what_a_surface_behind_it_makes_the_stated_one(albedo, transmittance, behind):
    seen = backed(albedo, transmittance, behind)
    assert bare(seen, transmittance, behind) == pytest.approx(albedo, abs=1e-12)


def test_a_coating_alone_reflects_at_least_nothing():
    assert bare(0.01, 0.4, 0.53) == 0.0


def directional_albedo(cos_out, *, specular, roughness):
    """Share of light from one direction that a coating of reflectance 1 sends back, by quadrature.

    Half vectors h are integrated over, for the lobe is narrow there: dw = 4 (out . h) dh.
    """
    u, weight = np.polynomial.legendre.leggauss(400)
    theta = (u + 1) * np.pi / 4
    phi = np.arange(720) * 2 * np.pi / 720
    t, p = np.meshgrid(theta, phi, indexing="ij")
    h = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)])
    out = np.array([np.sqrt(1 - cos_out**2), 0.0, cos_out])
    along = np.einsum("i,iab->ab", out, h)
    to_light = 2 * along * h - out[:, None, None]
    good = (to_light[2] > 0) & (along > 0)
    cos_in = np.where(good, to_light[2], 1.0)
    f = coating_brdf(cos_in, cos_out, h[2], reflectance=1.0, specular=specular, roughness=roughness)
    element = np.sin(t) * (weight * np.pi / 4)[:, None] * 2 * np.pi / 720 * 4 * along
    return float((np.where(good, f * cos_in, 0.0) * element).sum())


@pytest.mark.slow
@pytest.mark.parametrize("roughness", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("specular", [0.0, 0.5, 1.0])
def test_a_coating_never_returns_more_than_it_gets(specular, roughness):
    shares = [directional_albedo(c, specular=specular, roughness=roughness) for c in (0.05, 0.3, 0.7, 1.0)]
    assert max(shares) <= 1.0 + 1e-4  # what the quadrature errs by where light grazes
    if specular == 0:
        assert shares == pytest.approx([1.0] * 4, rel=1e-4)
    if roughness == 0.05 and specular == 1:
        # nearly a mirror, seen from above: next to nothing is hidden by the facets
        assert shares[-1] == pytest.approx(1.0, abs=0.01)


def test_swapping_light_and_eye_changes_nothing():
    rng = np.random.default_rng(1)
    a, b, h = rng.uniform(0.01, 1, (3, 100))
    settings = {"reflectance": 0.7, "specular": 0.4, "roughness": 0.2}
    np.testing.assert_allclose(coating_brdf(a, b, h, **settings), coating_brdf(b, a, h, **settings))


def test_a_plain_coating_has_no_texture():
    plain = coating_of({}, BALL)
    assert plain.texture is None
    assert plain.reflectance == FLAT.per_group("membrane_albedo")
    # nothing shines through where nothing touches
    assert coating_of({"optics.coating_transmittance": 0.2, "optics.object_reflectance": 0.5}).texture is None


def test_markers_are_dots_of_the_stated_size_and_reflectance():
    changes = {
        "optics.marker_pitch_mm": 2.0,
        "optics.marker_diameter_mm": 0.8,
        "optics.marker_reflectance": 0.1,
    }
    found = coating_of(changes)
    albedo = FLAT.per_group("membrane_albedo")
    assert found.reflectance == pytest.approx(albedo)
    assert len(found.texture.values) == 3
    for group in range(3):
        for x, y in ((0.02, 0.02), (2.02, -3.98), (-5.98, 4.02)):
            assert texel(found.texture, x, y, group) * found.reflectance[group] == pytest.approx(
                0.1, rel=1e-5
            )
        assert texel(found.texture, 1.0, 1.0, group) == pytest.approx(1.0)
    # share of the area covered over whole periods
    rows, columns = found.texture.values.shape[1:]
    cell = found.texture.width_mm / columns
    periods = found.texture.values[0][
        rows // 2 - int(5 / cell) : rows // 2 + int(5 / cell),
        columns // 2 - int(5 / cell) : columns // 2 + int(5 / cell),
    ]
    dark = (1 - periods).mean() / (1 - 0.1 / albedo[0])
    assert dark == pytest.approx(np.pi * 0.4**2 / 4, rel=5e-3)


def test_markers_on_an_elastic_gel_go_where_the_skin_goes():
    """Under pure normal load too: an incompressible gel is squeezed out sideways."""
    changes = {"optics.marker_pitch_mm": 1.5, "optics.marker_diameter_mm": 0.5, "contact": LayerContact()}
    design = FLAT.replace(changes)
    press = Press(probe=parse("sphere:4"), depth_mm=0.7)
    surface = indent(design.elastomer, design.contact, press, area_mm=(12.0, 9.0), pitch_mm=0.05)
    found = coating(design, surface).texture
    rows, columns = found.values.shape[1:]
    cell = found.width_mm / columns
    x, y = np.meshgrid(
        (np.arange(columns) + 0.5 - columns / 2) * cell, (rows / 2 - np.arange(rows) - 0.5) * cell
    )
    dark = 1 - found.values[0]
    for at in ((1.5, 0.0), (0.0, 1.5), (-1.5, 1.5)):
        near = np.hypot(x - at[0], y - at[1]) < 0.7
        seen = [np.average(field[near], weights=dark[near]) for field in (x, y)]
        shift = [surface.sample(field, *np.array(at)[:, None])[0] for field in surface.sideways_mm]
        assert np.hypot(*shift) > 0.03
        assert np.subtract(seen, at) == pytest.approx(shift, abs=0.01)
    assert np.average(x, weights=dark * (np.hypot(x, y) < 0.7)) == pytest.approx(0.0, abs=1e-3)


def test_a_pressed_object_shines_through_where_it_touches():
    changes = {
        "optics.membrane_albedo": (0.2,),
        "optics.coating_transmittance": 0.5,
        "optics.object_reflectance": 0.8,
    }
    found = coating_of(changes, BALL)
    assert found.reflectance == pytest.approx((backed(0.2, 0.5, 0.8),) * 3)
    assert len(found.texture.values) == 1
    assert texel(found.texture, 2.0, 1.0) == pytest.approx(1.0)
    for x, y in ((-5.0, 1.0), (2.0, -4.0), (-14.0, 8.0)):
        assert texel(found.texture, x, y) * found.reflectance[0] == pytest.approx(0.2, rel=1e-5)


def test_a_black_object_takes_the_light_that_air_behind_the_coating_sends_back():
    changes = {
        "optics.membrane_albedo": (0.5,),
        "optics.coating_transmittance": 0.3,
        "optics.backing_reflectance": 0.53,
    }
    found = coating_of(changes, BALL)
    # once through, k times between coating and air, once through again: what the stated 0.5 holds of it
    alone = brentq(lambda a: a + sum(0.3 * 0.53 * (a * 0.53) ** k * 0.3 for k in range(200)) - 0.5, 0.0, 0.5)
    assert found.reflectance == pytest.approx((0.5,) * 3)
    assert texel(found.texture, 2.0, 1.0) * 0.5 == pytest.approx(alone, rel=1e-6)
    assert texel(found.texture, -5.0, 1.0) == pytest.approx(1.0)
    alike = coating_of(changes | {"optics.object_reflectance": 0.53}, BALL)
    assert alike.texture is None


def image_file(folder, values, name="albedo.png"):
    write_image(folder / name, np.repeat(values[:, :, None], 3, axis=2).astype(np.float32))


IMAGE = """
mixing = [[1.0], [0.5], [0.2]]
[optics]
light_path = "air"
membrane_albedo = [0.6]
[optics.albedo_image]
file = "albedo.png"
width_mm = 8.0
height_mm = 4.0
[[leds.groups]]
name = "white"
azimuth_deg = [90.0]
"""


def test_an_image_is_read_beside_the_design_and_then_part_of_it(tmp_path):
    values = np.linspace(0.1, 1.0, 8).reshape(2, 4)
    image_file(tmp_path, values)
    (tmp_path / "my.toml").write_text(IMAGE)
    design = load(tmp_path / "my.toml")
    np.testing.assert_allclose(design.optics.albedo_image.values, values, atol=5e-3)
    again = loads(dumps(design))  # the file is not looked for any more
    assert again == design
    assert again.digest == design.digest
    image_file(tmp_path, values[::-1])
    assert load(tmp_path / "my.toml").digest != design.digest


def test_an_image_lies_centred_with_its_first_row_at_plus_y(tmp_path):
    values = np.array([[1.0, 0.8, 0.6, 0.4], [0.2, 0.2, 0.2, 0.2]])
    image_file(tmp_path, values)
    (tmp_path / "my.toml").write_text(IMAGE)
    design = load(tmp_path / "my.toml")
    surface = indent(design.elastomer, design.contact, None, area_mm=(16.0, 12.0), pitch_mm=0.1)
    found = coating(design, surface)
    for (x, y), value in {(-3.0, 1.0): 1.0, (3.0, 1.0): 0.4, (-3.0, -1.0): 0.2, (9.0, 8.0): 0.4}.items():
        assert texel(found.texture, x, y) * found.reflectance[0] == pytest.approx(0.6 * value, abs=0.01)


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        ({"optics.gelcore_index": 0.9}, ("optics.gelcore_index", "greater than or equal to 1", "0.9")),
        ({"optics.elastomer_index": 0.99}, ("optics.elastomer_index", "greater than or equal to 1")),
        ({"optics.gelcore_absorption_per_mm": (-0.1,)}, ("optics.gelcore_absorption_per_mm", "-0.1 per mm")),
        (
            {"optics.elastomer_absorption_per_mm": (0.1, 0.2)},
            ("optics.elastomer_absorption_per_mm", "3 LED groups"),
        ),
        ({"optics.gelcore_scattering_per_mm": -1.0}, ("optics.gelcore_scattering_per_mm", "-1.0")),
        ({"optics.gelcore_anisotropy": 1.0}, ("optics.gelcore_anisotropy", "less than 1")),
        ({"optics.coating_specular": 1.1}, ("optics.coating_specular", "1.1")),
        ({"optics.coating_roughness": 0.0}, ("optics.coating_roughness", "0.05")),
        ({"optics.coating_transmittance": 0.6}, ("coating_transmittance", "membrane_albedo (0.506)", "0.6")),
        ({"optics.object_reflectance": 2.0}, ("optics.object_reflectance",)),
        ({"optics.housing_reflectance": (1.5,)}, ("optics.housing_reflectance", "1.5")),
        ({"optics.housing_reflectance": (0.5, 0.5)}, ("optics.housing_reflectance", "3 LED groups")),
        ({"optics.marker_pitch_mm": 0.4}, ("marker_pitch_mm", "marker_diameter_mm (0.5 mm)", "0.4 mm")),
        ({"optics.marker_reflectance": -0.1}, ("optics.marker_reflectance",)),
        ({"optics.albedo_image": {"width_mm": 1.0, "height_mm": 1.0}}, ("optics.albedo_image", "file")),
        (
            {"optics.albedo_image": {"file": "no.png", "width_mm": 1.0, "height_mm": 1.0}},
            ("optics.albedo_image", "no.png"),
        ),
        (
            {
                "optics.albedo_image": {
                    "pixels": "x",
                    "rows": 1,
                    "columns": 1,
                    "width_mm": 1.0,
                    "height_mm": 1.0,
                }
            },
            ("optics.albedo_image", "pixels"),
        ),
        ({"gelcore.ground_roughness": 0.0}, ("gelcore.ground_roughness",)),
        ({"gelcore.paint_reflectance": 1.0}, ("gelcore.paint_reflectance", "0.99")),
    ],
)
def test_a_value_that_cannot_be_is_refused_by_name(change, parts):
    with pytest.raises(DesignError) as caught:
        FLAT.replace(change)
    for part in parts:
        assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_image_too_large_is_refused(tmp_path):
    image_file(tmp_path, np.full((2, 1025), 0.5))
    (tmp_path / "my.toml").write_text(IMAGE)
    with pytest.raises(DesignError, match=r"my\.toml.*albedo_image.*at most 1024 pixels.*1025 x 2"):
        load(tmp_path / "my.toml")


def test_overrides_win_over_the_materials_figures():
    assert (FLAT.optics.core_index, FLAT.optics.gel_index) == (1.5403, 1.41)
    changed = FLAT.replace(
        {"optics.gelcore_index": 1.6, "optics.gelcore_absorption_per_mm": (0.01, 0.02, 0.03)}
    )
    assert changed.optics.core_index == 1.6
    assert changed.absorption_per_mm("gelcore") == (0.01, 0.02, 0.03)
    assert changed.absorption_per_mm("elastomer") == (0.0, 0.0, 0.0)
    glass = FLAT.replace({"optics.gelcore_material": "glass"})
    # 4 pi k / wavelength from SCHOTT's k = 1.0286e-8 at 460 nm and 9.5781e-9 at 500 nm, at 465 nm
    k = np.interp(465.0, (460.0, 500.0), (1.0286e-8, 9.5781e-9))
    assert glass.absorption_per_mm("gelcore")[2] == pytest.approx(4 * np.pi * k / 465e-6, rel=2e-3)
