"""Rest gaps, measured while nothing touches the beam, and checks that the beam rests."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from beamtouch_common.digits import digits
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing.characteristic import QUALITIES, Characteristic
from beamtouch_service.samples import Quality

DURATION_S = 1.0
MIN_READINGS = 50
"""Limit below which noise looks like motion too often."""
MAX_SPREAD = 2.0
"""Largest standard deviation at rest, relative to the noise of one reading."""
MAX_DRIFT = 1.0
"""Largest difference between the means of both halves, relative to the noise of one reading."""
DRIFT_DEVIATIONS = 5.0
"""The same difference, relative to its own standard deviation; the smaller of both limits counts."""
MOUNTED_WITHIN = 0.1
"""Largest difference from the configured rest gap, which may be nominal, as a part of the linear range."""
DRIFTS_WITHIN = 0.02
"""Largest difference between two tares, from warmth and settling, as a part of the linear range."""


class TareRefusedError(Exception):
    """The surface was not at rest, or contradicts earlier rest gaps; the text is one line for the user."""


def readings_needed(rate_hz: float) -> int:
    """Return the number of readings to average."""
    return max(MIN_READINGS, math.ceil(DURATION_S * rate_hz))


def rest_gaps(
    counts: NDArray[np.float64], characteristic: Characteristic, channels: Sequence[str], noise_mm: float | None
) -> dict[str, float]:
    """Return the mean gap of each channel [mm], by name.

    Parameters
    ----------
    counts
        Shape (readings, channels), NaN where missing.
    characteristic
        Gives gaps and qualities.
    channels
        Names in column order.
    noise_mm
        Standard deviation of one reading [mm]; None: estimated from the differences between successive readings, which
        a slow motion hardly changes.

    Raises
    ------
    TareRefusedError
        A channel was not always good, or the surface moved: its spread or drift exceeds what noise and one ADC step
        explain.
    """
    codes = characteristic.quality(counts)
    gaps = characteristic.gap(counts)
    for name, code, gap, step in zip(channels, codes.T, gaps.T, characteristic.steepest.tolist(), strict=True):
        if bad := code[code != QUALITIES.index(Quality.GOOD)].tolist():
            message = f"{name} is {QUALITIES[bad[0]]} in {len(bad)} of {len(gap)} readings; check the sensor"
            raise TareRefusedError(message)
        if moved := motion(gap, step, noise_mm):
            message = f"{name} moved: {moved}; take everything off the beam and try again"
            raise TareRefusedError(message)
    return dict(zip(channels, np.mean(gaps, axis=0).tolist(), strict=True))


def noise_of(gap_mm: NDArray[np.float64], noise_mm: float | None) -> float:
    """Return the noise of a reading [mm]: `noise_mm`, or estimated from differences between successive readings."""
    return float(np.std(np.diff(gap_mm))) / math.sqrt(2.0) if noise_mm is None else noise_mm


def motion(gap_mm: NDArray[np.float64], step_mm: float, noise_mm: float | None) -> str:
    """Describe the motion in the gaps of a channel, shape (readings,); empty if noise and one ADC step explain it."""
    noise = noise_of(gap_mm, noise_mm)
    spread = float(np.std(gap_mm))
    first, second = np.array_split(gap_mm, 2)
    drift = abs(float(np.mean(second) - np.mean(first)))
    # The difference of two means of n / 2 readings has 2 / sqrt(n) times the standard deviation of a reading.
    max_drift = min(MAX_DRIFT, DRIFT_DEVIATIONS * 2 / math.sqrt(len(gap_mm))) * noise
    if spread <= MAX_SPREAD * noise + step_mm and drift <= max_drift + step_mm:
        return ""
    return f"standard deviation {digits(spread, 2)} mm, drift {digits(drift, 2)} mm, noise {digits(noise, 2)} mm"


def contradictions(rest_gap_mm: Mapping[str, float], last_mm: Mapping[str, float], surface: Surface) -> list[str]:
    """Return a phrase for each channel whose rest gap contradicts the last tare or the configuration.

    A rest gap is compared with the last tare, if there is one. It is also compared with the configuration, which may be
    nominal, unless the last tare already differed from it.

    Parameters
    ----------
    rest_gap_mm
        Measured rest gaps [mm], by channel name.
    last_mm
        Rest gaps of the last tare [mm], by channel name; empty without one.
    surface
        The configuration.
    """
    noise = surface.noise_mm or 0.0
    followed = surface.zero_tracking.max_mm if surface.zero_tracking else 0.0
    found = []
    for channel in surface.channels:
        gap, width = rest_gap_mm[channel.name], channel.range_mm[1] - channel.range_mm[0]
        last = last_mm.get(channel.name)
        mounted, drifted = MOUNTED_WITHIN * width + noise, max(DRIFTS_WITHIN * width, followed) + noise
        if last is not None and abs(gap - last) > drifted:
            found.append(f"{channel.name} {gap - last:+.3f} mm from the last tare")
            continue
        agreed = last is None or abs(last - channel.rest_gap_mm) <= mounted
        if agreed and abs(gap - channel.rest_gap_mm) > mounted:
            found.append(f"{channel.name} {gap - channel.rest_gap_mm:+.3f} mm from its rest_gap_mm")
    return found
