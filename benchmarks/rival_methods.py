"""Ways from colour to slope that laboratories use and that Kernel and Polynomial are compared with."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from designlab.core.types import Array
from designlab.reconstruction.methods import LinearMethod, Predictor, Samples

TABLE_REACH = 2.5  # spreads of the colour change that the table covers


@dataclass(frozen=True)
class LookupTable(LinearMethod):
    """Lookup table over colour change alone, linear between its nodes, as the classical calibration.

    Attributes
    ----------
    nodes : int
        Nodes along each channel; an odd number has one at no change.
    """

    nodes: int = 9

    @property
    def name(self) -> str:
        """Name with the size."""
        return f"table of {self.nodes} nodes a channel"

    def terms(self, signal: Array, position: Array) -> Array:
        """Weights of the table's nodes, less those of no change."""
        return self._hats(signal) - self._hats(np.zeros((1, signal.shape[1])))

    def _hats(self, signal: Array) -> Array:
        at = (np.clip(signal / TABLE_REACH, -1, 1) + 1) / 2 * (self.nodes - 1)
        nodes = np.arange(self.nodes)
        product = np.ones((len(signal), 1))
        for channel in at.T:
            hat = np.maximum(0, 1 - np.abs(channel[:, None] - nodes))
            product = (product[:, :, None] * hat[:, None, :]).reshape(len(signal), -1)
        return product


@dataclass(frozen=True)
class Perceptron:
    """Multilayer perceptron on colour and position (scikit-learn).

    Attributes
    ----------
    hidden : tuple of int
        Neurons of each hidden layer.
    folds : int
        Left-out predictions come from this many fits, each without every so-manieth press.
    seed : int
        Of the starting weights and the order of the samples.
    """

    hidden: tuple[int, ...] = (32, 32, 32)
    folds: int = 4
    seed: int = 0

    @property
    def name(self) -> str:
        """Name with the layers."""
        return f"perceptron {self.hidden}"

    def fit(self, presses: Sequence[Samples]) -> Predictor:
        """Fit to all presses."""
        from sklearn.neural_network import MLPRegressor

        untouched = [press.position for press in presses]
        position = np.concatenate([press.position for press in presses] + untouched)
        signal = np.concatenate([press.signal for press in presses])
        slope = np.concatenate([press.slope for press in presses])
        # the untouched gel is taught as well: nothing in a perceptron makes it flat
        signal = np.concatenate([signal, np.zeros_like(signal)])
        slope = np.concatenate([slope, np.zeros_like(slope)])
        net: Any = MLPRegressor(
            hidden_layer_sizes=self.hidden, activation="tanh", alpha=1e-3, batch_size=500,
            learning_rate_init=3e-3, max_iter=40, tol=1e-6, random_state=self.seed,
        )  # fmt: skip
        import warnings

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a fixed number of rounds is meant
            net.fit(np.concatenate([signal, position], axis=1), slope)
        return lambda s, p: np.asarray(net.predict(np.concatenate([s, p], axis=1)), dtype=float)

    def fit_without_each(self, presses: Sequence[Samples]) -> list[Predictor]:
        """Fits that each know nothing of one press, nor of others of its fold."""
        folds = min(self.folds, len(presses))
        fits = [
            self.fit([press for k, press in enumerate(presses) if k % folds != fold]) for fold in range(folds)
        ]
        return [fits[k % folds] for k in range(len(presses))]
