"""Checks for taxel values that a converter's words have corrupted: overflow and swapped bytes. Pure numerics.

Both leave marks that no load on a skin makes: readings of one taxel at both ends of a word's range with nothing in
between, or high bytes spread over their whole range while low bytes hardly change.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from skincal.model.arrays import BoolArray, FloatArray, IntArray
from skincal.model.rest import levels_from_presses
from skincal.statistics import TO_SIGMA

WIDTHS: Final = (8, 10, 12, 14, 16, 24, 32)
"""Word sizes that are checked [bit]."""

FEWEST_CELLS: Final = 2
"""Fewest readings at the other end: a single one may be an outlier."""

NEAR_END: Final = 1 / 64
"""Readings that fell below zero lie in this part at the upper end of the range."""

GAINED: Final = 0.15
"""Gain in correlation with the load, when read as unsigned, from which readings have wrapped (set by eye)."""

SHRINKS: Final = {16: 1 / 8, 32: 1 / 512}
"""Bytes are swapped if exchanging them makes the range of most taxels, or of the half of their readings that lie
closest together (mostly rest), smaller by this factor, by the bits of a word. Of 24 bits shifted up in 32, another
order makes it smaller by 1/256 at most."""

SINKS: Final = 6.0
"""Readings so many standard deviations of noise below rest are no noise."""

CHANCE: Final = 1e-3
"""Probability at most that readings below rest are where the load is largest by chance (Mann and Whitney's test)."""

LEAST_DROPPED, MOST_DROPPED = 1e-4, 0.1
"""Bounds of the part of readings that drop out (stated prior, log-uniform)."""

LOAD_BINS: Final = 20
"""Number of load quantiles in which readings are counted (numerical resolution)."""

NOISE_ERROR: Final = 0.15
"""Part by which the noise at rest may be off: it is estimated, and not quite normal (set by eye)."""

RESTS_THERE: Final = 0.9
"""Where more than this part of all readings lie at the top, nothing shows that loads go on at zero (set by eye)."""

KEPT: Final = 0.9
"""Part of a force that is still the same one, with its noise (tolerance)."""

NO_WORD_MENDS: Final = (
    "they came out low and cannot be told from others; press with less force, or leave values out"
)
"""Correction where no type of word mends the readings."""


@dataclass(frozen=True)
class Wrapped:
    """Readings that have wrapped, in words of some bits, of taxels with flat indices.

    ``word`` is the type to read them as (``uint16``, ``int16``, …; the level at rest may be another in it), '' if none
    mends them; ``evidence`` says what separates them from the others, ``mend`` how to correct them.
    """

    bits: int
    word: str
    taxels: IntArray
    readings: int
    evidence: str = "with nothing between"
    mend: str = ""


def find_wrapped(
    counts: FloatArray,
    load: FloatArray | None = None,
    *,
    rests: bool = True,
    image_load: FloatArray | None = None,
) -> Wrapped | None:
    """Return the readings that passed the end of their word and came out at the other end; None if there are none.

    Args:
        counts: readings as stored, shape (n, J).
        load: estimated load of each taxel, in any unit, shape (n, J); it also shows wrapped signed words that fill
            their whole range. None: unknown.
        rests: whether taxels are mostly at rest; under uniform pressure they are not.
        image_load: the same, estimated from the images (:func:`load_from_images`); it also separates drop-outs.
    """
    finite = np.isfinite(counts)
    if not finite.any():
        return None
    low, high = float(counts[finite].min()), float(counts[finite].max())

    def count(kind: Callable[[FloatArray, float], int], size: float) -> IntArray:
        return np.array([kind(column[ok], size) for column, ok in zip(counts.T, finite.T, strict=True)])

    for bits in WIDTHS:
        size = 2.0**bits
        signed, unsigned = f"int{bits}", f"uint{bits}"
        if low < 0 and low >= -size / 2 and high < size / 2:
            # Signed words above half of their range continued at the lower end.
            mend = f"add {size:g} to negative ones"
            found = count(_signed, size)
            if found.sum() >= FEWEST_CELLS:
                return Wrapped(bits, unsigned, np.flatnonzero(found), int(found.sum()), mend=mend)
            negative = finite & (counts < -size / 16)
            some = high > size / 4 and negative.sum() >= FEWEST_CELLS and _whole(counts[finite])
            gained = 0.0
            if load is not None and some:
                gained = correlation(as_word(counts, unsigned), load) - correlation(counts, load)
            if gained > GAINED:
                return _by_load(bits, unsigned, negative, mend)
        elif low >= 0 and high < size:
            found = count(_overflowed, size)
            if found.sum() >= FEWEST_CELLS:
                # Both ends meet in a signed word, where all readings lie below zero and beyond by the same.
                mend = f"add {size:g} to those that came out low"
                return Wrapped(bits, signed, np.flatnonzero(found), int(found.sum()), mend=mend)
            if rests and (below := find_below_zero(counts, load, image_load)) is not None:
                return below
            if load is not None and (lost := _below_rest(counts, load, high / size)).any():
                return _by_load(bits, "", lost, NO_WORD_MENDS)
    return None


def _by_load(bits: int, word: str, wrapped: BoolArray, mend: str) -> Wrapped:
    return Wrapped(
        bits, word, np.flatnonzero(wrapped.any(axis=0)), int(wrapped.sum()), "where the load is largest", mend
    )


def find_below_zero(
    counts: FloatArray, load: FloatArray | None = None, image_load: FloatArray | None = None
) -> Wrapped | None:
    """Return the readings at rest that noise took below zero, to the top of unsigned words; None if there are none.

    Read as signed words they are the lower tail of the noise about levels at rest near zero: about as many as a normal
    distribution has there, and no other readings lie at the top. Readings that drop out to full scale are as many
    whatever the level at rest is. Where loads fill the words, they must show that readings at the top are none.
    Arguments as :func:`find_wrapped`.
    """
    read = np.isfinite(counts)
    if not read.any() or counts[read].min() < 0:
        return None
    bits = next((bits for bits in WIDTHS if counts[read].max() < 2.0**bits), None)
    if bits is None:
        return None
    size = 2.0**bits
    top = counts >= size * (1 - NEAR_END)
    if top.sum() < FEWEST_CELLS or not _whole(counts[top]):
        return None
    signed = np.where(top, counts - size, counts)
    rest = levels_from_presses(signed)
    dark = np.abs(signed - rest.level) < SINKS * np.nan_to_num(rest.scatter)
    if (top & ~dark).any() or top.sum() > RESTS_THERE * read.sum():
        return None
    from scipy.special import gammaln, ndtr, pdtr, pdtrc, xlogy

    # Rounding scatters readings too, and takes below zero what is below minus one half.
    noise = np.sqrt(np.maximum(rest.scatter**2 - 1 / 12, 0.01))
    errors = (1 - NOISE_ERROR, 1 + NOISE_ERROR)
    few, many = sorted(float((dark * ndtr((-0.5 - rest.level) / (noise * error))).sum()) for error in errors)
    if pdtrc(top.sum() - 1, many) < CHANCE or pdtr(top.sum(), few) < CHANCE:
        return None
    # Log odds of wrapped noise at rest against drop-outs, which have any load and any rate.
    number = int(top.sum())
    rate = float(np.clip(number, few, many))
    odds = float(xlogy(number, rate) - rate - gammaln(number + 1))
    odds += float(np.log(number * np.log(MOST_DROPPED / LEAST_DROPPED)))
    odds += 0.0 if image_load is None else load_log_odds(image_load, top, dark & ~top, read)
    if odds < 0 and number < MOST_DROPPED * read.sum():
        return None
    word, evidence, mend = f"int{bits}", "with nothing between", f"take {size:g} off high ones"
    if counts[read & ~top].max(initial=0.0) >= size / 2:
        if load is None or not _less(load[top], load[read & ~dark]):
            return None
        # As signed words the largest loads would turn negative.
        word, evidence = "", "where nothing presses"
        mend = f"take {size:g} off those of {size * (1 - NEAR_END):g} or more where nothing presses"
    return Wrapped(bits, word, np.flatnonzero(top.any(axis=0)), int(top.sum()), evidence, mend)


def find_falls(counts: FloatArray, press: IntArray, force_n: FloatArray) -> Wrapped | None:
    """Return readings that fell by more than half of their word while the force did not; None if there are none.

    Between two frames of a press a load passes the top of its word, and comes out low. A reading that drops out falls
    too, but to rest, or always to the same value; or it returns from full scale, to which it had jumped. The readings
    as stored (n, J) are in the order of time, ``press`` (n,) is -1 at rest, ``force_n`` (n,) measured [N].
    """
    values = counts[np.isfinite(counts)]
    if not values.size or values.min() < 0:
        return None
    bits = next((b for b in WIDTHS if values.max() < 2.0**b), None)
    if bits is None or values.max() < 2.0**bits * (1 - 4 * NEAR_END):
        return None
    size = 2.0**bits
    at_rest = counts[press < 0] if (press < 0).any() else counts
    rest, noise = _rest(at_rest)
    held = (press[1:] == press[:-1]) & (press[1:] >= 0) & (force_n[1:] > KEPT * force_n[:-1])
    falls = held[:, None] & (counts[:-1] - counts[1:] > size / 2)
    falls &= np.abs(counts[1:] - rest) > SINKS * noise
    some = np.flatnonzero(falls.any(axis=0))
    steps, row = np.diff(counts[:, some], axis=0), np.arange(len(counts) - 1)[:, None]
    # A fall after a rise as large is the return of a drop-out: find the last change before each reading.
    last_step = np.take_along_axis(steps, np.maximum.accumulate(np.where(steps != 0, row, 0), axis=0), axis=0)
    falls[1:, some] &= ~(last_step[:-1] > size / 2)
    presses = len(np.unique(press[1:][falls.any(axis=1)]))
    if presses < FEWEST_CELLS or len(np.unique(counts[1:][falls])) < FEWEST_CELLS:
        return None
    return _by_load(bits, "", falls, NO_WORD_MENDS)


def _below_rest(counts: FloatArray, load: FloatArray, filled: float) -> BoolArray:
    """Return readings (n, J) far below rest, if they are where the load is largest and the words are filled.

    Readings that passed the top of their words lie anywhere below the others, most of them among these; the few below
    rest show it.
    """
    none = np.zeros(counts.shape, dtype=np.bool_)
    if filled < 1 - 4 * NEAR_END:
        return none
    rest, noise = _rest(counts)
    both = np.isfinite(counts) & np.isfinite(load)
    sunk = both & (counts < rest - SINKS * noise)
    if sunk.sum() < FEWEST_CELLS:
        return none
    return sunk if _less(load[both & ~sunk], load[sunk]) else none


def _rest(counts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the level at rest of each taxel (J,), and its noise, at least one count."""
    rest = np.nanmedian(counts, axis=0)
    return rest, np.maximum(TO_SIGMA * np.nanmedian(np.abs(counts - rest), axis=0), 1.0)


def _less(load: FloatArray, others: FloatArray) -> bool:
    """Return whether loads (n,) are less than others (m,), by more than chance explains."""
    from scipy.stats import mannwhitneyu  # takes a moment, and few words are filled

    load, others = load[np.isfinite(load)], others[np.isfinite(others)]
    if not (load.size and others.size):
        return False
    return bool(mannwhitneyu(load, others, alternative="less").pvalue < CHANCE)


def load_log_odds(load: FloatArray, chosen: BoolArray, kind: BoolArray, read: BoolArray) -> float:
    """Return the log odds that ``chosen`` readings are of a kind, not spread over all loads.

    ``load`` is the estimated load of each reading, in any unit; ``kind`` are other readings that are known to be of the
    kind, ``read`` those that are present. All are of shape (n, J).
    """
    others, judged = read & ~chosen & np.isfinite(load), chosen & np.isfinite(load)
    if not others.any():
        return 0.0
    edges = np.unique(np.quantile(load[others], np.linspace(0, 1, LOAD_BINS + 1)[1:-1]))
    bins = np.searchsorted(edges, load)
    total = np.bincount(bins[others], minlength=len(edges) + 1)
    of_kind = np.bincount(bins[others & kind], minlength=len(edges) + 1)
    usual = (of_kind.sum() + 0.5) / (total.sum() + 1)
    # One pseudo-count in each bin at the overall rate, so that no load is impossible.
    return float(np.log((of_kind + usual) / (total + 1) / usual)[bins[judged]].sum())


def load_from_images(place_m: FloatArray, force_n: FloatArray, counts: FloatArray) -> FloatArray:
    """Estimate the load of each taxel (n, J) from the images, without the pose or the order of taxels.

    The position of a taxel is the mean contact position, weighted by its signal. Its load is the force times a Gaussian
    of the distance. Contact points (n, 3) are not finite where unknown, forces (n,) are in newtons; of the readings (n,
    J) those near full scale are judged and therefore not used.
    """
    counts = np.where(counts < (1 - NEAR_END) * np.nanmax(counts, initial=0.0), counts, np.nan)
    rest = levels_from_presses(counts)
    signal = np.nan_to_num(counts - rest.level)
    known = np.isfinite(place_m).all(axis=1) & (force_n > 0)
    signal[(signal < SINKS * np.nan_to_num(rest.scatter)) | ~known[:, None]] = 0.0
    answers = signal.sum(axis=0)
    if not answers.any():
        return np.full(counts.shape, np.nan)
    place = np.where(known[:, None], place_m, 0.0)
    centre = (signal.T @ place) / np.where(answers > 0, answers, np.nan)[:, None]
    squares = (place**2).sum(axis=1)[:, None] + (centre**2).sum(axis=1)
    away = np.maximum(squares - 2 * place @ centre.T, 0.0)
    reach = float(np.nansum(signal * away) / answers.sum())
    load = force_n[:, None] * np.exp(-0.5 * away / max(reach, np.finfo(float).tiny))
    return np.where(known[:, None], load, np.nan)


def correlation(counts: FloatArray, load: FloatArray) -> float:
    """Return the correlation of readings (n, J) with loads (n, J), each about its mean; 0 if nothing changes."""
    both = np.isfinite(counts) & np.isfinite(load)
    number = np.maximum(both.sum(axis=0), 1)
    x, y = (np.where(both, one - np.where(both, one, 0).sum(axis=0) / number, 0.0) for one in (counts, load))
    size = float(np.sqrt((x**2).sum() * (y**2).sum()))
    return float((x * y).sum()) / size if size > 0 else 0.0


def _whole(values: FloatArray) -> bool:
    return bool((values == np.rint(values)).all())


def as_word(values: FloatArray, word: str) -> FloatArray:
    """Return readings as unsigned (``uint16``) or signed (``int16``) words of that size, of the same shape."""
    signed = not word.startswith("u")
    size = 2.0 ** int(word.removeprefix("u").removeprefix("int"))
    return np.mod(values + size / 2, size) - size / 2 if signed else np.mod(values, size)


def swapped(values: FloatArray, *, swap_bytes: bool = True, swap_words: bool = False) -> FloatArray:
    """Return whole readings with their bytes in another order, as unsigned words; others stay NaN.

    ``swap_bytes`` exchanges the two bytes of 16 bits, ``swap_words`` the two halves of 32 bits, which the readings then
    have.
    """
    size = 2.0**32 if swap_words else 2.0**16
    words = np.mod(np.where(np.isfinite(values), values, 0), size).astype(np.int64)
    if swap_bytes:
        words = ((words & 0xFF00FF) << 8) | ((words >> 8) & 0xFF00FF)
    if swap_words:
        words = ((words & 0xFFFF) << 16) | (words >> 16)
    return np.where(np.isfinite(values), words.astype(np.float64), np.nan)


def find_byte_order(counts: FloatArray) -> str:
    """Return the lines, under ``[taxels]``, that put the bytes of readings (n, J) in order; '' if none do."""
    word = bytes_swapped(counts)
    if word:
        return "swap_bytes = true" + (', word = "int16"' if word == "int16" else "")
    halves, all_four = (_reordered(counts, 32, swap_bytes=swap) for swap in (False, True))
    word, scatter = min(halves, all_four, key=lambda one: one[1])
    if not word and bytes_swapped(counts / 2**16):
        # No value is above 65535, so that the half that is read as the low one is always zero.
        return "swap_bytes = true, swap_words = true"
    lines = "swap_bytes = true, " * (scatter < halves[1]) + "swap_words = true"
    return lines + (', word = "int32"' if word == "int32" else "") if word else ""


def bytes_swapped(counts: FloatArray) -> str:
    """Return the word type of readings of 16 bits (n, J) whose bytes are swapped; '' if they are not."""
    return _reordered(counts, 16, swap_bytes=True)[0]


def _reordered(counts: FloatArray, bits: int, *, swap_bytes: bool) -> tuple[str, float]:
    """Return the word type of readings (n, J) in another order of bytes, '' if it is right, and their scatter in it."""
    finite, nothing = np.isfinite(counts), ("", np.inf)
    values, size = counts[finite], 2.0**bits
    least = 2.0 ** (bits // 2)
    if len(counts) < 8 or not values.size or values.min() < -size / 2 or not least <= values.max() < size:
        return nothing
    if not _whole(values):
        return nothing
    words = np.where(finite, np.mod(np.where(finite, counts, 0), size), np.nan)
    low = np.mod(words, least)[finite]
    # Values that are shifted up have no meaningful low half: the two orders cannot be told apart.
    alive = finite.sum(axis=0) >= 8
    if not low.any() or not alive.any():
        return nothing
    right = swapped(counts, swap_bytes=swap_bytes, swap_words=bits == 32)[:, alive]
    types = [f"uint{bits}", f"int{bits}"]
    for extent in (lambda values: np.ptp(np.nanquantile(values, (0.02, 0.98), axis=0), axis=0), _shorth):
        extent_now = np.minimum(extent(words[:, alive]), extent(as_word(words[:, alive], types[1])))
        extents = {word: extent(as_word(right, word)) for word in types}
        moves = extent_now > 0
        word = min(extents, key=lambda name: float(np.median(extents[name])))
        shrunk = extents[word][moves] / extent_now[moves]
        # Bytes that belong to two taxels get worse in some: no order of bytes mends those.
        if moves.any() and float(np.median(shrunk)) < SHRINKS[bits] and float(np.quantile(shrunk, 0.9)) < 1:
            return word, float(np.nanstd(as_word(right, word)))
    return nothing


def _shorth(values: FloatArray) -> FloatArray:
    """Return the length of the shortest interval that holds half of the readings of each taxel (J,)."""
    ordered = np.sort(values, axis=0)  # NaN last
    half = np.isfinite(values).sum(axis=0) // 2
    row = np.arange(len(values))[:, None]
    ends = np.take_along_axis(ordered, np.minimum(row + half, len(values) - 1), axis=0)
    return np.nanmin(np.where(row + half < len(values), ends - ordered, np.inf), axis=0)


def _groups(values: FloatArray, size: float) -> tuple[FloatArray, FloatArray]:
    """Return the readings below and above a gap of more than half of the range; none below if there is no such gap."""
    ordered = np.sort(values)
    gaps = np.flatnonzero(np.diff(ordered) > size / 2)
    at = int(gaps[0]) + 1 if gaps.size else 0
    return ordered[:at], ordered[at:]


def _signed(values: FloatArray, size: float) -> int:
    """Return how many readings of a taxel lie below zero, with a gap to the others."""
    low, high = _groups(values, size)
    return len(low) if len(low) and low[-1] < 0 <= high[0] else 0


def _overflowed(values: FloatArray, size: float) -> int:
    """Return how many readings of a taxel that rests high passed the top when it was pressed hard."""
    low, high = _groups(values, size)
    if not len(low):
        return 0
    rest = float(np.median(high))
    rises, sinks = float(high[-1] - rest), float(rest - high[0])
    climbed = rises > size * NEAR_END and high[-1] > size * (1 - 4 * NEAR_END)
    # Rest close to the top leaves little room to climb; there the readings go on at the other end.
    spread = float(low[-1] - low[0])
    goes_on = spread > 3 * sinks and low[-1] < size / 4 and size - high[-1] + low[0] < max(rises, spread)
    return len(low) if len(low) < len(high) and rises > 3 * sinks and (climbed or goes_on) else 0
