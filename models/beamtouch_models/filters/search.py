"""The best fit to some rows of a beam that swings: a search from nothing, or the last fit carried on."""

import math
from typing import NamedTuple

import numpy as np

from beamtouch_models.filters.jitter import refit
from beamtouch_models.filters.readings import FloatArray
from beamtouch_models.filters.significance import FALSE, chi_square_quantile
from beamtouch_models.filters.sinusoids import LEAST_CYCLES, Band, Fit, Poles, fit, mean_times, refine, seek

LEAST_ROWS = 5
"""Fewest rows of a fit."""
MOST_POLES = 2
"""Three pairs would take a load that grows for a swing."""
STEPS = 2
"""Gauss-Newton steps of a search, for each new pole."""
HIGHEST_LOWEST = 3.0
"""Lowest frequency, per row, above which there is no place for a pole: the rows are too close together."""
JITTER, JITTER_ANGLE = 0.3, 0.6
"""Largest deviation of stamps that is allowed for where exact ones do not explain the rows: in rows, and of the angle
of the swings."""
MOST_ROWS = 94
"""Most rows of a fit. Over more of them, the frequency of a real beam changes with its amplitude."""


class Whole(NamedTuple):
    """Rows that have the same channels."""

    ages: FloatArray
    """Their times, in rows before the newest one, shape (rows,), or (rows, readings)."""
    values: FloatArray
    """In units of the noise, shape (rows, channels)."""
    band: Band
    """Frequencies that they show."""


def whole_of(times: FloatArray, values: FloatArray, block: int, slowest: float) -> Whole | None:
    """Return the rows that have all channels of the newest one; None if they cannot show a swing.

    Rows from before a long gap do not count: their swings may have been any number of times as large. Nor do those
    that stamps which went back say are newer.

    Parameters
    ----------
    times, values
        As in `Followed`.
    block
        Readings in a row.
    slowest
        Angular frequency of the slowest swing to be sought, per row.
    """
    ages = (times - times[-1].mean()) / block
    since, there = mean_times(ages), ~np.isnan(values[-1])
    rows = ~np.isnan(values[:, there]).any(axis=1) & (since <= 0) & (since > -MOST_ROWS)
    if not (there.all() and rows.all()):
        ages, since, values = ages[rows], since[rows], values[np.ix_(rows, there)]
    if len(ages) < LEAST_ROWS:
        return None
    lowest = max(slowest, 2 * math.pi * LEAST_CYCLES / (1 - since.min()))
    return Whole(ages, values, Band.of(ages, lowest)) if lowest <= HIGHEST_LOWEST else None


def carried(last: Fit, whole: Whole, *, checks: bool) -> Fit | None:
    """Return the last fit some rows later; with or without slopes, or with one more pole, if that is better.

    None if none explains the rows.
    """
    ages, values, band = whole
    best = fit(ages, values, last.following.within(band), band, slopes=last.slopes)
    if explains(best, band) and not checks:
        return best
    if last.jitter and (jittery := with_jitter(best._replace(jitter=last.jitter), whole)):
        return jittery
    alternative = fit(ages, values, best.following, band, slopes=not last.slopes)
    if explains(alternative, band) and (not explains(best, band) or worth(alternative) < worth(best)):
        best = alternative
    if not explains(best, band) and len(last.poles.decay) < MOST_POLES:
        best = refine(ages, values, seek(best, ages, values, band), band, slopes=last.slopes, steps=STEPS)
    return best if explains(best, band) else with_jitter(best, whole)


def sought(whole: Whole) -> Fit | None:
    """Return the best fit of all kinds; None if none explains the rows."""
    ages, values, band = whole
    best = fit(ages, values, Poles.none(), band, slopes=False)
    sloping = fit(ages, values, Poles.none(), band, slopes=True)
    for _ in range(MOST_POLES):
        few = values.size < best.parameters + 2 + 3 * values.shape[1]
        if few or explains(best, band) or explains(sloping, band):
            break
        best = refine(ages, values, seek(best, ages, values, band), band, slopes=False, steps=STEPS)
        if not explains(best, band):
            sloping = refine(ages, values, best.following, band, slopes=True, steps=1)
        if not explains(best, band) and not explains(sloping, band) and (jittery := with_jitter(best, whole)):
            return jittery
    return next((candidate for candidate in (best, sloping) if explains(candidate, band)), None)


def with_jitter(of: Fit, whole: Whole) -> Fit | None:
    """Return the fit to rows whose stamps are not exact; None if that does not explain them either.

    One channel alone does not tell what is late from what is elsewhere. What the last step promises is not enough: a
    load that comes softly would be taken for a swing whose decay was clipped.
    """
    ages, values, band = whole
    if not len(of.poles.decay) or values.shape[1] < 2:
        return None
    most = min(JITTER, JITTER_ANGLE / of.frequency)
    best, residual_square = refit(of, ages, values, band, most)
    leaves_noise = residual_square < chi_square_quantile(max(best.freedom, 1), FALSE)
    return best if leaves_noise and explains(best, band) else None


def explains(of: Fit, band: Band) -> bool:
    """Return whether a fit leaves no more than noise, and none of its swings may be a load."""
    if band.seem_still(of.following.frequency).any():
        return False
    enough = len(of.constant) if len(of.coefficients) > 1 else 1
    return of.freedom >= enough and of.promised < chi_square_quantile(of.freedom, FALSE)


def worth(of: Fit) -> float:
    """Return Akaike's criterion."""
    return of.promised + 2 * of.parameters
