"""What is known of fitted effects: how well, from what, and how far it holds."""

from collections.abc import Mapping, Sequence
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from designlab.core.types import Array
from designlab.simulation.contact.press import Press
from designlab.simulation.effects.base import EffectParameter
from geometries.spec import Spec, quantity

DRAWS = 4096  # after which a draw outside the bounds is moved to them
Range = tuple[float, float]


class Covariance(Spec):
    """Joint covariance of fitted values in their own units; of those that act by their square, of the square.

    A blur of width s for example stands for its variance s^2: that is what pictures are linear in, and its
    error stays finite where s is zero.
    """

    parameters: tuple[str, ...] = Field(description="Effect and parameter, with a dot between.")
    matrix: tuple[tuple[float, ...], ...] = Field(description="Covariance, in the order of the parameters.")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        size = len(self.parameters)
        if not size or len(self.matrix) != size or any(len(row) != size for row in self.matrix):
            raise ValueError(f"matrix: needs {size} rows and columns, one for each parameter")
        scaled = self._scaled()
        if not np.allclose(scaled, scaled.T, atol=1e-6) or np.linalg.eigvalsh(scaled).min() < -1e-6:
            raise ValueError("matrix: a covariance is symmetric and has no negative eigenvalues")
        return self

    def _scaled(self) -> Array:
        """Correlations: parameters have all sorts of units."""
        matrix = np.array(self.matrix)
        sd = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
        return np.asarray(matrix / np.outer(sd, sd))

    def of(self, names: Sequence[str]) -> Self | None:
        """Covariance of some of the parameters, whatever the others are; None if it has none of them."""
        places = [k for k, name in enumerate(self.parameters) if name in names]
        if not places:
            return None
        rows = tuple(tuple(self.matrix[i][k] for k in places) for i in places)
        return type(self)(parameters=tuple(self.parameters[k] for k in places), matrix=rows)

    def beside(self, other: "Covariance | None") -> "Covariance":
        """Both together, one independent of the other."""
        if other is None:
            return self
        mine, theirs = len(self.parameters), len(other.parameters)
        joint = np.zeros((mine + theirs, mine + theirs))
        joint[:mine, :mine], joint[mine:, mine:] = self.matrix, other.matrix
        return Covariance(
            parameters=self.parameters + other.parameters,
            matrix=tuple(tuple(float(v) for v in row) for row in joint),
        )

    def draw(
        self, parameters: Mapping[str, EffectParameter], values: Mapping[str, float], *, seed: int
    ) -> dict[str, float]:
        """Draw values from the normal distribution about given ones, cut off at the bounds.

        Parameters
        ----------
        parameters : mapping of str to EffectParameter
            Bounds, and which act by their square.
        values : mapping of str to float
            Centre of the distribution.
        seed : int
            Seed of the draw.
        """
        own = [parameters[name] for name in self.parameters]
        squared = np.array([p.squared for p in own])
        null = np.array([p.null for p in own])
        centre = np.array([values[name] for name in self.parameters])
        low, high = (np.array([getattr(p, end) for p in own]) for end in ("low", "high"))
        # A value that acts by its square is no further from null than its bounds, to either side.
        away = np.where(squared, (centre - null) ** 2, centre)
        least = np.where(squared, 0.0, low)
        most = np.where(squared, (high - null) ** 2, high)
        sd = np.sqrt(np.diag(np.array(self.matrix)))
        root = _root(self._scaled())
        random = np.random.default_rng(seed)
        for _ in range(DRAWS):
            drawn = away + sd * (root @ random.standard_normal(len(own)))
            if ((least <= drawn) & (drawn <= most)).all():
                break
        drawn = np.clip(drawn, least, most)
        found = np.where(squared, null + np.sqrt(np.maximum(drawn, 0.0)), drawn)
        return {name: float(v) for name, v in zip(self.parameters, np.clip(found, low, high), strict=True)}


def _root(matrix: Array) -> Array:
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


class Domain(Spec):
    """What the values were fitted to; beyond it the model is a guess."""

    depth_mm: Range = quantity(unit="mm", description="Shallowest and deepest press.")
    x_mm: Range = quantity(unit="mm", description="Leftmost and rightmost press.")
    y_mm: Range = quantity(unit="mm", description="Lowest and highest press.")
    probes: tuple[str, ...] = Field(description="Kinds of probe.")
    exposure: Range = quantity(unit="1", description="Shortest and longest relative exposure.")

    @classmethod
    def of(cls, presses: Sequence[Press], exposures: Sequence[float]) -> Self:
        """Return the smallest that holds presses of stated depth, and relative exposures."""
        depths = [press.stated_depth_mm for press in presses]
        x, y = ([press.centre_mm[axis] for press in presses] for axis in (0, 1))
        return cls(
            depth_mm=(min(depths), max(depths)),
            x_mm=(min(x), max(x)),
            y_mm=(min(y), max(y)),
            probes=tuple(sorted({press.probe.kind for press in presses})),
            exposure=(min(exposures), max(exposures)),
        )

    def left(self, presses: Sequence[Press]) -> list[str]:
        """Say in which ways presses lie outside."""
        found = []
        figures = {
            "deep": (self.depth_mm, [press.depth_mm for press in presses if press.depth_mm is not None]),
            "from the middle along x": (self.x_mm, [press.centre_mm[0] for press in presses]),
            "from the middle along y": (self.y_mm, [press.centre_mm[1] for press in presses]),
        }
        for what, ((low, high), values) in figures.items():
            beyond = [value for value in values if not low - 1e-9 <= value <= high + 1e-9]
            if beyond:
                found.append(
                    f"effects were fitted to presses {low:.3g} to {high:.3g} mm {what}; here "
                    f"{len(beyond)} of {len(values)} are not, from {min(beyond):.3g} to {max(beyond):.3g} mm"
                )
        if others := sorted({press.probe.kind for press in presses} - set(self.probes)):
            found.append(
                f"effects were fitted to presses of {', '.join(self.probes)}; here {', '.join(others)} "
                "is pressed"
            )
        return found


class Provenance(Spec):
    """Measurement and diagnosis that values come from."""

    measurement: str = Field(description="Name of the measurement.")
    measurement_digest: str = Field(description="SHA-256 of its files.")
    design: str = Field(description="Name of the design that was diagnosed.")
    design_digest: str = Field(description="Its digest.")
    verdict: str = Field(description="Verdict of the diagnosis.")
    gap: dict[str, dict[str, float]] = Field(
        description="Mean squared residual before, after and its floor, of train, select and final presses."
    )
    seed: int = Field(description="Seed of the diagnosis.")
    samples: int = Field(description="Samples per pixel and LED group.")
    version: str = Field(description="Version of designlab.")
    date: str = Field(description="Day of the diagnosis, ISO 8601.")
