"""Readings to samples: what the service is told, how uncertain it is, and what never reaches the filter."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing import pipeline
from beamtouch_daemon.processing.filters import steps_mm
from beamtouch_daemon.processing.pipeline import Pipeline, TimedSample
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models.filters import FloatArray, Rested
from beamtouch_service.samples import Note, Quality, Sample

from .surfaces import RATE_HZ, STEP_MM, counts_of, mean_of, surface_of

GOOD, MISSING, SATURATED, STUCK = Quality.GOOD, Quality.MISSING, Quality.SATURATED, Quality.STUCK
NOISE_MM = 0.003
REST, DOWN = 20_000.0, 30_000.0
"""Counts at rest, and of a deflection of 1 mm."""
Counts = float | None


def readings_of(*counts: Sequence[Counts], start_s: float = 5.0, lost: int = 0) -> list[Reading]:
    """Return readings on schedule; `lost` is the number before the first."""
    return [Reading(start_s + index / RATE_HZ, tuple(row), 0 if index else lost) for index, row in enumerate(counts)]


def deflections(taken: list[TimedSample]) -> list[float | None]:
    return [one.sample.deflection_mm[0] for one in taken]


def qualities(taken: list[TimedSample]) -> list[Quality]:
    return [one.sample.quality[0] for one in taken]


def test_a_number_that_is_larger_than_any_value_is_none_as_devices_send_it() -> None:
    rows = [Reading(5.0, (1e12, -1e12, 7)), Reading(5.1, (1.000001e12, -math.inf, None))]
    first, second = pipeline.counts_of(rows).tolist()
    assert (first, [math.isnan(count) for count in second]) == ([1e12, -1e12, 7.0], [True] * 3)


def test_every_reading_becomes_one_sample_numbered_from_one_with_its_own_time() -> None:
    pipeline = Pipeline(surface_of(filter=mean_of(1)))
    first = pipeline.process([Reading(5.00, (20_000, 21_000)), Reading(5.01, (21_000, 21_000))], 100.0)
    second = pipeline.process([Reading(5.02, (22_000, 21_000))], 100.0)
    assert [one.sample.sequence for one in first + second] == [1, 2, 3]
    assert deflections(first + second) == pytest.approx([0.0, 0.1, 0.2])
    assert (first[1].monotonic_s, first[1].sample.acquired_unix_us) == (5.01, 105_010_000)


def test_a_bad_channel_passes_unfiltered_with_its_quality_and_never_enters_the_average() -> None:
    counts = [REST, REST, 0, REST, None, 65_535, 4000, math.inf, REST, REST, REST]
    pipeline = Pipeline(surface_of(filter=mean_of(4)))
    pipeline.process(readings_of(*[(REST, REST)] * 3), 0.0)
    taken = pipeline.process(readings_of(*[(count, REST) for count in counts]), 0.0)
    assert qualities(taken) == [
        *(GOOD, GOOD, SATURATED, GOOD, MISSING, SATURATED, Quality.OUT_OF_RANGE),
        *(MISSING, MISSING, GOOD, GOOD),  # one of the last four is good, then two
    ]
    expected = [0.0, 0.0, -2.0, 0.0, None, 4.5535, -1.6, None, None, 0.0, 0.0]
    assert [value and round(value, 9) for value in deflections(taken)] == expected
    assert {one.sample.quality[1] for one in taken} == {GOOD}


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
    pipeline = Pipeline(surface_of(filter=mean_of(4)))
    before = pipeline.process(readings_of(*[(REST, REST)] * 4), 0.0)
    after = pipeline.process(readings_of(*[(DOWN, REST)] * 4, start_s=6.0, lost=gap), 0.0)
    assert deflections(before + after) == pytest.approx([0.0] * 3 + expected)


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "With every kind of filter, `spike_mm` protects against single wrong readings.",
)
@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "A deflection that is further than this from the median of the last three is a spike, and enters no mean.",
)
@pytest.mark.parametrize("kind", [{"kind": "none"}, mean_of(1), {"kind": "growing-mean", "window": 1}])
def test_a_single_spike_never_passes(kind: dict[str, object]) -> None:
    pipeline = Pipeline(surface_of(filter=kind | {"spike_mm": 0.02}, noise_mm=NOISE_MM))
    taken = pipeline.process(readings_of(*[(REST, REST)] * 5, (DOWN, REST), *[(REST, REST)] * 5), 0.0)
    assert deflections(taken) == pytest.approx([0.0] * len(taken))


@pytest.mark.promise("docs/explanation/readings-to-samples.md", "make no filter begin anew")
def test_times_that_jitter_are_no_gap_and_lost_readings_do_not_count() -> None:
    """On a busy machine, times of a serial line jump although no reading is lost."""
    surface = surface_of(noise_mm=NOISE_MM, filter={"kind": "growing-mean", "max_mean_ms": 500.0})
    counts = (REST + np.random.default_rng(1).normal(scale=30.0, size=(300, 2))).tolist()
    times = np.sort(5.0 + np.arange(300) / RATE_HZ + np.random.default_rng(2).exponential(0.02, 300)).tolist()
    jittering = [Reading(at_s, tuple(row)) for at_s, row in zip(times, counts, strict=True)]
    assert Pipeline(surface).process(jittering, 0.0)[-1].sample.readings == 100
    pausing = [Reading(5.0, tuple(row), lost=6 if index % 40 == 0 else 0) for index, row in enumerate(counts)]
    # Of the last hundred readings, two gaps of six are lost.
    assert Pipeline(surface).process(pausing, 0.0)[-1].sample.readings == 88


def test_a_beam_that_rings_is_followed_by_the_best_estimates_of_when_readings_were_taken() -> None:
    """The safe stamps of a busy machine are as far apart as its processes run."""
    keys = {"filter": {"kind": "growing-mean", "window": 4, "max_mean_ms": 1000.0}, "slowest_period_ms": 100.0}
    surface, chance = surface_of(noise_mm=NOISE_MM, **keys), np.random.default_rng(3)
    taken_s = 5.0 + np.arange(300) / RATE_HZ + chance.normal(scale=0.1 / RATE_HZ, size=300)
    since = np.maximum(taken_s - taken_s[150] + 0.3 / RATE_HZ, 0.0) * (taken_s >= taken_s[150])
    bent = 1 - np.exp(-2.0 * since) * np.cos(2 * np.pi * 0.22 * RATE_HZ * since)
    counts = REST + np.rint(np.outer(bent, [9000.0, 4000.0]) + chance.normal(scale=30.0, size=(300, 2)))
    late_s = taken_s - chance.exponential(0.5 / RATE_HZ, size=300)
    rows = list(zip(late_s.tolist(), counts.tolist(), taken_s.tolist(), strict=True))
    known = Pipeline(surface).process(
        [Reading(at_s, tuple(row), taken_s=likely_s) for at_s, row, likely_s in rows], 0.0
    )
    exact = Pipeline(surface).process([Reading(likely_s, tuple(row)) for _, row, likely_s in rows], 0.0)
    asked = Pipeline(surface).process([Reading(at_s, tuple(row)) for at_s, row, _ in rows], 0.0)
    assert deflections(known) == deflections(exact)
    assert deflections(known)[190] == pytest.approx(0.9, abs=0.01)
    assert deflections(asked)[190] != pytest.approx(0.9, abs=0.03)


def test_a_frozen_channel_is_stuck_until_its_first_other_count_and_never_enters_the_average() -> None:
    surface = surface_of(filter=mean_of(1), noise_mm=3 * STEP_MM)  # 14 equal counts in a row are noise, 15 are not
    moving = [REST + index % 2 for index in range(20)]
    frozen = [*[DOWN] * 20]
    pipeline = Pipeline(surface)
    taken = pipeline.process(readings_of(*zip(frozen, moving, strict=True)), 0.0)
    assert qualities(taken) == [GOOD] * 14 + [STUCK] * 6
    assert {one.sample.quality[1] for one in taken} == {GOOD}
    assert deflections(taken)[-1] == pytest.approx(1.0)  # its own, for the record
    held, free = pipeline.process(readings_of((DOWN, REST), (DOWN + 1, REST), start_s=9.0, lost=380), 0.0)
    assert (held.sample.quality[0], free.sample.quality[0]) == (STUCK, GOOD)  # a gap frees none
    ended = Pipeline(surface).process(readings_of(*[(65_535, 4000)] * 20), 0.0)
    assert ended[-1].sample.quality == [SATURATED, Quality.OUT_OF_RANGE]
    unknown = Pipeline(surface_of()).process(readings_of(*[(REST, REST)] * 5000), 0.0)
    assert qualities(unknown)[-1] is GOOD  # without a stated noise


TRACKING = {"drift_um_per_min": 60.0, "max_mm": 0.02}
TRACKED: dict[str, object] = {"noise_mm": NOISE_MM, "zero_tracking": TRACKING, "zero_drift_mm": 0.005}


def test_a_tracked_zero_is_subtracted_before_the_filter_and_from_bad_channels_too() -> None:
    pipeline = Pipeline(surface_of(filter=mean_of(1), **TRACKED))
    resting = [(20_050 + index % 2, 19_980 + index % 2) for index in range(4000)]  # counts that stay are stuck
    taken = pipeline.process(readings_of(*resting, (None, 25_000), (4000, 25_000)), 0.0)
    assert taken[0].sample.deflection_mm == pytest.approx([0.005, -0.002], abs=1e-4)
    assert taken[3999].sample.deflection_mm == pytest.approx([0.0, 0.0], abs=1e-4)
    assert taken[4000].sample.deflection_mm == [None, pytest.approx(0.502, abs=1e-4)]
    assert taken[4001].sample.deflection_mm == pytest.approx([-1.605, 0.502], abs=1e-4)


def wobbling(counts: float, number: int) -> list[tuple[float, float]]:
    """Return readings that are not stuck."""
    return [(counts + index % 2, counts + index % 2) for index in range(number)]


@pytest.mark.promise(
    "docs/reference/samples.md",
    "states in `zero_mm` how far they may have drifted since, once that is more than the model allows for.",
)
@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "As soon as this is more than `zero_drift_mm`, a sample states it (`zero_mm`)",
)
def test_a_sample_says_how_far_zeros_may_have_drifted_once_it_is_more_than_is_allowed_for() -> None:
    pipeline = Pipeline(surface_of(filter=mean_of(1), **TRACKED))
    resting = pipeline.process(readings_of(*wobbling(REST, 400)), 0.0)
    assert {one.sample.zero_mm is None for one in resting[100:]} == {True}
    pressed = pipeline.process(readings_of(*wobbling(DOWN, round(30 * RATE_HZ))), 0.0)
    common_mm, own_mm = pressed[-1].sample.zero_mm or (0.0, 0.0)
    assert common_mm == pytest.approx(TRACKING["max_mm"] / 3**0.5, rel=0.01)  # 30 um would be beyond the limit
    assert own_mm == pytest.approx(0.0029, rel=0.1)
    assert [float(f"{own_mm:.{digits}g}") == own_mm for digits in (2, 3)] == [False, True]
    lifted = pipeline.process(readings_of(*wobbling(REST, 400)), 0.0)
    assert lifted[-1].sample.zero_mm is None


@pytest.mark.parametrize(
    ("zero_mm", "far_mm"),
    [((0.0139, -0.0139), None), ((0.0141, 0.003), 0.0141), ((0.003, -0.0141), 0.0141), ((0.0145, -0.0192), 0.0192)],
)
def test_a_zero_is_far_from_the_last_tare_from_seven_tenths_of_what_is_followed(
    zero_mm: tuple[float, float], far_mm: float | None
) -> None:
    surface = surface_of(filter=mean_of(1), **TRACKED)
    pipeline = Pipeline(surface, rested=Rested(1.0, zero_mm, (0.001, 0.001)))
    assert pipeline.far_zero_mm == far_mm
    (taken,) = pipeline.process(readings_of((REST, REST)), 0.0)
    assert taken.notes == (() if far_mm is None else (Note.ZEROS,))
    assert Pipeline(surface_of()).far_zero_mm is None


@pytest.mark.promise("docs/explanation/readings-to-samples.md", "samples carry the note `zeros`.")
@pytest.mark.parametrize(("um_per_min", "is_noted"), [(20.0, True), (5.0, False)])
def test_samples_carry_a_note_once_a_zero_drifts_faster_than_is_stated(um_per_min: float, *, is_noted: bool) -> None:
    tracking = {"drift_um_per_min": 5.0, "max_mm": 0.05}
    pipeline = Pipeline(surface_of(filter=mean_of(1), noise_mm=NOISE_MM, zero_tracking=tracking))
    noise_mm = NOISE_MM * np.random.default_rng(3).standard_normal((round(20 * RATE_HZ), 2))
    drift_mm = 1e-3 * um_per_min / 60 / RATE_HZ * np.arange(len(noise_mm))[:, None] * np.array([0.0, 1.0])
    rows = [(first, second) for first, second in counts_of(drift_mm + noise_mm).tolist()]
    noted = {note for one in pipeline.process(readings_of(*rows), 0.0) for note in one.notes}
    noted |= {note for one in pipeline.process(readings_of(*rows[-1:]), 0.0) for note in one.notes}
    assert noted == ({Note.ZEROS} if is_noted else set())
    assert (pipeline.hurried_zero is not None) is is_noted


KINDS: list[dict[str, object]] = [
    {"kind": "none", "spike_mm": 0.02},
    {**mean_of(5), "spike_mm": 0.02},
    {"kind": "growing-mean", "max_mean_ms": 1.0},
    {"kind": "growing-mean", "max_mean_ms": 130.0, "spike_mm": 0.018},
]
pairs = st.tuples(*[st.sampled_from([REST, REST + 1, REST + 40, REST + 300, DOWN, 65_535, None])] * 2)


@settings(max_examples=40)
@given(rows=st.lists(pairs, min_size=1, max_size=40), kind=st.sampled_from(KINDS), data=st.data())
def test_any_split_of_the_readings_gives_the_same_samples_to_the_bit(
    rows: list[tuple[Counts, Counts]], kind: dict[str, object], data: st.DataObject
) -> None:
    cuts = sorted(data.draw(st.lists(st.integers(0, len(rows)), max_size=6), label="cuts"))
    period_ms = data.draw(st.sampled_from([None, 37.5, 200.0]), label="period")
    # A slow surface follows its zeros in blocks of four readings.
    keys = {"filter": kind, "slowest_period_ms": period_ms, "rate_hz": 10.0}
    surface = surface_of(2, {"stuck_after_ms": 500.0}, **keys, **TRACKED)
    readings = readings_of(*rows, *[(REST + 30, REST)] * 15)
    ends = zip([0, *cuts], [*cuts, len(readings)], strict=True)
    pieces = [readings[begin:end] for begin, end in ends if begin < end]
    split = Pipeline(surface)
    assert [one for piece in pieces for one in split.process(piece, 0.0)] == Pipeline(surface).process(readings, 0.0)


def stated(channels: int = 4, **changes: object) -> Surface:
    """Return a surface that states its noise."""
    keys: dict[str, object] = {
        "noise_mm": NOISE_MM,
        "slowest_period_ms": 98.0,
        "filter": {**mean_of(4), "spike_mm": 6 * NOISE_MM},
    }
    return surface_of(channels, **(keys | changes))


def samples(surface: Surface, deflection_mm: FloatArray) -> list[Sample]:
    """The samples of deflections with noise, shape (readings, channels)."""
    noise = NOISE_MM * np.random.default_rng(2).standard_normal(deflection_mm.shape)
    rows = np.round((2.0 + deflection_mm + noise) / STEP_MM).tolist()
    counts = [[None if math.isnan(count) else count for count in row] for row in rows]
    return [one.sample for one in Pipeline(surface).process(readings_of(*counts), 0.0)]


def matrix_of(sample: Sample) -> FloatArray:
    assert sample.covariance_mm2 is not None
    channels = len(sample.deflection_mm)
    lower = np.zeros((channels, channels))
    lower[np.tril_indices(channels)] = sample.covariance_mm2
    return lower + np.tril(lower, -1).T


def ringing(readings: int, channels: int = 4) -> FloatArray:
    swing: FloatArray = np.sin(2 * math.pi * 44 / RATE_HZ * np.arange(readings))[:, np.newaxis]
    return 0.3 * swing * np.linspace(0.4, 1.0, channels)


def test_a_sample_at_rest_states_its_readings_and_one_of_a_ringing_beam_the_pattern_of_its_mode() -> None:
    at_rest = samples(stated(), np.full((1000, 4), 0.2))[20:]
    assert {sample.readings for sample in at_rest} == {4}
    assert sum(sample.covariance_mm2 is not None for sample in at_rest) <= 0.01 * len(at_rest)
    values, vectors = np.linalg.eigh(matrix_of(samples(stated(), ringing(100))[-1]))
    pattern = np.linspace(0.4, 1.0, 4)
    assert abs(vectors[:, -1] @ pattern) / np.linalg.norm(pattern) > 0.999
    assert values[-1] > 100 * values[-2]
    assert values[0] >= 0.99 * NOISE_MM**2 / 4  # rounding keeps the noise


@pytest.mark.parametrize("kind", [*KINDS, {"kind": "growing-mean"}])
def test_every_filter_states_it_and_the_service_takes_it(kind: dict[str, object]) -> None:
    touched = np.zeros((800, 4))
    touched[400:] = [0.1, 0.3, 0.2, 0.05]
    touched[:, 2] = math.nan  # its unit is off
    found = [samples(stated(filter=kind), values) for values in (ringing(300), np.zeros((300, 4)), touched)]
    assert np.trace(matrix_of(found[0][-1])) > 30 * NOISE_MM**2
    for sample in (one for part in found for one in part):
        assert sample.readings
        assert Sample.model_validate_json(sample.model_dump_json()) == sample


@pytest.mark.promise("docs/reference/daemon-configuration.md", "Samples state their covariance only if it is given.")
def test_what_a_channel_lacks_shows_in_the_covariance() -> None:
    deflection = ringing(60)
    deflection[40:, 1] = math.nan
    deflection[40:, 2] = 1.9  # beyond the linear range
    covariance = matrix_of(samples(stated(), deflection)[-1])
    assert not covariance[[1, 2]].any()
    assert covariance[3, 0] > 0
    fewer = np.zeros((40, 4))
    fewer[-2, 1] = math.nan
    sample = samples(stated(), fewer)[-1]
    assert sample.readings == 4
    np.testing.assert_allclose(matrix_of(sample), NOISE_MM**2 * np.diag([1 / 4, 1 / 3, 1 / 4, 1 / 4]), rtol=1e-3)
    unknown = samples(surface_of(4), ringing(50))[-1]
    assert (unknown.readings, unknown.covariance_mm2) == (None, None)


@pytest.mark.parametrize("noise", [0.02, 0.2])
def test_counts_that_flicker_between_two_values_are_not_motion(noise: float) -> None:
    rng, moving, number = np.random.default_rng(7), 0, 0
    surface = stated(noise_mm=math.hypot(noise, 1 / math.sqrt(12)) * STEP_MM, filter=mean_of(20))
    for gap in rng.uniform(size=(10, 4)):
        counts = np.rint(REST + gap + noise * rng.standard_normal((400, 4))).tolist()
        settled = [one.sample for one in Pipeline(surface).process(readings_of(*counts), 0.0)][50:]
        moving, number = moving + sum(one.covariance_mm2 is not None for one in settled), number + len(settled)
    assert moving <= 0.01 * number


def test_only_whole_numbers_have_steps() -> None:
    assert steps_mm(surface_of(1)).tolist() == pytest.approx([STEP_MM])
    assert steps_mm(surface_of(1, {"type": "f32"})).tolist() == [0.0]
    line = surface_of(source={"kind": "serial", "port": "/dev/null", "oversampling": 16})
    assert steps_mm(line).tolist() == pytest.approx([STEP_MM / 4] * 2)
