"""Rendered light probes against LED panels mirrored by Fermat's principle: no renderer, no unwrapping."""

import numpy as np
import pytest
from scipy.optimize import brentq, minimize

import designlab as dl
from designlab.measurement.light_probe.ball import LightProbe
from designlab.measurement.light_probe.comparison import compare_light
from designlab.measurement.light_probe.lobes import lobes
from designlab.measurement.light_probe.panels import panels
from designlab.measurement.light_probe.picture import light_probe
from designlab.measurement.light_probe.polar import polar_map
from designlab.sensor.camera import View
from designlab.sensor.design import preset
from designlab.simulation.simulator import RenderFailed
from geometries.leds import emitters

pytestmark = [pytest.mark.physics, pytest.mark.renders]

CENTRE_DEG, SOLID_ANGLE = 0.5, 0.02  # what is asked for
BALLS = {
    "gelsight-2020-flat": LightProbe(),
    "gelsight-2020-dome": LightProbe(),
    "flat, beside the axis, larger": LightProbe(diameter_mm=6.0, centre_mm=(2.0, -1.5), lowest_mm=-1.0),
}


@pytest.fixture(scope="module", params=BALLS)
def case(request, backend):
    """Design, picture and lobes."""
    name, probe = request.param, BALLS[request.param]
    design = preset(name if name in ("gelsight-2020-flat", "gelsight-2020-dome") else "gelsight-2020-flat")
    picture = light_probe(design, probe, columns=400, samples=16, seed=1)
    return design, probe, picture, lobes(picture.unwrap())


def mirrored(point, eye, probe):
    """Point of the ball on the shortest way from a point over the ball to the eye (Fermat)."""
    middle = np.array(probe.middle_mm)

    def surface(angles):
        t, a = angles
        return middle + probe.radius_mm * np.array([np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)])

    def way(angles):
        at = surface(angles)
        return np.linalg.norm(point - at) + np.linalg.norm(eye - at)

    azimuth = np.arctan2(*(point - middle)[1::-1])
    found = minimize(way, [0.6, azimuth], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-13})
    return surface(found.x)


def polygon_sr(corners, start):
    """Solid angle of a polygon seen from a point: signed triangles (van Oosterom, Strackee)."""
    units = corners - start
    units = units / np.linalg.norm(units, axis=1, keepdims=True)
    a, b, c = units.mean(axis=0), units, np.roll(units, -1, axis=0)
    a = a / np.linalg.norm(a)
    return abs(2 * np.arctan2(np.cross(b, c) @ a, 1 + b @ a + (b * c).sum(axis=1) + c @ a).sum())


def corners_of(face):
    across = face.half_width_mm * np.array(face.across)
    down = face.half_height_mm * np.array(face.down)
    return np.array(
        [np.array(face.centre_mm) + i * across + j * down for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    )


def seen_sr(face, eye, probe):
    """Solid angle of a rectangle, each part of it seen from the point of the ball that mirrors it."""
    first, second, _, last = corners_of(face)
    total = 0.0
    for i in range(6):
        for j in range(2):
            corner = first + (second - first) * i / 6 + (last - first) * j / 2
            part = corner + np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) @ [
                (second - first) / 6,
                (last - first) / 2,
            ]
            total += polygon_sr(part, mirrored(part.mean(axis=0), eye, probe))
    return total


def nearest(found, group, direction):
    return max(found.of(group), key=lambda lobe: np.dot(lobe.direction, direction))


def apart_deg(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), np.dot(a, b)))


