"""The fit of a surface's departures to unlabelled contacts: mean deflections under loads of unknown place and force.

An unlabelled contact is a load whose place and force are those of the fit, with errors as wide as their ranges. The
residual of its deflections at the best place and force shows the departures (variable projection: Golub & Pereyra 1973,
doi 10.1137/0710036). Three things are estimated together with the departures, by expectation and maximisation:

- the size of the departures, in units of plausible ones, so that few contacts change little;
- the relative error that no departure explains;
- for each contact, the probability that it is a single contact. Two contacts at once leave residuals of any size.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.calibration.contacts import UnlabelledContacts
from beamtouch_models.calibration.fit import bounds_of
from beamtouch_models.calibration.linear import Linear, degrees_of, linear
from beamtouch_models.calibration.normal import Normal
from beamtouch_models.calibration.single import SHARES, single_contact
from beamtouch_models.calibration.theory import GAIN, OFFSET_NOISES, Theory

ROUNDS = 12
"""Number of rounds of a fit; after eight, nothing changes by a tenth of its error."""
MIN_SIZE, MAX_SIZE = 0.02, 1.5
"""Bounds of the size of the departures, in units of plausible ones."""


@dataclass(frozen=True)
class ContactFit:
    """A fit to unlabelled contacts."""

    theory: Theory
    kinds: tuple[str, ...]
    start: Floats
    """The vector of the given model's departures."""
    vector: Floats
    covariance: Floats
    """(departures, departures) covariance of the vector, in its units; 0 if not fitted."""
    size: float
    """Standard deviation of the departures about the start, in units of plausible ones."""
    left_error: float
    """Relative error of the deflections beyond noise, zeros and the departures."""
    position_mm: Floats
    """(contacts,) where the fit places them."""
    single: Floats
    """(contacts,) probability that it is a single contact."""
    misfit: Floats
    """(contacts,) sum of squares of the residual, in units of the errors."""
    penalty: float
    """Sum of squares of the departures about the start, in units of their size."""

    @property
    def spread(self) -> Floats:
        """(departures,) standard errors, in the units of the vector; 0 if not fitted."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def cost(self) -> float:
        """The quantity that the fit minimises: misfit of the single contacts, and size of the departures."""
        return float(self.single @ self.misfit) + self.penalty


def free_of(theory: Theory, kinds: tuple[str, ...]) -> Indices:
    """Return the places of some kinds in the vector of all departures."""
    places = np.arange(theory.size)
    return np.concatenate([places[:0], *(places[theory.kinds[kind]] for kind in kinds)])


def fit_contacts(
    theory: Theory,
    start: Floats,
    contacts: UnlabelledContacts,
    kinds: tuple[str, ...],
    zero_mm: Floats,
    *,
    like: ContactFit | None = None,
    rounds: int = ROUNDS,
) -> ContactFit:
    """Fit some kinds of departures to contacts, about those of the given model.

    Parameters
    ----------
    start : the vector of the given model
    zero_mm : (channels,) standard deviation of the zeros
    like : a fit to begin with
    """
    problem = _ContactProblem(theory, start, contacts, kinds, zero_mm)
    found = problem.improved(
        _Estimate(start) if like is None else _Estimate(like.vector, like.size, like.left_error, 0.1)
    )
    for _ in range(rounds - 1):
        found = problem.improved(found)
    at = linear(theory, found.vector, contacts, zero_mm, found.left_error)
    whole = np.zeros((theory.size, theory.size))
    whole[np.ix_(problem.free, problem.free)] = found.covariance
    return ContactFit(
        theory,
        kinds,
        start,
        found.vector,
        whole,
        found.size,
        found.left_error,
        at.loads.position_mm,
        found.single,
        at.misfit(theory, found.left_error),
        float((((found.vector - start)[problem.free] / found.about) ** 2).sum()),
    )


class _Estimate(NamedTuple):
    """An intermediate result of a fit."""

    vector: Floats
    size: float = 1.0
    left_error: float = GAIN
    share: float = SHARES[0]
    """Share of samples that are not a single contact."""
    single: Floats = np.empty(0)
    """(contacts,) probability that it is a single contact."""
    covariance: Floats = np.empty((0, 0))
    """Covariance of the fitted departures."""
    about: Floats = np.empty(0)
    """Standard deviations of the fitted departures about the given model."""


@dataclass(frozen=True)
class _ContactProblem:
    """The departures to find, and the contacts that determine them."""

    theory: Theory
    start: Floats
    contacts: UnlabelledContacts
    kinds: tuple[str, ...]
    zero_mm: Floats

    @cached_property
    def free(self) -> Indices:
        """Places of the fitted departures in the vector of all."""
        return free_of(self.theory, self.kinds)

    def improved(self, found: _Estimate) -> _Estimate:
        """Return the estimate after another round."""
        theory, free, degrees = self.theory, self.free, degrees_of(self.theory)
        at = linear(theory, found.vector, self.contacts, self.zero_mm, found.left_error)
        single = single_contact(at.misfit(theory, found.left_error), degrees, found.share) * (at.loads.force_n > 0)
        slopes = theory.slopes(found.vector, at.loads, self.kinds)[..., free]
        about = _prior_deviation(theory, self.kinds, found.size, self.zero_mm)
        weighed = np.sqrt(single)[:, None, None] * at.whitening(theory, found.left_error)
        normal = Normal.of(weighed @ slopes, np.einsum("lcd,ld->lc", weighed, at.left_mm))
        normal = normal.with_prior((found.vector - self.start)[free], about)
        step = normal.step(*(bound - found.vector[free] for bound in bounds_of(theory, free)))
        covariance = np.asarray(np.linalg.inv(normal.precision), np.float64)
        vector = found.vector.copy()
        vector[free] += step
        used = len(free) - float((np.diag(covariance) / about**2).sum())
        left = at.left_mm - slopes @ step
        left_error = _left_error(theory, at, left, single, degrees - used / max(single.sum(), 1.0))
        sized = _sized(theory, self.kinds)
        size = float(np.sqrt((((vector - self.start)[free] ** 2 + np.diag(covariance))[sized]).mean()))
        size = float(np.clip(size, MIN_SIZE, MAX_SIZE))
        share = float(np.clip(1 - single.mean(), *SHARES))
        return _Estimate(vector, size, left_error, share, single, covariance, about)


def _sized(theory: Theory, kinds: tuple[str, ...]) -> Bools:
    """Return which of the fitted departures share a size: all but the offsets, whose size is that of the zeros."""
    offsets = np.arange(theory.size)[theory.kinds["offset"]]
    return ~np.isin(free_of(theory, kinds), offsets)


def _prior_deviation(theory: Theory, kinds: tuple[str, ...], size: float, zero_mm: Floats) -> Floats:
    """Return the standard deviations of the fitted departures about the given model."""
    about = np.full(theory.size, size)
    about[theory.kinds["offset"]] = zero_mm / (OFFSET_NOISES * theory.prior.noise_mm)
    fitted: Floats = about[free_of(theory, kinds)]
    return np.maximum(fitted, MIN_SIZE**2)


def _left_error(theory: Theory, at: Linear, left_mm: Floats, single: Floats, degrees: float) -> float:
    """Return the relative error that makes the misfit of the single contacts equal to their degrees of freedom."""
    if single.sum() <= 0 or degrees <= 0:
        return 0.0

    def beyond(left_error: float) -> float:
        return float(single @ at.misfit(theory, left_error, left_mm) / single.sum()) - degrees

    if beyond(0.0) <= 0:
        return 0.0
    return float(brentq(beyond, 0.0, 1.0, xtol=1e-5)) if beyond(1.0) < 0 else 1.0
