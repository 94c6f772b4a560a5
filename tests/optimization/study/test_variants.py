"""Studies with variants, fields that go together, bounds on scores, and confirmation of what they found."""

import json
import math
import re

import numpy as np
import pytest

from designlab.app import cli
from designlab.app.cli.study import summary
from designlab.optimization.constraint import Bound
from designlab.optimization.study import Plan, Robust, Study, StudyError, load_results, load_study, run_study
from designlab.optimization.study.definition import BASE
from designlab.optimization.study.front import history
from designlab.optimization.tolerance import Spread, tolerance
from designlab.report.study import study_report
from designlab.simulation.effects import SensorModel
from tests.helpers.scores import Estimate, Score
from tests.helpers.studies import BARE

DOME = {
    "gelcore.shape": "dome",
    "gelcore.radius_mm": 40.0,
    "elastomer.shape": "dome",
    "elastomer.outline": "round",
    "elastomer.radius_mm": 42.0,
}
PARAMETERS = {
    "leds.tilt_deg": {"low": 0, "high": 40},
    "elastomer.radius_mm": {"low": 35, "high": 60, "variant": "dome", "also": {"gelcore.radius_mm": -2}},
}


def closed_form(design, *, fidelity, seed):
    """A dome of 50 mm and 20 deg is best; what it shines is only seen within half the area."""
    curved = design.elastomer.shape == "dome"
    away = abs(design.elastomer.radius_mm - 50.0) / 50.0 if curved else 1.0
    tilt = design.leds.tilt_deg
    return Score(
        {
            "uniformity_u0": Estimate(math.exp(-away - ((tilt - 20.0) / 20.0) ** 2)),
            "coverage": Estimate(1.0 - tilt / 40.0),
        }
    )


def noisy(design, *, fidelity, seed):
    """The tilt does nothing: all that a search finds is chance, another for every design and seed."""
    random = np.random.default_rng([int(1e6 * (90 + design.leds.tilt_deg)), seed])
    sd = {"fast": 0.05, "standard": 0.02, "reference": 0.005}[fidelity]
    return Score({"uniformity_u0": Estimate(0.5 + sd * float(random.standard_normal()), se=sd)})


def make(**changes):
    content = {
        "name": "shapes",
        "base": "gelsight-2020-flat",
        "parameters": PARAMETERS,
        "variants": {"flat": {}, "dome": DOME},
        "objectives": {"uniformity_u0": "maximise"},
        "trials": 30,
        **BARE,
    }
    return Study.model_validate(content | changes)


def run(study, out, evaluator=closed_form, **options):
    return run_study(study, out=out, progress=False, evaluator=evaluator, **options)


@pytest.mark.slow
def test_a_variant_has_parameters_of_its_own(tmp_path):
    results = run(make(), tmp_path / "out")
    frame = results.frame[results.frame["state"] == "complete"]
    assert set(frame["variant"]) == {"flat", "dome"}
    assert frame.loc[frame["variant"] == "flat", "elastomer.radius_mm"].isna().all()
    assert results.start is not None
    assert results.start["trial"] == 0
    best = results.pareto.iloc[0]
    assert best["variant"] == "dome"
    design = results.design(int(best["trial"]))
    assert design.elastomer.radius_mm == best["elastomer.radius_mm"]
    assert design.gelcore.radius_mm == pytest.approx(design.elastomer.radius_mm - 2, abs=1e-9)
    assert results.to_json()["picks"][0]["variant"] == "dome"


