"""The configured filters: a chain of those in `beamtouch_models.filters`."""

import math

import numpy as np

from beamtouch_daemon.config.places import encoding_of
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.config.signal import Adaptive, Filter, GrowingMean, LowPass, MovingAverage
from beamtouch_daemon.processing.characteristic import Characteristic
from beamtouch_models import filters
from beamtouch_models.filters import Chain, FloatArray, Stage


def chain_of(surface: Surface) -> Chain:
    """Return the configured filters of a surface, with its noise, its steps and the period of its slowest motion."""
    channels, steps = len(surface.channels), steps_mm(surface)
    unit_mm, period = (
        filters.unit_of(surface.noise_mm or 0.0, steps, channels),
        (surface.slowest_period_ms or 0.0) * surface.rate_hz / 1e3,
    )
    return Chain(
        stages(surface.filter, surface.rate_hz, unit_mm, period),
        channels,
        surface.noise_mm,
        period,
        steps,
    )


def steps_mm(surface: Surface) -> FloatArray:
    """Return the steps of the readings [mm], shape (channels,); 0 for a channel whose counts are fractional numbers.

    A mean of n conversions scatters like a reading with steps that are sqrt(n) times smaller.
    """
    steps = Characteristic.of(surface.channels).steepest / math.sqrt(surface.conversions)
    return np.where([encoding_of(surface.source, channel) == "f32" for channel in surface.channels], 0.0, steps)


def stages(settings: Filter, rate_hz: float, unit_mm: FloatArray, slowest_period: float = 0.0) -> tuple[Stage, ...]:
    """Return the configured filters, in the order in which they apply.

    `unit_mm` is the noise of each channel, and `slowest_period` that of the beam, in readings.
    """
    mean = settings if isinstance(settings, MovingAverage | GrowingMean) else None
    chosen = filters.chosen_stages(
        mean.kind if mean else "none",
        window=mean.window if mean else 1,
        longest=settings.longest(rate_hz) if isinstance(settings, GrowingMean) else 1,
        spike_mm=settings.spike_mm,
        unit_mm=unit_mm,
        slowest_period=slowest_period,
    )
    if isinstance(settings, LowPass):
        return (*chosen, filters.low_pass_stage(filters.smoothing(settings.cutoff_hz, rate_hz)))
    if isinstance(settings, Adaptive):
        return (*chosen, filters.adaptive_stage(settings.window, settings.step_mm))
    return chosen
