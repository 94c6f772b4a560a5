"""Specifications behave as values, and their errors name the field."""

import pickle
import subprocess
import sys
from typing import Any

import pytest

from geometries import Elastomer, Gelcore, Housing, LedArray, LedGroup, Probe, Spec
from geometries.emission import AngularProfile

GROUP = {"name": "red", "azimuth_deg": [90.0]}
VALUES = [
    Gelcore(),
    Gelcore(shape="dome", radius_mm=20.0),
    Elastomer(),
    Elastomer(shape="dome", outline="round", radius_mm=20.0),
    Housing(),
    LedArray(groups=(LedGroup(name="red", azimuth_deg=(90.0,)),)),
    AngularProfile(beam_deg=20.0),
    AngularProfile(polar_deg=(0, 90), azimuth_deg=(0, 90), intensity=((2, 1), (2, 0))),
    Probe(kind="sphere", size_mm=4.0),
    Probe(kind="mesh", size_mm=4.0, file="part.stl"),
]


@pytest.mark.parametrize("spec", VALUES, ids=lambda spec: type(spec).__name__)
def test_specs_are_values(spec: Spec) -> None:
    copy = type(spec).model_validate(spec.model_dump())
    assert copy == spec
    assert hash(copy) == hash(spec)
    assert pickle.loads(pickle.dumps(spec)) == spec
    assert type(spec).model_validate_json(spec.model_dump_json()) == spec
    names = {type(value).__name__: type(value) for value in [*VALUES, spec]} | {"LedGroup": LedGroup}
    assert eval(repr(spec), names) == spec
    with pytest.raises(ValueError, match="frozen"):
        spec.size_mm = 1.0  # type: ignore[attr-defined]


def test_different_specs_differ() -> None:
    assert len(set(VALUES)) == len(VALUES)


SPECS = sorted({type(v) for v in VALUES} | {LedGroup}, key=lambda spec: spec.__name__)


@pytest.mark.parametrize("spec", SPECS, ids=lambda spec: spec.__name__)
def test_every_field_is_described_and_every_length_has_its_unit(spec: type[Spec]) -> None:
    for name, field in spec.model_fields.items():
        assert field.description, name
        unit = (
            (field.json_schema_extra or {}).get("unit") if isinstance(field.json_schema_extra, dict) else None
        )
        for suffix in ("mm", "deg", "nm", "mw"):
            if name.endswith(f"_{suffix}") and unit is not None:
                assert unit.lower() == suffix, name


BAD = [
    (Gelcore, {"width_mm": 0.0}, "width_mm"),
    (Gelcore, {"width_mm": float("nan")}, "width_mm"),
    (Gelcore, {"widht_mm": 24.0}, "widht_mm"),
    (Gelcore, {"shape": "round"}, "shape"),
    (Gelcore, {"shape": "dome"}, "radius_mm: a dome needs the radius"),
    (Gelcore, {"radius_mm": 20.0}, "radius_mm: only a dome has a radius, shape is 'hexagonal'"),
    (Gelcore, {"draft_deg": 31.0}, "draft_deg"),
    (Elastomer, {"shape": "dome", "outline": "round"}, "radius_mm: a dome needs the radius"),
    (Elastomer, {"shape": "dome", "radius_mm": 20.0}, "outline: a dome is round, not 'hexagon'"),
    (
        Elastomer,
        {"shape": "dome", "outline": "round", "radius_mm": 2.0, "width_mm": 3.0, "thickness_mm": 2.0},
        "thickness_mm: must be below radius_mm (2 mm), is 2 mm",
    ),
    (Elastomer, {"radius_mm": 20.0}, "radius_mm: only a dome has a radius, shape is 'flat'"),
    (Housing, {"bottom_mm": 30.0}, "top_mm: must be above bottom_mm (30 mm), is 30 mm"),
    (Housing, {"camera_hole_mm": 34.0}, "camera_hole_mm: must be below the inner diameter (34 mm), is 34 mm"),
    (LedGroup, {"name": "", "azimuth_deg": [0.0]}, "name"),
    (LedGroup, {"name": "red", "azimuth_deg": []}, "azimuth_deg"),
    (LedArray, {"groups": []}, "groups"),
    (LedArray, {"groups": [GROUP, GROUP]}, "groups: names must differ, got ['red', 'red']"),
    (LedArray, {"groups": [GROUP], "tilt_deg": 91.0}, "tilt_deg"),
    (
        LedArray,
        {"groups": [GROUP], "emitting_spans_mm": [[1.0, -1.0]]},
        "runs from low to high, got (1, -1) mm",
    ),
    (LedArray, {"groups": [GROUP], "emitting_spans_mm": [[-1.5, 1.0]]}, "body_height_mm is 2.8 mm"),
    (
        LedArray,
        {"groups": [GROUP], "emitting_width_mm": 4.0},
        "must not exceed body_width_mm (3.5 mm), is 4 mm",
    ),
    (Probe, {"kind": "sphere"}, "size_mm"),
    (Probe, {"kind": "cube", "size_mm": 4.0}, "kind"),
    (Probe, {"kind": "mesh", "size_mm": 4.0}, "file: a probe of kind mesh needs its mesh file"),
    (
        Probe,
        {"kind": "cone", "size_mm": 4.0, "file": "a.stl"},
        "only a probe of kind mesh has a file, kind is 'cone'",
    ),
]


@pytest.mark.parametrize(("spec", "fields", "text"), BAD)
def test_errors_name_the_field_and_the_rule(spec: type[Spec], fields: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError) as refusal:  # noqa: PT011 (the text is compared below, brackets and all)
        spec.model_validate(fields)
    assert text in str(refusal.value)


def test_importing_the_package_is_cheap_and_stands_alone() -> None:
    names = ["elastomer", "gelcore", "housing", "leds", "mesh", "outline", "probes", "raster", "spec"]
    code = (
        f"import sys, {', '.join(f'geometries.{name}' for name in names)}\n"
        "print([m for m in ('cadquery', 'trimesh', 'scipy', 'mitsuba', 'designlab') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