def test_fields_that_go_together_move_together():
    study = make(
        variants={},
        parameters={"leds.groups.0.flux_mw": {"low": 1, "high": 5, "also": {"leds.groups.1.flux_mw": 0.5}}},
    )
    groups = study.design({"leds.groups.0.flux_mw": 2.5}).leds.groups
    assert [group.flux_mw for group in groups[:2]] == [2.5, 3.0]
    leaning = {
        "leds.height_mm": {"low": 5, "high": 9, "also": {"leds.radius_mm": {"times": -0.5, "plus": 17}}}
    }
    leds = make(variants={}, parameters=leaning).design({"leds.height_mm": 8.0}).leds
    assert (leds.height_mm, leds.radius_mm) == (8.0, 13.0)


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"variants": {"flat": {}}}, "two variants or more"),
        ({"variants": {"flat": {}, "dome": {"elastomer.shape": "dome"}}}, "dome: field elastomer"),
        ({"variants": {}}, "there are none"),
        ({"constraints": {"coverage": {}}}, "give least, most or both"),
        ({"constraints": {"coverage": {"least": 1, "most": 0}}}, "least must not be above most"),
        (
            {"robust": {"spread": [{"field": "leds.tilt", "sd": 1}]}},
            r"robust\n.*spread\.0: no field 'leds.tilt'",
        ),
        (
            {"variants": {}, "robust": {"spread": [{"field": "gelcore.radius_mm", "sd": 1}]}},
            "spread.0: gelcore.radius_mm is no number",
        ),
        ({"robust": {"spread": [{"field": "leds.tilt_deg", "sd": 1}] * 2}}, "leds.tilt_deg is given twice"),
        (
            {"parameters": {"gelcore.shape": {"choices": ["dome"], "also": {"elastomer.shape": 1}}}},
            "only numbers can be moved",
        ),
        (
            {"parameters": {"leds.tilt_deg": {"low": 0, "high": 9, "also": {"leds.nothing": 0}}}},
            "no field 'leds.nothing'",
        ),
    ],
)
def test_what_does_not_fit_is_refused_by_name(changes, rule):
    with pytest.raises(ValueError, match=rule):
        make(**changes)


def test_variants_and_bounds_are_read_from_toml(tmp_path):
    path = tmp_path / "shapes.toml"
    path.write_text(
        'version = 1\nbase = "gelsight-2020-flat"\n'
        "[variants.flat]\n"
        '[variants.dome]\ngelcore = {shape = "dome", radius_mm = 40}\n'
        'elastomer = {shape = "dome", outline = "round", radius_mm = 42}\n'
        "[parameters.leds.tilt_deg]\nlow = 0\nhigh = 40\n"
        "[constraints]\ncoverage.least = 0.95\n"
        "[plan]\npromoted = 4\nconfirmed = 2\n",
        encoding="utf-8",
    )
    study = load_study(path)
    assert study.variants["dome"] == DOME
    assert study.constraints["coverage"].least == 0.95
    assert study.plan == Plan(promoted=4, confirmed=2)


@pytest.mark.slow
def test_designs_that_break_a_bound_are_not_recommended(tmp_path):
    free = run(make(), tmp_path / "free")
    bound = run(make(constraints={"coverage": {"least": 0.7}}), tmp_path / "bound")
    assert free.pareto.iloc[0]["coverage"] < 0.7
    assert (bound.pareto["coverage"] >= 0.7).all()
    broken = bound.frame[bound.frame["violated"].notna()]
    assert (broken["coverage"] < 0.7).all()
    assert len(broken) < 30  # the sampler learns where the bound is


@pytest.mark.slow
def test_where_every_design_breaks_a_bound_it_is_said_by_how_much_the_nearest_does(tmp_path):
    study = make(constraints={"coverage": {"least": 2}, "uniformity_u0": {"least": 0.0}})
    results = run(study, tmp_path)
    assert results.pareto.empty
    assert results.nearest["violated"] == ["coverage"]
    (said,) = (line for line in summary(results, study.trials).splitlines() if line.startswith("no design"))
    assert f"trial {results.nearest['trial']} breaks fewest: coverage " in said
    assert "must be" in said
    page = study_report(results, tmp_path / "report.html", pictures=False).read_text(encoding="utf-8")
    assert f"None of {results.evaluated} evaluated designs keeps the constraints" in page
    assert run(make(), tmp_path / "free").nearest is None


