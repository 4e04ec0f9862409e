"""Contact history of a simulated skin in a file, so that the skin of a resumed session remembers it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skincal.bounded import UnreadableError, read_bytes
from skincal.errors import input_error
from skincal.model.arrays import FloatArray
from skincal.sim.touch import TrueContact

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
        contact: the true contact.
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
