"""A skin with effects, sample by sample, for a simulated hand or an environment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.effects.effect import State
from skincal.effects.effect_skin import EffectSkin
from skincal.effects.samples import Samples
from skincal.model.arrays import FloatArray


class SkinStream:
    """A session of a skin in progress; the values equal those of :meth:`EffectSkin.values` for the whole session.

    This is the only mutable object of the package: it holds the states of the effects.
    """

    def __init__(self, skin: EffectSkin) -> None:
        """Start a session."""
        self.skin = skin
        self.reset()

    def reset(self) -> None:
        """Start another session: nothing has touched the skin yet, and drifts count from the next sample."""
        self._states: dict[int, State] = {}
        self._start_s = float("nan")
        self._now_s = -np.inf

    def step(self, samples: Samples) -> FloatArray:
        """Return the values (K, J) [counts] of the next samples; usually one.

        Raises:
            ValueError: the samples precede those of the last step.
            InputError: an effect lacks a covariate, and ``missing`` makes that an error.
        """
        if samples.time_s is not None and len(samples):
            if samples.time_s[0] < self._now_s:
                raise ValueError(
                    f"samples time_s: expected {self._now_s:g} s or later; got {samples.time_s[0]:g} s"
                )
            if np.isnan(self._start_s):
                self._start_s = samples.start_s
            self._now_s = float(samples.time_s[-1])
            samples = replace(samples, start_s=self._start_s)
        contacted = self.skin.contact(samples)
        return self.skin.after(self.skin.loads(contacted), contacted.samples, self._states)
