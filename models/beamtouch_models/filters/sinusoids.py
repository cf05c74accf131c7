"""The fit of a constant, a slope and damped sinusoids whose poles are free, and are shared by all channels.

It is variable projection (Golub & Pereyra 1973, in Kaufman's form of 1975): for given poles all else is linear, so that
only the poles are sought, by Gauss-Newton steps. All that a step needs is in the products of the columns and of their
derivatives with each other and with the readings. So a step costs little more than these products.

Values are in units of their noise, and times in readings before the newest one, so they are at most 0. A value may be
the mean of several readings, whose times are then a row.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.readings import FloatArray

AMPLITUDE = 1e3
"""Deviation of an amplitude before anything is measured, in units of the noise."""
ALIKE = 1e-8
"""Part of each square that two columns never share, so that two poles that meet are told apart, whatever their size."""
STILL = 1e-12
"""Square of an amplitude below which nothing swings."""
DAMPING = 0.04
"""Deviation of a damping ratio before anything is measured."""
MAX_DAMPING = 0.12
"""Largest damping ratio."""
FIRST_DAMPING = 0.003
"""Decay per reading where the search of a pole begins."""
HIGHEST, HIGHEST_UNEVEN = 0.995 * math.pi, 4 * math.pi
"""Highest angular frequency, per reading: two readings a period are not enough, if they are as far apart as each other.
Others tell a faster swing from a slow one."""
SOUGHT = 0.99 / 0.995
"""Part of the highest frequency up to which a new pole is sought."""
BETTER = 1.02
"""A swing above `HIGHEST` must explain this many times what one below does: often they are nearly the same."""
UNEVEN = 0.012
"""R.m.s. distance of intervals from whole multiples of the usual one, over that, from which on readings are uneven."""
LEAST_CYCLES = 0.8
"""Least part of a period that the readings span. Less of a slow swing is told from a slope by nothing."""
FREQUENCIES = 20, 64
"""Fewest and most frequencies, up to the highest one of even readings, among which that of a new pole is sought; as
many as there are readings between them."""


class Band(NamedTuple):
    """The angular frequencies that are allowed, per reading."""

    lowest: float
    highest: float = HIGHEST
    usual: float = 1.0
    """The usual time between readings, over the nominal one."""

    @classmethod
    def of(cls, times: FloatArray, lowest: float) -> "Band":
        """Return that of readings at some times, as for `fit`."""
        even = cls(lowest)
        if times.ndim > 1:  # single readings, in their unit
            times = times.ravel() * times.shape[1]
        if _are_whole(times):
            return even
        between = np.diff(times)
        usual = float(np.median(between))
        if usual <= 0 or _are_whole(between / usual):
            return even
        return cls(lowest, HIGHEST_UNEVEN, usual)

    def seem_still(self, frequency: FloatArray) -> NDArray[np.bool_]:
        """Return whether swings are so nearly as fast as the readings, or twice as fast, that they look like a load.

        A load that grows would be taken for one of them.
        """
        turns = frequency * self.usual / (2 * math.pi)
        whole_turns = np.rint(turns)
        still: NDArray[np.bool_] = (whole_turns > 0) & (
            np.abs(turns - whole_turns) * 2 * math.pi < self.lowest * self.usual
        )
        return still


class Poles(NamedTuple):
    """Damped sinusoids exp((-decay + i frequency) t)."""

    decay: FloatArray
    """Per reading, shape (poles,)."""
    frequency: FloatArray
    """Angular, per reading, shape (poles,)."""

    @classmethod
    def none(cls) -> "Poles":
        """Return no poles."""
        return cls(np.zeros(0), np.zeros(0))

    def within(self, band: Band) -> "Poles":
        """Return the poles within the ranges that are allowed."""
        frequency = np.minimum(np.maximum(self.frequency, band.lowest), band.highest)
        most = MAX_DAMPING * np.minimum(frequency, HIGHEST)
        return Poles(np.minimum(np.maximum(self.decay, 0.0), most), frequency)


class Fit(NamedTuple):
    """A fit for given poles."""

    poles: Poles
    slopes: bool
    constant: FloatArray
    """At the time 0, shape (channels,)."""
    coefficients: FloatArray
    """Of the columns: constant, slope over all readings, cosines, sines; shape (columns, channels)."""
    square: float
    """Sum of the squares that are left, with those of the priors."""
    rows: int
    """Number of readings."""
    freedom: int
    """Values less parameters."""
    parameters: int
    covariance: FloatArray
    """Of the constant, shape (channels, channels)."""
    following: Poles
    """The poles after a Gauss-Newton step."""
    promised: float
    """Part of the sum of squares that the step leaves, as far as it is linear."""
    jitter: float = 0.0
    """Deviation of the stamps that is allowed for, in readings."""

    @property
    def swing(self) -> float:
        """Sum of the squares of all amplitudes at the time 0."""
        return float((self.coefficients[1:] ** 2).sum())

    @property
    def turns(self) -> float:
        """Least number of turns of a pole that the readings span, if they are one apart; 0 without poles."""
        slowest = self.poles.frequency.min(initial=math.inf)
        return 0.0 if math.isinf(slowest) else float(self.rows * slowest / (2 * math.pi))

    @property
    def frequency(self) -> float:
        """R.m.s. angular frequency of the swings at the time 0, by their squares, per reading; needs a pole."""
        squares = (self.coefficients[1 + self.slopes :] ** 2).sum(axis=1).reshape(2, -1).sum(axis=0)
        return math.sqrt(float(squares @ self.poles.frequency**2) / max(float(squares.sum()), STILL))


def _are_whole(numbers: FloatArray) -> bool:
    """Return whether all are whole numbers within `UNEVEN` (r.m.s.)."""
    off = numbers - np.rint(numbers)
    return float(off @ off) <= len(off) * UNEVEN**2


def mean_times(times: FloatArray) -> FloatArray:
    """Return the mean time of each value, shape (readings,)."""
    means: FloatArray = times if times.ndim == 1 else times.mean(axis=1)
    return means


def waves_of(poles: Poles, times: FloatArray) -> NDArray[np.complex128]:
    """Return exp((-decay + i frequency) t), or its mean over several times t, shape (poles, readings)."""
    powers = 1j * poles.frequency - poles.decay
    waves: NDArray[np.complex128] = np.exp(np.multiply.outer(powers, times))
    return waves if times.ndim == 1 else waves.mean(axis=2)


def columns_of(poles: Poles, times: FloatArray, rows: int, *, slopes: bool) -> FloatArray:
    """Return what coefficients multiply at some times, shape (columns, readings): as in `Fit`, of so many readings."""
    count, first = len(poles.decay), 1 + slopes
    columns = np.empty((first + 2 * count, len(times)))
    columns[0] = 1.0
    if slopes:
        columns[1] = mean_times(times) / rows
    if count:
        wave = waves_of(poles, times)
        columns[first : first + count], columns[first + count :] = wave.real, wave.imag
    return columns


def fit(times: FloatArray, values: FloatArray, poles: Poles, band: Band, *, slopes: bool) -> Fit:
    """Return the fit for given poles, with the Gauss-Newton step from them.

    Parameters
    ----------
    times, values
        Of the readings, shapes (readings,), or (readings, each) of means, and (readings, channels).
    poles
        Where the step begins.
    band
        Frequencies that are allowed.
    slopes
        Whether each channel has a slope.
    """
    number, channels = values.shape
    count, first = len(poles.decay), 1 + slopes
    linear = first + 2 * count
    columns = columns_of(poles, times, number, slopes=slopes)
    if count:
        columns = np.concatenate([columns, columns[first:] * mean_times(times)])
    products, shown = columns @ columns.T, columns @ values
    normal = products[:linear, :linear].copy()
    normal.flat[:: linear + 1] += 1 / AMPLITUDE**2 + ALIKE * normal.flat[:: linear + 1]
    inverse = np.linalg.inv(normal)
    coefficients = inverse @ shown[:linear]
    every = values.ravel()
    square = float(every @ every - shown[:linear].ravel() @ coefficients.ravel())
    parameters = linear * channels + 2 * count
    freedom = number * channels - parameters
    if not count:
        covariance = inverse[0, 0] * np.eye(channels)
        return Fit(
            poles, slopes, coefficients[0], coefficients, square, number, freedom, parameters, covariance, poles, square
        )
    mixed = inverse @ products[:linear, linear:]
    schur = products[linear:, linear:] - products[linear:, :linear] @ mixed
    residual = shown[linear:] - products[linear:, :linear] @ coefficients
    # What each pole's decay and frequency change, in the columns times t.
    changes = np.zeros((2 * count, 2 * count, channels))
    for pole in range(count):
        cosine, sine = coefficients[first + pole], coefficients[first + count + pole]
        changes[pole, pole], changes[pole, count + pole] = -cosine, -sine
        changes[count + pole, pole], changes[count + pole, count + pole] = sine, -cosine
    flat = changes.reshape(2 * count, -1)
    stiffness = (schur @ changes).reshape(2 * count, -1) @ flat.T
    force = flat @ residual.ravel()
    stiffness.flat[:: 2 * count + 1] *= 1 + ALIKE
    prior = 1 / (DAMPING * poles.frequency) ** 2
    diagonal = np.einsum("ii->i", stiffness)
    diagonal[:count] += prior
    diagonal[count:] += 1 / math.pi**2
    force[:count] -= prior * poles.decay
    square += float(prior @ (poles.decay * poles.decay))
    moved = -(mixed[0] @ changes)  # the constant, by decays and frequencies
    spread = np.linalg.inv(stiffness)
    covariance = moved.T @ spread @ moved
    covariance.flat[:: channels + 1] += inverse[0, 0]
    step = spread @ force
    following = Poles(poles.decay + step[:count], poles.frequency + step[count:]).within(band)
    step = np.concatenate([following.decay - poles.decay, following.frequency - poles.frequency])
    promised = square + float(step @ (stiffness @ step - 2 * force))
    return Fit(
        poles,
        slopes,
        coefficients[0] + moved.T @ step,
        coefficients,
        square,
        number,
        freedom,
        parameters,
        covariance,
        following,
        promised,
    )


def predicted(of: Fit, times: FloatArray) -> FloatArray:
    """Return what a fit says of some times, shape (times, channels); times as for `fit`, later ones are above 0."""
    columns = columns_of(of.poles, times, of.rows, slopes=of.slopes)
    # Summed column by column, so that a row is the same however many there are.
    said: FloatArray = (columns[:, :, np.newaxis] * of.coefficients[:, np.newaxis]).sum(axis=0)
    return said


def seek(of: Fit, times: FloatArray, values: FloatArray, band: Band) -> Poles:
    """Return the poles of a fit, and one more: of the frequency that explains most of what it leaves.

    There is none more if no frequency is left: of readings far apart, all may look like a load.
    """
    number = min(max(FREQUENCIES[0], len(times)), FREQUENCIES[1])
    number = round(number * band.highest / HIGHEST)
    frequencies = np.linspace(band.lowest, SOUGHT * band.highest, number)
    frequencies = frequencies[~band.seem_still(frequencies)]
    if not len(frequencies):
        return of.poles
    number = len(frequencies)
    residuals, waves = values - predicted(of, times), waves_of(Poles(np.zeros(number), frequencies), times).T
    times = mean_times(times)
    columns = np.concatenate([waves.real, waves.imag], axis=1)
    base = np.stack([np.ones(len(times)), times / len(times)], axis=1)[:, : 1 + of.slopes]
    columns -= base @ np.linalg.solve(base.T @ base, base.T @ columns)
    cosines, sines = columns[:, :number], columns[:, number:]
    by_cosine, by_sine = cosines.T @ residuals, sines.T @ residuals
    least = 1e-6 * len(times)
    cc, ss, cs = (cosines**2).sum(axis=0) + least, (sines**2).sum(axis=0) + least, (cosines * sines).sum(axis=0)
    explained = (by_cosine**2).sum(axis=1) * ss - 2 * (by_cosine * by_sine).sum(axis=1) * cs
    explained += (by_sine**2).sum(axis=1) * cc
    explained /= np.maximum(cc * ss - cs * cs, least * len(times))
    explained[frequencies > HIGHEST] /= BETTER
    best = frequencies[explained.argmax()]
    return Poles(np.append(of.poles.decay, FIRST_DAMPING), np.append(of.poles.frequency, best)).within(band)


def refine(times: FloatArray, values: FloatArray, poles: Poles, band: Band, *, slopes: bool, steps: int) -> Fit:
    """Return the best fit after some Gauss-Newton steps; arguments as for `fit`."""
    best = fit(times, values, poles, band, slopes=slopes)
    towards = best.following
    for _ in range(steps):
        next_one = fit(times, values, towards, band, slopes=slopes)
        if next_one.square < best.square:
            best, towards = next_one, next_one.following
        else:  # too far: halfway back
            towards = Poles(*((there + here) / 2 for there, here in zip(towards, best.poles, strict=True)))
    return best
