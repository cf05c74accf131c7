"""Following a beam that rings, reading by reading: what is kept, when it is fitted again, and what it states."""

import math
from itertools import pairwise

import numpy as np
import pytest

from beamtouch_models.filters import FloatArray
from beamtouch_models.filters.ringing import Followed, Ringing
from beamtouch_models.filters.significance import chi_square_quantile
from beamtouch_models.filters.sinusoids import predicted

PERIOD, CHANNELS, UNSEEN = 20.0, 3, 0.03
NOISE_MM, UNIT_MM = np.array([0.5, 2.0, 1.0]), np.array([0.5, 3.0, 1.25])
LOAD, BENT = np.array([90.0, -60.0, 30.0]), np.array([25.0, 10.0, -15.0])
"""Of a touch, and what it swings by, in units of the noise."""


def ringing(period: float = PERIOD) -> Ringing:
    return Ringing(period, NOISE_MM, UNIT_MM, UNSEEN)


def swings(times: FloatArray, size: float = 1.0, rows_each: float = 1.0) -> FloatArray:
    """Return a beam that swings about its load, (times, channels), in units of the noise."""
    at = times / rows_each
    wave = np.exp(-0.01 * at) * np.cos(2 * np.pi * 0.22 * at + 0.4)
    return np.asarray(LOAD + size * wave[:, np.newaxis] * BENT)


class Run:
    """A beam that is followed."""

    def __init__(self, period: float = PERIOD) -> None:
        self.ringing, self.known = ringing(period), list[Followed | None]()
        """What is known after each reading."""
        self.told = list[int]()
        """Numbers of the readings at which a rest was told."""
        self.block = max(1, round(period / 20))

    def read(self, values: FloatArray, times: FloatArray | None = None, *, moves: bool = True) -> "Run":
        """Take readings in units of the noise of a row."""
        begin = len(self.known)
        times = np.arange(float(begin), begin + len(values)) if times is None else times
        unit_mm = UNIT_MM / math.sqrt(self.block)
        for time, value in zip(times, values, strict=True):
            rests, now = self.ringing.follow(
                self.known[-1] if self.known else None, np.array([time]), (value * unit_mm)[np.newaxis], [moves]
            )
            self.told += [len(self.known)] * len(rests)
            self.known.append(now)
        return self

    @property
    def now(self) -> Followed:
        assert self.known[-1] is not None
        return self.known[-1]


def followed(rows: int = 60, size: float = 1.0, seed: int = 1) -> Run:
    noise = np.random.default_rng(seed).standard_normal((rows, CHANNELS))
    return Run().read(swings(np.arange(float(rows)), size) + noise)


def test_a_beam_that_only_scatters_is_searched_less_and_less_often_over_its_newer_rows() -> None:
    run = Run().read(100 * np.random.default_rng(4).standard_normal((120, CHANNELS)))
    rows, wait, failures = 0, 0, 0
    for known in run.known:
        rows += 1
        if rows < 5 or wait > 0:
            wait -= 1
        else:
            failures += 1
            wait = min(failures, 8)
            rows = int(0.6 * rows) if 0.6 * rows >= 5 else rows
        assert known is not None
        assert (len(known.times), len(known.values), known.failures) == (rows, rows, failures)
        assert known.fit is None
    assert failures > 8


@pytest.mark.parametrize(("period", "readings"), [(20.0, 5), (60.0, 15), (29.0, 5), (31.0, 10)])
def test_a_search_is_given_up_after_five_rows_that_do_not_move(period: float, readings: int) -> None:
    run = Run(period).read(100 * np.random.default_rng(4).standard_normal((8, CHANNELS)))
    run.read(np.zeros((readings - 1, CHANNELS)), moves=False)
    assert run.known[-1] is not None
    run.read(np.zeros((1, CHANNELS)), moves=False)
    assert run.known[-1] is None
    # One that moves in between begins the count anew.
    run = Run(period).read(100 * np.random.default_rng(4).standard_normal((8, CHANNELS)))
    run.read(np.zeros((readings - 1, CHANNELS)), moves=False).read(np.zeros((1, CHANNELS)))
    run.read(np.zeros((readings - 1, CHANNELS)), moves=False)
    assert run.known[-1] is not None


