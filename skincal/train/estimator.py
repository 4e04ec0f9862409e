"""Position of the marble from one tactile image: a small network, trained in simulation, run with numpy alone."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from skincal.bounded import MOST_TAXELS, decode, parse_json, read_arrays
from skincal.errors import input_error, text_of
from skincal.files import reason, whole_file
from skincal.model.arrays import FloatArray
from skincal.train.policy_file import Network

FORMAT: Final = "skincal-estimator/1"
SPAN_M: Final = 0.012
"""The network's outputs of -1 to 1 stand for so much to each side of the sensor's centre [m]."""
_COUNTS: Final = 50.0
_LEAST_COUNTS: Final = 20.0
"""Keeps the shares of an image finite where nothing is felt [counts]."""
_LARGEST_BYTES: Final = 10_000_000
_MOST_LAYERS: Final = 16


@dataclass(frozen=True)
class Quality:
    """Errors on hands that were not learned from, the marble's contact inside the patch.

    Attributes:
        median_m: median distance from the truth [m].
        p95_m: 95 % of the errors are below [m].
        centroid_median_m: the median of the images' centroids, for comparison [m].
    """

    images: int
    median_m: float
    p95_m: float
    centroid_median_m: float


@dataclass(frozen=True, eq=False)
class Estimator:
    """Places from images.

    Attributes:
        network: from features to places in parts of :data:`SPAN_M`.
        ranges_sha256: of the ranges that it was learned over.
        quality: on hands that were kept back.
    """

    network: Network
    taxels: int
    ranges_sha256: str
    seed: int
    quality: Quality

    def __call__(self, images_counts: ArrayLike) -> FloatArray:
        """Return places (..., 2) of the contact in patch coordinates [m].

        Args:
            images_counts: (..., J) counts above the level at rest; NaN counts as 0.
        """
        images = np.asarray(images_counts, dtype=np.float64)
        flat = self.network(features(images.reshape(-1, images.shape[-1])))
        return SPAN_M * flat.astype(np.float64).reshape(*images.shape[:-1], 2)


def features(images_counts: FloatArray) -> FloatArray:
    """Return inputs of the network (N, 2 J) for images (N, J): the counts, and each taxel's share of their sum."""
    counts = np.maximum(np.nan_to_num(images_counts), 0.0)
    return np.concatenate(
        [counts / _COUNTS, counts / (counts.sum(axis=1, keepdims=True) + _LEAST_COUNTS)], axis=1
    )


