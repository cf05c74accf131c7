"""Which means move, and what they may be off by, against plain loops over the readings of each mean."""

import math

import numpy as np
import pytest

from beamtouch_models.filters import Filtered, FloatArray
from beamtouch_models.filters.change_detector import ChangeDetector, Seen
from beamtouch_models.filters.motion import Motion, Past, Taken, scatter_of_swing
from beamtouch_models.filters.significance import chi_square_quantile

CHANNELS, MEANS = 3, 4
NOISE_MM, UNIT_MM = np.array([0.5, 0.8, 1.2]), np.array([0.5, 1.0, 1.2])


def hardly_exceeded(freedom: int) -> float:
    """Return the sum of squares that noise exceeds once in a thousand."""
    return chi_square_quantile(freedom, 0.001)


def expected_scatter(period: float, readings: int) -> float:
    """Return the sum of squares about their mean of readings of a swing, averaged over its phases."""
    phases = np.linspace(0.0, 2 * math.pi, 48, endpoint=False)[:, np.newaxis]
    swings = np.sin(phases + 2 * math.pi / max(period, 2.0) * np.arange(readings))
    return float(((swings - swings.mean(axis=1, keepdims=True)) ** 2).sum(axis=1).mean())


@pytest.mark.parametrize("period", [3.0, 7.4, 20.0])
def test_a_swing_of_any_phase_scatters_on_average_as_it_is_expected_to(period: float) -> None:
    expected = [0.0, *(expected_scatter(period, readings) for readings in range(1, math.ceil(period) + 1))]
    assert scatter_of_swing(period) == pytest.approx(expected, abs=1e-9)
    assert scatter_of_swing(0.0).tolist() == [0.0]


