"""The fit of damped sinusoids to readings whose stamps are not exact.

A reading that is taken a little later is that of the beam a little later, in all channels. So what a stamp is off adds
the same share of the beam's velocity to all channels of a reading: noise of one direction, that in which the beam moves
just then, and large where it moves fast. Readings weigh less in that direction (generalized least squares, by
Gauss-Newton steps of all parameters). The other directions and the turning points are as good as ever, and say whether
the fit holds.
"""

import math
from typing import NamedTuple

import numpy as np

from beamtouch_models.filters.readings import FloatArray
from beamtouch_models.filters.sinusoids import AMPLITUDE, DAMPING, Band, Fit, Poles, columns_of, mean_times

STEPS, AGAIN = 3, 1
"""Gauss-Newton steps, and those of a fit that is carried on; each finds the deviation of the stamps, too."""
LEAST = 0.002
"""Smallest deviation of a stamp that is told from none, in readings."""
ALIKE = 1e-6
"""Part of each square that two parameters never share."""
STILL = 1e-12
"""Speed below which a beam does not move, in units of the noise per reading."""


def refit(of: Fit, times: FloatArray, values: FloatArray, band: Band, most: float) -> tuple[Fit, float]:
    """Return a fit that allows for stamps which are off, and the sum of the squares that it leaves.

    Parameters
    ----------
    of
        Where the steps begin. Those from a fit that allows for stamps already are few.
    times, values, band
        As for `sinusoids.fit`.
    most
        Largest deviation of a stamp that is allowed, in readings.
    """
    steps = AGAIN if of.jitter else STEPS
    now, waves = of._replace(jitter=of.jitter or most), _Waves.of(of, times)
    for _ in range(steps):
        now = _step(now, waves, times, values, band)
        waves = _Waves.of(now, times)
        now = now._replace(jitter=_jitter_of(waves, values, most))
    residuals = waves.whitened(values - waves.said, now.jitter)
    return now, float((residuals * residuals).sum())


def whitened(of: Fit, times: FloatArray, left: FloatArray) -> FloatArray:
    """Return what readings differ from a fit, (times, channels), so that stamps that are off do not count."""
    return _Waves.of(of, times).whitened(left, of.jitter) if of.jitter else left


class _Waves(NamedTuple):
    """The swings of a fit at some times, and what follows from them."""

    columns: FloatArray
    """Of the coefficients, shape (times, columns): constant, slope, cosines, sines."""
    swings: FloatArray
    """Of each pole, shape (poles, times, channels)."""
    turned: FloatArray
    """The same a quarter of a period later."""
    way: FloatArray
    """Direction in which the beam moves, of length 1, shape (times, channels)."""
    speed: FloatArray
    """In units of the noise per reading, shape (times,)."""
    said: FloatArray
    """Values of the fit, shape (times, channels)."""

    @classmethod
    def of(cls, fit: Fit, times: FloatArray) -> "_Waves":
        """Return them at times before the newest reading, as for `sinusoids.fit`."""
        count, first = len(fit.poles.decay), 1 + fit.slopes
        columns = columns_of(fit.poles, times, fit.rows, slopes=fit.slopes).T
        wave = columns.T[first : first + count] + 1j * columns.T[first + count :]
        cosine, sine = fit.coefficients[first : first + count], fit.coefficients[first + count :]
        turning = wave[:, :, np.newaxis] * (cosine - 1j * sine)[:, np.newaxis]
        moved = ((1j * fit.poles.frequency - fit.poles.decay)[:, np.newaxis, np.newaxis] * turning).real.sum(axis=0)
        if fit.slopes:
            moved += fit.coefficients[1] / fit.rows
        speed = np.sqrt((moved * moved).sum(axis=1))
        way, said = moved / np.maximum(speed, STILL)[:, np.newaxis], columns @ fit.coefficients
        return cls(columns, turning.real, -turning.imag, way, speed, said)

    def late(self, left: FloatArray) -> FloatArray:
        """Return the part along the way of the beam, (times,), of what readings differ by, (times, channels)."""
        late: FloatArray = (self.way * left).sum(axis=1)
        return late

    def less(self, jitter: float) -> FloatArray:
        """Return the share of a difference along the way that is taken off, as stamps are off, shape (times,)."""
        return 1 - 1 / np.sqrt(1 + (jitter * self.speed) ** 2)

    def whitened(self, left: FloatArray, jitter: float) -> FloatArray:
        """Return what readings differ by, (times, channels), in units of noise and stamps together."""
        white: FloatArray = left - (self.less(jitter) * self.late(left))[:, np.newaxis] * self.way
        return white


def _step(of: Fit, waves: _Waves, times: FloatArray, values: FloatArray, band: Band) -> Fit:
    """Return the fit after a Gauss-Newton step of all parameters."""
    (number, channels), count = values.shape, len(of.poles.decay)
    linear = len(of.coefficients) * channels
    changes = _changes(waves, times)
    along = waves.less(of.jitter)[:, np.newaxis] * waves.way
    changes -= along[:, :, np.newaxis] * (waves.way[:, np.newaxis] @ changes)
    white = waves.whitened(values - waves.said, of.jitter)
    flat = changes.reshape(number * channels, -1)
    stiffness, force = flat.T @ flat, flat.T @ white.ravel()
    prior = np.full(len(force), 1 / AMPLITUDE**2)
    prior[linear : linear + count] = 1 / (DAMPING * of.poles.frequency) ** 2
    prior[linear + count :] = 1 / math.pi**2
    here = np.concatenate([of.coefficients.ravel(), of.poles.decay, np.zeros(count)])
    stiffness.flat[:: len(force) + 1] *= 1 + ALIKE
    stiffness.flat[:: len(force) + 1] += prior
    force -= prior * here
    spread = np.linalg.inv(stiffness).astype(np.float64, copy=False)
    step = spread @ force
    coefficients = of.coefficients + step[:linear].reshape(-1, channels)
    moved = step[linear:]
    poles = Poles(of.poles.decay + moved[:count], of.poles.frequency + moved[count:]).within(band)
    square = float((white * white).sum() + (prior * here * here).sum())
    return of._replace(
        poles=poles,
        following=poles,
        constant=coefficients[0],
        coefficients=coefficients,
        covariance=spread[:channels, :channels],
        square=square,
        promised=square - float(step @ force),
        rows=number,
        freedom=number * channels - len(force),
        parameters=len(force),
    )


def _jitter_of(waves: _Waves, values: FloatArray, most: float) -> float:
    """Return the deviation of the stamps: what is left along the way of the beam, beyond noise, over its speed."""
    late = waves.late(values - waves.said)
    beyond = max(0.0, float((late * late - 1).sum())) / max(float((waves.speed * waves.speed).sum()), STILL)
    return min(max(math.sqrt(beyond), LEAST), most)


def _changes(waves: _Waves, times: FloatArray) -> FloatArray:
    """Return what the parameters change, (times, channels, parameters): coefficients, decays, frequencies."""
    count, channels = len(waves.swings), waves.said.shape[1]
    linear = waves.columns.shape[1] * channels
    changes = np.zeros((len(times), channels, linear + 2 * count))
    for channel in range(channels):
        changes[:, channel, channel:linear:channels] = waves.columns
    ages = mean_times(times)[:, np.newaxis]
    changes[:, :, linear : linear + count] = np.moveaxis(-ages * waves.swings, 0, 2)
    changes[:, :, linear + count :] = np.moveaxis(ages * waves.turned, 0, 2)
    return changes
