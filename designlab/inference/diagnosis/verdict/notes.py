"""Notes of a report: what frames, fits and physics say beside the verdict."""

from collections.abc import Iterator, Sequence

import numpy as np

from designlab.inference.diagnosis.likelihood.fit import FRINGES_SD, SIZE_SD, Fitter
from designlab.inference.diagnosis.result import Found
from designlab.inference.diagnosis.selection.held_out import Stand
from designlab.measurement import Measurement
from designlab.measurement.shots import Observations
from designlab.sensor.design import Design
from designlab.simulation.effects import CATALOGUE, UNASKED, SensorModel, effect

OF_PIXELS = tuple(e.name for e in CATALOGUE if e.per_pixel)  # with a number of their own for each pixel
OTHER_SD = 2.5  # usual errors of what is fitted along from which it is worth a note


def notes(
    seen: Observations,
    measurement: Measurement,
    model: SensorModel,
    given: Stand,
    last: Stand,
    effects: Sequence[Found],
) -> tuple[str, ...]:
    """All notes on a diagnosis of several presses.

    Parameters
    ----------
    given, last : Stand
        The model as given and the corrected one.
    effects : sequence of Found
        Effects found.
    """
    return (
        *of_frames(seen, measurement, model),
        *of_chance(given.fitter),
        *of_what_is_fitted_along(last),
        *of_unusual_values(last, effects),
        *of_confounded_effects(effects, model.effective_design()),
    )


def of_frames(seen: Observations, measurement: Measurement, model: SensorModel) -> Iterator[str]:
    """Note what was seen of the frames, and that they are of another sensor than the model."""
    yield from seen.notes
    if len({shot.view for shot in seen.shots}) > 1:
        for name in OF_PIXELS:
            yield f"{name} was not tried: frames show several parts of the camera's sensor"
    stated = measurement.design()
    if stated is not None and stated.digest != model.design.digest:
        yield f"the measurement names the sensor {measurement.sensor!r}, which is not the design of the model"


def of_chance(fitter: Fitter) -> Iterator[str]:
    """Note what chance leaves of light that is counted in photons."""
    shares = [
        float(np.sqrt((own.random.sigma**2).mean() / (shot.signal**2).mean()))
        for shot, own in zip(fitter.bank.shots, fitter.noises, strict=True)
        if own.random is not None and shot.lit.all()
    ]
    if shares:
        yield (
            "light behind the core is counted in photons; what chance leaves of it, "
            f"{np.median(shares):.1%} of the light, is part of the floor"
        )


def of_what_is_fitted_along(last: Stand) -> Iterator[str]:
    """Note probes that seem to be of another size than stated, and a lens that shifts colours much."""
    share = last.fit.state.fringes
    if abs(share) > OTHER_SD * FRINGES_SD:
        more, less = ("red", "blue") if share > 0 else ("blue", "red")
        yield f"the lens magnifies {more} {abs(share):.2%} more, and {less} less, than green"
    for probe, larger in last.fit.state.sizes.items():
        if abs(larger) > OTHER_SD * SIZE_SD:
            than = "larger" if larger > 0 else "smaller"
            yield f"probe {probe} fits best {abs(larger):.1%} {than} than stated: measure it"


def of_unusual_values(last: Stand, effects: Sequence[Found]) -> Iterator[str]:
    """Note values far beyond what is usual of built sensors."""
    for found in effects:
        bound = last.fitter.at_bound(last.state, found.name)
        far = dict.fromkeys([*last.fitter.beyond_prior(last.fit, found.name), *bound])
        if far:
            limit = ", at the end of its range" if bound else ""
            yield (
                f"{found.name}: {', '.join(far)} far beyond what is usual of built sensors{limit}: check "
                "that part of the sensor, and what the design says of it"
            )


def of_confounded_effects(effects: Sequence[Found], design: Design) -> Iterator[str]:
    """Note of each effect found what does much the same by its physics, whatever these frames tell."""
    for found in effects:
        fields = [name for name in effect(found.name).confounded_with if "." in name]
        others = [name for name in effect(found.name).confounded_with if name in UNASKED]
        others = [name for name in others if effect(name).parameters(design)]
        if others:
            yield f"{found.name}: {', '.join([*others, *fields])} would do much the same"
