"""Recovery tells how well a calibration finds hidden sensors, and whether its intervals hold."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from designlab.core.progress import named, silent
from designlab.core.run_folder import resumed
from designlab.core.store import atomic_folder
from designlab.core.types import Progress
from designlab.inference.calibration import Calibration, calibrate
from designlab.inference.calibration.imaging import ALBEDO, KERNEL
from designlab.measurement import MeasuredFrame, Measurement, load_measurement, write_measurement
from designlab.sensor.contact import KernelContact, require
from designlab.sensor.design import CHANNELS, preset
from designlab.simulation.effects.model import SensorModel
from designlab.validation.paper_2020.datasets import around, dataset_2, stated
from designlab.validation.paper_2020.hidden import hidden
from designlab.validation.paper_2020.photograph import photograph
from designlab.validation.paper_2020.sizes import SENSORS

BINNED, PROBE_BINNED = 8, 2  # of pixels: 75 columns are enough for light and poses, mirrored LEDs need more
COLUMNS = 75
TRUE_SAMPLES, SAMPLES = 64, 48
INTERVAL = 1.96  # standard errors to either side: 95 %
STRONG = 0.25  # of the largest response to an LED group, above which a product counts on its own


@dataclass(frozen=True)
class Recovered:
    """One number: what it was, what was found, and its stated standard error (None: none was stated)."""

    name: str
    true: float
    found: float
    se: float | None

    @property
    def covered(self) -> bool:
        """Whether the stated 95 % interval holds the truth."""
        return self.se is not None and abs(self.found - self.true) <= INTERVAL * self.se


def measured(
    true: SensorModel, sensor: str, presses: Sequence[MeasuredFrame], folder: Path, *, seed: int
) -> tuple[Measurement, list[MeasuredFrame]]:
    """Photograph what a calibration needs, with coarse pixels; the measurement, and the true frames."""
    frames = [*around(true.design, light_probe=True), *presses]
    probes = [frame for frame in frames if frame.kind == "light_probe"]
    others = [frame for frame in frames if frame.kind != "light_probe"]
    taken, pictures = photograph(true, others, samples=TRUE_SAMPLES, seed=seed, binned=BINNED)
    more, mirrored = photograph(true, probes, samples=TRUE_SAMPLES, seed=seed + 1, binned=PROBE_BINNED)
    taken += more
    set_ = Measurement(
        name=f"made {sensor} {seed}",
        sensor=sensor,
        response="linear",
        source="simulated: unbiased estimator, fine mesh, camera noise, poses off by their stated doubt",
        frames=tuple(stated(taken, seed=seed)),
    )
    return load_measurement(write_measurement(set_, pictures | mirrored, folder)), taken


def truths(true: SensorModel, frames: Sequence[MeasuredFrame]) -> dict[str, float]:
    """Value of every number that a calibration may report; floors are above the dark frames, so zero."""
    design = true.design
    flux = design.flux_mw
    transfer = (design.fixed_exposure or 1.0) * design.mixing_matrix * flux
    albedo = design.per_group("membrane_albedo")
    found = {KERNEL: require(design.contact, KernelContact).kernel_length_mm}
    found |= {f"{ALBEDO}.{group}": value for group, value in enumerate(albedo)}
    for channel, letter in enumerate(CHANNELS):
        found[f"floor.{letter}"] = 0.0
        for group, name in enumerate(design.group_names):
            found[f"transfer.{letter}.{name}"] = float(transfer[channel, group])
            found[f"product.{letter}.{name}"] = float(transfer[channel, group] * albedo[group])
    for frame in frames:
        if frame.kind == "press" and frame.centre_mm is not None and frame.depth_mm is not None:
            found[f"{frame.file}.x_mm"], found[f"{frame.file}.y_mm"] = frame.centre_mm
            found[f"{frame.file}.depth_mm"] = frame.depth_mm
            found[f"{frame.file}.yaw_deg"] = frame.yaw_deg or 0.0
    return found


def compared(calibration: Calibration, truth: dict[str, float]) -> list[Recovered]:
    """Everything that was fitted beside what it should have been."""
    return [
        Recovered(p.name, truth[p.name], p.value, p.se)
        for p in (*calibration.parameters, *calibration.products)
        if p.name in truth
    ]


def repeat(number: int, folder: str | Path, *, progress: Progress = silent) -> dict[str, Any]:
    """Make one hidden sensor and calibrate it, or take it from the folder where it is there.

    The gel is flat or a dome, and a ball or a triangle is pressed, in turn. The fit starts from the preset;
    kernel, reflectances, light, floor and poses are free.
    """
    folder = Path(folder)

    def made() -> dict[str, Any]:
        sensor = list(SENSORS.values())[number // 2 % 2]
        nominal = preset(sensor)
        true = hidden(nominal, seed=100 + number)
        press = dataset_2(nominal, seed=100 + number, balls=1, triangles=1)[number % 2]
        with atomic_folder(folder / f"measured-{number:02d}", replace=True) as place:
            measurement, frames = measured(true, sensor, [press], place / "set", seed=100 + number)
            free = [KERNEL, *(f"{ALBEDO}.{group}" for group in range(len(true.design.leds.groups)))]
            found = calibrate(
                measurement,
                nominal,
                columns=COLUMNS,
                samples=SAMPLES,
                seed=7 + number,
                free=free,
                progress=progress,
            )
        values = compared(found, truths(true, frames))
        return {"sensor": sensor, "values": [vars(value) for value in values]}

    return resumed(folder / f"repeat-{number:02d}.json", made)


def recovery(repeats: int, folder: str | Path, *, progress: Progress = silent) -> dict[str, Any]:
    """Repeat with other sensors; what is left to do is done, what is there is taken.

    Returns
    -------
    dict
        Largest and median errors of powers, reflectances, products and poses, and the share of stated 95 %
        intervals that hold the truth, over all numbers and by kind.
    """
    found = []
    for number in range(repeats):
        progress(f"{told(number)}of {repeats}", 0, 1)
        found.append(repeat(number, folder, progress=named(progress, told(number))))
    return summary(found)


def told(number: int) -> str:
    """How progress of a repeat begins to tell of it."""
    return f"number {number + 1} "


def summary(repeats: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Pool repeats."""
    rows: list[Recovered] = []
    errors: dict[str, list[float]] = {}
    for one in repeats:
        own = [Recovered(**value) for value in one["values"]]
        strongest: dict[str, float] = {}
        for value in own:
            kind, _, group = value.name.rpartition(".")
            if kind.startswith(("transfer", "product")):
                key = f"{kind[:8]}.{group}"
                strongest[key] = max(strongest.get(key, 0.0), value.true)
        for value in own:
            name, size = _error(value, strongest)
            errors.setdefault(name, []).append(size)
        rows += own
    stated = [value for value in rows if value.se is not None and value.se > 0]
    kinds: dict[str, list[bool]] = {}
    for value in stated:
        kinds.setdefault(_kind(value.name), []).append(value.covered)
    return {
        "repeats": len(repeats),
        "errors": {
            name: {"median": float(np.median(sizes)), "largest": float(np.max(sizes)), "count": len(sizes)}
            for name, sizes in sorted(errors.items())
        },
        "covered": {
            **_share([value.covered for value in stated]),
            "by_kind": {kind: _share(held) for kind, held in sorted(kinds.items())},
        },
    }


def _share(held: list[bool]) -> dict[str, float]:
    return {"share": float(np.mean(held)), "count": len(held)}


def _error(value: Recovered, strongest: dict[str, float]) -> tuple[str, float]:
    """Name and size of an error: relative, of weak responses relative to the group's strongest one."""
    kind, size = _kind(value.name), abs(value.found - value.true)
    if kind in ("transfer", "product"):
        name, _, group = value.name.rpartition(".")
        top = strongest[f"{name[:8]}.{group}"]
        return (kind, size / value.true) if value.true > STRONG * top else (f"{kind}, crosstalk", size / top)
    return kind, size / value.true if kind in ("reflectance", "kernel") else size


def _kind(name: str) -> str:
    if name.startswith(ALBEDO):
        return "reflectance"
    if name == KERNEL:
        return "kernel"
    first = name.partition(".")[0]
    return first if first in ("transfer", "product", "floor") else name.rpartition(".")[2]
