"""Readings to samples: what the service is told, and what never reaches the filter."""

import math

import numpy as np
import pytest

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing.pipeline import Pipeline, Taken
from beamtouch_daemon.sources.reading import Reading
from beamtouch_service.samples import Quality

RATE_HZ = 100.0


def make_pipeline(window: int = 4, **changes: object) -> Pipeline:
    channels = [
        {
            "name": name,
            "register": index,
            "gain_mm_per_count": -0.001,
            "offset_mm": 4.0,
            "rest_gap_mm": 3.0,
            "range_mm": [1.0, 3.5],
            "adc_bits": 12,
        }
        for index, name in enumerate(("s1", "s2"))
    ]
    values: dict[str, object] = {
        "rate_hz": RATE_HZ,
        "source": {"kind": "modbus-tcp", "host": "127.0.0.1"},
        "filter": {"kind": "moving-average", "window": window},
        "channels": channels,
    }
    return Pipeline(Surface.model_validate(values | changes))


def deflections(taken: list[Taken]) -> list[float | None]:
    return [sample.sample.deflection_mm[0] for sample in taken]


def test_every_reading_becomes_one_sample_numbered_from_zero() -> None:
    pipeline = make_pipeline(window=1)
    first = pipeline.process([Reading(5.00, (1000, 1500)), Reading(5.01, (1100, 1500))], 100.0)
    second = pipeline.process([Reading(5.02, (1200, 1500))], 100.0)
    assert [taken.sample.sequence for taken in first + second] == [1, 2, 3]
    assert deflections(first + second) == pytest.approx([0.0, 0.1, 0.2])
    assert first[1].monotonic_s == 5.01
    assert first[1].sample.acquired_unix_us == 105_010_000


def test_a_missing_channel_is_null_and_the_other_one_good() -> None:
    (taken,) = make_pipeline(window=1).process([Reading(5.0, (None, 1500))], 0.0)
    assert taken.sample.deflection_mm == [None, pytest.approx(0.5)]
    assert taken.sample.quality == [Quality.MISSING, Quality.GOOD]


def test_a_bad_channel_passes_unfiltered_with_its_quality_and_never_enters_the_average() -> None:
    counts = [1000, 1000, 0, 1000, 1000, 4095, 400, 1000, 1000, 1000]
    readings = [Reading(5.0 + i / RATE_HZ, (count, 1500)) for i, count in enumerate(counts)]  # the other is good
    pipeline = make_pipeline()
    pipeline.process([Reading(4.97 + i / RATE_HZ, (1000, 1500)) for i in range(3)], 0.0)
    taken = pipeline.process(readings, 0.0)
    assert [sample.sample.quality[0] for sample in taken] == [
        Quality.GOOD,
        Quality.GOOD,
        Quality.SATURATED,
        Quality.GOOD,  # three of the last four are good
        Quality.GOOD,
        Quality.SATURATED,
        Quality.OUT_OF_RANGE,
        Quality.GOOD,  # two of the last four are
        Quality.GOOD,
        Quality.GOOD,
    ]
    expected = [0.0, 0.0, -1.0, 0.0, 0.0, 3.095, -0.6, 0.0, 0.0, 0.0]
    assert [value and round(value, 9) for value in deflections(taken)] == expected


@pytest.mark.parametrize(
    ("gap", "expected"),
    [
        (0, [0.25, 0.5, 0.75, 1.0]),
        (1, [1 / 3, 2 / 3, 1.0, 1.0]),
        (2, [0.5, 1.0, 1.0, 1.0]),
        (4, [1.0, 1.0, 1.0]),  # as at the start, the first value is of two readings
    ],
)
def test_a_mean_continues_over_a_gap_with_what_it_knew(gap: int, expected: list[float]) -> None:
    before = readings_of(*[(1000, 1500)] * 4)
    first, *others = readings_of(*[(2000, 1500)] * 4, start_s=5.04 + gap / RATE_HZ)
    after = [first._replace(lost=gap), *others]
    in_one = make_pipeline().process(before + after, 0.0)
    pipeline = make_pipeline()
    in_two = pipeline.process(before, 0.0) + pipeline.process(after, 0.0)
    assert deflections(in_one) == deflections(in_two) == pytest.approx([0.0] * 3 + expected)
    assert [one.sample.sequence for one in in_one] == list(range(1, len(in_one) + 1))