@pytest.mark.slow
def test_a_design_that_breaks_a_bound_when_confirmed_is_marked(tmp_path):
    def brighter(design, *, fidelity, seed):
        score = noisy(design, fidelity=fidelity, seed=seed)
        return Score({**score.scores, "coverage": Estimate(0.5 if fidelity == "reference" else 1.0)})

    study = make(
        variants={},
        parameters={"leds.tilt_deg": {"low": 0, "high": 40}},
        constraints={"coverage": {"least": 0.95}},
        plan=Plan(),
    )
    results = run(study, tmp_path, brighter)
    again = results.confirmed
    assert set(again[again["fidelity"] == "reference"]["violated"].map(tuple)) == {("coverage",)}
    assert again[again["fidelity"] == "standard"]["violated"].isna().all()
    assert list(results.gains()["violated"]) == [["coverage"]]
    shown = summary(results, 30).partition("confirmed at reference")[2].splitlines()
    (line,) = (line for line in shown if line.split()[:1] == [f"{results.gains()['trial'].iloc[0]}"])
    assert line.split()[-1] == "coverage"


def test_a_bound_on_what_is_no_score_is_named(tmp_path):
    with pytest.raises(StudyError, match="field constraints: no score is called 'brightness'"):
        run(make(constraints={"brightness": {"least": 1}}), tmp_path / "out")


@pytest.mark.slow
def test_confirmation_shows_that_gains_were_chance(tmp_path):
    study = make(variants={}, parameters={"leds.tilt_deg": {"low": 0, "high": 40}}, plan=Plan(seeds=3))
    results = run(study, tmp_path / "out", noisy)
    again = results.confirmed
    assert list(again[again["fidelity"] == "reference"]["seeds"]) == [3] * 2  # one objective, one best
    assert set(again["trial"]) == {BASE, int(results.pareto.iloc[0]["trial"])}
    assert results.pareto.iloc[0]["uniformity_u0"] > 0.57
    assert list(results.curse()) == ["fast", "standard", "reference"]
    best, start = results.pareto.iloc[0], results.start
    fast = again[again["fidelity"] == "fast"].set_index("trial")["uniformity_u0"]
    seen, kept = best["uniformity_u0"] - start["uniformity_u0"], fast[best["trial"]] - fast[BASE]
    assert results.curse()["fast"]["uniformity_u0"] == pytest.approx(1 - kept / seen)
    assert results.curse()["reference"]["uniformity_u0"] > 0.7
    row = again[(again["fidelity"] == "reference") & (again["trial"] == BASE)].iloc[0]
    assert row["uniformity_u0_se"] == pytest.approx(0.005 / math.sqrt(3))


@pytest.mark.slow
def test_confirmation_is_not_repeated_and_goes_on(tmp_path):
    study = make(variants={}, parameters={"leds.tilt_deg": {"low": 0, "high": 40}}, plan=Plan())
    asked = []

    def counted(design, *, fidelity, seed):
        asked.append((fidelity, seed))
        if len(asked) == 32:
            raise KeyboardInterrupt
        return noisy(design, fidelity=fidelity, seed=seed)

    with pytest.raises(KeyboardInterrupt, match="to resume"):
        run(study, tmp_path / "out", counted)
    run(study, tmp_path / "out", counted)
    assert len(asked) == 30 + 1 + 2 + 2 + 4
    assert len({seed for fidelity, seed in asked if fidelity != "fast"}) == 3
    assert run(study, tmp_path / "out", counted).confirmed.equals(load_results(tmp_path / "out").confirmed)
    assert len(asked) == 39


def test_confirmations_of_other_designs_do_not_count(tmp_path):
    """Trials of a record that was lost are numbered anew: a design is known by its digest."""
    study = make(variants={}, parameters={"leds.tilt_deg": {"low": 0, "high": 40}}, plan=Plan(), trials=6)
    results = run(study, tmp_path, noisy)
    before = results.confirmed
    best = int(results.pareto.iloc[0]["trial"])
    for path in (tmp_path / "confirmed").glob(f"{best:04d}-*.json"):
        record = json.loads(path.read_text()) | {"design": "0" * 64}
        path.write_text(json.dumps(record))
        (tmp_path / "confirmed" / f"lost-{path.name}").write_text(json.dumps(record | {"trial": 99}))
    after = load_results(tmp_path)
    assert set(before["trial"]) == {BASE, best}
    assert set(after.confirmed["trial"]) == {BASE}
    assert after.curse() == {}


