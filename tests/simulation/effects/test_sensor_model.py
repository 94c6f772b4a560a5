"""Sensor models: what is known of effects, their versions, and that every user of a design heeds them."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from designlab.app.cli import main
from designlab.evaluation.protocol import EvaluationProtocol
from designlab.fabrication import to_make
from designlab.inference.calibration import calibrate
from designlab.measurement.light_probe.picture import light_probe
from designlab.optimization.study import Study, sweep
from designlab.report.view3d import render_view
from designlab.sensor.design import DesignError, preset
from designlab.simulation.contact.press import Press
from designlab.simulation.effects import CATALOGUE, AppliedEffect, ModelError, SensorModel, effect, load_model
from designlab.simulation.effects.known import Covariance, Domain, Provenance
from designlab.simulation.simulator import Simulator
from designlab.validation.synthetic import plant
from geometries.probes import sphere, triangle

DESIGN = preset("gelsight-2020-flat")
MIXED = ("R_from_green", "R_from_blue", "G_from_red", "G_from_blue", "B_from_red", "B_from_green")
NAMES = ("colour_mixing", "point_spread")
KNOWN = Covariance(
    parameters=("colour_mixing.R_from_green", "colour_mixing.R_from_blue", "point_spread.sigma_um"),
    matrix=((4e-4, 3e-4, 0.0), (3e-4, 4e-4, 0.0), (0.0, 0.0, 2.5e5)),
)
DOMAIN = Domain(
    depth_mm=(0.4, 0.8), x_mm=(-4.0, 4.0), y_mm=(-3.0, 3.0), probes=("sphere",), exposure=(0.5, 1.0)
)
MOVED = {"x_mm": 0.2, "y_mm": 0.0, "z_mm": 0.0, "tilt_x_deg": 0.0, "tilt_y_deg": 0.0}


def provenance(**changes: object) -> Provenance:
    known = {
        "measurement": "bench, first day",
        "measurement_digest": "0" * 64,
        "design": DESIGN.name,
        "design_digest": DESIGN.digest,
        "verdict": "named",
        "gap": {"final": {"before": 9.0, "after": 1.2, "floor": 1.0}},
        "seed": 3,
        "samples": 256,
        "version": "0.1.0",
        "date": "2026-11-22",
    }
    return Provenance.model_validate(known | changes)


def model(*more: AppliedEffect, **known: object) -> SensorModel:
    effects = (
        AppliedEffect(name="point_spread", values={"sigma_um": 60.0}),
        AppliedEffect(name="colour_mixing", values=dict.fromkeys(MIXED, 0.0) | {"R_from_green": 0.1}),
    )
    found = SensorModel(
        design=DESIGN, effects=effects, covariance=KNOWN, domain=DOMAIN, provenance=provenance(**known)
    )
    for one in more:
        found = found.with_effect(one)
    return found


def test_a_file_says_all_that_is_known(tmp_path) -> None:
    path = model().save(tmp_path / "model.toml")
    assert load_model(path) == model()


def test_no_version_is_lost(tmp_path) -> None:
    path = tmp_path / "model.toml"
    versions = [model(), model().sampled(1), model().transferable().replace({"leds.tilt_deg": 25.0})]
    for version in versions:
        version.save(path)
    versions[-1].save(path)
    kept = {load_model(found).digest for found in tmp_path.iterdir()}
    assert kept == {version.digest for version in versions}
    assert load_model(path).digest == versions[-1].digest
    assert versions[1].parent == versions[0].digest


def test_a_design_is_not_overwritten_by_a_model(tmp_path) -> None:
    path = tmp_path / "design.toml"
    path.write_text("[leds]\n", encoding="utf-8")
    with pytest.raises(ModelError, match="is no sensor model and not overwritten"):
        model().save(path)


def test_a_file_of_the_first_format_is_read(tmp_path) -> None:
    """Its digest was that of design and values alone."""
    import hashlib
    import json

    content = [DESIGN.digest, [["contact_kernel", [["length_ratio", 1.5]]]]]
    digest = hashlib.sha256(json.dumps(content).encode()).hexdigest()
    new = SensorModel(
        design=DESIGN, effects=(AppliedEffect(name="contact_kernel", values={"length_ratio": 1.5}),)
    )
    text = new.dumps().replace("format = 2", "format = 1").replace(new.digest, digest)
    text = text.replace("coherence_set = []\n", "").replace("[effects.bounds]\n", "")
    (tmp_path / "old.toml").write_text(text, encoding="utf-8")
    assert load_model(tmp_path / "old.toml").effects == new.effects
    (tmp_path / "new.toml").write_text(text.replace("format = 1", "format = 3"), encoding="utf-8")
    with pytest.raises(ModelError, match="reads formats 1 and 2, got 3"):
        load_model(tmp_path / "new.toml")


def test_the_digest_covers_what_is_known_but_not_the_day() -> None:
    others = [
        model(verdict="partial"),
        model().model_copy(update={"covariance": None}),
        model().model_copy(update={"domain": None}),
        model().sampled(1),
    ]
    assert len({found.digest for found in [model(), *others]}) == 5
    assert model(date="2027-01-01").digest == model().digest


def test_draws_have_the_covariance_they_come_from() -> None:
    parameters = {f"{name}.{p.name}": p for name in NAMES for p in effect(name).parameters(DESIGN)}
    values = dict.fromkeys(KNOWN.parameters, 0.0) | {
        "colour_mixing.R_from_green": 0.1,
        "point_spread.sigma_um": 60.0,
    }
    draws = [KNOWN.draw(parameters, values, seed=seed) for seed in range(3000)]
    mixing = np.array([[d[name] for name in KNOWN.parameters[:2]] for d in draws])
    found = np.cov(mixing.T)
    assert found == pytest.approx(np.array(KNOWN.matrix)[:2, :2], rel=0.08)
    assert mixing.mean(axis=0) == pytest.approx([0.1, 0.0], abs=3 * 0.02 / np.sqrt(3000))
    # The blur's square is what is normal.
    squares = np.array([d["point_spread.sigma_um"] ** 2 for d in draws])
    assert squares.mean() == pytest.approx(3600.0, abs=3 * 500 / np.sqrt(3000))
    assert squares.std() == pytest.approx(500.0, rel=0.05)


def test_draws_stay_within_the_bounds() -> None:
    wide = model().model_copy(
        update={"covariance": Covariance(parameters=("point_spread.sigma_um",), matrix=((1e9,),))}
    )
    values = [wide.sampled(seed).effects[0].values["sigma_um"] for seed in range(300)]
    assert 0.0 <= min(values) < 60.0 < max(values) <= 300.0
    assert len(set(values)) == 300  # cut off, not moved to the bounds
    assert model().sampled(5) == model().sampled(5)


def test_a_covariance_must_be_one() -> None:
    with pytest.raises(ValueError, match="no negative eigenvalues"):
        Covariance(parameters=("a.b", "c.d"), matrix=((1.0, 2.0), (2.0, 1.0)))
    with pytest.raises(ValueError, match="needs 2 rows and columns"):
        Covariance(parameters=("a.b", "c.d"), matrix=((1.0,),))
    with pytest.raises(ValueError, match=r"no effect has vignetting\.corner_loss"):
        SensorModel(
            design=DESIGN, covariance=Covariance(parameters=("vignetting.corner_loss",), matrix=((1.0,),))
        )


def test_what_belongs_to_one_unit_stays_behind() -> None:
    unit = model(AppliedEffect(name="camera_pose", values=MOVED))
    kind = unit.transferable()
    assert [a.name for a in unit.effects] == ["camera_pose", "point_spread", "colour_mixing"]
    assert [a.name for a in kind.effects] == ["point_spread", "colour_mixing"]
    assert kind.covariance == KNOWN
    assert kind.parent == unit.digest
    assert not any(e.transferable for e in CATALOGUE if e.drawn)


def test_effects_go_with_a_changed_design_or_are_refused() -> None:
    changed = model().replace({"leds.tilt_deg": 30.0})
    assert changed.design == DESIGN.replace({"leds.tilt_deg": 30.0})
    assert changed.effects == model().effects
    core = preset("gelsight-2020-flat-core")
    absorbing = AppliedEffect(
        name="absorption", values={f"{name}_per_mm": 0.004 for name in core.group_names}
    )
    with pytest.raises(DesignError, match=r"effects\.absorption\.values"):
        SensorModel(design=core, effects=(absorbing,)).on(DESIGN)


def test_use_beyond_what_was_fitted_is_said() -> None:
    inside = Press(probe=sphere(diameter_mm=4), depth_mm=0.6)
    assert model().warnings([None, inside]) == ()
    for press, text in (
        (inside.model_copy(update={"depth_mm": 1.2}), "0.4 to 0.8 mm deep; here 1 of 2 are not, from 1.2"),
        (inside.model_copy(update={"centre_mm": (5.0, 0.0)}), "-4 to 4 mm from the middle along x"),
        (Press(probe=triangle(side_mm=5), depth_mm=0.6), "of sphere; here triangle is pressed"),
    ):
        (said,) = model().warnings([inside, press])
        assert text in said
    (said,) = model().replace({"leds.tilt_deg": 30.0}).warnings()
    assert f"fitted to another design, {DESIGN.name}" in said
    (said,) = model(verdict="partial").warnings()
    assert "verdict of the diagnosis: partial" in said
    alone = model(AppliedEffect(name="exposure_drift", values={"rms": 0.02}))
    (said,) = alone.warnings()
    assert said.startswith("exposure_drift: not in simulated pictures")
    unsure = AppliedEffect(
        name="vignetting", values={"corner_loss": 0.2}, coherence_set=("vignetting", "led_profile")
    )
    (said,) = model(unsure).warnings()
    assert said == "vignetting: the measurement did not tell it from led_profile"


def applied(name: str) -> SensorModel:
    values = {p.name: p.null + (0 if p.shape else p.sd) for p in effect(name).parameters(DESIGN)}
    return SensorModel(design=DESIGN, effects=(AppliedEffect(name=name, values=values),))


@pytest.mark.renders
def test_pictures_carry_the_warnings() -> None:
    simulator = Simulator(model(), columns=24, samples=4, seed=1)
    assert simulator.frame(None).warnings == ()
    deep = Press(probe=sphere(diameter_mm=4), depth_mm=1.0)
    assert "mm deep" in simulator.frame(deep).warnings[0]


@pytest.mark.renders
def test_what_the_camera_does_to_the_signal_is_in_the_pictures_of_an_evaluation() -> None:
    frame = Simulator(DESIGN, columns=24, samples=4, seed=1).frame(None)
    pictures = {}
    for name in ("black_level", "response_curve"):
        found = applied(name)
        plain, changed = (
            EvaluationProtocol(DESIGN, 1.0, 1, model=one).picture(frame, 0)
            for one in (SensorModel.of(DESIGN), found)
        )
        # Effects act before the converter rounds: both pictures are off by up to half a step.
        step = 1 / (2**DESIGN.camera.bit_depth - 1)
        expected = np.clip(found.on_signal(plain), 0, 1)
        assert changed == pytest.approx(expected, abs=1.5 * step)
        pictures[name] = np.abs(changed - plain)
    assert pictures["black_level"].mean() == pytest.approx(0.015, rel=0.01)
    assert pictures["response_curve"].max() > 0.01


@pytest.mark.renders
def test_a_light_probe_sees_the_lens() -> None:
    plain = light_probe(DESIGN, columns=24, samples=4, seed=1)
    dim = light_probe(applied("vignetting"), columns=24, samples=4, seed=1)
    column, row = plain.view.centres()
    camera = DESIGN.camera
    radius = np.hypot(column - camera.centre_px[0], row - camera.centre_px[1])
    falloff = 1 - 0.25 * (2 * radius / np.hypot(camera.width_px, camera.height_px)) ** 2
    assert dim.basis == pytest.approx(plain.basis * falloff, rel=1e-5)


def test_files_to_make_are_of_the_kind_not_of_the_unit() -> None:
    kernel = AppliedEffect(name="contact_kernel", values={"length_ratio": 1.5})
    built = SensorModel(design=DESIGN, effects=(AppliedEffect(name="camera_pose", values=MOVED), kernel))
    made, notes = to_make(built)
    assert made.camera.position_mm == DESIGN.camera.position_mm
    assert made.contact.kernel_length_mm == 1.5 * DESIGN.contact.kernel_length_mm
    assert notes == [
        "left out, since they belong to one built unit: camera_pose",
        "with effects of a sensor model: contact_kernel",
    ]
    assert to_make(DESIGN) == (DESIGN, [])


def test_what_takes_no_model_says_why(tmp_path, capsys) -> None:
    path = model().save(tmp_path / "model.toml")
    with pytest.raises(TypeError, match="effects to plant are given by `effects`"):
        plant(model(), effects={}, out=tmp_path / "set", seed=1)
    with pytest.raises(TypeError, match="effects of a built sensor are not drawn"):
        render_view(model(), tmp_path / "view.png")
    assert main(["gap", "plant", "--design", str(path), "--out", str(tmp_path / "set")]) == 2
    assert "point_spread, colour_mixing" in capsys.readouterr().err
    assert not (tmp_path / "set").exists()


def test_a_study_inherits_what_is_known(tmp_path) -> None:
    built = model(AppliedEffect(name="camera_pose", values=MOVED))
    path = built.save(tmp_path / "built.toml")
    study = Study.model_validate({"base": path, "parameters": {"leds.tilt_deg": {"low": 0, "high": 60}}})
    changed = DESIGN.replace({"leds.tilt_deg": 40.0})
    subject = study.subject(changed)
    assert subject.digest == built.transferable().on(changed).digest
    assert subject.covariance == KNOWN
    assert study.model["parent"] == built.digest
    own = Study.model_validate(
        {"base": path, "effects": (), "parameters": {"leds.tilt_deg": {"low": 0, "high": 60}}}
    )
    assert own.subject(changed) == changed


@pytest.mark.slow
def test_warnings_reach_a_sweep() -> None:
    answer = SimpleNamespace(scores={}, warnings=("beyond what was fitted",))
    table = sweep(model(), {"leds.tilt_deg": [20.0, 30.0]}, progress=False, evaluator=lambda *_, **__: answer)
    assert list(table["warnings"]) == ["beyond what was fitted"] * 2


def test_calibration_refuses_effects_it_would_forget(tmp_path) -> None:
    with pytest.raises(ValueError, match="must be a design without effects"):
        calibrate(None, model(), seed=1)  # refused before the measurement is looked at


def test_pairs_of_effects_keep_the_covariance_of_each() -> None:
    new = Covariance(parameters=("vignetting.corner_loss",), matrix=((1e-4,),))
    joint = new.beside(KNOWN)
    for a, b in itertools.product(range(4), range(4)):
        both = {a, b} <= {1, 2, 3}
        expected = KNOWN.matrix[a - 1][b - 1] if both else (1e-4 if a == b == 0 else 0.0)
        assert joint.matrix[a][b] == expected
    assert joint.of(KNOWN.parameters) == KNOWN
