"""What has touched a simulated skin, kept in a file: a session that goes on does so with a skin that remembers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skincal.bounded import UnreadableError, read_bytes
from skincal.errors import InputError, Problem
from skincal.sim.touch import TrueContact

FloatArray = NDArray[np.float64]

MAGIC = b"skinmem1"
"""The file begins with this; rows of float64 follow."""

MOST_BYTES = 1 << 30
"""Of the file: four million looks."""

_FIXED = 11
"""Numbers of a row that every hand has: time, point, normal, force, shear (u, v), gap."""


@dataclass(frozen=True, eq=False)
class Look:
    """What was there when an image was taken.

    Attributes:
        contact: what truly touched.
        q_rad: angles (n,) where the hand measures them, without noise [rad].
        tau_nm: torques (n,) of the drives [N m].
    """

    contact: TrueContact
    q_rad: FloatArray
    tau_nm: FloatArray


class SkinMemory:
    """The looks of a session in a file that is there as far as it got, whatever ends the process.

    Args:
        path: the file; made where there is none.
        joints: number of the hand's joints.

    Raises:
        InputError: the file is something else.
    """

    def __init__(self, path: Path, joints: int) -> None:
        width = _FIXED + 3 * joints
        try:
            content = read_bytes(path, MOST_BYTES) if path.exists() else b""
        except UnreadableError as error:
            raise InputError([Problem(str(path), error.expected, error.got)]) from None
        if not MAGIC.startswith(content[: len(MAGIC)]):
            raise InputError([Problem(str(path), "what a simulated skin remembers", "another file")])
        # The last row may have been cut off.
        rows = max(0, len(content) - len(MAGIC)) // (8 * width)
        end = len(MAGIC) + 8 * rows * width
        self.past = [_look(row) for row in np.frombuffer(content[len(MAGIC) : end]).reshape(-1, width)]
        # No buffer: what is written is there even if the process is killed.
        self._file = path.open("ab", buffering=0)
        self._file.truncate(end if rows else 0)
        if not rows:
            self._file.write(MAGIC)

    @property
    def end_s(self) -> float:
        """When the last image was taken [s]; minus infinity where there is none."""
        return self.past[-1].contact.time_s if self.past else -np.inf

    def keep(self, look: Look) -> None:
        """Keep another look."""
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