class Loops:
    """The motion of means, one at a time."""

    def __init__(self, span: int, grows: bool, period: float, longest: int) -> None:
        self.span, self.grows, self.period, self.longest = span, grows, period, longest
        self.still = math.ceil(period / 4)
        self.rows = max(span, self.still)
        self.means = max(4, math.ceil(period / 2))
        self.memory = max(4 * self.rows, self.means)

    def take(self, taken: Taken, number: int) -> None:
        """Look at one of the means."""
        self.last = len(taken.readings) - MEANS + number
        self.mean, self.variance = taken.mean[number], taken.variance[number]
        self.there = [channel for channel in range(CHANNELS) if not math.isnan(self.mean[channel])]
        self.most = max([1.0 / self.variance[channel] for channel in self.there], default=1.0)
        self.doubtful = bool(taken.doubtful[number])
        seen = taken.seen
        self.since, self.size = int(seen.since[number]), int(seen.sizes[number])
        self.drifts, self.touched, self.jump = seen.drifts[number], seen.touched[number], seen.jumps[number]
        self.compared = max(min(self.size, self.span) if self.grows else self.span, self.still)
        self.window = taken.readings[self.last - self.rows + 1 : self.last + 1].copy()
        before = taken.spikes[self.last - 2 * self.rows + 1 : self.last]
        if before.any(axis=1).sum() + self.doubtful <= 1:
            for row in range(self.rows - 1):
                self.window[row][taken.spikes[self.last - self.rows + 1 + row]] = math.nan
        away = self.window - self.mean
        self.missing, self.away = np.isnan(away), np.nan_to_num(away)
        self.begun = np.array([self.rows - row <= taken.begun - (MEANS - 1 - number) for row in range(self.rows)])
        units = (self.away / UNIT_MM)[-self.compared :]
        self.newest = float((units[-1] ** 2).sum())
        self.squares = float((units**2).sum() - (units.sum(axis=0) ** 2).sum() / self.compared)
        self.raw = taken.readings[self.last - self.memory + 1 : self.last + 1]

    def moves(self) -> bool:
        """Return whether the mean moves, as far as its readings say."""
        limit = hardly_exceeded((self.compared - 1) * len(self.there))
        if self.squares > limit or self.since < min(self.compared, self.longest):
            return True
        if self.drifts and self.since <= self.memory:
            return True
        few = min(self.since, math.ceil(self.period))
        swing = expected_scatter(self.period, few) * self.jump / 4 if few else 0.0
        return bool(self.jump > 0 and self.since <= math.ceil(self.period) and swing < 2 * limit)

    def missed(self) -> tuple[bool, bool]:
        """Return whether missing readings may hide motion, and whether they say nothing of it."""
        among = self.begun & (np.arange(self.rows) >= self.rows - self.compared)
        lost = self.missing.all(axis=1)
        alone = any((among & ~lost & self.missing[:, channel]).sum() > self.compared / 2 for channel in self.there)
        unseen = any((among & self.missing[:, channel]).sum() > self.compared / 2 for channel in self.there)
        few = bool((among & lost).any()) and self.most < self.compared
        return alone or (few if self.grows else unseen), unseen

    def is_unproven(self) -> bool:
        """Return whether the beam is deflected, and was never seen to rest."""
        came = (~np.isnan(self.raw)).any(axis=1).sum()
        if self.most >= self.rows or came >= self.rows:
            return False
        square = sum((self.mean[channel] / UNIT_MM[channel]) ** 2 / self.variance[channel] for channel in self.there)
        return bool(square > hardly_exceeded(len(self.there)))

    def excess(self, means: FloatArray, confirms: bool, any_missing: bool) -> FloatArray:
        """Return the covariance of a mean that moves, after some means."""
        before = means[~np.isnan(means - self.mean).all(axis=1)] - self.mean
        excess = np.nan_to_num(before).T @ np.nan_to_num(before) / max(len(before), 1)
        share = 0.5 if self.since < self.size else 0.0
        if (self.doubtful and confirms) or (self.since < self.span and not self.grows):
            share = 1.0
        if self.newest > hardly_exceeded(len(self.there)):
            excess += share * np.outer(self.away[-1], self.away[-1])
        variance = min(self.newest / max(self.squares, 1.0), 1.0) * NOISE_MM**2 + 0.03**2 * np.trace(excess)
        if any_missing:
            left_out = (self.missing & self.begun[:, np.newaxis]).sum(axis=0) / self.rows
            around = np.nan_to_num(self.raw - self.mean)
            variance += (left_out * (around.max(axis=0) - around.min(axis=0))) ** 2
        return np.asarray(excess + np.diag(variance))


def drawn(rng: np.random.Generator, loops: Loops, whole: bool) -> tuple[Taken, Past]:
    """Return means whose readings scatter, move, are lost or spikes, all of it now and then."""
    rows = loops.memory + MEANS + 2
    scale = rng.choice([0.7, 1.0, 1.6])
    readings = NOISE_MM * scale * rng.standard_normal((rows, CHANNELS)) + rng.choice([0.0, 3.0])
    spikes = np.zeros(readings.shape, np.bool_)
    mean = np.array([readings[row - 3 : row + 1].mean(axis=0) for row in range(rows - MEANS, rows)])
    mean += rng.choice([0.0, 0.5]) * rng.standard_normal(mean.shape)
    if not whole:
        readings[rng.random(readings.shape) < rng.choice([0.02, 0.3, 0.6])] = math.nan
        readings[rng.random(rows) < rng.choice([0.0, 0.2, 0.7])] = math.nan
        for _ in range(rng.integers(3)):
            spikes[rng.integers(rows - MEANS - loops.rows, rows - 1), rng.integers(CHANNELS)] = True
        mean[:, rng.integers(CHANNELS)] = rng.choice([math.nan, 2.0])
        mean[rng.integers(MEANS)] *= rng.choice([math.nan, 1.0], p=[0.2, 0.8])
    sizes = rng.integers(1, loops.longest + 1, MEANS)
    seen = Seen(
        np.where(rng.random(MEANS) < 0.6, loops.longest, rng.integers(1, loops.longest + 1, MEANS)),
        sizes,
        rng.random(MEANS) < 0.15,
        rng.random(MEANS) < 0.2,
        np.where(rng.random(MEANS) < 0.5, 0.0, 10 ** rng.uniform(0, 3, MEANS)),
        np.where(rng.random((MEANS, 1)) < 0.5, 0.0, rng.standard_normal((MEANS, CHANNELS))),
    )
    variance = np.where(np.isnan(mean), math.nan, 1 / rng.integers(1, 2 * loops.rows, mean.shape))
    begun = int(rng.choice([rows, loops.rows, MEANS + 1]))
    past = Past(rng.standard_normal((loops.means, CHANNELS)), bool(rng.random() < 0.4))
    past.means[: rng.integers(loops.means + 1)] = math.nan
    return Taken(readings, begun, spikes, rng.random(MEANS) < 0.2, mean, variance, seen), past


