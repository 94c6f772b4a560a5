"""Light straight through core and gel: against Snell's law in closed form, and against photons."""

import numpy as np
import pytest

from designlab.design import preset
from designlab.simulate import Simulator

pytestmark = pytest.mark.usefixtures("backend")


def straight(design):
    """Straight light of every group, the undeformed scene, and its membrane."""
    from designlab.render.refracted import Refracted, images
    from designlab.scene import build

    simulator = Simulator(design, columns=24, samples=16, seed=1)
    untouched = simulator.surface(None)
    scene = build(design, untouched, simulator.view)
    return [Refracted(untouched, own) for own in images(scene)], scene


def through_a_plane(design, scene, group, x, y):
    """Irradiance at points of the membrane z = 0 by one group within the core, above a plane interface.

    Light goes from each point of a face to a point of the membrane in the upright plane through both. There
    the angles follow from Snell's law; the solid angle by area from how far apart neighbouring rays land.
    """
    core, gel = design.optics.core_index, design.optics.gel_index
    thick = design.elastomer.thickness_mm
    found = np.zeros_like(x)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    for light in (light for light in scene.lights if light.group == group):
        for u, v, w in (
            (u, v, a * b / 4)
            for u, a in zip(nodes, weights, strict=True)
            for v, b in zip(nodes, weights, strict=True)
        ):
            start = np.array(light.centre_mm) + u * light.half_width_mm * np.array(light.across)
            start = start + v * light.half_height_mm * np.array(light.down)
            away = np.hypot(x - start[0], y - start[1])
            low, high = np.zeros_like(away), np.full_like(away, np.pi / 2 - 1e-9)
            for _ in range(60):
                angle = (low + high) / 2
                sine = np.minimum(core / gel * np.sin(angle), 1.0)
                lands = (start[2] - thick) * np.tan(angle) + thick * sine / np.sqrt(
                    np.maximum(1 - sine**2, 1e-18)
                )
                low, high = np.where(lands < away, angle, low), np.where(lands < away, high, angle)
            cosine, cosine_gel = np.cos(angle), np.sqrt(1 - sine**2)
            slope = (start[2] - thick) / cosine**2 + thick * core / gel * cosine / cosine_gel**3
            across = (core * cosine - gel * cosine_gel) / (core * cosine + gel * cosine_gel)
            along = (gel * cosine - core * cosine_gel) / (gel * cosine + core * cosine_gel)
            passed = 1 - (across**2 + along**2) / 2
            way = np.stack(
                [(x - start[0]) / away * sine * gel / core, (y - start[1]) / away * sine * gel / core]
            )
            leaving = np.tensordot(light.normal, np.stack([*way, -cosine]), axes=1)
            polar = np.degrees(np.arccos(np.clip(leaving, 0.0, 1.0)))
            density = light.profile.share_per_sr(polar, np.zeros_like(polar))
            found += light.flux_mw * w * density * passed * np.sin(angle) / (away * slope)
    return found


def test_light_through_a_plane_interface_is_snells():
    # Five segments of path: nothing but the interface is met on the way.
    design = preset("gelsight-2020-flat-core").replace({"optics.path_length": 5})
    lights, scene = straight(design)
    x, y = np.linspace(-7.3, 7.3, 5), np.linspace(-5.6, 5.6, 5)
    for group, light in enumerate(lights):
        exact = through_a_plane(design, scene, group, *np.meshgrid(x, y))
        np.testing.assert_allclose(light.irradiance_at(x, y), exact, rtol=4e-3, atol=1e-3 * exact.max())


@pytest.mark.parametrize("name", ["gelsight-2020-flat-core", "gelsight-2020-dome-core"])
def test_photons_bring_as_much_straight_light(name):
    import drjit as dr
    import mitsuba as mi

    from designlab.render import photons

    half_x, half_y, columns, rows = 8.0, 6.0, 8, 6
    lights, scene = straight(preset(name))
    loaded = photons.load(scene, 0)
    table = dr.zeros(mi.Float, columns * rows)

    def record(arrival, active):
        column = mi.Int32(dr.floor((arrival.at.p.x + half_x) * columns / (2 * half_x)))
        row = mi.Int32(dr.floor((arrival.at.p.y + half_y) * rows / (2 * half_y)))
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        share = arrival.power * dr.abs(arrival.at.n.z)
        dr.scatter_add(table, share, mi.UInt32(row * columns + column), active & inside & arrival.straight)

    photons.trace(scene, group=0, photons=4_000_000, seed=5, record=record, loaded=loaded)
    size = 2 * half_x / columns, 2 * half_y / rows
    counted = np.asarray(table).reshape(rows, columns) / (size[0] * size[1])
    fine_x, fine_y = (np.linspace(-h, h, 40 * n + 1) for h, n in ((half_x, columns), (half_y, rows)))
    light = lights[0].irradiance_at((fine_x[1:] + fine_x[:-1]) / 2, (fine_y[1:] + fine_y[:-1]) / 2)
    looked = light.reshape(rows, 40, columns, 40).mean(axis=(1, 3))
    # About 1000 photons a square in the mean.
    np.testing.assert_allclose(looked, counted, rtol=0.02, atol=0.03 * counted.mean())
    assert looked.mean() == pytest.approx(counted.mean(), rel=5e-3)


def test_few_samples_cost_accuracy_only_at_edges():
    design = preset("gelsight-2020-flat-core")
    coarse, fine = (
        Simulator(design, columns=32, samples=samples, seed=3).frame(None).basis for samples in (16, 128)
    )
    assert np.abs(coarse / fine - 1).mean() < 0.02
