"""Shared fields are numbers of design and probe that a calibration fits: bounds, priors, difference steps."""

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

from pydantic import BaseModel

from designlab.core.fields import OPEN_END, FieldAt, field_at
from designlab.sensor.contact import LayerContact
from designlab.sensor.design import Design
from geometries.probes import LARGEST_EDGE, Probe

# What light transport does not see, or sees as a factor only, is part of the transfer.
WITHIN = "design."  # prefix of the design's fields in a model that holds one
IN_TRANSFER = r"mixing(\..*)?|leds\.groups\.\d+\.flux_mw|camera\.exposure|(factors|floor)(\..*)?"
UNSEEN = r"camera\.(full_well_e|read_noise_e|black_level)"
SHARE = r"optics\.\w+(albedo|reflectance)\.\d+"  # of several values, whose bounds pydantic does not hold
STEP = 0.05  # of the value, for finite differences
EDGE_STEP = 0.01  # edges move by pixels where the camera or the size of a probe does
BOUNDED_STEP = 0.05  # of stated bounds, for a value that starts at zero
PROBE = "probe."  # prefix of what is pressed, which all presses share
OF_EDGES = ("camera.", f"{PROBE}size_mm")
MATERIAL = ("modulus_mpa", "poisson")  # of a gel of the table where the design states none
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
STATED = re.compile(
    rf"(?P<path>[^=]+)(?:=(?:(?P<value>{NUMBER})\+-(?P<sigma>{NUMBER}))?,?"
    rf"(?:(?P<low>{NUMBER})\.\.(?P<high>{NUMBER}))?)?"
)
DIRECTION, DIRECTION_STEP_DEG = r"lights\.\d+\.\w+_deg", 1.0
# Smaller steps of an LED change a picture by less than the noise of light through ground sides.
LED_PLACE = r"leds\.(groups\.\d+\.)?(?P<name>height_mm|tilt_deg|azimuth_deg)(\.\d+)?"
LED_STEPS = {"height_mm": 0.5, "tilt_deg": 2.0, "azimuth_deg": 3.0}
MOST_EDGE = 0.5  # of the largest edge radius that a probe of the given size can have


class SharedField(NamedTuple):
    """A number that all frames share, with its bounds and the step of finite differences.

    Beside the pictures it is expected at `expected` with the standard deviation `sigma`, infinite where
    nothing is known.
    """

    path: str
    unit: str
    value: float
    low: float
    high: float
    step: float
    expected: float = 0.0
    sigma: float = math.inf


def shared_fields(
    model: BaseModel, free: Sequence[str], probes: Sequence[Probe] = ()
) -> tuple[SharedField, ...]:
    """Look up the fields to be fitted.

    Parameters
    ----------
    model : BaseModel
        Design, or model that holds one.
    free : sequence of str
        Dotted paths, of the probe such as ``probe.size_mm``. After the path may follow what is known of the
        value: ``PATH=4+-1.5`` (value and standard deviation), ``PATH=5..5.8`` (bounds) or both,
        ``PATH=4+-1.5,2..6``.
    probes : sequence of Probe
        What is pressed.

    Raises
    ------
    ValueError
        If a path names no number, is named twice, or cannot be calibrated; says which and why.
    """
    stated = [_stated(text) for text in free]
    paths = [path for path, _, _ in stated]
    repeated = sorted({path for path in paths if paths.count(path) > 1})
    if repeated:
        raise ValueError(f"free: each field once, got {', '.join(repeated)} twice")
    return tuple(_known(_field(model, path, probes), prior, bounds) for path, prior, bounds in stated)


def _stated(text: str) -> tuple[str, tuple[float, float] | None, tuple[float, float] | None]:
    """Path, value with standard deviation, and bounds."""
    match = STATED.fullmatch(text.strip())
    if match is None or text.endswith(("=", ",")):
        raise ValueError(
            f"free: FIELD, FIELD=VALUE+-SIGMA, FIELD=LOW..HIGH or FIELD=VALUE+-SIGMA,LOW..HIGH, got {text!r}"
        )
    value, sigma, low, high = (
        None if part is None else float(part) for part in match.group("value", "sigma", "low", "high")
    )
    prior = None if value is None or sigma is None else (value, sigma)
    bounds = None if low is None or high is None else (low, high)
    if (prior and not prior[1] > 0) or (bounds and not bounds[0] < bounds[1]):
        raise ValueError(f"free: the standard deviation is above 0 and bounds ascend, got {text!r}")
    return match["path"], prior, bounds


