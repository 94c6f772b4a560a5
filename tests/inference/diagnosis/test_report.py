"""What a diagnosis says: fields as documented, words that fit the verdict, honest intervals, the page."""

import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from designlab.core.intervals import of_amplitudes, of_deviation
from designlab.inference.diagnosis.diagnose import _gives_back, _names, _provenance, _untried
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.empirical_errors import shares_right
from designlab.inference.diagnosis.likelihood.fit import FRINGES_SD, SIZE_SD, Fitter
from designlab.inference.diagnosis.likelihood.normal_equations import ALIKE
from designlab.inference.diagnosis.result import (
    Advice,
    Candidate,
    Control,
    Found,
    GapReport,
    Level,
    Overlap,
    Unexplained,
    Value,
    Where,
)
from designlab.inference.diagnosis.selection.criterion import (
    LEAST_OF_FIRST,
    LEAST_SHARE,
    OF_BLOCKS,
    OF_PRESSES,
    SURE_SE,
)
from designlab.inference.diagnosis.single_image import diagnose as single
from designlab.inference.diagnosis.single_image.frame_fitter import SCALE_SD
from designlab.inference.diagnosis.verdict.confidence import SIGNS, confidence
from designlab.inference.diagnosis.verdict.decision import AT_FLOOR, settled, sure, verdict_of
from designlab.inference.diagnosis.verdict.notes import (
    of_confounded_effects,
    of_unusual_values,
    of_what_is_fitted_along,
)
from designlab.measurement.blocks import BLOCKS
from designlab.measurement.quality.invariants import FrameCheck
from designlab.measurement.shots import Observations
from designlab.report.diagnosis_folder import report_content
from designlab.report.gap import _removed, _what_next, gap_report
from designlab.report.gap_plots import gap_bars, interval_bar
from designlab.report.gap_text import places, statement
from designlab.sensor.design import preset
from designlab.simulation.contact.press import Press
from designlab.simulation.effects import SensorModel, effect
from designlab.simulation.render_cache import Renders
from geometries.probes import parse
from tests import ROOT

DOCUMENT = ROOT / "docs" / "gap.md"
SETS = 2000

VALUE = Value(0.31, 0.2, 0.4, "1", 0.0, 0.25, (0.0, 0.9))
FOUND = Found("vignetting", {"corner_loss": VALUE}, 0.88, ("vignetting",), "corners are darker", True)
CORNERS = Where("corners of the picture", "R", "background", 0.4, 0.05, 6.0, -4.2)
REST = Where("rest of the gel", "R", "background", 0.6, 0.7, 0.6, 1.0)
REPORT = GapReport(
    verdict="named",
    effects=(FOUND,),
    where=(CORNERS, REST),
    gap={
        "train": Level(9.0, 1.2, 1.0, 0.6),
        "select": Level(8.0, 1.3, 1.0, 0.6),
        "final": Level(8.0, 1.7, 1.0, 1.0),
    },
    next_measurement=Advice("a flat field", 4.0, 10.0),
    updated=SensorModel.of(preset("gelsight-2020-flat")),
    model=Path("out/model.toml"),
    candidates=(
        Candidate(1, "numerical", "fitted with every candidate", parameters={"numerical.amount": 0.2}),
        Candidate(1, "banding", "screened out", evidence=0.3),
        Candidate(1, "vignetting", "passed", 0.9, 0.05, 1.0, {"vignetting.corner_loss": 0.31}, 55.0, 2.5),
        Candidate(
            1, "led_profile", "at the bound of red", 0.2, 0.1, 0.5, {"led_profile.red": 9.0}, 12.0, 7.5
        ),
    ),
    notes=("the noise is assumed",),
    provenance={
        "measurement": "a <b>",
        "model": "0" * 64,
        "seed": 1,
        "samples": 256,
        "noise": "repeats",
        "floor": "measured",
        "frames": {"dark": [], "background": ["b.exr"], "train": ["t.exr"], "select": [], "final": ["f.exr"]},
        "rendered": 3,
        "seconds": 12.5,
        "version": "1",
        "blocks": {
            "parity": 0,
            "structure": {
                "select": {"given": {"snr_db": 1.0, "structure_corr": 0.5, "structure_snr_db": 0.1}}
            },
        },
    },
    seen=Observations((), np.zeros(3), "repeats", True, True, ()),
    control=Control("albedo_field", 0.12, 5),
    unexplained=Unexplained(
        0.1, 0.06, 0.14, 0.021, 0.011, {"smooth": 0.6, "grain": 0.2, "edges": 0.01}, "b.exr"
    ),
    overlaps=(Overlap("lens_distortion", "camera_pose", 0.996),),
    checks=(FrameCheck("repeats", False, "1.3 % apart", ("a.exr", "b.exr")),),
)


