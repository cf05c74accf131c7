"""Finds the rest of a beam that rings: the free-pole fit, reading by reading.

While a beam swings, the mean of few readings is far from where it will rest, and a mean of many must begin somewhere.
The constant of a fit needs neither: it is known as soon as the readings show the swings. The fit begins with the first
reading that moves, takes every reading since, and begins anew when it fails. Its poles are carried on, so that a
reading costs one step. Only where the swings are most of what is seen (`OPENS`, `CLOSES`) does it replace the mean.

Until the swings after a touch are found, those from before it go on.

docs/decisions/045-ringing.md explains the form.
"""

import math
from typing import NamedTuple, Self

import numpy as np

from beamtouch_models.filters.filtered import Found
from beamtouch_models.filters.jitter import whitened
from beamtouch_models.filters.readings import FloatArray
from beamtouch_models.filters.search import LEAST_ROWS, MOST_ROWS, Whole, carried, sought, whole_of
from beamtouch_models.filters.significance import FALSE, SHARP, chi_square_quantile
from beamtouch_models.filters.sinusoids import LEAST_CYCLES, Fit, mean_times, predicted

ROWS_A_PERIOD = 20
"""Rows in the slowest period; at a higher rate, a row is the mean of several readings."""
YOUNG = 16
"""Rows below which a fit that fails lacks a pole, more likely than that something has changed."""
SHORTER = 0.6
"""Length of the shorter window that is tried where one fails, over it."""
SLOPES_TRIED = 4
"""Slopes are tried in one fit of so many."""
MOST_AHEAD = 16
"""Most rows that wait for a fit, because they are as the last one predicts; half as many if it has slopes."""
FRESH = 4
"""A fit is of all but a part of its rows: one in so many."""
LIKE = 2.0
"""Square of the distance of a row from its prediction, over that of noise, up to which it is as predicted."""
MOST_WAITS = 8
"""After each search in vain a row more passes before the next one, up to so many."""
CALM_ROWS = 5
"""Rows that do not move, after which a search is given up."""
OPENS, CLOSES = 15.0, 3.0
"""Swings (r.m.s., in units of the noise) at which the fit replaces the mean, and at which it no longer does."""
UNSEEN_SWING = 0.03
"""Swing that readings do not show, over that which they show, if a scene does not say it: modes that seem to stand
still, and what is no damped sinusoid."""
FEW = 8.0
"""Rows below which much more is not seen."""
FORMER_TURNS = 2.0
"""Turns of each swing that a fit has seen, from which on it goes on as the fit says, whatever comes."""
TOUCH_PART, LEAST_TOUCH_ROWS = 1 / 4, 2
"""Part of the slowest period in which a beam that is touched swings little yet, and its fewest rows."""
SHAPE = 0.1
"""Difference between its deflection then and that at rest, over the latter: faster modes have come further."""
STAMP_OFF, STAMP_PART = 1.0, 0.1
"""Largest difference between times by stamps and by counting readings: in readings, and more over the latter."""
MOST_UNDATED = 2
"""Readings in a row without a known time, from which on no rest is told."""
LAGS = (1, 2)
"""The constant is compared with those of so many fits before."""


class Followed(NamedTuple):
    """The memory of a beam that moves."""

    block: tuple[tuple[float, FloatArray], ...]
    """Times and values of the readings that are no row yet."""
    times: FloatArray
    """Of the rows, in readings, shape (rows,); of rows that are means, (rows, readings)."""
    values: FloatArray
    """In units of the noise, shape (rows, channels); NaN where one is missing."""
    fit: Fit | None
    """The last fit; None while none is found."""
    fitted: float
    """Time of the newest row in it."""
    doubtful: tuple[FloatArray, FloatArray] | None
    """The times and values of the newest row, if it contradicts the fit. The next one says whether it is a spike."""
    waits: int
    """Rows until the next search."""
    failures: int
    """Searches in vain, in a row."""
    age: int
    """Fits since the beginning."""
    constants: tuple[FloatArray, ...]
    """Of the last fits in a row, shape (channels,) each."""
    opened: bool
    """True if the swings are most of the motion."""
    calm: int
    """Readings in a row that did not move."""
    found: Found | None
    passed: int = 0
    """Readings since the newest row in the fit, with those that are lost."""
    undated: int = 0
    """Readings in a row that came, but whose times are not known."""
    former: tuple[Fit, float] | None = None
    """The fit before the last sharp change, and the time of the newest row in it; None after the first fit since."""

    @property
    def is_confirmed(self) -> bool:
        """True if the last fit is the second one in a row. One to few rows may be chance."""
        return len(self.constants) > 1

    def with_rows(self, times: FloatArray, values: FloatArray) -> Self:
        """Return what is known with more rows; the oldest ones are forgotten."""
        return self._replace(
            times=np.concatenate([self.times, times])[-MOST_ROWS:],
            values=np.concatenate([self.values, values])[-MOST_ROWS:],
        )


