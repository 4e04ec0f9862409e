"""Results that show themselves in a notebook."""

from __future__ import annotations

from importlib import import_module


class Shown:
    """A result with a card of its own in :mod:`skincal.report.cards`.

    The report is imported when a notebook asks for the card, and by its name: what computes a result knows nothing of
    how it is shown.
    """

    def _repr_html_(self) -> str:
        return import_module("skincal.report.cards").card(self)
