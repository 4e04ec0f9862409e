"""The parts of a calibration, as frozen objects: best parameters, loss, effects, findings, provenance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Annotated, Any, Final, Literal

from skincal.dataset.keys import Key, Names, When, Word
from skincal.dataset.schema import Table
from skincal.dataset.spec import Centre
from skincal.effects import EFFECTS
from skincal.model import ContactLaw
from skincal.units import in_unit

EFFECT_NAMES: Final[dict[str, str]] = {name: effect.meaning for name, effect in EFFECTS.items()}
"""Name and meaning of each effect, in the order of the chain."""


Interval = tuple[float, float]
"""Low and high; infinite on a side that the data do not bound."""

Numbers = float | tuple[float, ...]
Severity = Literal["info", "warning", "error"]

REST: Final = "rest_counts"
"""The only model parameter that belongs to the session, not to the skin; files may omit it."""

ELASTICITY_PA_PER_M: Final = (1.0, 1e15)
SCALE_PER_N: Final = (1e-9, 1e12)
"""Bounds of plausible stiffness and scale; beyond them, squares overflow."""

_Numbers = Annotated[Numbers, Key("a number, or a list of numbers")]
_Side = Annotated[Numbers, Key("a number, or a list of numbers", inf=True)]


@dataclass(frozen=True)
class ModelParameters(Table):
    """The best parameters of the skin model (paper, section III).

    Attributes:
        y_m: centre of the patch along the finger [m].
        alpha_deg: turn of the patch about its normal [°].
        elasticity_pa_per_m: stress over penetration, E [Pa/m].
        scale_per_n: counts over taxel load, S, common to all taxels [1/N].
        beta_deg: centre of the patch round the fingertip [°]; None on a plane.
        x_m: centre of the patch across the finger [m]; on a plane only.
        scale_per_taxel_per_n: scale of each taxel, S_j [1/N], J numbers by the flat index; overrides
            ``scale_per_n``. None: one scale for all.
        rest_counts: level at rest that all taxels share [counts]; None if it was not fitted.
    """

    y_m: Centre
    alpha_deg: Annotated[float, Key("an angle in degrees")]
    elasticity_pa_per_m: Annotated[float, Key("E [Pa/m], 1 to 1e15", *ELASTICITY_PA_PER_M)]
    scale_per_n: Annotated[float, Key("S [1/N], 1e-9 to 1e12", *SCALE_PER_N)]
    beta_deg: float | None = None
    x_m: Centre | None = None
    scale_per_taxel_per_n: Annotated[
        tuple[float, ...] | None, Key("S_j [1/N], a number for each taxel, 0 to 1e12", 0.0, SCALE_PER_N[1])
    ] = None
    rest_counts: float | None = None

    def best(self) -> dict[str, float]:
        """Return the scalar parameters by name, in the order of the contract: the pose, E, S."""
        across = {"x_m": self.x_m} if self.beta_deg is None else {"beta_deg": self.beta_deg}
        values = {
            "y_m": self.y_m,
            **across,
            "alpha_deg": self.alpha_deg,
            "elasticity_pa_per_m": self.elasticity_pa_per_m,
            "scale_per_n": self.scale_per_n,
        }
        return {name: value for name, value in values.items() if value is not None}


LAW: Final = ("exponent", "spread_m2", "radius_scale")
"""Fitted parameters of a contact law."""


@dataclass(frozen=True)
class FittedLaw:
    """A contact law other than the elastic foundation, if the data show one."""

    law: ContactLaw
    intervals: Mapping[str, Interval] = field(default_factory=dict[str, Interval])


@dataclass(frozen=True)
class Loss(Table, unknown="keep"):
    """Quality of fit of the best parameters, and of the valley.

    Attributes:
        mse_counts2: mean square of the residual per taxel at the best parameters [counts²].
        valley_mse_counts2: bound of that loss in the valley [counts²].
        presses_used: number of presses.
        extra: further figures of a fit, by a name with its unit.
    """

    mse_counts2: Annotated[float, Key("a mean square [counts²], 0 or more", 0.0)]
    valley_mse_counts2: Annotated[float, Key("a mean square [counts²], 0 or more, or inf", 0.0, inf=True)]
    presses_used: Annotated[int, Key("a whole number, 0 or more", 0)]
    extra: Mapping[str, Any] = field(default_factory=dict[str, Any])


@dataclass(frozen=True)
class Effect(Table, unknown="keep"):
    """An effect of the skin beyond the base model.

    Attributes:
        name: one of the contract's names, a key of :data:`skincal.calibration.EFFECT_NAMES`.
        parameters: a number, or one number per taxel or hand pose, by a name with its unit; omitted ones are
            neutral.
        intervals: low and high of some of the parameters, of the same shape as the parameter.
        extra: further keys.
        poses: names of the hand poses of lists with one number per pose. Empty if not given; a list
            then belongs to the poses of the data at hand, in the order of their names.
    """

    name: Annotated[str, Word(options=EFFECT_NAMES)]
    parameters: Mapping[str, _Numbers] = field(default_factory=dict[str, Numbers])
    intervals: Mapping[str, Annotated[tuple[_Side, _Side], Key("[low, high]", inf=True)]] = field(
        default_factory=dict[str, tuple[Numbers, Numbers]]
    )
    extra: Mapping[str, Any] = field(default_factory=dict[str, Any])
    poses: Annotated[tuple[str, ...], Names("names of hand poses, each once")] = ()


@dataclass(frozen=True)
class Finding(Table, unknown="keep"):
    """A finding about a calibration, with advice for the user.

    Attributes:
        code: code for programs, as ``few_presses``; ``CODES`` has those with properties.
        severity: ``info``, ``warning`` or ``error``.
        text: the finding.
        advice: what to do; may be empty.
        mapping: lines of a mapping file, under ``[taxels]``, that correct it; may be empty.
        factor: what corrects the unit of suspect values; None of other findings.
    """

    code: str
    severity: Severity
    text: str
    advice: str = ""
    mapping: str = ""
    factor: float | None = None

    def in_unit(self, unit: str | None) -> Finding:
        """Return the finding with the unit of the taxel values instead of counts."""
        return replace(self, text=in_unit(self.text, unit), advice=in_unit(self.advice, unit))

    def plain(self) -> dict[str, Any]:
        """Return the finding as TOML has it, without an empty mapping and without a factor that there is not."""
        return {key: value for key, value in vars(self).items() if value or key not in ("mapping", "factor")}

    def as_json(self) -> dict[str, Any]:
        """Return the finding for other programs; the severity ``info`` becomes ``note``."""
        return self.plain() | {"severity": "note" if self.severity == "info" else "warning"}


@dataclass(frozen=True)
class Code:
    """Properties of a code of a fit's findings.

    Attributes:
        of_images: whether images in the wrong order, or of corrupted values, can cause it.
        of_base_model: whether it says how well images match the base model, or where its intervals end. A
            diagnosis, which extends the model, supersedes it.
        on_a_stage: advice for a rig without joints; '' for the advice of the finding.
    """

    of_images: bool = False
    of_base_model: bool = False
    on_a_stage: str = ""


_IMAGES, _MATCH = Code(of_images=True), Code(of_images=True, of_base_model=True)

CODES: Final = {
    **dict.fromkeys(("dead_taxel", "few_draws", "lost_readings", "not_identified", "rest_in_doubt"), _IMAGES),
    **dict.fromkeys(("misfit", "range_edge", "bad_presses", "glitches"), _MATCH),
    **dict.fromkeys(("response_bends", "contact_law", "slack_too_tight"), _MATCH),
    "force_scatter": Code(
        True, True, "Check the zero of the load cell, and that it measures along the normal of the skin."
    ),
    "positions_worse": Code(
        True,
        True,
        "Check how the stage's axes lie to the sensor, and the offset of the indenter's tip; raise [position] sigma_m "
        "and slack_m.",
    ),
    "positions_bent": Code(
        True, True, "Align the axes of the stage with the sensor's edges for a sharper alpha."
    ),
}
"""Codes with properties; all others have those of ``Code()``."""


def code_of(name: str) -> Code:
    """Return the properties of a code."""
    return CODES.get(name, Code())


@dataclass(frozen=True)
class Provenance(Table, unknown="keep"):
    """Provenance of a calibration.

    Attributes:
        dataset_sha256: hash of the dataset (:func:`skincal.dataset.dataset_hash`).
        dataset: name of its folder.
        version: version of skincal that made it.
        command: the command line.
        seed: seed of the randomness; None without randomness.
        time: time of the fit.
        options: settings of the fit by name.
        extra: further keys.
    """

    dataset_sha256: Annotated[str, Key("the dataset's hash")]
    dataset: str = ""
    version: str = ""
    command: str = ""
    seed: int | None = None
    time: Annotated[datetime | None, When()] = None
    options: Mapping[str, Any] = field(default_factory=dict[str, Any])
    extra: Mapping[str, Any] = field(default_factory=dict[str, Any])
