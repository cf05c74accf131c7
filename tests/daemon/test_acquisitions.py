"""What becomes of readings between a source and the log, and what is logged of them."""

import logging

import numpy as np
import pytest
from prometheus_client.core import Metric

from beamtouch_common.parts import Parts
from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.delivery.log_file import Chunk
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.running.metrics import CountCollector
from beamtouch_daemon.sources.reading import Reading
from beamtouch_daemon.sources.requests import Failure
from beamtouch_models.filters import Hurried
from beamtouch_service.samples import Note, Quality

from .acquiring import REST, Bench, reading
from .publishing import boot
from .surfaces import RATE_HZ, surface_of

pytestmark = pytest.mark.anyio

TRACKED: dict[str, object] = {"noise_mm": 0.003, "zero_tracking": {"drift_um_per_min": 4.0, "max_mm": 0.05}}
GROWING: dict[str, object] = {"kind": "growing-mean", "max_mean_ms": 1000.0, "window": 4}


async def test_readings_become_samples_once_they_are_processed() -> None:
    bench = Bench()
    bench.take(reading(50.0), reading(50.005, REST, None))
    assert (bench.samples(), bench.line.quality, bench.line.is_missing) == ([], [], False)
    bench.line.process()
    assert bench.samples() == [1, 2]
    assert bench.line.quality == [Quality.GOOD, Quality.MISSING]
    assert (bench.line.readings, bench.line.lost, bench.line.last_s) == (2, 0, 50.005)
    bench.line.process()
    assert bench.samples() == [1, 2]


async def test_at_most_64_readings_wait_to_become_samples() -> None:
    bench = Bench()
    for number in range(63):
        bench.take(reading(50.0 + number / RATE_HZ))
    assert bench.samples() == []
    bench.take(reading(50.0 + 63 / RATE_HZ))
    assert len(bench.samples()) == 64


@pytest.mark.parametrize(
    ("gap_s", "lost"), [(0.4 / RATE_HZ, 0), (1 / RATE_HZ, 0), (1.4 / RATE_HZ, 0), (1.6 / RATE_HZ, 1), (2.0, 399)]
)
async def test_readings_between_two_sessions_are_lost_by_the_clock(gap_s: float, lost: int) -> None:
    bench = Bench()
    bench.take(reading(50.0, lost=7))  # before the first reading, nothing was due
    assert bench.line.lost == 7
    bench.line.is_missing = True
    bench.take(reading(50.0 + gap_s, lost=5, failed=4))
    assert bench.line.lost == 7 + lost


async def test_a_device_that_is_read_for_the_first_time_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    bench = Bench()
    bench.take(reading(50.0))
    bench.line.is_missing = True
    bench.take(reading(51.0))
    assert [line for line in caplog.messages if line == "bench: reading"] == ["bench: reading"]


async def test_lost_readings_are_logged_by_their_cause(caplog: pytest.LogCaptureFixture) -> None:
    bench = Bench()
    bench.take(reading(50.0), reading(50.1, lost=5, failed=3), reading(50.2, lost=4, failed=2))
    assert bench.line.lost == 9
    assert caplog.messages == [
        "bench: 5 readings lost since the last such line, as requests fail",
        "bench: 4 readings lost since the last such line, by the device, the line or a busy machine",
    ]


async def test_an_error_in_the_processing_loses_the_readings_that_waited() -> None:
    bench = Bench()
    bench.take(reading(50.0))
    bench.line.process()
    bench.take(reading(50.01, lost=2), Reading(50.02, ("no number", 0.0)))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="could not convert"):
        bench.line.process()
    assert (bench.line.lost, bench.line._discarded) == (4, 4)
    bench.take(reading(50.03, lost=1))
    bench.line.process()
    taken_up = bench.boot.log.from_memory(range(2, 3))
    assert [(one.sample.sequence, one.reading.lost) for one in taken_up] == [(2, 5)]
    bench.take(reading(50.04, lost=1))
    bench.line.process()
    assert [one.reading.lost for one in bench.boot.log.from_memory(range(3, 4))] == [1]


async def test_samples_at_another_rate_carry_a_note() -> None:
    bench = Bench(surface_of(rate_hz=40.0))
    assert not any(one.notes for one in bench.boot.log.from_memory(range(1, 2)))
    bench.take(*[reading(50.0 + number / 10) for number in range(50)])
    bench.line.process()
    assert {one.notes for one in bench.boot.log.from_memory(range(1, bench.boot.log.next))} == {(Note.RATE,)}


