"""Rest gaps, measured while nothing touches the beam, and checks that the beam rests."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from beamtouch_common.digits import digits
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.config.signal import Channel
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
LOAD_SHARE = 0.1
"""The same for both, as a part of what the smallest force causes where it moves the channel most. Smaller parts would
refuse ordinary settling. With it, the smallest force shows everywhere but within a few percent of the supports."""
STATED_DEVIATIONS = 4.0
"""A difference within this many standard deviations of the stated drift is never refused."""


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


def allowed_mm(channel: Channel, surface: Surface, *, first: bool) -> float:
    """Return the largest difference [mm] of a rest gap from the last tare, or in the first tare from `rest_gap_mm`."""
    share = MOUNTED_WITHIN if first else DRIFTS_WITHIN
    largest = share * (channel.range_mm[1] - channel.range_mm[0])
    if channel.smallest_force_mm is not None:
        largest = min(largest, LOAD_SHARE * channel.smallest_force_mm)
    followed = surface.zero_tracking.max_mm if surface.zero_tracking else 0.0
    drift = max(followed, STATED_DEVIATIONS * surface.zero_drift_mm)
    return max(largest, drift) + (surface.noise_mm or 0.0)


def contradictions(rest_gap_mm: Mapping[str, float], last_mm: Mapping[str, float], surface: Surface) -> list[str]:
    """Return a phrase for each channel whose rest gap contradicts the last tare or the configuration.

    A rest gap is compared with the last tare; without one, with the configuration. Later tares must not creep away from
    a configuration that the last tare agreed with, either.

    Parameters
    ----------
    rest_gap_mm
        Measured rest gaps [mm], by channel name.
    last_mm
        Rest gaps of the last tare [mm], by channel name; empty without one.
    surface
        The configuration.
    """
    found = []
    for channel in surface.channels:
        gap, last = rest_gap_mm[channel.name], last_mm.get(channel.name)
        mounted = MOUNTED_WITHIN * (channel.range_mm[1] - channel.range_mm[0]) + (surface.noise_mm or 0.0)
        if last is None:
            mounted = allowed_mm(channel, surface, first=True)
        elif abs(gap - last) > allowed_mm(channel, surface, first=False):
            found.append(f"{channel.name} {gap - last:+.3f} mm from the last tare")
            continue
        agreed = last is None or abs(last - channel.rest_gap_mm) <= mounted
        if agreed and abs(gap - channel.rest_gap_mm) > mounted:
            found.append(f"{channel.name} {gap - channel.rest_gap_mm:+.3f} mm from its rest_gap_mm")
    return found


def comparison(rest_gap_mm: Mapping[str, float], last_mm: Mapping[str, float], surface: Surface) -> str:
    """Describe what accepted rest gaps were compared with, and how closely; arguments as `contradictions`."""
    first, smallest = not last_mm, min(allowed_mm(one, surface, first=not last_mm) for one in surface.channels)
    differences = {
        one.name: abs(rest_gap_mm[one.name] - last_mm.get(one.name, one.rest_gap_mm)) for one in surface.channels
    }
    name = max(differences, key=lambda one: differences[one])
    what = "first tare, compared with rest_gap_mm" if first else "compared with the last tare"
    text = f"{what}: {name} differs most, by {digits(differences[name], 2)} mm; {digits(smallest, 2)} mm are allowed"
    if all(one.smallest_force_mm is None for one in surface.channels):
        return f"{text}; a load that moves less is not noticed, as the channels state no smallest_force_mm"
    return text
