"""Effects that do nearly the same: what the equation of one is not quite right in must not be named as the other."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from skincal.gap.candidates import Scene, best_of
from skincal.gap.choice import Round
from skincal.gap.models import Material, Model, excess_of, finished, found_again, without

KINDS: tuple[frozenset[str], ...] = (
    frozenset({"spread", "crosstalk", "ghosting"}),
    frozenset({"hysteresis", "creep", "rate"}),
    frozenset({"saturation", "dead_band", "response_curve", "stiffening", "cover"}),
)
"""Effects of which one takes up what another's equation leaves over: signals that go to other taxels, memories that
fade, curves from load to counts."""


def of_one_kind(name: str, known: Collection[str]) -> bool:
    """Whether an effect is of a kind with others: equations for the same thing, each right for some skins."""
    return any(name in kind and not kind.isdisjoint(known) for kind in KINDS)


def likeness(scene: Scene, material: Material, first: Round, name: str, known: Sequence[str]) -> float:
    """The largest squared cosine of what an effect and others do, each as a round's search ended with it alone.

    Args:
        scene: of the model that the round began with: the base model, beside what was read off.
        material: the session.
        first: the round, the first that looked for something; what it did not search is searched.
        name: of the effect.
        known: names of the others.
    """
    views = scene.part(material.learn), scene.part(material.score)
    searched = {f.effect: f for f in first.found}
    of = {n: searched.get(n) or best_of(scene, n, *views) for n in (name, *known)}
    done = {n: views[0].seen(scene.bench.values(f.parameters) - scene.zero)[:, 0] for n, f in of.items() if f}
    if name not in done:
        return 0.0
    unit = {n: own / max(float(np.linalg.norm(own)), 1e-300) for n, own in done.items()}
    return max((float(unit[name] @ unit[n]) ** 2 for n in known if n in unit), default=0.0)


def instead(
    model: Model, kin: Collection[str], material: Material, most: float, null_mean: float
) -> Model | None:
    """A model without effects that are of a kind with its last one; None where it leaves too much then.

    One that was named before may have come nearest only as long as sensor and presses were not where they belong.

    Args:
        model: with all of them.
        kin: names of those to be dropped.
        material: the session.
        most: excess that it may leave.
        null_mean: mean square of a null session's residual.
    """
    for name in kin:
        model = without(model, name, material)
    model = finished(found_again(model, material), material)
    return model if excess_of(model, material, null_mean) <= most else None