def paths(value: object, inside: str = "") -> set[str]:
    """Names of all fields, `[]` for the entries of a list, `*` for keys that are not fields."""
    free = ("effects[].parameters", "gap", "candidates[].parameters", "pictures")
    free += ("provenance.blocks.structure", "provenance.blocks.structure.*", "unexplained.parts")
    if isinstance(value, dict):
        found = set()
        for key, entry in value.items():
            name = "*" if inside in free else key
            found |= paths(entry, f"{inside}.{name}" if inside else name)
        return found or {f"{inside}.*" if inside in free else inside}
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return set().union(*(paths(entry, f"{inside}[]") for entry in value))
    return {inside}


def test_every_field_that_is_written_is_documented_and_the_other_way_round() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    table = text[text.index("## report.json") :]
    documented = set()
    for inside, fields in re.findall(r"^\| (report|`[^`]+`) \| (`.+?`) \| ", table, re.MULTILINE):
        within = "" if inside == "report" else f"{inside.strip('`')}."
        documented |= {within + name for name in re.findall(r"`([^`]+)`", fields)}
    assert documented == paths(report_content(REPORT, {"where.png": "where"}))


@pytest.mark.parametrize(
    ("loss", "words"),
    [
        (0.3, None),
        (0.9, "vignetting: corner_loss far beyond what is usual of built sensors: check that part"),
        (0.98, "vignetting: corner_loss far beyond what is usual of built sensors, at the end of its range"),
    ],
)
def test_values_far_beyond_the_usual_are_noted(loss, words) -> None:
    """A quarter of the light is usual at the corner."""
    fitter = Fitter.__new__(Fitter)
    fitter.grain = 0.0
    fitter.forward = SimpleNamespace(
        parameters={"vignetting": effect("vignetting").parameters(preset("gelsight-2020-flat"))}
    )
    state = State(np.ones(3)).with_values("vignetting", {"corner_loss": loss})
    stand = SimpleNamespace(fitter=fitter, state=state, fit=SimpleNamespace(state=state))
    notes = list(of_unusual_values(stand, [FOUND]))  # type: ignore[arg-type]
    assert len(notes) == (words is not None)
    assert all(note.startswith(words) for note in notes)


def test_the_thresholds_that_are_documented_are_those_of_the_code() -> None:
    text = " ".join(DOCUMENT.read_text(encoding="utf-8").split())
    for words in (
        f"`at_floor` lies below {AT_FLOOR:g} floors. *Usual*",
        f"with {100 * OF_PRESSES.of_smooth:g} % of that for smooth errors of light",
        f"divided by {ALIKE:g} since",
        f"within {OF_PRESSES.as_good:g} of its evidence",
        f"within {SURE_SE:g} standard errors",
        f"its evidence is {OF_PRESSES.evidence:g}, with",
        f"it leaves, and {SURE_SE:g} standard errors",
        f"close {100 * LEAST_SHARE:g} % of what is left and, beside effects that need new pictures, "
        f"{100 * LEAST_OF_FIRST:g} % of the first gap",
        f"for up to {OF_PRESSES.most_effects} effects",
        f"beside others an effect needs an evidence of {OF_PRESSES.later:g}",
        f"{BLOCKS} blocks across",
        f"free to {100 * SCALE_SD:g} %",
        f"needs evidence of {OF_BLOCKS.evidence:g}",
        f"up to {OF_BLOCKS.most_effects} effects join, and `at_floor` lies below {single.AT_FLOOR:g} floors",
        f"sizes of probes (to {100 * SIZE_SD:g} %), lateral colour (to {100 * FRINGES_SD:g} %)",
    ):
        assert words in text, words


