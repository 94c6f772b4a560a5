"""The made data sets: layout, poses as a lab states them, hidden sensors, photographs, pooled figures."""

import numpy as np
import pytest

from designlab.measurement import Measurement, load_measurement, write_measurement
from designlab.measurement.compare import compare_model
from designlab.sensor.design import preset
from designlab.simulation.imaging import Capture, noise_sigma
from designlab.simulation.optics.viewing_rays import rays
from designlab.validation.paper_2020.accuracy import error_shares
from designlab.validation.paper_2020.datasets import SIGMA, around, crop_around, dataset_1, dataset_2, stated
from designlab.validation.paper_2020.hidden import hidden
from designlab.validation.paper_2020.photograph import photograph
from designlab.validation.paper_2020.recovery import INTERVAL, summary, truths

FLAT, DOME = preset("gelsight-2020-flat"), preset("gelsight-2020-dome")


class TestLayout:
    def test_the_sets_have_the_papers_numbers(self):
        first = [*dataset_1(FLAT, seed=1), *dataset_1(DOME, seed=2)]
        assert len(first) == 48
        assert {frame.probe.partition(":")[0] for frame in first} == {"sphere", "triangle", "star"}
        second = dataset_2(FLAT, seed=1)
        assert [frame.probe.partition(":")[0] for frame in second].count("sphere") == 10
        assert [frame.probe.partition(":")[0] for frame in second].count("triangle") == 6

    def test_two_presses_are_fitted_and_stand_apart_from_all_others(self):
        frames = [*dataset_1(FLAT, seed=1), *dataset_2(FLAT, seed=1)]
        fitted = [frame for frame in frames if frame.split == "train"]
        assert [frame.file for frame in fitted] == ["sphere-at-1.exr", "triangle-at-1.exr"]
        places = {frame.centre_mm for frame in frames if frame.split == "final"}
        assert not places & {frame.centre_mm for frame in fitted}

    def test_a_crop_is_around_its_point_and_on_the_sensor(self):
        x, y, *_ = crop_around(FLAT, (2.0, -1.5), 600)
        view = FLAT.camera.full_view()._replace(
            x_px=float(x), y_px=float(y), width_px=600.0, height_px=600.0, columns=3, rows=3
        )
        middle = rays(FLAT, view)
        assert abs(middle.x_mm[1, 1] - 2.0) < 0.15
        assert abs(middle.y_mm[1, 1] + 1.5) < 0.15
        corner = crop_around(FLAT, (-90.0, 90.0), 600)
        assert corner[:2] == (0, 0)

    def test_stated_poses_are_off_by_their_doubt(self):
        frames = dataset_2(FLAT, seed=1, balls=150, triangles=150)
        off = [
            (b.centre_mm[0] - a.centre_mm[0], b.depth_mm - a.depth_mm)
            for a, b in zip(frames, stated(frames, seed=4), strict=True)
        ]
        x, depth = np.std(off, axis=0)
        assert x == pytest.approx(SIGMA.centre_mm, rel=0.15)
        assert depth == pytest.approx(SIGMA.depth_mm, rel=0.15)


@pytest.mark.renders
class TestHidden:
    def test_it_differs_from_its_design_where_a_fit_must_find_it(self):
        true = hidden(FLAT, seed=3)
        assert true.design.digest != FLAT.digest
        for group, own in zip(true.design.leds.groups, FLAT.leds.groups, strict=True):
            assert 0.3 < group.flux_mw / own.flux_mw < 3.0
            assert group.flux_mw != own.flux_mw
        changed = {"leds", "optics", "contact", "camera", "mixing", "name", "parent"}
        for name in set(type(FLAT).model_fields) - changed:
            assert getattr(true.design, name) == getattr(FLAT, name)
        assert hidden(FLAT, seed=3).digest == true.digest
        assert hidden(FLAT, seed=4).digest != true.digest

    def test_truths_hold_the_product_of_power_reflectance_and_exposure(self):
        true = hidden(FLAT, seed=3)
        known = truths(true, dataset_2(FLAT, seed=1, balls=1, triangles=0))
        design = true.design
        expected = (
            design.camera.exposure
            * design.mixing_matrix[1, 1]
            * design.leds.groups[1].flux_mw
            * design.optics.membrane_albedo[1]
        )
        assert known["product.G.green"] == pytest.approx(expected, rel=1e-12)
        assert "sphere-at-1.exr.depth_mm" in known


