"""Directional light: closed forms, its file, its fit to pictures of its own and to rendered ones."""

import numpy as np
import pytest

from designlab.app import cli
from designlab.inference.calibration import calibrate
from designlab.inference.calibration.directional import Directional
from designlab.measurement import MeasuredFrame, Measurement, load_measurement, write_measurement
from designlab.measurement.compare import compare_model
from designlab.measurement.shots import observe
from designlab.sensor.camera import View
from designlab.sensor.design import DesignError, preset
from designlab.simulation.contact.press import Press
from designlab.simulation.directional_light import DirectionalLight, load_any_model
from designlab.simulation.effects.model import ModelError, SensorModel, load_model
from designlab.simulation.simulator import Simulator
from geometries.probes import parse

DESIGN = preset("gelsight-2020-flat")
CROP = (987, 815, 480, 480)
SIDE = 60
VIEW = View(*map(float, CROP), SIDE, SIDE)
BALL = Press(probe=parse("sphere:4"), depth_mm=0.5)
SHARP = {"contact.kernel_length_mm": 0.0}


def model(reflection="diffuse", design=DESIGN, **changes):
    return DirectionalLight.of(design, reflection).replace(changes)


def lit_from(*angles, design=DESIGN, reflection="diffuse", **changes):
    lights = [{"azimuth_deg": azimuth, "elevation_deg": elevation} for azimuth, elevation in angles]
    return model(reflection, design, lights=lights, **changes)