def fragile(model, *, fidelity, seed):
    """A peak of 1 that one degree ruins, and one of 0.7 that is 15 degrees wide."""
    tilt = SensorModel.of(model).design.leds.tilt_deg
    sharp = math.exp(-(((tilt - 30.0) / 1.0) ** 2))
    broad = 0.7 * math.exp(-(((tilt - 10.0) / 15.0) ** 2))
    return Score({"uniformity_u0": Estimate(max(sharp, broad)), "tilt": Estimate(tilt, unit="deg")})


@pytest.mark.slow
@pytest.mark.parametrize("aim", ["mean_minus_sigma", "worst"])
def test_a_robust_study_gives_up_a_peak_that_cannot_be_built(aim, tmp_path):
    spread = Spread(field="leds.tilt_deg", sd=2.0)
    tilts = {"leds.tilt_deg": {"low": 0, "high": 40}}
    common = {"variants": {}, "parameters": tilts, "trials": 64, "sampler": "qmc"}
    nominal = run(make(**common), tmp_path / "nominal", fragile)
    robust = run(make(**common, robust=Robust(spread=(spread,), aim=aim)), tmp_path / "robust", fragile)
    assert nominal.pareto.iloc[0]["leds.tilt_deg"] == pytest.approx(30, abs=1)
    best = robust.pareto.iloc[0]
    assert best["leds.tilt_deg"] == pytest.approx(10, abs=5)
    assert best["tilt"] == pytest.approx(best["leds.tilt_deg"], abs=0.5)  # of other scores the mean
    limit = {"uniformity_u0": Bound(least=0.6)}
    yields = [
        tolerance(
            found.design(int(found.pareto.iloc[0]["trial"])),
            out=tmp_path / f"copies-{name}",
            copies=64,
            spreads=(spread,),
            spec=limit,
            progress=False,
            evaluator=fragile,
        ).passed()["share"]
        for name, found in (("nominal", nominal), ("robust", robust))
    ]
    assert yields[0] < 0.4
    assert yields[1] > 0.95


def test_a_robust_study_is_confirmed_with_other_copies_and_knows_its_error(tmp_path):
    """Scores are the tilt that a copy came out with, so that they tell what was drawn."""
    built = {}

    def remember(model, *, fidelity, seed):
        tilt = SensorModel.of(model).design.leds.tilt_deg
        built.setdefault((fidelity, seed), []).append(tilt)
        return Score({"uniformity_u0": Estimate(tilt, se=0.0), "tilt": Estimate(tilt, se=0.0)})

    spread = Spread(field="leds.tilt_deg", sd=2.0)
    study = make(
        variants={},
        parameters={"leds.tilt_deg": {"low": 0, "high": 40}},
        robust=Robust(spread=(spread,), copies=16),
        plan=Plan(promoted=1, confirmed=1, seeds=2),
        trials=2,
    )
    results = run(study, tmp_path, remember)
    base = study.base.leds.tilt_deg
    search = built.pop(("fast", 0))[:16]
    assert len(built) == 4
    for tilts in built.values():
        assert not np.isclose(tilts[:16], search).any()
        assert np.mean(tilts[:16]) == pytest.approx(base, abs=0.5)
    row = results.confirmed.set_index(["trial", "fidelity"]).loc[(BASE, "standard")]
    assert row["tilt_se"] == pytest.approx(2.0 / math.sqrt(16), rel=0.1)
    assert row["uniformity_u0_se"] == pytest.approx(2.0 * math.sqrt(1 / 16 + 1 / 32), rel=0.3)