def test_times_that_jitter_are_no_gap_and_lost_readings_do_not_count() -> None:
    """On a busy machine, times of a serial line jump although no reading is lost."""
    noise = np.random.default_rng(1).normal(scale=3.0, size=(300, 2))
    times = np.sort(5.0 + np.arange(300) / RATE_HZ + np.random.default_rng(2).exponential(0.04, 300))
    counts = [(first, second) for first, second in (1000 + noise).tolist()]
    jittering = [Reading(at_s, pair) for at_s, pair in zip(times.tolist(), counts, strict=True)]
    assert growing().process(jittering, 0.0)[-1].sample.readings == 100
    pausing = [Reading(5.0, pair, lost=6 if index % 40 == 0 else 0) for index, pair in enumerate(counts)]
    # Of the last hundred readings, two gaps of six are lost.
    assert growing().process(pausing, 0.0)[-1].sample.readings == 88


def growing() -> Pipeline:
    return make_pipeline(noise_mm=0.003, filter={"kind": "growing-mean", "max_mean_ms": 1000.0})


def readings_of(*counts: tuple[float | None, float | None], start_s: float = 5.0) -> list[Reading]:
    return [Reading(start_s + index / RATE_HZ, pair) for index, pair in enumerate(counts)]


def test_a_frozen_channel_is_stuck_until_its_first_other_count_and_never_enters_the_average() -> None:
    pipeline = make_pipeline(window=1, noise_mm=0.003)  # three counts: 14 equal ones in a row are noise, 15 are not
    moving = [1000.0 + index % 2 for index in range(30)]
    frozen = [*[1500.0] * 20, *(1500.0 + index for index in range(1, 11))]
    taken = pipeline.process(readings_of(*zip(frozen, moving, strict=True)), 0.0)
    first = [sample.sample.quality[0] for sample in taken]
    assert first == [Quality.GOOD] * 14 + [Quality.STUCK] * 6 + [Quality.GOOD] * 10
    assert {sample.sample.quality[1] for sample in taken} == {Quality.GOOD}
    assert taken[19].sample.deflection_mm[0] == pytest.approx(0.5)  # its own, for the record
    assert taken[20].sample.deflection_mm[0] == pytest.approx(0.501)


def test_a_gap_does_not_free_a_stuck_channel() -> None:
    pipeline = make_pipeline(window=1, noise_mm=0.003)
    pipeline.process(readings_of(*[(1500, index) for index in range(100, 120)]), 0.0)
    (taken,) = pipeline.process([Reading(9.0, (1500, 1000), lost=380)], 0.0)
    assert taken.sample.quality == [Quality.STUCK, Quality.GOOD]


def test_saturated_and_out_of_range_channels_are_not_called_stuck() -> None:
    taken = make_pipeline(noise_mm=0.003).process(readings_of(*[(4095, 400)] * 20), 0.0)
    assert taken[-1].sample.quality == [Quality.SATURATED, Quality.OUT_OF_RANGE]


def test_without_a_stated_noise_no_channel_is_stuck() -> None:
    taken = make_pipeline().process(readings_of(*[(1500, 1500)] * 5000), 0.0)
    assert taken[-1].sample.quality == [Quality.GOOD, Quality.GOOD]


def test_a_tracked_zero_is_subtracted_before_the_filter_and_from_bad_channels_too() -> None:
    tracking = {"band_mm": 0.01, "rate_mm_per_min": 6.0, "max_mm": 1.0}  # 0.001 mm a reading
    pipeline = make_pipeline(window=1, zero_tracking=tracking)
    taken = pipeline.process(readings_of(*[(1005, 998)] * 110, (None, 1500), (400, 1500)), 0.0)
    assert taken[98].sample.deflection_mm == pytest.approx([0.005, -0.002])  # after a second the zeros begin to move
    assert taken[102].sample.deflection_mm == pytest.approx([0.002, 0.0])
    assert taken[109].sample.deflection_mm == pytest.approx([0.0, 0.0])
    assert taken[110].sample.deflection_mm == [None, pytest.approx(0.502)]
    assert taken[111].sample.deflection_mm == pytest.approx([-0.605, 0.502])


def test_a_long_gap_keeps_the_zeros_and_holds_them_for_a_second() -> None:
    pipeline = make_pipeline(window=1, zero_tracking={"band_mm": 0.01, "rate_mm_per_min": 6.0, "max_mm": 1.0})
    pipeline.process(readings_of(*[(1003, 1000)] * 110), 0.0)
    first, *others = readings_of(*[(1006, 1000)] * 110, start_s=20.0)
    after_a_gap = pipeline.process([first._replace(lost=1390), *others], 0.0)
    assert deflections(after_a_gap[:100]) == pytest.approx([0.003] * 100)
    assert deflections(after_a_gap)[-1] == pytest.approx(0.0)


def test_a_count_that_is_no_number_is_missing() -> None:
    (taken,) = make_pipeline().process(readings_of((math.inf, math.nan)), 0.0)
    assert taken.sample.quality == [Quality.MISSING, Quality.MISSING]
    assert taken.sample.deflection_mm == [None, None]
