"""Where the beam rings about its rest: the free-pole fit, reading by reading.

While a beam swings, the mean of few readings is far from where it will rest, and a mean of many must begin somewhere.
The constant of a fit needs neither: it is known as soon as the readings show the swings. The fit begins with the first
reading that moves, takes every reading since, and begins anew when it fails. Its poles are carried on, so that a
reading costs one step. Only where the swings are most of what is seen (`OPENS`, `CLOSES`) does it replace the mean.

docs/decisions/045-ringing.md explains the form.
"""

import math
from typing import NamedTuple, Self

import numpy as np

from beamtouch_models.filters.filtered import Found
from beamtouch_models.filters.jitter import refit, whitened
from beamtouch_models.filters.readings import FloatArray
from beamtouch_models.filters.significance import FALSE, SHARP, chi_square_quantile
from beamtouch_models.filters.sinusoids import LEAST_CYCLES, Band, Fit, Poles, fit, middle, predicted, refine, seek

MOST_ROWS = 94
"""Most rows of a fit. Over more of them, the frequency of a real beam changes with its amplitude."""
ROWS_A_PERIOD = 20
"""Rows in the slowest period; at a higher rate, a row is the mean of several readings."""
LEAST_ROWS = 5
"""Fewest rows of a fit."""
YOUNG = 16
"""Rows below which a fit that fails lacks a pole, more likely than that something has changed."""
MOST_POLES = 2
"""Three pairs would take a load that grows for a swing."""
SHORTER = 0.6
"""Length of the shorter window that is tried where one fails, over it."""
STEPS = 2
"""Gauss-Newton steps of a search, for each new pole."""
HIGHEST_LOWEST = 3.0
"""Lowest frequency, per row, above which there is no place for a pole: the rows are too close together."""
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
JITTER, JITTER_ANGLE = 0.3, 0.6
"""Largest deviation of stamps that is allowed for where exact ones do not explain the rows: in rows, and of the angle
of the swings."""
FORMER_TURNS = 2.0
"""Turns of each swing that a fit has seen, from which on it goes on as the fit says, whatever comes."""
STILL_PART, LEAST_STILL = 1 / 4, 2
"""Part of the slowest period in which a beam that is touched swings little yet, and its fewest rows."""
SHAPE = 0.1
"""What its deflection then differs from that at rest, over it: faster modes have come further."""
LAGS = (1, 2)
"""The constant is compared with those of so many fits before."""


class Followed(NamedTuple):
    """What is known of a beam that moves."""

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
    calm: int
    """Readings in a row that did not move."""
    found: Found | None
    former: tuple[Fit, float] | None = None
    """The fit before the last sharp change, and the time of the newest row in it; None after the first fit since."""

    @property
    def is_confirmed(self) -> bool:
        """Whether the last fit is the second one in a row. One to few rows may be chance."""
        return len(self.constants) > 1

    def with_rows(self, times: FloatArray, values: FloatArray) -> Self:
        """Return what is known with more rows; the oldest ones are forgotten."""
        return self._replace(
            times=np.concatenate([self.times, times])[-MOST_ROWS:],
            values=np.concatenate([self.values, values])[-MOST_ROWS:],
        )


