"""How a diagnosis goes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from skincal.gap.choice import Choice
from skincal.gap.choice_options import ChoiceOptions
from skincal.gap.signatures import Signature


@dataclass(frozen=True)
class DiagnoseOptions:
    """Settings of a diagnosis.

    Attributes:
        null_draws: null sessions of each contact law.
        choice: when an effect is named.
        structure: something is missing where a residual surely depends on something by so many times the most of any
            null session, whether an effect explains it or not.
        misfit: root mean square in units of the noise of a residual that is more than chance can leave, if it is also
            ``structure`` times the most of any null session: something is missing, though it depends on nothing known.
        unexplained: part of the excess that may be left before a diagnosis says that something is.
        much: root mean square, in units of the noise, that is said to be left however much was explained.
        negligible: root mean square in units of the noise that may always be left.
        background: the same beside effects that are named: where the contact law is another than the model's, nearly
            as much is left when nothing is hidden.
        reach_m: how far a press is looked for from its measured place where the dataset does not bound it [m].
    """

    null_draws: int = 60
    choice: ChoiceOptions = field(default_factory=ChoiceOptions)
    structure: float = 5.0
    misfit: float = 0.5
    unexplained: float = 0.12
    much: float = 0.5
    negligible: float = 0.2
    background: float = 0.25
    reach_m: float = 2e-3

    def misfits(self, left: float, times: float) -> bool:
        """Whether a residual is beyond what chance and any contact law leave.

        Args:
            left: its root mean square, in units of the noise.
            times: its excess, in units of the most of any null session.
        """
        return left > self.misfit and times >= self.structure

    def strongest(self, choice: Choice, signatures: Sequence[Signature]) -> float:
        """What a residual surely depends on most: by how many times more than in any null session.

        What is sure, but no more than the weakest effect does to a session of many values, is what ramps averaged in
        bins leave, or a law; nor does that count which a contact law that no null session has may leave.

        Args:
            choice: of effects.
            signatures: on what the residual depends.
        """
        if choice.excess[0] < 1:
            return 0.0
        least = self.choice.weakest_beside(choice.law) ** 2 * choice.values
        sure = [s for s in signatures if s.fall >= least and s.p_value <= self.choice.significant]
        return max((s.times_null for s in sure), default=0.0)


def thoroughly() -> DiagnoseOptions:
    """Settings for when there is time: more null sessions, and more effects fitted in full."""
    return DiagnoseOptions(
        null_draws=300, choice=ChoiceOptions(contenders=6, contend=0.3, searched=22, near=0.0)
    )
