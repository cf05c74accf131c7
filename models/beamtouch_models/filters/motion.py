"""Means that move: which they are, and the covariance of what each may be off by, beyond that of white noise.

docs/decisions/012-covariance.md explains the form and has the measurements.
"""

import math
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.look import Look, Seen
from beamtouch_models.filters.means import BEFORE, MIN_MM, FloatArray, lone_spikes, windows
from beamtouch_models.filters.significance import FALSE, chi_square_quantile

SCATTER_PART = 1 / 2
"""Part of the slowest period over which means scatter by their amplitude."""
MEANS = 4
"""Fewest means whose scatter is taken."""
SWINGING = 1 / 2
"""Share of the square of the newest deviation that counts where a mean is of more rows than since the last change. A
load that moves has gone on; a beam that rings comes back."""
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
    """The state: the last rows, shape (rows, channels), and whether the last mean moved."""

    readings: FloatArray
    means: FloatArray
    moved: bool


class Moves(NamedTuple):
    """What is said of some means."""

    moves: NDArray[np.bool_]
    """Whether they move, shape (means,)."""
    lags: NDArray[np.bool_]
    """Which others lag, shape (means,)."""
    excess_mm2: FloatArray
    """Covariance beyond that of the noise, of the means that move or lag, shape (uncertain, channels, channels)."""


