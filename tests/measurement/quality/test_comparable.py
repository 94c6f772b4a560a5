"""Sets that cannot be compared with a model stop; what a model may lack does not."""

import numpy as np
import pytest

from designlab.measurement import MeasurementError, check, load_measurement, refuse, write_measurement
from designlab.measurement.quality.comparable import check_comparable
from designlab.sensor.design import preset
from designlab.simulation.effects import SensorModel
from tests.helpers.spoilt_sets import DESIGN

MODEL = SensorModel.of(DESIGN)


@pytest.mark.parametrize("effect", ["black_level", "response_curve", "exposure_drift", "banding"])
def test_what_an_effect_of_the_catalogue_does_is_no_fault(hour, effect):
    assert all(note.startswith("not_additive") for note in check_comparable(hour(effect), MODEL))


def test_a_response_that_is_not_known_stops(whole):
    unknown = whole.model_copy(update={"response": "unknown"})
    with pytest.raises(MeasurementError, match=r"field response: must be known.*remedy: "):
        check_comparable(unknown, MODEL)


def test_the_model_of_another_sensor_stops(whole):
    dome = SensorModel.of(preset("gelsight-2020-dome"))
    with pytest.raises(MeasurementError, match=r"field sensor: .* not the same sensor: gel flat"):
        check_comparable(whole, dome)
    nearly = DESIGN.replace({"leds.height_mm": DESIGN.leds.height_mm + 1})
    check_comparable(whole, SensorModel.of(nearly))


def test_frames_that_are_not_compared_may_be_as_they_are(whole, tmp_path):
    """A lens in front of a bright wall may be saturated: no diagnosis looks at it."""
    lens = whole.frames[0].model_copy(update={"file": "lens.exr", "kind": "flat_field", "leds": None})
    images = {frame.file: np.array(whole.image(frame)) for frame in whole.frames}
    images["lens.exr"] = np.ones_like(images[whole.frames[0].file])
    both = whole.model_copy(update={"frames": (*whole.frames, lens)})
    both = load_measurement(write_measurement(both, images, tmp_path / "m"))
    with pytest.raises(MeasurementError, match=r"saturated: lens\.exr"):
        refuse(both, check(both))
    assert check_comparable(both, MODEL) == check_comparable(whole, MODEL)
