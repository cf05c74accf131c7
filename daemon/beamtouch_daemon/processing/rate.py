"""Measures the rate of the readings and compares it with the configured one. Pure.

Filter windows, zero tracking and the limits for stuck channels are sized by the configured rate. At another rate of the
device they last longer or shorter than configured. If the daemon polls and misses slots, means are of fewer readings.
Either way, the samples are not what the model was made for.
"""

from beamtouch_common.digits import digits
from beamtouch_daemon.sources.reading import Reading

TOLERANCE = 0.1
"""Tolerance of the rate. Settling times, cutoffs and zero tracking shift by as much; nobody states them more closely.
Device clocks are better: a ceramic resonator is within 0.5 %, a timer with coarse steps within a few percent."""
BLOCK_S = 1.5
BLOCK_READINGS = 20
"""The rate is measured over the longer of this time and this number of readings."""
FAILED_PART = 0.5
"""If failed requests cost this part of the missing readings, they are the reason."""
AGREEING = 2
"""Number of successive measurements that must agree, as a single one may be disturbed."""


class RateMeter:
    """Measures the rate of one surface.

    It uses the time stamps of the readings. These follow the device's clock, if it has one, so readings that arrive in
    a burst count with the times at which they were taken. If the device numbers its readings, readings lost on the way
    count as taken. If the daemon polls (`is_polled`), they do not.
    """

    def __init__(self, configured_hz: float, *, is_polled: bool) -> None:
        self.measured_hz: float | None = None
        """Result of the last measurement; None before the first."""
        self.fits = True
        """True if the rate is the configured one, as far as is known."""
        self._configured_hz = configured_hz
        self._is_polled = is_polled
        self._failed_hz = 0.0
        """Readings that failed requests have cost in the last measurement, per second."""
        self._disagreeing = 0
        self.restart()

    def restart(self) -> None:
        """Start a new measurement, as at the start of each session; the verdict stays."""
        self._begin_s: float | None = None
        self._readings = self._failed = 0

    def add(self, readings: list[Reading]) -> bool:
        """Add readings, oldest first; return whether the verdict has just changed."""
        before = self.fits
        for reading in readings:
            if self._begin_s is None:
                self._begin_s = reading.monotonic_s
                continue
            self._readings += 1 + (0 if self._is_polled else reading.lost)
            self._failed += reading.failed
            lasted_s = reading.monotonic_s - self._begin_s
            # Enough readings, or enough time for them at the configured rate.
            if lasted_s >= BLOCK_S and max(self._readings, lasted_s * self._configured_hz) >= BLOCK_READINGS:
                self._judge(self._readings / lasted_s, self._failed / lasted_s)
                self._begin_s, self._readings, self._failed = reading.monotonic_s, 0, 0
        return self.fits != before

    def _judge(self, measured_hz: float, failed_hz: float) -> None:
        self.measured_hz, self._failed_hz = measured_hz, failed_hz
        fits = abs(measured_hz / self._configured_hz - 1) <= TOLERANCE
        self._disagreeing = 0 if fits == self.fits else self._disagreeing + 1
        if self._disagreeing == AGREEING:
            self.fits, self._disagreeing = fits, 0

    def __str__(self) -> str:
        """Return one line: the measured rate, the configured rate, and what to set if they differ."""
        measured_hz, configured_hz = self.measured_hz or 0.0, self._configured_hz
        if self.fits:
            within = f"within {100 * TOLERANCE:g} % of rate_hz = {configured_hz:g}"
            return f"{measured_hz:.4g} readings per second, {within}"
        times = digits(max(configured_hz / measured_hz, measured_hz / configured_hz), 2)
        if self._is_polled:
            only = f"only {digits(measured_hz, 4)} of {configured_hz:g} readings per second"
            fewer = f"means are of {times} times fewer readings than configured"
            if self._failed_hz >= FAILED_PART * (configured_hz - measured_hz):
                return f"{only} arrive, as requests fail: {fewer}; mend what fails, as a lower rate_hz does not help"
            slower_hz = 0.95 * (measured_hz + self._failed_hz)
            return f"{only} could be polled: {fewer}; set rate_hz to {digits(slower_hz, 2)} or less"
        windows = "longer" if measured_hz < configured_hz else "shorter"
        return (
            f"the device sends {digits(measured_hz, 4)} readings per second, rate_hz is {configured_hz:g}: "
            f"filter windows last {times} times {windows} than configured; "
            f"set rate_hz = {max(1, round(measured_hz))} or correct the device"
        )
