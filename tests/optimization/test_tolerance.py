"""Copies of a design on evaluators with closed forms, so that yield and blame are known beforehand."""

import math
import sys

import numpy as np
import pytest
from scipy.stats import norm, truncnorm

from designlab.app import cli
from designlab.evaluation.evaluate import evaluate
from designlab.optimization.constraint import Bound
from designlab.optimization.outcome import Simulated
from designlab.optimization.tolerance import Spread, default_spreads, load_terms, load_tolerance, tolerance
from designlab.optimization.tolerance.distributions import CUT_SD, copy, deviates, inputs
from designlab.report.tolerance import tolerance_report
from designlab.sensor.design import InfeasibleDesign, preset, preset_names
from designlab.simulation.effects import AppliedEffect, SensorModel
from designlab.simulation.simulator import RenderFailed
from tests.helpers.browser import faults, opened
from tests.helpers.scores import Estimate, Score

RUN = sys.modules["designlab.optimization.tolerance.run"]
FLAT, DOME = preset("gelsight-2020-flat"), preset("gelsight-2020-dome")
TILT = Spread(field="leds.tilt_deg", sd=2.0)
HEIGHT = Spread(field="leds.height_mm", sd=0.1)
THICKNESS = Spread(field="elastomer.thickness_mm", sd=0.1, also=("camera.position_mm.2",))


def closed_form(model, *, fidelity, seed):
    """Linear in tilt and height with 9 : 1 parts of variance; another knows the distance of the camera."""
    design = SensorModel.of(model).design
    tilt, height = design.leds.tilt_deg - FLAT.leds.tilt_deg, design.leds.height_mm - FLAT.leds.height_mm
    return Score(
        {
            "blur": Estimate(3.0 * tilt / 2.0 + height / 0.1, unit="um"),
            "distance": Estimate(design.camera.position_mm[2], unit="mm"),
        }
    )


def run(out, design=FLAT, spreads=(TILT, HEIGHT), **options):
    return tolerance(
        design,
        out=out,
        spreads=spreads,
        progress=False,
        **({"evaluator": closed_form, "copies": 200} | options),
    )


@pytest.mark.slow
def test_yield_and_blame_are_those_of_the_closed_form(tmp_path):
    limit = 3.0
    found = run(tmp_path / "out", spec={"blur": Bound(most=limit)})
    sd = math.hypot(3.0, 1.0)
    expected = norm.cdf(limit / sd)
    share = found.passed()
    assert share["low"] < expected < share["high"]
    assert share["share"] == pytest.approx(
        expected, abs=0.02
    )  # even draws know it better than their interval
    blame = found.offenders("blur")
    assert list(blame["input"]) == ["leds.tilt_deg", "leds.height_mm"]
    assert blame["share"].to_numpy() == pytest.approx([0.9, 0.1], abs=0.06)
    curve = found.yield_curve("blur")
    assert np.interp(limit, curve["value"], curve["share"]) == pytest.approx(share["share"], abs=0.01)
    above = found.yield_curve("blur", at_least=True)
    assert np.interp(limit, above["value"], above["share"]) == pytest.approx(1 - share["share"], abs=0.01)
    assert above["share"].iloc[0] == 1.0
    assert found.nominal["blur"] == 0.0
    assert found.units == {"blur": "um", "distance": "mm"}


def test_what_moves_along_moves_by_the_same_distance(tmp_path):
    found = run(tmp_path / "out", spreads=(THICKNESS,), copies=20)
    away = found.copies["distance"] - found.nominal["distance"]
    assert away.to_numpy() == pytest.approx(0.1 * found.copies["elastomer.thickness_mm"].to_numpy())


def test_draws_are_normal_even_cut_and_the_same_when_more_are_asked_for():
    values = deviates(256, "abc", seed=4)
    assert np.abs(values.mean(axis=0)).max() < 0.02
    assert values.std(axis=0) == pytest.approx(0.987, abs=0.02)  # of a normal cut at three
    assert np.abs(values).max() <= CUT_SD
    assert np.abs(np.corrcoef(values.T) - np.eye(3)).max() < 3 / math.sqrt(256)  # as of independent draws
    for count in (8, 32, 64):
        shares = truncnorm.cdf(deviates(count, "a", seed=4)[:, 0], -CUT_SD, CUT_SD)
        assert sorted((shares * count).astype(int)) == list(range(count))
    np.testing.assert_array_equal(deviates(50, "abc", seed=4), values[:50])