def test_the_fields_of_the_provenance_are_those_that_a_diagnosis_writes(tmp_path) -> None:
    seen = Observations((), np.zeros(3), "repeats", True, True, ())
    measurement = SimpleNamespace(name="mine")  # of a measurement only its name is written
    model = SensorModel.of(preset("gelsight-2020-flat"))
    written = _provenance(seen, measurement, model, Renders(tmp_path, 256, 1), 0.0)  # type: ignore[arg-type]
    assert written.keys() == REPORT.provenance.keys() - {"blocks"}  # of a single picture
    assert written["frames"].keys() == REPORT.provenance["frames"].keys()


@pytest.mark.parametrize(
    ("changes", "said", "unsaid"),
    [
        (
            {},
            [
                "The model lacks vignetting (the full picture's corners are 31 % (20 to 40) darker than",
                "90 % of the gap is gone",
                "0.88",
            ],
            "or",
        ),
        (
            {"verdict": "partial"},
            ["Part of the gap is explained", "Look at what is left before you design"],
            "The model lacks one",
        ),
        (
            {"verdict": "partial", "effects": (replace(FOUND, confidence=0.3),), "provenance": {}},
            ["The model may lack vignetting", "more likely wrong than right"],
            "Part of the gap",
        ),
        (
            {
                "verdict": "unexplained",
                "effects": (),
                "control": None,
                "gap": {split: Level(8.0, 8.0, 1.0, 7.9) for split in REPORT.gap},
                "provenance": {},
            },
            ["No effect of the catalogue is seen", "8 times its floor", "passes for noise, grain"],
            "real but unexplained",
        ),
        (
            {
                "verdict": "ambiguous",
                "effects": (replace(FOUND, coherence_set=("vignetting", "albedo_field")),),
            },
            ["do not tell apart: vignetting or albedo_field", "The updated model holds vignetting"],
            "unexplained",
        ),
        (
            {
                "verdict": "partial",
                "reserves": ("no frame was repeated",),
                "barred": ("no frame was repeated",),
            },
            ["may lack vignetting", "this measurement is too weak to be sure: no frame was repeated."],
            "The rest",
        ),
        (
            {"verdict": "partial", "reserves": ("0.6 % are saturated",)},
            ["Part of the gap is explained", "With reserve: 0.6 % are saturated.", "The rest is more"],
            "seems",
        ),
        (
            {
                "verdict": "ambiguous",
                "effects": (
                    FOUND,
                    replace(FOUND, name="led_tilt", coherence_set=("led_tilt", "led_profile")),
                ),
            },
            [
                "corners are 31 % (20 to 40) darker than stated), and one of several",
                "apart: led_tilt or led_profile.",
            ],
            "or vignetting",
        ),
        (
            {"verdict": "unexplained", "effects": (), "control": None},
            ["real but unexplained", "8 times its floor", "Nothing was added"],
            "lacks",
        ),
        (
            {"verdict": "at_floor", "effects": (), "control": None},
            ["agree", "Nothing was added", "not excluded"],
            "lacks",
        ),
    ],
)
def test_the_verdict_is_said_in_plain_words(changes, said, unsaid) -> None:
    text = " ".join(statement(replace(REPORT, **changes)))
    for words in said:
        assert words in text
    assert not re.search(rf"\b{unsaid}\b", text)


def test_a_gap_below_the_floor_is_told_of_like_any_other() -> None:
    levels = {split: Level(0.9, 0.61, 1.0, 0.58) for split in REPORT.gap}
    below = replace(REPORT, gap=levels, provenance={})
    text = " ".join(statement(below))
    said = "91 % of the gap is gone on the final presses, which decided nothing: squared residual "
    said += "0.9 before, 0.61 after, where noise, grain"
    assert said in text
    assert "takes away 12 %" in text
    text = " ".join(statement(replace(below, verdict="partial")))
    assert "The rest is more than noise, grain and smooth errors of light leave" in text


ONE, SEVERAL = [("vignetting",)], [("vignetting",), ("led_tilt", "led_profile")]


