"""Stress is a nonlinear function of penetration.

    sigma = E eps_0 (eps / eps_0)^n

n = 1 is the paper's foundation; with n > 1 the skin stiffens as it is compressed, with n < 1 it gives way. The
equilibrium of forces is solved with this law, so that the penetration and the image change together.
"""

from __future__ import annotations

from skincal.effects.effect import LawEffect
from skincal.effects.parameter import Values, form, start, strength
from skincal.model import StressLaw


class Stiffening(LawEffect):
    name = "stiffening"
    # The stiffness may be that at eps_0, or where the penetration begins.
    zero_error = 1.0
    meaning = "stress is a nonlinear function of penetration"
    parameters = (
        strength("exponent", "-", 1.0, 0.3, 4.0, "n", typical=0.6, scale="log"),
        form(
            "reference_m",
            "m",
            5e-4,
            1e-5,
            5e-3,
            "eps_0: where the stress is that of the linear law",
            scale="log",
        ),
    )
    search_from = (start({"exponent": 1.2}),)
    asks = ("forces",)
    source = "Power-law foundation: Johnson, Contact Mechanics, 1985, 4.3; foams: Gibson, Ashby, Cellular Solids, 1997."

    def law(self, values: Values) -> StressLaw:
        return StressLaw(values.number("exponent"), values.number("reference_m"))
