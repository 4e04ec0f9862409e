"""Pictures of what effects do, in the documentation."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from skincal.effects import EFFECTS
from skincal.errors import InputError
from skincal.report.style import png_bytes

SOURCE = Path(__file__).parents[1] / "docs" / "_ext" / "signatures.py"
spec = importlib.util.spec_from_file_location("signatures", SOURCE)
assert spec is not None and spec.loader is not None
signatures = sys.modules["signatures"] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(signatures)
signature, signature_figure = signatures.signature, signatures.signature_figure


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_shows_in_its_picture(name: str):
    found = signature(name)
    assert found.change.shape == (4, 4)
    assert np.abs(found.change).max() > 2
    difference = max(np.abs(c.changed - c.base).max() for c in found.curves)
    assert difference > 2, "the curves show it too"
    none = signature(name, strength=0.0)
    assert not none.change.any()
    for curve in none.curves:
        np.testing.assert_array_equal(curve.base, curve.changed)


def test_what_makes_an_effect_is_seen():
    loop = signature("hysteresis").curves[0]
    assert loop.changed.max() == pytest.approx(loop.base.max())
    cross = signature("crosstalk").change
    assert (np.count_nonzero(np.abs(cross) > 5), np.count_nonzero(cross < -1e-9)) == (4, 0)
    slow, fast = signature("rate").curves
    assert slow.base[-1] < slow.changed[-1] < fast.changed[-1]
    late = signature("latency").curves[0]
    assert np.argmax(late.changed > 1) > np.argmax(late.base > 1)
    touches = signature("first_cycle").curves[0]
    assert touches.changed[0] > 1.2 * touches.changed[-1]


@pytest.mark.parametrize("name", ["creep", "taxel_gain", "force_bias"])
def test_a_figure_has_curves_and_a_map(name: str):
    figure = signature_figure(name)
    assert len(figure.axes) == 3
    assert len(png_bytes(figure)) > 5000


@pytest.mark.parametrize(
    ("name", "label"), [("cover", "force [N]"), ("creep", "time [s]"), ("hysteresis", "time [s]")]
)
def test_an_effect_without_values_is_drawn(name: str, label: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(signatures, "_VIEWS", MappingProxyType({}))
    assert signature(name).x_label == label


def test_no_such_effect():
    with pytest.raises(InputError, match="Did you mean creep"):
        signature("crep")
