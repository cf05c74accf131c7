"""The rate at which readings really come, beside the one that the configuration declares. Pure.

Filter windows, zero tracking, and what counts as stuck or as a gap are sized by the declared rate. At another rate they
last longer or shorter than configured, and the samples are not what the model was made for.
"""

from dataclasses import dataclass

from beamtouch_daemon.sources.reading import Reading

TOLERANCE = 0.1
"""Relative. Settling times, cutoffs and zero tracking shift by as much, and nobody states them more closely. Device
clocks are well within it: a ceramic resonator is within 0.5 %, a timer with coarse steps within a few percent."""
BLOCK_S = 1.5
BLOCK_READINGS = 20
"""The rate is measured over the longer of a time and a number of readings."""
AGREEING = 2
"""So many measurements in a row must say the same: one alone may have met a hiccup."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether the rate fits, and the measurement that says so."""

    fits: bool
    measured_hz: float


class RateMeter:
    """Measures the rate of one surface.

    It goes by the time stamps of readings, which follow the device's clock where there is one: readings that arrive in
    a burst are as far apart as they were taken. Where the device numbers its readings, those that were lost on the way
    count as taken: they are counted by themselves. Where the daemon polls, a slot that was missed is a reading less.
    """

    def __init__(self, declared_hz: float, *, counts_lost: bool) -> None:
        self.measured_hz: float | None = None
        """By the last measurement; None before the first."""
        self.fits = True
        """Whether the rate is the declared one, as far as is known."""
        self._declared_hz = declared_hz
        self._counts_lost = counts_lost
        self._disagreeing = 0
        self.restart()

    def restart(self) -> None:
        """Begin a measurement anew, as with each session; the verdict stands."""
        self._begin_s: float | None = None
        self._readings = 0

    def add(self, readings: list[Reading]) -> Verdict | None:
        """Take in readings, oldest first; return the verdict if it has just changed."""
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
        """Whether there are readings enough, or time enough for them at the declared rate."""
        return self._readings >= BLOCK_READINGS or lasted_s * self._declared_hz >= BLOCK_READINGS

    def _judge(self, measured_hz: float) -> Verdict | None:
        self.measured_hz = measured_hz
        fits = abs(measured_hz / self._declared_hz - 1) <= TOLERANCE
        self._disagreeing = 0 if fits == self.fits else self._disagreeing + 1
        if self._disagreeing < AGREEING:
            return None
        self.fits, self._disagreeing = fits, 0
        return Verdict(fits, measured_hz)


def complaint(verdict: Verdict, declared_hz: float, *, polled: bool) -> str:
    """Return one line: what was measured, what is declared, and what to set."""
    measured_hz = verdict.measured_hz
    windows = "longer" if measured_hz < declared_hz else "shorter"
    if polled:
        done = f"only {measured_hz:.4g} of {declared_hz:g} readings per second could be polled"
        remedy = f"set rate_hz to {float(f'{0.95 * measured_hz:.2g}'):g} or less"
    else:
        done = f"the device sends {measured_hz:.4g} readings per second, rate_hz is {declared_hz:g}"
        remedy = f"set rate_hz = {max(1, round(measured_hz))} or correct the device"
    times = max(declared_hz / measured_hz, measured_hz / declared_hz)
    return f"{done}: filter windows last {times:.2g} times {windows} than configured; {remedy}"
