"""The true contact of the simulated hand, and its memory of touches between sessions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skincal.bounded import UnreadableError, read_bytes
from skincal.dataset.dataset import pose_of
from skincal.errors import input_error
from skincal.model import Contacts
from skincal.model.arrays import FloatArray
from skincal.robot import Kinematics
from skincal.robot.kinematics import contact_rows


@dataclass(frozen=True, eq=False)
class TrueContact:
    """True contact at one moment; positions and vectors are in the fingertip frame.

    Attributes:
        point_m: (3,) the point of the surface nearest to the indenter [m].
        normal: (3,) unit normal there.
        shear_u_n: force on the skin towards growing beta [N].
        shear_v_n: force on the skin along +y [N].
        gap_m: distance of sphere and surface at rest; negative where it penetrates [m].
        q_rad: (n,) true angles of the links [rad].
    """

    time_s: float
    point_m: FloatArray
    normal: FloatArray
    force_n: float
    shear_u_n: float
    shear_v_n: float
    gap_m: float
    q_rad: FloatArray

    @property
    def touching(self) -> bool:
        """True if there is a force."""
        return self.force_n > 0

    def contacts(self) -> Contacts:
        """Return the contact in the form of the skin model."""
        return Contacts(self.point_m[None], self.normal[None], np.array([self.force_n]))


def true_contact(
    kinematics: Kinematics, time_s: float, q_rad: FloatArray, force_root_n: FloatArray
) -> TrueContact:
    """Return the contact at true angles of the links.

    Args:
        kinematics: the hand.
        time_s: its clock [s].
        q_rad: (n,) true angles [rad].
        force_root_n: (3,) force on the skin, root frame [N].
    """
    row = contact_rows(kinematics, q_rad[None], np.zeros((1, len(q_rad))))[0][0]
    normal = row[3:6]
    x, y, z = (force_root_n @ kinematics.skin_frames(q_rad).rotations[0]).tolist()
    return TrueContact(
        time_s=time_s,
        point_m=row[:3],
        normal=normal,
        force_n=max(0.0, -float(x * normal[0] + y * normal[1] + z * normal[2])),
        shear_u_n=float(x * normal[2] - z * normal[0]),
        shear_v_n=y,
        gap_m=float(row[9]) - kinematics.description.indenter_radius_m,
        q_rad=q_rad,
    )


def contact_stiffness(kinematics: Kinematics, elasticity_pa_per_m: float, force_n: float) -> float:
    """Return the force over depth of the hand's indenter in its skin at some force [N/m]."""
    hand = kinematics.description
    pose = pose_of(hand.meta.mount)
    return kinematics.surface.ball_stiffness(pose, hand.indenter_radius_m, elasticity_pa_per_m, force_n)


MAGIC = b"skinmem1"
"""First bytes of the file; rows of float64 follow."""

MOST_BYTES = 1 << 30
"""Largest size of the file: four million looks."""

_FIXED = 11
"""Number of values in a row for every hand: time, point, normal, force, shear (u, v), gap."""


@dataclass(frozen=True, eq=False)
class Look:
    """State of the contact when an image was taken.

    Attributes:
        q_rad: angles (n,) where the hand measures them, without noise [rad].
        tau_nm: torques (n,) of the drives [N m].
    """

    contact: TrueContact
    q_rad: FloatArray
    tau_nm: FloatArray


class SkinMemory:
    """The looks of a session in a file that is complete up to any end of the process.

    Raises:
        InputError: the file is of another kind.
    """

    def __init__(self, path: Path, joints: int) -> None:
        width = _FIXED + 3 * joints
        try:
            content = read_bytes(path, MOST_BYTES) if path.exists() else b""
        except UnreadableError as error:
            raise input_error(str(path), error.expected, error.got) from None
        if not MAGIC.startswith(content[: len(MAGIC)]):
            raise input_error(str(path), "the contact history of a simulated skin", "another file")
        # The last row may be incomplete.
        rows = max(0, len(content) - len(MAGIC)) // (8 * width)
        end = len(MAGIC) + 8 * rows * width
        self.past = [_look(row) for row in np.frombuffer(content[len(MAGIC) : end]).reshape(-1, width)]
        # No buffer: what is written stays even if the process is killed.
        self._file = path.open("ab", buffering=0)
        self._file.truncate(end if rows else 0)
        if not rows:
            self._file.write(MAGIC)

    @property
    def end_s(self) -> float:
        """Time of the last image [s]; minus infinity without one."""
        return self.past[-1].contact.time_s if self.past else -np.inf

    def keep(self, look: Look) -> None:
        """Append a look."""
        c = look.contact
        row = [c.time_s, *c.point_m, *c.normal, c.force_n, c.shear_u_n, c.shear_v_n, c.gap_m]
        self._file.write(np.array([*row, *c.q_rad, *look.q_rad, *look.tau_nm]).tobytes())

    def close(self) -> None:
        """Close the file; may be called twice."""
        self._file.close()


def _look(row: FloatArray) -> Look:
    true, measured, torques = np.split(row[_FIXED:], 3)
    time_s, force_n, shear_u_n, shear_v_n, gap_m = (float(row[i]) for i in (0, 7, 8, 9, 10))
    contact = TrueContact(time_s, row[1:4], row[4:7], force_n, shear_u_n, shear_v_n, gap_m, true)
    return Look(contact, measured, torques)
