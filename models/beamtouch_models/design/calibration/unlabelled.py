"""The fit of a surface's departures to unlabelled contacts: mean deflections under loads of unknown place and force.

The residual of a contact's deflections at its best place and force shows the departures (`health.residuals`). Three
things are estimated together with the departures, by expectation and maximisation:

- the size of the departures, in units of plausible ones, so that few contacts change little;
- the relative error that no departure explains;
- for each contact, the probability that it is a single contact. Two contacts at once leave residuals of any size.

What the fit leaves open is stated as errors of the position. The errors of a fit are correlated across channels, and
the largest of them lie along the influence curve, where residuals do not see them. The floor of a model is independent
per channel. So it is scaled until it states the position error.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from beamtouch_models.arrays import Floats
from beamtouch_models.design.calibration.nominal_surface import GAIN, OFFSET_NOISES, Fitted, NominalSurface, best_step
from beamtouch_models.design.calibration.recordings import UnlabelledContacts
from beamtouch_models.places import Extent, positions_of
from beamtouch_models.runtime.health.residuals import Residuals

MISFITS = (4.0, 16.0, 64.0, 256.0)
"""Residuals of several contacts at once, in units of the errors; each is as probable as the others."""
SHARES = (0.01, 0.5)
"""Bounds of the share of samples that are not a single contact."""
MAX_FORCE_RATIO = 100.0
"""Largest force of a contact, over the largest of its scene. At a support, the best force may be any."""
ROUNDS = 12
"""Number of rounds of a fit; after eight, nothing changes by a tenth of its error."""
MIN_SIZE, MAX_SIZE = 0.02, 1.5
"""Bounds of the size of the departures, in units of plausible ones."""


def single_contact(misfit: Floats, degrees: int, share: float) -> Floats:
    """Return the probability that each contact is a single one, by its misfit; `share` are not."""
    log_other = np.logaddexp.reduce([-misfit / 2 / scale**2 - degrees * np.log(scale) for scale in MISFITS], axis=0)
    odds = np.log(share / (1 - share) / len(MISFITS)) + log_other + misfit / 2
    single: Floats = 1 / (1 + np.exp(np.minimum(odds, 700.0)))
    return single


@dataclass(frozen=True)
class Located:
    """Contacts at the places and forces that explain them best on a surface with departures."""

    place_mm: Floats
    """(contacts, axes)"""
    force_n: Floats
    """0 if it would have to pull, or to be beyond MAX_FORCE_RATIO: this is no contact."""
    residuals: Residuals


def locate(
    nominal: NominalSurface, vector: Floats, contacts: UnlabelledContacts, zero_mm: Floats, left_error: float = 0.0
) -> Located:
    """Locate contacts on a surface with departures.

    Parameters
    ----------
    theory, vector : the surface and its departures
    contacts : the deflections
    zero_mm : (channels,) standard deviation of the zeros
    left_error : relative error of the deflections beyond noise and zeros
    """
    curve, prior, noise_mm = nominal.curve(vector), nominal.prior, contacts.noise_mm(zero_mm, left_error)
    stated = prior.force_range
    linear_mm = curve.departures.linear_mm(contacts.measured_mm)
    place, force = curve.best_contacts(linear_mm, noise_mm**-2, stated)
    force = np.where((force > 0) & (force <= MAX_FORCE_RATIO * prior.force_n[1]), force, 0.0)
    if not stated.is_open:
        # Whatever a sample says of it: that it differs from the stated force is part of the residual.
        force = np.where(force > 0, stated.middle_n, 0.0)
    return Located(place, force, Residuals.of(curve, place, force, contacts.measured_mm, noise_mm))


@dataclass(frozen=True)
class ContactFit(Fitted):
    """A fit to unlabelled contacts."""

    start: Floats
    """The vector of the given model's departures."""
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
    def cost(self) -> float:
        """The quantity that the fit minimises: misfit of the single contacts, and size of the departures."""
        return float(self.single @ self.misfit) + self.penalty


