"""Readings to samples: what the service is told, and what never reaches the filter."""

import pytest

from beamtouch_daemon.calibration import Calibration
from beamtouch_daemon.config_signal import Channel, MovingAverage
from beamtouch_daemon.filters import Chain, stages
from beamtouch_daemon.pipeline import Pipeline, Taken
from beamtouch_daemon.sources.reading import Reading
from beamtouch_service.samples import Quality

RATE_HZ = 100.0


def make_pipeline(window: int = 4) -> Pipeline:
    channels = [
        Channel.model_validate(
            {
                "name": name,
                "register": index,
                "gain_mm_per_count": -0.001,
                "offset_mm": 4.0,
                "rest_gap_mm": 3.0,
                "range_mm": [1.0, 3.5],
                "adc_bits": 12,
            }
        )
        for index, name in enumerate(("s1", "s2"))
    ]
    chain = Chain(stages(MovingAverage(kind="moving-average", window=window), RATE_HZ), 2)
    return Pipeline(Calibration.of(channels), chain, RATE_HZ)


def deflections(taken: list[Taken]) -> list[float | None]:
    return [sample.sample.deflection_mm[0] for sample in taken]


def test_every_reading_becomes_one_sample_numbered_from_zero() -> None:
    pipeline = make_pipeline(window=1)
    first = pipeline.process([Reading(5.00, (1000, 1500)), Reading(5.01, (1100, 1500))], 100.0)
    second = pipeline.process([Reading(5.02, (1200, 1500))], 100.0)
    assert [taken.sample.sequence for taken in first + second] == [0, 1, 2]
    assert deflections(first + second) == pytest.approx([0.0, 0.1, 0.2])
    assert first[1].monotonic_s == 5.01
    assert first[1].sample.acquired_unix_us == 105_010_000


def test_a_missing_channel_is_null_and_the_other_one_good() -> None:
    (taken,) = make_pipeline().process([Reading(5.0, (None, 1500))], 0.0)
    assert taken.sample.deflection_mm == [None, pytest.approx(0.5)]
    assert taken.sample.quality == [Quality.MISSING, Quality.GOOD]


def test_what_is_not_good_passes_unfiltered_with_its_quality_and_never_enters_the_average() -> None:
    readings = [Reading(5.0 + i / RATE_HZ, (counts, 1500)) for i, counts in enumerate([1000, 0, 4095, 400, 1000])]
    taken = make_pipeline().process(readings, 0.0)
    assert [sample.sample.quality[0] for sample in taken] == [
        Quality.GOOD,
        Quality.SATURATED,
        Quality.SATURATED,
        Quality.OUT_OF_RANGE,
        Quality.GOOD,
    ]
    assert deflections(taken) == pytest.approx([0.0, -1.0, 3.095, -0.6, 0.0])


def test_after_a_gap_in_the_readings_the_filter_starts_anew() -> None:
    before = [Reading(5.00, (1000, 1500)), Reading(5.01, (1000, 1500))]
    after = [Reading(5.05, (2000, 1500)), Reading(5.06, (2000, 1500))]
    in_one = make_pipeline().process(before + after, 0.0)
    pipeline = make_pipeline()
    in_two = pipeline.process(before, 0.0) + pipeline.process(after, 0.0)
    assert deflections(in_one) == deflections(in_two) == pytest.approx([0.0, 0.0, 1.0, 1.0])


def test_one_reading_missed_is_not_a_gap() -> None:
    taken = make_pipeline().process([Reading(5.00, (1000, 1500)), Reading(5.02, (2000, 1500))], 0.0)
    assert deflections(taken) == pytest.approx([0.0, 0.5])


def test_a_new_session_starts_the_filter_anew_and_goes_on_counting() -> None:
    pipeline = make_pipeline()
    pipeline.process([Reading(5.00, (1000, 1500))], 0.0)
    pipeline.restart()
    (taken,) = pipeline.process([Reading(5.01, (2000, 1500))], 0.0)
    assert taken.sample.sequence == 1
    assert deflections([taken]) == pytest.approx([1.0])
