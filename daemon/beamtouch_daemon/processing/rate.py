"""Measures the rate of the readings and compares it with the configured one. Pure.

Filter windows, zero tracking and the limits for stuck channels are sized by the configured rate. At another rate of the
device they last longer or shorter than configured. If the daemon polls and misses slots, means are of fewer readings.
Either way, the samples are not what the model was made for.
"""

from dataclasses import dataclass

from beamtouch_common.digits import digits
from beamtouch_daemon.sources.reading import Reading

TOLERANCE = 0.1
"""Tolerance of the rate. Settling times, cutoffs and zero tracking shift by as much; nobody states them more closely.
Device clocks are better: a ceramic resonator is within 0.5 %, a timer with coarse steps within a few percent."""
BLOCK_S = 1.5
BLOCK_READINGS = 20
"""The rate is measured over the longer of this time and this number of readings."""
AGREEING = 2
"""Number of successive measurements that must agree, as a single one may be disturbed."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """The measured rate, and whether it fits."""

    fits: bool
    measured_hz: float


class RateMeter:
    """Measures the rate of one surface.

    It uses the time stamps of the readings. These follow the device's clock, if it has one, so readings that arrive in
    a burst count with the times at which they were taken. If the device numbers its readings (`counts_lost`), readings
    lost on the way count as taken. If the daemon polls, they do not.
    """

    def __init__(self, configured_hz: float, *, counts_lost: bool) -> None:
        self.measured_hz: float | None = None
        """Result of the last measurement; None before the first."""
        self.fits = True
        """Whether the rate is the configured one, as far as is known."""
        self._configured_hz = configured_hz
        self._counts_lost = counts_lost
        self._disagreeing = 0
        self.restart()

    def restart(self) -> None:
        """Start a new measurement, as at the start of each session; the verdict stays."""
        self._begin_s: float | None = None
        self._readings = 0

    def add(self, readings: list[Reading]) -> Verdict | None:
        """Add readings, oldest first; return the verdict if it has just changed."""
        changed = None
        for reading in readings:
            if self._begin_s is None:
                self._begin_s = reading.monotonic_s
                continue
            self._readings += 1 + (reading.lost if self._counts_lost else 0)
            lasted_s = reading.monotonic_s - self._begin_s
            if lasted_s >= BLOCK_S and self._enough(lasted_s):
                changed = self._judge(self._readings / lasted_s) or changed
                self._begin_s, self._readings = reading.monotonic_s, 0
        return changed

    def _enough(self, lasted_s: float) -> bool:
        """Return whether there are enough readings, or enough time for them at the configured rate."""
        return self._readings >= BLOCK_READINGS or lasted_s * self._configured_hz >= BLOCK_READINGS

    def _judge(self, measured_hz: float) -> Verdict | None:
        self.measured_hz = measured_hz
        fits = abs(measured_hz / self._configured_hz - 1) <= TOLERANCE
        self._disagreeing = 0 if fits == self.fits else self._disagreeing + 1
        if self._disagreeing < AGREEING:
            return None
        self.fits, self._disagreeing = fits, 0
        return Verdict(fits, measured_hz)


def complaint(verdict: Verdict, configured_hz: float, *, polled: bool) -> str:
    """Return one line: the measured rate, the configured rate, and what to set."""
    measured_hz = verdict.measured_hz
    times = digits(max(configured_hz / measured_hz, measured_hz / configured_hz), 2)
    if polled:
        return (
            f"only {digits(measured_hz, 4)} of {configured_hz:g} readings per second could be polled: means are of "
            f"{times} times fewer readings than configured; set rate_hz to {digits(0.95 * measured_hz, 2)} or less"
        )
    windows = "longer" if measured_hz < configured_hz else "shorter"
    return (
        f"the device sends {digits(measured_hz, 4)} readings per second, rate_hz is {configured_hz:g}: "
        f"filter windows last {times} times {windows} than configured; "
        f"set rate_hz = {max(1, round(measured_hz))} or correct the device"
    )
