"""The light probe without a renderer: closed forms of a mirror ball, lobes, comparison, outline, refusals."""

import json

import numpy as np
import pytest
from pydantic import ValidationError

import designlab as dl
from designlab.measurement.light_probe.ball import LightProbe, chromium
from designlab.measurement.light_probe.comparison import compare_light
from designlab.measurement.light_probe.lobes import Lobes, lobes
from designlab.measurement.light_probe.outline import Outline, find_outline, locate
from designlab.measurement.light_probe.panels import panels
from designlab.measurement.light_probe.polar import polar_map, unit_vectors
from designlab.measurement.light_probe.sight import probe_view
from designlab.measurement.light_probe.unwrap import unwrap
from designlab.sensor.camera import View
from designlab.sensor.optical_constants import fresnel_reflectance

FLAT = dl.preset("gelsight-2020-flat")
CORE = dl.preset("gelsight-2020-dome-core")
PLAIN = LightProbe(reflectance=1.0)


def unwrapped(image, design=FLAT, probe=PLAIN, view=None, **names):
    view = view or probe_view(design, probe, columns=image.shape[1])._replace(rows=image.shape[0])
    return unwrap(image, design=design, probe=probe, view=view, **names)


def directions(design=FLAT, probe=PLAIN, columns=300):
    view = probe_view(design, probe, columns=columns)
    return unwrapped(np.ones((view.rows, view.columns, 3)), design, probe, view), view