class Ringing:
    """Follows a surface.

    Parameters
    ----------
    slowest_period
        Of the motion of the beam, in readings.
    noise_mm, unit_mm
        Standard deviation of a reading, and what deviations are compared with, shape (channels,).
    unseen
        Swing that readings do not show, over that which they show.
    """

    def __init__(self, slowest_period: float, noise_mm: FloatArray, unit_mm: FloatArray, unseen: float) -> None:
        self._slowest_period, self._noise_mm, self._unseen = slowest_period, noise_mm, unseen
        self._block = max(1, round(slowest_period / ROWS_A_PERIOD))
        """Readings in a row."""
        # So that the mean of a block has the noise of 1.
        self._unit_mm = unit_mm / math.sqrt(self._block)
        self._areas_mm2 = np.outer(self._unit_mm, self._unit_mm)
        self._touch_rows = max(LEAST_TOUCH_ROWS, round(TOUCH_PART * slowest_period / self._block))
        """Most rows after a touch in which the beam swings little yet."""
        self._lowest = 2 * math.pi * LEAST_CYCLES * self._block / slowest_period
        """Lowest angular frequency, per row."""

    def follow(
        self, before: Followed | None, times: FloatArray, readings_mm: FloatArray, moves: list[bool]
    ) -> tuple[list[tuple[int, Found]], Followed | None]:
        """Take the next readings; return the rests that are found, by reading, and what is known after them.

        Parameters
        ----------
        before
            What was known.
        times, readings_mm
            When they were taken, in readings, and shape (readings, channels). NaN is missing: a reading without any
            value, or without a time, is lost.
        moves
            Whether the mean of the newest readings moves, after each of them.
        """
        rests: list[tuple[int, Found]] = []
        there = np.any(~np.isnan(readings_mm), axis=1)
        came, undated = (there & ~np.isnan(times)).tolist(), (there & np.isnan(times)).tolist()
        reading = 0
        while reading < len(moves):
            if before is None and not moves[reading]:
                reading += 1
                continue
            until = reading
            if before is not None and before.is_confirmed and before.fit is not None:
                before, until = self._wait(before, before.fit, times, readings_mm, moves, reading)
            if until == reading:
                reading_mm = readings_mm[reading] if came[reading] else None
                before, until = self._step(before, float(times[reading]), reading_mm, moves=moves[reading]), reading + 1
                if before is not None and (undated[reading] or came[reading]):
                    before = before._replace(undated=before.undated + 1 if undated[reading] else 0)
            # Readings whose time is not known cannot contradict a rest. One of them may be chance.
            if before is not None and before.found is not None and before.undated < MOST_UNDATED:
                rests += [(row, before.found) for row in range(reading, until) if moves[row]]
            reading = until
        return rests, before

    def _waits(self, before: Followed, last: Fit, time: float, more: int = 0) -> bool:
        """Return whether a row that the last fit predicts waits for the next one, after so many more."""
        most = min(MOST_AHEAD // (1 + last.slopes), (len(before.times) + more) // FRESH)
        return (time - before.fitted) / self._block < most

    def _wait(
        self,
        before: Followed,
        last: Fit,
        times: FloatArray,
        readings_mm: FloatArray,
        moves: list[bool],
        first: int,
    ) -> tuple[Followed, int]:
        """Take readings from the first one on that wait for a fit; return what is known, and the next reading."""
        if self._block > 1 or before.doubtful is not None or not self._waits(before, last, times[first]):
            return before, first
        ahead = slice(first, first + MOST_AHEAD)
        rows = readings_mm[ahead] / self._unit_mm
        are_predicted = self._are_predicted(before, last, times[ahead], rows)
        calm, number = before.calm, 0
        while number < len(rows) and are_predicted[number]:
            calmer = 0 if moves[first + number] else calm + 1
            if calmer >= self._slowest_period or not self._waits(before, last, times[first + number], number):
                break
            calm, number = calmer, number + 1
        if not number:
            return before, first
        return before.with_rows(times[first : first + number], rows[:number])._replace(
            calm=calm, passed=before.passed + number, undated=0
        ), first + number

    def _step(
        self, before: Followed | None, time: float, reading_mm: FloatArray | None, *, moves: bool
    ) -> Followed | None:
        """Take the next reading, None if it is lost; return what is known, None of a beam that does not move."""
        if before is None:
            if not moves or reading_mm is None:
                return None
            nothing = np.zeros((0, len(reading_mm)))
            before = Followed((), np.zeros(self._shape_of(0)), nothing, None, time, None, 0, 0, 0, (), False, 0, None)
        before = before._replace(passed=before.passed + 1)
        calm = 0 if moves else before.calm + 1
        if calm >= (CALM_ROWS * self._block if before.fit is None else self._slowest_period):
            return None
        if reading_mm is None:
            return before._replace(calm=calm)
        block = (*before.block, (time, reading_mm))
        if len(block) < self._block:
            return before._replace(block=block, calm=calm)
        times, readings = zip(*block, strict=True)
        row = sum(readings) / self._block / self._unit_mm
        return self._follow(before._replace(block=(), calm=calm), np.reshape(times, self._shape_of(1)), row[np.newaxis])

    def _shape_of(self, rows: int) -> tuple[int, ...]:
        """Return the shape of the times of some rows."""
        return (rows,) if self._block == 1 else (rows, self._block)

    def _follow(self, before: Followed, time: FloatArray, row: FloatArray) -> Followed:
        """Take the next row: its times, and its values (1, channels)."""
        now = before.with_rows(time, row)
        times, values = now.times, now.values
        if before.fit is None or not self._is_dated(now, before.fitted):
            return self._searched(now if before.fit is None else now._replace(times=time, values=row, opened=False))
        is_predicted = before.doubtful is None and self._are_predicted(before, before.fit, times[-1:], values[-1:])[0]
        if is_predicted and before.is_confirmed and self._waits(before, before.fit, time.mean()):
            return now
        checks = before.age % SLOPES_TRIED == 0
        best = self._carried(before.fit, now, checks=checks)
        if best is None and is_predicted and len(times) >= YOUNG:
            # Nothing has changed, but the oldest swings were others.
            newer = -int(SHORTER * len(times))
            now = now._replace(times=times[newer:], values=values[newer:])
            best = self._carried(before.fit, now, checks=checks)
        if best is not None:
            return self._told(now._replace(doubtful=None, waits=0), best)
        if len(times) < YOUNG:
            return self._searched(now)
        if before.doubtful is None:
            return before._replace(doubtful=(time, row), found=None)
        # Two rows in a row: something has changed.
        times, values = (np.concatenate(pair) for pair in zip(before.doubtful, (time, row), strict=True))
        former = (before.fit, before.fitted) if before.opened and before.fit.turns >= FORMER_TURNS else None
        return self._searched(now._replace(times=times, values=values, former=former))

    def _are_predicted(self, before: Followed, last: Fit, times: FloatArray, rows: FloatArray) -> list[bool]:
        """Return whether the last fit says what rows are, (rows, channels)."""
        if len(last.constant) != rows.shape[1]:
            return [False] * len(rows)
        # One that is lost may have no time.
        since = np.maximum(times - before.fitted, 0.0) / self._block
        apart = whitened(last, since, rows - predicted(last, since))
        limit = LIKE * chi_square_quantile(rows.shape[1], FALSE)
        return [square < limit for square in (apart * apart).sum(axis=1).tolist()]  # False for NaN

    def _searched(self, now: Followed) -> Followed:
        """Search for a fit: of all rows, or else of the newer ones."""
        rows = len(now.times)
        if now.waits > 0 or rows < LEAST_ROWS:
            return self._told(now._replace(doubtful=None, waits=now.waits - 1), None)
        now, newest = now._replace(constants=()), rows
        best = self._sought(now, rows)
        if best is None and SHORTER * rows >= LEAST_ROWS:
            newest = int(SHORTER * rows)
            best = self._sought(now, newest)
        failures = 0 if best else now.failures + 1
        now = now._replace(
            times=now.times[-newest:],
            values=now.values[-newest:],
            doubtful=None,
            failures=failures,
            waits=min(failures, MOST_WAITS),
        )
        return self._told(now, best)

    def _told(self, now: Followed, best: Fit | None) -> Followed:
        """Return what is known with a fit to all rows; without one, what rang before a touch goes on."""
        if best is None:
            now = now._replace(fit=None, found=None, opened=False, constants=())
            return now if now.former is None else self._touched(now, *now.former)
        opened = self._seen(best, now) > (CLOSES if now.opened else OPENS)
        rest = self._found(now, best) if opened and now.constants else None
        constant = np.full(now.values.shape[1], np.nan)
        constant[~np.isnan(now.values[-1])] = best.constant
        constants = (*now.constants, constant)[-max(LAGS) :]
        return now._replace(
            fit=best,
            fitted=now.times[-1].mean(),
            opened=opened,
            found=rest,
            constants=constants,
            age=now.age + 1,
            passed=0,
            former=None,
        )

    def _is_dated(self, now: Followed, fitted: float) -> bool:
        """Return whether the stamp of the newest row agrees with the number of readings since the newest one fitted.

        A board that was started anew has another clock.
        """
        return bool(abs(now.times[-1].mean() - fitted - now.passed) <= STAMP_OFF + STAMP_PART * now.passed)

    def _touched(self, now: Followed, former: Fit, fitted: float) -> Followed:
        """Return what is known just after a beam that rang has changed sharply: the mean of the rows, less the swings.

        So few rows prove no rest, so it is stated as uncertain as a single reading. Stamps that do not agree with the
        number of readings say nothing of the swings.
        """
        middles = mean_times(now.times)
        goes_on = now.values.shape[1] == len(former.constant) and not np.isnan(now.values).any()
        is_new = middles[-1] - middles[0] < self._touch_rows * self._block
        if (
            not (goes_on and self._is_dated(now, fitted) and is_new)
            or now.passed > (MOST_AHEAD + self._touch_rows) * self._block
        ):
            return now._replace(former=None)
        since = (now.times - fitted) / self._block
        swings = predicted(former, since) - former.constant
        apart = whitened(former, since, now.values - swings - former.constant)
        if (apart * apart).sum(axis=1).min() < LIKE * chi_square_quantile(apart.shape[1], SHARP):
            return now._replace(former=None)
        rows, mean = len(since), (now.values - swings).mean(axis=0)
        swing, load = float((swings[-1] ** 2).sum()), float(((mean - former.constant) ** 2).sum())
        unseen = self._unseen_part(former.rows) ** 2 * swing + SHAPE**2 * load
        excess_mm2 = np.diag(self._unit_mm**2 * (self._block + unseen))
        mean_mm = mean * self._unit_mm
        return now._replace(found=Found(mean_mm, rows * self._block, excess_mm2, is_rest=False))

    def _unseen_part(self, rows: int) -> float:
        """Return the swing that so many rows do not show, over that which they show."""
        return self._unseen * (1 + (FEW / rows) ** 2)

    def _whole(self, now: Followed, newest: int = MOST_ROWS) -> Whole | None:
        """Return the newest rows that can be fitted."""
        return whole_of(now.times[-newest:], now.values[-newest:], self._block, self._lowest)

    def _carried(self, last: Fit, now: Followed, *, checks: bool) -> Fit | None:
        """Return the last fit, carried on to all rows; None if none explains them."""
        rows = self._whole(now)
        return None if rows is None else carried(last, rows, checks=checks)

    def _sought(self, now: Followed, newest: int) -> Fit | None:
        """Return the best fit to so many newest rows; None if none explains them."""
        rows = self._whole(now, newest)
        return None if rows is None else sought(rows)

    def _seen(self, of: Fit, now: Followed) -> float:
        """Return the swings that are seen (r.m.s., in units of the noise)."""
        rows = self._whole(now)
        if rows is None or not len(of.poles.decay):
            return 0.0
        ages, values = mean_times(rows.ages), rows.values - rows.values.mean(axis=0)
        ages = ages - ages.mean()
        slope = ages @ values
        line = (values * values).sum() - slope @ slope / (ages @ ages)
        return math.sqrt(max(0.0, line - of.promised) / len(ages))

    def _found(self, now: Followed, of: Fit) -> Found:
        """Return the constant of a fit with its covariance."""
        there = ~np.isnan(now.values[-1])
        before = np.array([now.constants[-lag] for lag in LAGS if lag <= len(now.constants)])[:, there]
        apart = np.nan_to_num(before - of.constant)
        covariance = of.covariance + apart.T @ apart / len(apart)
        unseen = self._unseen_part(of.rows)
        if len(covariance) < len(there):
            covariance, part = np.zeros((len(there), len(there))), covariance
            covariance[np.ix_(there, there)] = part
        covariance = covariance * self._areas_mm2
        readings = of.rows * self._block
        unseen_mm2 = unseen**2 * of.swing * self._unit_mm**2
        covariance.flat[:: len(there) + 1] += there * (unseen_mm2 - self._noise_mm**2 / readings)
        mean_mm = np.full(len(there), np.nan)
        mean_mm[there] = of.constant * self._unit_mm[there]
        return Found(mean_mm, readings, covariance)
