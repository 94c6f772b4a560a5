"""The command line: results, exit statuses, clean stdout, quick start."""

import json
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import trimesh

from designlab.app import cli
from designlab.app.cli import arguments, console, designs
from designlab.core.images import read_image, write_image
from designlab.measurement import load_measurement
from designlab.optimization.study import load_study
from designlab.sensor.design import dumps, load, preset, preset_names
from designlab.validation.blind.pool import shard
from geometries import mesh_files
from geometries.probes import parse

PROGRAM = Path(sys.executable).with_name("designlab")
COMMANDS = (
    "doctor",
    "presets",
    "parts",
    "init",
    "demo",
    "evaluate",
    "render",
    "compare",
    "import",
    "calibrate",
    "export",
    "study run",
    "study status",
    "study report",
    "gap plant",
    "gap diagnose",
    "gap benchmark",
    "reproduce",
)


@pytest.fixture
def run(capfd):
    """Run a command in this process: status, stdout, stderr, also of what C code prints."""

    def runner(*arguments):
        capfd.readouterr()
        status = cli.main([str(argument) for argument in arguments])
        captured = capfd.readouterr()
        return status, captured.out, captured.err

    return runner


@pytest.fixture
def run_json(run):
    """Run a command with --json and return its status and its one JSON object."""

    def runner(*arguments):
        status, out, _ = run(*arguments, "--json")
        return status, json.loads(out)

    return runner


class TestStart:
    def test_help_starts_within_half_a_second(self):
        subprocess.run([PROGRAM, "--help"], check=True, capture_output=True)  # compiles what is not yet
        times = []
        for _ in range(3):
            start = time.perf_counter()
            subprocess.run([PROGRAM, "--help"], check=True, capture_output=True)
            times.append(time.perf_counter() - start)
        assert min(times) < 0.5

    @pytest.mark.parametrize("command", COMMANDS)
    def test_every_command_explains_itself(self, run, command):
        status, out, err = run(*command.split(), "--help")
        assert status == 0
        assert out.startswith(f"usage: designlab {command} ")
        assert "--json" in out
        assert err == ""

    @pytest.mark.parametrize("command", COMMANDS)
    def test_every_command_has_a_function(self, command):
        defaults = {
            "evaluate": ["x"],
            "export": ["x", "--out", "o"],
            "render": ["x", "-o", "f.png"],
            "compare": ["a", "b"],
            "calibrate": ["m", "--model", "x", "--out", "o"],
            "init": ["x"],
            "demo": ["--out", "o"],
            "gap plant": ["--out", "o"],
            "gap diagnose": ["m", "--model", "x", "--out", "o"],
            "gap benchmark": ["--out", "o"],
            "reproduce": ["--out", "o"],
        }
        words = command.split() + (["x"] if command.startswith("study") else defaults.get(command, []))
        module, _, function = arguments.parse(words).run.partition(":")
        assert callable(getattr(__import__(module, fromlist=["_"]), function))

    def test_version(self, run):
        from designlab import __version__

        assert run("--version")[1] == f"designlab {__version__}\n"


