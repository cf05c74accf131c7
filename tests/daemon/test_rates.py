"""The rate of readings, by their own times."""

import pytest

from beamtouch_daemon.processing.rate import RateMeter
from beamtouch_daemon.sources.reading import Reading


@pytest.mark.parametrize(
    ("configured_hz", "sent_hz", "within_s"), [(100.0, 2.0, 4.0), (5.0, 2.5, 8.8), (5.0, 50.0, 3.2)]
)
def test_another_rate_is_told_after_the_time_of_forty_readings_at_the_configured_one_or_sooner(
    configured_hz: float, sent_hz: float, within_s: float
) -> None:
    meter = RateMeter(configured_hz, is_polled=False)
    for number in range(round(within_s * sent_hz) + 1):
        meter.add([Reading(number / sent_hz, (1.0,))])
    assert not meter.fits
    assert meter.measured_hz == pytest.approx(sent_hz)
