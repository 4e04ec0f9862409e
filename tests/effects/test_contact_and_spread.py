"""Laws of the effects at the contact and between the contact and the taxels, whose neighbours go by position."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from effect_sessions import BASE, FINGER, PATCH, SESSION, SKIN, contacts_at, rms, skin_with

from skincal.effects import EffectSkin, Samples
from skincal.effects.samples import Setting
from skincal.effects.spread import Spread
from skincal.errors import InputError
from skincal.model import Patch, Plane, SensorPose, Skin, SkinParameters, Sphere, StressLaw, TaxelLayout

BALL = Sphere(0.006)


def test_stiffening_is_the_skin_with_that_law():
    samples = Samples.of(contacts_at(1e-3, 0.0, [0.5, 3.0]), BALL)
    skin = replace(SKIN, law=StressLaw(1.8, 4e-4))
    values = skin_with("stiffening", exponent=1.8, reference_m=4e-4).values(samples)
    assert np.array_equal(values, skin.values(BALL, samples.contacts))


def test_stiffening_carries_the_same_force():
    layout = TaxelLayout.grid(1, 1, taxel_size_m=0.02, pitch_m=0.02)
    skin = Skin(Patch.build(Plane(), layout, SensorPose(0.0, 0.0), 0.5e-3, 0.0), SkinParameters(4e8, 1.0))
    place = contacts_at(0.0, 0.0, 2.0)
    flat = replace(place, points_m=np.zeros((1, 3)), normals=np.array([[0.0, 0.0, 1.0]]))
    samples = Samples.of(flat, Sphere(0.05))
    for exponent in (0.6, 1.5, 3.0):
        stiff = EffectSkin.of(skin, Plane(), {"stiffening": {"exponent": exponent}})
        # All points face the indenter nearly: the taxel feels nearly all of the force.
        assert stiff.values(samples)[0, 0] == pytest.approx(2.0, rel=0.01)


def test_spread_keeps_the_force_but_for_what_leaves_the_patch():
    weights = Spread().weights(Spread().checked({"width_m": 1e-3}, 16), PATCH)
    assert weights.min() >= 0
    assert weights.sum(axis=1).max() <= 1 + 1e-12
    layout = TaxelLayout.grid(3, 3, taxel_size_m=0.004, pitch_m=0.004)
    patch = Patch.build(FINGER, layout, SensorPose(0.0235, 0.0), 0.5e-3)
    whole = Spread().weights(Spread().checked({"width_m": 0.5e-3}, 9), patch)
    inside = np.abs(patch.uv_m).max(axis=1) < 6e-3 - 5 * 0.5e-3
    np.testing.assert_allclose(whole[inside].sum(axis=1), 1.0, atol=1e-6)


def test_spread_is_the_convolution_with_a_gaussian():
    """A point's weight on a taxel by adding up the Gaussian on a fine grid."""
    width, taxel, point = 0.8e-3, 5, np.argmin(np.linalg.norm(PATCH.uv_m - [-1e-3, -3.2e-3], axis=1))
    weights = Spread().weights(Spread().checked({"width_m": width}, 16), PATCH)
    cells = (np.arange(200) + 0.5) / 200 - 0.5
    centre, size = PATCH.layout.centres_m[taxel], PATCH.layout.sizes_m[taxel]
    u, v = (centre[k] + cells * size[k] - PATCH.uv_m[point, k] for k in range(2))
    gauss = [
        size[k] * np.exp(-(x**2) / (2 * width**2)).mean() / (width * np.sqrt(2 * np.pi))
        for k, x in enumerate((u, v))
    ]
    assert weights[point, taxel] == pytest.approx(gauss[0] * gauss[1], rel=1e-4)
    assert weights[point, taxel] > 0.01


def slender(places_m: np.ndarray, length_m: float) -> SimpleNamespace:
    """Return the parts of a patch that a spread needs: points on a line, one very wide taxel across it."""
    sizes = np.array([[0.1, length_m]])
    points = np.stack([np.zeros(len(places_m)), places_m], axis=-1)
    return SimpleNamespace(uv_m=points, layout=SimpleNamespace(centres_m=np.zeros((1, 2)), sizes_m=sizes))


