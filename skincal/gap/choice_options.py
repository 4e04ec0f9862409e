"""When an effect is named: the numbers of the choice."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ChoiceOptions:
    """When an effect is named.

    Attributes:
        most: effects at most.
        significant: p-value at which there is something.
        share_first: part of the excess that an effect must explain to be named at all, of what is there in its round.
        share_later: the same from the second round on: what an equation that is not quite right leaves over must not
            be named.
        share_of_taxels: the same of an effect with numbers for each taxel that did not score: so many numbers take up a
            part of whatever is missing.
        explained: part of the excess that the named effects must explain together, else the verdict is ``unknown``.
            Where one is named that does not, every other is fitted in full beside it: the search holds places, forces
            and sensor to first order, and about a fit that has no room for the second effect they are far off.
        of_all: part of the first round's excess that a later effect must explain, but no more than ``clear`` asks for,
        most_of_rest: and no more than the weakest effect does, if it scores and explains this part of what is left. An
            equation that is not quite right leaves over what no other explains so well, but those that are like it.
        alike: effects stay in the set of names if they explain at least this part of what the best one does, or less
            by no more than the weakest effect that is named; ``half`` of it in any case.
        half: see ``alike``.
        broad: an effect with numbers for each taxel gives way to one with a few for all that explains this part of what
            it does,
        no_worse: and leaves no more than so many times what it leaves, or what the weakest effect explains.
        contenders: so many are fitted in full at first, and of those that explain about as much as the best so many are
            compared once presses were looked for again; twice as many beside a first effect.
        contend: effects that explain at least this part of the best are fitted in full.
        halfway: while nothing is named, and those explain less than this part of what is left, so are all others with a
            significant score: far from where the sensor belongs the search may rank an effect low that explains nearly
            all of it. Later it is not far, and a low score may say that what is fitted holds for few other presses.
        sure: what is left is that many times the weakest effect at least where more are fitted in full, to the presses
            learned from, and score with what that explains of the presses that choose: while nothing is named and what
            was fitted explains less than ``halfway``, or one is and it explains less than ``share_later``. What was
            read off does not count as named here.
        holds: while nothing is named, part of what is left of the presses that choose that such a fit must explain. Far
            from where the sensor belongs, places of presses that were not learned from are off as well, and hide most
            of it; what is fitted in full then must explain ``share_first`` like any other. Beside a first effect, part
            of what is left that one must explain for presses to be looked for again with it.
        searched: so many are searched, those that explain most to first order.
        near: effects that explain less than this part of the best to first order are not.
        enough: no further round where this part of the first round's excess is left, or less, but for ``clear``.
        weakest: root mean square of the weakest effect that is named, in units of the noise, over all that was read:
            tactile points half a millimetre apart and ramps averaged in bins leave nearly as much.
        of_few: by how much it lowers the squared residual in any case, in squared units of the noise. A static session
            has few values with little noise, and what places or a contact law are not quite right in leaves tens.
        beside_law: the same as ``weakest`` where another contact law explains much: what is not quite right in it
            leaves nearly as much.
        share_of_law: part of what a law explains that the weakest effect has at least, up to ``beside_law``.
        clear: root mean square in units of the noise from which on a later effect is looked at however large the first
            one was.
        related: cosine, squared, of what two effects do to the values, each alone, from which on the later one is taken
            for what the equation of the first leaves over, unless it explains ``of_related`` of the first excess; so is
            a later one of the same kind (:data:`skincal.gap.related.KINDS`).
        of_related: see ``related``.
    """

    most: int = 4
    significant: float = 0.01
    share_first: float = 0.25
    share_later: float = 0.4
    share_of_taxels: float = 0.5
    explained: float = 0.75
    of_all: float = 0.06
    most_of_rest: float = 0.6
    alike: float = 0.88
    half: float = 0.5
    broad: float = 0.93
    no_worse: float = 1.5
    contenders: int = 3
    contend: float = 0.6
    halfway: float = 0.5
    sure: float = 4.0
    holds: float = 0.1
    searched: int = 8
    near: float = 0.1
    enough: float = 0.03
    weakest: float = 0.15
    of_few: float = 100.0
    beside_law: float = 0.25
    share_of_law: float = 0.8
    clear: float = 0.4
    related: float = 0.3
    of_related: float = 0.25

    def least(self, values: int, law: float = 0.0) -> float:
        """By how much the weakest effect lowers the squared residual of so many values.

        Args:
            values: that were read.
            law: root mean square of what another contact law explains, in units of the noise.
        """
        return max(self.weakest_beside(law) ** 2 * values, self.of_few)

    def weakest_beside(self, law: float) -> float:
        """Root mean square of the weakest effect that is named, in units of the noise.

        Args:
            law: root mean square of what another contact law explains, in units of the noise.
        """
        return max(self.weakest, min(self.share_of_law * law, self.beside_law))

    def about(self, fall: float, values: int) -> float:
        """What an effect must explain that cannot be told from one that explains more.

        A difference that is too small to be named as an effect is too small to choose between two names.

        Args:
            fall: what the better one explains.
            values: that were read.
        """
        return max(min(self.alike * fall, fall - self.weakest**2 * values), self.half * fall)

    def enough_of(self, fall: float, left: float, values: int) -> float:
        """What an effect with few numbers must explain to go before one with many that explains more.

        Args:
            fall: what the one with many explains.
            left: of what is left before.
            values: that were read.
        """
        rest = max(left - fall, self.weakest**2 * values)
        return max(self.broad * fall, left - self.no_worse * rest)

    def later(self, share: float, first: float, values: int) -> float:
        """A share of the first round's excess, but no more than is clear."""
        return min(share * first, self.clear**2 * values)
