"""Detects means taken while the beam moves, and states their covariance beyond that of white noise.

docs/decisions/012-covariance.md explains the form.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.change_detector import ChangeDetector, Seen
from beamtouch_models.filters.filtered import Filtered
from beamtouch_models.filters.readings import FloatArray, windows
from beamtouch_models.filters.significance import FALSE, chi_square_quantile

SCATTER_PART = 1 / 2
"""Part of the slowest period over which means scatter by their amplitude."""
MEANS = 4
"""Fewest means whose scatter is taken."""
SWINGING = 1 / 2
"""Share of the square of the newest deviation that counts where a mean is of more rows than since the last change. A
load that moves has gone on; a beam that rings comes back."""
CERTAIN = 2.0
"""Expected scatter of a swing over the limit of the test, from which it is seen in nearly all cases."""
LONE = 1
"""Readings in a window that may be spikes. More of them are the motion of the beam."""
LOOKED = 4
"""Rows in which readings are sought that show whether the beam rests, in multiples of those that prove it."""
MAX_MISSING = 1 / 2
"""Part of the readings of a channel that may be missing where rest is to be proved."""
UNSEEN = 0.03
"""Motion that the scatter does not show, relative to that which it shows. Modes that swing as fast as the readings come
seem to stand still; and the mean deflection over a long way is that of no single contact."""


class Past(NamedTuple):
    """The state: the last means, shape (rows, channels), and whether the last one moved."""

    means: FloatArray
    moved: bool


class Taken(NamedTuple):
    """Means of readings, and the readings about them."""

    readings: FloatArray
    """Unfiltered, shape (rows, channels): some rows before the first mean, and up to the last one."""
    begun: int
    """Number of rows since the filter began."""
    spikes: NDArray[np.bool_]
    """True where readings are spikes, shape (rows, channels)."""
    doubtful: NDArray[np.bool_]
    """True where the newest reading of a mean may be a spike, shape (means,)."""
    mean: FloatArray
    """Means after the last rows, shape (means, channels); NaN where a channel has none."""
    variance: FloatArray
    """Relative variance of their noise, of the same shape."""
    seen: Seen
    """The finding there."""

    @property
    def number(self) -> FloatArray:
        """Number of readings in each mean, of the channel that has most of them, shape (means,); 1 for none."""
        least: FloatArray = np.where(np.isnan(self.mean), 1.0, self.variance).min(axis=1)
        return 1 / least


class Near(NamedTuple):
    """The last readings about some means."""

    compared: NDArray[np.intp]
    """How many of them are compared, shape (means,)."""
    deviations: FloatArray
    """Their deviations from the mean [mm], shape (means, rows, channels); 0 if missing."""
    missing: NDArray[np.bool_] | None
    """True where they are missing, of the same shape; None: nowhere."""
    squares: FloatArray
    """Sums of squares of the compared readings about their own mean, in units of the noise, shape (means,)."""
    newest: FloatArray
    """Square of the newest deviation, in units of the noise, shape (means,)."""


class Motion:
    """Finds the means that move, and what they may be off by.

    Parameters
    ----------
    look
        Looks at the newest readings.
    span
        Number of readings whose scatter is tested.
    grows
        Whether the mean is of the readings that agree, and not always of the last `span`.
    noise_mm, unit_mm
        Standard deviation of a reading, shape (channels,), and what deviations are compared with.
    slowest_period
        Period of the slowest motion, in readings; 0 if it is not known.
    """

    def __init__(
        self,
        detector: ChangeDetector,
        span: int,
        *,
        grows: bool,
        noise_mm: FloatArray,
        unit_mm: FloatArray,
        slowest_period: float,
    ) -> None:
        self._detector, self._span, self._grows = detector, span, grows
        self._noise_mm, self._unit_mm, self._every = noise_mm, unit_mm, np.eye(len(noise_mm))
        self._rows = max(span, detector.still)
        self._ages = np.arange(self._rows)[::-1]
        self._means = max(MEANS, math.ceil(SCATTER_PART * slowest_period))
        self._of_swing = scatter_of_swing(slowest_period)
        working, sizes = range(len(noise_mm) + 1), range(self._rows + 1)
        self._scatter = np.array(
            [[chi_square_quantile(max(size - 1, 0) * few, FALSE) for few in working] for size in sizes]
        )
        """Limits of the sums of squares, by the number of compared rows and of working channels."""
        self._newest = np.array([chi_square_quantile(few, FALSE) for few in working])

    @property
    def memory(self) -> int:
        """Number of rows that are looked at."""
        return max(LOOKED * self._rows, self._means)

    def fresh(self) -> Past:
        """Return the initial state."""
        return Past(np.full((self._means, len(self._noise_mm)), np.nan), moved=False)

    def of(self, taken: Taken, past: Past, skipped: int) -> tuple[Filtered, Past]:
        """Return means with their uncertainty, and the next state.

        Means of `skipped` readings were not taken before these, and count as equal to the first one.
        """
        mean = taken.mean
        means = np.concatenate([past.means, mean[:1].repeat(skipped, axis=0), mean])
        there = ~np.isnan(mean)
        near = self._near(taken)
        unproven = self._unproven(taken, near)
        moves, confirms, moved = self._moves(taken, near, moved=past.moved)
        moves |= unproven
        lag = taken.seen.lags if self._grows else np.zeros_like(mean)
        lags = lag.any(axis=1) & ~moves
        uncertain = np.flatnonzero(moves | lags)
        excess = lag[uncertain, :, np.newaxis] * lag[uncertain, np.newaxis]
        if moves.any():
            moving = np.flatnonzero(moves)
            of = np.searchsorted(uncertain, moving)
            excess[of] += self._excess(taken, near, means, confirms)[moving]
            if self._grows:
                excess[of[(taken.seen.touched & ~taken.doubtful)[moving]]] = np.diag(self._unit_mm**2)
            # A beam that nobody has seen rest may swing as far as it is deflected.
            far_mm2 = (np.where(there, mean, 0.0) ** 2).sum(axis=1) * unproven
            excess[of] += far_mm2[moving, np.newaxis, np.newaxis] * self._every
        excess *= there[uncertain, :, np.newaxis] & there[uncertain, np.newaxis]
        filtered = Filtered(mean, taken.variance, self._noise_mm, moves, lags, excess, np.zeros_like(moves))
        return filtered, Past(means[len(means) - self._means :], moved)

    def _near(self, taken: Taken) -> Near:
        """Return the readings about each mean."""
        size = np.minimum(taken.seen.sizes, self._span) if self._grows else np.full(len(taken.mean), self._span)
        compared = np.maximum(size, self._detector.still)
        deviations = self._tidy(taken) - taken.mean[:, np.newaxis]
        missing = np.isnan(deviations)
        is_whole = not missing.any()
        if not is_whole:
            deviations[missing] = 0.0
        units = deviations / self._unit_mm
        newest = (units[:, -1] ** 2).sum(axis=1)
        units *= (self._ages < compared[:, np.newaxis])[:, :, np.newaxis]
        squares = (units * units).sum(axis=(1, 2)) - (units.sum(axis=1) ** 2).sum(axis=1) / compared
        return Near(compared, deviations, None if is_whole else missing, squares, newest)

    def _tidy(self, taken: Taken) -> FloatArray:
        """Return the last readings up to each mean, shape (means, rows, channels).

        A spike that is alone on a beam at rest is no motion, and counts as missing.
        """
        size, number = self._rows, len(taken.mean)
        window = windows(taken.readings, size, number)
        if taken.spikes.any():
            spiky = windows(np.any(taken.spikes, axis=1), 2 * size, number)[:, :-1].sum(axis=1)
            spikes = windows(taken.spikes, size, number)
            spikes[spiky + taken.doubtful > LONE] = False
            spikes[:, -1] = False  # of the newest, the next one says it
            window[spikes] = np.nan
        return window

    def _moves(self, taken: Taken, near: Near, *, moved: bool) -> tuple[NDArray[np.bool_], NDArray[np.bool_], bool]:
        """Return which means move, which would be the first that do, and whether the last one did."""
        seen, working = taken.seen, (~np.isnan(taken.mean)).sum(axis=1)
        # No change is seen further back than the look goes.
        moves = near.squares > self._scatter[near.compared, working]
        moves |= seen.since < np.minimum(near.compared, self._detector.longest)
        moves |= seen.drifts & (seen.since <= self.memory)
        moves |= self._may_swing(seen, near, working)
        unseen = np.zeros(len(moves), dtype=np.bool_)
        if near.missing is not None:
            hides, unseen = self._hides(taken, near, near.missing)
            moves |= hides
        confirms = np.ones(len(moves), dtype=np.bool_)
        if moved or moves.any():
            # What may be a spike, or is lost, does not show whether the beam moves.
            for index in np.flatnonzero(working).tolist():
                confirms[index] = not moved
                moves[index] |= moved and unseen[index]
                moved = moved if taken.doubtful[index] else bool(moves[index])
        return moves | taken.doubtful, confirms, moved

    def _may_swing(self, seen: Seen, near: Near, working: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Return where readings since a change agree, and yet would if the beam swung, shape (means,).

        A load that comes at once leaves the beam swinging by as much as it bends it. So the change is up to two swings.
        Readings of a whole period show them.
        """
        few = np.minimum(seen.since, len(self._of_swing) - 1)
        expected = self._of_swing[few] * seen.jumps / 4
        hides: NDArray[np.bool_] = expected < CERTAIN * self._scatter[near.compared, working]
        return hides & (seen.jumps > 0) & (seen.since < len(self._of_swing))

    def _hides(
        self, taken: Taken, near: Near, missing: NDArray[np.bool_]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return where missing readings may hide motion, and where they say nothing of it, shape (means,) each.

        A channel that is missing alone may be beyond its range because the beam moves. Lost readings do not change what
        was known: whether the beam moves, and a mean of enough readings.
        """
        compared, there = near.compared[:, np.newaxis], ~np.isnan(taken.mean)
        among = (self._ages < compared) & self._begun(taken)
        lost = missing.all(axis=2)
        most = MAX_MISSING * compared
        alone = ((among & ~lost)[:, :, np.newaxis] & missing).sum(axis=1) > most
        unseen: NDArray[np.bool_] = ((((among[:, :, np.newaxis] & missing).sum(axis=1)) > most) & there).any(axis=1)
        few = (lost & among).any(axis=1) & (taken.number < near.compared)
        return (alone & there).any(axis=1) | (few if self._grows else unseen), unseen

    def _begun(self, taken: Taken) -> NDArray[np.bool_]:
        """Return which of the last rows up to each mean came since the filter began, shape (means, rows)."""
        begun: NDArray[np.bool_] = self._ages < (taken.begun - np.arange(len(taken.mean))[::-1])[:, np.newaxis]
        return begun

    def _unproven(self, taken: Taken, near: Near) -> NDArray[np.bool_]:
        """Return which means are of a deflected beam, and of too few readings to show that it rests, shape (means,).

        That is so when the readings begin, and after a gap that leaves nothing to look at.
        """
        unproven: NDArray[np.bool_] = taken.number < self._rows
        if near.missing is None:
            unproven[:] = False
        elif unproven.any():
            came = ~np.all(np.isnan(taken.readings), axis=1)
            unproven &= windows(came, self.memory, len(unproven)).sum(axis=1) < self._rows
            square = np.nansum((taken.mean / self._unit_mm) ** 2 / np.maximum(taken.variance, 1e-9), axis=1)
            unproven &= square > self._newest[(~np.isnan(taken.mean)).sum(axis=1)]
        return unproven

    def _excess(self, taken: Taken, near: Near, means: FloatArray, confirms: NDArray[np.bool_]) -> FloatArray:
        """Return the excess of means if they move [mm^2], shape (means, channels, channels).

        `means` (rows, channels) are the last of all, and `confirms` says which would be the first that move.
        """
        seen, mean = taken.seen, taken.mean
        before = windows(means[:-1], self._means, len(mean)) - mean[:, np.newaxis]
        known = ~np.isnan(before)
        before = np.where(known, before, 0.0)
        count = np.maximum(known.any(axis=2).sum(axis=1), 1)
        excess: FloatArray = before.transpose(0, 2, 1) @ before / count[:, np.newaxis, np.newaxis]
        # A change within the mean, or one that the next reading must confirm: the newest reading shows it.
        full = (taken.doubtful & confirms) | ((seen.since < self._span) & (not self._grows))
        share = np.where(full, 1.0, SWINGING * (seen.since < seen.sizes))
        share *= near.newest > self._newest[(~np.isnan(mean)).sum(axis=1)]
        step = near.deviations[:, -1] * np.sqrt(share)[:, np.newaxis]
        excess += step[:, :, np.newaxis] * step[:, np.newaxis]
        # A direction that a single reading shows is as uncertain as that reading.
        single = np.minimum(near.newest / np.maximum(near.squares, 1.0), 1.0)
        variance_mm2 = single[:, np.newaxis] * self._noise_mm**2
        variance_mm2 += UNSEEN**2 * np.trace(excess, axis1=1, axis2=2)[:, np.newaxis]
        if near.missing is not None:
            variance_mm2 += self._left_out(taken, near.missing) ** 2
        return excess + variance_mm2[:, :, np.newaxis] * self._every

    def _left_out(self, taken: Taken, missing: NDArray[np.bool_]) -> FloatArray:
        """Return how far missing readings may move the mean [mm], shape (means, channels).

        Where a beam moves, readings are missing because they are beyond the range of the sensor. They are about as far
        from the others as these are apart.
        """
        share = (self._begun(taken)[:, :, np.newaxis] & missing).mean(axis=1)
        around = windows(taken.readings, self.memory, len(share)) - taken.mean[:, np.newaxis]
        apart: FloatArray = share * np.ptp(np.where(np.isnan(around), 0.0, around), axis=1)
        return apart


def scatter_of_swing(period: float) -> FloatArray:
    """Return the expected sum of squares about their mean of k readings of a swing of amplitude 1, by k.

    Its phase is not known. The last k is that of a whole period; there are none if the period, in readings, is 0.
    """
    numbers, angle = np.arange(1.0, math.ceil(period) + 1), math.pi / max(period, 2.0)
    together = np.sin(numbers * angle) / math.sin(angle)
    return np.concatenate([[0.0], numbers / 2 - together**2 / (2 * numbers)])
