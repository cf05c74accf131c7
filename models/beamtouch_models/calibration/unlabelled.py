"""The fit of a surface's departures to unlabelled contacts: mean deflections under loads of unknown place and force.

An unlabelled contact is a load whose place and force are those of the fit, with errors as wide as their ranges; what is
left of its deflections after the best place and force tells of the surface (variable projection: Golub & Pereyra 1973,
doi 10.1137/0710036). Three things are estimated together with the departures, by expectation and maximisation:

- the size of the departures, in units of plausible ones, so that few contacts change little;
- the relative error that no departure explains;
- for each contact, the probability that it is a single contact. Two contacts at once leave residuals of any size.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.calibration.contacts import Contacts
from beamtouch_models.calibration.errors import Deflections, Errors
from beamtouch_models.calibration.fit import bounds_of
from beamtouch_models.calibration.loads import Loads
from beamtouch_models.calibration.normal import Normal
from beamtouch_models.calibration.places import places
from beamtouch_models.calibration.theory import GAIN, OFFSET_NOISES, Theory

ROUNDS = 12
"""Number of rounds of a fit; after eight, nothing changes by a tenth of its error."""
SMALLEST_SIZE, LARGEST_SIZE = 0.02, 1.5
"""Bounds of the size of the departures, in units of plausible ones."""
MISFITS = (4.0, 16.0, 64.0, 256.0)
"""Residuals of what is not a single contact, in units of the errors; each is as probable as the others."""
SHARES = (0.01, 0.5)
"""Bounds of the share of what is not a single contact."""
ANY_FORCE = 3.0
"""Error of the force of a contact, relative to the force of the fit: as good as unknown."""


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
    unexplained: float
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
        """What the fit makes as small as possible: misfit of the single contacts, and size of the departures."""
        return float(self.single @ self.misfit) + self.penalty


@dataclass(frozen=True)
class Linear:
    """Contacts at their best places and forces under a vector of departures."""

    loads: Loads
    moved: Deflections
    left_mm: Floats
    """(contacts, channels) measured minus predicted."""

    def covariance_mm2(self, theory: Theory, unexplained: float) -> Floats:
        """Return the covariance (contacts, channels, channels) of `left_mm`, if place and force are unknown."""
        noise = np.hypot(self.loads.deviation_mm, unexplained * self.loads.stated_mm)
        low, high = theory.prior.position_mm
        force = 0.0 if theory.prior.force_is_known else ANY_FORCE
        errors = Errors(placing_mm=high - low, force=force)
        return replace(self.moved, noise_mm=noise).covariance_mm2(errors)

    def whitening(self, theory: Theory, unexplained: float) -> Floats:
        """Return W (contacts, channels, channels) with W'W the inverse of that covariance."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance_mm2(theory, unexplained)))


def linear(theory: Theory, vector: Floats, contacts: Contacts, zero_mm: Floats, unexplained: float) -> Linear:
    """Locate contacts on a surface with departures; `zero_mm` (channels,) is the deviation of the zeros."""
    deviation = np.hypot(contacts.deviation_mm, zero_mm)
    position, force = places(theory, vector, contacts.stated_mm, np.hypot(deviation, unexplained * contacts.stated_mm))
    count = np.arange(len(contacts))
    lines = np.zeros((len(contacts), 2), np.intp)
    loads = Loads(count, position, force, contacts.stated_mm, deviation, lines)
    left = contacts.stated_mm - theory.stated_mm(vector, loads)
    return Linear(loads, theory.deflections(vector, loads), left)


def free_of(theory: Theory, kinds: tuple[str, ...]) -> Indices:
    """Return the places of some kinds in the vector of all departures."""
    places = np.arange(theory.size)
    return np.concatenate([places[:0], *(places[theory.kinds[kind]] for kind in kinds)])


