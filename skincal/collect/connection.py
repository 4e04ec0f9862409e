"""The presses of one connection to the hand, and a session of connections: to the first site, between sites, home."""

from __future__ import annotations

from itertools import groupby

import numpy as np

from skincal.collect.plan import PlannedPress
from skincal.collect.posture import Fingers, Posture
from skincal.collect.press import Press
from skincal.collect.record import frames_of, press_tables
from skincal.collect.senses import Loop, Senses
from skincal.collect.session import MakeDriver, Session
from skincal.collect.travel import LOWEST_SHARE, Place, follow, way_over_skin, way_through_joints
from skincal.errors import WorkError, input_error
from skincal.hand import GuardedHand, GuardOptions, HandDriver
from skincal.model.arrays import FloatArray
from skincal.robot import place_indenter

APART_M = 1e-3
"""An indenter nearer to the skin than this is lifted before anything else [m]."""


FEWEST_FOUND = 3
"""Number of presses in a pose after which the start of the skin is known."""


class Connection:
    """Executor of some presses of a session with a connected hand."""

    def __init__(
        self, session: Session, fingers: Fingers, loop: Loop, radius_m: float, numbers: list[int]
    ) -> None:
        self._session, self._loop, self._radius_m, self._numbers = session, loop, radius_m, numbers
        self._fingers, self._options = fingers, session.options
        self._links: FloatArray = fingers.kinematics.description.home_rad
        self._offset: FloatArray = np.zeros_like(self._links)
        self._place: Place | None = None
        self._contacts_m: dict[str, list[float]] = {}

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
        loop.senses.shift_clock(session.connect(loop.look().state.time_s))
        loop.take()
        links = loop.look().links_rad
        self._offset = loop.now.state.q_desired_rad - links
        if loop.now.height_m < APART_M:
            links = self._lifted(links)
            self._offset = np.zeros_like(links)
        loop.take()
        loop.hold(links + self._offset, self._options.rest_s)
        self._links = links
        self._keep_rest(self._numbers[0])

    def _keep_rest(self, number: int) -> None:
        """Store the frames since the last call, in the pose of a press."""
        frames = frames_of(self._loop.take(), self._session.last_frame_s, self._options.frame_rate_hz)
        pose = self._session.plan.presses[number].pose
        self._session.keep_rest(frames, {"pose": np.full(len(frames["time_s"]), pose)})

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
            self._contacts_m.setdefault(planned.pose, []).append(press.found_m)
        samples, tare_nm = loop.take(), loop.senses.tare_nm
        tables = press_tables(session, number, posture.point_m, moments, samples, tare_nm, lost=press.lost)
        session.keep(number, *tables)

    def _near(self, pose: str) -> float:
        """Return the height below which the skin may begin [m]: joint errors differ between poses, less within one."""
        heights_m = self._contacts_m.get(pose, [])
        if len(heights_m) < FEWEST_FOUND:
            return self._options.near_m
        return max(heights_m) + self._options.before_contact_m

    def _posture(self, planned: PlannedPress) -> Posture:
        skin = self._session.plan.poses[planned.pose]
        start = None if self._place is None else self._place.links_rad
        return self._fingers.posture(planned.site, skin, self._options, self._radius_m, start)

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
        loop = self._loop
        home = self._fingers.kinematics.description.home_rad
        loop.doing = "travel"
        follow(loop, self._through(self._links, home), self._offset, self._options)
        loop.doing = "idle"
        loop.hold(home, self._options.rest_s)
        self._keep_rest(self._numbers[-1])


def press_on_hand(
    session: Session, fingers: Fingers, make_driver: MakeDriver, guard: GuardOptions | None
) -> None:
    """Make the missing presses of a session, with one connection for each indenter.

    Raises:
        InputError: the hand follows no commands.
        HandError: the hand failed; finished presses are in the journal.
        WorkError: a press cannot be made.
    """
    presses = session.plan.presses
    for radius, group in groupby(list(session.todo), lambda number: presses[number].indenter_radius_m):
        driver = make_driver(session.need(radius))
        assert isinstance(driver, HandDriver)
        if not driver.follows_commands:
            fix = "The recording itself can be fitted: `skincal fit`."
            raise input_error(f"driver {driver.name}", "a hand that moves", "a recorded one", fix)
        radius_m = radius or fingers.kinematics.description.indenter_radius_m
        senses = Senses(fingers.kinematics, radius_m)
        with GuardedHand(driver, guard, senses.contact_force) as hand:
            Connection(session, fingers, Loop(hand, senses, session.report), radius_m, list(group)).run()
