"""A policy as bare numbers: normalisation, layers, and what they compute."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float32]

EPSILON = 1e-8
"""Added to a variance before its root is taken, as in training."""


@dataclass(frozen=True, eq=False)
class Network:
    """A perceptron with normalised inputs, ReLU between its layers, and tanh at its end.

    The action is the mean of the learned distribution; nothing random is left.

    Attributes:
        mean: of each observation value, shape (O,).
        scale: one over its standard deviation, shape (O,).
        clip: normalised observations are cut off here.
        weights: of the layers, shapes (inputs, outputs).
        biases: of the layers, shapes (outputs,).
    """

    mean: Array
    scale: Array
    clip: float
    weights: tuple[Array, ...]
    biases: tuple[Array, ...]

    @classmethod
    def build(
        cls, mean: ArrayLike, variance: ArrayLike, clip: float, layers: Sequence[tuple[ArrayLike, ArrayLike]]
    ) -> Network:
        """Make one from running statistics and (weight, bias) of the layers."""
        variance = np.asarray(variance, dtype=np.float64)
        return cls(
            _frozen(mean),
            _frozen(1.0 / np.sqrt(variance + EPSILON)),
            float(clip),
            tuple(_frozen(weight) for weight, _ in layers),
            tuple(_frozen(bias) for _, bias in layers),
        )

    @property
    def observations(self) -> int:
        """Length O of an observation."""
        return len(self.mean)

    @property
    def actions(self) -> int:
        """Length A of an action."""
        return len(self.biases[-1])

    def __call__(self, observation: ArrayLike) -> Array:
        """Return the actions (N, A) in [-1, 1] for observations (N, O)."""
        x = np.clip((np.asarray(observation, np.float32) - self.mean) * self.scale, -self.clip, self.clip)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = np.maximum(x @ weight + bias, np.float32(0.0))
        return np.tanh(x @ self.weights[-1] + self.biases[-1])


def _frozen(values: ArrayLike) -> Array:
    array = np.array(values, dtype=np.float32)
    array.setflags(write=False)
    return array
