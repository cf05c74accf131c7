"""What a sample says of its uncertainty, from counts to what the service receives."""

import math
from dataclasses import replace

import numpy as np
import pytest

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing.characteristic import Characteristic
from beamtouch_daemon.processing.filters import steps_mm
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models.filters import FloatArray
from beamtouch_service.samples import Sample, triangle_rows

NOISE_MM = 0.003
RATE_HZ = 200.0
COUNTS_PER_MM = 10_000


def surface_of(channels: int = 4, **changes: object) -> Surface:
    values: dict[str, object] = {
        "rate_hz": RATE_HZ,
        "noise_mm": NOISE_MM,
        "slowest_period_ms": 98.0,
        "source": {"kind": "modbus-tcp", "host": "127.0.0.1"},
        "filter": {"kind": "moving-average", "window": 4, "spike_mm": 6 * NOISE_MM},
        "channels": [
            {
                "name": f"s{index + 1}",
                "register": index,
                "gain_mm_per_count": -1 / COUNTS_PER_MM,
                "offset_mm": 4.5,
                "rest_gap_mm": 2.5,
                "range_mm": [1.0, 4.0],
            }
            for index in range(channels)
        ],
    }
    return Surface.model_validate(values | changes)


def samples(surface: Surface, deflection_mm: FloatArray, begin_s: float = 1.0) -> list[Sample]:
    """The samples of deflections with noise, shape (readings, channels)."""
    noise = NOISE_MM * np.random.default_rng(2).standard_normal(deflection_mm.shape)
    counts = np.round((2.0 + deflection_mm + noise) * COUNTS_PER_MM)
    readings = [
        Reading(begin_s + index / RATE_HZ, tuple(None if math.isnan(count) else count for count in row))
        for index, row in enumerate(counts.tolist())
    ]
    return [one.sample for one in Pipeline(surface).process(readings, 0.0)]


def matrix_of(sample: Sample) -> FloatArray:
    assert sample.covariance_mm2 is not None
    channels = len(sample.deflection_mm)
    lower = np.zeros((channels, channels))
    for index, row in enumerate(triangle_rows(sample.covariance_mm2)):
        lower[index, : index + 1] = row
    return lower + np.tril(lower, -1).T


def ringing(readings: int, channels: int = 4) -> FloatArray:
    swing: FloatArray = np.sin(2 * math.pi * 44 / RATE_HZ * np.arange(readings))[:, np.newaxis]
    return 0.3 * swing * np.linspace(0.4, 1.0, channels)


def test_a_sample_at_rest_states_its_readings_and_no_covariance() -> None:
    at_rest = samples(surface_of(), np.full((1000, 4), 0.2))[20:]
    assert {sample.readings for sample in at_rest} == {4}
    assert sum(sample.covariance_mm2 is not None for sample in at_rest) <= 0.01 * len(at_rest)


def test_a_sample_of_a_ringing_beam_states_a_covariance_in_the_pattern_of_the_mode() -> None:
    sample = samples(surface_of(), ringing(100))[-1]
    values, vectors = np.linalg.eigh(matrix_of(sample))
    pattern = np.linspace(0.4, 1.0, 4)
    assert abs(vectors[:, -1] @ pattern) / np.linalg.norm(pattern) > 0.999
    assert values[-1] > 100 * values[-2]
    assert values[0] >= 0.99 * NOISE_MM**2 / 4  # rounding keeps the noise


def test_the_largest_covariance_takes_few_bytes_and_the_service_takes_it() -> None:
    at_rest, moving = samples(surface_of(8), np.zeros((50, 8))), samples(surface_of(8), ringing(50, 8))
    size = [len(sample.model_dump_json(exclude_defaults=True)) for sample in (at_rest[-1], moving[-1])]
    assert size[1] - size[0] < 36 * 15
    assert Sample.model_validate_json(moving[-1].model_dump_json()) == moving[-1]


def test_a_channel_that_is_not_good_has_zeros() -> None:
    deflection = ringing(60)
    deflection[40:, 1] = math.nan
    deflection[40:, 2] = 1.9  # beyond the linear range
    covariance = matrix_of(samples(surface_of(), deflection)[-1])
    assert not covariance[[1, 2]].any()
    assert covariance[3, 0] > 0


@pytest.mark.parametrize("touched_at", [0, 400])
def test_the_service_takes_each_sample_of_a_touch_without_a_channel(touched_at: int) -> None:
    deflection_mm = np.zeros((800, 4))
    deflection_mm[touched_at:] = [0.1, 0.3, 0.2, 0.05]
    deflection_mm[:, 2] = math.nan  # its unit is off
    for sample in samples(surface_of(filter={"kind": "growing-mean"}), deflection_mm):
        assert Sample.model_validate_json(sample.model_dump_json()) == sample