def test_every_panel_is_seen_where_and_as_large_as_it_is(case):
    """Direction and solid angle of every panel, seen from the point of the ball that mirrors its middle."""
    design, probe, _, found = case
    eye = np.array(design.camera.position_mm)
    assert len(found.lobes) == len(emitters(design.leds)) == 6
    for face in emitters(design.leds):
        at = mirrored(np.array(face.centre_mm), eye, probe)
        towards = np.array(face.centre_mm) - at
        lobe = nearest(found, design.group_names[face.group], towards / np.linalg.norm(towards))
        off_deg = apart_deg(np.array(lobe.source_mm) - at, towards)
        mean_deg, share = apart_deg(lobe.direction, towards), lobe.seen_sr / seen_sr(face, eye, probe)
        from_middle = lobe.seen_sr / polygon_sr(corners_of(face), at)
        print(
            f"{lobe.channel} panel at {lobe.polar_deg:.2f}, {lobe.azimuth_deg:.2f} deg: middle off by "
            f"{off_deg:.3f} deg (mean of all points {mean_deg:.3f}), {lobe.seen_sr:.5f} sr, "
            f"{share - 1:+.2%} (seen from the middle's point alone {from_middle - 1:+.2%})"
        )
        assert not lobe.cut
        assert off_deg < CENTRE_DEG
        if probe == LightProbe():
            # Near a large ball what many points see differs from what the middle one alone would.
            assert mean_deg < CENTRE_DEG
            assert from_middle == pytest.approx(1.0, abs=SOLID_ANGLE)
        assert share == pytest.approx(1.0, abs=SOLID_ANGLE)


def test_the_map_of_directions_has_the_outline_of_every_panel(case):
    """Points around each panel, mirrored one by one, enclose the directions that the lobe covers."""
    design, probe, _, found = case
    eye = np.array(design.camera.position_mm)
    for face in emitters(design.leds)[::3]:
        corners = corners_of(face)
        steps = (8, 2, 8, 2)
        outline = np.concatenate([
            a + (b - a) * (np.arange(n) / n)[:, None]
            for a, b, n in zip(corners, np.roll(corners, -1, axis=0), steps, strict=True)
        ])  # fmt: skip
        at = np.array([mirrored(point, eye, probe) for point in outline])
        towards = outline - at
        lobe = nearest(found, design.group_names[face.group], towards.mean(axis=0))
        assert lobe.solid_angle_sr == pytest.approx(polygon_sr(towards, np.zeros(3)), rel=SOLID_ANGLE)


def test_lobes_have_the_radiance_of_the_panels(case):
    """Flux over pi and area, once the reflectance of chromium is taken off."""
    design, _, _, found = case
    area = sum(face.area_mm2 for face in emitters(design.leds) if face.group == 0)
    for lobe in found.lobes:
        assert lobe.peak == pytest.approx(1 / (np.pi * area), rel=2e-3)


def test_nothing_hides_a_panel_and_the_library_mirrors_them_alike(case):
    design, probe, picture, found = case
    for panel in panels(design, probe, picture.view).panels:
        assert (panel.visible, panel.hidden_by) == (1.0, ())
        lobe = nearest(found, panel.group, panel.direction)
        assert apart_deg(panel.direction, lobe.direction) < 0.02
        assert lobe.solid_angle_sr == pytest.approx(panel.solid_angle_sr, rel=0.01)
        assert lobe.seen_sr == pytest.approx(panel.seen_sr, rel=0.01)
        # Free of the grain of pixels at the edge:
        assert lobe.flux / lobe.peak == pytest.approx(panel.solid_angle_sr, rel=2e-3)


def test_the_map_keeps_the_light(case):
    light = case[2].unwrap()
    on_map = polar_map(light, step_deg=2.0, furthest_deg=180.0)
    by_pixel = np.nansum(light.radiance * light.solid_angle_sr, axis=(1, 2))
    by_cell = np.nansum(on_map.radiance * on_map.solid_angle_sr, axis=(1, 2))
    assert by_cell == pytest.approx(by_pixel, rel=5e-3)


def test_a_panel_in_the_wrong_place_is_found(backend):
    """Panels 2 mm further out: compared with the model, every lobe sits where the moved panel is mirrored."""
    model, built = (
        preset("gelsight-2020-flat"),
        preset("gelsight-2020-flat").replace({"leds.radius_mm": 14.59}),
    )
    pictures = [light_probe(design, columns=300, samples=16, seed=1) for design in (built, model)]
    found = compare_light(*(picture.unwrap() for picture in pictures), step_deg=2)
    wanted = [panels(design, pictures[0].probe, pictures[0].view).panels for design in (built, model)]
    assert len(found.lobes) == 6
    assert not found.missing
    assert not found.extra
    for new, old in zip(*wanted, strict=True):
        difference = min(
            found.lobes, key=lambda d: abs(d.polar_deg - old.polar_deg) + 9 * (d.channel != old.group)
        )
        assert difference.polar_change_deg == pytest.approx(new.polar_deg - old.polar_deg, abs=0.05)
        assert difference.seen == pytest.approx(new.seen_sr / old.seen_sr, rel=0.02)