async def test_another_rate_is_a_warning_and_the_right_one_is_none(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    bench = Bench(surface_of(rate_hz=40.0))
    bench.take(*[reading(50.0 + number / 10) for number in range(60)])
    bench.take(*[reading(56.0 + number / 40) for number in range(200)])
    said = [(record.levelname, record.message) for record in caplog.records]
    assert said[-2:] == [
        (
            "WARNING",
            "bench: only 10 of 40 readings per second could be polled: means are of 4 times fewer readings than "
            "configured; set rate_hz to 9.5 or less",
        ),
        ("INFO", "bench: 40 readings per second, within 10 % of rate_hz = 40"),
    ]


async def test_failing_requests_are_logged_and_that_they_no_longer_fail(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    bench = Bench()
    for number in range(20):
        bench.source.requests["unit 4"].answered() if number % 4 else bench.source.requests["unit 4"].fail(Failure.LATE)
    bench.take(reading(50.0))
    assert caplog.messages[-1] == "bench: 5 of 20 requests to unit 4 fail: late answer (5); raise timeout_ms"
    for _ in range(100):
        bench.source.requests["unit 4"].answered()
    bench.take(reading(50.1))
    assert caplog.messages[-1].startswith("bench: unit 4 answers all requests again after ")


def at_rest(number: int) -> list[Reading]:
    counts = REST + 30 * np.random.default_rng(2).standard_normal((number, 2))
    return [Reading(50.0 + index / RATE_HZ, tuple(row)) for index, row in enumerate(counts.tolist())]


async def test_readings_wait_at_rest_for_a_fifth_of_the_time_after_which_an_answer_is_stale() -> None:
    bench = Bench(surface_of(noise_mm=0.003, filter=GROWING), rests=True)
    for one in at_rest(400):
        bench.take(one)
        bench.line.process()
    assert bench.pipeline.most_waiting > 5

    def waiting(after_s: float, counts: float = REST) -> bool:
        """Return whether a reading so long after the newest sample waits for others."""
        return bench.line._may_wait([reading(bench.line._sampled_s + after_s, counts, REST)])

    assert not waiting(0.005)  # how long an answer may stand is not known
    bench.boot.pace.stale_s = 0.3
    assert [waiting(after_s) for after_s in (0.005, 0.059, 0.0601)] == [True, True, False]
    bench.boot.pace.stale_s = 9.0
    assert [waiting(after_s) for after_s in (0.099, 0.101)] == [True, False]  # rest_ms
    assert not waiting(0.005, REST + 1000)  # it leaves what the mean explains
    bench.line._unprocessed = [reading(0.0)] * bench.pipeline.most_waiting
    assert waiting(0.005)
    bench.line._unprocessed.append(reading(0.0))
    assert not waiting(0.005)


async def test_the_debug_log_says_which_channels_change_and_when_nothing_happens(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.DEBUG)
    bench = Bench(surface_of(noise_mm=0.003, filter=GROWING), rests=True)
    for one in at_rest(300):
        bench.take(one)
        bench.line.process()
    said = [line.removeprefix("bench: ") for line in caplog.messages if ": sample " in line]
    assert said[0].endswith(": s1 is good, s2 is good")
    assert said[1].endswith(": nothing happens: few samples, each the mean of all readings")
    bench.take(reading(60.0, REST, None))
    bench.line.process()
    assert caplog.messages[-2:] == [
        "bench: sample 301: s2 is missing",
        "bench: sample 301: one sample for each reading",
    ]


class Drifting(Pipeline):
    """A pipeline whose zeros are said to be far, or to drift in a hurry."""

    far_zero_mm: float | None = None
    hurried_zero: Hurried | None = None


def drifting() -> tuple[Bench, Drifting]:
    bench = Bench(surface_of(**TRACKED))
    bench.line._pipeline = pipeline = Drifting(bench.surface)
    return bench, pipeline


def process(bench: Bench, times: int = 2) -> None:
    for number in range(times):
        bench.take(reading(50.0 + bench.line.readings / RATE_HZ + number))
        bench.line.process()


async def test_zeros_that_are_far_from_the_tare_are_said_once_and_that_they_are_back(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO")
    bench, pipeline = drifting()
    process(bench)
    assert not [line for line in caplog.messages if "zeros" in line]
    pipeline.far_zero_mm = 0.0457
    process(bench)
    pipeline.far_zero_mm = None
    process(bench)
    assert [line for line in caplog.messages if "zeros" in line] == [
        "bench: its zeros have drifted by up to 45.7 um since the last tare; no more than 50 um are followed: wait "
        "until it no longer warms or cools, take everything off the beam, and tare",
        "bench: its zeros are near the last tare again",
    ]


@pytest.mark.parametrize(
    ("hurried", "said"),
    [
        (
            Hurried(1, 0.0137, is_common=False),
            "bench: the zero of s2 drifts at +14 um/min, 3.4 times what is stated, and answers will soon be wrong: "
            "look at this sensor and its bracket, or state",
        ),
        (
            Hurried(0, -0.0137, is_common=True),
            "bench: its zeros drift at -14 um/min, 3.4 times what is stated, and answers will soon be wrong: state",
        ),
    ],
)
async def test_a_zero_that_drifts_faster_than_is_stated_is_said_once(
    hurried: Hurried, said: str, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    bench, pipeline = drifting()
    pipeline.hurried_zero = hurried
    process(bench)
    pipeline.hurried_zero = None
    process(bench)
    assert [line for line in caplog.messages if "drift" in line] == [
        f"{said} the drift of the hall in zero_tracking.drift_um_per_min; a load laid on very slowly looks the same",
        "bench: its zeros again drift no faster than stated",
    ]


def found(collector: CountCollector) -> dict[tuple[str, ...], float]:
    metrics: list[Metric] = list(collector.collect())
    return {
        (sample.name.removeprefix("beamtouch_"), *sample.labels.values()): sample.value
        for metric in metrics
        for sample in metric.samples
        if not sample.name.endswith("_created")
    }


async def test_the_metrics_are_the_counts_of_the_acquisition_and_of_its_log() -> None:
    bench = Bench(surface_of(rate_hz=40.0))
    collector = CountCollector([bench.line], lambda: {"bench": bench.logs}, Parts(logging.getLogger(__name__)))
    before = found(collector)
    assert (before["source_missing", "bench"], before["untared", "bench"], before["rate_wrong", "bench"]) == (1, 0, 0)
    assert not [key for key in before if key[0] in {"reading_age_seconds", "readings_per_second", "channel_quality"}]
    begin_s = uptime_s() - 5.0
    bench.take(*[reading(begin_s + number / 10, lost=1) for number in range(50)])
    bench.line.process()
    bench.line.is_tared = False
    bench.source.requests["unit 3"].answered()
    for reason in (Failure.LATE, Failure.LATE, Failure.SILENT):
        bench.source.requests["unit 4"].fail(reason)
    bench.logs.adopt(Chunk(1, 3, 9), boot("boot-0000"))
    bench.logs.by_boot["boot-0000"].refusal = "No."
    bench.logs.counts.published, bench.logs.counts.dropped = 11, 13
    bench.boot.pace.is_thin = True
    now = found(collector)
    assert now["readings_total", "bench"] == 50
    assert now["readings_lost_total", "bench"] == 50
    assert (now["source_missing", "bench"], now["untared", "bench"], now["rate_wrong", "bench"]) == (0, 1, 1)
    assert now["readings_per_second", "bench"] == pytest.approx(10.0)
    assert 0.09 < now["reading_age_seconds", "bench"] < 60.0
    assert (now["requests_total", "bench", "unit 3"], now["requests_total", "bench", "unit 4"]) == (1, 3)
    failed = {key[2:]: value for key, value in now.items() if key[0] == "requests_failed_total"}
    assert failed == {("unit 4", "late"): 2, ("unit 4", "silent"): 1}
    qualities = {key[2:]: value for key, value in now.items() if key[0] == "channel_quality"}
    assert {key for key, value in qualities.items() if value} == {("s1", "good"), ("s2", "good")}
    assert len(qualities) == 2 * len(Quality)
    assert (now["samples_published_total", "bench"], now["samples_dropped_total", "bench"]) == (11, 13)
    assert (now["samples_in_log", "bench", "memory"], now["samples_in_log", "bench", "disk"]) == (50, 7)
    assert (now["boots_refused", "bench"], now["line_thin", "bench"]) == (1, 1)


async def test_the_metrics_tell_which_parts_fail_and_how_often_they_did() -> None:
    parts = Parts(logging.getLogger(__name__))
    parts.failures.update({"zeros": 3, "metrics": 2})
    parts.failing["zeros"] = "broken"
    now = found(CountCollector([], dict, parts))
    assert (now["part_failing", "zeros"], now["part_failing", "metrics"]) == (1, 0)
    assert (now["part_failures_total", "zeros"], now["part_failures_total", "metrics"]) == (3, 2)
