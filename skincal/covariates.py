"""Optional columns of a session, beside positions, forces and images, and the covariates of effects.

The only list of either. Readers of datasets, mappings of imports, samples, warnings and the audit follow it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

POSITION: Final = ("x_m", "y_m", "z_m")
NORMAL: Final = ("nx", "ny", "nz")
TARGET: Final = ("target_x_m", "target_y_m", "target_z_m")

TIMES: Final = ("t_start_s", "t_hold_s", "t_release_s", "t_end_s")
"""Optional columns of presses only, in the order of time."""

TEXT: Final = "text"
ANY: Final = "a number"
NOT_NEGATIVE: Final = "a number, 0 or more"
POSITIVE: Final = "a number above 0"
WHOLE: Final = "a whole number, 0 or more"


@dataclass(frozen=True)
class Column:
    """An optional column of presses and frames.

    Attributes:
        quantity: kind of quantity, which decides the units that an import may convert from.
        of_press: whether it describes a whole press, so that it is not averaged over a hold.
    """

    cells: str = ANY
    quantity: str = "number"
    of_press: bool = False


COLUMNS: Final[dict[str, Column]] = {
    "pose": Column(TEXT, of_press=True),
    "branch": Column(TEXT, of_press=True),
    "cycle": Column(WHOLE, of_press=True),
    "speed_m_per_s": Column(NOT_NEGATIVE, "speed"),
    "indenter_radius_m": Column(POSITIVE, "length", of_press=True),
    "shear_u_n": Column(quantity="force"),
    "shear_v_n": Column(quantity="force"),
    "temperature_c": Column(quantity="temperature"),
    "target_force_n": Column(quantity="force", of_press=True),
    **dict.fromkeys(NORMAL, Column()),
    **dict.fromkeys(TARGET, Column(quantity="length", of_press=True)),
}
"""Optional columns of presses and frames, by name."""


@dataclass(frozen=True)
class Covariate:
    """A quantity beside position and force on which an effect may depend.

    Attributes:
        attribute: attribute of :class:`skincal.effects.Samples` that holds it.
        columns: columns that give it, as they stand; several are the components of a vector. Empty where it is
            computed or, like a pose, named.
        cure: what to do where a session lacks it.
        with_others: column names for messages, where ``columns`` do not tell them.
        comes_with: covariate that it is recorded along with; a message that names that one need not name it.
        whole: whether it is a whole number, -1 where it is unknown, instead of a real one.
        clocked: whether it is recorded over time: a message that the session has no times covers it.
        unplanned: what a plan does not say about it; empty where a plan determines it.
        typical: its value, or those of its components, in an ordinary press: for drawings.
    """

    attribute: str
    columns: tuple[str, ...] = ()
    cure: str = ""
    with_others: str = ""
    comes_with: str = ""
    whole: bool = False
    clocked: bool = False
    unplanned: str = ""
    typical: tuple[float, ...] = ()

    def __str__(self) -> str:
        return self.with_others or " and ".join(self.columns) or self.attribute


COVARIATES: Final[dict[str, Covariate]] = {
    "time": Covariate(
        "time_s", cure="record when each press begins and ends", with_others=f"{', '.join(TIMES)} of every press",
        clocked=True, typical=(0.0,),
    ),
    "phase": Covariate(
        "phase", cure="record every frame", comes_with="time", whole=True, clocked=True, typical=(2,)
    ),  # hold
    "speed": Covariate(
        "speed_m_per_s", ("speed_m_per_s",), "load slowly and fast, and record how fast", typical=(1e-3,)
    ),
    "cycle": Covariate(
        "cycle", ("cycle",), "come back to sites, and record how often each was touched before", typical=(9,)
    ),
    "met": Covariate(
        "met_n", with_others=f"cycle and {', '.join(TARGET)} of every press", comes_with="cycle"
    ),
    "pose": Covariate("pose", cure="press in two hand poses, and record which", whole=True, typical=(0,)),
    "temperature": Covariate(
        "temperature_c", ("temperature_c",), "record the temperature", clocked=True, unplanned="how warm it will be",
        typical=(25.0,),
    ),
    "shear": Covariate(
        "shear_n", ("shear_u_n", "shear_v_n"), "press with tangential force, too, and record it",
        unplanned="which tangential forces there will be", typical=(1.0, 0.0),
    ),
}  # fmt: skip
"""Covariates of effects, by name. A new one also needs its attribute in :class:`skincal.effects.Samples`."""

NUMBERS: Final = tuple(covariate for covariate in COVARIATES.values() if covariate.columns)
"""Covariates that are columns as they stand."""
