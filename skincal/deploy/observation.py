"""Observations of a policy, assembled as its description specifies."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skincal.errors import InputError, Problem


class PolicyObservation:
    """Observation of a policy: present and past quantities, concatenated in the order of its description.

    Args:
        parts: parts of the observation from the description: ``name``, ``size``, ``steps_ago``.
        sizes: sizes of the quantities that the hand and the task provide, by name; others are refused.
        file: file of the policy, for errors.

    Raises:
        InputError: a part is unknown or has another size: the policy is for another hand or task.
    """

    def __init__(self, parts: Sequence[Mapping[str, Any]], sizes: Mapping[str, int], file: str) -> None:
        self._order = [(str(part["name"]), int(part.get("steps_ago", 0))) for part in parts]
        problems: list[Problem] = []
        for name, size in ((part["name"], part["size"]) for part in parts):
            if name not in sizes:
                problems.append(Problem(file, f"a policy that sees {', '.join(sizes)}", f'"{name}"'))
            elif int(size) != sizes[name]:
                expected = f"{sizes[name]} values of {name}, as this hand and task have"
                problems.append(Problem(file, expected, f"{size}; the policy is for another hand or task"))
        if problems:
            raise InputError(list(dict.fromkeys(problems)))
        self._past: deque[dict[str, NDArray[np.float64]]] = deque(maxlen=1 + max(a for _, a in self._order))

    @property
    def has_image(self) -> bool:
        """True if the policy observes the tactile image."""
        return any(name == "image" for name, _ in self._order)

    def next(self, values: Mapping[str, ArrayLike]) -> NDArray[np.float32]:
        """Return the next observation. At the first step, the present values also fill the past.

        Args:
            values: present quantities by name; NaN is replaced by 0.
        """
        now = {name: np.nan_to_num(np.asarray(value, dtype=np.float64)) for name, value in values.items()}
        self._past.append(now)
        while len(self._past) < (self._past.maxlen or 1):
            self._past.appendleft(now)
        return np.concatenate([self._past[-1 - ago][name] for name, ago in self._order]).astype(np.float32)
