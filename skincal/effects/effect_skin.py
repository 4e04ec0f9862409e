"""A skin with effects: the values of a whole session at once, or sample by sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from skincal.effects.effect import (
    InputEffect,
    LawEffect,
    MemoryEffect,
    SignalEffect,
    SpreadEffect,
    Stage,
    State,
)
from skincal.effects.registry import Applied, Missing, applied, at_work
from skincal.effects.samples import Samples, Setting
from skincal.model import Pressures, Skin, Surface
from skincal.model.arrays import FloatArray, IntArray
from skincal.model.skin import spread_weights


@dataclass(frozen=True, eq=False)
class Contacted:
    """Result of the contact stage for some samples, from which the later stages can be repeated.

    Attributes:
        samples: samples as the skin feels them, after effects on pose and force.
        loads_n: (K, J) loads on taxels before the spread [N].
        pressures: loads per tactile point, in blocks of rows; empty unless requested.
        key: key of the effects that took part.
    """

    samples: Samples
    loads_n: FloatArray
    pressures: tuple[tuple[IntArray, Pressures], ...]
    key: tuple[object, ...]


@dataclass(frozen=True, eq=False)
class EffectSkin:
    """A skin with its effects beyond the base model.

    Values are those before the converter: neither rounded nor clipped nor noisy. An effect whose strengths are all
    neutral is skipped; without effects the values are bitwise those of the skin. Where the converter's range begins at
    rest (``value_min`` zero or more) effects with memory leave no signal below it.

    Attributes:
        skin: the base model.
        effects: effects in the order of the chain.
        missing: policy if all samples lack a covariate: ``error``, or the effect abstains. If
            single samples lack it, the effect abstains in them.
    """

    skin: Skin
    surface: Surface
    effects: tuple[Applied, ...] = ()
    missing: Missing = "error"

    @classmethod
    def of(
        cls,
        skin: Skin,
        surface: Surface,
        effects: Mapping[str, Mapping[str, ArrayLike]],
        *,
        missing: Missing = "error",
    ) -> Self:
        """Return a skin with effects by name: parameters by effect; omitted ones are neutral or default.

        Raises:
            InputError: unknown effects or parameters, or values out of bounds.
        """
        return cls(skin, surface, applied(effects, skin.patch.layout.taxels), missing)

    def with_effects(self, effects: Mapping[str, Mapping[str, ArrayLike]]) -> Self:
        """Return the same skin with other effects; cached results of its geometry are shared."""
        other = replace(self, effects=applied(effects, self.skin.patch.layout.taxels))
        other.__dict__["setting"] = self.setting
        return other

    @cached_property
    def setting(self) -> Setting:
        """The geometry of the skin."""
        return Setting(self.skin.patch, self.surface)

    @property
    def has_memory(self) -> bool:
        """True if a value depends on earlier samples."""
        return any(a.effect.has_memory and not a.neutral for a in self.effects)

    @cached_property
    def _law_skin(self) -> Skin:
        """The skin with an effect's stress law at the contact."""
        skin = self.skin
        for a in self.effects:
            if isinstance(a.effect, LawEffect) and not a.neutral:
                skin = replace(skin, law=a.effect.law(a.values))
        return skin

    @cached_property
    def _weights(self) -> FloatArray | None:
        """Weight of each tactile point in each taxel (N, J); None if a taxel feels what the skin says."""
        patch = self.skin.patch
        for a in self.effects:
            if isinstance(a.effect, SpreadEffect) and not a.neutral:
                found = a.effect.weights(a.values, patch)
                variance = 0.0 if self.skin.contact is None else self.skin.contact.spread_m2
                # Both are small beside the contact: what the contact law adds is what it adds alone.
                return (
                    found + spread_weights(patch, variance) - spread_weights(patch, 0.0)
                    if variance
                    else found
                )
        return None

    @cached_property
    def _front(self) -> tuple[object, ...]:
        """Key of everything except the samples that :meth:`contact` depends on."""
        early = [a.key for a in self.effects if a.effect.stage <= Stage.CONTACT and not a.neutral]
        skin = self.skin
        return (skin.patch, skin.parameters.elasticity_pa_per_m, skin.contact, self.surface, *early)

    def values(self, samples: Samples) -> FloatArray:
        """Return the values of the taxels over a session (K, J) [counts].

        Raises:
            InputError: an effect lacks a covariate, and ``missing`` makes that an error.
        """
        return self.finish(self.contact(samples))

    def contact(self, samples: Samples, *, points: bool = False) -> Contacted:
        """Return the result of the stages up to the contact, the slow part.

        Args:
            samples: samples of the session.
            points: keep loads per tactile point, so that :meth:`finish` can spread them.
        """
        felt = samples
        for _, effect, values in at_work(self.effects, samples, InputEffect, self.missing):
            felt = effect.apply(felt, values, self.setting)
        loads = np.zeros((len(samples), self.skin.patch.layout.taxels))
        pressures: list[tuple[IntArray, Pressures]] = []
        for number, indenter in enumerate(felt.indenters):
            rows = np.flatnonzero(felt.touching & (felt.indenter == number))
            if not len(rows):
                continue
            contacts = felt.contacts[rows]
            if points or self._weights is None:
                loads[rows] = self._law_skin.loads(indenter, contacts)
            if points or self._weights is not None:
                pressures.append((rows, self._law_skin.pressures(indenter, contacts)))
        return Contacted(felt, loads, tuple(pressures), self._front)

    def loads(self, contacted: Contacted) -> FloatArray:
        """Return the loads that the taxels feel at once, after the spread (K, J) [N].

        Raises:
            ValueError: the contact belongs to another skin or other effects, or lacks the tactile points.
        """
        if contacted.key != self._front:
            raise ValueError(
                "contacted: expected the contact of this skin and these effects; got that of others"
            )
        if self._weights is None:
            return contacted.loads_n
        loads = np.zeros_like(contacted.loads_n)
        if not contacted.pressures and contacted.samples.touching.any():
            raise ValueError("contacted: expected loads per tactile point; call contact() with points=True")
        for rows, pressures in contacted.pressures:
            loads[rows] = pressures.loads(self._weights)
        return loads

    def finish(self, contacted: Contacted) -> FloatArray:
        """Return the values (K, J) [counts] of a contact, by the stages after it.

        Args:
            contacted: result of :meth:`contact` of this skin, or of one that differs only after the contact: in the
                scale and in effects of later stages.
        """
        return self.after(self.loads(contacted), contacted.samples, {})

    def after(self, loads_n: FloatArray, samples: Samples, states: dict[int, State]) -> FloatArray:
        """Return the values (K, J) [counts] of loads, by the stages from the memory on.

        Args:
            loads_n: (K, J) loads [N]; NaN where the contact is unknown.
            samples: samples as the skin feels them.
            states: states of effects with memory, by index; changed in place. Empty at the start of a session.
        """
        signal = loads_n
        remembering = at_work(self.effects, samples, MemoryEffect, self.missing)
        for number, effect, values in remembering:
            sure = np.logical_and.reduce(np.isfinite(signal), axis=1)
            before = states.get(number)
            if sure.all():
                signal, states[number] = effect.run(signal, samples, values, before)
                continue
            # Unknown loads are not remembered: the next sample follows the last known one.
            out = np.full_like(signal, np.nan)
            out[sure], states[number] = effect.run(signal[sure], samples[sure], values, before)
            signal = out
        least = self.skin.converter.value_min
        if remembering and least is not None and least >= 0:
            # Taxels whose range begins at rest, such as resistances, cannot read less: signal that has crept away is
            # missing while nothing presses.
            signal = np.maximum(signal, 0.0)
        later = at_work(self.effects, samples, SignalEffect, self.missing)
        for _, effect, values in later:
            if effect.stage == Stage.TRANSFER:
                signal = effect.apply(signal, samples, values, self.setting)
        signal = signal * self.skin.parameters.scale_per_n
        for _, effect, values in later:
            if effect.stage > Stage.TRANSFER:
                signal = effect.apply(signal, samples, values, self.setting)
        return signal

    def image(self, samples: Samples) -> FloatArray:
        """Return the tactile images (K, J) [counts], through the converter."""
        return self.skin.converter.apply(self.values(samples))


class SkinStream:
    """A session of a skin in progress; the values equal those of :meth:`EffectSkin.values` for the whole session.

    This is the only mutable object of the package: it holds the states of the effects.
    """

    def __init__(self, skin: EffectSkin) -> None:
        """Start a session."""
        self.skin = skin
        for one in skin.effects:
            if isinstance(one.effect, MemoryEffect):
                one.effect.prepare()
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
