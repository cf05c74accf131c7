"""Stuck channels: what noise never does, and what a frozen sensor does."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing.stuck import Runs, longest_run, longest_runs
from beamtouch_models.filters import FloatArray

NOISES = (0.3, 0.5, 2.0)
"""Before rounding, in counts."""


def stated(noise_counts: float) -> float:
    """Standard deviation of a reading: with that of rounding (Widrow & Kollar, Quantization Noise, 2008, sec. 1.2)."""
    return math.sqrt(noise_counts**2 + 1 / 12)


@pytest.mark.parametrize(("noise", "run"), [(0.3, 276), (0.5, 73), (2.0, 18)])
def test_the_longest_run_is_that_of_the_formula(noise: float, run: int) -> None:
    assert longest_run(stated(noise), 200.0) == run
    repeat = math.erf(0.5 / (noise * math.sqrt(2)))
    assert repeat**run <= 1e-12 < repeat ** (run - 1)


@pytest.mark.parametrize("noise", [0.0, 0.2, 1 / math.sqrt(12)])
def test_noise_that_rounding_alone_explains_judges_nothing(noise: float) -> None:
    assert longest_run(noise, 200.0) == math.inf


def test_a_run_longer_than_ten_seconds_judges_nothing() -> None:
    assert longest_run(stated(0.3), 27.6) == 276
    assert longest_run(stated(0.3), 27.5) == math.inf
    assert longest_run(1e300, 200.0) == 1  # no count repeats


@pytest.mark.parametrize("noise", NOISES)
def test_noise_at_its_worst_is_not_taken_for_stuck_in_a_million_readings(noise: float) -> None:
    counts = np.rint(1000 + noise * np.random.default_rng(2).standard_normal((1_000_000, 1)))
    lengths = Runs(1).lengths(counts)
    assert lengths.max() <= longest_run(stated(noise), 200.0)


def test_runs_of_noise_are_as_long_as_the_formula_says() -> None:
    counts = np.rint(0.5 * np.random.default_rng(3).standard_normal((1_000_000, 1)))
    lengths = Runs(1).lengths(counts)
    repeat = math.erf(0.5 / (0.5 * math.sqrt(2)))
    for run in (5, 10, 15):  # a reading ends so many equal ones in a row with the chance q^run, if they are the middle
        in_run = np.mean((lengths >= run) & (counts == 0))
        assert in_run == pytest.approx(repeat**run, rel=0.15)


@pytest.mark.parametrize("noise", NOISES)
def test_a_frozen_channel_is_found_with_the_first_reading_that_is_too_many(noise: float) -> None:
    run = int(longest_run(stated(noise), 200.0))
    counts = np.concatenate([[1.0, 2.0], np.full(run + 5, 3.0), [4.0]])[:, np.newaxis]
    lengths = Runs(1).lengths(counts)
    is_stuck = lengths[:, 0] > run
    assert np.flatnonzero(is_stuck).tolist() == list(range(2 + run, 2 + run + 5))


def test_a_missing_count_neither_adds_to_a_run_nor_ends_it() -> None:
    lengths = Runs(1).lengths(np.array([[7.0], [7.0], [math.nan], [7.0], [math.nan], [8.0]]))
    assert lengths[:, 0].tolist() == [1, 2, 2, 3, 3, 1]
    lengths = Runs(1).lengths(np.array([[math.nan], [7.0]]))
    assert lengths[:, 0].tolist() == [0, 1]


columns = st.lists(st.tuples(*[st.sampled_from([1.0, 1.0, 2.5, math.nan])] * 2), min_size=1, max_size=40)


@given(rows=columns, data=st.data())
def test_any_split_of_the_stream_gives_the_same(rows: list[tuple[float, float]], data: st.DataObject) -> None:
    counts: FloatArray = np.array(rows)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(rows)), max_size=6), label="cuts"))
    at_once, split = Runs(2), Runs(2)
    whole = at_once.lengths(counts)
    pieces = [split.lengths(piece) for piece in np.split(counts, cuts)]
    np.testing.assert_array_equal(np.concatenate(pieces), whole)
    following = np.array([[1.0, 2.5]])
    np.testing.assert_array_equal(split.lengths(following), at_once.lengths(following))


def test_a_stated_time_overrides_the_noise_and_the_steepest_piece_counts() -> None:
    values = {"rest_gap_mm": 2.0, "range_mm": [1.0, 4.0]}
    table = values | {"name": "a", "register": 0, "table": [[0, 1.0], [10, 1.1], [20, 4.1]]}
    timed = values | {"name": "b", "register": 1, "table": [[0, 1.0], [10, 4.0]], "stuck_after_ms": 251.0}

    def longest(noise_mm: float | None) -> list[float]:
        source = {"kind": "serial", "port": "/dev/ttyACM0"}
        keys = {"rate_hz": 200.0, "source": source, "noise_mm": noise_mm, "channels": [table, timed]}
        runs: list[float] = longest_runs(Surface.model_validate(keys)).tolist()
        return runs

    assert longest(0.3 * stated(2.0)) == [18, 51]
    assert longest(None) == [math.inf, 51]
