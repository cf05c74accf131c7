"""The search for loads of a recording that contradict the others.

A wrong load, whose position or force was mistyped, pulls the fit towards itself, so residuals do not show which load is
wrong. Each load is therefore tested against a fit without it, with its externally studentized residual (Cook &
Weisberg, Residuals and Influence in Regression, 1982, sec. 2.2). Two wrong loads can hide each other, so pairs are left
out as well if the rest disagrees.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.stats import f as f_distribution

from beamtouch_models.arrays import Floats
from beamtouch_models.design.calibration.fit import ROUNDS, Fit, fit
from beamtouch_models.design.calibration.nominal_surface import NominalSurface
from beamtouch_models.design.calibration.recordings import Loads
from beamtouch_models.design.calibration.session import COMMON, Session
from beamtouch_models.design.sweeps import Fraction, silent

CHANCE = 1e-4
"""Probability that any load of a correct recording is called mistaken."""
FAR_NOISES = 8.0
"""Distance to the prediction of the others, in noises of a sample, below which a load does no harm."""
AGREED = 2.0
"""Scatter of the rest, in units of the stated errors, below which loads agree, so that no pair is searched for."""
LIKE_THE_BEST = 2.0
"""A load may be the mistaken one if the rest scatters at most this many times the smallest scatter without it."""
PAIRED = 3
"""Number of loads that are tried in pairs with every other: those that leave the smallest scatter alone."""
MIN_FOR_PAIRS = 5
"""Largest number of loads for which no pairs are left out, since too few would remain."""


@dataclass(frozen=True)
class MistakenLoad:
    """A load that contradicts the others."""

    index: int
    """Index among the loads."""
    place_mm: Floats
    """(axes,)"""
    force_n: float
    """Place and force of the load by a fit to the others."""
    certain: bool
    """True if no other load can be the mistaken one instead."""


def mistaken(nominal: NominalSurface, loads: Loads, progress: Fraction = silent) -> tuple[MistakenLoad, ...]:
    """Find loads that contradict the others.

    Returns
    -------
    none where all agree; one or two that are mistaken; or, where the loads are too few to tell, every load that may be
    the mistaken one.
    """
    count = len(loads.number)
    singles = _rank(nominal, loads, [(index,) for index in range(count)], progress)
    least, first = singles[0]
    best = _fit_without(nominal, loads, first)
    if best.scatter > AGREED and count > MIN_FOR_PAIRS:
        likely = {index for _, single in singles[:PAIRED] for index in single}
        pairs = [pair for pair in combinations(range(count), 2) if not likely.isdisjoint(pair)]
        _, pair = _rank(nominal, loads, pairs, progress)[0]
        without = _fit_without(nominal, loads, pair)
        if all(_contradicts(without, loads, index) for index in pair):
            return tuple(_mistaken_load(without, loads, index, certain=True) for index in pair)
    if not _contradicts(best, loads, *first):
        return ()
    alike = {first[0]: best}
    for scatter, (index,) in singles[1:]:
        if scatter <= LIKE_THE_BEST * least:
            without = _fit_without(nominal, loads, (index,))
            if _contradicts(without, loads, index):
                alike[index] = without
    return tuple(_mistaken_load(without, loads, index, certain=len(alike) == 1) for index, without in alike.items())


def _rank(
    nominal: NominalSurface, loads: Loads, groups: Sequence[tuple[int, ...]], progress: Fraction
) -> list[tuple[float, tuple[int, ...]]]:
    """Return the scatter of a quick fit without each group of loads, and the group; the smallest scatter first."""
    scatters = []
    for number, group in enumerate(groups):
        progress(number / len(groups))
        scatters.append(_fit_without(nominal, loads, group, rounds=1).scatter)
    return sorted(zip(scatters, groups, strict=True), key=lambda ranked: ranked[0])


def _fit_without(nominal: NominalSurface, loads: Loads, left_out: tuple[int, ...], rounds: int = ROUNDS) -> Fit:
    # Start from the scene, not from a fit that included the load. What all loads share makes none of them wrong.
    return fit(nominal, loads.without(*left_out), (*Session(nominal, loads).usual_kinds, *COMMON), rounds=rounds)


def _contradicts(fitted: Fit, loads: Loads, index: int) -> bool:
    """Return whether a load contradicts a fit to others, beyond chance and by enough to matter."""
    nominal, load = fitted.nominal, loads[[index]]
    session = Session(nominal, load)
    residuals = session.residuals(fitted.vector)
    count = int(residuals.is_measured.sum())
    if not np.sqrt((residuals.left_mm**2).sum() / count) >= FAR_NOISES * nominal.prior.errors.noise_mm:
        return False
    slopes = session.slopes(fitted.vector, fitted.kinds)
    # An honest load may be off by as much as is stated, even if the others are better.
    errors = fitted.errors.at_least(loads.errors)
    misfit = residuals.misfit(errors, slopes, fitted.covariance)
    chance = f_distribution.sf(float(misfit[0]) / count, count, fitted.freedom)
    return bool(chance < CHANCE / len(loads.number))


def _mistaken_load(fitted: Fit, loads: Loads, index: int, *, certain: bool) -> MistakenLoad:
    """Return where the load pressed and how hard, by least squares over the range of positions."""
    curve, measured = fitted.nominal.curve(fitted.vector), loads.measured_mm[[index]]
    linear = np.nan_to_num(fitted.departures.linear_mm(measured))
    place, force = curve.best_contacts(linear, np.isfinite(measured).astype(np.float64))
    return MistakenLoad(index, place[0], max(float(force[0]), 0.0), certain)