@pytest.mark.parametrize(
    ("alike", "before", "after", "verdict"),
    [
        ([], 1.2, 1.2, "at_floor"),
        ([], 1.4, 1.4, "unexplained"),
        (ONE, 1.1, 0.7, "named"),
        (ONE, 9.0, 1.5, "named"),
        (ONE, 9.0, 5.5, "unexplained"),  # more than half is left
        (ONE, 1.1, 1.08, "named"),  # nearly nothing is closed, and no gap is left
        (ONE, 1.4, 1.35, "unexplained"),
        (ONE, 1.4, 0.87, "named"),
        (SEVERAL, 9.0, 0.7, "ambiguous"),
        (SEVERAL, 9.0, 5.5, "unexplained"),
    ],
)
def test_the_verdict_follows_from_what_is_left(alike, before, after, verdict) -> None:
    """In units of the floor, of which 0.58 are usual."""
    assert verdict_of(alike, Level(before, after, 1.0, 0.58)) == verdict
    assert verdict_of(alike, Level(7 * before, 7 * after, 7.0, 7 * 0.58)) == verdict


@pytest.mark.parametrize(
    ("verdict", "train", "final", "weakened"),
    [
        ("at_floor", (1.1, 1.1), (0.9, 0.9), "at_floor"),
        ("at_floor", (1.1, 1.1), (2.0, 2.0), "unexplained"),  # something that was not where one looked
        ("at_floor", (2.0, 2.0), (1.1, 1.1), "unexplained"),
        ("named", (9.0, 0.7), (9.0, 0.7), "named"),
        ("named", (9.0, 0.7), (0.75, 0.74), "named"),  # the final presses hardly show it
        ("named", (9.0, 0.7), (9.0, 3.0), "named"),
        ("named", (9.0, 0.7), (9.0, 6.0), "partial"),
        ("named", (9.0, 0.7), (0.77, 1.4), "partial"),  # there it makes things worse
        ("unexplained", (9.0, 9.0), (9.0, 9.0), "unexplained"),
    ],
)
def test_other_presses_can_weaken_a_verdict(verdict, train, final, weakened) -> None:
    gap = {name: Level(*ends, 1.0, 0.58) for name, ends in (("train", train), ("final", final))}
    assert settled(verdict, ONE, gap) == weakened


@pytest.mark.parametrize(("after", "given_back"), [(0.9, False), (1.7, False), (2.0, True), (12.0, True)])
def test_a_last_fit_may_not_undo_what_the_search_reached(after, given_back) -> None:
    assert _gives_back(9.0, 1.0, after) is given_back


def test_a_region_stands_out_by_its_own_excess_and_an_even_one_does_not() -> None:
    said = places((CORNERS, REST))
    assert "corners of the picture (on the untouched gel, channel R), 40 % of the excess on 5 %" in said
    assert "measured darker than simulated" in said
    even = [
        Where(region, "B", "press", share, share, 1.0, 3.0)
        for region, share in (("rest of the gel", 0.7), ("corners of the picture", 0.3))
    ]
    assert places(even) == (
        "Where: 100 % of the excess is in channel B; 100 % in presses. "
        "No region stands out: it is spread over the picture."
    )


@pytest.mark.parametrize("count", [4, 12, 30])
def test_intervals_of_drawn_strengths_hold_as_often_as_they_say(count) -> None:
    random = np.random.default_rng(count)
    draws = 0.02 * random.standard_normal((SETS, count))
    draws -= draws.mean(axis=1, keepdims=True)  # gains of the LED groups take the mean
    held = [low <= 0.02 <= high for low, high in map(of_deviation, draws)]
    assert abs(np.mean(held) - 0.95) < 3 * np.sqrt(0.95 * 0.05 / SETS)


def test_an_error_of_the_draws_widens_the_interval_upwards_alone() -> None:
    draws = np.array([0.02, -0.01, 0.015, -0.025])
    sharp, blurred = of_deviation(draws), of_deviation(draws, 1e-4)
    assert blurred[0] == sharp[0]
    assert blurred[1] > sharp[1]


