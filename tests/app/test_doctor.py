"""The report of what the machine offers."""

import json

import numpy as np
import pytest

from designlab.app import doctor
from designlab.core import backend


@pytest.mark.slow
def test_report_is_json_and_text() -> None:
    report = json.loads(json.dumps(doctor.doctor()))
    assert report["packages"]["numpy"] == np.__version__
    assert report["backend"]["variant"] == backend.choose().variant
    text = doctor.render_text(report)
    assert report["backend"]["variant"] in text
    for entry in report["missing"]:
        assert entry["what"] in text
        assert entry["how"] in text


def test_everything_missing_is_reported_not_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_process(*_: object, **__: object) -> None:
        raise OSError("no process can be started")

    monkeypatch.setattr(doctor, "installed_version", lambda _: None)
    monkeypatch.setattr(backend, "run_apart", no_process)
    monkeypatch.setattr(doctor.llvm, "candidate_paths", list)
    report = doctor.doctor()
    assert report["ok"] is False
    assert report["backend"] is None
    missing = {entry["what"] for entry in report["missing"]}
    assert "a back end: Mitsuba is not installed" in missing
    assert "package numpy" in missing
    assert "off-screen 3D pictures: no process can be started" in missing
    assert "back end     none" in doctor.render_text(report)


@pytest.mark.slow
def test_missing_optional_package_is_not_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    known = doctor.installed_version
    monkeypatch.setattr(
        doctor, "installed_version", lambda name: None if name == "pymeshlab" else known(name)
    )
    report = doctor.doctor()
    assert report["ok"] is True
    assert "package pymeshlab" in {entry["what"] for entry in report["missing"]}


@pytest.mark.slow
def test_impossible_variant_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(backend.VARIANT_VARIABLE, "fast")
    monkeypatch.setattr(backend, "choose", backend.choose.__wrapped__)
    report = doctor.doctor()
    assert report["ok"] is False
    assert "got 'fast'" in report["missing"][0]["what"]
    assert report["missing"][0]["how"] == "unset DESIGNLAB_VARIANT"
