"""Blocks are the algebra of whole covariances, written down press by press."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skincal.inference.blocks import Rows, Whitened, blocks
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.null import add_laws, law_parts
from skincal.inference.score import full_step, gains, held_out, whole
from skincal.inference.slopes import Slopes

PRESSES, ROWS, TAXELS, COLUMNS = 3, 5, 4, 2
PRECISION = 1 / np.array([1e-3, 2e-3, 0.02]) ** 2


def case() -> tuple[Whitened, np.ndarray, np.ndarray, np.ndarray]:
    """Three presses of five observations, and two moments of rest."""
    rng = np.random.default_rng(4)
    press = np.append(np.repeat(np.arange(PRESSES), ROWS), [-1, -1])
    phase = np.append(np.tile([1, 1, 2, 2, 3], PRESSES), [0, 0])
    n = len(press)

    def some(*shape: int, size: float = 1.0) -> np.ndarray:
        return size * rng.standard_normal((n, TAXELS, *shape))

    w = Whitened(
        some(), Slopes.of(some(COLUMNS)), some(3) * [300.0, 300.0, 5.0], some(size=40.0), some(1, size=0.6),
        np.ones((n, TAXELS), dtype=bool), some(size=0.1),
    )  # fmt: skip
    w.press[press < 0] = 0.0
    return w, press, phase, 1e-4 * rng.standard_normal((PRESSES, 3))


def whole_covariance(w: Whitened, rows: np.ndarray, phase: np.ndarray, moved: float = 1.0) -> np.ndarray:
    """Of the values of a press: noise, its own numbers, an error of the image, one of the equation in each phase."""
    n = w.press[rows].reshape(-1, 3)
    found = np.eye(len(n)) + moved * n @ np.diag(1 / PRECISION) @ n.T
    for j in range(TAXELS):
        image = np.zeros((len(rows), TAXELS))
        image[:, j] = w.signal[rows, j]
        found += C.image**2 * np.outer(image.ravel(), image.ravel())
    for part in np.unique(phase[rows]):
        own = (w.own[rows, :, 0] * (phase[rows] == part)[:, None]).ravel()
        found += np.outer(own, own)
    return found


def test_they_are_what_the_whole_covariance_says():
    w, press, phase, at = case()
    found = blocks(w, Rows.of(press, phase, w.seen), at, PRECISION)
    for k, p in enumerate(found.press):
        rows = np.flatnonzero(press == p)
        if p < 0:
            continue
        inverse = np.linalg.inv(whole_covariance(w, rows, phase))
        c = w.columns.array()[rows].reshape(-1, COLUMNS)
        # The residual is that at the press's own numbers: at none it is what they add, too.
        e = w.residual[rows].ravel() + w.press[rows].reshape(-1, 3) @ at[p]
        assert found.h[k] == pytest.approx(c.T @ inverse @ c, rel=1e-8)
        assert found.b[k] == pytest.approx(c.T @ inverse @ e, rel=1e-8)
        assert found.chi[k] == pytest.approx(e @ inverse @ e, rel=1e-8)
        _, log_det = np.linalg.slogdet(whole_covariance(w, rows, phase))
        beside = log_det + 2 * w.log_sd[rows].sum()
        assert (found.loss - found.ahead - found.chi)[k] == pytest.approx(beside, rel=1e-8)
        # With its own numbers where they are.
        here, r = np.linalg.inv(whole_covariance(w, rows, phase, moved=0.0)), w.residual[rows].ravel()
        assert found.loss[k] == pytest.approx(r @ here @ r + at[p] ** 2 @ PRECISION + beside, rel=1e-8)


def test_drawn_sessions_leave_one_square_a_value():
    w, press, phase, at = case()
    rng = np.random.default_rng(0)
    draws = rng.standard_normal((*w.residual.shape, 4000))
    found = blocks(w, Rows.of(press, phase, w.seen), at, PRECISION, draws, rng)
    assert found.drawn_chi.mean(axis=1) == pytest.approx(found.count, rel=0.05)
    # b of a null session has the curvature for its covariance.
    for h, b in zip(found.h, found.drawn, strict=True):
        assert np.cov(b) == pytest.approx(h, abs=0.1 * np.abs(h).max())


def test_taxels_that_were_not_read_have_no_say():
    w, press, phase, at = case()
    seen = w.seen.copy()
    seen[2, 1] = False
    cut = replace(
        w, seen=seen, residual=w.residual * seen, columns=w.columns.weighted(1.0 * seen),
        press=w.press * seen[..., None], signal=w.signal * seen, own=w.own * seen[..., None],
    )  # fmt: skip
    changed = replace(cut, log_sd=np.where(seen, w.log_sd, 7.0))
    a, b = (blocks(x, Rows.of(press, phase, x.seen), at, PRECISION) for x in (cut, changed))
    assert a.loss == pytest.approx(b.loss) and a.count.sum() == b.count.sum() == seen.sum()


def some_single() -> tuple[Whitened, Whitened]:
    """The case with columns of one taxel between those of all taxels, compact and as full arrays."""
    w, *_ = case()
    rng = np.random.default_rng(8)
    one = [Slopes.of_taxel(rng.standard_normal(len(w.seen)), j, TAXELS) for j in (2, 0, 2, 3, 2)]
    dense = w.columns.dense
    parts = [Slopes.of(dense[..., :1]), *one[:3], Slopes.of(dense[..., 1:]), *one[3:]]
    compact = Slopes.joined(parts)
    assert compact.single.shape[1] == len(one)
    return replace(w, columns=compact), replace(w, columns=Slopes.of(compact.array()))


def test_columns_of_one_taxel_are_columns_like_others():
    (compact, full), (_, press, phase, at) = some_single(), case()
    draws = np.random.default_rng(1).standard_normal((*full.residual.shape, 6))
    rows = Rows.of(press, phase, full.seen)
    a, b = (blocks(w, rows, at, PRECISION, draws, np.random.default_rng(2)) for w in (compact, full))
    for name in ("h", "b", "loss", "ahead", "chi", "drawn", "drawn_chi"):
        assert getattr(a, name) == pytest.approx(getattr(b, name), rel=1e-9, abs=1e-9), name
    assert a.moves == pytest.approx(b.moves, rel=1e-9, abs=1e-12)
    some, others = np.array([4, 1, 3]), np.array([0, 3, 1, 6])
    assert a.products.between(some, others) == pytest.approx(a.h[:, some][:, :, others])


def test_multiples_of_columns_are_those_of_the_whole():
    compact, full = (w.columns for w in some_single())
    c = np.arange(1.0, 8.0)
    assert compact.times(c) == pytest.approx(full.times(c))


def test_a_number_that_one_block_shows_is_integrated_out():
    """One number, told by the first of six blocks: its evidence is that of the Gaussian integral."""
    h, b = np.zeros((C.folds, 1, 1)), np.zeros((C.folds, 1, 1))
    h[0], b[0] = 400.0, 400.0 * 3.0
    wide = np.array([1.0])
    gained = held_out(h, b, wide, 0 * wide, np.arange(C.folds))[:, 0]
    at = np.linspace(-10.0, 10.0, 200_001)
    shown = np.exp(b[0, 0] * at - 0.5 * h[0, 0] * at**2 - 0.5 * at**2 - gained[0]) / np.sqrt(2 * np.pi)
    assert shown.sum() * (at[1] - at[0]) == pytest.approx(1.0) and gained[0] > 1700
    assert gained[1:] == pytest.approx(0.0)


def test_gains_are_those_of_fits_with_and_without():
    (compact, _), (_, press, phase, at) = some_single(), case()
    draws = np.random.default_rng(1).standard_normal((*compact.residual.shape, 3))
    found = blocks(
        compact, Rows.of(press, phase, compact.seen), at, PRECISION, draws, np.random.default_rng(2)
    )
    prior, pull = np.array([0.5, 2.0]), np.array([0.3, -0.2])
    sigma = [np.array([1.0, 0.5]), np.array([2.0]), np.array([0.1, 3.0])]
    folds = np.arange(len(found.press)) % C.folds
    h = found.h
    without = held_out(h[:, :2, :2], found.drawn[:, :2], prior, pull, folds)
    for s, own, each in zip(
        sigma, ([2, 3], [4], [5, 6]), gains(found, found.drawn, prior, pull, sigma, folds), strict=True
    ):
        k = np.array([0, 1, *own])
        all_prior, all_pull = np.append(prior, 1 / s**2), np.append(pull, 0 * s)
        with_it = held_out(h[:, k][:, :, k], found.drawn[:, k], all_prior, all_pull, folds)
        assert each == pytest.approx(with_it - without, rel=1e-6, abs=1e-9)
        step = np.linalg.solve(
            h[:, k][:, :, k].sum(axis=0) + np.diag(all_prior), found.b[:, k].sum(axis=0) - all_pull
        )
        assert full_step(*whole(found, k), all_prior, all_pull) == pytest.approx(step)


def test_products_of_the_whole_are_the_sum_of_those_of_blocks():
    (compact, _), (_, press, phase, at) = some_single(), case()
    found = blocks(compact, Rows.of(press, phase, compact.seen), at, PRECISION).products
    some, others = np.array([4, 1, 3]), np.array([0, 3, 1, 6])
    assert found.whole.between(some, others)[0] == pytest.approx(found.between(some, others).sum(axis=0))


def test_null_sessions_have_as_much_of_a_law_as_they_are_given():
    w, press, phase, at = case()
    rng = np.random.default_rng(5)
    law, draws = (rng.standard_normal((*w.residual.shape, k)) for k in (2, 3))
    parts = np.array([[0.3, 0.0, 0.0], [0.0, 0.9, 0.0]])
    beside = replace(w, columns=Slopes.joined([w.columns, Slopes.of(law)]))
    rows = Rows.of(press, phase, w.seen)
    found = blocks(beside, rows, at, PRECISION, draws, np.random.default_rng(2))
    drawn = blocks(beside, rows, at, PRECISION, draws + law @ parts, np.random.default_rng(2))
    b, chi = add_laws(found, parts)
    assert b == pytest.approx(drawn.drawn) and chi == pytest.approx(drawn.drawn_chi)


def test_a_session_says_how_much_of_a_law_it_can_have():
    """Beside an effect that is there, too, which without it would be taken for the contrary of the law."""
    rng, n, part = np.random.default_rng(6), 60, 0.4
    press, phase = np.repeat(np.arange(12), 5), np.ones(n, dtype=np.int64)
    base, effect, law = rng.standard_normal((3, n, TAXELS, 1))
    law, noise = law - 0.8 * effect, 0.02 * rng.standard_normal((n, TAXELS))
    columns = Slopes.of(np.concatenate([base, effect, law], axis=2))
    seen, none = np.ones((n, TAXELS), dtype=bool), np.zeros((n, TAXELS, 0))

    def parts(hidden: float) -> np.ndarray:
        residual = base[..., 0] + hidden * effect[..., 0] + part * law[..., 0] + noise
        w = Whitened(
            residual / 0.02,
            columns.weighted(np.full((n, TAXELS), 50.0)),
            np.zeros((n, TAXELS, 3)),
            none.sum(axis=2),
            none,
            seen,
            np.zeros((n, TAXELS)),
        )
        found = blocks(w, Rows.of(press, phase, seen), np.zeros((12, 3)), PRECISION)
        return law_parts(found, np.full(1, 1e-9), np.zeros(1), np.ones(1), 1)

    assert parts(0.0) == pytest.approx([part], abs=0.01)
    assert parts(3.0) == pytest.approx([part], abs=0.01)
    assert parts(-3.0) == pytest.approx([1.0])