class TestOutput:
    def test_presets_are_listed_and_printed(self, run, run_json):
        status, out, _ = run("presets")
        assert status == 0
        named = [line.split()[0] for line in out.splitlines() if line[0] != " "]
        assert named == list(preset_names())
        marked = [line for line in out.splitlines() if "not buildable as published" in line]
        assert len(marked) == 4  # the replays of scenes whose light meets no core
        status, found = run_json("presets", "gelsight-2020-flat")
        assert found["digest"] == preset("gelsight-2020-flat").digest
        assert tomllib.loads(found["toml"])["name"] == "gelsight-2020-flat"
        assert tomllib.loads(run("presets", "gelsight-2020-flat")[1]) == tomllib.loads(found["toml"])

    def test_json_may_stand_before_the_command(self, run):
        assert "presets" in json.loads(run("--json", "presets")[1])

    @pytest.mark.slow
    def test_doctor(self, run_json):
        status, found = run_json("doctor")
        assert status == (0 if found["ok"] else 1)
        assert found["python"]["executable"] == sys.executable

    def test_what_libraries_print_does_not_reach_stdout(self, run, monkeypatch):
        def chatty(args):
            print("from Python")
            os.write(1, b"from C\n")
            return console.Result({"value": 1}, "text")

        monkeypatch.setattr(designs, "presets", chatty)
        status, out, err = run("presets", "--json")
        assert (status, out) == (0, '{"value": 1}\n')
        assert "from Python" in err
        assert "from C" in err

    def test_numbers_without_a_finite_value_become_null(self, run_json, monkeypatch):
        data = {"a": float("inf"), "b": [np.float64("nan"), np.int64(3)], "c": {"d": Path("x")}}
        monkeypatch.setattr(designs, "presets", lambda args: console.Result(data, ""))
        assert run_json("presets")[1] == {"a": None, "b": [None, 3], "c": {"d": "x"}}

    def test_a_reader_that_stops_is_no_error(self):
        command = f"'{PROGRAM}' presets gelsight-2020-flat | head -n 1"
        done = subprocess.run(command, shell=True, capture_output=True, text=True, check=True)
        assert done.stderr == ""

    @pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
    def test_a_full_disk_behind_stdout_is_reported(self):
        with open("/dev/full", "w") as full:
            done = subprocess.run([PROGRAM, "presets"], stdout=full, stderr=subprocess.PIPE, text=True)
        assert done.returncode == 1
        assert "No space left on device" in done.stderr
        assert "Traceback" not in done.stderr


class TestFailures:
    @pytest.mark.parametrize(
        ("error", "status", "reason"),
        [
            (OSError(28, "No space left on device", "/x/y"), 1, "/x/y: No space left on device"),
            (MemoryError(), 1, "out of memory"),
            (ModuleNotFoundError("No module", name="pymeshlab"), 1, "pymeshlab is missing"),
            (KeyError("secret"), 1, "a defect of designlab: KeyError: 'secret'"),
            (KeyboardInterrupt(), 130, "run the same command again"),
        ],
    )
    def test_statuses(self, run, monkeypatch, error, status, reason):
        def failing(args):
            raise error

        monkeypatch.setattr(designs, "presets", failing)
        found, out, err = run("presets")
        assert found == status
        assert reason in err
        assert out == ""
        assert len(err.splitlines()) == 1
        assert "error" in json.loads(run("presets", "--json")[1])

    def test_ctrl_c_while_a_native_library_loads_is_no_defect(self, run, monkeypatch):
        def loading(args):
            raise ImportError("while initializing the extension") from KeyboardInterrupt()

        monkeypatch.setattr(designs, "presets", loading)
        status, _, err = run("presets")
        assert status == 130
        assert "run the same command again" in err

    def test_a_value_error_of_a_library_is_a_defect_and_not_bad_input(self, run, monkeypatch):
        monkeypatch.setattr(designs, "presets", lambda args: np.linalg.inv(np.ones((2, 3))))
        status, _, err = run("presets")
        assert status == 1
        assert "a defect of designlab: LinAlgError" in err

    @pytest.mark.slow
    def test_a_users_error_met_by_a_worker_is_no_defect(self, run, monkeypatch):
        """Its traceback stays behind in the worker; a library's error there is a defect as anywhere."""

        def failing(args):
            with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
                pool.submit(*call).result()

        monkeypatch.setattr(designs, "presets", failing)
        call = (shard, [], "nonsense")
        status, _, err = run("presets")
        assert status == 2
        assert err.startswith("designlab: --shard: must be K/N")
        call = (parse, "sphere:-1")
        assert run("presets")[0] == 2
        call = (np.linalg.inv, np.ones((2, 3)))
        status, _, err = run("presets")
        assert status == 1
        assert "a defect of designlab: LinAlgError" in err
        assert "linalg" in err

    def test_debug_shows_the_traceback(self, run, monkeypatch):
        monkeypatch.setattr(designs, "presets", lambda args: {}["secret"])
        assert "Traceback" not in run("presets")[2]
        assert "Traceback" in run("presets", "--debug")[2]
        monkeypatch.setenv(console.DEBUG_VARIABLE, "1")
        assert "Traceback" in run("presets")[2]

    @pytest.mark.slow
    def test_ctrl_c_leaves_nothing_behind_and_says_how_to_go_on(self, tmp_path):
        out = tmp_path / "evaluation"
        command = [PROGRAM, "evaluate", "gelsight-2020-flat", "--out", str(out), "--json"]
        process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            # a run in the background may have inherited the order to ignore it
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )
        time.sleep(6)
        process.send_signal(signal.SIGINT)
        stdout, stderr = process.communicate(timeout=120)
        assert process.returncode == 130
        assert "run the same command again" in json.loads(stdout)["error"]
        assert "Traceback" not in stderr
        assert [path.name for path in tmp_path.rglob("*") if path.name != "evaluation"] == []