class Evidence(NamedTuple):
    """The readings about some means."""

    deviations: FloatArray
    """Deviations of the compared readings from the mean [mm], shape (means, rows, channels); 0 if missing."""
    known: NDArray[np.bool_]
    """Which readings there are, of the same shape."""
    among: NDArray[np.bool_]
    """Which rows are compared, shape (means, rows)."""
    squares: FloatArray
    """Sums of squares of the last `compared` readings about their mean, in units of the noise, shape (means,)."""
    newest: FloatArray
    """Square of the newest deviation, in units of the noise, shape (means,)."""

    def at(self, rows: NDArray[np.intp]) -> Self:
        """Return the readings about some of the means."""
        deviations, known, among, squares, newest = self
        return self._replace(
            deviations=deviations[rows],
            known=known[rows],
            among=among[rows],
            squares=squares[rows],
            newest=newest[rows],
        )


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
        self, look: Look, span: int, *, grows: bool, noise_mm: FloatArray, unit_mm: FloatArray, slowest_period: float
    ) -> None:
        self._look, self._span, self._grows = look, span, grows
        self._noise_mm, self._unit_mm = noise_mm, np.maximum(unit_mm, MIN_MM)
        self._compared = max(span, look.still)
        self._means = max(MEANS, math.ceil(SCATTER_PART * slowest_period))
        working, sizes = range(len(noise_mm) + 1), range(self._compared + 1)
        self._scatter = np.array(
            [[chi_square_quantile(max(size - 1, 0) * few, FALSE) for few in working] for size in sizes]
        )
        """Limits of the sums of squares, by the number of compared rows and of working channels."""
        self._newest = np.array([chi_square_quantile(few, FALSE) for few in working])

    @property
    def memory(self) -> int:
        """Number of rows that are looked at."""
        return max(LOOKED * self._compared, self._means)

    def fresh(self, channels: int) -> Past:
        """Return the initial state."""
        nothing = np.full((self.memory + BEFORE, channels), np.nan)
        return Past(nothing, nothing[: self._means], moved=False)

    def of(
        self, readings: FloatArray, mean: FloatArray, variance: FloatArray, seen: Seen, past: Past
    ) -> tuple[Moves, Past]:
        """Return what is said of means, and the next state.

        Parameters
        ----------
        readings
            Unfiltered, shape (readings, channels).
        mean, variance
            Means after the last ones of them, NaN where a channel has none, and the relative variance of their noise.
            Means that were not taken before these count as equal to the first one.
        seen
            What the look has seen at these last ones.
        past
            The state.
        """
        rows = np.concatenate([past.readings, readings])
        means = np.concatenate([past.means, mean[:1].repeat(len(readings) - len(mean), axis=0), mean])
        there = ~np.isnan(mean)
        number = 1 / np.where(there, variance, 1.0).min(axis=1)
        size = np.minimum(seen.sizes, self._span) if self._grows else np.full(len(mean), self._span)
        compared = np.maximum(size, self._look.still)
        evidence = self._evidence(rows, mean, compared, seen)
        moves, still, moved = self._moves(evidence, there, number, compared, seen, moved=past.moved)
        unproven = self._unproven(rows, mean, variance, number)
        moves = moves | unproven
        lag = seen.lags_mm if self._grows else np.zeros_like(mean)
        lags = lag.any(axis=1) & ~moves
        uncertain = np.flatnonzero(moves | lags)
        excess = lag[uncertain, :, np.newaxis] * lag[uncertain, np.newaxis]
        at = np.flatnonzero(moves)
        if len(at):
            of = np.searchsorted(uncertain, at)
            before = windows(means[:-1], self._means)[-len(mean) :][at] - mean[at, np.newaxis]
            full = (seen.doubtful & still) | ((seen.since < self._span) & (not self._grows))
            share = np.where(full, 1.0, SWINGING * (seen.since < seen.sizes))
            share *= evidence.newest > self._newest[there.sum(axis=1)]
            excess[of] += self._excess(evidence.at(at), before, share[at])
            if self._grows:
                excess[of[(seen.touched & ~seen.doubtful)[at]]] = np.diag(self._unit_mm**2)
            # A beam that nobody has seen rest may swing as far as it is deflected.
            far_mm2 = (np.nan_to_num(mean[at]) ** 2).sum(axis=1) * unproven[at]
            excess[of] += far_mm2[:, np.newaxis, np.newaxis] * np.eye(mean.shape[1])
        excess *= there[uncertain, :, np.newaxis] & there[uncertain, np.newaxis]
        kept = len(rows) - len(past.readings)
        return Moves(moves, lags, excess), Past(rows[kept:], means[len(means) - self._means :], moved)

    def _evidence(self, rows: FloatArray, mean: FloatArray, compared: NDArray[np.intp], seen: Seen) -> Evidence:
        """Return the readings about each mean.

        A spike that is alone on a beam at rest is no motion, so its median takes its place.
        """
        size = self.memory
        window = windows(rows, size)[-len(mean) :]
        _, spikes, medians = lone_spikes(rows, self._look.spike_mm)
        if spikes.any():
            spiky = windows(np.any(spikes, axis=1), size)[-len(mean) :]
            lone = spiky[:, -2 * self._compared : -1].sum(axis=1) + seen.doubtful <= LONE
            tidy = windows(np.where(spikes, medians, rows), size)[-len(mean) :]
            tidy = np.concatenate([tidy[:, :-1], window[:, -1:]], axis=1)  # of the newest, the next one says it
            window = np.where(lone[:, np.newaxis, np.newaxis], tidy, window)
        deviations = window - mean[:, np.newaxis]
        known = ~np.isnan(deviations)
        deviations[~known] = 0.0
        units = deviations / self._unit_mm
        squared = (units * units).sum(axis=2)
        among = np.arange(size)[::-1] < compared[:, np.newaxis]
        total = np.einsum("erc,er->ec", units, among)
        within = (squared * among).sum(axis=1) - (total * total).sum(axis=1) / compared
        return Evidence(deviations, known, among, within, squared[:, -1])

    def _moves(
        self,
        evidence: Evidence,
        there: NDArray[np.bool_],
        number: FloatArray,
        compared: NDArray[np.intp],
        seen: Seen,
        *,
        moved: bool,
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], bool]:
        """Return which means move, which follow one that did not, and whether the last one did."""
        working = there.sum(axis=1)
        # No change is seen further back than the look goes.
        recent = seen.since < np.minimum(compared, self._look.longest)
        moves = (evidence.squares > self._scatter[compared, working]) | recent
        moves |= seen.drifts & (seen.since <= self.memory)
        unseen = np.zeros(len(moves), dtype=np.bool_)
        if not evidence.known.all():
            # A channel that is missing alone may be beyond its range because the beam moves. Lost readings do not
            # change what was known: whether the beam moves, and a mean of enough readings.
            rows = evidence.known.any(axis=2)
            begun = np.logical_or.accumulate(rows, axis=1)
            hidden, missing = (
                ((some[:, :, np.newaxis] & ~evidence.known).sum(axis=1) > MAX_MISSING * compared[:, np.newaxis]) & there
                for some in (rows & evidence.among, begun & evidence.among)
            )
            unseen = missing.any(axis=1)
            lost = (begun & ~rows & evidence.among).any(axis=1) & (number < compared)
            moves |= hidden.any(axis=1) | (lost if self._grows else unseen)
        still = np.ones(len(moves), dtype=np.bool_)
        if moved or moves.any():
            # What may be a spike, or is lost, does not show whether the beam moves.
            for index in np.flatnonzero(working > 0).tolist():
                still[index] = not moved
                moves[index] |= moved and unseen[index]
                moved = moved if seen.doubtful[index] else bool(moves[index])
        return moves | seen.doubtful, still, moved

    def _unproven(
        self, rows: FloatArray, mean: FloatArray, variance: FloatArray, number: FloatArray
    ) -> NDArray[np.bool_]:
        """Return which means are of a deflected beam, and of too few readings to show that it rests, shape (means,).

        That is so when the readings begin, and after a gap that leaves nothing to look at.
        """
        came = windows(np.any(~np.isnan(rows), axis=1), self.memory)[-len(mean) :].sum(axis=1)
        unproven: NDArray[np.bool_] = np.maximum(came, number) < self._compared
        if unproven.any():
            square = np.nansum((mean / self._unit_mm) ** 2 / np.maximum(variance, 1e-9), axis=1)
            unproven &= square > self._newest[(~np.isnan(mean)).sum(axis=1)]
        return unproven

    def _excess(self, evidence: Evidence, before: FloatArray, share: FloatArray) -> FloatArray:
        """Return the excess of means that move [mm^2], shape (means, channels, channels).

        The deviations of earlier means from these, `before` (means, rows, channels), are NaN if missing. `share`
        is how much of the newest deviation they do not hold.
        """
        known = ~np.isnan(before)
        before = np.where(known, before, 0.0)
        count = np.maximum(known.any(axis=2).sum(axis=1), 1)
        excess: FloatArray = before.transpose(0, 2, 1) @ before / count[:, np.newaxis, np.newaxis]
        # A change within the mean, or one that the next reading must confirm: the newest reading shows it.
        newest = evidence.deviations[:, -1] * np.sqrt(share)[:, np.newaxis]
        excess += newest[:, :, np.newaxis] * newest[:, np.newaxis]
        # A direction that a single reading shows is as uncertain as that reading.
        single = np.minimum(evidence.newest / np.maximum(evidence.squares, 1.0), 1.0)
        each = single[:, np.newaxis] * self._noise_mm**2
        each = each + UNSEEN**2 * np.trace(excess, axis1=1, axis2=2)[:, np.newaxis]
        each = each + self._left_out(evidence) ** 2
        excess += each[:, :, np.newaxis] * np.eye(each.shape[1])
        return excess

    def _left_out(self, evidence: Evidence) -> FloatArray:
        """Return how far missing readings may move the mean [mm], shape (means, channels).

        Where a beam moves, readings are missing because they are beyond the range of the sensor. They are about as far
        from the others as these are apart.
        """
        known, begun = evidence.known, np.logical_or.accumulate(evidence.known.any(axis=2), axis=1)
        missing = (begun[:, :, np.newaxis] & ~known)[:, -self._compared :].mean(axis=1)
        apart: FloatArray = missing * np.ptp(evidence.deviations, axis=1)
        return apart