def test_a_beam_with_a_fit_is_given_up_after_a_period_that_does_not_move() -> None:
    run, at = followed(), np.arange(60.0, 80.0)
    assert run.now.fit is not None
    run.read(swings(at[:19]), moves=False)
    assert run.known[-1] is not None
    run.read(swings(at[19:]), moves=False)
    assert run.known[-1] is None
    # Nothing begins without a reading, or without motion.
    assert Run().read(np.full((3, CHANNELS), np.nan)).known == [None] * 3
    assert Run().read(swings(at), moves=False).known == [None] * 20


def test_rows_as_predicted_wait_for_a_fit_up_to_a_quarter_of_all_and_to_sixteen() -> None:
    run, fits = followed(150), 0
    for before, after in pairwise(run.known):
        assert after is not None
        if before is None or not before.is_confirmed or before.fit is None or after.doubtful is not None:
            continue
        most = min(8 if before.fit.slopes else 16, len(before.times) // 4)
        waits = after.times[-1] - before.fitted < most
        assert (after.age == before.age) is bool(waits)
        assert after.passed == (before.passed + 1 if waits else 0)
        assert after.fitted == (before.fitted if waits else after.times[-1])
        fits += not waits
    assert fits > 8
    assert len(run.now.times) == 94
    assert run.now.times.tolist() == np.arange(56.0, 150.0).tolist()


@pytest.mark.parametrize("channel", [0, 2])
def test_a_row_is_as_predicted_within_twice_the_square_that_noise_hardly_exceeds(channel: int) -> None:
    limit = 2 * chi_square_quantile(CHANNELS, 0.001)
    for factor, is_predicted in ((0.99, True), (1.01, False)):
        run = followed(64)
        while run.now.times[-1] - run.now.fitted != 2:
            run.read(swings(np.array([float(len(run.known))])))
        fit, before = run.now.fit, run.now
        assert fit is not None
        row = predicted(fit, np.array([len(run.known) - before.fitted]))
        row[0, channel] += math.sqrt(factor * limit)
        run.read(row)
        assert (run.now.age == before.age and run.now.doubtful is None) is is_predicted


@pytest.mark.parametrize(
    ("jump", "is_dated"), [(1.25, True), (1.35, False), (-1.25, True), (-1.35, False), (50, False)]
)
def test_a_stamp_that_readings_do_not_agree_with_begins_anew(jump: float, is_dated: bool) -> None:
    """They may differ by one reading, and by a tenth of those since the last fit."""
    run = followed(64)
    while run.now.times[-1] - run.now.fitted != 2:
        run.read(swings(np.array([float(len(run.known))])))
    time = len(run.known) + jump
    run.read(swings(np.array([time])) + 30.0, np.array([time]))
    assert run.now.passed in {0, 3}
    assert (len(run.now.times) > 1) is is_dated
    if not is_dated:
        assert (run.now.fit, run.now.opened, run.now.times.tolist()) == (None, False, [time])


def test_swings_of_fifteen_deviations_replace_the_mean_until_they_are_of_three() -> None:
    """Their r.m.s. over all channels, about a straight line, without what a fit leaves."""
    seen: dict[bool, list[float]] = {False: [], True: []}
    for size in np.linspace(0.5, 0.95, 8):
        at = np.arange(190.0)
        wave = size * np.exp(-0.03 * at) * np.cos(2 * np.pi * 0.22 * at)
        run = Run().read(LOAD + wave[:, np.newaxis] * BENT)
        for before, after in pairwise(run.known):
            if before is None or after is None or after.fit is None or after.age == before.age:
                continue
            line = np.polyfit(after.times, after.values, 1)
            away = after.values - np.outer(after.times, line[0]) - line[1]
            swing = math.sqrt(max(0.0, (away**2).sum() - after.fit.promised) / len(away))
            assert after.opened is (swing > (3 if before.opened else 15))
            assert (after.found is not None) is (after.opened and len(before.constants) > 0)
            seen[before.opened].append(swing)
    for was_opened, limit in ((False, 15), (True, 3)):
        for low, high in ((limit - 1, limit), (limit, limit + 1)):
            assert any(low < swing < high for swing in seen[was_opened])


@pytest.mark.parametrize("out", [None, 1])
@pytest.mark.parametrize("period", [20.0, 60.0])
def test_a_rest_is_the_constant_and_as_unsure_as_the_fit_its_changes_and_what_readings_do_not_show(
    period: float, out: int | None
) -> None:
    run, each = Run(period), max(1, round(period / 20))
    readings = np.arange(45.0 * each)
    noise = math.sqrt(each) * np.random.default_rng(2).standard_normal((len(readings), CHANNELS))
    values = swings(readings, 3.0, each) + noise
    values[:, [] if out is None else [out]] = np.nan
    run.read(values)
    kept, told = [channel for channel in range(CHANNELS) if channel != out], 0
    for before, after in pairwise(run.known):
        if before is None or after is None or after.found is None or after.fit is None or after.age == before.age:
            continue
        fit, found, told = after.fit, after.found, told + 1
        unit_mm = UNIT_MM / math.sqrt(each)
        assert found.readings == fit.rows * each
        assert found.mean_mm[kept] == pytest.approx(fit.constant * unit_mm[kept])
        # The last constant, and the one before it.
        apart = np.array(before.constants)[-2:, kept] - fit.constant
        spread = fit.covariance + (apart[:, :, None] * apart[:, None]).mean(axis=0)
        swing = float((fit.coefficients[1:] ** 2).sum())
        unseen = (UNSEEN * (1 + (8 / fit.rows) ** 2)) ** 2 * swing
        expected = (spread + unseen * np.eye(len(kept))) * np.outer(unit_mm[kept], unit_mm[kept])
        expected -= np.diag(NOISE_MM[kept] ** 2) / found.readings
        assert found.excess_mm2[np.ix_(kept, kept)] == pytest.approx(expected)
        assert found.is_rest
        if out is not None:
            assert math.isnan(found.mean_mm[out])
            assert not found.excess_mm2[out].any()
            assert not found.excess_mm2[:, out].any()
    assert told > 3


def test_no_rest_is_told_of_the_first_fit_nor_after_two_readings_without_a_time() -> None:
    run = followed(50, size=3.0)
    first = next(row for row, known in enumerate(run.known) if known is not None and known.fit is not None)
    assert run.told[0] > first
    assert run.told[-1] == 49
    values = swings(np.arange(50.0, 54.0), 3.0)
    run.read(values, np.array([np.nan, np.nan, np.nan, 53.0]))
    assert [row for row in run.told if row >= 50] == [50, 53]
    assert run.now.undated == 0
    # One that does not move tells no rest.
    assert run.read(values[:1], np.array([54.0]), moves=False).told[-1] == 53


@pytest.mark.parametrize(("step", "scatter"), [([70.0, 50.0, -40.0], 12.0), ([80.0, 0.0, 0.0], 4.5)])
@pytest.mark.parametrize("period", [20.0, 60.0])
def test_just_after_a_touch_the_former_swings_go_on_and_the_mean_is_as_unsure_as_a_reading(
    period: float, step: list[float], scatter: float
) -> None:
    run, each = Run(period), max(1, round(period / 20))
    readings = np.arange(60.0 * each)
    noise = math.sqrt(each) * np.random.default_rng(3).standard_normal((len(readings), CHANNELS))
    run.read(swings(readings, 4.0, each) + noise)
    former, fitted = run.now.fit, run.now.fitted
    assert former is not None
    assert run.now.opened
    unit_mm = UNIT_MM / math.sqrt(each)
    later, told = np.arange(60.0 * each, 66.0 * each), []
    rough = scatter * np.random.default_rng(5).standard_normal(
        (len(later), CHANNELS)
    )  # so that no new swings are found
    for reading, value in zip(later, swings(later, 4.0, each) + step + rough, strict=True):
        run.read(value[np.newaxis], np.array([reading]))
        if run.now.found is not None and not run.now.found.is_rest and run.now.former is not None:
            told.append(run.now)
    # A quarter of the slowest period.
    rows_told = {len(now.times) for now in told}
    assert rows_told | {5} == {2, 3, 4, 5}
    assert 5 in rows_told or scatter < 5  # where new swings may be found
    for now in told:
        assert now.found is not None
        rows = len(now.times)
        since = (now.times - fitted) / each
        ringing_on = predicted(former, since) - former.constant
        mean = (now.values - ringing_on).mean(axis=0)
        assert now.found.mean_mm == pytest.approx(mean * unit_mm)
        assert mean == pytest.approx(LOAD + step, abs=2 * scatter + 2)
        assert now.found.readings == rows * each
        swing, load = float((ringing_on[-1] ** 2).sum()), float(((mean - former.constant) ** 2).sum())
        unseen = (UNSEEN * (1 + (8 / former.rows) ** 2)) ** 2 * swing + 0.1**2 * load
        assert now.found.excess_mm2 == pytest.approx(np.diag(unit_mm**2 * (each + unseen)))
