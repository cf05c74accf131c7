"""The keys of the daemon's configuration and of the scene that state a measured noise."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing.characteristic import Characteristic
from beamtouch_daemon.processing.rest_noise import ChannelNoise
from beamtouch_daemon.processing.stuck import longest_run

ZERO_SHARE = 0.2
"""Least drift of a zero, as a part of the noise, as in a scene: a recording shows only its own time."""
STEPS_MATTER = 0.1
"""Steps are stated if their rounding is more than this part of the noise."""
HIDDEN = 0.02
"""Noise that is stated where the steps hide it, in steps: it is too small to average the rounding away."""
MIN_BITS, MAX_BITS = 6, 16
"""Values of `adc_bits` that a scene accepts."""
RUNS_DIFFER = 1.5
MAX_STUCK_MS = 3_600_000.0
"""Largest `stuck_after_ms` that is stated: an hour."""
DIGITS = 3


@dataclass(frozen=True)
class Keys:
    """Values by key, rounded up, in the units of the keys."""

    daemon_noise_mm: float
    """`noise_mm` of the surface."""
    stuck_after_ms: dict[str, float]
    """`stuck_after_ms` by channel, where the noise would find a working channel stuck."""
    scene_noise_mm: float
    """`[sensors] noise_mm`: without the steps if `adc_bits` states them."""
    zero_drift_mm: float
    """`[sensors] zero_drift_mm`."""
    adc_bits: int | None
    """`[sensors] adc_bits`, if the steps matter."""


def keys_of(found: Sequence[ChannelNoise], surface: Surface) -> Keys:
    """Return the keys that state the noise of all channels, which is that of the noisiest one.

    A mean of readings has the stated variance, noise squared over the number of readings, in the configured filter. The
    rounding of an ADC that is coarser than the noise stays in every mean: a scene states it by `adc_bits` and a smaller
    noise.
    """
    step = max(one.step_mm for one in found)
    rounding = step / math.sqrt(12)
    loud = [one.effective_noise_mm for one in found if not one.is_rounded or one.is_coloured]
    noise = max(loud) if loud else math.hypot(HIDDEN * step, rounding) / math.sqrt(surface.conversions)
    drift = max(ZERO_SHARE * noise, *(one.drift_mm for one in found))
    bits = _bits(surface, step) if rounding > STEPS_MATTER * noise else None
    sensor = math.sqrt(max(noise**2 - rounding**2, 0.0)) if loud else HIDDEN * step
    if any(one.is_rounded for one in found) and (loud or bits is None):
        # A scene would take such noise to average the rounding away, but it does not. The tare is rounded too.
        drift = math.hypot(drift, math.sqrt(2) * rounding)
    return Keys(
        daemon_noise_mm=rounded_up(noise),
        stuck_after_ms=_stuck_after_ms(found, noise, surface),
        scene_noise_mm=rounded_up(noise if bits is None else sensor),
        zero_drift_mm=rounded_up(drift),
        adc_bits=bits,
    )


def rounded_up(value: float) -> float:
    """Return the value with three digits, never less than it."""
    if value == 0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - DIGITS + 1)
    return float(f"{math.ceil(value / unit * (1 - 1e-9)) * unit:.{DIGITS}g}")


def _bits(surface: Surface, step_mm: float) -> int | None:
    """Return the largest number of bits whose steps over the linear range are no smaller than the measured ones.

    In a scene the linear range takes the middle 80 % of the ADC's scale.
    """
    low, high = surface.channels[0].range_mm
    bits = math.floor(math.log2((high - low) / (0.8 * step_mm) + 1) + 1e-6)
    return min(bits, MAX_BITS) if bits >= MIN_BITS else None


def _stuck_after_ms(found: Sequence[ChannelNoise], noise_mm: float, surface: Surface) -> dict[str, float]:
    """Return the time for which counts may stay equal, by channel, where the stated noise allows much less."""
    times = {}
    for one, count_mm in zip(found, Characteristic.of(surface.channels).steepest.tolist(), strict=True):
        stated = longest_run(noise_mm / count_mm, surface.rate_hz)
        hidden = one.is_rounded or not one.step_mm
        own = math.inf if hidden else longest_run(one.fast_noise_mm / one.step_mm, surface.rate_hz)
        if own > RUNS_DIFFER * stated:
            times[one.channel] = min(rounded_up(1e3 * min(own, MAX_STUCK_MS) / surface.rate_hz), MAX_STUCK_MS)
    return times