@pytest.mark.slow
def test_values_of_a_robust_study_say_what_they_are(tmp_path, capsys):
    spread = Spread(field="leds.tilt_deg", sd=2.0)
    study = make(
        parameters={"leds.tilt_deg": {"low": 0, "high": 40}},
        variants={},
        trials=6,
        robust=Robust(spread=(spread,), copies=3, sigmas=1.5),
    )
    results = run(study, tmp_path, fragile)
    assert results.to_json()["robust"]["copies"] == 3
    assert cli.main(["study", "status", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "mean - 1.5 sigma of uniformity_u0" in said
    assert re.search(r"0\.\d+ ± 0\.\d+", said)
    page = study_report(results, tmp_path / "page.html", pictures=False).read_text("utf-8")
    assert "mean - 1.5 sigma of uniformity U0" in page
    assert "one over 3 copies of the design" in page
    worst = study.model_copy(update={"robust": Robust(aim="worst")})
    assert (worst.called("uniformity_u0"), worst.called("x")) == ("worst of uniformity_u0", "mean of x")


@pytest.mark.slow
def test_a_design_of_which_a_copy_cannot_be_built_is_infeasible(tmp_path):
    spread = Spread(field="leds.height_mm", sd=2.0)
    study = make(
        variants={},
        parameters={"leds.height_mm": {"low": 4.5, "high": 14}},
        robust=Robust(spread=(spread,)),
        trials=15,
    )
    results = run(study, tmp_path / "out", fragile)
    refused = results.frame[results.frame["state"] == "infeasible"]
    assert refused["reason"].str.contains("cannot be built").any()


def test_a_spread_is_for_the_variants_that_have_it(tmp_path):
    """A radius is drawn for domes; a flat gel, of which nothing differs then, is scored as drawn."""
    asked = []

    def remember(model, *, fidelity, seed):
        asked.append(SensorModel.of(model).design)
        return closed_form(SensorModel.of(model).design, fidelity=fidelity, seed=seed)

    spread = Spread(field="elastomer.radius_mm", sd=0.2, also=("gelcore.radius_mm",))
    study = make(robust=Robust(spread=(spread,), copies=4), trials=6, sampler="random")
    results = run(study, tmp_path / "out", remember)
    done = results.frame[results.frame["state"] == "complete"]
    assert set(done["variant"]) == {"flat", "dome"}
    flat = [design for design in asked if design.elastomer.shape == "flat"]
    assert len(flat) == (done["variant"] == "flat").sum()
    assert len(asked) - len(flat) == 4 * (done["variant"] == "dome").sum()


@pytest.mark.slow
def test_the_page_shows_variants_bounds_and_what_was_confirmed(tmp_path):
    study = make(constraints={"coverage": {"least": 0.6}}, plan=Plan(seeds=2))
    results = run(study, tmp_path / "out")
    gains = results.gains()
    assert list(gains["fidelity"]) == ["reference"]
    (gain,) = gains.to_dict(orient="records")
    room = 1.959964 * math.hypot(gain["base_se"], gain["value_se"])  # one design, one objective
    assert gain["difference"] == pytest.approx(gain["value"] - gain["base"])
    assert gain["high"] - gain["low"] == pytest.approx(2 * room)
    assert gain["seen"]
    assert gain["better"]
    text = study_report(results, tmp_path / "page.html", pictures=False).read_text("utf-8")
    shown = " ".join(re.sub("<script.*?</script>|<[^>]*>", " ", text, flags=re.S).split())
    broken = int(results.frame["violated"].notna().sum())
    assert f"{broken} evaluated designs break a constraint" in shown
    assert "Confirmed with fresh seeds" in shown
    assert f"{gain['difference']:+.3g} ({gain['low']:+.3g} to {gain['high']:+.3g}) better" in shown
    assert "Is there a better sensor" in shown
    assert "yes, in some scores" in shown
    assert "elastomer.radius_mm (variant dome)" in shown
    assert "nan" not in shown.lower()
    best = history(results.frame, study.objectives).iloc[-1]["uniformity_u0"]
    assert best == results.valid["uniformity_u0"].max() < results.frame["uniformity_u0"].max()


@pytest.mark.slow
def test_where_nothing_differs_no_difference_is_seen(tmp_path):
    def perfect(design, *, fidelity, seed):
        return Score({"uniformity_u0": Estimate(0.0, 0.0)})

    study = make(
        variants={},
        parameters={"leds.tilt_deg": {"low": 0, "high": 40}},
        objectives={"uniformity_u0": "minimise"},
        trials=3,
        plan=Plan(promoted=1, confirmed=1, seeds=1),
    )
    results = run(study, tmp_path / "out", perfect)
    assert not results.gains()["seen"].any()
    page = study_report(results, tmp_path / "page.html", pictures=False)
    assert "no difference seen" in page.read_text("utf-8")