def looked(loops: Loops, taken: Taken, past: Past) -> tuple[list[bool], list[bool], list[FloatArray], bool]:
    """Return what moves, what lags, the covariances of these, and whether the last one moved."""
    means, moved = np.concatenate([past.means, taken.mean]), past.moved
    looks, any_missing = [], False
    for number in range(MEANS):
        loops.take(taken, number)
        any_missing |= bool(loops.missing.any())
    for number in range(MEANS):
        loops.take(taken, number)
        moves, unseen, confirms = loops.moves(), False, True
        if any_missing:
            hides, unseen = loops.missed()
            moves = moves or hides
        if loops.there:
            confirms, moves = not moved, moves or (moved and unseen)
            moved = moved if loops.doubtful else moves
        unproven = any_missing and loops.is_unproven()
        moves = moves or loops.doubtful or unproven
        lag = taken.seen.lags[number] if loops.grows else np.zeros(CHANNELS)
        excess = np.outer(lag, lag)
        if moves:
            excess = excess + loops.excess(means[number : number + loops.means], confirms, any_missing)
            if loops.grows and loops.touched and not loops.doubtful:
                excess = np.diag(UNIT_MM**2)
            excess = excess + unproven * np.eye(CHANNELS) * np.nansum(loops.mean**2)
        there = ~np.isnan(loops.mean)
        looks.append((moves, bool(lag.any()) and not moves, excess * np.outer(there, there)))
    uncertain = [excess for moves, lags, excess in looks if moves or lags]
    return [moves for moves, *_ in looks], [lags for _, lags, _ in looks], uncertain, moved


@pytest.mark.parametrize("whole", [True, False], ids=["whole", "with losses"])
@pytest.mark.parametrize(
    ("span", "grows", "period", "longest"),
    [(8, True, 13.0, 40), (3, True, 26.5, 30), (5, False, 9.0, 18), (1, False, 0.0, 2)],
)
def test_means_move_as_their_readings_say_one_by_one(
    span: int, grows: bool, period: float, longest: int, whole: bool
) -> None:
    loops, rng = Loops(span, grows, period, longest), np.random.default_rng(span)
    detector = ChangeDetector(CHANNELS, longest, 1, period, 1.0)
    motion = Motion(detector, span, grows=grows, noise_mm=NOISE_MM, unit_mm=UNIT_MM, slowest_period=period)
    assert motion.memory == loops.memory
    assert (motion.fresh().means.shape, motion.fresh().moved) == ((loops.means, CHANNELS), False)
    moving = 0
    for _ in range(30):
        taken, past = drawn(rng, loops, whole)
        found: Filtered
        found, after = motion.of(taken, past, 0)
        moves, lags, excess, moved = looked(loops, taken, past)
        assert (found.moves.tolist(), found.lags.tolist(), after.moved) == (moves, lags, moved)
        assert found.excess_mm2 == pytest.approx(np.reshape(excess, (-1, CHANNELS, CHANNELS)))
        kept = np.concatenate([past.means, taken.mean])[-loops.means :]
        np.testing.assert_array_equal(after.means, kept)
        assert not found.found.any()
        moving += sum(moves)
    assert 20 < moving < 100