@pytest.mark.parametrize("count", [5, 20])
def test_intervals_of_an_amplitude_hold_as_often_as_they_say(count) -> None:
    random = np.random.default_rng(count)
    phase = random.uniform(0, 2 * np.pi, (SETS, count))
    sigma = 0.002
    waves = 0.015 * np.stack([np.sin(phase), np.cos(phase)], axis=-1)
    waves += sigma * random.standard_normal(waves.shape)
    held = [low <= 0.015 <= high for low, high in (of_amplitudes(w, 2 * sigma**2) for w in waves)]
    assert np.mean(held) > 0.93


def test_the_page_shows_what_was_found_tried_and_not_known(tmp_path) -> None:
    unknown = replace(VALUE, low=None, high=None)
    report = replace(REPORT, effects=(replace(FOUND, parameters={"corner_loss": VALUE, "red_1": unknown}),))
    text = gap_report(report_content(report, {}), tmp_path / "page.html").read_text(encoding="utf-8")
    shown = " ".join(re.sub(r"<(script|style)>.*?</\1>|<[^>]+>", " ", text, flags=re.DOTALL).split())
    for words in (
        "measurement a &lt;b&gt;",
        "named The model lacks vignetting",
        "corners of the picture R untouched gel 40 5 6 times darker, mean 4.2 sd",
        "vignetting corner loss 0.31 0.2 to 0.4",
        "red 1 0.31 not known",
        "0 to 0.9 0.88 none the design",
        "albedo_field , fitted in the same way, takes away 12 % of the gap",
        "vignetting accepted corner_loss 0.31 55 0.900 ± 0.050 100 % 2.5",
        "led_profile at the bound of red red 9 12 0.20 ± 0.10 50 % 7.5",
        "Set aside before fitting, with their evidence by linear approximation: banding 0.3",
        "numerical : fitted with every candidate (amount 0.2)",
        "A flat field. the candidates would differ by 4 standard deviations (predicted)",
        "time in the lab about 10 min",
        "final 8 1.7 1 1 90",
        "Only products are known",
        "repeats fails 1.3 % apart",
    ):
        assert words in shown, words
    assert "<b>" not in text.partition("<title>")[2].partition("</main>")[0].replace("</b>", "")


def test_bars_of_the_gap_begin_at_what_is_usual() -> None:
    drawn = gap_bars(
        {"final": {"before": 100.0, "after": 1.0, "floor": 1.7, "usual": 1.0}}, {"final": "final"}
    )
    before, after = (float(width) for width in re.findall(r'<rect x="\d+" y="\d+" width="([\d.]+)"', drawn))
    assert after < 2
    halfway = gap_bars(
        {"final": {"before": 100.0, "after": 10.0, "floor": 1.7, "usual": 1.0}}, {"final": "final"}
    )
    long, half = (float(width) for width in re.findall(r'<rect x="\d+" y="\d+" width="([\d.]+)"', halfway))
    assert long == before
    assert half == pytest.approx(long / 2, abs=0.1)  # logarithmic


def test_the_drawing_of_a_value_keeps_order_and_shows_a_bound_that_is_near() -> None:
    drawn = interval_bar(vars(VALUE) | {"bounds": list(VALUE.bounds)})
    value = float(re.search(r'<circle cx="([\d.]+)"', drawn)[1])
    *_, interval = re.findall(r'<line x1="([\d.]+)" y1="11.0" x2="([\d.]+)"', drawn)
    assert float(interval[0]) < value < float(interval[1])
    assert drawn.count("<path") == 2  # 0 and 0.9 lie within what is drawn
    far = interval_bar(vars(VALUE) | {"bounds": [-50.0, 50.0]})
    assert "<path" not in far


def test_confidence_of_a_report_is_what_was_learnt_of_names_like_it() -> None:
    passed = [c for c in REPORT.candidates if c.name == "vignetting"]
    assert passed
    shown = REPORT.to_json()
    shown["candidates"] = [
        {**c, "outcome": "passed"} for c in shown["candidates"] if c["name"] == "vignetting"
    ]
    weights, scores, right = shares_right()

    def said(after: float, names: list[str]) -> float:
        shown["gap"]["select"] |= {"after": after, "usual": 0.6}
        shown["effects"][0]["coherence_set"] = names
        return confidence(shown, 0)

    good, worse, alike = (
        said(0.6, ["vignetting"]),
        said(6.0, ["vignetting"]),
        said(0.6, ["vignetting", "b", "c"]),
    )
    assert good > worse
    assert good >= alike
    assert 0.0 < worse <= good <= round(max(right), 3) < 1.0  # below all that was learnt it falls further
    assert weights.keys() == SIGNS.keys()
    assert list(scores) == sorted(scores)


