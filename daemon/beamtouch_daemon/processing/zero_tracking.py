"""Zero tracking: removes a slow drift of the rest gaps from the deflections while nothing touches the beam.

It follows the rule of weighing instruments (OIML R 76-1): near zero, when stable, slowly, within a limit. When
all channels have been good and within a band for a second, the zero of each channel moves towards its deflection, at a
limited rate and up to a limited total. Anything else stops all zeros until a second after it. Lost readings are no
disturbance, and prove no calm; only a gap of a second is like one. So a sudden contact that
deflects any channel by more than the band never counts as drift, however long it lasts. A contact that stays within the
band in all channels does, and so does one that grows as slowly as the rate, until the total is reached.

The band applies to single readings. It must be a few standard deviations wide, or noise alone stops the zeros: Gaussian
noise exceeds 4.5 standard deviations once in 150 000 readings. A wider band misses light contacts.
"""

import math
from collections.abc import Sequence

import numpy as np

from beamtouch_daemon.config.signal import ZeroTracking
from beamtouch_models.filters import FloatArray

CALM_S = 1.0
CALM_READINGS = 10
"""Zeros move after the longer of this time and this number of readings within the band."""


class ZeroTracker:
    """The zeros of one surface. Any split of the stream of readings gives the same zeros.

    Steps of a limited size make a zero follow the median, which a few odd readings do not move.
    """

    def __init__(self, settings: ZeroTracking, rate_hz: float, channels: int) -> None:
        self.zero_mm: FloatArray = np.zeros(channels)
        """Zero of each channel after the last reading, shape (channels,)."""
        self.calm_after = max(CALM_READINGS, math.ceil(CALM_S * rate_hz))
        """Readings in a row within the band, including the newest, before zeros move."""
        self._settings = settings
        self._step_mm = settings.rate_mm_per_min / 60 / rate_hz
        self._calm = 0
        """Readings within the band since the last disturbance."""

    def track(self, deflection: FloatArray, lost: Sequence[int] | None = None) -> FloatArray:
        """Return the zero to subtract from each deflection [mm]; it depends only on earlier readings.

        Parameters
        ----------
        deflection : Deflections [mm], shape (readings, channels), oldest first; NaN where a channel is not good.
        lost : Number of readings lost before each, shape (readings,); None: none.
        """
        zeros = np.empty_like(deflection)
        band_mm, max_mm = self._settings.band_mm, self._settings.max_mm
        for row, (value, gap) in enumerate(zip(deflection, lost or [0] * len(deflection), strict=True)):
            zeros[row] = self.zero_mm
            left = value - self.zero_mm
            is_calm = bool(np.all(np.abs(left) <= band_mm))  # NaN, a channel that is not good, is outside the band too
            self._calm = (0 if gap >= self.calm_after else self._calm) + 1 if is_calm else 0
            if self._calm >= self.calm_after:
                self.zero_mm = np.clip(self.zero_mm + np.clip(left, -self._step_mm, self._step_mm), -max_mm, max_mm)
        return zeros
