"""A rig by the name of its driver: created with its options, and anew for every connection of a session."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skincal.collect.collection import Collected, collect
from skincal.collect.journal import journal_folder
from skincal.collect.plan import Plan
from skincal.collect.session import PAUSE_S, MakeDriver, Need, Watch
from skincal.errors import input_error
from skincal.hand import GuardOptions, HandDriver, StageDriver
from skincal.hand.registry import create_driver, create_rig, driver_options, parse_options
from skincal.hand.stage_guard import check_stage
from skincal.robot import HandDescription, check_limits

MEMORY = "skin.memory"
"""File in the folder of an unfinished session: the contact history that the simulated skin remembers."""


@dataclass(frozen=True, eq=False)
class Rig:
    """A hand or stage that makes presses.

    Attributes:
        name: name of its driver.
        options: of the driver.
        seed: of a simulated rig.
        beyond_limits: whether the guard's limits may be exceeded.
        driver: not connected.
    """

    name: str
    options: Mapping[str, Any]
    seed: int
    beyond_limits: bool
    driver: HandDriver | StageDriver

    @classmethod
    def of(
        cls, name: str, given: list[str] | None, seed: int, *, beyond_limits: bool = False, **own: Any
    ) -> Rig:
        """Create the driver; an option of the command that it lacks is an error.

        Args:
            name: of the driver.
            given: its options as a command line has them, each ``KEY=VALUE``.
            seed: for drivers that take one.
            beyond_limits: whether limits may be beyond those of any finger or bench; otherwise they are refused.
            own: options of the driver for which the command has an option of its own; empty ones are left out.

        Raises:
            InputError: there is no such driver or option, or a limit is beyond those of any finger or bench.
        """
        own = {key: value for key, value in own.items() if value}
        if "seed" in _known(name):
            own["seed"] = seed
        options: dict[str, Any] = dict(parse_options(given or []))
        if twice := [key for key in own if key in options]:
            expected = "options without an own command-line option"
            raise input_error("--driver-option", expected, ", ".join(twice))
        options |= own
        driver = create_rig(name, **options)
        if isinstance(driver, StageDriver):
            check_stage(driver.description, beyond=beyond_limits)
        else:
            check_limits(driver.description, beyond=beyond_limits)
        return cls(name, options, seed, beyond_limits, driver)

    @property
    def hand(self) -> HandDescription | None:
        """The hand; None: the rig is a stage."""
        return None if isinstance(self.driver, StageDriver) else self.driver.description

    @property
    def texts(self) -> dict[str, str]:
        """The options of the driver as texts, by which an interrupted session recognises it."""
        return {key: str(value) for key, value in sorted(self.options.items())}

    def press(
        self,
        plan: Plan,
        out: Path,
        source: str,
        *,
        start_s: float = 0.0,
        change_cap: Callable[[float | None], None],
        watch: Watch | None = None,
        **output: Any,
    ) -> Collected:
        """Make the presses of a plan, or go on with them.

        Args:
            plan: the presses.
            out: folder of the dataset.
            source: for ``dataset.toml``.
            start_s: start of a simulated hand's clock [s].
            change_cap: asks for the cap with a sphere of a radius [m], None for the hand's own; it returns when that
                is mounted. A simulated hand changes its cap itself.
            watch: progress callback.
            output: ``force``, ``inputs`` and ``restart`` of :func:`skincal.collect.collect`.
        """
        key = {"driver": self.name, "seed": self.seed, "driver options": self.texts}
        guard, make = GuardOptions(beyond_limits=self.beyond_limits), self._maker(out, change_cap, start_s)
        rig, about = self.driver.description, {"key": key, "source": source, "watch": watch}
        return collect(plan, rig, make, out, guard=guard, **about, **output)

    def _maker(self, out: Path, change_cap: Callable[[float | None], None], start_s: float) -> MakeDriver:
        """Return a factory of drivers for the point that the session has reached.

        A simulated hand is given the clock of its session, the cap and the contact history.
        """
        known = _known(self.name)
        mounted: list[float | None] = [None]

        def make(need: Need) -> HandDriver | StageDriver:
            if self.hand is None:
                return self.driver
            radius_m = need.indenter_radius_m
            if radius_m != mounted[0] and "indenter_radius_m" not in known:
                change_cap(radius_m)
                mounted[0] = radius_m
            later = {
                "start_s": (need.session_s or start_s) + PAUSE_S if need.session_s or start_s > 0 else None,
                "indenter_radius_m": radius_m,
                "memory_path": journal_folder(out) / MEMORY,
            }
            own = {n: v for n, v in later.items() if n in known and n not in self.options and v is not None}
            return create_driver(self.name, **self.options, **own)

        return make


def driver_text(name: str, seed: int | str) -> str:
    """Return a driver as the ``source`` of a dataset names it; the simulated hand with its seed."""
    return f"driver {name}, seed {seed}" if name == "sim" else f"driver {name}"


def simulated_seed(source: str) -> int | None:
    """Return the seed of the simulated hand that a ``source`` names; None: it names none."""
    found = re.search(driver_text("sim", r"(\d+)"), source)
    return None if found is None else int(found[1])


def _known(driver: str) -> set[str]:
    return {option.name for option in driver_options(driver)}
