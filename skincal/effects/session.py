"""A skin with effects: values for a whole session at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from skincal.effects.applied import Applied, Missing, applied, at_work
from skincal.effects.base import (
    InputEffect,
    LawEffect,
    MemoryEffect,
    SignalEffect,
    SpreadEffect,
    Stage,
    State,
)
from skincal.effects.samples import Samples
from skincal.effects.setting import Setting
from skincal.model import Pressures, Skin, Surface
from skincal.model.arrays import FloatArray, IntArray
from skincal.model.press.run import count_places


@dataclass(frozen=True, eq=False)
class Contacted:
    """What the contact made of samples: all that the later stages need, so that they can be done again without it.

    Attributes:
        samples: as the skin feels them, after effects on pose and force.
        loads_n: (K, J) loads on taxels as they are [N].
        pressures: loads point by point of some rows each; empty unless they were asked for.
        key: of the effects that took part.
    """

    samples: Samples
    loads_n: FloatArray
    pressures: tuple[tuple[IntArray, Pressures], ...]
    key: tuple[object, ...]


@dataclass(frozen=True, eq=False)
class EffectSkin:
    """A skin, and what it does beyond the base model.

    Values are those before the converter: neither rounded nor clipped nor noisy. An effect whose strengths are all
    neutral is left out; without any the values are bitwise those of the skin. Where the converter's range begins at
    rest (``value_min`` zero or more) effects with memory leave no signal below it.

    Attributes:
        skin: the base model.
        surface: that carries it.
        effects: in the order of the chain.
        missing: what to do where samples lack a covariate as a whole: ``error``, or the effect abstains. Where
            single samples lack it, the effect abstains in them.
    """

    skin: Skin
    surface: Surface
    effects: tuple[Applied, ...] = ()
    missing: Missing = "error"

    def __getstate__(self) -> dict[str, object]:
        """For another process: the key is made of identities, which are of this one."""
        return {name: own for name, own in self.__dict__.items() if name != "_front"}

    @classmethod
    def of(
        cls,
        skin: Skin,
        surface: Surface,
        effects: Mapping[str, Mapping[str, ArrayLike]],
        *,
        missing: Missing = "error",
    ) -> Self:
        """Return a skin with effects by name.

        Args:
            skin: the base model.
            surface: that carries it.
            effects: parameters by effect; what is left out is neutral or default.
            missing: see the attribute.

        Raises:
            InputError: unknown effects or parameters, or values out of bounds.
        """
        return cls(skin, surface, applied(effects, skin.patch.layout.taxels), missing)

    def with_effects(self, effects: Mapping[str, Mapping[str, ArrayLike]]) -> Self:
        """Return the same skin with other effects; what it has worked out of its geometry is kept."""
        other = replace(self, effects=applied(effects, self.skin.patch.layout.taxels))
        other.__dict__["setting"] = self.setting
        return other

    @cached_property
    def setting(self) -> Setting:
        """The skin's geometry."""
        return Setting(self.skin.patch, self.surface)

    @property
    def has_memory(self) -> bool:
        """Whether a value depends on earlier samples."""
        return any(a.effect.has_memory and not a.neutral for a in self.effects)

    @property
    def _no_tension(self) -> bool:
        """Whether taxels cannot read less than at rest, such as a resistance: their range begins there.

        What has crept away is then missing while nothing presses, but the signal is that at rest, with its noise.
        """
        least = self.skin.converter.value_min
        return least is not None and least >= 0

    @cached_property
    def _law_skin(self) -> Skin:
        """The skin with the law of an effect at the contact."""
        laws = [
            a.effect.law(a.values) for a in self.effects if isinstance(a.effect, LawEffect) and not a.neutral
        ]
        return replace(self.skin, law=laws[-1]) if laws else self.skin

    @cached_property
    def _weights(self) -> FloatArray | None:
        """What each taxel feels of each tactile point (N, J), if that is not just its own area."""
        for a in self.effects:
            if isinstance(a.effect, SpreadEffect) and not a.neutral:
                return a.effect.weights(a.values, self.skin.patch)
        return None

    @cached_property
    def _front(self) -> tuple[object, ...]:
        """Key of all that :meth:`contact` depends on but the samples."""
        early = [a.key for a in self.effects if a.effect.stage <= Stage.CONTACT and not a.neutral]
        return (id(self.skin.patch), self.skin.parameters.elasticity_pa_per_m, id(self.surface), *early)

    def values(self, samples: Samples) -> FloatArray:
        """Return the values (K, J) of the taxels over a session [counts].

        Args:
            samples: the session, in the order of time.

        Raises:
            InputError: an effect lacks a covariate, and that is an error.
        """
        return self.finish(self.contact(samples))

    def contact(self, samples: Samples, *, points: bool = False) -> Contacted:
        """Return the stages up to the contact: the slow part.

        Args:
            samples: the session.
            points: keep loads point by point, so that :meth:`finish` can spread them.
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

    def casts(self, contacted: Contacted) -> int:
        """How often, at most, :meth:`contact` sets an indenter down on the skin for samples like those: what it costs.

        Args:
            contacted: by this skin or one like it.
        """
        felt, count = contacted.samples, 0
        for number in range(len(felt.indenters)):
            rows = np.flatnonzero(felt.touching & (felt.indenter == number))
            count += count_places(felt.contacts[rows])
        return count

    def own(self, contacted: Contacted) -> Contacted:
        """Return a contact that a copy of this skin made, as in another process, as this one's."""
        return replace(contacted, key=self._front)

    def loads(self, contacted: Contacted) -> FloatArray:
        """Return the loads (K, J) that the taxels feel at once [N], after the spread.

        Raises:
            ValueError: the contact is that of another skin or of other effects, or lacks the tactile points.
        """
        if contacted.key != self._front:
            raise ValueError(
                "contacted: expected the contact of this skin and these effects; got that of others"
            )
        if self._weights is None:
            return contacted.loads_n
        loads = np.zeros_like(contacted.loads_n)
        if not contacted.pressures and contacted.samples.touching.any():
            raise ValueError("contacted: expected loads point by point; say points=True to contact()")
        for rows, pressures in contacted.pressures:
            loads[rows] = pressures.loads(self._weights)
        return loads

    def finish(self, contacted: Contacted) -> FloatArray:
        """Return values (K, J) [counts] from a contact, by the stages after it.

        Args:
            contacted: of :meth:`contact` of this skin, or of one that differs from it after the contact only: in the
                scale and in effects of later stages.
        """
        return self.after(self.loads(contacted), contacted.samples, {})

    def after(self, loads_n: FloatArray, samples: Samples, states: dict[int, State]) -> FloatArray:
        """Return values (K, J) [counts] from loads, by the stages from the memory on.

        Args:
            loads_n: (K, J) loads [N]; NaN where the contact is not known.
            samples: as the skin feels them.
            states: what effects remember, by their number; changed in place. Empty at the beginning of a session.
        """
        signal = loads_n
        remembering = at_work(self.effects, samples, MemoryEffect, self.missing)
        for number, effect, values in remembering:
            sure = np.logical_and.reduce(np.isfinite(signal), axis=1)
            before = states.get(number)
            if sure.all():
                signal, states[number] = effect.run(signal, samples, values, before)
                continue
            # What is not known is not remembered either: the next sample follows the one before.
            out = np.full_like(signal, np.nan)
            out[sure], states[number] = effect.run(signal[sure], samples[sure], values, before)
            signal = out
        if remembering and self._no_tension:
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