def test_what_two_designs_have_in_common_is_built_with_the_same_luck():
    """A dome draws its radius too; tilt, thickness and the rest differ from its drawing as the flat's do."""
    flat, dome = ([each.name for each in inputs(one, default_spreads(one))] for one in (FLAT, DOME))
    shared = [name for name in flat if name in dome]
    assert 15 < len(shared) < len(dome)
    of_flat, of_dome = (
        deviates(8, names, seed=3)[:, [names.index(name) for name in shared]] for names in (flat, dome)
    )
    np.testing.assert_array_equal(of_flat, of_dome)
    assert not np.isclose(of_flat, deviates(8, shared, seed=4)).any()


@pytest.mark.parametrize("name", preset_names())
def test_default_copies_of_every_preset_can_be_built(name):
    design = preset(name)
    drawn = inputs(design, default_spreads(design))
    values = deviates(24, [each.name for each in drawn], seed=1)
    built = [copy(SensorModel.of(design), drawn, row) for row in values]
    assert len({model.digest for model in built}) == 24
    for model in built:
        model.effective_design().require_feasible(as_built=True)
    assert all(spread.source for spread in default_spreads(design))
    means = np.mean([m.effective_design().elastomer.thickness_mm for m in built])
    assert means == pytest.approx(design.elastomer.thickness_mm, abs=0.05)


@pytest.mark.parametrize(
    ("seats", "gap_mm"),
    [
        ({"fit": "fdm"}, 0.2),
        ({"fit": "sla"}, 0.1),
        ({"clearance_mm": 0.3}, 0.3),
        ({"clearance_mm": 0.05}, 0.05),
    ],
)
def test_the_fit_of_the_seats_says_how_far_parts_stand_off(seats, gap_mm):
    design = preset("default").replace({"housing.seats": seats})
    sd = {spread.field: spread.sd for spread in default_spreads(design)}
    play_mm = gap_mm / math.sqrt(3)  # even over the gap
    assert sd["effects.led_position.*"] == pytest.approx(math.hypot(0.1 / math.sqrt(3), play_mm))
    assert sd["effects.led_tilt.*"] == pytest.approx(math.degrees(math.atan(play_mm / 11.0)))
    for axis in "xyz":
        assert sd[f"effects.camera_pose.{axis}_mm"] == pytest.approx(play_mm)
    assert sd["effects.camera_pose.tilt_x_deg"] == pytest.approx(math.degrees(math.atan(play_mm / 23.862)))
    tube = default_spreads(design.replace({"housing.seats": None}))
    assert {spread.field: spread.sd for spread in tube}["effects.camera_pose.*"] == 0.1


def test_a_copy_that_lost_some_of_its_view_is_built_and_a_drawing_is_refused(tmp_path, monkeypatch):
    def stop(*_):
        raise RenderFailed("as far as the simulator")

    monkeypatch.setattr(sys.modules[evaluate.__module__], "_simulator", stop)
    tight = preset("digit-like")  # 0.03 mm more at the camera's side, and the corners are cut
    near = tight.replace({"camera.position_mm.2": tight.camera.position_mm[2] - 0.1})
    assert list(near.broken()) == ["camera_sees_membrane"]
    with pytest.raises(InfeasibleDesign, match="camera_sees_membrane"):
        Simulated()(near, fidelity="fast", seed=0)
    with pytest.raises(RenderFailed, match="as far as the simulator"):
        Simulated(as_built=True)(near, fidelity="fast", seed=0)


def test_a_dome_stays_a_dome_when_its_gel_is_thicker():
    drawn = inputs(DOME, default_spreads(DOME))
    place = [each.name for each in drawn].index("elastomer.thickness_mm")
    values = np.zeros(len(drawn))
    values[place] = 2.0
    design = copy(SensorModel.of(DOME), drawn, values).design
    gel, core = design.elastomer, design.gelcore
    assert gel.thickness_mm == pytest.approx(DOME.elastomer.thickness_mm + 0.2)
    assert gel.radius_mm - gel.thickness_mm == pytest.approx(core.radius_mm)


