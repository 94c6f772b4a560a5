"""A model of one sensor's pictures is a sum of components, each with a factor for every channel.

A component is the picture of one LED group at unit flux, say. `Rendered` simulates light; what a calibration
asks of it, `directional.Directional` answers as well.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from pydantic import BaseModel

from designlab.core.memory import remembered
from designlab.core.progress import Work
from designlab.core.types import Array
from designlab.measurement.light_probe.ball import LightProbe
from designlab.measurement.light_probe.picture import light_probe
from designlab.measurement.shots import Shot
from designlab.sensor.camera import View
from designlab.sensor.design import CHANNELS, Design
from designlab.simulation.contact.press import Press
from designlab.simulation.effects.camera import BlackLevel
from designlab.simulation.effects.model import AppliedEffect, SensorModel
from designlab.simulation.imaging import mixed
from designlab.simulation.simulator import Simulator, automatic_exposure

KERNEL, SKIN, MODULUS = "contact.kernel_length_mm", "contact.skin_length_mm", "contact.modulus_mpa"
SCALE = "camera.horizontal_fov_deg"
ALBEDO = "optics.membrane_albedo"
NODES, BRIGHTEST = (0.7, 1.4), 0.95  # reflectances that are simulated where they are free, of the given ones
MOST_LEVEL = 0.99  # black level of a camera
MOST_KNOWN = 160  # pictures kept
UNBIASED_SAMPLES = 128  # per pixel and LED group

Touched = Press | LightProbe | None
"""What a shot shows: an indentation, a light probe in the place of the gel, or the untouched gel."""


How = Literal["usual", "rough", "fine", "unbiased"]
"""As usual; less exactly, which is good enough for derivatives; on a mesh of half the pitch; without the bias
of the usual light transport."""


@dataclass(frozen=True)
class Rendered:
    """Light transport: one component for each LED group, its picture at unit flux.

    Parameters
    ----------
    design : Design
        The sensor.
    samples : int
        Samples per pixel and LED group.
    probe_samples : int
        The same of a light probe, which is path-traced; a ball mirrors LEDs with next to no noise.
    beyond : array, shape (3,)
        Level of each channel above the camera's black level.
    known : dict
        Pictures kept, since much of what is asked for was asked before.
    work : Work
        What pictures are a part of; its unit is a picture.
    """

    design: Design
    samples: int
    probe_samples: int = 64
    beyond: Array = field(default_factory=lambda: np.zeros(3))
    known: dict[object, Array] = field(default_factory=dict, repr=False, compare=False)
    work: Work = field(default_factory=Work, repr=False, compare=False)

    kind = "rendered"
    unit = "mm2 sr"  # of one over radiance at unit flux
    step_share = 1.0  # steps of finite differences over those that suit pictures with random errors

    @property
    def model(self) -> BaseModel:
        """Whose numbers can be freed, by their dotted paths: the design."""
        return self.design

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the components: the LED groups."""
        return self.design.group_names

    def lit(self, shot: Shot) -> Array:
        """Relative exposure of every component in a shot, (components,): of the groups that are on."""
        return shot.lit

    def usual(self, shots: Sequence[Shot]) -> tuple[str, ...]:
        """Return paths of the numbers that are free where nothing else is said.

        Length of kernel or skin and field of view; the modulus where a press tells its force; with a light
        probe, which tells light from reflectance, that too.
        """
        length = KERNEL if self.design.contact.model == "kernel" else SKIN
        found = [length, SCALE] if any(shot.press is not None for shot in shots) else []
        found += [MODULUS] if any(math.isfinite(shot.force_sigma_n) for shot in shots) else []
        albedo = self.design.optics.membrane_albedo
        probed = any(shot.ball is not None for shot in shots) and len(albedo) == len(self.names)
        return (*found, *(f"{ALBEDO}.{group}" for group in range(len(albedo)) if probed))

    def sees(self, path: str, shot: Shot) -> bool:
        """Whether a shot can depend on a number of the model.

        Light probes see no gel; an untouched gel does not know how it smooths an indentation.
        """
        if shot.ball is not None:
            return not path.startswith(("contact.", "elastomer.", "optics.membrane", "optics.coating"))
        return shot.press is not None or not path.startswith("contact.")

    def alone(self, path: str) -> int | None:
        """Return the only component that depends on a number; None where several do.

        It is the group whose reflectance or LEDs the path names.
        """
        parts = path.split(".")
        groups = len(self.names)
        own = parts[:2] == ["optics", "membrane_albedo"] and len(self.design.optics.membrane_albedo) == groups
        return int(parts[2]) if len(parts) > 2 and (own or parts[:2] == ["leds", "groups"]) else None

    def basis(
        self, changes: Mapping[str, float], touched: Touched, view: View, *, seed: int, how: How = "usual"
    ) -> Array:
        """Return pictures of the components, (components, rows, columns), after changes of the model.

        Where reflectances are free, they are made from pictures at two of them.
        Light that reaches the camera after n reflections by the membrane goes with the n-th power of its
        reflectance, so a picture over reflectance is a constant plus little that is almost linear in it. A
        line through two keeps the fit free of the noise that tracing the light anew for each would bring.
        """
        rest = {path: value for path, value in changes.items() if not path.startswith(ALBEDO)}
        if how == "unbiased":
            return self._picture(changes, touched, view, seed, how)
        if len(rest) == len(changes) or isinstance(touched, LightProbe):
            return self._picture(rest, touched, view, seed, how)
        given = np.array(self.design.per_group("membrane_albedo"))
        wanted = np.array(self.design.replace(changes).per_group("membrane_albedo"))
        brightest = min(BRIGHTEST, 1.0 - self.design.optics.coating_transmittance)
        nodes = [
            np.minimum(share * given, brightest * most) for share, most in zip(NODES, (0.9, 1.0), strict=True)
        ]

        def at(node: Array) -> Array:
            there = rest | {f"{ALBEDO}.{g}": float(a) for g, a in enumerate(node)}
            return self._picture(there, touched, view, seed, how) / node[:, None, None]

        factor, along = wanted[:, None, None], ((wanted - nodes[0]) / (nodes[1] - nodes[0]))[:, None, None]
        low = at(nodes[0])
        return np.asarray(factor * (low if how == "rough" else low + along * (at(nodes[1]) - low)))

    def _picture(
        self, changes: Mapping[str, float], touched: Touched, view: View, seed: int, how: How
    ) -> Array:
        def simulated() -> Array:
            design = self.design.replace(changes)
            if isinstance(touched, LightProbe):
                basis = light_probe(design, touched, view=view, samples=self.probe_samples, seed=seed).basis
            else:
                simulator = Simulator(
                    design,
                    view=view,
                    samples=UNBIASED_SAMPLES if how == "unbiased" else self.samples,
                    seed=seed,
                    estimator="reference" if how == "unbiased" else "fast",
                )
                if how == "fine":
                    simulator.pitch_mm /= 2
                basis = simulator.frame(touched).basis
            self.work.step()
            return basis.astype(float)

        key = (tuple(sorted(changes.items())), touched, view, seed, "usual" if how == "rough" else how)
        return remembered(self.known, key, simulated, most=MOST_KNOWN)

    def at(self, changes: Mapping[str, float]) -> "Rendered":
        """Return the model with changed numbers."""
        return replace(self, design=self.design.replace(changes), known={})

    def factors(self) -> Array:
        """Return factors of the model as given, (3, components): exposure x mixing x flux.

        Without a stated exposure that holds which the camera would choose.
        """
        exposure = self.design.fixed_exposure
        transfer = self.design.transfer_mw
        if exposure is None:
            untouched = Simulator(self.design, samples=self.samples, seed=0).frame(None).basis.astype(float)
            exposure = automatic_exposure(mixed(untouched, transfer))
        return np.asarray(transfer * exposure)

    def level(self) -> Array:
        """Return signal of the channels without light, (3,): the black level and what they have beyond it."""
        return self.beyond + self.design.camera.black_level

    def finished(
        self, changes: Mapping[str, float], factors: Array, level: Array, source: str
    ) -> SensorModel:
        """Return the calibrated model, with the name of the measurement it was found in.

        Products are put into fields: exposure stays as given, else total flux; columns of mixing reach 1.
        The camera has one black level, the mean; what channels have beyond it is the effect ``black_level``.
        """
        design = self.design.replace(changes)
        largest = factors.max(axis=0)
        flux = design.flux_mw
        shown = largest > 0
        chosen = float(largest.sum() / flux[shown].sum()) if shown.any() else 1.0
        exposure = design.fixed_exposure or chosen
        light: dict[str, object] = {
            f"leds.groups.{g}.flux_mw": float(largest[g] / exposure / (design.leds.groups[g].drive or 1.0))
            for g in np.flatnonzero(shown)
        }
        mixing = factors / np.where(shown, largest, 1.0)
        design = design.replace(
            {
                **light,
                "mixing": [[float(v) for v in row] for row in mixing],
                "camera.exposure": exposure / design.camera.gain,
                "camera.exposure_time_ms": None,
                "camera.black_level": float(np.clip(level.mean(), 0.0, MOST_LEVEL)),
            }
        )
        beyond = level - design.camera.black_level
        values = {channel: float(value) for channel, value in zip(CHANNELS, beyond, strict=True)}
        effect = AppliedEffect(name=BlackLevel.name, values=values, found_in=source)
        return SensorModel.of(design).with_effect(effect)