def test_a_channel_with_fewer_readings_than_the_others_states_its_larger_variance() -> None:
    deflection = np.zeros((40, 4))
    deflection[-2, 1] = math.nan
    sample = samples(surface_of(), deflection)[-1]
    assert sample.readings == 4
    expected = NOISE_MM**2 * np.diag([1 / 4, 1 / 3, 1 / 4, 1 / 4])
    np.testing.assert_allclose(matrix_of(sample), expected, rtol=1e-3)


def test_after_a_long_gap_a_deflected_beam_is_doubtful_until_it_was_seen_to_rest() -> None:
    pipeline = Pipeline(surface_of())
    level = [Reading(1.0 + index / RATE_HZ, (20_000.0,) * 4) for index in range(50)]
    first, *others = [Reading(9.0 + index / RATE_HZ, (25_000.0,) * 4) for index in range(50)]
    (*_, last), after = pipeline.process(level, 0.0), pipeline.process([first._replace(lost=750), *others], 0.0)
    assert last.sample.covariance_mm2 is None
    assert after[0].sample.readings == 2
    assert matrix_of(after[0].sample).min(where=np.eye(4, dtype=bool), initial=np.inf) > 100 * NOISE_MM**2
    assert all(one.sample.covariance_mm2 is None for one in after[8:])


def test_without_a_stated_noise_a_sample_says_nothing() -> None:
    sample = samples(surface_of(noise_mm=None), ringing(50))[-1]
    assert (sample.readings, sample.covariance_mm2) == (None, None)


@pytest.mark.parametrize("spike", [{}, {"spike_mm": 0.018}])
@pytest.mark.parametrize("kind", [{"kind": "none"}, {"kind": "growing-mean"}])
def test_every_filter_states_it_and_the_service_takes_it(kind: dict[str, object], spike: dict[str, object]) -> None:
    of = surface_of(filter=kind | spike)
    at_rest, moving = (samples(of, values) for values in (np.zeros((300, 4)), ringing(300)))
    assert np.trace(matrix_of(moving[-1])) > 100 * NOISE_MM**2
    assert all(one.readings and Sample.model_validate_json(one.model_dump_json()) == one for one in (*at_rest, *moving))


def test_the_period_is_refused_where_it_holds_too_many_readings() -> None:
    with pytest.raises(ValueError, match="at most 4000 readings, 20 s"):
        surface_of(slowest_period_ms=20_001.0)


def test_another_rest_gap_or_gain_is_another_identity() -> None:
    surface = surface_of()
    same, tared = (Characteristic.of(surface.channels, gaps) for gaps in (None, {"s1": 2.6}))
    other = replace(same, slopes=2 * same.slopes)
    assert same.identity == Characteristic.of(surface_of().channels).identity
    assert len({same.identity, tared.identity, other.identity}) == 3


@pytest.mark.parametrize("noise", [0.02, 0.1, 0.2])
def test_counts_that_flicker_between_two_values_are_not_motion(noise: float) -> None:
    rng = np.random.default_rng(7)
    stated = math.hypot(noise, 1 / math.sqrt(12)) / COUNTS_PER_MM
    surface = surface_of(noise_mm=stated, filter={"kind": "moving-average", "window": 20})
    moving, all_of = 0, 0
    for gap in rng.uniform(size=(20, 4)):
        counts = np.rint(20_000 + gap + noise * rng.standard_normal((400, 4)))
        readings = [Reading(index / RATE_HZ, tuple(row)) for index, row in enumerate(counts.tolist())]
        settled = [one.sample for one in Pipeline(surface).process(readings, 0.0)][50:]
        moving, all_of = moving + sum(one.covariance_mm2 is not None for one in settled), all_of + len(settled)
    assert moving <= 0.01 * all_of


def test_only_whole_numbers_have_steps() -> None:
    channels = [channel.model_dump(by_alias=True) for channel in surface_of().channels]
    channels[1]["type"] = "f32"
    assert steps_mm(surface_of()).tolist() == pytest.approx([1 / COUNTS_PER_MM] * 4)
    assert steps_mm(Surface.model_validate(surface_of().model_dump(by_alias=True) | {"channels": channels}))[1] == 0
    line = surface_of(source={"kind": "serial", "port": "/dev/null", "oversampling": 16})
    assert steps_mm(line).tolist() == pytest.approx([0.25 / COUNTS_PER_MM] * 4)