def fit_contacts(
    theory: Theory,
    start: Floats,
    contacts: Contacts,
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
    free, degrees = free_of(theory, kinds), degrees_of(theory)
    vector = start if like is None else like.vector
    size, unexplained, share = (1.0, GAIN, SHARES[0]) if like is None else (like.size, like.unexplained, 0.1)
    for _ in range(rounds):
        at = linear(theory, vector, contacts, zero_mm, unexplained)
        whitening = at.whitening(theory, unexplained)
        misfit = (np.einsum("lcd,ld->lc", whitening, at.left_mm) ** 2).sum(axis=1)
        single = _single(misfit, degrees, share) * (at.loads.force_n > 0)
        share = float(np.clip(1 - single.mean(), *SHARES))
        slopes = theory.slopes(vector, at.loads, kinds)[..., free]
        about = _prior_deviation(theory, kinds, size, zero_mm)
        weighed = np.sqrt(single)[:, None, None] * whitening
        normal = Normal.of(weighed @ slopes, np.einsum("lcd,ld->lc", weighed, at.left_mm))
        normal = normal.with_prior((vector - start)[free], about)
        step = normal.step(*(bound - vector[free] for bound in bounds_of(theory, free)))
        covariance = np.linalg.inv(normal.precision)
        vector = vector.copy()
        vector[free] += step
        used = len(free) - float((np.diag(covariance) / about**2).sum())
        left = at.left_mm - slopes @ step
        unexplained = _unexplained(theory, at, left, single, degrees - used / max(single.sum(), 1.0))
        moved = (vector - start)[free]
        sized = _sized(theory, kinds)
        size = float(np.sqrt(((moved**2 + np.diag(covariance))[sized]).mean()))
        size = float(np.clip(size, SMALLEST_SIZE, LARGEST_SIZE))
    at = linear(theory, vector, contacts, zero_mm, unexplained)
    misfit = (np.einsum("lcd,ld->lc", at.whitening(theory, unexplained), at.left_mm) ** 2).sum(axis=1)
    whole = np.zeros((theory.size, theory.size))
    whole[np.ix_(free, free)] = covariance
    penalty = float((((vector - start)[free] / about) ** 2).sum())
    return ContactFit(
        theory, kinds, start, vector, whole, size, unexplained, at.loads.position_mm, single, misfit, penalty
    )


def degrees_of(theory: Theory) -> int:
    """Return the degrees of freedom of the residual of a contact: channels beyond its place and, if open, its force."""
    return theory.prior.channels - (1 if theory.prior.force_is_known else 2)


def _single(misfit: Floats, degrees: int, share: float) -> Floats:
    """Return the probability that each contact is a single one, by its misfit; `share` are not."""
    log_other = np.logaddexp.reduce([-misfit / 2 / scale**2 - degrees * np.log(scale) for scale in MISFITS], axis=0)
    odds = np.log(share / (1 - share) / len(MISFITS)) + log_other + misfit / 2
    single: Floats = 1 / (1 + np.exp(np.minimum(odds, 700.0)))
    return single


def _sized(theory: Theory, kinds: tuple[str, ...]) -> Bools:
    """Return which of the fitted departures share a size: all but the offsets, whose size is that of the zeros."""
    offsets = np.arange(theory.size)[theory.kinds["offset"]]
    return ~np.isin(free_of(theory, kinds), offsets)


def _prior_deviation(theory: Theory, kinds: tuple[str, ...], size: float, zero_mm: Floats) -> Floats:
    """Return the standard deviations of the fitted departures about the given model."""
    about = np.full(theory.size, size)
    about[theory.kinds["offset"]] = zero_mm / (OFFSET_NOISES * theory.prior.noise_mm)
    fitted: Floats = about[free_of(theory, kinds)]
    return np.maximum(fitted, SMALLEST_SIZE**2)


def _unexplained(theory: Theory, at: Linear, left_mm: Floats, single: Floats, degrees: float) -> float:
    """Return the relative error that makes the misfit of the single contacts equal to their degrees of freedom."""
    if single.sum() <= 0 or degrees <= 0:
        return 0.0

    def beyond(unexplained: float) -> float:
        misfit = (np.einsum("lcd,ld->lc", at.whitening(theory, unexplained), left_mm) ** 2).sum(axis=1)
        return float(single @ misfit / single.sum()) - degrees

    if beyond(0.0) <= 0:
        return 0.0
    return float(brentq(beyond, 0.0, 1.0, xtol=1e-5)) if beyond(1.0) < 0 else 1.0
