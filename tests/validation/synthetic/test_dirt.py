"""A lab's dirt: small departures of every kind, of the sizes stated, which leave all else as it was."""

import numpy as np
import pytest

from designlab.core.images import read_image
from designlab.measurement import load_measurement
from designlab.sensor.design import preset
from designlab.validation.synthetic import plant, unseal
from designlab.validation.synthetic.dirt import GRAIN_RMS, LIGHT_RMS, LIT, READ_OFF, add_dirt
from designlab.validation.synthetic.electronics import grain
from designlab.validation.synthetic.generator_sensor import Rig, Sensor, cells
from designlab.validation.synthetic.light import EMITTER_SPACING_MM, Lighting, irradiance

pytestmark = pytest.mark.physics

FLAT = preset("gelsight-2020-flat")
CLEAN = Rig.of(FLAT)


def dirty(seed: int = 3) -> tuple[Rig, dict[str, object]]:
    return add_dirt(CLEAN, random=np.random.default_rng(seed))


def test_light_of_each_group_departs_smoothly_by_the_size_drawn() -> None:
    x, y = np.random.default_rng(0).uniform(-5000, 5000, (2, 20_000))
    for seed in range(4):
        rig, drawn = dirty(seed)
        assert LIGHT_RMS[0] <= drawn["light_rms"] <= LIGHT_RMS[1]
        # Over very many wavelengths the waves are independent of each other.
        assert rig.light_share(x, y).std(axis=1) == pytest.approx(drawn["light_rms"], rel=0.05)
        # Within a tenth of the gel the light changes by little of that.
        step = FLAT.sensing_area_mm[0] / 10
        change = rig.light_share(x + step, y) - rig.light_share(x, y)
        assert (change.std(axis=1) < drawn["light_rms"]).all()
    assert CLEAN.light_share(x, y) == 1.0


def test_a_strip_with_gaps_sends_the_light_of_the_whole() -> None:
    rig, drawn = dirty()
    lit = rig.emitters.half.prod(axis=1).sum() / CLEAN.emitters.half.prod(axis=1).sum()
    assert lit == pytest.approx(drawn["lit_share"])
    assert LIT[0] <= lit <= LIT[1]
    assert len(rig.face_flux) == len(rig.emitters.group) > len(CLEAN.emitters.group)

    def light_at(distance_mm: float, one: Rig) -> np.ndarray:
        """Irradiance by the first group, straight before the middle of its board."""
        normal = one.boards.normal[0]
        point = one.boards.centre[0] + distance_mm * normal
        own = cells(one.emitters, spacing_mm=EMITTER_SPACING_MM, exponent=one.exponent)
        power = Lighting(one).power(0)[:, : len(own.area)]
        return irradiance(point[None], -normal[None], own, power)[0, 0]

    assert light_at(300.0, rig) == pytest.approx(light_at(300.0, CLEAN), rel=1e-3)
    assert abs(light_at(0.5, rig) / light_at(0.5, CLEAN) - 1) > 0.02  # LEDs and gaps are seen from near


def test_walls_stand_above_the_boards() -> None:
    rig, drawn = dirty()
    boards, walls = np.split(np.arange(len(rig.boards.group)), 2)
    top = rig.boards.centre - rig.boards.half[:, 1:] * rig.boards.down
    foot = rig.boards.centre + rig.boards.half[:, 1:] * rig.boards.down
    assert foot[walls] == pytest.approx(top[boards])
    assert np.linalg.norm(top - foot, axis=1)[walls] == pytest.approx(drawn["wall_mm"])
    assert (top[walls, 2] > top[boards, 2]).all()


def test_grain_has_its_size_and_that_of_photons_grows_where_light_is_little() -> None:
    light = np.full((200, 300, 3), 0.5)
    light[:, 150:] = 0.125
    random = np.random.default_rng(0)
    coarse = grain(light, Sensor(grain_rms=0.02, grain_px=1.5), random)
    assert coarse.std() == pytest.approx(0.02, rel=0.02)
    beside = np.corrcoef(coarse[:, 1:, 0].ravel(), coarse[:, :-1, 0].ravel())[0, 1]
    assert beside == pytest.approx(np.exp(-1 / (4 * 1.5**2)), abs=0.03)  # of a Gaussian blur
    photons = grain(light, Sensor(sampling_rms=0.01), random)
    bright, dark = photons[:, :150].std(), photons[:, 150:].std()
    assert dark / bright == pytest.approx(2.0, rel=0.03)
    assert bright == pytest.approx(0.01 * np.sqrt(light.mean() / 0.5), rel=0.03)


def test_dirt_leaves_the_sensor_it_came_to_as_it_was() -> None:
    rig, _ = dirty()
    shared = {"camera", "lens", "mixing", "albedo", "flux_mw", "kernel_length_mm", "coat", "turn", "waves"}
    assert all(getattr(rig, name) is getattr(CLEAN, name) for name in shared)
    assert np.array_equal(dirty()[0].light_waves, rig.light_waves)
    assert not np.array_equal(dirty(4)[0].light_waves, rig.light_waves)


def test_dirt_of_a_core_is_not_known() -> None:
    behind = Rig.of(preset("gelsight-2020-flat-core"))
    with pytest.raises(ValueError, match=r"dirt: optics\.light_path must be 'air', is 'core'"):
        add_dirt(behind, random=np.random.default_rng(0))


@pytest.mark.slow
def test_a_set_with_dirt_states_poses_as_read_off_and_grain_is_each_states_own(tmp_path) -> None:
    common = {"effects": {}, "seed": 4, "kit": "small", "columns": 48, "unlisted": False}
    clean, dirt = (tmp_path / name for name in ("clean", "dirt"))
    plant(FLAT, out=clean, **common)
    plant(FLAT, out=dirt, dirt=True, noise=False, **common)
    assert unseal(clean)["dirt"] == {}
    drawn = unseal(dirt)["dirt"]
    assert GRAIN_RMS[0] <= drawn["grain_rms"] <= GRAIN_RMS[1]
    presses = [frame for frame in load_measurement(dirt).frames if frame.kind == "press"]
    assert all(frame.sigma.model_dump(exclude_none=True) == READ_OFF for frame in presses)
    # Repeats of one state agree to the last digit without noise; another state has grain of its own.
    first, second = (read_image(dirt / f"background-{number}.exr") for number in (0, 1))
    assert np.array_equal(first, second)
    rows = slice(0, 8)  # far from the first two presses, which are in one place
    shares = [(read_image(dirt / f"press-0{number}.exr") / first)[rows].std() for number in (1, 2)]
    assert all(share > drawn["grain_rms"] for share in shares)
