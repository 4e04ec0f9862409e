"""Checks that the force sensors answer contact, so that no rig presses on blindly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skincal.dataset import ACTIVE_COUNTS, DatasetMeta
from skincal.errors import WorkError
from skincal.model.arrays import FloatArray

BLIND_M, BLIND_S = 0.5e-3, 0.05
"""Largest way into the skin without any growth of the force, for a skin as soft as can be and slow force sensors: the
way itself, and the time at the indenter's speed [m, s]."""

NEGATIVE = 5.0
"""Force below zero that no offset or noise of the sensors explains, relative to the force that counts as contact."""

NEGATIVE_PERIODS = 3
"""Number of periods in a row with such a force; outliers are single."""

AWAY = 2.0
"""Response of a touched taxel, relative to its largest deviation in free motion."""


class ForceGrowth:
    """Check that the force grows on the way into the skin.

    Args:
        sensor: name of the force sensors, for the error.
        contact_n: force that counts as contact [N].
        blind_m: largest way without growth [m].
    """

    def __init__(self, sensor: str, contact_n: float, blind_m: float) -> None:
        self._sensor, self._contact_n, self._blind_m = sensor, contact_n, blind_m
        self.start()

    def start(self) -> None:
        """Start the way at the next position."""
        self._most_n, self._there_m = -np.inf, np.nan

    def check(self, force_n: float, height_m: float) -> None:
        """Check the force [N] at the next height of the indenter [m].

        Raises:
            WorkError: the force has not grown for too long a way.
        """
        if force_n > self._most_n + self._contact_n / 2:
            # The indenter only goes down: a greater height is an outlier.
            self._most_n, self._there_m = force_n, np.fmin(self._there_m, height_m)
        if (way_m := self._there_m - height_m) > self._blind_m:
            raise WorkError(
                f"{self._sensor}: expected a force that grows on a way of {1e3 * way_m:.3g} mm into the skin; it "
                f"stayed at {force_n:.3g} N. Check the {self._sensor}: connection, unit, and values that stand still."
            )


class ApproachCheck:
    """Check of an approach: where taxels respond and the skin must be, the force grows, and it is never negative.

    Taxels alone are not enough, as magnetic and capacitive skins may respond to an indenter above them.

    Args:
        sensor: name of the force sensors, for errors.
        meta: of the rig: the sensor, and how far measured positions may err.
        free: taxel values (J,) in free motion, image by image.
        contact_n: force that counts as contact [N].
        blind_m: largest way into the skin without growth of the force [m].
        positive: what a positive reading means, for the error.
    """

    def __init__(
        self,
        sensor: str,
        meta: DatasetMeta,
        free: Sequence[FloatArray],
        contact_n: float,
        blind_m: float,
        positive: str,
    ) -> None:
        self._sensor, self._positive = sensor, positive
        self._lowest_m, self._negative_n = -meta.position.sigma_m, -NEGATIVE * contact_n
        self._growth, self._negatives = ForceGrowth(sensor, contact_n, blind_m), 0
        images = np.array(free, dtype=np.float64)
        self._rest = np.median(images, axis=0)
        least = ACTIVE_COUNTS if meta.sensor.unit == "counts" else 0.0
        self._away = np.maximum(least, AWAY * np.abs(images - self._rest).max(axis=0))

    def check(self, force_n: float, height_m: float, taxels: FloatArray) -> None:
        """Check the force [N] and the taxels (J,) at the next height above the nominal skin [m].

        Raises:
            WorkError: the force is negative, or does not answer contact.
        """
        self._negatives = self._negatives + 1 if force_n < self._negative_n else 0
        if self._negatives >= NEGATIVE_PERIODS:
            raise WorkError(
                f"{self._sensor}: expected a positive force where the indenter presses; got {force_n:.3g} N at "
                f"{1e3 * height_m:.3g} mm above the nominal skin. The sign is wrong: {self._positive}."
            )
        if height_m > self._lowest_m or not (np.abs(taxels - self._rest) > self._away).any():
            self._growth.start()
        self._growth.check(force_n, height_m)