def fit_contacts(
    nominal: NominalSurface,
    start: Floats,
    contacts: UnlabelledContacts,
    kinds: tuple[str, ...],
    zero_mm: Floats,
    *,
    like: ContactFit | None = None,
) -> ContactFit:
    """Fit some kinds of departures to contacts, about those of the given model.

    Parameters
    ----------
    start : the vector of the given model
    zero_mm : (channels,) standard deviation of the zeros
    like : a fit to begin with
    """
    free, degrees, errors = nominal.free_of(kinds), nominal.degrees, nominal.contact_errors
    bounds = nominal.bounds_of(free)
    # The offsets have the size of the zeros; all others share one.
    offsets = np.arange(nominal.size)[nominal.kinds["offset"]]
    sized = ~np.isin(free, offsets)
    zeros = np.zeros(nominal.size)
    zeros[offsets] = zero_mm / (OFFSET_NOISES * nominal.prior.errors.noise_mm)
    vector, size, left_error, share = start, 1.0, GAIN, SHARES[0]
    if like is not None:
        vector, size, left_error, share = like.vector, like.size, like.left_error, 0.1
    for _ in range(ROUNDS):
        located = locate(nominal, vector, contacts, zero_mm, left_error)
        single = single_contact(located.residuals.misfit(errors), degrees, share) * (located.force_n > 0)
        slopes = nominal.slopes(vector, located.place_mm, located.force_n, kinds)[..., free]
        about = np.maximum(np.where(sized, size, zeros[free]), MIN_SIZE**2)
        whitening = np.sqrt(single)[:, None, None] * located.residuals.whitening(errors)
        weighed, whitened = whitening @ slopes, np.einsum("lij,lj->li", whitening, located.residuals.left_mm)
        room = bounds[0] - vector[free], bounds[1] - vector[free]
        step, covariance = best_step(weighed, whitened, (vector - start)[free], about, room)
        vector = vector.copy()
        vector[free] += step
        used = len(free) - float((np.diag(covariance) / about**2).sum())
        moved = replace(located.residuals, left_mm=located.residuals.left_mm - slopes @ step)
        per_contact = degrees - used / max(single.sum(), 1.0)
        left_error = _left_error(nominal, contacts, zero_mm, moved, single, per_contact)
        squares = ((vector - start)[free] ** 2 + np.diag(covariance))[sized]
        size = float(np.clip(np.sqrt(squares.mean()), MIN_SIZE, MAX_SIZE))
        share = float(np.clip(1 - single.mean(), *SHARES))
    located = locate(nominal, vector, contacts, zero_mm, left_error)
    full_covariance = nominal.covariance_of(kinds, covariance)
    penalty = float((((vector - start)[free] / about) ** 2).sum())
    misfit = located.residuals.misfit(errors)
    position = positions_of(located.place_mm)
    return ContactFit(
        nominal, kinds, vector, full_covariance, start, size, left_error, position, single, misfit, penalty
    )


def _left_error(
    nominal: NominalSurface,
    contacts: UnlabelledContacts,
    zero_mm: Floats,
    at: Residuals,
    single: Floats,
    degrees: float,
) -> float:
    """Return the relative error that makes the misfit of the single contacts equal to their degrees of freedom."""
    if single.sum() <= 0 or degrees <= 0:
        return 0.0

    def beyond(left_error: float) -> float:
        misfit = replace(at, noise_mm=contacts.noise_mm(zero_mm, left_error)).misfit(nominal.contact_errors)
        return float(single @ misfit / single.sum()) - degrees

    if beyond(0.0) <= 0:
        return 0.0
    return float(brentq(beyond, 0.0, 1.0, xtol=1e-5)) if beyond(1.0) < 0 else 1.0


PLACES = 61
"""Number of contacts over the range at which errors are computed."""
INNER = 0.05
"""Share of the range at each end that is left out: next to a support, a contact has no position error worth stating."""
ENOUGH = 0.75
"""Share of these contacts at which the floor states at least the position error that the fit leaves."""
TINY = float(np.finfo(np.float64).tiny)
UNTOLD = 1e-9
"""Part of the information on a place that does not depend on the force, below which rounding is all that is left."""
MIN_GAIN = 5e-4
"""Smallest floor of a gain: sensors and amplifiers are not steadier than that."""


@dataclass(frozen=True)
class RemainingUncertainty:
    """Errors of the estimates of a fitted model, at contacts over the range with a force from its middle."""

    position_mm: Floats
    """Standard deviation (places,) of the place, from the departures."""
    shift_mm: float
    """Root mean square of the change of positions from the given model to the fitted one."""
    per_gain_mm: Floats
    """(places, axes, channels) change of the place with the gain of each channel."""
    relative: Floats
    """(departures, departures) covariance, without the common scale of the gains if it looks like force."""
    floor: Floats
    """Gain errors (channels,) that state what the fit leaves open."""
    force_error: float
    """Relative error of all forces together: how much the departures that the fit leaves open look like force."""


