"""The suites of the blind test: how many sessions of which kind. All is drawn from the seed of the test.

======== ==== =====================================================================================================
none      100 nothing hidden; elastic layers, which no fit of ours knows
decoy      60 nothing hidden, but something that misleads; both contact laws
one        12 an effect of the catalogue: six strengths, both contact laws
two        60 two effects of different classes
outside    64 something the catalogue does not have, eight kinds
poor       60 static sessions and such in raster order, with and without an effect
robust     36 glitches with an effect, taxels that jump together, taxels that die half-way
rest       88 sensors that rest between 8 and 60 counts and clip nowhere, count in steps of 1 to 8, with noise that
              may grow: a quarter with nothing hidden, one effect in the others
third      44 half spaces by the package ContactMechanics (`pip install ContactMechanics`), a law that nothing here
              knows: half with nothing hidden, one effect in the others
======== ==== =====================================================================================================

The classes are those of what a user would look for next: the *memory* of the skin, *drift* over the session, what
goes on *between* taxels, the *transfer* from load to counts, single *taxels*, and the *input*, what is measured of a
contact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from benchmarks.blind.truth.body import LAWS
from benchmarks.blind.truth.catalogue import EFFECTS
from benchmarks.blind.truth.decoys import DECOYS, FAULTS
from benchmarks.blind.truth.outside import OUTSIDE
from benchmarks.blind.truth.spec import Spec

CLASSES: Mapping[str, tuple[str, ...]] = {
    "memory": ("hysteresis", "creep", "rate", "latency", "first_cycle"),
    "drift": ("baseline_drift", "gain_drift"),
    "between": ("spread", "crosstalk", "ghosting"),
    "transfer": ("saturation", "dead_band", "response_curve", "stiffening", "cover"),
    "taxels": ("taxel_gain", "taxel_offset", "dead_taxel"),
    "input": ("shear", "force_bias", "contact_offset", "indenter_radius"),
}
CLASS_OF: Mapping[str, str] = {name: kind for kind, names in CLASSES.items() for name in names}

STRENGTHS = (0.2, 0.3, 0.4, 0.6, 0.9, 1.4)
TWO_STRENGTHS = (0.4, 0.6, 0.9, 1.3)
OUTSIDE_STRENGTHS = (0.5, 0.7, 1.0, 1.4)
POOR_STRENGTHS = (0.5, 0.8, 1.2)
WEAK = ("indenter_radius",)
"""Effects that hardly reach g = 0.4 by any size; not taken where two are hidden."""


def specs(suite: str, seed: int) -> list[Spec]:
    """The sessions of a suite."""
    rng = np.random.default_rng([seed, *suite.encode()])
    return SUITES[suite](rng, seed)


def _none(rng: np.random.Generator, seed: int) -> list[Spec]:
    del rng
    return [Spec("none", number, seed) for number in range(100)]


def _decoy(rng: np.random.Generator, seed: int) -> list[Spec]:
    del rng
    return [
        Spec("decoy", n, seed, law=LAWS[n // len(DECOYS) % 2], decoy=DECOYS[n % len(DECOYS)])
        for n in range(60)
    ]


def _one(rng: np.random.Generator, seed: int) -> list[Spec]:
    wanted = [(name, g, law) for name in EFFECTS for g in STRENGTHS for law in LAWS]
    order = rng.permutation(len(wanted))
    chosen = (wanted[k] for k in order)
    return [Spec("one", n, seed, law=law, effects=((name, g),)) for n, (name, g, law) in enumerate(chosen)]


def _two(rng: np.random.Generator, seed: int) -> list[Spec]:
    found: list[Spec] = []
    usable = [name for name in EFFECTS if name not in WEAK]
    for number in range(60):
        kinds = rng.choice(list(CLASSES), 2, replace=False)
        names = [str(rng.choice([n for n in usable if CLASS_OF[n] == kind])) for kind in kinds]
        effects = tuple((name, float(rng.choice(TWO_STRENGTHS))) for name in names)
        found.append(Spec("two", number, seed, law=LAWS[number % 2], effects=effects))
    return found


def _outside(rng: np.random.Generator, seed: int) -> list[Spec]:
    kinds = list(OUTSIDE)
    return [
        Spec(
            "outside",
            number,
            seed,
            law=LAWS[number // len(kinds) % 2],
            outside=(kinds[number % len(kinds)], float(rng.choice(OUTSIDE_STRENGTHS))),
        )
        for number in range(64)
    ]


def _poor(rng: np.random.Generator, seed: int) -> list[Spec]:
    found: list[Spec] = []
    names = list(EFFECTS)
    for number in range(60):
        protocol = ("static", "raster")[number % 2]
        # Every sixth of either kind has nothing hidden.
        hidden = () if number % 12 < 2 else ((str(rng.choice(names)), float(rng.choice(POOR_STRENGTHS))),)
        found.append(Spec("poor", number, seed, LAWS[number // 2 % 2], protocol, hidden))
    return found


def _robust(rng: np.random.Generator, seed: int) -> list[Spec]:
    found: list[Spec] = []
    plain = [name for name in EFFECTS if CLASS_OF[name] in ("memory", "between", "transfer")]
    for number in range(36):
        decoy = FAULTS[number % len(FAULTS)]
        hidden = ((str(rng.choice(plain)), 0.9),) if decoy == "glitches" else ()
        found.append(Spec("robust", number, seed, LAWS[number // 3 % 2], effects=hidden, decoy=decoy))
    return found


def _rest(rng: np.random.Generator, seed: int) -> list[Spec]:
    wanted = [((name, float(g)),) for name in EFFECTS for g in rng.choice(STRENGTHS, 3, replace=False)]
    hidden = [*(wanted[k] for k in rng.permutation(len(wanted))), *[()] * 22]
    order = rng.permutation(len(hidden))
    return [
        Spec(
            "rest",
            number,
            seed,
            law=LAWS[number % 2],
            effects=hidden[k],
            rest_counts=float(np.round(rng.uniform(8, 60), 2)),
            step_counts=int(rng.choice([1, 1, 2, 4, 8])),
            noise_grows=float(rng.choice([0.0, 0.0, 0.01, 0.025])),
        )
        for number, k in enumerate(order)
    ]


def _third(rng: np.random.Generator, seed: int) -> list[Spec]:
    wanted = [((name, float(rng.choice(STRENGTHS[2:]))),) for name in EFFECTS]
    hidden = [effect for k in rng.permutation(len(wanted)) for effect in ((), wanted[k])]
    return [Spec("third", number, seed, law="half_space", effects=e) for number, e in enumerate(hidden)]


SUITES: Mapping[str, Callable[[np.random.Generator, int], list[Spec]]] = {
    "none": _none,
    "decoy": _decoy,
    "one": _one,
    "two": _two,
    "outside": _outside,
    "poor": _poor,
    "robust": _robust,
    "rest": _rest,
    "third": _third,
}

SIZES: Mapping[str, int] = {suite: len(specs(suite, 0)) for suite in SUITES}
"""Sessions that a whole test has of each suite."""