@pytest.mark.parametrize("split", ["select", "final"])
def test_without_grain_a_name_that_leaves_some_of_the_gap_is_hardly_ever_right(split) -> None:
    """Of 34 names that left more than 1.5 % of it one was right."""
    shown = REPORT.to_json()
    shown["candidates"] = [{**c, "outcome": "passed"} for c in shown["candidates"]]

    def said(grain: float, left: float) -> float:
        shown["unexplained"]["grain_rms"] = grain
        shown["gap"] = {name: {"before": 10.6, "after": 0.6, "usual": 0.6} for name in ("select", "final")}
        shown["gap"][split]["after"] += 10.0 * left
        return confidence(shown, 0)

    assert said(0.0, 0.014) == said(0.01, 0.014) > 0.8
    assert said(0.01, 0.016) > 0.8
    assert said(0.0, 0.016) == pytest.approx(1 / 34, abs=5e-4)


@pytest.mark.parametrize("right", [0.49, 0.51])
def test_a_name_that_is_more_likely_wrong_than_right_is_given_with_reserve(right, monkeypatch) -> None:
    candidates = tuple(replace(c, outcome="passed") for c in REPORT.candidates if c.name == "vignetting")
    report = replace(REPORT, verdict="named", candidates=candidates)
    monkeypatch.setattr(sys.modules[sure.__module__], "confidence", lambda *_: right)
    found = sure(report, 6)
    assert found.verdict == ("named" if right > 0.5 else "partial")
    assert found.effects[0].confidence == right


@pytest.mark.parametrize(("presses", "most"), [(2, 0.75), (5, 6 / 7), (6, 1.0)])
def test_few_presses_limit_confidence(presses, most) -> None:
    candidates = tuple(replace(c, outcome="passed") for c in REPORT.candidates if c.name == "vignetting")
    levels = {split: Level(9.0, 0.5, 1.0, 0.58) for split in REPORT.gap}
    report = replace(REPORT, candidates=candidates, gap=levels)
    (found,) = sure(report, presses).effects
    assert found.confidence == min(confidence(report.to_json(), 0), most)


@pytest.mark.parametrize(
    ("along", "notes"),
    [
        ({}, []),
        ({"fringes": 0.004, "sizes": {"sphere(radius=3)": 0.02}}, []),
        ({"fringes": 0.006}, ["the lens magnifies red 0.60% more, and blue less, than green"]),
        ({"fringes": -0.006}, ["the lens magnifies blue 0.60% more, and red less, than green"]),
        (
            {"sizes": {"sphere(radius=3)": 0.03, "sphere(radius=5)": -0.04}},
            [
                "probe sphere(radius=3) fits best 3.0% larger than stated: measure it",
                "probe sphere(radius=5) fits best 4.0% smaller than stated: measure it",
            ],
        ),
    ],
)
def test_what_is_fitted_along_is_told_where_it_is_more_than_usual(along, notes) -> None:
    stand = SimpleNamespace(fit=SimpleNamespace(state=State(np.ones(1), {}, **along)))
    assert list(of_what_is_fitted_along(stand)) == notes


def test_what_does_much_the_same_by_its_physics_is_noted_where_the_design_can_have_it():
    elastic, kernel = (preset(f"gelsight-2020-flat{kind}") for kind in ("-elastic", ""))
    found = [Found.of(name, {}, 0.9, (name,)) for name in ("vignetting", "gel_thickness")]
    assert list(of_confounded_effects(found, elastic)) == [
        "gel_thickness: depth_offset, friction, contact.poisson would do much the same"
    ]
    offset = [Found.of("depth_offset", {}, 0.9, ("depth_offset",))]
    assert list(of_confounded_effects(offset, elastic)) == [
        "depth_offset: gel_thickness would do much the same"
    ]
    assert not list(of_confounded_effects(offset, kernel))
    # What is tried by name alone is no rival of what is found unasked.
    assert not list(
        of_confounded_effects([Found.of("lens_distortion", {}, 0.9, ("lens_distortion",))], kernel)
    )


