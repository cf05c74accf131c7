"""Views of the readings of means, as they came and with lone spikes replaced; and which of them shows motion."""

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.means import BEFORE, FloatArray, lone_spikes, windows
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
    raw: Found,
    tidy: Found,
    as_came: NDArray[np.bool_],
    newest: NDArray[np.bool_],
    absent: NDArray[np.bool_],
    *,
    moved: bool,
) -> tuple[NDArray[np.bool_], bool]:
    """Return which means move, and whether the last one did.

    A newest reading that was replaced does not show that, and neither does one that is `absent`. Marks in `as_came` the
    means whose readings count as they came.
    """
    moves = as_came.copy()
    for index in range(len(moves)):
        as_came[index] |= moved
        found = raw if as_came[index] else tidy
        moves[index] |= found.moves[index] or (moved and found.lingers[index])
        if not newest[index] and not absent[index]:
            moved = bool(moves[index])
        moves[index] |= newest[index]
    return moves, moved


class Sizes(NamedTuple):
    """Sizes of means."""

    spans: list[int]
    """Number of rows of each mean that are looked at."""
    variance: FloatArray
    """Relative variance of the noise of its least noisy channel, shape (means,)."""

    @property
    def readings(self) -> FloatArray:
        """Number of readings in each mean, shape (means,)."""
        return 1 / self.variance

    @classmethod
    def of(cls, variance: FloatArray, longest: int, rows: FloatArray, *, restarts: bool) -> Self:
        """Return the sizes of means whose noise has a variance (means, channels), NaN for a channel without a value.

        At most `longest` of the `rows` (rows, channels) up to each mean are looked at; that many always if the mean
        never restarts.
        """
        least = variance.min(axis=1)
        if np.isnan(least).any():
            least = np.where(np.isnan(variance), 1.0, variance).min(axis=1)
        if not restarts:
            return cls([longest] * len(least), least)
        spans = np.minimum(np.ceil(1 / least - 1e-9), longest).astype(np.intp)
        lost = np.isnan(rows[-len(least) - longest + 1 :]).all(axis=1)
        if lost.any():  # these are rows of the mean, too
            seen = windows(np.where(lost, 0.0, 1.0), longest)[:, ::-1].cumsum(axis=1)
            spans = np.minimum((seen < spans[:, np.newaxis]).sum(axis=1) + 1, longest)
        return cls(spans.tolist(), least)


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
    restarts
        Whether a mean may be of fewer readings than `span`.
    """

    def __init__(
        self, span: int, still: int, slope: int, unit_mm: FloatArray, lag_readings: int | None, *, restarts: bool
    ) -> None:
        self._span, self._still, self._slope, self._restarts = span, still, slope, restarts
        self._unit_mm, self._lag_readings = unit_mm, lag_readings
        self.rows = max(LONGER_SLOPES[-1] * slope, span + self.compared(span))
        """Number of rows that are looked at."""

    def view(self, rows: FloatArray, mean: FloatArray, sizes: Sizes, *, moved: bool) -> View:
        """Return what the last readings (means, rows, channels) show about each mean."""
        deviations = rows - mean[:, np.newaxis]
        if not np.isnan(deviations.sum()):
            return View(deviations, None, None, self._find(deviations, mean.shape[1], sizes, None, moved=moved))
        known, there = ~np.isnan(deviations), ~np.isnan(mean)
        deviations[~known] = 0.0
        seen: NDArray[np.bool_] = np.any(known, axis=2)
        begun = np.logical_or.accumulate(seen, axis=1)
        hidden, missing = (
            (rows[:, :, np.newaxis] & ~known)[:, -self.compared(self._span) :].mean(axis=1) for rows in (seen, begun)
        )
        found = self._find(deviations, there.sum(axis=1), sizes, None if seen.all() else seen, moved=True)
        # A channel that is missing alone may be beyond its range because the beam moves. Lost readings do not change
        # what was known: whether the beam moves, and a mean of enough readings.
        unseen = ((missing > MAX_MISSING) & there).any(axis=1)
        doubted = ((hidden > MAX_MISSING) & there).any(axis=1)
        doubted |= self._few_seen(begun & ~seen, sizes) if self._restarts else unseen
        found = found._replace(moves=found.moves | doubted, lingers=found.lingers | unseen)
        return View(deviations, known, missing, found)

    def _few_seen(self, lost: NDArray[np.bool_], sizes: Sizes) -> NDArray[np.bool_]:
        """Return which means lack readings that would prove rest, and are not of as many others, shape (means,)."""
        compared = np.array([self.compared(span) for span in sizes.spans])
        number = lost[:, ::-1].cumsum(axis=1)[np.arange(len(lost)), compared - 1]
        few: NDArray[np.bool_] = (number > 0) & (sizes.readings < compared)
        return few

    def compared(self, span: int) -> int:
        """Return the number of readings that must agree to prove rest."""
        return max(span, self._still)

    def _find(
        self,
        deviations: FloatArray,
        working: NDArray[np.intp] | int,
        sizes: Sizes,
        seen: NDArray[np.bool_] | None,
        *,
        moved: bool,
    ) -> Found:
        """Return what the tests find in the deviations; which rows are `seen`, None for all."""
        units = deviations / self._unit_mm
        spans, variance = sizes
        kinds = set(spans)
        if len(kinds) == 1:
            return self.look(spans[0]).find(units, working, variance, seen, moved=moved)
        flags = np.empty((2, len(units)), dtype=np.bool_)
        found = Found(flags[0], flags[1], np.empty(len(units)), np.empty_like(units[:, 0]), np.empty_like(units[:, 0]))
        for span in kinds:
            at = np.flatnonzero(np.array(spans) == span)
            there = working if isinstance(working, int) else working[at]
            part = self.look(span).find(units[at], there, variance[at], None if seen is None else seen[at], moved=True)
            for whole, values in zip(found, part, strict=True):
                whole[at] = values
        return found

    def look(self, span: int) -> Look:
        """Return the contrasts that are tested for a mean of this number of readings."""
        return look_at(self.compared(span), self._slope, self.rows, len(self._unit_mm), self._lag_readings)
