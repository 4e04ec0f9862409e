"""Trains an estimator of the marble's place, and judges it on hands that it has not seen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skincal.envs.pinch import Pinch
from skincal.model.arrays import FloatArray
from skincal.ranges import Ranges
from skincal.ranges.plain import digest
from skincal.train.estimator import SPAN_M, Estimator, Quality, features, learn
from skincal.train.touches import Touches, draw_touches

HANDS = 1000
"""Hands that images are drawn from, unless another number is asked for."""
IMAGES = 60
"""Images of each hand."""
KEPT_BACK = 0.15
"""Share of the hands that the errors are stated on."""


def train_estimator(
    ranges: Ranges,
    pinch: Pinch,
    *,
    seed: int = 0,
    hands: int = HANDS,
    epochs: int = 40,
    progress: Callable[[str, int, int], None] = lambda *_: None,
) -> Estimator:
    """Draw hands, learns from most of them, and judges on the rest.

    Args:
        ranges: what is drawn.
        pinch: the hand.
        seed: of all randomness.
        hands: how many, the ones kept back among them; at least 10.
        epochs: passes over the images.
        progress: progress callback: a stage, how much of it is done, and of how much.
    """
    draws, learning = np.random.default_rng(seed).spawn(2)
    touches = draw_touches(
        ranges, pinch, hands, IMAGES, draws, lambda n: progress("images of drawn hands", n, hands)
    )
    back = max(1, round(KEPT_BACK * hands))
    taxels = touches.images_counts.shape[-1]
    images, places = (
        touches.images_counts[:-back].reshape(-1, taxels),
        touches.places_m[:-back].reshape(-1, 2),
    )
    network = learn(
        images, places, learning, epochs=epochs, progress=lambda n: progress("learning", n, epochs)
    )
    quality = judge(lambda seen: SPAN_M * network(features(seen)).astype(np.float64), touches, back)
    return Estimator(network, taxels, digest(ranges), seed, quality)


def judge(places_of: Callable[[FloatArray], FloatArray], touches: Touches, back: int) -> Quality:
    """Return the errors on the last hands, where the contact lies on the taxels.

    Args:
        places_of: places (N, 2) [m] of images (N, J).
        touches: images and places.
        back: number of hands at the end that count.
    """
    inside = touches.inside[-back:]
    images, true = touches.images_counts[-back:][inside], touches.places_m[-back:][inside]
    errors = np.linalg.norm(places_of(images) - true, axis=1)
    felt = np.maximum(np.nan_to_num(images), 0.0)
    centroids = felt @ touches.layout_centres_m / np.maximum(felt.sum(axis=1, keepdims=True), 1e-9)
    plain = np.linalg.norm(centroids - true, axis=1)
    median, p95 = np.quantile(errors, [0.5, 0.95])
    return Quality(len(errors), float(median), float(p95), float(np.median(plain)))