def test_a_relative_spread_and_one_about_what_a_model_has():
    model = SensorModel(design=FLAT).with_effect(AppliedEffect(name="veiling_glare", values={"share": 0.05}))
    flux = Spread(field="leds.groups.*.flux_mw", sd=0.1, relative=True)
    glare = Spread(field="effects.veiling_glare.share", sd=0.01)
    drawn = inputs(FLAT, (flux, glare))
    assert len(drawn) == len(FLAT.leds.groups) + 1
    made = copy(model, drawn, np.array([1.0, 0.0, -2.0, 1.5]))
    ratios = [a.flux_mw / b.flux_mw for a, b in zip(made.design.leds.groups, FLAT.leds.groups, strict=True)]
    assert ratios == pytest.approx([1.1, 1.0, 0.8])
    assert made.effects[0].values["share"] == pytest.approx(0.065)


def test_a_copy_that_cannot_be_built_is_not_good(tmp_path):
    low = FLAT.replace({"leds.height_mm": 5.0})
    wide = Spread(field="leds.height_mm", sd=3.0)
    found = run(tmp_path / "out", design=low, spreads=(wide,), copies=30)
    refused = found.copies[~found.copies["built"].astype(bool)]
    assert 0 < len(refused) < 30
    assert (refused["leds.height_mm"] < 0).all()
    assert refused["reason"].str.len().min() > 0
    assert found.passed()["share"] == pytest.approx(1 - len(refused) / 30)


