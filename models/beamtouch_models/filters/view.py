"""Views of the readings of means, as they came and with lone spikes replaced; and which of them shows motion."""

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.means import BEFORE, FloatArray, lone_spikes
from beamtouch_models.filters.significance import LONGER_SLOPES, Found, Look, look_at

MAX_MISSING = 1 / 2
"""Part of the readings of a channel that may be missing where rest is to be proved."""


class Tidied(NamedTuple):
    """Rows of readings with spikes replaced."""

    rows: FloatArray
    """Readings as they entered the mean, or with lone spikes replaced, shape (rows, channels)."""
    changed: NDArray[np.bool_]
    """Which rows were changed, shape (rows,)."""
    newest: NDArray[np.bool_]
    """Of which means the newest reading was replaced, or is doubtful, shape (means,)."""

    @classmethod
    def of(cls, rows: FloatArray, past: FloatArray, cleaned: FloatArray, spike_mm: float | None) -> Self:
        """Return the rows, tidied.

        Parameters
        ----------
        rows
            Readings as they came, shape (rows, channels).
        past
            Those before the newest ones, tidied.
        cleaned
            The newest ones, as they entered the mean.
        spike_mm
            Distance of a lone spike from the median, if the mean leaves out spikes itself; None: `cleaned` lacks them.
        """
        if spike_mm is None:
            clean = np.concatenate([past, cleaned])
            changed: NDArray[np.bool_] = np.any(np.abs(rows - clean) > 0, axis=1)  # False for NaN
            return cls(clean, changed, changed[len(past) :])
        # Whether a reading was a spike shows when the next one has come.
        recent = rows[-len(cleaned) - BEFORE :]
        held, spikes, medians = lone_spikes(recent, spike_mm)
        judged = np.where(spikes, medians, recent) if spikes.any() else recent
        clean = np.concatenate([past[:-1], judged[BEFORE - 1 :]])
        return cls(clean, np.any(np.abs(rows - clean) > 0, axis=1), held[BEFORE:])


class View(NamedTuple):
    """What the last readings show about means."""

    deviations: FloatArray
    """Deviations of the readings from each mean [mm], shape (means, rows, channels); 0 if missing."""
    known: NDArray[np.bool_] | None
    """Which readings there are, of the same shape; None: all."""
    missing: FloatArray | None
    """Part of the compared readings that each channel lacks since the first reading of any; None: nothing."""
    found: Found

    def or_else(self, other: "View", own: NDArray[np.bool_]) -> "View":
        """Return a view that is another one except for some means. The same readings are missing in both."""
        columns = zip(self.found, other.found, strict=True)
        found = Found(*(np.where(own.reshape(-1, *[1] * (one.ndim - 1)), one, another) for one, another in columns))
        deviations = np.where(own[:, np.newaxis, np.newaxis], self.deviations, other.deviations)
        return View(deviations, self.known, self.missing, found)


def decide(
    raw: Found, tidy: Found, as_came: NDArray[np.bool_], newest: NDArray[np.bool_], *, moved: bool
) -> tuple[NDArray[np.bool_], bool]:
    """Return which means move, and whether the last one did; a newest reading that was replaced does not show that.

    Marks in `as_came` the means whose readings count as they came.
    """
    moves = as_came.copy()
    for index in range(len(moves)):
        as_came[index] |= moved
        found = raw if as_came[index] else tidy
        moves[index] |= found.moves[index] or (moved and found.lingers[index])
        if not newest[index]:
            moved = bool(moves[index])
        moves[index] |= newest[index]
    return moves, moved


class Sizes(NamedTuple):
    """Sizes of means."""

    spans: list[int]
    """Number of readings in each mean that are looked at."""
    variance: FloatArray
    """Relative variance of the noise of its least noisy channel, shape (means,)."""

    @classmethod
    def of(cls, variance: FloatArray, longest: int, *, restarts: bool) -> Self:
        """Return the sizes of means whose noise has a variance (means, channels), NaN for a channel without a value.

        At most `longest` readings are looked at; that many always if the mean never restarts.
        """
        least = variance.min(axis=1)
        if np.isnan(least).any():
            least = np.where(np.isnan(variance), 1.0, variance).min(axis=1)
        if not restarts:
            return cls([longest] * len(least), least)
        spans: list[int] = np.minimum(np.ceil(1 / least - 1e-9), longest).astype(np.intp).tolist()
        return cls(spans, least)


class Looks:
    """Looks at the readings of each mean.

    Parameters
    ----------
    span
        Largest number of readings in a mean that are looked at.
    still
        Number of readings that must agree to prove rest, if the mean is of fewer.
    slope
        Smallest number of readings in which slopes are looked for.
    unit_mm
        Standard deviation of a reading, shape (channels,).
    lag_readings
        Fewest newest readings whose distance from the mean counts as its lag; None: nothing does.
    """

    def __init__(self, span: int, still: int, slope: int, unit_mm: FloatArray, lag_readings: int | None) -> None:
        self._span, self._still, self._slope = span, still, slope
        self._unit_mm, self._lag_readings = unit_mm, lag_readings
        self.rows = max(LONGER_SLOPES[-1] * slope, span + self.compared(span))
        """Number of rows that are looked at."""

    def view(self, rows: FloatArray, mean: FloatArray, sizes: Sizes, *, moved: bool) -> View:
        """Return what the last readings (means, rows, channels) show about each mean."""
        deviations = rows - mean[:, np.newaxis]
        if not np.isnan(deviations.sum()):
            return View(deviations, None, None, self._find(deviations, mean.shape[1], sizes, moved=moved))
        known, there = ~np.isnan(deviations), ~np.isnan(mean)
        deviations[~known] = 0.0
        begun = np.logical_or.accumulate(known.any(axis=2), axis=1)
        missing = (begun[:, :, np.newaxis] & ~known)[:, -self.compared(self._span) :].mean(axis=1)
        found = self._find(deviations, there.sum(axis=1), sizes, moved=True)
        moves = found.moves | ((missing > MAX_MISSING) & there).any(axis=1)
        return View(deviations, known, missing, found._replace(moves=moves))

    def compared(self, span: int) -> int:
        """Return the number of readings that must agree to prove rest."""
        return max(span, self._still)

    def _find(self, deviations: FloatArray, working: NDArray[np.intp] | int, sizes: Sizes, *, moved: bool) -> Found:
        """Return what the tests find in the deviations."""
        units = deviations / self._unit_mm
        spans, variance = sizes
        kinds = set(spans)
        if len(kinds) == 1:
            return self.look(spans[0]).find(units, working, variance, moved=moved)
        flags = np.empty((2, len(units)), dtype=np.bool_)
        found = Found(flags[0], flags[1], np.empty(len(units)), np.empty_like(units[:, 0]), np.empty_like(units[:, 0]))
        for span in kinds:
            at = np.flatnonzero(np.array(spans) == span)
            there = working if isinstance(working, int) else working[at]
            part = self.look(span).find(units[at], there, variance[at], moved=True)
            for whole, values in zip(found, part, strict=True):
                whole[at] = values
        return found

    def look(self, span: int) -> Look:
        """Return the contrasts that are tested for a mean of this number of readings."""
        return look_at(self.compared(span), self._slope, self.rows, len(self._unit_mm), self._lag_readings)