class TestShading:
    @pytest.mark.parametrize("reflection", ["diffuse", "phong"])
    def test_flat_gel_gives_the_sine_of_the_elevation(self, reflection):
        found = lit_from((10, 20), (130, 50), (250, 70), reflection=reflection).components(None, VIEW)
        for picture, elevation in zip(found, (20, 50, 70), strict=False):
            np.testing.assert_allclose(picture, np.sin(np.radians(elevation)), rtol=1e-12)

    def test_ball_cap_is_lit_as_its_normals_say(self):
        """Sharp gel takes the ball's shape: viewing rays meet the sphere where a quadratic equation says."""
        angles = (40, 30), (160, 30), (280, 80)
        sharp = DESIGN.replace(SHARP)
        column, row = DESIGN.project_px(0.0, 0.0)
        view = View(column - 90, row - 90, 180.0, 180.0, 40, 40)
        found = lit_from(*angles, design=sharp).components(BALL, view)
        rays = Simulator(sharp, view=view, seed=0).rays
        radius, middle = 2.0, 0.5 - 2.0  # of the ball, below the undeformed gel
        a = rays.slope_x**2 + rays.slope_y**2 + 1
        b = rays.x_mm * rays.slope_x + rays.y_mm * rays.slope_y - middle
        c = rays.x_mm**2 + rays.y_mm**2 + middle**2 - radius**2
        z = (np.sqrt(np.maximum(b**2 - a * c, 0.0)) - b) / a
        x, y = rays.x_mm + z * rays.slope_x, rays.y_mm + z * rays.slope_y
        normal = np.stack([x, y, z - middle]) / radius
        within = np.hypot(x, y) < 1.2  # contact ends at 1.32 mm
        assert within.sum() > 300
        for picture, (azimuth, elevation) in zip(found, np.radians(angles), strict=True):
            light = np.array(
                [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
            )
            expected = np.maximum(np.tensordot(light, normal, axes=1), 0.0)
            np.testing.assert_allclose(picture[within], expected[within], atol=2e-3)

    def test_side_facing_the_light_is_bright_and_the_other_in_attached_shadow(self):
        right = lit_from((0, 5), (90, 5), (180, 5), design=DESIGN.replace(SHARP)).components(BALL, VIEW)
        for picture, (x, y) in zip(right, ((1, 0), (0, 1), (-1, 0)), strict=True):
            row, column = np.unravel_index(picture.argmax(), picture.shape)
            middle = np.array(DESIGN.project_px(0.0, 0.0)) - CROP[:2]
            pixel_px = CROP[2] / SIDE
            across = (column + 0.5) * pixel_px - middle[0]
            up = middle[1] - (row + 0.5) * pixel_px
            assert across * x + up * y > 4 * pixel_px
            assert picture.min() == 0.0

    def test_lobe_is_one_in_the_mirror_direction_and_falls_as_its_power(self):
        """The camera's direction at a pixel of flat gel, mirrored, is where the light must stand."""
        rays = Simulator(DESIGN, view=VIEW, seed=0).rays
        v = np.array([rays.slope_x[14, 33], rays.slope_y[14, 33], 1.0])
        v /= np.linalg.norm(v)
        azimuth = float(np.degrees(np.arctan2(-v[1], -v[0])))
        elevation = float(np.degrees(np.arcsin(v[2])))
        lights = (azimuth, elevation), (azimuth, elevation - 30), (azimuth, elevation - 60)
        found = lit_from(*lights, reflection="phong", exponent=7.0).components(None, VIEW)[3:, 14, 33]
        np.testing.assert_allclose(found, np.cos(np.radians([0, 30, 60])) ** 7, rtol=1e-9)

    def test_no_lobe_from_a_light_behind_the_surface(self):
        steep = lit_from(
            (0, 2), (0, 2), (0, 2), reflection="phong", exponent=1.0, design=DESIGN.replace(SHARP)
        )
        diffuse, lobe = steep.components(BALL, VIEW)[[0, 3]]
        assert (diffuse == 0).any()
        assert not lobe[diffuse == 0].any()

    def test_signal_adds_groups_that_are_on_exposure_and_floor(self):
        each = model(floor=[0.1, 0.2, 0.3])
        whole = each.signal(BALL, VIEW) - each.floor
        parts = sum(each.signal(BALL, VIEW, lit=lit, exposure=2.0) - each.floor for lit in np.eye(3))
        np.testing.assert_allclose(parts, 2 * whole, rtol=1e-12)
        dark = each.signal(BALL, VIEW, lit=[0, 0, 0])
        np.testing.assert_allclose(dark, np.broadcast_to([0.1, 0.2, 0.3], dark.shape))

    def test_vignetting_and_the_gels_outline(self):
        small = DESIGN.replace({"elastomer.width_mm": 8.0, "camera.vignetting.cosine_power": 4.0})
        view = small.view(80)
        rays = Simulator(small, view=view, seed=0).rays
        picture = model(design=small).components(None, view)[0]
        assert not picture[np.hypot(rays.x_mm, rays.y_mm) > 4.7].any()  # corners of the hexagon at 4.62 mm
        ratio = picture / small.camera.vignette(view)
        middle = np.hypot(rays.x_mm, rays.y_mm) < 3.9
        np.testing.assert_allclose(ratio[middle], ratio[middle].mean(), rtol=1e-12)

    def test_lights_start_where_the_leds_stand(self):
        design = DESIGN.replace({"leds.emitting_spans_mm": [[-1.0, 1.0]]})
        leds = design.leds
        for light, group in zip(DirectionalLight.of(design, "diffuse").lights, leds.groups, strict=True):
            assert light.azimuth_deg == pytest.approx(group.azimuth_deg[0])
            assert np.tan(np.radians(light.elevation_deg)) == pytest.approx(leds.height_mm / leds.radius_mm)

    @pytest.mark.renders
    def test_bright_sides_are_those_of_the_simulation(self):
        """Relative to the untouched gel; the rest is near-field light and shadow."""
        simulator = Simulator(DESIGN, view=VIEW, samples=64, seed=3)
        frames = [simulator.frame(press).basis for press in (BALL, None)]
        light = model()
        shaded = [light.components(press, VIEW) for press in (BALL, None)]
        for group in range(3):
            rendered = frames[0][group] / frames[1][group]
            ratio = shaded[0][group] / shaded[1][group]
            assert np.corrcoef(rendered.ravel(), ratio.ravel())[0, 1] > 0.9


class TestFile:
    @pytest.mark.parametrize("reflection", ["diffuse", "phong"])
    def test_round_trip(self, reflection, tmp_path):
        light = model(reflection, floor=[0.01, 0.02, 0.03], found_in="somewhere")
        (tmp_path / "m.toml").write_text(light.dumps(), encoding="utf-8")
        again = load_any_model(tmp_path / "m.toml")
        assert again == light
        assert again.digest == light.digest

    def test_digest_follows_numbers_and_not_names(self):
        light = model()
        assert light.replace({"found_in": "elsewhere"}).digest == light.digest
        assert light.replace({"floor": [0.0, 0.0, 1e-6]}).digest != light.digest
        assert light.replace({"design.contact.kernel_m": 150.0}).digest != light.digest

    def test_designs_and_sensor_models_are_still_read(self, tmp_path):
        assert load_any_model("default") == load_model("default")
        (tmp_path / "s.toml").write_text(SensorModel(design=DESIGN).dumps(), encoding="utf-8")
        assert load_any_model(tmp_path / "s.toml") == SensorModel(design=DESIGN)

    @pytest.mark.parametrize(
        ("old", "new", "named"),
        [
            ("version = 1", "version = 2", r"field version: must be 1, got 2"),
            ("elevation_deg = ", "elevation_deg = 9", r"field lights\.0\.elevation_deg: .* or equal to 89"),
            ("exponent = 5.0", "exponent = 500.0", r"field exponent: .*less than or equal to 200"),
            ("exponent = 5.0", "", r"exponent: a number for reflection 'phong'"),
            ('reflection = "phong"', 'reflection = "shiny"', r"field reflection: .*'diffuse' or 'phong'"),
            ("floor = [", "floor = [\n    1.0,", r"field floor"),
            ("factors = [", "factors = [\n    [0.1, 0.2],", r"factors: 3 rows \(R, G, B\) of 6 values"),
            ("factors = [\n    [\n        ", "factors = [\n    [\n        -", r"factors: .*negative.* R$"),
            ("kernel_m = 200.0", "kernel_m = 0.0", r"field design\.contact\.kernel_m"),
            ("kernel_m = 200.0", "kernel_m = 201.0", r"field digest: .*edited by hand"),
            ("version = 1", "version = 1\ncolour = 3", r"field colour: unknown field"),
            ("version = 1", "version =", r"not valid TOML"),
        ],
    )  # fmt: skip
    def test_bad_files_are_refused_by_field_and_rule(self, old, new, named, tmp_path):
        text = model("phong").dumps()
        assert old in text
        path = tmp_path / "bad.toml"
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
        with pytest.raises(ModelError, match=named) as refused:
            load_any_model(path)
        assert str(path) in str(refused.value)

    def test_a_light_too_few_is_refused(self):
        with pytest.raises(DesignError, match="lights: one for each of the 3 LED groups, got 2"):
            lit_from((0, 30), (120, 30))

    @pytest.mark.parametrize(
        "words",
        [
            ["evaluate", "{}"],
            ["export", "{}", "--out", "{out}"],
            ["render", "{}", "-o", "{out}.exr"],
            ["gap", "diagnose", "{set}", "--model", "{}", "--out", "{out}"],
            ["gap", "plant", "--design", "{}", "--out", "{out}"],
            ["study", "run", "{study}"],
            ["calibrate", "{set}", "--model", "{}", "--baseline", "phong", "--out", "{out}"],
        ],
    )
    def test_other_commands_refuse_it_in_one_line(self, words, own_set, tmp_path, capsys):
        path, study = tmp_path / "baseline.toml", tmp_path / "study.toml"
        path.write_text(model().dumps(), encoding="utf-8")
        study.write_text(
            'version = 1\nbase = "baseline.toml"\n[parameters."leds.tilt_deg"]\nlow = 0.0\nhigh = 10.0\n'
        )
        places = {"out": str(tmp_path / "out"), "set": str(own_set.folder), "study": str(study)}
        assert cli.main([word.format(str(path), **places) for word in words]) == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert "baseline.toml" in line
        assert "design" in line
        assert not (tmp_path / "out").exists()


TRUE = {
    "lights": [
        {"azimuth_deg": 95.0, "elevation_deg": 29.6},
        {"azimuth_deg": 205.0, "elevation_deg": 39.6},
        {"azimuth_deg": 334.0, "elevation_deg": 38.0},
    ],
    "floor": [0.02, 0.03, 0.01],
}
DIFFUSE = [[0.5, 0.05, 0.02], [0.06, 0.45, 0.04], [0.02, 0.08, 0.55]]
SPECULAR = [[0.15, 0.02, 0.0], [0.0, 0.2, 0.01], [0.01, 0.0, 0.25]]
NOISE = 2e-3
STATED = {"probe": "sphere:5", "depth_mm": 0.6}
SIGMA = {"centre_mm": 0.05, "depth_mm": 0.02}
PLACES = ((0.5, -0.4), (-1.2, 0.9))
ALL = ("red", "green", "blue")
ANGLES = ("azimuth_deg", "elevation_deg")
GEOMETRY = {
    "contact.kernel_length_mm": DESIGN.contact.kernel_length_mm,
    "camera.horizontal_fov_deg": DESIGN.camera.horizontal_fov_deg,
}


def true_model(reflection):
    factors = DIFFUSE if reflection == "diffuse" else np.hstack([DIFFUSE, SPECULAR]).tolist()
    own = {"exponent": 9.0} if reflection == "phong" else {}
    return model(reflection, **TRUE, **own, factors=factors)


def made(folder, picture, *, noise=NOISE, places=PLACES, switched=(ALL,)):
    """Write a background and presses, each with some LEDs on, as a function of press and LEDs gives them."""
    rng = np.random.default_rng(8)
    images, frames = {}, []
    for leds in switched:
        for number, place in enumerate((None, *places)):
            file = f"{number}-{'-'.join(leds)}.exr"
            content = {"file": file, "kind": "background", "crop_px": CROP, "leds": leds}
            press = None
            if place is not None:
                content |= {"kind": "press", "split": "train", **STATED, "centre_mm": place, "sigma": SIGMA}
                press = Press(probe=parse(STATED["probe"]), depth_mm=STATED["depth_mm"], centre_mm=place)
            frames.append(MeasuredFrame.model_validate(content))
            signal = picture(press, [float(name in leds) for name in ALL])
            images[file] = (signal + noise * rng.standard_normal(signal.shape)).astype(np.float32)
    measurement = Measurement(sensor="gelsight-2020-flat", response="linear", frames=tuple(frames))
    return load_measurement(write_measurement(measurement, images, folder))


@pytest.fixture(scope="module")
def own_set(tmp_path_factory):
    light = true_model("diffuse")
    folder = tmp_path_factory.mktemp("own") / "m"
    return made(folder, lambda press, lit: light.signal(press, VIEW, lit=lit), noise=0.0, places=PLACES[:1])


class TestCompare:
    def test_the_truth_is_the_measurement(self, own_set):
        found = compare_model(true_model("diffuse"), own_set).to_json()
        assert found["snr_db"] > 120  # single precision
        assert found["structure_corr"] == pytest.approx(1.0)
        assert [entry["file"] for entry in found["skipped"]] == ["0-red-green-blue.exr"]
        assert compare_model(model(), own_set).to_json()["snr_db"] < 30

    def test_groups_that_are_off_and_exposure_count(self, tmp_path):
        light = true_model("diffuse")
        picture = light.signal(BALL, VIEW, lit=[1, 0, 1], exposure=0.5).astype(np.float32)
        frame = MeasuredFrame.model_validate(
            {"file": "p.exr", "kind": "press", "crop_px": CROP, "probe": "sphere:4", "depth_mm": 0.5,
             "centre_mm": (0.0, 0.0), "leds": ["red", "blue"], "exposure": 0.5}
        )  # fmt: skip
        folder = write_measurement(
            Measurement(sensor="unknown", response="linear", frames=(frame,)),
            {"p.exr": picture},
            tmp_path / "m",
        )
        assert compare_model(light, load_measurement(folder)).to_json()["snr_db"] > 120

    def test_the_command_takes_the_file(self, own_set, tmp_path, capsys):
        path = tmp_path / "baseline.toml"
        path.write_text(true_model("diffuse").dumps(), encoding="utf-8")
        assert cli.main(["compare", str(path), str(own_set.folder)]) == 0
        assert "structure_corr" in capsys.readouterr().out


def free_by_itself(start, measurement):
    return Directional(start).usual(observe(measurement, DESIGN, columns=SIDE).shots)


def scores(found, light):
    """Departures from the truth in standard errors, of every number that does not stand at zero."""
    true = {f"lights.{g}.{name}": getattr(at, name) for g, at in enumerate(light.lights) for name in ANGLES}
    true |= {f"design.{path}": value for path, value in GEOMETRY.items()}
    true |= {"exponent": light.exponent} if light.exponent is not None else {}
    for letter, row, floor in zip("RGB", light.factors, light.floor, strict=True):
        true |= {f"transfer.{letter}.{name}": value for name, value in zip(light.names, row, strict=True)}
        true[f"floor.{letter}"] = floor
    values = {p.name: p for p in found.parameters}
    at_zero = {name for name, p in values.items() if p.value == 0.0}
    assert max((true[name] for name in at_zero), default=0.0) < 0.03
    return {name: (values[name].value - true[name]) / values[name].se for name in true.keys() - at_zero}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("reflection", "switched", "places"),
    [("diffuse", tuple((name,) for name in ALL), PLACES[:1]), ("phong", (ALL,), PLACES)],
)
def test_recovery_within_standard_errors(reflection, switched, places, tmp_path):
    """From directions 5 deg and more away. Without lobes, light of one group at a time is needed."""
    light = true_model(reflection)

    def finely(press, lit):
        """On a mesh of half the pitch: a fit takes out the error of the usual one."""
        mixed = np.tensordot(
            light.factors * light.each(lit), light.components(press, VIEW, fine=True), axes=1
        )
        return np.moveaxis(mixed, 0, -1) + np.array(light.floor)

    measurement = made(tmp_path / "m", finely, places=places, switched=switched)
    start = DirectionalLight.of(DESIGN, reflection)
    assert not any(path.startswith("design.") for path in free_by_itself(start, measurement))
    free = [*free_by_itself(start, measurement), *(f"design.{path}" for path in GEOMETRY)]
    found = calibrate(measurement, start, columns=SIDE, free=free)
    score = scores(found, light)
    # Of some thirty numbers one errs by 3 in a tenth of all draws, and by 4 in a five-hundredth.
    assert np.abs(list(score.values())).max() < 4, score
    assert np.sqrt(np.mean(np.square(list(score.values())))) < 1.5
    for number in found.parameters[: 2 * len(light.lights)]:
        assert number.se < 1.0
    for frame in found.frames:
        assert np.std(frame.measured - frame.simulated) == pytest.approx(NOISE, rel=0.03)
    assert isinstance(found.model, DirectionalLight)
    (tmp_path / "found.toml").write_text(found.model.dumps(), encoding="utf-8")
    assert load_any_model(tmp_path / "found.toml") == found.model
    assert found.products == ()


