"""What a session says of its sensor: the base model, null sessions, the effects that are named, and the verdict.

Presses that are out of all proportion are left out. An effect that is steep in place or time shows in few presses,
and those are the first to be left out then. So where others differ as well and are not explained, the session is
asked again with all its presses. That answer counts if effects are named that explain the doubted presses, too, or if
it is "unknown" and the first one "none".
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skincal.diagnose.base_fit import Base, explains, fit_base_and_law, may_be_effect, of_law
from skincal.diagnose.cache import Cache
from skincal.diagnose.diagnosis import Verdict
from skincal.diagnose.kept import Kept
from skincal.diagnose.options import DiagnoseOptions
from skincal.diagnose.prepare import OFFSET, Prepared
from skincal.diagnose.second_look import heard_again, silent_beside, taken_back
from skincal.gap.candidates import Scene, Start
from skincal.gap.choice import Choice
from skincal.gap.choose import choose
from skincal.gap.contest import Heard
from skincal.gap.dying import NAME as DEAD_TAXEL
from skincal.gap.dying import dead_start, with_silent
from skincal.gap.library import Library
from skincal.gap.models import scene_of
from skincal.gap.null import Null
from skincal.gap.places import with_places
from skincal.gap.signatures import Signature, signature_columns, signature_falls
from skincal.gap.silent import Silent, without_silent
from skincal.model import TaxelLayout
from skincal.model.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Answer:
    """What a session says.

    Attributes:
        base: the base model about it.
        null: sessions in which nothing is missing.
        choice: the effects that are named.
        signatures: on what the residual depends, strongest first.
        verdict: as of a diagnosis.
        unexplained: whether something significant is left beside what was named.
        doubted: rows of presses that had been left out at first.
        seen_only: whether all that is named are taxels that were seen to fall silent.
    """

    base: Base
    null: Null
    choice: Choice
    signatures: tuple[Signature, ...]
    verdict: Verdict
    unexplained: bool
    doubted: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    seen_only: bool = False


@dataclass(frozen=True, eq=False)
class Question:
    """A session that is asked, and how.

    Attributes:
        ready: the session.
        layout: of its taxels.
        options: settings.
        seed: of all chance.
        cache: of what was worked out before.
        heard: told which stage begins.
    """

    ready: Prepared
    layout: TaxelLayout
    options: DiagnoseOptions
    seed: int
    cache: Cache
    heard: Heard

    def answer(self, rng: np.random.Generator) -> Answer:
        """What the session says, without glitches, or with all presses if those may be an effect."""
        whole = rng.spawn(1)[0]
        base, errors = self._base()
        # Other processes begin with it before it is known whether it is needed; without any, it waits until then.
        with_all = self._ahead(whole) if may_be_effect(base) else None
        first = self._answer(base, errors, rng)
        if first.choice.named and (late := silent_beside(first.base, first.choice.after)):
            self.heard("again, without taxels that fell silent")
            first = self._answer(*self._base(late=late), rng)
        if with_all is None or (first.verdict == "effects" and not first.unexplained):
            return with_what_was_seen(first)
        self.heard("again, with all presses")
        again = replace(next(with_all), doubted=base.glitches)
        if again.verdict == "effects" and explains(again.choice.after, again.base, base.glitches):
            return with_what_was_seen(again)
        # What glitches do is not to be named, nor to take away what is.
        other = first.verdict == "none" and again.verdict == "unknown"
        return with_what_was_seen(again if other else first)

    def _ahead(self, rng: np.random.Generator) -> Iterator[Answer]:
        """The answer of all presses: begun at once by another process or, where there is none, when it is asked for."""
        spread = self.ready.options.mapper
        if spread is map:
            return map(self._with_all, [(self, rng)])
        ready = replace(self.ready, options=self.ready.options.alone)
        return map(self._here, spread(self._with_all, [(replace(self, ready=ready, heard=_unheard), rng)]))

    @staticmethod
    def _with_all(task: tuple[Question, np.random.Generator]) -> Answer:
        question, rng = task
        return question._answer(*question._base(leave_out=False), rng)

    def _here(self, answer: Answer) -> Answer:
        """An answer of another process, to be gone on with in this one."""
        base = answer.base
        options = replace(base.material.options, mapper=self.ready.options.mapper)
        return replace(answer, base=replace(base, material=replace(base.material, options=options)))

    def _base(
        self, *, leave_out: bool = True, late: Sequence[Silent] = ()
    ) -> tuple[Base, dict[str, FloatArray]]:
        self.heard("base model")
        return fit_base_and_law(self.ready, self.heard, leave_out=leave_out, late=late)

    def _answer(self, base: Base, errors: Mapping[str, FloatArray], rng: np.random.Generator) -> Answer:
        drawn, swapped = rng.spawn(2)
        ready, heard = self.ready, self.heard
        scene = scene_of(base.model, base.material)
        heard("sensitivities of the effects")
        library = Library.of(scene)
        signs = signature_columns(base.model.refit.slopes, ready.session, self.layout)
        columns = {name: own for name, (_, own) in signs.items()}
        heard("null sessions: scores")
        kept = Kept(self.cache, base.model, base.material, self.seed)
        null = kept.null(scene, library, errors, self.options.null_draws, drawn, columns)
        start = dead_start(scene.bench, base.dead)
        extra: dict[str, Start] = {} if start is None else {DEAD_TAXEL: start}
        choice = choose(
            base.model,
            base.material,
            library,
            null.p_value,
            null.mean_square,
            self.options.choice,
            extra=extra,
            heard=heard,
            plain=_read_off(base, ready),
            law=of_law(base),
            fresh=ready.start if ready.options.base else None,
        )
        heard("places")
        choice = with_places(choice, base.material, list(errors.values()), null.mean_square, swapped)
        told = _signatures(scene, base, null, signs, self.options.choice.least(choice.values, choice.law))
        verdict, unexplained = judged(choice, null, told, self.options)
        return Answer(base, null, choice, told, verdict, unexplained)


def with_what_was_seen(answer: Answer) -> Answer:
    """An answer with taxels that were seen to fall silent, and with presses that were no glitches after all.

    What else is there is judged without them.
    """
    answer = _with_silent(answer)
    if answer.verdict != "effects":
        return answer
    base, choice = taken_back(answer.base, answer.choice)
    return replace(answer, base=base, choice=choice)


def _with_silent(answer: Answer) -> Answer:
    base = heard_again(answer.base, answer.choice.after)
    choice = with_silent(answer.choice, base.silent, base.material, answer.null)
    if choice is answer.choice:
        # Nothing explains what silent taxels read: it stays left out.
        m = base.material
        quiet = replace(m, reading=without_silent(m.reading, base.silent, m.session))
        return replace(answer, base=replace(base, material=quiet))
    verdict = "effects" if answer.verdict == "none" else answer.verdict
    only = len(choice.named) == 1
    return replace(
        answer, base=replace(base, model=choice.before), choice=choice, verdict=verdict, seen_only=only
    )


def _read_off(base: Base, ready: Prepared) -> tuple[str, ...]:
    """Effects that can be seen without a model.

    A high level at rest is one; in a chamber, where all taxels feel the same, those that do not answer are another.
    """
    high = () if ready.rest_counts is None else (OFFSET,)
    return (DEAD_TAXEL, *high) if base.dead and not ready.options.base else high


def _unheard(_: str) -> None:
    """What another process does is not told."""


def judged(
    choice: Choice, null: Null, signatures: Sequence[Signature], options: DiagnoseOptions
) -> tuple[Verdict, bool]:
    """The verdict, and whether something significant is left unexplained.

    Something is missing where an effect scores as none does in null sessions, or where the residual depends on
    something far more than in any of them, or is simply far larger. It is named if what was named explains most of it.
    """
    little = choice.left <= options.negligible
    strongest = options.strongest(choice, signatures)
    in_images = [one for one in choice.named if not one.by_places]
    no_more = choice.left <= options.background
    if in_images and (no_more or choice.explained >= options.choice.explained):
        much = 1 - choice.explained > options.unexplained or choice.left > options.much
        return "effects", not no_more and much
    misfit = options.misfits(choice.left, null.times_most(choice.excess[1]))
    if choice.named and not in_images and strongest < options.structure and not misfit:
        # What lives in the places is taken up by them: the images say nothing for it or against it.
        return "effects", False
    if choice.named or misfit or (strongest >= options.structure and not little):
        return "unknown", True
    return "none", False


def _signatures(
    scene: Scene, base: Base, null: Null, signs: Mapping[str, tuple[str, FloatArray]], unknown: float
) -> tuple[Signature, ...]:
    whole = scene.part(base.material.known)
    read = int(base.material.reading.seen[whole.rows].sum())
    excess = float((whole.residual**2).sum()) - null.mean_square * read
    found: list[Signature] = []
    for name, (meaning, columns) in signs.items():
        fall = float(signature_falls(whole, columns, whole.residual)[0])
        found.append(Signature.of(name, meaning, fall, excess, null.signatures[name], unknown))
    return tuple(sorted(found, key=lambda s: -s.fall))
