"""The presses of one connection to the hand, and a session of connections: to the first site, between sites, home."""

from __future__ import annotations

from itertools import groupby

import numpy as np

from skincal.collect.journal import Journal
from skincal.collect.plan import Plan, PlannedPress
from skincal.collect.poses import heights, radius_of
from skincal.collect.posture import Fingers, Posture
from skincal.collect.press import Press
from skincal.collect.press_options import CollectOptions
from skincal.collect.progress import MakeDriver, Need, Progress, Watch
from skincal.collect.record import Arrays, press_arrays, rest_arrays
from skincal.collect.senses import Loop, Sample, Senses
from skincal.collect.travel import LOWEST_SHARE, Place, follow, way_over_skin, way_through_joints
from skincal.errors import WorkError, input_error
from skincal.hand import GuardedHand, GuardOptions, HandDriver
from skincal.model.arrays import FloatArray
from skincal.robot import place_indenter

GAP_S = 1.0
"""Gap in the session's clock when a session continues on another clock [s]."""

APART_M = 1e-3
"""An indenter nearer to the skin than this is lifted before anything else [m]."""


FEWEST_FOUND = 3
"""Number of presses in a pose after which the start of the skin is known."""


class Connection:
    """Executor of some presses of a session with a connected hand."""

    def __init__(self, session: Session, loop: Loop, radius_m: float, numbers: list[int]) -> None:
        self._session, self._loop, self._radius_m, self._numbers = session, loop, radius_m, numbers
        self._fingers, self._options = session.fingers, session.options
        self._offset: FloatArray = np.zeros(len(session.fingers.kinematics.description.joints))
        self._links: FloatArray = session.fingers.kinematics.description.home_rad
        self._place: Place | None = None
        self._found: dict[str, list[float]] = {}

    def run(self) -> None:
        """Make the presses, and bring the hand home."""
        self._begin()
        for number in self._numbers:
            self._make(number)
        self._end()

    def _begin(self) -> None:
        """Start the clock, lift the indenter if it touches, and record the skin at rest."""
        session, loop = self._session, self._loop
        loop.doing = "idle"
        state = loop.look().state
        loop.senses.start_clock(state, self._clock_now(state.time_s))
        session.connected(self._numbers[0], loop.senses.shift_s)
        loop.take()
        links = loop.look().links_rad
        self._offset = loop.now.state.q_desired_rad - links
        if loop.now.height_m < APART_M:
            links = self._lifted(links)
            self._offset = np.zeros_like(links)
        loop.take()
        loop.hold(links + self._offset, self._options.rest_s)
        self._links = links
        first = session.plan.presses[self._numbers[0]].pose
        session.keep_rest(rest_arrays(loop.take(), session.last_frame_s, self._options, first))

    def _clock_now(self, hand_s: float) -> float:
        """Return the session's clock: on the hand's clock if that ran on, else a moment after the last frame."""
        last = self._session.last_frame_s
        if not np.isfinite(last):
            return 0.0
        shifts = [float(c["shift_s"]) for c in self._session.journal.connections()]
        went_on = hand_s + shifts[-1] if shifts else -np.inf
        return max(went_on, last + GAP_S)

    def _lifted(self, links: FloatArray) -> FloatArray:
        """Lift an indenter that touches straight off the skin; return the link angles there."""
        loop, sample = self._loop, self._loop.now
        normal = self._fingers.mount.surface.normal_at(sample.point_m[None])[0]
        away = sample.point_m + (self._radius_m + self._options.clearance_m) * normal
        end = place_indenter(self._fingers.kinematics, away, links)
        offset = sample.state.q_desired_rad - links
        follow(loop, np.stack([links, end]), offset, self._options)
        return end

    def _make(self, number: int) -> None:
        session, loop = self._session, self._loop
        planned = session.plan.presses[number]
        posture = self._posture(planned)
        loop.doing = "travel"
        self._go(planned, posture)
        press = Press(loop, posture, planned, self._options, self._near(planned.pose))
        moments = press.run()
        self._offset = press.offset_rad
        if np.isfinite(press.found_m):
            self._found.setdefault(planned.pose, []).append(press.found_m)
        session.keep(
            number,
            press_arrays(
                number,
                session.cycles[number],
                planned,
                posture.point_m,
                moments,
                press.lost,
                loop.take(),
                session.last_frame_s,
                loop.senses.tare_nm,
                self._options,
            ),
        )

    def _near(self, pose: str) -> float:
        """Return the height below which the skin may begin [m]: joint errors differ between poses, less within one."""
        found = self._found.get(pose, [])
        if len(found) < FEWEST_FOUND:
            return self._options.near_m
        return max(found) + self._options.before_contact_m

    def _posture(self, planned: PlannedPress) -> Posture:
        skin = np.array(self._session.plan.poses[planned.pose])
        start = None if self._place is None else self._place.links_rad
        return self._fingers.posture(planned.site, skin, self._radius_m, heights(self._options), start)

    def _go(self, planned: PlannedPress, posture: Posture) -> None:
        """Move the indenter over a site, at travelling height."""
        top, end = float(posture.heights_m[-1]), posture.links_rad[-1]
        skin = np.array(self._session.plan.poses[planned.pose])
        length = 0.0
        if self._place is None:
            way = self._through(self._links, end)
        else:
            try:
                way = way_over_skin(self._fingers, self._place, planned.site, skin, self._radius_m + top)
                length = float(np.hypot(*np.subtract(planned.site, self._place.site)))
            except WorkError:
                # Between two sites within reach there may be one that is not.
                way = self._through(self._place.links_rad, end)
        follow(self._loop, np.concatenate([way, end[None]]), self._offset, self._options, length)
        self._place, self._links = Place(planned.site, skin, end), end
        self._offset = np.zeros_like(end)

    def _through(self, start: FloatArray, end: FloatArray) -> FloatArray:
        least = LOWEST_SHARE * self._options.clearance_m
        return way_through_joints(self._fingers, start, end, self._radius_m, least)

    def _end(self) -> None:
        """Bring the hand home, and record the skin at rest once more."""
        loop, session = self._loop, self._session
        home = self._fingers.kinematics.description.home_rad
        loop.doing = "travel"
        follow(loop, self._through(self._links, home), self._offset, self._options)
        loop.doing = "idle"
        loop.hold(home, self._options.rest_s)
        pose = session.plan.presses[self._numbers[-1]].pose
        session.keep_rest(rest_arrays(loop.take(), session.last_frame_s, self._options, pose))


class Session:
    """Executor of a plan on a hand."""

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