def test_what_mixed_light_does_not_tell_has_no_error_and_a_note(tmp_path):
    """Without shadows a diffuse picture is linear in the normal, 12 numbers; the model has 18."""
    high = true_model("diffuse").replace(
        {f"lights.{group}.elevation_deg": 60.0 + 5 * group for group in range(3)}
    )
    measurement = made(
        tmp_path / "m", lambda press, lit: high.signal(press, VIEW, lit=lit), places=PLACES[:1]
    )
    start = high.replace({f"lights.{group}.azimuth_deg": 93.0 + 118 * group for group in range(3)})
    directions = [f"lights.{group}.azimuth_deg" for group in range(3)]
    found = calibrate(measurement, start, columns=SIDE, free=directions)
    for parameter in found.parameters[:3]:
        assert parameter.se is None
    assert any(
        "lights.0.azimuth_deg" in note and "explain the pictures as well" in note for note in found.notes
    )
    assert all(frame.after["snr_db"] > 40 for frame in found.frames)


@pytest.mark.renders
@pytest.mark.slow
def test_a_rendered_picture_is_told_better_by_light_transport(tmp_path):
    """Near light falls off and casts shadows; a lobe towards the camera stands for some of it."""
    crop = (1016, 832, 480, 480)
    simulator = Simulator(DESIGN, view=View(*map(float, crop), 32, 32), samples=64, seed=21)
    pose = {"probe": "sphere:4", "depth_mm": 0.5, "centre_mm": (0.0, 0.0), "sigma": SIGMA, "split": "train"}
    rng = np.random.default_rng(22)
    images, frames = {}, []
    for kind, press, content in (("background", None, {}), ("press", BALL, pose)):
        picture = simulator.frame(press).mixed.astype(float) / 2.0
        images[f"{kind}.exr"] = (picture + 1e-4 * rng.standard_normal(picture.shape)).astype(np.float32)
        frames.append(
            MeasuredFrame.model_validate({"file": f"{kind}.exr", "kind": kind, "crop_px": crop, **content})
        )
    measurement = Measurement(sensor="gelsight-2020-flat", response="linear", frames=tuple(frames))
    measurement = load_measurement(write_measurement(measurement, images, tmp_path / "m"))
    starts = {kind: DirectionalLight.of(DESIGN, kind) for kind in ("diffuse", "phong")}
    found = {kind: calibrate(measurement, start, columns=32) for kind, start in starts.items()}
    found["rendered"] = calibrate(measurement, DESIGN, columns=32, samples=32, free=())
    after = {kind: result.frames[1].after for kind, result in found.items()}
    assert after["rendered"]["snr_db"] > after["phong"]["snr_db"] + 6
    assert after["phong"]["snr_db"] > after["diffuse"]["snr_db"]
    assert after["rendered"]["structure_snr_db"] > after["diffuse"]["structure_snr_db"] + 6
    for kind in starts:
        press = found[kind].frames[1]
        assert press.before["snr_db"] < press.after["snr_db"]
    # What was found stays where it is.
    again = calibrate(measurement, found["diffuse"].model, columns=32).frames[1]
    assert again.after["snr_db"] == pytest.approx(after["diffuse"]["snr_db"], abs=0.1)
