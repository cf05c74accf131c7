"""The fit of damped sinusoids to readings whose stamps are not exact.

A reading that is taken a little later is that of the beam a little later, in all channels. So what a stamp is off adds
the same share of the beam's velocity to all channels of a reading: noise of one direction, that in which the beam moves
just then, and large where it moves fast. Readings weigh less in that direction (generalized least squares, by
Gauss-Newton steps of all parameters). The other directions and the turning points are as good as ever, and say whether
the fit holds.
"""

import math

import numpy as np

from beamtouch_models.filters.readings import FloatArray
from beamtouch_models.filters.sinusoids import AMPLITUDE, DAMPING, Fit, Poles, predicted

STEPS = 3
"""Gauss-Newton steps; each finds the deviation of the stamps, too."""
LEAST = 0.002
"""Smallest deviation of a stamp that is told from none, in readings."""
ALIKE = 1e-6
"""Part of each square that two parameters never share."""
STILL = 1e-12
"""Speed below which a beam does not move, in units of the noise per reading."""


def refit(of: Fit, times: FloatArray, values: FloatArray, lowest: float, most: float) -> Fit:
    """Return a fit that allows for stamps which are off, with the deviation that explains most of what is left.

    Parameters
    ----------
    of
        Where the steps begin.
    times, values, lowest
        As for `sinusoids.fit`.
    most
        Largest deviation of a stamp that is allowed, in readings.
    """
    now = of._replace(jitter=of.jitter or most)
    for _ in range(STEPS):
        now = _step(now, times, values, lowest)
        now = now._replace(jitter=_jitter_of(now, times, values, most))
    return now


def whitened(of: Fit, times: FloatArray, left: FloatArray) -> FloatArray:
    """Return what readings differ from a fit, (times, channels), so that stamps that are off do not count."""
    if not of.jitter:
        return left
    along, less = _along(_speed(of, times), of.jitter)
    white: FloatArray = left - (less * (along * left).sum(axis=1))[:, np.newaxis] * along
    return white


def _step(of: Fit, times: FloatArray, values: FloatArray, lowest: float) -> Fit:
    """Return the fit after a Gauss-Newton step of all parameters."""
    (number, channels), count = values.shape, len(of.poles.decay)
    linear = len(of.coefficients) * channels
    left, along, less = values - predicted(of, times), *_along(_speed(of, times), of.jitter)
    changes = _changes(of, times, channels)
    changes -= (less[:, np.newaxis] * along)[:, :, np.newaxis] * (along[:, np.newaxis] @ changes)
    white = left - (less * (along * left).sum(axis=1))[:, np.newaxis] * along
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
    poles = Poles(of.poles.decay + moved[:count], of.poles.frequency + moved[count:]).within(lowest)
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


def _jitter_of(of: Fit, times: FloatArray, values: FloatArray, most: float) -> float:
    """Return the deviation of the stamps: what is left along the way of the beam, beyond noise, over its speed."""
    speed = _speed(of, times)
    late = (_along(speed, of.jitter)[0] * (values - predicted(of, times))).sum(axis=1)
    beyond = max(0.0, float((late * late - 1).sum())) / max(float((speed * speed).sum()), STILL)
    return min(max(math.sqrt(beyond), LEAST), most)


def _along(speed: FloatArray, jitter: float) -> tuple[FloatArray, FloatArray]:
    """Return the direction in which the beam moves at each time, and which part of it noise does not explain."""
    size = np.sqrt((speed * speed).sum(axis=1))
    return speed / np.maximum(size, STILL)[:, np.newaxis], 1 - 1 / np.sqrt(1 + (jitter * size) ** 2)


def _waves(of: Fit, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the swing of each pole at each time, and a quarter of a period later, (poles, times, channels)."""
    count, first = len(of.poles.decay), 1 + of.slopes
    wave = np.exp((1j * of.poles.frequency - of.poles.decay)[:, np.newaxis] * times)[:, :, np.newaxis]
    cosine = of.coefficients[first : first + count, np.newaxis]
    sine = of.coefficients[first + count :, np.newaxis]
    return wave.real * cosine + wave.imag * sine, wave.real * sine - wave.imag * cosine


def _speed(of: Fit, times: FloatArray) -> FloatArray:
    """Return how fast the beam moves, (times, channels), in units of the noise per reading."""
    swings, turned = _waves(of, times)
    speed: FloatArray = np.tensordot(of.poles.frequency, turned, 1) - np.tensordot(of.poles.decay, swings, 1)
    return speed + of.coefficients[1] / of.rows if of.slopes else speed


def _changes(of: Fit, times: FloatArray, channels: int) -> FloatArray:
    """Return what the parameters change, (times, channels, parameters): coefficients, decays, frequencies."""
    swings, turned = _waves(of, times)
    count, linear = len(swings), len(of.coefficients) * channels
    wave = np.exp((1j * of.poles.frequency - of.poles.decay)[:, np.newaxis] * times)
    slope = [times / of.rows] if of.slopes else []
    columns = np.stack([np.ones(len(times)), *slope, *wave.real, *wave.imag], axis=1)
    changes = np.zeros((len(times), channels, linear + 2 * count))
    for channel in range(channels):
        changes[:, channel, channel:linear:channels] = columns
    changes[:, :, linear : linear + count] = np.moveaxis(-times[:, np.newaxis] * swings, 0, 2)
    changes[:, :, linear + count :] = np.moveaxis(times[:, np.newaxis] * turned, 0, 2)
    return changes