def test_a_spread_with_a_tail_is_pasternaks_sheet():
    """Across a long taxel, what a sheet carries sideways falls as exp(-|v| / l)."""
    width = 1e-3
    v = np.linspace(-6e-3, 6e-3, 49)
    line = slender(v, 0.002)
    low, high = -1e-3, 1e-3
    shown = Spread().weights(Spread().checked({"width_m": width, "tail": 1.0}, 1), line)[:, 0]
    length = width / np.sqrt(2)

    def below(x: np.ndarray) -> np.ndarray:
        return np.where(
            x < 0, np.exp(np.minimum(x, 0) / length) / 2, 1 - np.exp(-np.maximum(x, 0) / length) / 2
        )

    np.testing.assert_allclose(shown, below(high - v) - below(low - v), atol=0.012)
    gauss = Spread().weights(Spread().checked({"width_m": width}, 1), line)[:, 0]
    assert np.abs(gauss - shown).max() > 0.03


def test_a_tail_does_not_change_how_wide_a_spread_is():
    places = np.linspace(-8e-3, 8e-3, 400)
    line = slender(places, 0.0005)
    for tail in (0.0, 0.03, 0.3, 1.0):
        weights = Spread().weights(Spread().checked({"width_m": 1e-3, "tail": tail}, 1), line)[:, 0]
        variance = (weights * places**2).sum() / weights.sum()
        assert variance == pytest.approx(1e-6, rel=0.06)


def test_a_tail_begins_smoothly():
    """A fit begins where there is none, with differences that are small."""
    line = slender(np.linspace(-4e-3, 4e-3, 60), 0.002)

    def weights(tail: float) -> np.ndarray:
        return Spread().weights(Spread().checked({"width_m": 1e-3, "tail": tail}, 1), line)[:, 0]

    far = (weights(0.05) - weights(0.0)) / 0.05
    for step in (1e-4, 0.009, 0.019, 0.021):
        near = (weights(step) - weights(0.0)) / step
        assert np.linalg.norm(near - far) < 0.2 * np.linalg.norm(far)


def test_spread_needs_a_patch_that_was_cut():
    by_hand = replace(SKIN, patch=replace(PATCH, uv_m=None))
    with pytest.raises(InputError, match="uv_m"):
        EffectSkin.of(by_hand, FINGER, {"spread": {"width_m": 1e-3}}).values(SESSION)


def test_spread_of_a_contact_without_points_is_refused():
    contacted = BASE.contact(SESSION)
    with pytest.raises(ValueError, match="points=True"):
        skin_with("spread").finish(contacted)


def test_stiffening_and_spread_together():
    both = BASE.with_effects({"spread": {"width_m": 1e-3}, "stiffening": {"exponent": 1.5}})
    kept = skin_with("stiffening", exponent=1.5).contact(SESSION, points=True)
    assert np.array_equal(both.finish(kept), both.values(SESSION))
    assert rms(both.values(SESSION) - skin_with("spread", width_m=1e-3).values(SESSION)) > 0.05


def neighbours(layout: TaxelLayout) -> np.ndarray:
    return Setting(Patch.build(Plane(), layout, SensorPose(0.0, 0.0), 1e-3), Plane()).neighbours


@pytest.mark.parametrize("pitch_m", [(4e-3, 4e-3), (3e-3, 5e-3)])
def test_in_a_grid_they_are_the_next_in_row_and_column(pitch_m: tuple[float, float]):
    near = neighbours(TaxelLayout.grid(3, 4, taxel_size_m=2.5e-3, pitch_m=pitch_m))
    row, col = np.divmod(np.arange(12), 4)
    apart = np.abs(row[:, None] - row) + np.abs(col[:, None] - col)
    assert (near == (apart == 1)).all()


def hexagonal(rows: int = 4, cols: int = 4, pitch_m: float = 4e-3) -> TaxelLayout:
    row, col = np.divmod(np.arange(rows * cols), cols)
    centres = np.stack([(col + 0.5 * (row % 2)) * pitch_m, row * pitch_m * np.sqrt(3) / 2], axis=1)
    return TaxelLayout(rows, cols, centres - centres.mean(axis=0), np.full((rows * cols, 2), 2.5e-3))


def test_in_a_hexagonal_layout_they_are_six():
    layout = hexagonal()
    near = neighbours(layout)
    apart = np.linalg.norm(layout.centres_m[:, None] - layout.centres_m, axis=-1)
    assert (near == ((apart > 0) & (apart < 4.1e-3))).all()
    assert near.sum(axis=1).max() == 6


def test_in_any_layout_they_are_mutual_and_reach_all():
    rng = np.random.default_rng(1)
    layout = hexagonal()
    moved = layout.centres_m + rng.uniform(-0.6e-3, 0.6e-3, (16, 2))
    near = neighbours(TaxelLayout(4, 4, moved, np.full((16, 2), 2e-3)))
    assert (near == near.T).all()
    assert (np.linalg.matrix_power(near + np.eye(16), 16) > 0).all()
