"""The presses of one connection to the hand, and free motion: to the first site, between sites and poses, home."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

import numpy as np

from skincal.collect.plan import CollectOptions, PlannedPress
from skincal.collect.posture import Fingers, Posture
from skincal.collect.press import Press
from skincal.collect.record import frames_of, press_tables
from skincal.collect.senses import Loop, Senses
from skincal.collect.session import MakeDriver, Session
from skincal.errors import WorkError, input_error
from skincal.hand import GuardedHand, GuardOptions, HandDriver
from skincal.model.arrays import FloatArray
from skincal.robot import contact_from_joints, place_indenter

WAYPOINT_M = 0.002
"""Spacing of the solved points of a path; between them joints move evenly [m]."""

CHECKED = 60
"""Number of points of a joint-space path that are checked for contact."""

LOWEST_SHARE = 0.5
"""Part of the travelling height below which a joint-space path must not go."""

PEAK = 1.875
"""Ratio of the largest to the mean speed of a smooth motion."""


@dataclass(frozen=True, eq=False)
class Place:
    """Position of the indenter over the skin, at travelling height.

    Attributes:
        site: patch coordinates [m].
        skin_rad: angles of the finger with the skin [rad].
        links_rad: angles of all links (n,) [rad].
    """

    site: tuple[float, float]
    skin_rad: FloatArray
    links_rad: FloatArray


def way_over_skin(
    fingers: Fingers, start: Place, site: tuple[float, float], skin_rad: FloatArray, centre_height_m: float
) -> FloatArray:
    """Return angles of the links (W, n) [rad] on the way between two sites at one height; nothing is dragged.

    Raises:
        WorkError: the path leads out of reach.
    """
    length = float(np.hypot(site[0] - start.site[0], site[1] - start.site[1]))
    turn = float(np.abs(skin_rad - start.skin_rad).max())
    count = 2 + int(max(length / WAYPOINT_M, turn / 0.05))
    shares = np.linspace(0.0, 1.0, count)[1:, None]
    sites = (1 - shares) * np.asarray(start.site) + shares * np.asarray(site)
    skins = (1 - shares) * start.skin_rad + shares * skin_rad
    points, normals = fingers.mount.place(sites)
    q = start.links_rad
    way = [q]
    for skin, centre in zip(skins, points + centre_height_m * normals, strict=True):
        q = q.copy()
        q[fingers.kinematics.skin.columns] = skin
        q = place_indenter(fingers.kinematics, centre, q)
        way.append(q)
    return np.array(way)


def way_through_joints(
    fingers: Fingers, start_rad: FloatArray, end_rad: FloatArray, radius_m: float, least_m: float
) -> FloatArray:
    """Return a straight path (W, n) [rad] of the joints if the indenter stays off the skin; else one that first rises.

    Raises:
        WorkError: both paths lead through the finger.
    """
    indenter = fingers.kinematics.indenter.columns
    first = start_rad.copy()
    first[indenter] = fingers.kinematics.description.home_rad[indenter]
    last = end_rad.copy()
    last[indenter] = first[indenter]
    for between in ([], [first], [last], [first, last]):
        way = np.stack([start_rad, *between, end_rad])
        dense = _spaced(way, np.linspace(0, len(way) - 1, CHECKED))
        torques = np.zeros_like(dense)
        contact = contact_from_joints(fingers.kinematics, dense, torques, indenter_radius_m=radius_m)
        if float(contact.gap_m.min()) >= least_m:
            return way
    raise WorkError(
        "free motion: expected a path from the hand's present angles to the first site on which the indenter stays "
        f"{1e3 * least_m:.1f} mm off the skin; found none. Move the fingers apart, to the hand's home angles, and run "
        "again."
    )


def follow(
    loop: Loop, way_rad: FloatArray, offset_rad: FloatArray, options: CollectOptions, length_m: float = 0.0
) -> None:
    """Move along a path, slowly at both ends, while an offset of the commanded angles fades out."""
    turn = float(np.abs(np.diff(way_rad, axis=0)).max(axis=1).sum())
    time_s = PEAK * max(turn / options.travel_rad_per_s, length_m / options.travel_m_per_s)
    steps = loop.steps(time_s)
    t = np.arange(1, steps + 1) / steps
    smooth = t**3 * (10 - 15 * t + 6 * t**2)
    for share, links in zip(smooth, _spaced(way_rad, smooth * (len(way_rad) - 1)), strict=True):
        loop.step(links + (1 - share) * offset_rad)


def _spaced(way_rad: FloatArray, places: FloatArray) -> FloatArray:
    """Return the angles at positions along a path, counted in waypoints."""
    low = np.minimum(places.astype(int), len(way_rad) - 2)
    share = (places - low)[:, None]
    return (1 - share) * way_rad[low] + share * way_rad[low + 1]


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
        skin, start = session.plan.poses[planned.pose], None if self._place is None else self._place.links_rad
        posture = self._fingers.posture(planned.site, skin, self._options, self._radius_m, start)
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
