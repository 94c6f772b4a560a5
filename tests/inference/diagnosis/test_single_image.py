"""A single press without a background: blocks of one picture against sets by the independent generator."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from designlab.core import metrics
from designlab.inference.diagnosis.diagnose import diagnose
from designlab.measurement import load_measurement, write_measurement
from designlab.measurement.blocks import FINAL, SELECT, TRAIN, block_numbers, block_uses, grain
from designlab.report.diagnosis_folder import write_diagnosis
from designlab.report.gap_text import statement
from designlab.sensor.design import preset
from designlab.validation.synthetic import answer_path, plant
from tests.helpers.told import Told

DESIGN = preset("gelsight-2020-flat")
PRESS = {"probe": "triangle:5", "depth_mm": 0.5, "centre_mm": (0.5, -0.5), "yaw_deg": 20.0}
COLUMNS = 48
CATALOGUE = ["lens_distortion", "colour_mixing", "vignetting", "black_level", "response_curve"]
MIXED = {
    "R_from_green": 0.2,
    "R_from_blue": 0.0,
    "G_from_red": 0.1,
    "G_from_blue": 0.15,
    "B_from_red": 0.0,
    "B_from_green": -0.1,
}


def alone(folder, effects):
    """Plant a set and keep its press, at its true pose: one picture without background, dark or repeat."""
    out = folder / "set"
    plant(DESIGN, effects=effects, out=out, seed=3, presses=[PRESS], columns=COLUMNS, kit="small")
    whole = load_measurement(out)
    (frame,) = (f for f in whole.frames if f.kind == "press")
    (true,) = json.loads(answer_path(out).read_text(encoding="utf-8"))["presses"]
    shown = frame.model_copy(update={**true, "centre_mm": tuple(true["centre_mm"])})
    one = whole.model_copy(update={"frames": (shown,)})
    return load_measurement(write_measurement(one, {frame.file: whole.image(frame)}, folder / "one"))


@pytest.fixture(scope="module")
def told():
    """What the diagnoses tell."""
    return {name: Told() for name in ("mixed", "nothing")}


@pytest.fixture(scope="module")
def reports(tmp_path_factory, told):
    """Diagnoses, as found and as written, of mixed colours and of nothing hidden, on shared renders."""
    folder = tmp_path_factory.mktemp("single")
    found = {}
    for name, effects in (("mixed", {"colour_mixing": MIXED}), ("nothing", {})):
        (folder / name).mkdir()
        report = diagnose(
            alone(folder / name, effects),
            DESIGN,
            out=folder / name / "out",
            seed=0,
            catalogue=CATALOGUE,
            samples=64,
            columns=COLUMNS,
            renders=folder / "renders",
            progress=told[name],
        )
        found[name] = report, write_diagnosis(report)
    return found


@pytest.mark.renders
@pytest.mark.llvm
class TestPlanted:
    def test_mixed_colours_are_found_from_other_blocks(self, reports):
        report, _ = reports["mixed"]
        named = {effect.name: effect for effect in report.effects}
        assert "colour_mixing" in named
        values = report.updated.effects[
            [a.name for a in report.updated.effects].index("colour_mixing")
        ].values
        for pair, true in MIXED.items():
            assert values[pair] == pytest.approx(true, abs=0.05), pair
        for split in ("select", "final"):
            level = report.gap[split]
            assert level.after - level.floor < 0.15 * (level.before - level.floor), split

    def test_the_share_that_is_done_only_rises(self, reports, told):
        told["mixed"].assert_only_rises()
        told["nothing"].assert_only_rises()  # its pictures are there already
        assert "trying colour_mixing" in told["mixed"].said

    def test_evidence_against_other_effects_is_stated_with_its_error(self, reports):
        report, _ = reports["mixed"]
        (said,) = (note for note in report.notes if note.startswith("colour_mixing explains the blocks"))
        leads = re.findall(r"(\w+) \(by ([-\d.]+) ± ([\d.]+)\)", said)
        rivals = {name: (float(value), float(se)) for name, value, se in leads}
        assert {"black_level", "response_curve", "vignetting"} <= set(rivals)
        assert all(value > 2 * se > 0 for value, se in rivals.values())

    def test_a_wrong_model_does_not_drive_the_press_from_where_it_is(self, reports):
        report, _ = reports["mixed"]  # stated at its true pose
        (said,) = (note for note in report.notes if note.startswith("the press departs"))
        away = [float(value) for value in re.findall(r"[-+]\d+\.\d+", said)]
        assert np.abs(away[:3]).max() < 0.02  # mm
        assert abs(away[3]) < 0.5  # deg

    def test_one_picture_names_nothing_for_certain(self, reports):
        report, written = reports["mixed"]
        assert report.verdict == "partial"
        assert all(effect.confidence <= 0.5 for effect in report.effects)
        assert any("n = 1" in text and "consistent with" in text for text in written["statement"])
        assert any("floor is unknown" in text for text in written["limits"])
        assert "untouched gel" in str(report.next_measurement)

    def test_nothing_hidden_nothing_named(self, reports):
        report, _ = reports["nothing"]
        assert report.verdict == "at_floor"
        assert not report.effects
        assert not report.updated.effects

    def test_report_and_model_are_written_with_figures_of_blocks_not_fitted_to(self, reports):
        report, written = reports["mixed"]
        data = json.loads((report.model.parent / "report.json").read_text(encoding="utf-8"))
        assert data == json.loads(json.dumps(written))
        figures = data["provenance"]["blocks"]["structure"]
        given, corrected = (
            figures[name]["other blocks"]["structure_corr"] for name in ("given", "corrected")
        )
        assert corrected > max(given, 0.97)
        assert [Path(path).name for path in written["pictures"]] == ["picture.png"]
        assert all(Path(path).is_file() for path in written["pictures"])
        outcomes = {c["name"]: c["outcome"] for c in data["candidates"]}
        assert set(CATALOGUE) <= set(outcomes) | {"lens_distortion"}


class TestBlocks:
    def test_neighbouring_blocks_serve_different_uses(self):
        uses = block_uses(120, 150)
        row, column = block_numbers(120, 150)
        fitted = uses == TRAIN
        np.testing.assert_array_equal(fitted, (row + column) % 2 == 0)
        assert np.mean(uses == SELECT) == pytest.approx(0.25, abs=0.02)
        assert np.mean(uses == FINAL) == pytest.approx(0.25, abs=0.02)

    def test_other_parity_is_the_complement(self):
        assert ((block_uses(60, 60) == TRAIN) != (block_uses(60, 60, parity=1) == TRAIN)).all()

    def test_a_coarse_picture_has_the_blocks_of_a_fine_one(self):
        fine, coarse = block_uses(600, 600), block_uses(150, 150)
        np.testing.assert_array_equal(fine, np.kron(coarse, np.ones((4, 4), dtype=int)))

    def test_grain_is_the_noise_of_a_smooth_picture_with_an_edge(self):
        step = np.where(np.arange(300) < 150, 1.0, 2.0)
        level = (np.linspace(0.2, 0.4, 300) * step)[None, :, None]
        noise = np.random.default_rng(0).normal(0.0, 0.02, (200, 300, 3))
        np.testing.assert_allclose(grain(level * (1 + noise)), 0.02, rtol=0.03)


class TestStructure:
    def test_over_the_whole_picture_it_is_that_of_compare(self):
        random = np.random.default_rng(1)
        real = random.uniform(0.2, 0.8, (40, 60, 3))
        simulated = real + random.normal(0, 0.1, real.shape)
        ours = metrics.compare_within(simulated, real, np.ones((40, 60), dtype=bool))
        theirs = metrics.compare(simulated, real)
        for name in ("structure_corr", "structure_snr_db", "snr_db"):
            assert ours[name] == pytest.approx(theirs[name], rel=1e-9), name

    def test_values_outside_do_not_count(self):
        random = np.random.default_rng(2)
        real, mask = random.uniform(0.2, 0.8, (40, 60, 3)), random.uniform(size=(40, 60)) < 0.5
        simulated = np.where(mask[..., None], real + random.normal(0, 0.1, real.shape), 1e3)
        assert metrics.compare_within(simulated, real, mask)["structure_corr"] > 0.5


@pytest.mark.renders
@pytest.mark.full
@pytest.mark.llvm
@pytest.mark.measured
def test_the_real_triangle(measured_dir, tmp_path):
    """From published values, without a fixed pattern: scored on blocks that were not fitted to."""
    measurement = load_measurement(measured_dir / "gelsight-flat")
    report = diagnose(measurement, DESIGN, out=tmp_path / "out", seed=0, samples=64)
    figures = report.provenance["blocks"]["structure"]
    held = figures["corrected"]["other blocks"]
    assert held["structure_corr"] >= 0.80
    assert held["structure_snr_db"] >= 4.5
    assert figures["given"]["other blocks"]["structure_corr"] < 0.6
    assert report.verdict == "partial"
    assert all(effect.confidence <= 0.5 for effect in report.effects)
    assert "fixed_pattern" not in {applied.name for applied in report.updated.effects}
    assert any("n = 1" in text for text in statement(report))
