"""Light behind a core where uneven LEDs stand, against the mean of other random numbers."""

import numpy as np
import pytest

from designlab.inference.diagnosis.emulator.rendering import fill, rendered_at
from designlab.measurement.shots import Shot
from designlab.sensor.design import preset
from designlab.simulation.effects import AppliedEffect, SensorModel
from designlab.simulation.render_cache import Renders

DESIGN = preset("default")
VIEW = DESIGN.view(40)
UNEVEN = {"red_1": 0.1, "red_2": -0.05, "green_1": -0.1, "green_2": -0.08, "blue_1": 0.0, "blue_2": 0.1}
SAMPLES, SEEDS = 16, 6


def untouched() -> Shot:
    flat = np.ones((VIEW.rows, VIEW.columns, 3))
    return Shot(
        files=("background.exr",),
        use="background",
        press=None,
        pose_sigma=np.zeros(4),
        lit=np.ones(3),
        view=VIEW,
        signal=flat,
        variance=flat,
        valid=flat > 0,
        dark_sigma=np.full(3, 1e-4),
    )


@pytest.mark.renders
@pytest.mark.slow
@pytest.mark.llvm
@pytest.mark.full
def test_photons_that_go_other_ways_bring_no_noise_of_their_own(tmp_path) -> None:
    given = SensorModel.of(DESIGN)
    uneven = given.with_effect(AppliedEffect(name="led_spread", values=UNEVEN))
    renders = Renders(tmp_path, SAMPLES, 0)
    bank = fill(renders, given, (untouched(),), ["led_spread"], finer=False, both=False)
    view = bank.of(0).view

    def ratio(source: Renders) -> np.ndarray:
        pictures = (source.basis(model, None, view, like=given) for model in (uneven, given))
        changed, usual = (np.asarray(picture, dtype=float) for picture in pictures)
        return changed / usual

    truth = np.mean([ratio(Renders(tmp_path, SAMPLES, seed)) for seed in range(1, 1 + SEEDS)], axis=0)
    ((_, found),) = rendered_at(renders, bank, {"led_spread": UNEVEN}, {0: np.zeros(4)}, {})
    inside = (slice(None), *bank.of(0).place)
    raw = (ratio(renders) - truth)[inside].std()
    left = (found / bank.of(0).light - truth)[inside].std()
    assert left < 0.7 * raw, (left, raw)
    assert left < 0.02
    assert truth[inside].std() > 2 * left  # uneven LEDs show