def test_a_rough_ball_keeps_the_middles_of_lobes(backend):
    """Its lobes are wide; a view that shows one side of the ball shows the lobe of that side alone."""
    design, probe = preset("gelsight-2020-flat"), LightProbe(roughness=0.02)
    picture = light_probe(design, probe, columns=200, samples=64, seed=1)
    sharp, rough = (
        lobes(one.unwrap(), threshold=0.3)
        for one in (light_probe(design, columns=200, samples=16, seed=1), picture)
    )
    for group in design.group_names:
        middles = [
            sum(lobe.flux * np.array(lobe.direction) for lobe in found.of(group)) for found in (sharp, rough)
        ]
        assert apart_deg(*middles) < 2.0
        assert rough.of(group)[0].peak < sharp.of(group)[0].peak
    half = picture.view._replace(height_px=picture.view.height_px / 2, rows=100)
    upper = light_probe(design, probe, samples=16, seed=1, view=half).unwrap()
    assert not upper.whole
    assert [panel.visible > 0 for panel in panels(design, probe, half).panels] == [True, True] + 4 * [False]


@pytest.mark.slow
def test_light_of_bonded_panels_through_core_and_liquid(backend):
    """Plane core: Snell's law bends what the ball sees, and radiance over index squared is kept."""
    design, probe = preset("gelsight-2020-flat-core"), LightProbe(lowest_mm=-3.0, immersed=True)
    found = lobes(light_probe(design, probe, columns=300, samples=64, seed=1).unwrap())
    area = sum(face.area_mm2 for face in emitters(design.leds) if face.group == 0)
    gel, core = design.optics.gel_index, design.optics.core_index
    for lobe in found.lobes:
        # Fresnel's loss at the face is 0.2 % steeply and 4 % at the most slanted.
        kept = lobe.peak * np.pi * area * (core / gel) ** 2
        assert 0.95 < kept < 1.003
        start = np.array(lobe.origin_mm)
        gap = design.elastomer.thickness_mm - start[2]
        angles = []
        for face in (f for f in emitters(design.leds) if design.group_names[f.group] == lobe.channel):
            way = np.array(face.centre_mm) - start
            across, rise = np.hypot(*way[:2]), face.centre_mm[2] - design.elastomer.thickness_mm

            def beside(sine, across=across, rise=rise, gap=gap):
                inner = sine * gel / core
                return gap * sine / np.sqrt(1 - sine**2) + rise * inner / np.sqrt(1 - inner**2) - across

            angles.append(np.degrees(np.arcsin(brentq(beside, 0.0, 1 - 1e-12))))
        assert min(abs(lobe.polar_deg - angle) for angle in angles) < CENTRE_DEG
    assert len(found.lobes) == 6


def test_a_plane_core_keeps_light_from_its_sides(backend):
    """Total reflection: from a vertical side no light leaves the plane face into air."""
    with pytest.raises(RenderFailed, match=r"immersed"):
        light_probe(dl.preset("default"), LightProbe(lowest_mm=-3.0), columns=24, samples=4, seed=1)


def test_pictures_repeat_and_show_what_was_asked(backend):
    design = preset("gelsight-2020-flat")
    view = View(1000.0, 850.0, 400.0, 300.0, 80, 60)
    first, again = (light_probe(design, samples=4, seed=3, view=view) for _ in range(2))
    assert first.basis.shape == (3, 60, 80)
    assert np.array_equal(first.basis, again.basis)
    assert first.mixed[..., 2] == pytest.approx(862.4 * first.basis[2])