def test_a_design_of_which_no_copy_can_be_built_is_reported(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(RUN, "Simulated", lambda **_: closed_form)
    terms = tmp_path / "terms.toml"
    terms.write_text(
        'version = 1\n[[spread]]\nfield = "leds.height_mm"\nsd = 0.1\nalso = ["elastomer.thickness_mm"]\n'
    )
    monkeypatch.setattr(RUN, "copy", lambda *_: FLAT.replace({"leds.height_mm": 0.5}))
    words = ["tolerance", "gelsight-2020-flat", "--terms", str(terms), "--copies", "5"]
    assert cli.main([*words, "--out", str(tmp_path / "out")]) == 0
    assert "5 copies, 5 of them cannot be built" in capsys.readouterr().out
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "leds_above_membrane" in page
    assert load_tolerance(tmp_path / "out").passed()["share"] == 0


def test_a_copy_whose_picture_fails_is_not_called_unbuildable_and_tried_again(tmp_path):
    asked = []

    def failing(model, *, fidelity, seed):
        asked.append(model)
        if len(asked) in (3, 5):
            raise RenderFailed("the picture is black")
        score = closed_form(model, fidelity=fidelity, seed=seed)
        if len(asked) == 6:
            score.scores["blur"].value = math.nan  # of one copy this score is not known
        return score

    spec = {"blur": Bound(most=100.0)}
    found = run(tmp_path / "out", evaluator=failing, copies=60, spec=spec)
    assert (len(found.unbuilt), len(found.failed), len(found.built())) == (0, 2, 58)
    assert found.passed()["share"] == pytest.approx(57 / 58)
    blame = found.offenders("blur")
    assert blame is not None
    assert blame["share"].iloc[0] == pytest.approx(0.9, abs=0.1)
    again = run(tmp_path / "out", evaluator=failing, copies=60, spec=spec)
    assert len(asked) == 63
    assert len(again.failed) == 0


def test_a_run_goes_on_and_takes_more_copies(tmp_path):
    asked = []

    def counted(model, *, fidelity, seed):
        asked.append(SensorModel.of(model).digest)
        if len(asked) == 8:
            raise KeyboardInterrupt
        return closed_form(model, fidelity=fidelity, seed=seed)

    with pytest.raises(KeyboardInterrupt, match="after 7 of 13 evaluations"):
        run(tmp_path / "out", evaluator=counted, copies=12)
    whole = run(tmp_path / "out", evaluator=counted, copies=12)
    assert len(asked) == 14
    more = run(tmp_path / "out", evaluator=counted, copies=20)
    assert len(asked) == 22
    assert more.frame.iloc[:13].equals(whole.frame)
    assert load_tolerance(tmp_path / "out").frame.equals(more.frame)


@pytest.mark.parametrize(
    ("spread", "rule"),
    [
        (Spread(field="leds.nothing_mm", sd=1), "no field 'leds.nothing_mm'"),
        (Spread(field="gelcore.shape", sd=1), "gelcore.shape is no number"),
        (Spread(field="elastomer.radius_mm", sd=1), "elastomer.radius_mm is no number"),
        (Spread(field="effects.camera_pose", sd=1), "is not effects.NAME.PARAMETER"),
        (Spread(field="effects.camera_pose.w_mm", sd=1), "no parameter 'w_mm'"),
        (Spread(field="effects.nothing.x", sd=1), "effect 'nothing' is unknown"),
    ],
)
def test_a_spread_that_fits_nothing_is_named(spread, rule, tmp_path):
    with pytest.raises(ValueError, match=rule):
        run(tmp_path / "out", spreads=(spread,))
    with pytest.raises(ValueError, match="given twice"):
        run(tmp_path / "out", spreads=(TILT, TILT))


def test_a_folder_of_another_run_is_refused_and_few_copies_blame_nobody(tmp_path):
    few = run(tmp_path / "out", copies=10)
    with pytest.raises(ValueError, match=r"holds a tolerance run of another design, .*seed 0, .*; choose"):
        run(tmp_path / "out", copies=10, seed=3)
    assert few.offenders("blur") is None
    with pytest.raises(ValueError, match="holds no tolerance run"):
        load_tolerance(tmp_path)


TERMS = """version = 1
[spec]
distance.most = 41.0
[[spread]]
field = "leds.tilt_deg"
sd = 2.0
source = "protractor"
[[spread]]
field = "elastomer.thickness_mm"
sd = 0.1
also = ["camera.position_mm.2"]
"""


def test_terms_are_read_and_wrong_ones_named(tmp_path):
    path = tmp_path / "terms.toml"
    path.write_text(TERMS, encoding="utf-8")
    terms = load_terms(path)
    assert terms.spec["distance"].most == 41.0
    assert terms.spread is not None
    assert terms.spread[0] == Spread(field="leds.tilt_deg", sd=2.0, source="protractor")
    for old, new, rule in (
        ("version = 1", "version = 2", "has format version 2"),
        ("sd = 2.0", "sd = -2.0", "spread.0.sd"),
        ("most = 41.0", "top = 41.0", "unknown field"),
        ("[spec]", "[spec", "not valid TOML"),
    ):
        path.write_text(TERMS.replace(old, new), encoding="utf-8")
        with pytest.raises(ValueError, match=rule):
            load_terms(path)


@pytest.mark.slow
def test_the_page_and_the_summary_say_what_was_found(tmp_path, monkeypatch, capsys):
    path = tmp_path / "terms.toml"
    path.write_text(TERMS, encoding="utf-8")
    monkeypatch.setattr(RUN, "Simulated", lambda **_: closed_form)
    monkeypatch.setattr(RUN, "SCORES", ("blur", "distance"))
    words = ["tolerance", "gelsight-2020-flat", "--terms", str(path), "--copies", "60", "--out"]
    assert cli.main([*words, str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for word in ("good (distance at most 41)", "variance of distance: elastomer.thickness_mm"):
        assert word in said
    for word in ("protractor", "copies at or below (%)", "elastomer, thickness (mm)", "None."):
        assert word in page
    with opened() as browser:
        assert faults(browser, tmp_path / "out" / "report.html") == []
    assert cli.main([*words, str(tmp_path / "out"), "--seed", "4"]) == 2
    assert "holds a tolerance run of another design" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("spec", "way"),
    [({"blur": Bound(least=0.0)}, "at or above"), ({"blur": Bound(least=-5.0, most=5.0)}, "at or below")],
)
def test_the_yield_curve_counts_the_side_that_the_specification_asks_for(tmp_path, spec, way):
    page = tolerance_report(run(tmp_path / "out", spec=spec, copies=20), tmp_path / "page.html")
    assert f"copies {way} (%)" in page.read_text(encoding="utf-8")


def test_a_calibration_of_the_drawing_is_for_the_usual_evaluator(tmp_path):
    with pytest.raises(ValueError, match="calibrate: once is for the usual evaluator"):
        run(tmp_path, calibrate="once")
