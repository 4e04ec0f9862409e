"""Lookup of a hand, by name or by file."""

from __future__ import annotations

from pathlib import Path

from skincal.errors import input_error
from skincal.robot.description import HandDescription
from skincal.robot.hand_file import read_hand

DEFAULT_HAND = "dlr_hand_2"
"""Thumb and forefinger after the DLR-Hand II."""


def bundled_hand(name: str = DEFAULT_HAND) -> HandDescription:
    """Return the description of a bundled hand.

    Raises:
        InputError: there is no bundled hand of that name.
    """
    folder = Path(__file__).parent / "hands"
    known = sorted(path.parent.name for path in folder.glob("*/hand.toml"))
    if name not in known:
        raise input_error("hand", f"one of {', '.join(known)}", f'"{name}"')
    return read_hand(folder / name)


def hand_named(hand: str | Path = DEFAULT_HAND) -> HandDescription:
    """Return the description of a hand: a bundled one by name, or a ``hand.toml``, or its folder.

    Raises:
        InputError: there is no hand of that name, or the file is invalid.
    """
    path = Path(hand).expanduser()
    return read_hand(path) if path.exists() or path.suffix or len(path.parts) > 1 else bundled_hand(str(hand))
