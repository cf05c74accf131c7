"""Stuck channels: what noise never does, and what a frozen sensor does."""

import math

import numpy as np
import pytest

from beamtouch_daemon.processing.stuck import Runs, longest_run, longest_runs, steps_mm

from .surfaces import STEP_MM, surface_of


def stated(noise_counts: float) -> float:
    """Standard deviation of a reading: with that of rounding (Widrow & Kollar, Quantization Noise, 2008, sec. 1.2)."""
    return math.sqrt(noise_counts**2 + 1 / 12)


@pytest.mark.parametrize(("noise", "run"), [(0.3, 276), (0.5, 73), (2.0, 18)])
def test_the_longest_run_is_that_of_the_formula_and_noise_never_reaches_it(noise: float, run: int) -> None:
    assert longest_run(stated(noise), 200.0) == run
    repeat = math.erf(0.5 / (noise * math.sqrt(2)))
    assert repeat**run <= 1e-12 < repeat ** (run - 1)
    counts = np.rint(noise * np.random.default_rng(2).standard_normal((300_000, 1)))
    lengths = Runs(np.zeros(1)).lengths(counts)
    assert lengths.max() <= run
    if noise == 0.5:
        for long in (5, 10):  # a reading ends so many equal ones in a row with the chance q^long, if they are 0
            assert np.mean((lengths >= long) & (counts == 0)) == pytest.approx(repeat**long, rel=0.15)


@pytest.mark.parametrize(
    ("noise", "rate_hz", "run"),
    [
        (0.0, 200.0, math.inf),
        (1 / math.sqrt(12), 200.0, math.inf),  # rounding alone explains it
        (stated(0.3), 27.6, 276),
        (stated(0.3), 27.5, math.inf),  # longer than ten seconds
        (1e300, 200.0, 1),  # no count repeats
    ],
)
def test_where_runs_judge_nothing(noise: float, rate_hz: float, run: float) -> None:
    assert longest_run(noise, rate_hz) == run


def test_a_run_is_counted_over_missing_counts_which_neither_add_to_it_nor_end_it() -> None:
    counts = [1.0, 2.0, 3.0, 3.0, math.nan, 3.0, math.nan, 4.0]
    assert Runs(np.zeros(1)).lengths(np.array(counts)[:, np.newaxis])[:, 0].tolist() == [1, 1, 1, 2, 2, 3, 3, 1]
    assert Runs(np.zeros(1)).lengths(np.array([[math.nan], [7.0]]))[:, 0].tolist() == [0, 1]


@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "A channel is stuck when its counts have not changed for longer; default: from the surface's `noise_mm`.",
)
def test_a_stated_time_overrides_the_noise_and_the_steepest_piece_counts() -> None:
    table = {"gain_mm_per_count": None, "offset_mm": None, "table": [[0, 1.0], [10, 1.1], [20, 4.1]]}
    for timed, noise_mm, run in ((None, 0.3 * stated(2.0), 18), (251.0, 0.3 * stated(2.0), 51), (251.0, None, 51)):
        surface = surface_of(1, table | {"stuck_after_ms": timed}, noise_mm=noise_mm)
        assert longest_runs(surface).tolist() == [run]


@pytest.mark.parametrize(
    ("stuck_after_ms", "run"),
    [(0.01, 1), (5.0, 1), (5.1, 2), (15.0, 3), (3_000_001.0, 600_001)],
)
def test_a_stated_time_is_taken_in_readings_of_which_the_last_is_begun(stuck_after_ms: float, run: int) -> None:
    assert longest_runs(surface_of(1, {"stuck_after_ms": stuck_after_ms})).tolist() == [run]


def test_a_count_of_a_fractional_number_is_as_large_as_the_noise_and_no_finer_than_its_digits() -> None:
    floats = {"type": "f32", "range_mm": [2.25, 2.75]}  # 17 500 to 22 500 counts, with steps of 2**-9
    assert steps_mm(surface_of(1), 0.003).tolist() == pytest.approx([STEP_MM])
    assert steps_mm(surface_of(1, floats), 0.003).tolist() == [0.003]
    assert steps_mm(surface_of(1, floats), 0.0).tolist() == pytest.approx([2 * 2 * 2.0**-9 * STEP_MM])