class TestInit:
    @pytest.fixture
    def folder(self, run, tmp_path):
        target = tmp_path / "mine"
        assert run("init", target)[0] == 0
        return target

    def test_design_and_study_are_valid(self, folder):
        design = load(folder / "design.toml")
        assert design.digest == preset("default").digest
        assert (design.name, design.parent) == (folder.name, "default")
        assert design.not_buildable == ""
        design.require_feasible()
        study = load_study(folder / "study.toml")
        assert study.base.digest == design.digest
        assert set(study.parameters) == {"leds.height_mm", "leds.pitch_mm"}

    def test_another_preset(self, run, tmp_path):
        assert run("init", tmp_path / "dome", "--preset", "gelsight-2020-dome")[0] == 0
        assert load(tmp_path / "dome" / "design.toml").digest == preset("gelsight-2020-dome").digest

    def test_measurement_template_loads_once_the_pictures_are_there(self, folder):
        template = folder / "measurement" / "measurement.toml"
        camera = preset("default").camera
        random = np.random.default_rng(0)
        shape = (camera.height_px // 12, camera.width_px // 12, 3)
        files = [frame["file"] for frame in tomllib.loads(template.read_text())["frame"]]
        for file in files:
            write_image(template.parent / file, random.random(shape).astype(np.float32))
        measurement = load_measurement(template.parent)
        assert [frame.file for frame in measurement.frames] == files
        split = measurement.split()
        assert all(split.values()), "the presses of the template serve all three uses"
        for frames in split.values():
            assert all(measurement.press(frame) is not None for frame in frames)

    def test_every_file_is_explained(self, folder):
        text = (folder / "README.md").read_text()
        for path in folder.rglob("*"):
            if path.is_file() and path.name != "README.md":
                assert f"`{path.relative_to(folder).as_posix()}`" in text

    def test_every_command_it_names_exists(self, folder):
        commands = re.findall(
            r"^designlab (.*?)(?: {2,}.*)?$", (folder / "README.md").read_text(), re.MULTILINE
        )
        assert len(commands) >= 5
        for command in commands:
            arguments.parse(command.split())

    def test_nothing_is_overwritten(self, run, folder):
        before = (folder / "design.toml").read_bytes()
        status, _, err = run("init", folder)
        assert status == 2
        assert str(folder) in err
        assert (folder / "design.toml").read_bytes() == before
        status, _, err = run("init", folder / "design.toml")
        assert status == 2


@pytest.mark.renders
class TestRender:
    def test_files_agree_with_the_library(self, run_json, tmp_path):
        import designlab as dl

        target = tmp_path / "press.exr"
        status, found = run_json(
            "render", "gelsight-2020-flat", "--probe", "sphere:4", "--depth-mm", "0.5", "--at", "-1,2",
            "--yaw-deg", "30", "--columns", "32", "--samples", "4", "--seed", "3", "-o", target,
        )  # fmt: skip
        press = dl.Press(probe=dl.sphere(diameter_mm=4), depth_mm=0.5, centre_mm=(-1, 2), yaw_deg=30)
        frame = dl.render(dl.preset("gelsight-2020-flat"), press, columns=32, samples=4, seed=3)
        assert status == 0
        assert (found["columns"], found["rows"]) == (32, 24)
        np.testing.assert_allclose(read_image(target), frame.mixed, rtol=1e-3)
        assert found["deepest_mm"] == pytest.approx(0.5, abs=0.05)

    def test_png_is_a_picture_for_eyes(self, run, tmp_path):
        from PIL import Image

        target = tmp_path / "gel.png"
        assert run("render", "gelsight-2020-flat", "--columns", 32, "--samples", 4, "-o", target)[0] == 0
        with Image.open(target) as picture:
            assert (picture.size, picture.mode) == ((32, 24), "RGB")
            assert np.asarray(picture).max() == 255


class TestCompare:
    def test_two_images_against_closed_forms(self, run_json, tmp_path):
        random = np.random.default_rng(0)
        real = random.uniform(0.2, 0.8, (32, 48, 3)).astype(np.float32)
        write_image(tmp_path / "real.exr", real)
        write_image(tmp_path / "half.exr", real / 2)
        status, found = run_json("compare", tmp_path / "half.exr", tmp_path / "real.exr")
        assert status == 0
        assert found["mse"] == pytest.approx(np.mean(np.square(real)) / 4, rel=1e-6)
        assert found["snr_db"] == pytest.approx(10 * np.log10(4), rel=1e-6)
        assert found["smape"] == pytest.approx(2 / 3, rel=1e-6)
        assert found["structure_corr"] == pytest.approx(1, abs=1e-9)
        assert set(found["channels"]) == {"R", "G", "B"}

    def test_equal_images_have_no_finite_snr(self, run_json, run, tmp_path):
        image = np.random.default_rng(0).random((16, 16, 3)).astype(np.float32)
        write_image(tmp_path / "a.exr", image)
        status, found = run_json("compare", tmp_path / "a.exr", tmp_path / "a.exr")
        assert (status, found["snr_db"], found["mse"], found["ssim"]) == (0, None, 0.0, 1.0)
        assert "inf" in run("compare", tmp_path / "a.exr", tmp_path / "a.exr")[1]

    @pytest.mark.renders
    def test_a_model_against_frames_it_made_itself(self, run_json, tmp_path):
        """Frames rendered with another seed differ by noise alone; gain, pose and crop errors would show."""
        import tomli_w

        from designlab.simulation.contact.press import Press
        from designlab.simulation.simulator import Simulator
        from geometries import probes

        design = preset("gelsight-2020-flat")
        crop, exposure = [1024, 670, 600, 600], 0.5
        view = design.camera.full_view()._replace(
            x_px=1024.0, y_px=670.0, width_px=600.0, height_px=600.0, columns=60, rows=60
        )
        press = Press(probe=probes.parse("sphere:4"), depth_mm=0.5, centre_mm=(1, 0.5))
        picture = Simulator(design, view=view, samples=64, seed=99).frame(press)
        without_green = np.einsum("cg,grk->rkc", picture.weights * [1, 0, 1], picture.basis)
        write_image(tmp_path / "all.exr", picture.mixed * np.float32(exposure))
        write_image(tmp_path / "two.exr", without_green.astype(np.float32))
        write_image(tmp_path / "gel.exr", picture.mixed)
        pose = {"kind": "press", "probe": "sphere:4", "depth_mm": 0.5, "crop_px": crop}
        frames = [
            {"file": "all.exr", **pose, "centre_mm": [1.0, 0.5], "exposure": exposure},
            {"file": "two.exr", **pose, "centre_mm": [1.0, 0.5], "leds": ["red", "blue"]},
            {"file": "gel.exr", "kind": "background", "crop_px": crop},
        ]
        write_image(tmp_path / "lost.exr", picture.mixed)
        frames.append({"file": "lost.exr", **pose})
        content = {"sensor": design.name, "response": "linear", "frame": frames}
        (tmp_path / "measurement.toml").write_text(tomli_w.dumps(content))

        status, found = run_json("compare", design.name, tmp_path, "--out", tmp_path / "pictures")
        assert status == 0
        assert [frame["file"] for frame in found["frames"]] == ["all.exr", "two.exr"]
        for frame in found["frames"]:
            assert frame["snr_db"] > 25
            for channel in "RB":
                assert frame["channels"][channel]["structure_corr"] > 0.97
        assert found["frames"][1]["channels"]["G"]["structure_corr"] is None  # green was off
        assert found["mse"] == pytest.approx(np.mean([frame["mse"] for frame in found["frames"]]))
        skipped = {entry["file"]: entry["reason"] for entry in found["skipped"]}
        assert [frame["file"] for frame in found["backgrounds"]] == ["gel.exr"]
        assert "centre_mm" in skipped["lost.exr"]
        assert any(note.startswith("lost.exr: its pose cannot be read") for note in found["notes"])
        saved = read_image(tmp_path / "pictures" / "all-simulated.exr")
        np.testing.assert_allclose(np.mean(saved), exposure * np.mean(picture.mixed), rtol=0.02)

    @pytest.mark.renders
    def test_automatic_exposure_brings_the_bright_parts_to_half_of_full_scale(self, tmp_path):
        from designlab.measurement import MeasuredFrame, Measurement
        from designlab.measurement.compare import compare_model

        design = preset("gelsight-2020-flat").replace({"camera.exposure": None})
        width, height = design.camera.width_px // 16, design.camera.height_px // 16
        write_image(tmp_path / "a.exr", np.full((height, width, 3), 0.5, dtype=np.float32))
        frame = MeasuredFrame(file="a.exr", kind="press", probe="sphere:1", depth_mm=0.01, centre_mm=(5, 4))
        measurement = Measurement(sensor="unknown", response="linear", frames=(frame,), folder=tmp_path)
        (pair,) = compare_model(design, measurement, samples=16, seed=1).pairs
        left, top, wide, high = (round(value / 16) for value in design.view(100)[:4])
        inside = pair.simulated[top : top + high, left : left + wide]
        assert np.percentile(inside, 99.5) == pytest.approx(0.5, rel=0.05)

    @pytest.mark.renders
    @pytest.mark.slow
    @pytest.mark.measured
    def test_published_values_against_the_real_triangle(self, run_json, measured_dir):
        """Bounds: what the published scene reaches on this picture (mse 0.00697, 5.0 dB)."""
        status, found = run_json("compare", "gelsight-2020-flat", measured_dir / "gelsight-flat")
        assert status == 0
        assert found["mse"] <= 0.0072
        assert found["snr_db"] >= 4.9
        assert found["structure_corr"] >= 0.50

    @pytest.mark.renders
    @pytest.mark.slow
    @pytest.mark.measured
    def test_an_elastic_gel_explains_the_real_triangle_better(self, run_json, measured_dir):
        status, found = run_json("compare", "gelsight-2020-flat-elastic", measured_dir / "gelsight-flat")
        assert status == 0
        assert found["structure_corr"] >= 0.72
        assert found["structure_snr_db"] >= 1.4


class TestStudy:
    @pytest.fixture
    def study_file(self, run, tmp_path):
        """The starter study, with three trials already evaluated by a closed form instead of a simulation."""
        from types import SimpleNamespace

        from designlab.optimization.study import run_study

        assert run("init", tmp_path / "mine")[0] == 0
        path = tmp_path / "mine" / "study.toml"
        path.write_text(path.read_text().replace("trials = 24", "trials = 3"))

        def evaluator(design, *, fidelity, seed):
            height = design.leds.height_mm
            values = {
                "uniformity_u0": 1 / (1 + height**2),
                "normal_error_median_deg": 2 + (height - 6) ** 2 / 36,
                "coverage": 1.0,
                "saturation_share": 0.0,
            }
            estimates = {
                name: SimpleNamespace(value=value, se=0.01, bias_bound=None, unit="1")
                for name, value in values.items()
            }
            return SimpleNamespace(scores=estimates, seconds={})

        run_study(load_study(path), out=tmp_path / "mine" / "study-out", progress=False, evaluator=evaluator)
        return path

    @pytest.mark.slow
    def test_a_file_or_its_folder_name_the_same_study(self, run_json, study_file):
        status, found = run_json("study", "status", study_file)
        assert status == 0
        assert found["trials"]["complete"] == found["wanted"] == 3
        assert run_json("study", "status", study_file.with_name("study-out")) == (status, found)
        moved = study_file.with_name("elsewhere")
        study_file.with_name("study-out").rename(moved)
        assert run_json("study", "status", study_file, "--out", moved)[1]["trials"] == found["trials"]

    @pytest.mark.slow
    def test_a_study_that_is_done_is_not_run_again(self, run, run_json, study_file):
        status, found = run_json("study", "run", study_file)
        assert status == 0
        assert found["trials"]["complete"] == 3
        best = max(found["pareto"], key=lambda row: row["uniformity_u0"])
        assert best["uniformity_u0"] == pytest.approx(1 / (1 + best["leds.height_mm"] ** 2))
        assert "3 of 3 designs evaluated" in run("study", "run", study_file.with_name("study-out"))[1]

    @pytest.mark.slow
    def test_an_interrupted_study_says_how_to_go_on(self, run, study_file, monkeypatch):
        import designlab.optimization.study

        def interrupted(study, **settings):
            raise designlab.optimization.study.StudyInterrupted(
                "study 'x' interrupted after 3 of 9 designs; run it again"
            )

        monkeypatch.setattr(designlab.optimization.study, "run_study", interrupted)
        status, _, err = run("study", "run", study_file, "--trials", 9, "--workers", 2)
        assert status == 130
        assert f"designlab study run {study_file} --workers 2 --trials 9" in err
        assert "3 of 9 designs" in err

    @pytest.mark.renders
    @pytest.mark.slow
    def test_the_report_is_one_page(self, run_json, study_file, tmp_path):
        page = tmp_path / "page.html"
        status, found = run_json("study", "report", study_file, "-o", page)
        assert (status, found["report"]) == (0, str(page))
        assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


@pytest.mark.renders
@pytest.mark.slow
def test_evaluate_prints_the_scores_and_shows_the_pictures(run_json, tmp_path):
    out = tmp_path / "evaluation"
    status, found = run_json("evaluate", "gelsight-2020-flat", "--seed", 1, "--out", out)
    assert status == 0
    assert found["seed"] == 1
    for name in ("uniformity_u0", "uniformity_cv", "normal_error_median_deg", "height_mae_um"):
        assert {"value", "se", "bias_bound", "unit"} <= set(found["scores"][name])
    assert json.loads((out / "score.json").read_text())["scores"] == found["scores"]
    assert set(found["pictures"]) == {path.name for path in out.glob("*.png")}
    assert len(found["pictures"]) >= 3
    assert (out / "report.html").is_file()


@pytest.mark.renders
@pytest.mark.slow
def test_a_design_differs_from_a_copy_with_a_darker_membrane_in_colour_alone(run_json, tmp_path):
    dimmer = tmp_path / "dimmer.toml"
    darker = {"optics.membrane_albedo": (0.1, 0.397, 0.453)}
    dimmer.write_text(dumps(preset("gelsight-2020-flat").replace(darker)))
    status, found = run_json("evaluate", "gelsight-2020-flat", dimmer, "--compare")
    assert status == 0
    assert found["first"]["seed"] == found["second"]["seed"] == 0
    assert found["differences"]["colour_balance"]["differs"]
    # one LED group's own picture only scales with the membrane's reflectance
    assert not found["differences"]["slant_deg"]["differs"]


@pytest.mark.parametrize("words", [("default", "--compare"), ("default", "gelsight-2020-flat")])
def test_a_comparison_needs_two_designs_and_its_option(run, words):
    status, _, err = run("evaluate", *words)
    assert status == 2
    assert "--compare: takes two designs" in err


@pytest.mark.slow
@pytest.mark.renders
def test_export_writes_files_that_pass_their_checks(run_json, tmp_path):
    out = tmp_path / "parts"
    status, found = run_json("export", "default", "--out", out, "--probe", "sphere:4")
    assert status == 0
    assert all(check["ok"] for check in found["checks"])
    assert {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()} == {
        *found["files"],
        "manifest.json",
    }


@pytest.mark.slow
@pytest.mark.full
def test_plant_hides_what_it_was_told(run_json, tmp_path):
    from designlab.validation.synthetic import unseal

    out = tmp_path / "set"
    effect = "led_position:radial_mm=0.5,height_mm=-0.4"
    words = ["--effect", effect, "--out", out, "--kit", "small", "--columns", 32]
    status, found = run_json("gap", "plant", *words)
    assert status == 0
    assert found["measurement"] == str(out)
    planted = unseal(out)["effects"]["led_position"]
    assert planted == {"radial_mm": 0.5, "height_mm": -0.4, "tangential_mm": 0.0}
    assert "led_position" not in (out / "measurement.toml").read_text()
    load_measurement(out)


def test_a_file_in_place_of_a_results_folder_is_named(run, tmp_path):
    file = tmp_path / "taken"
    file.write_text("mine")
    status, _, err = run("evaluate", "default", "--out", file)
    assert status == 2
    assert "taken: must be a folder, is a file" in err
    assert file.read_text() == "mine"


@pytest.mark.parametrize("words", [["render", "default", "-o", "x.png"], ["export", "default", "--out", "x"]])
@pytest.mark.parametrize("side", mesh_files.SIDES)
@pytest.mark.parametrize("unit", mesh_files.UNITS_MM)
def test_sides_and_units_of_meshes_are_those_that_files_are_read_by(words, side, unit):
    args = arguments.parse([*words, "--probe", "a.stl", "--probe-side", side, "--probe-unit", unit])
    assert (args.probe_side, args.probe_unit) == (side, unit)


@pytest.mark.renders
@pytest.mark.parametrize(
    ("side", "share"), [("+z", (0.05, 0.12)), ("-z", (0.99, 1.0)), ("+x", (0.99, 1.0)), ("-y", (0.99, 1.0))]
)
def test_what_of_a_mesh_touches_is_said(run, tmp_path, side, share):
    trimesh.util.concatenate(
        [
            trimesh.creation.box((60, 60, 20)).apply_translation((0, 0, -10)),
            trimesh.creation.icosphere(subdivisions=4, radius=4),
        ]
    ).apply_scale(1e-3).export(tmp_path / "knob.stl")
    call = [
        *("render", "gelsight-2020-flat", "-o", tmp_path / "x.png", "--columns", 48, "--samples", 1),
        *("--probe", tmp_path / "knob.stl", "--probe-unit", "m", "--probe-side", side, "--depth-mm", 0.5),
    ]
    status, out, _ = run(*call, "--json")
    assert status == 0
    (said,) = json.loads(out)["understood"]
    assert share[0] <= said["share_touching"] <= share[1]
    assert (said["unit"], said["side"]) == ("m", side)
    assert said["extents_mm"] == pytest.approx([60, 60, 24], rel=1e-3)
    status, out, _ = run(*call)
    assert f"in m: 60 x 60 x 24 mm, pressed with its {side} side; " in out
    assert "% of its top that is in the picture touches" in out


@pytest.mark.renders
@pytest.mark.parametrize(("at", "outside"), [("0,0", False), ("6,4", False), ("9,0", True), ("0,-7", True)])
@pytest.mark.parametrize("design", ["default", "gelsight-2020-flat-core"])
def test_a_press_outside_the_picture_is_said(run, tmp_path, at, outside, design):
    call = ["render", design, "-o", tmp_path / "x.png", "--columns", 32, "--samples", 1, "--json"]
    status, out, _ = run(*call, "--probe", "sphere:3", "--depth-mm", 0.5, f"--at={at}")
    assert status == 0
    assert any("lies outside the picture" in text for text in json.loads(out)["warnings"]) == outside