@pytest.mark.parametrize(
    ("polar_deg", "azimuth_deg"), [(5.0, 40.0), (60.0, 200.0), (85.0, 331.0), (120.0, 90.0)]
)
def test_a_distant_light_appears_where_the_ball_mirrors_it(polar_deg, azimuth_deg):
    """The normal halves the angle between light and eye: solved by least squares, not in the code's way."""
    from scipy.optimize import least_squares

    probe = LightProbe(diameter_mm=6.0, centre_mm=(1.5, -2.0), reflectance=1.0)
    light = unit_vectors(polar_deg, azimuth_deg)
    eye, middle = np.array(FLAT.camera.position_mm), np.array(probe.middle_mm)

    def bent(angles):
        n = unit_vectors(angles[0], angles[1])
        to_eye = eye - middle - 3.0 * n
        to_eye = to_eye / np.linalg.norm(to_eye)
        return 2 * (n @ to_eye) * n - to_eye - light

    found = least_squares(bent, [polar_deg / 2, azimuth_deg], xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    point = middle + 3.0 * unit_vectors(found[0], found[1])
    light_seen, _ = directions(probe=probe)
    row, column = light_seen.pixel_of(light)
    way = point - eye
    at_column, at_row = FLAT.camera.project(way[0], way[1], -way[2])
    part = light_seen.view
    assert column == pytest.approx((at_column - part.x_px) / part.width_px * part.columns - 0.5, abs=1e-4)
    assert row == pytest.approx((at_row - part.y_px) / part.height_px * part.rows - 0.5, abs=1e-4)
    # And the pixel next to it says the same direction, within its own size.
    nearest = light_seen.direction[round(float(row)), round(float(column))]
    assert np.degrees(np.arccos(nearest @ light)) < 1.5
    assert np.linalg.norm(light_seen.origin_mm[round(float(row)), round(float(column))] - point) < 0.05


def test_the_visible_disc_shows_all_directions_but_a_cone_behind_the_ball():
    """At the outline the ray goes straight on: what is missing is the cone of half the ball's own angle."""
    probe = LightProbe(diameter_mm=10.0, reflectance=1.0)
    light, _ = directions(probe=probe, columns=500)
    eye_mm = np.linalg.norm(np.array(FLAT.camera.position_mm) - probe.middle_mm)
    cosine = np.sqrt(1 - (5.0 / eye_mm) ** 2)
    assert light.solid_angle_sr.sum() == pytest.approx(2 * np.pi * (1 + cosine), rel=1e-3)
    assert light.whole


def test_seen_from_afar_every_pixel_has_the_same_solid_angle():
    """Mirror ball under parallel rays: 4 / r^2 of every mm2 of its picture (Debevec 1998)."""
    far = FLAT.replace({"camera.position_mm": (0.0, 0.0, 4000.0), "camera.horizontal_fov_deg": 1.1})
    light, _ = directions(far, columns=200)
    pixel_mm = light.rays.pitch_mm[0]
    inner = light.cosine > 0.2
    assert light.solid_angle_sr[inner] == pytest.approx(4 / 4.0 * pixel_mm**2, rel=6e-3)


def test_bundles_of_rays_widen_as_neighbouring_rays_do():
    light, _ = directions(columns=400)
    rows, columns = light.on_ball.shape
    row, column, far_mm = rows // 2 + 50, columns // 2 - 60, 11.0
    at = light.origin_mm + far_mm * light.direction
    across = (at[row, column + 1] - at[row, column - 1]) / 2
    down = (at[row + 1, column] - at[row - 1, column]) / 2
    area = abs(np.cross(across, down) @ light.direction[row, column])
    assert light.seen_sr(far_mm)[row, column] == pytest.approx(area / far_mm**2, rel=2e-3)


@pytest.mark.parametrize("design", [FLAT, CORE], ids=["air", "core"])
def test_pixels_lead_to_directions_and_back(design):
    probe = LightProbe(diameter_mm=3.0, lowest_mm=-2.0, centre_mm=(2.0, 1.0))
    light, _ = directions(design, probe, columns=120)
    inner = light.cosine > 0.1
    row, column = light.pixel_of(light.direction[inner])
    wanted = np.nonzero(inner)
    assert np.abs(row - wanted[0]).max() < 0.02
    assert np.abs(column - wanted[1]).max() < 0.02


def test_even_light_gives_an_even_map_whatever_the_ball_reflects():
    probe = LightProbe()
    view = probe_view(FLAT, probe, columns=160)
    light = directions(probe=probe, columns=160)[0]
    wavelengths = [group.wavelength_nm for group in FLAT.leds.groups]
    cosine = np.where(light.on_ball, light.cosine, 1.0)
    dimmed = np.zeros((view.rows, view.columns, 3))
    place = np.s_[: light.on_ball.shape[0], : light.on_ball.shape[1]]
    dimmed[place] = np.stack([fresnel_reflectance(cosine, chromium(w)) for w in wavelengths], axis=-1)
    even = polar_map(unwrapped(dimmed, probe=probe, view=view), step_deg=5)
    assert np.nanmax(np.abs(even.radiance - 1)) < 1e-3
    assert np.isfinite(even.radiance).mean() > 0.99


def test_chromium_reflects_as_published():
    """At normal incidence ((n - 1)^2 + k^2) / ((n + 1)^2 + k^2); all at grazing incidence."""
    n, k = 2.94, 3.33
    assert fresnel_reflectance(np.ones(1), chromium(521.0))[0] == pytest.approx(
        ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
    )
    assert fresnel_reflectance(np.full(1, 1e-9), chromium(521.0))[0] == pytest.approx(1.0)


def painted(light, view, spots):
    """Picture with round spots of light: (channel, polar, azimuth, radius in deg, radiance)."""
    image = np.zeros((*light.on_ball.shape, 3))
    for channel, polar, azimuth, radius_deg, radiance in spots:
        near = light.direction @ unit_vectors(polar, azimuth) > np.cos(np.radians(radius_deg))
        image[near & light.on_ball, channel] = radiance
    whole = np.zeros((view.rows, view.columns, 3))
    whole[: image.shape[0], : image.shape[1]] = image
    return whole


def test_a_lobe_has_the_direction_size_and_flux_of_its_light():
    light, view = directions(columns=500)
    found = lobes(unwrapped(painted(light, view, [(1, 60.0, 120.0, 8.0, 2.0)]), view=view))
    assert isinstance(found, Lobes)
    (lobe,) = found.lobes
    cap_sr = 2 * np.pi * (1 - np.cos(np.radians(8.0)))
    assert lobe.channel == "G"
    assert (lobe.polar_deg, lobe.azimuth_deg) == pytest.approx((60.0, 120.0), abs=0.05)
    assert lobe.solid_angle_sr == pytest.approx(cap_sr, rel=0.01)
    assert (lobe.flux, lobe.peak) == pytest.approx((2 * cap_sr, 2.0), rel=0.01)
    # A disc of radius r has the second moments of a square of side sqrt(3) r.
    assert lobe.width_deg == pytest.approx((np.sqrt(3) * 8.0,) * 2, rel=0.02)
    assert not lobe.cut
    assert found.total["G"] == pytest.approx(2 * cap_sr, rel=0.01)
    assert json.loads(found.to_json())["lobes"][0]["pixels"] == lobe.pixels


def test_a_lobe_at_the_outline_is_said_to_be_cut():
    light, view = directions(columns=300)
    (lobe,) = lobes(unwrapped(painted(light, view, [(0, 150.0, 0.0, 28.0, 1.0)]), view=view)).lobes
    assert lobe.cut


@pytest.mark.slow
def test_two_probes_differ_by_what_was_changed():
    light, view = directions(columns=300)
    spots = [(0, 60.0, 90.0, 7.0, 1.0), (1, 60.0, 210.0, 7.0, 1.0), (2, 60.0, 330.0, 7.0, 1.0)]
    moved = [(0, 63.0, 90.0, 7.0, 1.0), (1, 60.0, 210.0, 7.0, 1.5), (2, 60.0, 30.0, 7.0, 1.0)]
    before, after = (unwrapped(painted(light, view, s), view=view) for s in (spots, moved))
    same = compare_light(before, before, step_deg=2)
    assert same.error == {"R": 0.0, "G": 0.0, "B": 0.0}
    assert not same.missing
    assert not same.extra
    found = compare_light(after, before, step_deg=2)
    red, green = found.lobes
    assert (red.apart_deg, red.polar_change_deg) == pytest.approx((3.0, 3.0), abs=0.1)
    assert (red.solid_angle, red.flux) == pytest.approx((1.0, 1.0), rel=0.03)
    assert green.apart_deg == pytest.approx(0.0, abs=1e-6)
    assert (green.flux, found.scale["G"]) == pytest.approx((1.5, 1 / 1.5))
    assert (found.error["G"], found.scaled_error["G"]) == pytest.approx((0.5, 0.0), abs=1e-6)
    assert [lobe.channel for lobe in found.missing + found.extra] == ["B", "B"]
    assert json.loads(found.to_json())["lobes"][0]["channel"] == "R"


def rim_picture(probe, view):
    """Dark ball before a bright ground, its outline antialiased: rays that pass within its radius."""
    from designlab.simulation.optics.viewing_rays import rays

    fine = view._replace(columns=4 * view.columns, rows=4 * view.rows)
    looks = rays(FLAT, fine)
    upward = np.stack([looks.slope_x, looks.slope_y, np.ones_like(looks.x_mm)], axis=-1)
    upward /= np.linalg.norm(upward, axis=-1, keepdims=True)
    away = np.stack([looks.x_mm, looks.y_mm, 0 * looks.x_mm], axis=-1) - probe.middle_mm
    miss = np.linalg.norm(np.cross(away, upward), axis=-1)
    return 1.0 - 0.8 * (miss < probe.radius_mm).reshape(view.rows, 4, view.columns, 4).mean(axis=(1, 3))


def test_the_ball_is_found_by_its_outline():
    probe = LightProbe(diameter_mm=4.0, centre_mm=(1.3, -0.8), lowest_mm=0.5)
    view = View(996.0, 772.0, 600.0, 500.0, 300, 250)
    image = rim_picture(probe, view) + np.random.default_rng(1).normal(0, 0.02, (250, 300))
    outline = find_outline(image)
    assert outline.share > 0.9
    found = locate(outline, design=FLAT, view=view, diameter_mm=4.0, lowest_mm=0.5)
    assert found.centre_mm == pytest.approx((1.3, -0.8), abs=0.01)
    free = locate(outline, design=FLAT, view=view, diameter_mm=4.0)
    assert free.centre_mm == pytest.approx((1.3, -0.8), abs=0.01)
    assert free.lowest_mm == pytest.approx(0.5, abs=0.3)  # 0.3 mm is 0.8 % of the way to the camera
    with pytest.raises(
        ValueError, match=r"diameter_mm: a ball of 5 mm at lowest_mm = 0.5 mm must touch .* within 3%"
    ):
        locate(outline, design=FLAT, view=view, diameter_mm=5.0, lowest_mm=0.5)
    outside = Outline(outline.column + 200, outline.row, outline.radius_px, 1.0)
    with pytest.raises(ValueError, match="outline: must lie within the picture of 300 x 250 px"):
        locate(outside, design=FLAT, view=view, diameter_mm=4.0)


def test_no_ball_is_found_where_there_is_none():
    noise = np.random.default_rng(2).normal(0.5, 0.05, (60, 80))
    for image in (noise, np.ones((60, 80)), np.linspace(0, 1, 80) * np.ones((60, 1))):
        with pytest.raises(ValueError, match="image: a ball's outline must show over at least 35%"):
            find_outline(image)
    with pytest.raises(ValueError, match="radius_px: must run from at least 4 to at most 80 px, got 2 to 50"):
        find_outline(noise, radius_px=(2, 50))


@pytest.mark.parametrize(
    ("probe", "design", "text"),
    [
        ({"centre_mm": (60.0, 0.0)}, FLAT, r"centre_mm: the ball must lie in the camera's picture"),
        ({"lowest_mm": 40.0}, FLAT, r"light_probe.lowest_mm: .*below the camera at 41.05 mm, is at 44 mm"),
        ({"diameter_mm": 30.0}, FLAT, r"light_probe.diameter_mm: must be below [0-9.]+ mm, .* got 30 mm"),
        ({}, CORE, r"light_probe.lowest_mm: must be at most -2 mm, .*diameter_mm = 4 mm.* got 0 mm"),
    ],
)  # fmt: skip
def test_a_ball_that_does_not_fit_is_refused(probe, design, text):
    view = View(1000.0, 800.0, 400.0, 400.0, 64, 64)
    with pytest.raises(ValueError, match=text):
        unwrap(np.zeros((64, 64, 3)), design=design, probe=LightProbe(**probe), view=view)


def test_pictures_that_do_not_fit_are_refused():
    view = probe_view(FLAT, PLAIN, columns=64)
    with pytest.raises(
        ValueError, match="image: must have the view's 64 rows and 64 columns, has shape 32 x 64 x 3"
    ):
        unwrap(np.zeros((32, 64, 3)), design=FLAT, probe=PLAIN, view=view)
    with pytest.raises(ValueError, match="names: one for each of the image's 2 channels, got R, G, B"):
        unwrap(np.zeros((64, 64, 2)), design=FLAT, probe=PLAIN, view=view)
    beside = View(0.0, 0.0, 200.0, 200.0, 64, 64)
    with pytest.raises(ValueError, match="centre_mm: the picture must show at least 8 x 8 px of the ball"):
        unwrap(np.zeros((64, 64, 3)), design=FLAT, probe=PLAIN, view=beside)
    light, _ = directions(columns=64)
    with pytest.raises(ValueError, match="threshold: must lie between 0 and 1, got 1"):
        lobes(light, threshold=1.0)
    with pytest.raises(ValueError, match=r"step_deg: must lie between 0.05 and 30 deg, got 0 deg"):
        polar_map(light, step_deg=0.0)
    with pytest.raises(ValueError, match="light_path: must be 'air'"):
        panels(CORE, PLAIN, view)
    with pytest.raises(ValidationError, match="greater than 0"):
        LightProbe(diameter_mm=0.0)


def test_a_panel_that_the_picture_cuts_or_the_ball_hides_is_named():
    view = probe_view(FLAT, PLAIN, columns=64)
    half = view._replace(height_px=view.height_px / 2)  # upper half: red shows, green and blue do not
    red, _, green, *_ = panels(FLAT, PLAIN, half).panels
    assert (red.visible, red.hidden_by) == (1.0, ())
    assert (green.visible, green.hidden_by) == (0.0, ("picture",))
    sunken = FLAT.replace({"leds.height_mm": -40.0, "leds.radius_mm": 0.5, "leds.tilt_deg": -80.0})
    behind = panels(sunken, PLAIN, view).panels[0]
    assert behind.visible < 1.0
    assert "ball" in behind.hidden_by


def test_a_board_between_ball_and_panel_hides_it():
    """Two rows at one azimuth, one group's boards before the other's: the nearer ones are seen alone."""
    groups = [{"name": n, "azimuth_deg": [0.0], "flux_mw": 1.0} for n in ("a", "b", "c")]
    three = FLAT.replace({"leds.groups": groups, "leds.tilt_deg": 0.0, "leds.height_mm": 5.0})
    from designlab.measurement.light_probe.panels import blocked
    from designlab.sensor.led_mounting import front_corners, seated

    board = front_corners(seated(three)[0][0])
    start = np.zeros((1, 3))
    middle = board.mean(axis=0)
    assert blocked(start, np.array([2 * middle]), board[None])[0]
    assert not blocked(start, np.array([0.9 * middle]), board[None])[0]
    assert not blocked(start, np.array([2 * middle * (1, 1, 3)]), board[None])[0]


def test_the_figure_shows_light_where_it_comes_from(tmp_path):
    """Red light from the right and blue from the left end up there, in these colours."""
    from PIL import Image

    from designlab.report.figures import write_figure
    from designlab.report.plots import light_map

    light, view = directions(columns=120)
    spots = [(0, 60.0, 0.0, 15.0, 1.0), (2, 60.0, 180.0, 15.0, 1.0)]
    found = unwrapped(painted(light, view, spots), view=view)
    on_map = polar_map(found, step_deg=3, furthest_deg=120)
    write_figure(light_map(on_map, lobes(found), traced=panels(FLAT, PLAIN, view)), tmp_path / "a.png")
    pixels = np.asarray(Image.open(tmp_path / "a.png").convert("RGB")).astype(int)[:, :638]
    red = np.argwhere((pixels[..., 0] > 200) & (pixels[..., 2] < 120))
    blue = np.argwhere((pixels[..., 2] > 200) & (pixels[..., 0] < 120))
    assert red[:, 1].mean() > 400 > 240 > blue[:, 1].mean()
    assert abs(red[:, 0].mean() - blue[:, 0].mean()) < 12
