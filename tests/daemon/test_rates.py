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


def meter_of(sent_hz: float, configured_hz: float, *, is_polled: bool, lost: int = 0, failed: int = 0) -> RateMeter:
    """Return a meter after two measurements, in which each reading follows so many that were lost or failed."""
    meter = RateMeter(configured_hz, is_polled=is_polled)
    readings = [Reading(7.0 + number / sent_hz, (1.0,), lost, failed) for number in range(round(20 * sent_hz))]
    changes = [meter.add([reading]) for reading in readings]
    assert sum(changes) == (not meter.fits)
    return meter


@pytest.mark.parametrize(("sent_hz", "fits"), [(36.1, True), (43.9, True), (35.9, False), (44.1, False), (40.0, True)])
def test_a_rate_fits_within_a_tenth(sent_hz: float, fits: bool) -> None:
    assert meter_of(sent_hz, 40.0, is_polled=False).fits == fits


@pytest.mark.parametrize(("is_polled", "measured_hz"), [(True, 5.0), (False, 20.0)])
def test_lost_readings_of_a_device_that_numbers_them_were_taken(is_polled: bool, measured_hz: float) -> None:
    meter = meter_of(5.0, 20.0, is_polled=is_polled, lost=3)
    assert meter.measured_hz == pytest.approx(measured_hz)
    assert meter.fits == (not is_polled)


def test_one_disturbed_measurement_changes_no_verdict_and_two_that_agree_do() -> None:
    meter = RateMeter(20.0, is_polled=False)
    at_s, verdicts = 0.0, []
    for readings_hz in (20, 10, 20, 10, 10, 20, 20):  # each over 20 readings, or 1.5 s at least
        for _ in range(40):
            at_s += 1 / readings_hz
            if meter.add([Reading(at_s, (1.0,))]):
                verdicts.append((readings_hz, meter.fits))
    assert verdicts == [(10, False), (20, True)]


def test_a_new_session_starts_a_new_measurement_and_the_verdict_stays() -> None:
    meter = meter_of(10.0, 40.0, is_polled=True)
    meter.restart()
    meter.add([Reading(at_s, (1.0,)) for at_s in (1000.0, 1000.025, 1000.05)])
    assert not meter.fits
    assert meter.measured_hz == pytest.approx(10.0)


def test_readings_that_arrive_together_count_as_those_that_come_one_by_one() -> None:
    meter = RateMeter(20.0, is_polled=False)
    assert not meter.add([Reading(7.0 + number / 12.5, (1.0,)) for number in range(20)])
    assert meter.measured_hz == pytest.approx(12.5)  # of 1.52 s, which would have brought more than 20 readings
    assert meter.add([Reading(7.0 + number / 12.5, (1.0,)) for number in range(20, 60)])


@pytest.mark.parametrize(
    ("meter", "said"),
    [
        (meter_of(38.516, 40.0, is_polled=False), "38.52 readings per second, within 10 % of rate_hz = 40"),
        (
            meter_of(10.0, 40.0, is_polled=False),
            "the device sends 10 readings per second, rate_hz is 40: filter windows last 4 times longer than "
            "configured; set rate_hz = 10 or correct the device",
        ),
        (
            meter_of(62.5, 25.0, is_polled=False),
            "the device sends 62.5 readings per second, rate_hz is 25: filter windows last 2.5 times shorter than "
            "configured; set rate_hz = 62 or correct the device",
        ),
        (
            meter_of(0.3, 40.0, is_polled=False),
            "the device sends 0.3 readings per second, rate_hz is 40: filter windows last 130 times longer than "
            "configured; set rate_hz = 1 or correct the device",
        ),
        (
            meter_of(10.0, 40.0, is_polled=True, lost=3),
            "only 10 of 40 readings per second could be polled: means are of 4 times fewer readings than configured; "
            "set rate_hz to 9.5 or less",
        ),
        (
            meter_of(13.5678, 321.5, is_polled=True, lost=23),
            "only 13.57 of 321.5 readings per second could be polled: means are of 24 times fewer readings than "
            "configured; set rate_hz to 13 or less",
        ),
        (
            meter_of(13.5678, 321.5, is_polled=False),
            "the device sends 13.57 readings per second, rate_hz is 321.5: filter windows last 24 times longer than "
            "configured; set rate_hz = 14 or correct the device",
        ),
        (
            meter_of(10.0, 40.0, is_polled=True, lost=3, failed=1),  # 10 of the 30 that are missing
            "only 10 of 40 readings per second could be polled: means are of 4 times fewer readings than configured; "
            "set rate_hz to 19 or less",
        ),
        (
            meter_of(10.0, 31.0, is_polled=True, lost=3, failed=1),  # 10 of 21, which is less than half
            "only 10 of 31 readings per second could be polled: means are of 3.1 times fewer readings than "
            "configured; set rate_hz to 19 or less",
        ),
        (
            meter_of(10.0, 30.0, is_polled=True, lost=3, failed=1),
            "only 10 of 30 readings per second arrive, as requests fail: means are of 3 times fewer readings than "
            "configured; mend what fails, as a lower rate_hz does not help",
        ),
    ],
    ids=[
        "it fits",
        "slow",
        "quick",
        "very slow",
        "polled",
        "many digits",
        "many digits of a device",
        "some fail",
        "nearly half fail",
        "half fail",
    ],
)
def test_a_rate_is_told_with_what_to_set(meter: RateMeter, said: str) -> None:
    assert str(meter) == said