def stated_mm(per_gain_mm: Floats, gain: Floats) -> Floats:
    """Return the standard deviation (places,) of the place that a floor of the gains (channels,) states."""
    deviation_mm: Floats = np.linalg.norm(per_gain_mm * gain, axis=(1, 2))
    return deviation_mm


def measure_remaining(
    nominal: NominalSurface,
    vector: Floats,
    covariance: Floats,
    noise_mm: Floats,
    *,
    start: Floats | None = None,
    left_error: float = 0.0,
    is_scale_open: bool = False,
) -> RemainingUncertainty:
    """Return what a fit of a surface leaves open, by unlabelled contacts or by loads.

    Parameters
    ----------
    vector, covariance : (departures,) as fitted, and (departures, departures), in its units
    noise_mm : (channels,) noise of a sample with the deviation of its zero
    start : (departures,) before the fit; None: as fitted
    left_error : relative error of all deflections that stays unexplained
    is_scale_open : whether the common scale of the gains is not known, as without known loads
    """
    curve = nominal.curve(vector)
    extent, stated = nominal.prior.extent, nominal.prior.force_range
    inside = zip(extent.low_mm + INNER * extent.size_mm, extent.high_mm - INNER * extent.size_mm, strict=True)
    places = Extent(tuple(inside)).grid(PLACES)
    force = np.full(len(places), np.mean(nominal.prior.force_n))
    clean = curve.measured_mm(places, force)
    slopes = nominal.slopes(vector, places, force, tuple(nominal.kinds))
    relative = covariance
    if is_scale_open and stated.is_open:
        project, gain = np.eye(nominal.size), nominal.kinds["gain"]
        project[gain, gain] -= 1 / nominal.prior.channels
        relative = project @ covariance @ project.T
    spread = np.einsum("lcv,vw,lcw->lc", slopes, relative, slopes)
    # The best estimate of the position, with a typical floor.
    deviation = np.sqrt(noise_mm**2 + spread)
    *along, by_force = curve.moved_mm(places, force) / deviation
    by_place = np.stack(along, axis=1)
    # A change along the force may as well come from it, as far as the stated range lets it.
    read = stated.relative_error**-2
    part = (by_place * by_force[:, None]).sum(axis=2) / ((by_force**2).sum(axis=1) + read)[:, None]
    across = by_place - part[:, :, None] * by_force[:, None]
    told = across @ across.transpose(0, 2, 1) + read * part[:, :, None] * part[:, None]
    # Too few sensors under an open force tell no place.
    own = np.einsum("laa->la", told)
    is_told = (own > UNTOLD * (by_place**2).sum(axis=2)).all(axis=1)
    is_told &= np.linalg.det(told) > UNTOLD * own.prod(axis=1)
    safe = np.where(is_told[:, None, None], told, np.eye(extent.axes))
    weights = np.where(is_told[:, None, None], np.linalg.solve(safe, across), 0.0) / deviation[:, None]
    moves = np.einsum("lac,lcv->lav", weights, slopes)
    open_mm = np.sqrt(np.einsum("lav,vw,law->l", moves, covariance, moves))
    gain_error = np.sqrt((spread / np.maximum(clean**2, TINY)).mean(axis=0))
    gain_error = np.maximum(gain_error, MIN_GAIN)
    per_gain_mm = weights * clean[:, None]
    ratios = open_mm[is_told] / stated_mm(per_gain_mm, gain_error)[is_told]
    factor = float(np.quantile(ratios, ENOUGH)) if len(ratios) else 1.0
    floor = np.maximum(np.hypot(factor * gain_error, left_error), MIN_GAIN)
    shift_mm = 0.0 if start is None else float(np.sqrt(((moves @ (vector - start)) ** 2).sum(axis=1).mean()))
    share = np.einsum("lc,lcv->lv", clean / np.maximum((clean**2).sum(axis=1, keepdims=True), TINY), slopes)
    force_error = float(np.sqrt(np.einsum("lv,vw,lw->l", share, covariance, share).mean()))
    return RemainingUncertainty(open_mm, shift_mm, per_gain_mm, relative, floor, force_error)
