import math

import numpy as np
import pytest
from random_designs import RANGES, random_design

from geometries.elastomer import base_mm
from geometries.leds import emitters

pytestmark = pytest.mark.slow

SEEDS = range(40)


@pytest.fixture(scope="module")
def designs():
    return [random_design(seed) for seed in SEEDS]


def test_same_seed_same_design(designs):
    assert random_design(3).digest == designs[3].digest
    assert len({design.digest for design in designs}) == len(designs)


def test_every_design_is_feasible_and_seen_whole(designs):
    for design in designs:
        assert max(design.margins().values()) <= 0, design.name
        width, height = design.sensing_area_mm
        for x, y in ((-width / 2, -height / 2), (width / 2, height / 2)):
            column, row = design.project_px(x, y)
            assert 0 <= column <= design.camera.width_px
            assert 0 <= row <= design.camera.height_px


def test_kinds_come_in_their_shares(designs):
    # Shape and light path are drawn before anything is thrown away: binomial, here within 3 sigma.
    count = len(designs)
    dome = sum(design.elastomer.shape == "dome" for design in designs)
    core = sum(design.optics.light_path == "core" for design in designs)
    assert abs(dome - count / 2) < 3 * math.sqrt(count / 4)
    assert abs(core - 2 * count / 3) < 3 * math.sqrt(count * 2 / 9)
    for field in ("package", "coupling"):
        assert len({getattr(design.leds, field) for design in designs}) == 2
    assert len({design.gelcore.side_finish for design in designs}) == 3


def test_numbers_keep_to_their_ranges_and_use_them(designs):
    drawn = {
        "gel_thickness": [d.elastomer.thickness_mm for d in designs],
        "dome_radius": [d.elastomer.radius_mm for d in designs if d.elastomer.radius_mm],
        "albedo": [a for d in designs for a in d.optics.membrane_albedo],
        "profile_exponent": [d.leds.profile.exponent for d in designs],
        "board_reflectance": [a for d in designs for a in d.optics.board_reflectance],
        "field_of_view": [d.camera.horizontal_fov_deg for d in designs],
    }
    for name, values in drawn.items():
        low, high = RANGES[name][:2]
        assert low <= min(values) < low + 0.3 * (high - low), name
        assert high - 0.3 * (high - low) < max(values) <= high, name


def test_light_into_a_core_meets_its_side(designs):
    # Straight ahead of every face of an untilted LED stands the core, not the open air over it.
    for design in designs:
        if design.optics.light_path != "core":
            continue
        window = design.elastomer.thickness_mm + design.gelcore.height_mm
        for face in emitters(design.leds):
            half = face.half_height_mm * abs(face.down[2])
            assert face.centre_mm[2] + half <= window + 1e-9
            lowest = design.elastomer.thickness_mm
            if design.gelcore.radius_mm is not None:
                lowest += design.gelcore.radius_mm - math.sqrt(
                    design.gelcore.radius_mm**2 - (design.gelcore.width_mm / 2) ** 2
                )
            assert face.centre_mm[2] - half >= lowest - 1e-9


def test_light_in_air_stands_off_the_membrane(designs):
    for design in designs:
        if design.optics.light_path != "air":
            continue
        for face in emitters(design.leds):
            x, y, z = face.centre_mm
            if np.hypot(x, y) < design.elastomer.width_mm / 2:
                assert z - float(base_mm(design.elastomer, x, y)) > 0.5
