"""The base model about a session: fitted with every press's place, without what must not sway a verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from skincal.diagnose.prepare import SELECTION, TRAIN, Prepared, force_variance
from skincal.gap.law import law_directions
from skincal.gap.models import Material, Model, excess_of, scene_of
from skincal.gap.null import law_error
from skincal.gap.reading import Reading
from skincal.gap.refit import Refit, refit
from skincal.gap.relocate import relocated
from skincal.gap.robust import Dead, Jump, dead_taxels, glitches, jumps, without_jumps, without_presses
from skincal.gap.twin import twins_for
from skincal.model.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Base:
    """The base model about a session, and what must not sway a verdict taken out.

    Attributes:
        model: fitted to the presses that learn and choose.
        material: the session, split.
        glitches: rows of presses that were left out.
        dead: taxels that do not answer.
        jumps: of the level at rest, taken off.
    """

    model: Model
    material: Material
    glitches: IntArray
    dead: tuple[Dead, ...]
    jumps: tuple[Jump, ...]


def fit_base(ready: Prepared) -> Base:
    """Fits the base model, and again with the noise of the force, and without glitches and jumps."""
    known = ready.is_part(TRAIN, SELECTION)
    first = _first_look(ready, ready.reading)
    wild = glitches(first.slopes.residual, ready.reading.seen, ready.session.press)
    reading = without_presses(ready.reading, ready.session.press, wild)
    if len(wild):
        # They have drawn sensor and places after them: from the beginning, without them.
        first = _first_look(ready, reading)
    reading = reading.with_further(force_variance(first.hypothesis, ready.session, ready.force_noise_n))
    values = first.slopes.values
    dead = tuple(dead_taxels(values, reading, ready.session))
    jumped = tuple(jumps(values, reading, ready.session, list(dead)))
    reading = without_jumps(reading, ready.session, list(jumped))
    options = replace(ready.options, settle=0, steps=4)
    first = refit(first.hypothesis, ready.session, reading, options, learn=known, fixed=ready.known_effects)
    learn, score = ready.is_part(TRAIN), ready.is_part(SELECTION)
    material = Material(ready.session, reading, learn, score, ready.options)
    return Base(Model(first, (), ready.known_effects), material, wild, dead, jumped)


def _first_look(ready: Prepared, reading: Reading) -> Refit:
    """The base model's fit, with presses that it left in the wrong valley found again."""
    known, session = ready.is_part(TRAIN, SELECTION), ready.session
    first = refit(ready.start, session, reading, ready.options, learn=known, fixed=ready.known_effects)
    placed = relocated(first.hypothesis, session, reading, ready.options)
    if placed is first.hypothesis:
        return first
    options = replace(ready.options, settle=0, steps=2)
    return refit(placed, session, reading, options, learn=known, fixed=ready.known_effects)


def law_errors(base: Base, heard: Callable[[str], None]) -> dict[str, FloatArray]:
    """What each contact law leaves of the base model (N, J), whitened; the fitted one nothing."""
    hypothesis, material = base.model.hypothesis, base.material
    errors = {"fitted": np.zeros_like(base.model.refit.slopes.values)}
    for twin in twins_for(hypothesis, material.session):
        heard(f"null sessions: {twin.name}")
        errors[twin.name] = law_error(hypothesis, material, twin)
    return errors


def with_law(base: Base, errors: Mapping[str, FloatArray]) -> Base:
    """A base whose contact law may err as twins do."""
    law = law_directions(scene_of(base.model, base.material), base.material.known, list(errors.values()))
    return replace(base, material=replace(base.material, law=law))


def of_law(base: Base) -> float:
    """Root mean square of what the law's own error explains, in units of the noise."""
    without = excess_of(base.model, replace(base.material, law=None), 0.0)
    values = int((base.material.reading.seen & base.material.known[:, None]).sum())
    return float(np.sqrt(max(without - excess_of(base.model, base.material, 0.0), 0.0) / values))