def learn(
    images_counts: FloatArray,
    places_m: FloatArray,
    rng: np.random.Generator,
    *,
    epochs: int = 60,
    width: int = 64,
    batch: int = 128,
    rate: float = 2e-3,
    progress: Callable[[int], None] = lambda _: None,
) -> Network:
    """Fit a perceptron with two hidden layers by Adam; the loss is the Huber loss, so that odd images count less.

    Args:
        images_counts: (N, J) above rest.
        places_m: (N, 2) true places.
        rng: first weights, and the order.
        epochs: passes over the data; the rate falls to zero along a cosine.
        width: of the hidden layers.
        batch: images in a step.
        rate: of learning, at first.
        progress: progress callback; gets the number of epochs that are done.
    """
    seen = features(images_counts)
    mean, variance = seen.mean(axis=0), seen.var(axis=0) + 1e-6
    x, y = (seen - mean) / np.sqrt(variance), places_m / SPAN_M
    sizes = (x.shape[1], width, width, 2)
    weights = [rng.normal(0.0, np.sqrt(2.0 / a), (a, b)) for a, b in pairwise(sizes)]
    parameters = [*weights, *(np.zeros(size) for size in sizes[1:])]
    first, second = ([np.zeros_like(p) for p in parameters] for _ in range(2))
    steps = epochs * (len(x) // batch)
    step = 0
    for epoch in range(epochs):
        order = rng.permutation(len(x))
        for start in range(0, len(x) - batch + 1, batch):
            rows = order[start : start + batch]
            step += 1
            now = rate * 0.5 * (1 + np.cos(np.pi * step / steps))
            for p, g, m, v in zip(
                parameters, _gradient(parameters, x[rows], y[rows]), first, second, strict=True
            ):
                m += 0.1 * (g - m)
                v += 1e-3 * (g * g - v)
                p -= now * (m / (1 - 0.9**step)) / (np.sqrt(v / (1 - 0.999**step)) + 1e-8)
        progress(epoch + 1)
    layers = [(parameters[i], parameters[i + 3]) for i in range(3)]
    return Network.build(mean, variance, 10.0, layers)


def _gradient(parameters: list[FloatArray], x: FloatArray, y: FloatArray) -> list[FloatArray]:
    """Return the gradient of the mean Huber loss by each parameter."""
    weights, biases = parameters[:3], parameters[3:]
    hidden = [x]
    for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
        hidden.append(np.maximum(hidden[-1] @ weight + bias, 0.0))
    out = np.tanh(hidden[-1] @ weights[-1] + biases[-1])
    # Beyond 0.6 mm the loss goes on as a straight line.
    back = np.clip(out - y, -0.05, 0.05) * (1 - out**2) / len(x)
    by_weight: list[FloatArray] = []
    by_bias: list[FloatArray] = []
    for layer in (2, 1, 0):
        by_weight.insert(0, hidden[layer].T @ back)
        by_bias.insert(0, back.sum(axis=0))
        back = (back @ weights[layer].T) * (hidden[layer] > 0)
    return by_weight + by_bias


def write_estimator(estimator: Estimator, path: Path, *, force: bool = False) -> None:
    """Write a file of plain numbers (``.npz``), whole or not at all."""
    network = estimator.network
    about = {
        "format": FORMAT,
        "taxels": estimator.taxels,
        "clip": network.clip,
        "layers": len(network.weights),
        "ranges_sha256": estimator.ranges_sha256,
        "seed": estimator.seed,
        "quality": asdict(estimator.quality),
    }
    arrays: dict[str, Any] = {
        "mean": network.mean,
        "scale": network.scale,
        "about": np.frombuffer(json.dumps(about).encode(), np.uint8),
    }
    arrays |= {f"weight_{i}": weight for i, weight in enumerate(network.weights)}
    arrays |= {f"bias_{i}": bias for i, bias in enumerate(network.biases)}
    with whole_file(path, force=force, mark=FORMAT) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)


def read_estimator(path: str | Path) -> Estimator:
    """Read what :func:`write_estimator` wrote; nothing in the file is code.

    Raises:
        InputError: the file cannot be read, or is something else.
    """
    try:
        arrays = read_arrays(Path(path), most=_LARGEST_BYTES)
        about = parse_json(decode(arrays["about"].tobytes()))
        if about["format"] != FORMAT:
            raise ValueError(f'the format "{about["format"]}"')
        count, taxels = int(about["layers"]), int(about["taxels"])
        if not 0 < taxels <= MOST_TAXELS or not 0 < count <= _MOST_LAYERS:
            raise ValueError(f"{count} layers and {taxels} taxels")
        network = Network(
            arrays["mean"],
            arrays["scale"],
            float(about["clip"]),
            tuple(arrays[f"weight_{i}"] for i in range(count)),
            tuple(arrays[f"bias_{i}"] for i in range(count)),
        )
        numbers = (network.mean, network.scale, np.array(network.clip), *network.weights, *network.biases)
        if not all(array.dtype.kind == "f" and np.isfinite(array).all() for array in numbers):
            raise ValueError("numbers that are not finite")
        if network(features(np.zeros((1, taxels)))).shape != (1, 2):
            raise ValueError("layers that do not fit")
        return Estimator(
            network, taxels, about["ranges_sha256"], int(about["seed"]), Quality(**about["quality"])
        )
    except (OSError, ArithmeticError, LookupError, TypeError, ValueError) as error:
        got = reason(error) if isinstance(error, OSError) else text_of(error)
        expected = f"an estimator ({FORMAT}), as `skincal train estimator` writes it"
        raise input_error(str(path), expected, got) from error