@pytest.fixture(scope="module")
def taken():
    true = hidden(FLAT, seed=5)
    press = dataset_2(FLAT, seed=5, balls=1, triangles=0)
    frames = [*around(FLAT, light_probe=False), *press]
    return true, *photograph(true, frames, samples=16, seed=2, binned=15)


@pytest.mark.renders
class TestPhotograph:
    def test_dark_frames_hold_the_floor_and_the_noise_of_the_camera(self, taken):
        true, _, pictures = taken
        dark = np.stack([pictures["dark-0.exr"], pictures["dark-1.exr"]])
        camera, floor = true.design.camera, np.array(list(true.effects[0].values.values()))
        sigma = noise_sigma(np.zeros(3), Capture(camera, binned=225.0))
        count = dark[..., 0].size
        assert (
            np.abs(dark.mean(axis=(0, 1, 2)) - floor - camera.black_level).max()
            < 4 * sigma.max() / count**0.5
        )
        np.testing.assert_allclose(dark.std(axis=(0, 1, 2)), sigma, rtol=0.08)

    def test_the_true_model_predicts_them(self, taken, tmp_path):
        """At the true pose what is left is noise: of the camera, and of tracing in either renderer."""
        true, frames, pictures = taken
        measurement = Measurement(sensor="gelsight-2020-flat", response="linear", frames=tuple(frames))
        made = load_measurement(write_measurement(measurement, pictures, tmp_path / "m"))
        assert compare_model(true, made, seed=0).to_json()["snr_db"] > 30

    def test_a_light_probe_is_exposed_to_its_mirrored_leds(self):
        true = hidden(FLAT, seed=5)
        (probe,) = [frame for frame in around(FLAT, light_probe=True) if frame.kind == "light_probe"]
        (frame,), pictures = photograph(true, [probe], samples=4, seed=1, binned=8)
        assert frame.exposure < 0.2
        assert 0.4 < pictures[frame.file].max() < 0.9


class TestFigures:
    def test_shares_of_an_error_that_is_a_quadratic_field_or_stands_on_edges(self):
        row, column = np.indices((40, 50)) / 40.0
        edges = np.zeros((40, 50), dtype=bool)
        edges[::7] = True
        real = np.zeros((40, 50, 3))
        field = np.stack([1 + row, column**2, row * column], axis=-1)
        assert error_shares(field, real, edges)["smooth"] == pytest.approx(1.0)
        noise = np.random.default_rng(0).standard_normal((40, 50, 3)) * edges[..., None]
        found = error_shares(noise, real, edges)
        assert found["edges"] > 0.9
        assert sum(found.values()) == pytest.approx(1.0)

    def test_coverage_and_errors_are_pooled(self):
        random = np.random.default_rng(1)
        repeats = []
        for _ in range(200):
            draws = random.standard_normal(3)
            names = ("transfer.R.red", "product.R.red", "a.exr.x_mm")
            values = [
                {"name": name, "true": 100.0, "found": 100.0 + 0.5 * float(z), "se": 0.5}
                for name, z in zip(names, draws, strict=True)
            ]
            repeats.append(
                {
                    "sensor": "s",
                    "values": [*values, {"name": "floor.R", "true": 0.0, "found": 0.0, "se": None}],
                }
            )
        found = summary(repeats)
        assert found["covered"]["count"] == 600
        assert found["covered"]["share"] == pytest.approx(0.95, abs=3 * (0.95 * 0.05 / 600) ** 0.5)
        assert found["errors"]["transfer"]["median"] == pytest.approx(0.005 * 0.6745, rel=0.25)
        assert found["errors"]["x_mm"]["largest"] > 0.5 * INTERVAL
        assert found["errors"]["floor"]["count"] == 200
