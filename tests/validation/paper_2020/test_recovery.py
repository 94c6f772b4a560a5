"""The reproduction at its reduced size: hidden sensors are found, light transport beats directional light.

The full size runs by ``designlab reproduce --out DIR``; its figures are in docs/reproduction.md.
"""

import json

import pytest

from designlab.app import cli
from designlab.validation.paper_2020.accuracy import DIFFUSE, PHONG, TRANSPORT
from designlab.validation.paper_2020.real import real
from designlab.validation.paper_2020.sizes import SIZES

pytestmark = [pytest.mark.recovery, pytest.mark.renders]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Results of all but the real picture, which has a test of its own."""
    out = tmp_path_factory.mktemp("reproduction") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("DESIGNLAB_MEASURED", raising=False)
        assert cli.main(["reproduce", "--out", str(out), "--size", "reduced"]) == 0
    return out


@pytest.fixture(scope="module")
def stages(folder):
    return json.loads((folder / "result.json").read_text(encoding="utf-8"))["stages"]


@pytest.mark.slow
@pytest.mark.full
@pytest.mark.llvm
class TestReducedSize:
    def test_powers_reflectances_and_products_within_one_percent(self, stages):
        errors = stages["recovery"]["errors"]
        for kind in ("product", "transfer", "reflectance"):
            assert errors[kind]["largest"] < 0.01, kind
        for kind in ("product, crosstalk", "transfer, crosstalk"):
            assert errors[kind]["largest"] < 0.01, kind

    def test_poses_within_50_um(self, stages):
        for kind in ("x_mm", "y_mm", "depth_mm"):
            assert stages["recovery"]["errors"][kind]["largest"] < 0.05, kind

    def test_most_intervals_hold_the_truth(self, stages):
        """Of some 27 numbers, which are not independent, 80 % is three standard deviations below 95 %."""
        assert stages["recovery"]["covered"]["share"] > 0.8

    def test_light_transport_predicts_presses_it_was_not_fitted_to(self, stages):
        models = stages["accuracy"]["sensors"]["gelsight-2020-dome"]["models"]
        ours = models[TRANSPORT]["held_out"]
        assert ours["snr_db"] >= 25.0
        assert ours["structure_corr"] >= 0.95  # 0.97 at the full size, whose pictures have more samples
        for name in (DIFFUSE, PHONG):
            assert models[name]["held_out"]["snr_db"] <= ours["snr_db"] - 5.0, name
            assert models[name]["held_out"]["structure_corr"] < ours["structure_corr"], name

    def test_pages_are_there_and_a_second_call_repeats_nothing(self, folder, monkeypatch):
        assert {"report.html", "reproduction.md", "result.json"} <= {path.name for path in folder.iterdir()}

        def never(*arguments, **options):
            raise AssertionError("this was done before")

        monkeypatch.delenv("DESIGNLAB_MEASURED", raising=False)
        monkeypatch.setattr("designlab.validation.paper_2020.recovery.repeat", never)
        monkeypatch.setattr("designlab.validation.paper_2020.accuracy.photograph", never)
        assert cli.main(["reproduce", "--out", str(folder), "--size", "reduced"]) == 0


@pytest.mark.full
@pytest.mark.llvm
@pytest.mark.measured
def test_the_real_triangle(tmp_path, measured_dir):
    """From published values; nothing but a constant floor beside light, pose, kernel and scale."""
    (frame,) = real(tmp_path, size=SIZES["reduced"])["frames"]
    assert frame["before"]["snr_db"] < 6
    assert frame["after"]["snr_db"] >= 20
    assert frame["after"]["structure_corr"] >= 0.72
    assert frame["after"]["structure_snr_db"] >= 2.5
