"""The look at the newest readings: since when they agree, whether they drift, and how far a mean of them lags.

It is Lepski's rule (Lepski 1991; Goldenshluger & Nemirovski 1997): a window grows as long as its newest 1, 2, 4, ...
readings agree with all of it. The change that ends the growth is where the readings before and after it differ most. If
that was a step, the load has rested since, and all readings since agree. If not, something drifts. A drift just too
slow for k readings to show has moved their mean by several standard deviations. So only the newest quarter counts:
compared with its noise, its mean lags an eighth as much.

docs/decisions/017-mean-since-touch.md explains the form.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.readings import FloatArray, Sums
from beamtouch_models.filters.significance import FALSE, LAGS, SHARP, chi_square_quantile
from beamtouch_models.filters.splits import best_split, is_calm, is_sharp, is_step

OLDEST = (1, 4)
"""Numbers of oldest readings of a window that are compared with the others."""
RATIO = 1.3
"""Between the lengths of windows; the split between two lengths is found to the reading."""
DRIFT_PART = 4
"""One reading in this many counts where something drifts."""
LAG_NUMBERS = (1, 2, 4)
"""Numbers of newest readings whose distance from a long mean counts as its lag, in multiples of the least one."""
LEAST_LAG, LAG_PART = 8, 2
"""The least one, and its least multiple of the fewest readings. Fewer scatter too much to show a lag."""
STILL_PART = 1 / 4
"""Part of the slowest period in which readings must agree to prove rest."""


class Seen(NamedTuple):
    """The finding at each reading; all but `lags` have shape (readings,)."""

    since: NDArray[np.intp]
    """Number of rows since the newest change, without the newest one if that is doubtful."""
    sizes: NDArray[np.intp]
    """Number of them that count."""
    drifts: NDArray[np.bool_]
    """True where they drift; not if all rows before the change are lost, as it may be a step then."""
    touched: NDArray[np.bool_]
    """True where they follow a touch: a sharp change of a beam that lay still."""
    jumps: FloatArray
    """Square of the newest change: of their mean from that of as many rows before, in units of the noise; 0 without."""
    lags: FloatArray
    """Distance of their mean from the newest readings that noise does not explain, shape (readings, channels)."""


def windows_of(longest: int) -> list[int]:
    """Return the lengths of windows, ascending, from 1 to the longest."""
    windows = [1]
    while windows[-1] < longest:
        windows.append(min(longest, max(windows[-1] + 1, int(windows[-1] * RATIO))))
    return windows


class ChangeDetector:
    """Looks at the newest readings, in units in which their noise has the deviation `unit`.

    Parameters
    ----------
    channels
        Number of channels.
    longest
        Largest number of readings that are looked at.
    fewest
        Smallest number of readings in a mean, except right after a touch. A beam that rings swings about its rest, so
        more readings are closer to it.
    slowest_period
        Period of the slowest motion, in readings; 0 if it is not known.
    """

    def __init__(self, channels: int, longest: int, fewest: int, slowest_period: float, unit: float) -> None:
        self.longest, self._fewest, self._unit = longest, min(fewest, longest), unit
        self.still = math.ceil(STILL_PART * slowest_period)
        """Number of readings that must agree to prove rest."""
        self._before = max(2, math.ceil(slowest_period))
        """Number of readings before a touch that must be calm. Those of a whole period show the amplitude of a swing;
        about a turning point, those of a part may agree, and if a period has few readings, the next one differs
        sharply."""
        self._numbers = max(LEAST_LAG, LAG_PART * self._fewest) * np.array(LAG_NUMBERS)
        self.rows = 2 * longest + 2 * max(self._numbers) + self._before
        """Number of rows that are looked at."""
        self._windows = np.array(windows_of(longest))
        self._newest = 2 ** np.arange(longest.bit_length())
        # What differs among the oldest readings hardly changes the mean of the newest ones.
        shorter = np.concatenate([[0], self._windows[:-1]])
        oldest = [shorter, *(np.maximum(self._windows - few, 0) for few in OLDEST)]
        self._lengths = np.concatenate([self._newest, *oldest, self._windows])[np.newaxis]
        tests = len(self._newest) + len(oldest)
        self._agree, self._sharp, self._clearly, self._lag = (
            unit**2 * chi_square_quantile(channels, beyond) for beyond in (FALSE / tests, SHARP, FALSE, LAGS)
        )
        self._calm = unit**2 * np.array(
            [chi_square_quantile(few * (self._before - 1), FALSE) for few in range(channels + 1)]
        )

    def at(self, sums: Sums) -> Seen:
        """Return what is seen at some readings, by the sums up to them."""
        changed = self._differ(sums)
        since, sizes = np.full((2, len(changed)), self.longest)
        drifts, shown, touched = np.zeros((3, len(changed)), dtype=np.bool_)
        jumps = np.zeros(len(changed))
        changed_means = np.flatnonzero(changed.any(axis=1))
        if len(changed_means):
            part, first = sums.of(changed_means), changed[changed_means].argmax(axis=1)
            # The windows before the first one that fails hold no change.
            split = best_split(part, np.maximum(1, self._windows[first - 1] // 2), self._windows[first])
            step = is_sharp(part, split, self._sharp)
            early = step & (split > 1) & (split < max(self._fewest, self.still))
            if early.any():
                touched[changed_means[early]] = is_calm(part.of(early), split[early], self._before, self._calm)
            slow = ~step & (split >= self._fewest)
            if slow.any():
                step[slow] = is_step(part.of(slow), split[slow], self._clearly)
            size = np.where(step, split, -(-split // DRIFT_PART))
            few = (size < self._fewest) & ~touched[changed_means]
            since[changed_means], sizes[changed_means] = split, np.where(few, self._fewest, size)
            drifts[changed_means] = moving = ~step | few
            values, number = part.each(split[:, np.newaxis] * np.array([2, 1, 0]))
            shown[changed_means] = moving & number[:, 0].any(axis=1)
            before, after = np.moveaxis(values / np.maximum(number, 1), 1, 0)
            jumps[changed_means] = ((after - before) ** 2).sum(axis=1) / self._unit**2
        return Seen(since, sizes, shown, touched, jumps, self._lags(sums, sizes, drifts))

    def _differ(self, sums: Sums) -> NDArray[np.bool_]:
        """Return in which windows some readings differ from all of them, shape (means, windows).

        These are its newest ones, and all but some of its oldest ones.
        """
        # The windows are the last axis, along which numpy is fastest.
        total = sums.since(self._lengths).transpose(0, 2, 3, 1)
        inverse = 1 / np.maximum(total[:, 1], 1e-300)  # windows without a reading differ from nothing
        means = total[:, 0] * inverse
        newest, windows = len(self._newest), len(self._windows)
        changed = np.zeros((len(total), windows), dtype=np.bool_)
        for shape, of in (((newest, 1), slice(newest)), ((-1, windows), slice(newest, -windows))):
            apart, variance = (
                quantity[:, :, of].reshape(*quantity.shape[:2], *shape) - quantity[:, :, np.newaxis, -windows:]
                for quantity in (means, inverse)
            )
            apart *= apart
            apart /= np.where(variance > 0, variance, np.inf)  # otherwise no part of the window
            changed |= (apart.sum(axis=1) > self._agree).any(axis=1)
        return changed

    def _lags(self, sums: Sums, sizes: NDArray[np.intp], drifts: NDArray[np.bool_]) -> FloatArray:
        """Return the lags of the means, shape (means, channels).

        A mean of many readings is so precise that a load which begins to move leaves its interval before any test can
        know. So numbers of newest readings are compared with it, and the part of their distance that noise does not
        explain is its lag. Readings that drift lag by half of the distance to as many readings before them.
        """
        own = sizes[:, np.newaxis]
        total = sums.since(np.hstack([own, np.where(drifts[:, np.newaxis], 2 * own, self._numbers)]))
        inverse = 1 / np.maximum(total[:, :, 1], 1e-300)
        means = total[:, :, 0] * inverse
        apart, variance = means[:, 1:] - means[:, :1], inverse[:, 1:] - inverse[:, :1]
        variance *= np.where(drifts, -1, 1)[:, np.newaxis, np.newaxis]
        untested = (variance <= 0) | (variance >= 1)  # too many readings, or none
        apart[untested], variance[untested] = 0.0, 1.0
        square = np.einsum("mnc,mnc->mn", apart, apart / variance)
        best, rows = square.argmax(axis=1), np.arange(len(sizes))
        share = np.sqrt(1 - self._lag / np.maximum(square[rows, best], self._lag))
        lags: FloatArray = apart[rows, best] * np.where(drifts, share * (sizes - 1) / sizes, share)[:, np.newaxis]
        return lags
