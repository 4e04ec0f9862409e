"""Train an estimator of the marble's position, and evaluate it on other hands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.envs.bodies import body_of
from skincal.envs.drawing import Drawer
from skincal.envs.pinch import Pinch
from skincal.envs.tactile import SkinContact, TactileSkin, drawn_age_s
from skincal.envs.trajectories import POLICY_HZ, wander
from skincal.envs.world import Sensor
from skincal.model.arrays import FloatArray
from skincal.ranges import Ranges
from skincal.ranges.files import digest
from skincal.train.estimator import SPAN_M, Estimator, Quality, features, learn

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
    """Draw hands, train on most of them, and evaluate on the rest."""
    draws, learning = np.random.default_rng(seed).spawn(2)
    touches = draw_touches(
        ranges, pinch, hands, IMAGES, draws, lambda n: progress("images of drawn hands", n, hands)
    )
    back = max(1, round(KEPT_BACK * hands))
    taxels = touches.images_counts.shape[-1]
    images = touches.images_counts[:-back].reshape(-1, taxels)
    places = touches.places_m[:-back].reshape(-1, 2)
    network = learn(
        images, places, learning, epochs=epochs, progress=lambda n: progress("learning", n, epochs)
    )
    quality = judge(lambda seen: SPAN_M * network(features(seen)).astype(np.float64), touches, back)
    return Estimator(network, taxels, digest(ranges), seed, quality)


def judge(places_of: Callable[[FloatArray], FloatArray], touches: Touches, back: int) -> Quality:
    """Return the errors on the last hands, where the contact lies on the taxels."""
    inside = touches.inside[-back:]
    images, true = touches.images_counts[-back:][inside], touches.places_m[-back:][inside]
    errors = np.linalg.norm(places_of(images) - true, axis=1)
    felt = np.maximum(np.nan_to_num(images), 0.0)
    centroids = felt @ touches.layout_centres_m / np.maximum(felt.sum(axis=1, keepdims=True), 1e-9)
    plain = np.linalg.norm(centroids - true, axis=1)
    median, p95 = np.quantile(errors, [0.5, 0.95])
    return Quality(len(errors), float(median), float(p95), float(np.median(plain)))


FORCE_N = (0.8, 3.0)
"""Normal forces of the touches, as policies hold the marble [N]."""
SHEAR_N = 0.3
"""Standard deviation of tangential forces [N]."""
HALF_M = 8e-3
"""Half the width of the box in which the marble goes [m]."""
_HOLDING = 10
"""Images from one force to the next."""
_RESTING = 10
"""Images of which the level at rest is the mean."""


@dataclass(frozen=True, eq=False)
class Touches:
    """Images above rest and true places, of H hands with T images each.

    Attributes:
        images_counts: (H, T, J) [counts].
        places_m: (H, T, 2) patch coordinates of the contact [m].
        layout_centres_m: (J, 2) of the taxels [m].
        half_m: (2,) half the extent of the taxels, from edge to edge [m].
    """

    images_counts: FloatArray
    places_m: FloatArray
    layout_centres_m: FloatArray
    half_m: FloatArray

    @property
    def inside(self) -> NDArray[np.bool_]:
        """(H, T) whether the contact lies on the taxels."""
        return np.all(np.abs(self.places_m) <= self.half_m, axis=2)


def draw_touches(
    ranges: Ranges,
    pinch: Pinch,
    hands: int,
    each: int,
    rng: np.random.Generator,
    progress: Callable[[int], None] = lambda _: None,
) -> Touches:
    """Let a marble wander over the skins of drawn hands, at forces that change."""
    skin = TactileSkin(pinch)
    drawer = Drawer(ranges, "marble", pinch, skin.taxels)
    images, places = np.zeros((hands, each, skin.taxels)), np.zeros((hands, each, 2))
    for hand in range(hands):
        values, sample = drawer.episode(rng)
        body = body_of("marble", values)
        pose = Sensor.of(pinch, values).pose
        skin.begin(values, pose, body, drawn_age_s(rng))
        # A hand's clock ticks alike at rest and under load: what has memory remembers.
        noise = [
            np.asarray(drawer.step(rng, sample).get("skin.taxel_noise_counts", 0.0))
            for _ in range(_RESTING + each)
        ]
        rest = np.mean([skin.image(None, k / POLICY_HZ, noise[k]) for k in range(_RESTING)], axis=0)
        way = wander(rng, each, HALF_M) + rng.uniform(-1.0, 1.0, 2) * HALF_M / 4
        points, normals = pinch.surface.wrap(pose, way)
        low, high = np.log(FORCE_N)
        knots = np.arange(0, each + _HOLDING, _HOLDING)
        force = np.exp(np.interp(np.arange(each), knots, rng.uniform(low, high, len(knots))))
        for k in range(each):
            contacts = body.contacts(
                points[k], normals[k], float(force[k]), points[k] + body.radius_m * normals[k], np.eye(3)
            )
            felt = SkinContact(contacts, *rng.normal(0.0, SHEAR_N, 2).tolist())
            images[hand, k] = skin.image(felt, (_RESTING + k) / POLICY_HZ, noise[_RESTING + k]) - rest
        places[hand] = way
        progress(hand + 1)
    layout = skin.layout
    half = (np.abs(layout.centres_m) + layout.sizes_m / 2).max(axis=0)
    return Touches(images, places, layout.centres_m, half)