class Whole(NamedTuple):
    """Rows that have the same channels."""

    ages: FloatArray
    """Their times, in rows before the newest one, shape (rows,), or (rows, readings)."""
    values: FloatArray
    """In units of the noise, shape (rows, channels)."""
    band: Band
    """Frequencies that they show."""


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
        self._still = max(LEAST_STILL, round(STILL_PART * slowest_period / self._block))
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
        found: list[tuple[int, Found]] = []
        came, at = (~np.isnan(times) & np.any(~np.isnan(readings_mm), axis=1)).tolist(), 0
        while at < len(moves):
            if before is None and not moves[at]:
                at += 1
                continue
            until = at
            if before is not None and before.is_confirmed and before.fit is not None:
                before, until = self._wait(before, before.fit, times, readings_mm, moves, at)
            if until == at:
                reading_mm = readings_mm[at] if came[at] else None
                before, until = self._step(before, float(times[at]), reading_mm, moves=moves[at]), at + 1
            if before is not None and before.found is not None:
                found += [(row, before.found) for row in range(at, until) if moves[row]]
            at = until
        return found, before

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
        return before.with_rows(times[first : first + number], rows[:number])._replace(calm=calm), first + number

    def _step(
        self, before: Followed | None, time: float, reading_mm: FloatArray | None, *, moves: bool
    ) -> Followed | None:
        """Take the next reading, None if it is lost; return what is known, None of a beam that does not move."""
        if before is None:
            if not moves or reading_mm is None:
                return None
            nothing = np.zeros((0, len(reading_mm)))
            before = Followed((), np.zeros(self._shape_of(0)), nothing, None, time, None, 0, 0, 0, (), False, 0, None)
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
        if before.fit is None:
            return self._searched(now)
        is_predicted = before.doubtful is None and self._are_predicted(before, before.fit, times[-1:], values[-1:])[0]
        if is_predicted and before.is_confirmed and self._waits(before, before.fit, time.mean()):
            return now
        checks = before.age % SLOPES_TRIED == 0
        best = self._carried(before.fit, times, values, checks=checks)
        if best is None and is_predicted and len(times) >= YOUNG:
            # Nothing has changed, but the oldest swings were others.
            newer = -int(SHORTER * len(times))
            now = now._replace(times=times[newer:], values=values[newer:])
            best = self._carried(before.fit, now.times, now.values, checks=checks)
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
        now, kept = now._replace(constants=()), rows
        best = self._sought(now.times, now.values)
        if best is None and SHORTER * rows >= LEAST_ROWS:
            kept = int(SHORTER * rows)
            best = self._sought(now.times[-kept:], now.values[-kept:])
        failures = 0 if best else now.failures + 1
        now = now._replace(
            times=now.times[-kept:],
            values=now.values[-kept:],
            doubtful=None,
            failures=failures,
            waits=min(failures, MOST_WAITS),
        )
        return self._told(now, best)

    def _told(self, now: Followed, best: Fit | None) -> Followed:
        """Return what is known with a fit to all rows; None: none is found."""
        if best is None:
            now = now._replace(fit=None, found=None, opened=False, constants=())
            return now if now.former is None else self._touched(now, *now.former)
        opened = self._seen(best, now) > (CLOSES if now.opened else OPENS)
        found = self._found(now, best) if opened and now.constants else None
        constant = np.full(now.values.shape[1], np.nan)
        constant[~np.isnan(now.values[-1])] = best.constant
        constants = (*now.constants, constant)[-max(LAGS) :]
        return now._replace(
            fit=best,
            fitted=now.times[-1].mean(),
            opened=opened,
            found=found,
            constants=constants,
            age=now.age + 1,
            former=None,
        )

    def _touched(self, now: Followed, former: Fit, fitted: float) -> Followed:
        """Return what is known of a beam that rang, and has changed sharply: without the swings, it is as if at rest.

        Of so few rows, the newest one alone may be what the mean is off by, as after the touch of a beam that rests.
        """
        if len(now.times) > self._still or np.isnan(now.values).any() or now.values.shape[1] != len(former.constant):
            return now._replace(former=None)
        since = (now.times - fitted) / self._block
        swings = predicted(former, since) - former.constant
        apart = whitened(former, since, now.values - swings - former.constant)
        if (apart * apart).sum(axis=1).min() < 2 * chi_square_quantile(apart.shape[1], SHARP):
            return now._replace(former=None)
        rows, mean = len(since), (now.values - swings).mean(axis=0)
        swing, load = float((swings[-1] ** 2).sum()), float(((mean - former.constant) ** 2).sum())
        unseen = (self._unseen * (1 + (FEW / former.rows) ** 2)) ** 2 * swing + SHAPE**2 * load
        excess_mm2 = np.diag(self._unit_mm**2 * (self._block + unseen))
        mean_mm = mean * self._unit_mm
        readings = rows * self._block
        variance_mm2 = float(np.trace(excess_mm2) + (self._noise_mm**2).sum() / readings)
        return now._replace(found=Found(mean_mm, readings, excess_mm2, variance_mm2))

    def _whole(self, times: FloatArray, values: FloatArray) -> Whole | None:
        """Return the rows that have all channels of the newest one; None if they cannot show a swing.

        Rows from before a long gap do not count: their swings may have been any number of times as large. Nor do those
        that stamps which went back say are newer.
        """
        ages = (times - times[-1].mean()) / self._block
        since, there = middle(ages), ~np.isnan(values[-1])
        rows = ~np.isnan(values[:, there]).any(axis=1) & (since <= 0) & (since > -MOST_ROWS)
        if not (there.all() and rows.all()):
            ages, since, values = ages[rows], since[rows], values[np.ix_(rows, there)]
        if len(ages) < LEAST_ROWS:
            return None
        lowest = max(self._lowest, 2 * math.pi * LEAST_CYCLES / (1 - since.min()))
        return Whole(ages, values, Band.of(ages, lowest)) if lowest <= HIGHEST_LOWEST else None

    def _carried(self, last: Fit, times: FloatArray, values: FloatArray, *, checks: bool) -> Fit | None:
        """Return the last fit some rows later; with or without slopes, or with one more pole, if that is better.

        None if none explains the rows.
        """
        whole = self._whole(times, values)
        if whole is None:
            return None
        ages, values, band = whole
        best = fit(ages, values, last.following.within(band), band, slopes=last.slopes)
        if explains(best) and not checks:
            return best
        if last.jitter and (jittery := with_jitter(best._replace(jitter=last.jitter), whole)):
            return jittery
        other = fit(ages, values, best.following, band, slopes=not last.slopes)
        if explains(other) and (not explains(best) or worth(other) < worth(best)):
            best = other
        if not explains(best) and len(last.poles.decay) < MOST_POLES:
            best = refine(ages, values, seek(best, ages, values, band), band, slopes=last.slopes, steps=STEPS)
        return best if explains(best) else with_jitter(best, whole)

    def _sought(self, times: FloatArray, values: FloatArray) -> Fit | None:
        """Return the best fit of all kinds; None if none explains the rows."""
        whole = self._whole(times, values)
        if whole is None:
            return None
        ages, values, band = whole
        best = fit(ages, values, Poles.none(), band, slopes=False)
        sloping = fit(ages, values, Poles.none(), band, slopes=True)
        for _ in range(MOST_POLES):
            few = values.size < best.parameters + 2 + 3 * values.shape[1]
            if few or explains(best) or explains(sloping):
                break
            best = refine(ages, values, seek(best, ages, values, band), band, slopes=False, steps=STEPS)
            if not explains(best):
                sloping = refine(ages, values, best.following, band, slopes=True, steps=1)
            if not explains(best) and not explains(sloping) and (jittery := with_jitter(best, whole)):
                return jittery
        return next(filter(explains, (best, sloping)), None)

    def _seen(self, of: Fit, now: Followed) -> float:
        """Return the swings that are seen (r.m.s., in units of the noise)."""
        whole = self._whole(now.times, now.values)
        if whole is None or not len(of.poles.decay):
            return 0.0
        ages, values = middle(whole.ages), whole.values - whole.values.mean(axis=0)
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
        unseen = self._unseen * (1 + (FEW / of.rows) ** 2)
        if len(covariance) < len(there):
            covariance, part = np.zeros((len(there), len(there))), covariance
            covariance[np.ix_(there, there)] = part
        covariance = covariance * self._areas_mm2
        readings = of.rows * self._block
        unseen_mm2 = unseen**2 * of.swing * self._unit_mm**2
        covariance.flat[:: len(there) + 1] += there * (unseen_mm2 - self._noise_mm**2 / readings)
        white_mm2 = float(there @ self._noise_mm**2) / readings
        mean_mm = np.full(len(there), np.nan)
        mean_mm[there] = of.constant * self._unit_mm[there]
        return Found(mean_mm, readings, covariance, float(np.trace(covariance)) + white_mm2)


def with_jitter(of: Fit, whole: Whole) -> Fit | None:
    """Return the fit to rows whose stamps are not exact; None if that does not explain them either.

    One channel alone does not tell what is late from what is elsewhere. What the last step promises is not enough: a
    load that comes softly would be taken for a swing whose decay was clipped.
    """
    ages, values, band = whole
    if not len(of.poles.decay) or values.shape[1] < 2:
        return None
    most = min(JITTER, JITTER_ANGLE / of.speed)
    best, left = refit(of, ages, values, band, most)
    leaves_noise = left < chi_square_quantile(max(best.freedom, 1), FALSE)
    return best if leaves_noise and explains(best) else None


def explains(of: Fit) -> bool:
    """Return whether a fit leaves no more than noise."""
    enough = len(of.constant) if len(of.coefficients) > 1 else 1
    return of.freedom >= enough and of.promised < chi_square_quantile(of.freedom, FALSE)


def worth(of: Fit) -> float:
    """Return Akaike's criterion."""
    return of.promised + 2 * of.parameters
