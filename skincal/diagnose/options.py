"""How a diagnosis goes."""

from __future__ import annotations

from dataclasses import dataclass, field

from skincal.gap.choice_options import ChoiceOptions


@dataclass(frozen=True)
class DiagnoseOptions:
    """Settings of a diagnosis.

    Attributes:
        null_draws: null sessions of each contact law.
        choice: when an effect is named.
        structure: something is missing where a residual depends on something by so many times the most of any null
            session, whether an effect explains it or not.
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


def thoroughly() -> DiagnoseOptions:
    """Settings for when there is time: more null sessions, and more effects fitted in full."""
    return DiagnoseOptions(
        null_draws=300, choice=ChoiceOptions(contenders=6, contend=0.3, searched=22, near=0.0)
    )
