"""Sets with a fault or a lack: refused by name, or answered with less confidence; never fitted in silence."""

import json
from pathlib import Path

import numpy as np
import pytest

from designlab.app import cli
from designlab.core.images import to_srgb
from designlab.inference.diagnosis.result import Advice, Found, GapReport, Level, Value
from designlab.inference.diagnosis.verdict.data_checks import (
    Examined,
    Reserve,
    examine,
    looking_alike,
    weakened,
)
from designlab.measurement import MeasurementError
from designlab.measurement.shots import Observations, Shot
from designlab.measurement.usable_frames import observe_apart
from designlab.sensor.camera import View
from designlab.sensor.design import preset
from designlab.simulation.effects import SensorModel
from designlab.simulation.render_cache import Renders
from tests.helpers.spoilt_sets import COLUMNS, DESIGN, PLACES, PRESSES, changed, planted

MODEL = SensorModel.of(DESIGN)
SAMPLES = 8


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A set without a fault and without a hidden effect."""
    return planted(tmp_path_factory.mktemp("whole") / "m")


@pytest.fixture(scope="module")
def renders(tmp_path_factory):
    return Renders(tmp_path_factory.mktemp("renders"), SAMPLES, 1)


def examined(measurement, renders, **options) -> Examined:
    seen = observe_apart(measurement, DESIGN, columns=COLUMNS)
    return examine(measurement, MODEL, seen, renders, **options)


@pytest.mark.renders
class TestPresses:
    """What shows against the model as given."""

    def test_a_set_without_a_fault_passes(self, whole, renders):
        found = examined(whole, renders)
        assert all(each.passed is not False for each in found.checks)
        assert (found.notes, found.reserves) == ((), ())

    def test_srgb_declared_linear_is_named(self, whole, renders, tmp_path):
        """Nothing but the model tells: the groups light different channels, and there is no ladder."""
        wrong = changed(whole, tmp_path / "m", pictures=lambda image: to_srgb(np.maximum(image, 0)))
        with pytest.raises(MeasurementError, match=r"nonlinear: .*sRGB-encoded.*--trust nonlinear"):
            examined(wrong, renders)

    @pytest.mark.slow
    def test_another_probe_or_size_is_named(self, whole, renders, tmp_path):
        wrong = changed(
            whole, tmp_path / "m", frames=lambda f: {"probe": "sphere:2.5"} if f.kind == "press" else {}
        )
        with pytest.raises(MeasurementError, match=r'probe: press-01.exr.*probe = "sphere:5"'):
            examined(wrong, renders)
        said = examined(wrong, renders, trust=("probe",))
        assert any(reserve.why.startswith("trusted although probe") for reserve in said.reserves)

    @pytest.mark.full
    def test_places_counted_downwards_are_named(self, whole, renders, tmp_path):
        wrong = changed(
            whole,
            tmp_path / "m",
            frames=lambda f: {"centre_mm": (f.centre_mm[0], -f.centre_mm[1])} if f.kind == "press" else {},
        )
        with pytest.raises(MeasurementError, match=r"place: press-01.exr.* with \[x, -y\]"):
            examined(wrong, renders)

    @pytest.mark.full
    def test_a_press_of_another_sensor_is_named(self, whole, renders, tmp_path):
        dome = preset("gelsight-2020-dome")
        other = planted(tmp_path / "dome", design=dome, presses=PRESSES[:1])
        press = other.image(next(f for f in other.frames if f.kind == "press"))
        from designlab.core.images import resize_area

        def alien(image):
            return resize_area(press, *image.shape[:2])

        wrong = changed(whole, tmp_path / "m", files={"press-04.exr"}, pictures=alien)
        with pytest.raises(MeasurementError, match=r"odd: press-04\.exr: .*another sensor.*--trust odd"):
            examined(wrong, renders)

    @pytest.mark.parametrize(
        ("drop", "why"),
        [
            ({"dark.exr"}, "no frame without light"),
            ({"background-1.exr", "background-2.exr"}, "the noise floor is unknown"),
            ({f"press-{n:02d}.exr" for n in (2, 4, 6, 8)}, "4 presses, 1 of them to choose by"),
        ],
    )
    def test_what_is_missing_weakens(self, whole, renders, tmp_path, drop, why):
        found = examined(changed(whole, tmp_path / "m", drop=drop), renders)
        assert [reserve.why.startswith(why) for reserve in found.reserves] == [True]
        assert found.reserves[0].confidence < 1


def report(verdict="named", name="vignetting", coherence=None) -> GapReport:
    found = Found(name, {}, 0.9, coherence or (name,))
    nothing = verdict in ("at_floor", "unexplained")
    return GapReport(
        verdict=verdict,
        effects=() if nothing else (found,),
        where=(),
        gap={split: Level(8.0, 1.7, 1.0, 1.0) for split in ("train", "select", "final")},
        next_measurement=Advice(""),
        updated=MODEL,
        model=Path("model.toml"),
        candidates=(),
        notes=(),
        provenance={},
        seen=Observations((), np.zeros(3), "repeats", True, True, ()),
    )


def about(value: float) -> Value:
    return Value(value, value - 0.001, value + 0.001, "1", 0.0, 0.015, (-1.0, 1.0))


def seen_shot(lit: np.ndarray, clips: bool) -> Shot:
    picture = np.full((2, 2, 3), 0.5 * lit.max())
    view = View(0.0, 0.0, 2.0, 2.0, 2, 2)
    use = "background" if lit.any() else "dark"
    return Shot(
        ("f",), use, None, np.zeros(4), lit, view, picture, picture + 1, picture >= 0, np.full(3, 1e-3),
        clips=(clips,) * 3,
    )  # fmt: skip


class TestVerdict:
    TRIED = ("vignetting", "black_level", "veiling_glare", "colour_mixing")

    def said(self, before, reserves=(), alike=()):
        return weakened(before, Examined((), (), tuple(reserves)), self.TRIED, alike)

    def test_nothing_is_taken_from_a_whole_set(self):
        assert self.said(report()) == report()

    def test_an_unknown_floor_or_few_presses_leave_a_partial_explanation(self):
        said = self.said(report(), [Reserve("the floor is unknown", 0.5)])
        assert (said.verdict, said.effects[0].confidence) == ("partial", 0.5)
        assert "verdict lowered from named to partial" in said.notes
        assert said.to_json()["reserves"] == ["the floor is unknown"]
        assert said.barred == ("the floor is unknown",)

    def test_without_a_dark_frame_a_floor_is_not_told_from_stray_light(self):
        no_dark = [Reserve("no frame without light", 0.7, name_stands=True)]
        floors = ("black_level", "veiling_glare")
        said = self.said(report(name="black_level"), no_dark, floors)
        assert (said.verdict, said.effects[0].coherence_set) == ("ambiguous", floors)
        assert said.effects[0].confidence == 0.5
        other = self.said(report(), no_dark, floors)
        assert (other.verdict, other.effects[0].confidence) == ("named", 0.7)
        assert other.barred == ()

    @pytest.mark.parametrize(
        ("level", "clips", "single", "asked"),
        [(-0.01, True, False, True), (-0.01, False, False, False), (0.01, True, False, False),
         (-0.01, True, True, False)],
    )  # fmt: skip
    def test_a_frame_without_light_does_not_show_a_black_level_below_zero(self, level, clips, single, asked):
        """Where counts end at zero; light of single groups shows it."""
        lit, off = np.ones(3), np.zeros(3)
        shots = [seen_shot(lit, clips), seen_shot(off, clips), *([seen_shot(np.eye(3)[0], clips)] * single)]
        seen = Observations(tuple(shots), np.zeros(3), "repeated frames", True, True, ())
        found = Found(
            "black_level", {c: about(level if c == "G" else 0.0) for c in "RGB"}, 0.9, ("black_level",)
        )
        alike = looking_alike([found], seen, DESIGN)
        assert set(alike) == ({"black_level", "veiling_glare", "colour_mixing"} if asked else set())
        without = Observations(tuple(shots[::2]), np.zeros(3), "repeated frames", True, False, ())
        assert len(looking_alike([found], without, DESIGN)) == (2 if single else 3)

    @pytest.mark.parametrize("verdict", ["at_floor", "unexplained", "partial"])
    def test_other_verdicts_stay_with_their_reserve_said(self, verdict):
        said = self.said(report(verdict), [Reserve("the floor is unknown", 0.5)])
        assert said.verdict == verdict
        assert "the floor is unknown" in said.notes


class TestCommand:
    """Wrong input ends with one line and exit status 2, and leaves nothing behind."""

    def refused(self, capsys, *words, status=2):
        assert cli.main(["gap", "diagnose", *map(str, words), "--json"]) == status
        answer = json.loads(capsys.readouterr().out)
        assert answer["exit_status"] == status
        assert "defect" not in answer["error"]
        return answer["error"]

    def test_missing_folder_model_and_design(self, whole, capsys, tmp_path):
        out = tmp_path / "out"
        model = ("--model", DESIGN.name, "--out", out)
        assert "no measurement there" in self.refused(capsys, tmp_path / "none", *model)
        assert "nothing-like-it" in self.refused(
            capsys, whole.folder, "--model", "nothing-like-it", "--out", out
        )
        assert "--model" in self.refused(capsys, whole.folder, "--out", out)
        assert "--seed" in self.refused(capsys, whole.folder, *model, "--seed", "-1")
        assert "trust: one of" in self.refused(capsys, whole.folder, *model, "--trust", "everything")
        dome = ("--model", "gelsight-2020-dome", "--out", out)
        assert "not the same sensor" in self.refused(capsys, whole.folder, *dome)
        assert not out.exists()

    def test_folders_that_cannot_take_results(self, whole, capsys, tmp_path):
        (tmp_path / "file").write_text("text")
        model = ("--model", DESIGN.name)
        assert "is a file" in self.refused(capsys, whole.folder, *model, "--out", tmp_path / "file")
        (tmp_path / "mine").mkdir()
        (tmp_path / "mine" / "thesis.txt").write_text("text")
        assert "must be absent, empty or of an earlier run" in self.refused(
            capsys, whole.folder, *model, "--out", tmp_path / "mine"
        )

    def test_presses_at_too_few_places(self, whole, capsys, tmp_path):
        for number, places in enumerate((PLACES[:1], PLACES[:2])):
            drop = {f.file for f in whole.frames if f.kind == "press" and f.centre_mm not in places}
            few = changed(whole, tmp_path / str(number), drop=drop)
            said = self.refused(capsys, few.folder, "--model", DESIGN.name, "--out", tmp_path / "out")
            assert "presses at 3 places or more" in said

    @pytest.mark.parametrize("spoil", ["cut", "size", "probe", "nan"])
    def test_a_frame_that_cannot_be_read(self, whole, capsys, tmp_path, spoil):
        folder = changed(whole, tmp_path / "m").folder
        file, text = folder / "press-03.exr", (folder / "measurement.toml").read_text()
        if spoil == "cut":
            file.write_bytes(file.read_bytes()[:1000])
        elif spoil == "size":
            from designlab.core.images import read_image, write_image

            write_image(file, read_image(file)[:-3])
        elif spoil == "nan":
            import tifffile

            file.rename(folder / "press-03.tif")
            image = np.array(whole.image(whole.frames[0]))
            image[0, 0] = np.nan
            tifffile.imwrite(folder / "press-03.tif", image, photometric="rgb")
            (folder / "measurement.toml").write_text(text.replace("press-03.exr", "press-03.tif"))
        else:
            (folder / "measurement.toml").write_text(text.replace("sphere:5", "spere:5"))
        said = self.refused(capsys, folder, "--model", DESIGN.name, "--out", tmp_path / "out")
        expected = {"cut": "damaged", "size": "agree in size", "probe": "unknown 'spere'", "nan": "finite"}
        assert expected[spoil] in said
        assert "frame " in said

    def test_ctrl_c_says_how_to_go_on(self, whole, capsys, tmp_path, monkeypatch):
        def interrupt(*words, **more):
            raise KeyboardInterrupt

        monkeypatch.setattr("designlab.inference.diagnosis.diagnose", interrupt)
        words = (whole.folder, "--model", DESIGN.name, "--out", tmp_path / "out")
        said = self.refused(capsys, *words, status=130)
        assert said == (
            "interrupted; the pictures rendered so far are kept; run the same command again to go on"
        )