def _known(
    found: SharedField, prior: tuple[float, float] | None, bounds: tuple[float, float] | None
) -> SharedField:
    """Put what is stated of a value into its field; the fit starts there."""
    value, low, high, step = found.value, found.low, found.high, found.step
    if bounds is not None:
        low, high = max(low, bounds[0]), min(high, bounds[1])
        if low > high:
            raise ValueError(
                f"free: {found.path} lies between {found.low:.4g} and {found.high:.4g}, "
                f"got {bounds[0]:g}..{bounds[1]:g}"
            )
        step = step if value else BOUNDED_STEP * (high - low)
    if prior is not None:
        value = prior[0]
        found = found._replace(expected=prior[0], sigma=prior[1])
    return found._replace(value=min(max(value, low), high), low=low, high=high, step=step)


def _field(model: BaseModel, path: str, probes: Sequence[Probe]) -> SharedField:
    inner = path.removeprefix(WITHIN)
    if path.startswith(PROBE):
        return _of_probe(path, probes)
    if re.fullmatch(IN_TRANSFER, inner):
        raise ValueError(
            f"free: {path} cannot be told from other factors of the light and is fitted with them as transfer"
        )
    if re.fullmatch(UNSEEN, inner):
        raise ValueError(f"free: {path} must be a field that pictures without noise depend on")
    node, unit, low, high = _looked_up(model, path)
    if node is None:
        node = _of_material(model, path)
    if isinstance(node, bool) or not isinstance(node, float):
        raise ValueError(f"free: {path} must be a number that can vary, got {node!r}")
    if re.fullmatch(SHARE, inner):
        low, high = OPEN_END, 1.0 - (model.optics.coating_transmittance if isinstance(model, Design) else 0.0)
    step = _step(inner, node, low, high)
    if re.fullmatch(DIRECTION, path):
        step = DIRECTION_STEP_DEG
    if place := re.fullmatch(LED_PLACE, inner):
        step = LED_STEPS[place["name"]]
    return SharedField(path, unit, node, low, high, step)


def _of_material(model: BaseModel, path: str) -> float | None:
    """Elastic constant of the gel that a design names without stating the constant itself."""
    place, _, name = path.rpartition(".")
    contact = field_at(model, place).value if name in MATERIAL else None
    if not isinstance(contact, LayerContact):
        return None
    return float(getattr(contact.layer(thickness_mm=1.0), name))


def _of_probe(path: str, probes: Sequence[Probe]) -> SharedField:
    """Look up a length of the probe, which has to be one and the same in every press."""
    if len(set(probes)) != 1:
        texts = ", ".join(sorted({probe.text for probe in probes})) or "none"
        raise ValueError(f"free: {path} needs one probe in all presses, got {texts}")
    probe = probes[0]
    value, unit, low, high = _looked_up(probe, path.removeprefix(PROBE))
    if not isinstance(value, float):
        raise ValueError(f"free: {path} must be a number that can vary, got {value!r}")
    if path == f"{PROBE}edge_radius_mm":
        if probe.kind not in LARGEST_EDGE:
            raise ValueError(f"free: {path} is of {', '.join(LARGEST_EDGE)}, the probe is a {probe.kind}")
        high = MOST_EDGE * LARGEST_EDGE[probe.kind] * probe.size_mm
    return SharedField(path, unit, value, low, high, _step(path, value, low, high))


def _step(path: str, value: float, low: float, high: float) -> float:
    share = EDGE_STEP if path.startswith(OF_EDGES) else STEP
    return share * abs(value) or 0.01 * (min(high, 1.0) - max(low, -1.0))


def _looked_up(spec: BaseModel, path: str) -> FieldAt:
    try:
        return field_at(spec, path)
    except LookupError as error:
        raise ValueError(f"free: {error} in the model") from None
