"""The configured filters: a chain of those in `beamtouch_models.filters`."""

import math

from beamtouch_daemon.config.signal import Adaptive, Filter, LowPass, MovingAverage
from beamtouch_models import filters
from beamtouch_models.filters import Stage

MIN_FILL = 0.75
"""Part of the averaging window that good readings must fill before a channel has a value.

The noise of that first value is at most 1.15 times that of a full window. A single reading would be noisier still, and
could make a beam at rest look touched.
"""


def stages(settings: Filter, rate_hz: float) -> tuple[Stage, ...]:
    """Return the configured filters, in the order in which they apply."""
    chosen = []
    if (limit_mm := settings.spike_mm) is not None:
        chosen.append(Stage(filters.SPIKE_MEMORY, lambda values, state: filters.spike(values, state, limit_mm)))
    if isinstance(settings, MovingAverage):
        window, needed = settings.window, math.ceil(MIN_FILL * settings.window)
        chosen.append(Stage(window - 1, lambda values, state: filters.moving_average(values, state, window, needed)))
    elif isinstance(settings, LowPass):
        factor = filters.smoothing(settings.cutoff_hz, rate_hz)
        chosen.append(Stage(filters.LOW_PASS_MEMORY, lambda values, state: filters.low_pass(values, state, factor)))
    elif isinstance(settings, Adaptive):
        longest, step_mm = settings.window, settings.step_mm
        chosen.append(Stage(longest, lambda values, state: filters.adaptive(values, state, longest, step_mm)))
    return tuple(chosen)
