"""The fit of a surface's departures to unlabelled contacts: mean deflections under loads of unknown place and force.

An unlabelled contact is a load whose place and force are those of the fit, with errors as wide as their ranges. About
them, its deflections are linear in the departures. The residual of its deflections at the best place and force shows
the departures (variable projection: Golub & Pereyra 1973, doi 10.1137/0710036). Three things are estimated together
with the departures, by expectation and maximisation:

- the size of the departures, in units of plausible ones, so that few contacts change little;
- the relative error that no departure explains;
- for each contact, the probability that it is a single contact. Two contacts at once leave residuals of any size.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from scipy.optimize import brentq, lsq_linear

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.calibration.contacts import UnlabelledContacts
from beamtouch_models.calibration.fit import bounds_of, free_of
from beamtouch_models.calibration.loads import Deflections, Loads, RecordingErrors
from beamtouch_models.calibration.theory import GAIN, OFFSET_NOISES, Theory
from beamtouch_models.health.curve import InfluenceCurve

MISFITS = (4.0, 16.0, 64.0, 256.0)
"""Residuals of several contacts at once, in units of the errors; each is as probable as the others."""
SHARES = (0.01, 0.5)
"""Bounds of the share of samples that are not a single contact."""


def single_contact(misfit: Floats, degrees: int, share: float) -> Floats:
    """Return the probability that each contact is a single one, by its misfit; `share` are not."""
    log_other = np.logaddexp.reduce([-misfit / 2 / scale**2 - degrees * np.log(scale) for scale in MISFITS], axis=0)
    odds = np.log(share / (1 - share) / len(MISFITS)) + log_other + misfit / 2
    single: Floats = 1 / (1 + np.exp(np.minimum(odds, 700.0)))
    return single


GRID = 401
"""Number of positions over the range at which contacts are searched for."""
MAX_FORCE_RATIO = 100.0
"""Largest force of a contact, over the largest of its scene. At a support, the best force may be any."""


def places(theory: Theory, vector: Floats, measured_mm: Floats, deviation_mm: Floats) -> tuple[Floats, Floats]:
    """Return the positions in mm and forces in N (contacts,) that explain measured deflections best.

    Deflections and their standard deviations are (contacts, channels). A force that would have to pull
    or to be beyond MAX_FORCE_RATIO is 0: this is no contact.
    """
    departures = theory.departures(vector)
    prior = theory.prior_with(departures)
    grid = np.linspace(*prior.position_mm, GRID)
    curve = InfluenceCurve(grid, prior.influence_at(grid), departures)
    known_n = prior.force_n[0] if prior.force_is_known else None
    linear_mm = departures.linear_mm(measured_mm)
    position, force = curve.best_contacts(linear_mm, deviation_mm**-2, known_n)
    return position, np.where((force > 0) & (force <= MAX_FORCE_RATIO * prior.force_n[1]), force, 0.0)


ANY_FORCE = 3.0
"""Error of the force of a contact, relative to the force of the fit: as good as unknown."""


@dataclass(frozen=True)
class Linear:
    """Contacts at their best places and forces under a vector of departures."""

    loads: Loads
    moved: Deflections
    left_mm: Floats
    """(contacts, channels) measured minus predicted."""

    def covariance_mm2(self, theory: Theory, left_error: float) -> Floats:
        """Return the covariance (contacts, channels, channels) of `left_mm`, if place and force are unknown."""
        noise = np.hypot(self.loads.deviation_mm, left_error * self.loads.measured_mm)
        low, high = theory.prior.position_mm
        force = 0.0 if theory.prior.force_is_known else ANY_FORCE
        errors = RecordingErrors(placing_mm=high - low, force=force)
        return replace(self.moved, noise_mm=noise).covariance_mm2(errors)

    def whitening(self, theory: Theory, left_error: float) -> Floats:
        """Return W (contacts, channels, channels) with W'W the inverse of that covariance."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance_mm2(theory, left_error)))

    def misfit(
        self, theory: Theory, left_error: float, left_mm: Floats | None = None, more_mm2: Floats | float = 0.0
    ) -> Floats:
        """Return the misfits (contacts,) of `left_mm`, or of other residuals, under that covariance and `more_mm2`."""
        left_mm = self.left_mm if left_mm is None else left_mm
        total = self.covariance_mm2(theory, left_error) + more_mm2
        misfit: Floats = np.einsum("lc,lc->l", left_mm, np.linalg.solve(total, left_mm[..., None])[..., 0])
        return misfit


def linear(theory: Theory, vector: Floats, contacts: UnlabelledContacts, zero_mm: Floats, left_error: float) -> Linear:
    """Locate contacts on a surface with departures; `zero_mm` (channels,) is the deviation of the zeros."""
    deviation = np.hypot(contacts.deviation_mm, zero_mm)
    position, force = places(
        theory, vector, contacts.measured_mm, np.hypot(deviation, left_error * contacts.measured_mm)
    )
    count = np.arange(len(contacts))
    lines = np.zeros((len(contacts), 2), np.intp)
    loads = Loads(count, position, force, contacts.measured_mm, deviation, lines)
    left = contacts.measured_mm - theory.measured_mm(vector, loads)
    return Linear(loads, theory.deflections(vector, loads), left)


def degrees_of(theory: Theory) -> int:
    """Return the degrees of freedom of the residual of a contact: channels beyond its place and, if open, its force."""
    return theory.prior.channels - (1 if theory.prior.force_is_known else 2)


MAX_STEP = 2.0
"""Bound of a step of a departure, in units of plausible ones: far off, the slopes are those of another surface."""


@dataclass(frozen=True)
class Normal:
    """Normal equations of the departures."""

    precision: Floats
    pull: Floats

    @classmethod
    def of(cls, slopes: Floats, left: Floats) -> Self:
        """Equations of whitened slopes (contacts, channels, departures) and residuals (contacts, channels)."""
        return cls(np.einsum("lcv,lcw->vw", slopes, slopes), np.einsum("lcv,lc->v", slopes, left))

    def with_prior(self, moved: Floats, deviation: Floats) -> Self:
        """Add the prior of departures that are now `moved` away from its middle."""
        return replace(self, precision=self.precision + np.diag(deviation**-2), pull=self.pull - moved / deviation**2)

    def step(self, low: Floats, high: Floats) -> Floats:
        """Return the best step between bounds."""
        root = np.linalg.cholesky(self.precision)
        bounds = np.clip(low, -MAX_STEP, -1e-9), np.clip(high, 1e-9, MAX_STEP)
        found: Floats = lsq_linear(root.T, np.linalg.solve(root, self.pull), bounds, method="bvls").x
        return found


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
