"""A session: the presses of a plan on a hand, one after the other, each stored before the next begins."""

from __future__ import annotations

from itertools import groupby

from skincal.collect.connection import Connection
from skincal.collect.journal import Journal
from skincal.collect.plan import Plan
from skincal.collect.poses import radius_of
from skincal.collect.posture import Fingers
from skincal.collect.press_options import CollectOptions
from skincal.collect.progress import MakeDriver, Need, Progress, Watch
from skincal.collect.record import Arrays
from skincal.collect.senses import Loop, Sample, Senses
from skincal.errors import input_error
from skincal.hand import GuardedHand, GuardOptions, HandDriver


class Session:
    """Executor of a plan on a hand.

    Args:
        guard: limits of the guard; None: its defaults.
    """

    def __init__(
        self,
        plan: Plan,
        journal: Journal,
        fingers: Fingers,
        make_driver: MakeDriver,
        options: CollectOptions | None = None,
        guard: GuardOptions | None = None,
        watch: Watch | None = None,
    ) -> None:
        self.plan, self.journal, self.fingers = plan, journal, fingers
        self._make_driver, self._guard, self._watch = make_driver, guard, watch
        self.options = options or CollectOptions()
        self.todo, self.last_frame_s = journal.open_end(len(plan))
        # An earlier connection for the press that now comes first may have touched its site.
        self._resumed = bool(journal.connections())
        self.cycles = _touches(plan, [*_cuts(journal), *(self.todo[:1] if self._resumed else ())])

    def run(self) -> None:
        """Make the missing presses.

        Raises:
            InputError: the hand follows no commands.
            HandError: the hand failed; finished presses are in the journal.
            WorkError: a press cannot be made.
        """
        presses = self.plan.presses
        for radius, group in groupby(list(self.todo), lambda number: presses[number].indenter_radius_m):
            numbers = list(group)
            before = len(self.journal.connections())
            driver = self._make_driver(Need(max(self.last_frame_s, 0.0), radius, before))
            assert isinstance(driver, HandDriver)
            if not driver.follows_commands:
                fix = "The recording itself can be fitted: `skincal fit`."
                raise input_error(f"driver {driver.name}", "a hand that moves", "a recorded one", fix)
            senses = Senses(self.fingers.kinematics, radius or radius_of(self.fingers))
            with GuardedHand(driver, self._guard, senses.contact_force) as hand:
                loop = Loop(hand, senses, self._report)
                Connection(self, loop, radius or radius_of(self.fingers), numbers).run()

    def connected(self, first: int, shift_s: float) -> None:
        """Record a connection of the hand, before it moves."""
        self.journal.connected({"first": first, "resumed": self._resumed, "shift_s": shift_s})
        self._resumed = False

    def keep(self, number: int, arrays: Arrays) -> None:
        """Store a finished press; on return it is on the disk."""
        self.journal.keep_press(number, arrays)
        self.todo.remove(number)
        self._saw(arrays)

    def keep_rest(self, arrays: Arrays) -> None:
        """Store frames outside of presses."""
        self.journal.keep_rest(arrays)
        self._saw(arrays)

    def _saw(self, arrays: Arrays) -> None:
        times = arrays["frames.time_s"]
        if len(times):
            self.last_frame_s = float(times[-1])

    def _report(self, sample: Sample, doing: str) -> None:
        if self._watch is not None:
            done, total = len(self.plan) - len(self.todo), len(self.plan)
            planned = self.plan.presses[self.todo[0] if self.todo else -1]
            self._watch(Progress(done, total, planned, doing, sample))


def _cuts(journal: Journal) -> list[int]:
    """Return the presses at which the session resumed after an interruption."""
    return [int(connection["first"]) for connection in journal.connections() if connection["resumed"]]


def _touches(plan: Plan, cuts: list[int]) -> list[int]:
    """Return the earlier touches of each press's site, including those by interrupted presses."""
    cycles = list(plan.cycles())
    for cut in cuts:
        for number in range(cut, len(plan)):
            cycles[number] += plan.presses[number].site == plan.presses[cut].site
    return cycles