def test_effects_of_elastic_gels_are_tried_of_these_alone_and_some_only_by_name():
    elastic, kernel = (SensorModel(design=preset(f"gelsight-2020-flat{kind}")) for kind in ("-elastic", ""))
    seen = Observations((), np.zeros(3), "", repeats=False, dark=False, notes=())
    own = {"gel_thickness", "friction", "skin_length"}
    of_kernels = {"contact_kernel", "contact_profile", "contact_layer"}
    assert set(_names(elastic, None, seen)) - set(_names(kernel, None, seen)) == own
    assert set(_names(kernel, None, seen)) - set(_names(elastic, None, seen)) == of_kernels
    asked = ["wetting", "probe_edge", "probe_size", "friction"]
    assert not set(asked) & set(_names(kernel, None, seen))
    assert _names(kernel, asked, seen) == asked[:3]
    assert _names(elastic, asked, seen) == asked
    (said,) = _untried(asked, kernel, seen)
    assert said == "friction was not tried: the design gelsight-2020-flat cannot have it"
    assert not list(_untried(None, kernel, seen))
    # Nothing was learnt of single pictures without some effects.
    press = Press(probe=parse("triangle:5"), depth_mm=0.5)
    alone = replace(seen, shots=(SimpleNamespace(lit=np.ones(3), ball=None, press=press, view=None),))
    assert set(asked[:3]) <= set(_names(kernel, None, alone))


def test_a_further_name_that_is_more_likely_wrong_is_said_to_be_so() -> None:
    """The first name stands; one beside it of less than a half is no finding."""
    first, second = (
        replace(REPORT.effects[0], name=name, summary=text, confidence=confidence, parameters={})
        for name, text, confidence in (("banding", "bands", 0.9), ("camera_pose", "camera moved", 0.36))
    )
    (said, *_) = statement(replace(REPORT, verdict="named", effects=(first, second), provenance={}))
    assert said == (
        "The model lacks banding (bands). It may lack camera_pose (camera moved) too, but that is more "
        "likely wrong than right."
    )


def test_many_effects_are_named_first_and_told_one_by_one() -> None:
    """One sentence with the values of all would be too long."""
    names = ("banding", "camera_pose", "vignetting")
    effects = tuple(
        replace(REPORT.effects[0], name=name, summary=f"what {name} does", confidence=0.9, parameters={})
        for name in names
    )
    first, *others = statement(replace(REPORT, verdict="named", effects=effects, provenance={}))
    assert first == "The model lacks banding, camera_pose and vignetting."
    assert others[0].startswith("banding: what banding does. Confidence: 0.90 (")
    assert others[1].startswith("camera_pose: what camera_pose does. Confidence: 0.90; ")


@pytest.mark.parametrize(("verdict", "command"), [("named", True), ("partial", False)])
def test_what_is_doubtful_is_measured_before_it_is_scored(verdict, command) -> None:
    shown = REPORT.to_json() | {"verdict": verdict, "next_measurement": "repeat the background", "next": None}
    words, given = _what_next(shown)
    assert (words == "Repeat the background.") is not command
    assert given.startswith("designlab evaluate") is command
    assert _what_next(shown | {"next_measurement": ""})[1].startswith("designlab evaluate")


def test_the_first_screen_says_what_was_judged_and_what_is_left_anyway() -> None:
    shown = REPORT.to_json() | {"gap": {"final": {"before": 20.0, "after": 2.0, "usual": 1.0}}}
    assert "blocks" in shown["provenance"]
    of_blocks = _removed(shown)
    assert of_blocks.startswith(
        "On blocks of the picture that decided nothing the excess falls from 19 to 1."
    )
    assert "left by its grain and what the simulation may be wrong by" in of_blocks
    shown["provenance"] = {}
    assert _removed(shown).startswith("On presses that decided nothing the excess falls from 19 to 1.")
    assert "left by noise, grain and smooth errors of light" in _removed(shown)
    shown["unexplained"]["grain_rms"] = 0.0
    assert "left by noise and what the simulation may be wrong by" in _removed(shown)
