"""The uncertainty that a fit to unlabelled contacts leaves: misfits of left-out contacts, and errors of the position.

The errors of a fit are correlated across channels, and the largest of them lie along the influence curve, where
residuals do not see them. The floor of a model is independent per channel. So it is scaled until it states the position
error.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import chi2

from beamtouch_models.arrays import Floats
from beamtouch_models.calibration.contacts import UnlabelledContacts
from beamtouch_models.calibration.loads import Loads
from beamtouch_models.calibration.theory import Theory
from beamtouch_models.calibration.unlabelled import ContactFit, degrees_of, fit_contacts, linear

PARTS = 4
"""Number of parts of the contacts; each is left out of one fit."""
ROUNDS = 5
"""Rounds of a fit without a part, which begins with the fit to all."""
CHANCE = 1e-4
"""Probability that contacts on a surface as modelled are said to contradict it."""
PLACES = 61
"""Number of contacts over the range at which errors are computed."""
INNER = 0.05
"""Share of the range at each end that is left out: next to a support, a contact has no position error worth stating."""
ENOUGH = 0.75
"""Share of these contacts at which the floor states at least the position error that the fit leaves."""
MIN_GAIN = 5e-4
"""Smallest floor of a gain: sensors and amplifiers are not steadier than that."""


@dataclass(frozen=True)
class HeldOut:
    """Misfits of left-out contacts: sums of squares in units of noise and zero."""

    before: float
    """Median by the given model."""
    after: float
    """Median by fits without the contact."""
    expected: float
    """Median of contacts on a surface that is exactly as the model says."""
    beyond: float
    """Sum of the misfits of single contacts over the largest that is allowed."""


def held_out(fit: ContactFit, contacts: UnlabelledContacts, zero_mm: Floats, max_error: float) -> HeldOut:
    """Leave out one part of the contacts at a time, spread over time.

    Parameters
    ----------
    zero_mm : (channels,) standard deviation of the zeros
    max_error : relative error of deflections that may be left
    """
    theory, count = fit.theory, len(contacts)
    after, allowed = np.empty(count), np.empty(count)
    for part in range(PARTS):
        left_out = np.arange(count) % PARTS == part
        rest = fit_contacts(theory, fit.start, contacts[~left_out], fit.kinds, zero_mm, like=fit, rounds=ROUNDS)
        after[left_out] = _misfits(fit, rest.vector, contacts[left_out], zero_mm, 0.0, None)
        allowed[left_out] = _misfits(fit, rest.vector, contacts[left_out], zero_mm, max_error, rest.covariance)
    before = _misfits(fit, fit.start, contacts, zero_mm, 0.0, None)
    degrees = degrees_of(theory)
    largest = float(chi2.isf(CHANCE, degrees * fit.single.sum()))
    return HeldOut(
        float(np.median(before)),
        float(np.median(after)),
        float(chi2.median(degrees)),
        float(fit.single @ allowed) / largest,
    )


def _misfits(
    fit: ContactFit,
    vector: Floats,
    contacts: UnlabelledContacts,
    zero_mm: Floats,
    left_error: float,
    covariance: Floats | None,
) -> Floats:
    """Return the misfits (contacts,) of contacts under departures, whose covariance counts as an error."""
    theory = fit.theory
    at = linear(theory, vector, contacts, zero_mm, left_error)
    if covariance is None:
        return at.misfit(theory, left_error)
    slopes = theory.slopes(vector, at.loads, fit.kinds)
    return at.misfit(theory, left_error, more_mm2=np.einsum("lcv,vw,ldw->lcd", slopes, covariance, slopes))


@dataclass(frozen=True)
class LeftOpen:
    """Errors of the estimates of a fitted model, at contacts over the range with a force from its middle."""

    fit: ContactFit
    covariance: Floats
    """(departures, departures) covariance of the departures, in the units of the vector."""
    noise_mm: Floats
    """(channels,) noise of a sample with the deviation of its zero."""

    @property
    def theory(self) -> Theory:
        """The surface."""
        return self.fit.theory

    @cached_property
    def position_mm(self) -> Floats:
        """Standard deviation (places,) of the position, from the departures."""
        variance: Floats = np.einsum("lv,vw,lw->l", self._moves, self.covariance, self._moves)
        return np.sqrt(variance)

    def shift_mm(self) -> float:
        """Root mean square of the change of positions from the given model to the fitted one."""
        step = self._moves @ (self.fit.vector - self.fit.start)
        return float(np.sqrt((step**2).mean()))

    def stated_mm(self, gain: Floats) -> Floats:
        """Return the standard deviation (places,) of the position that a floor of the gains (channels,) states."""
        variance: Floats = ((self._weights * gain * self._clean_mm) ** 2).sum(axis=1)
        return np.sqrt(variance)

    def floor(self) -> Floats:
        """Return the gain errors (channels,) that state what the fit leaves open."""
        moved = np.einsum("lcv,vw,lcw->lc", self._slopes, self.relative, self._slopes)
        each = np.sqrt((moved / np.maximum(self._clean_mm**2, np.finfo(np.float64).tiny)).mean(axis=0))
        each = np.maximum(each, MIN_GAIN)
        factor = float(np.quantile(self.position_mm / self.stated_mm(each), ENOUGH))
        floor: Floats = np.hypot(factor * each, self.fit.left_error)
        return np.maximum(floor, MIN_GAIN)

    @cached_property
    def _loads(self) -> Loads:
        low, high = self.theory.prior.position_mm
        margin = INNER * (high - low)
        position = np.linspace(low + margin, high - margin, PLACES)
        force = np.full(PLACES, np.mean(self.theory.prior.force_n))
        shape = (PLACES, self.theory.prior.channels)
        lines = np.zeros((PLACES, 2), np.intp)
        return Loads(np.arange(PLACES), position, force, np.zeros(shape), np.ones(shape), lines)

    @cached_property
    def _clean_mm(self) -> Floats:
        return self.theory.measured_mm(self.fit.vector, self._loads)

    @cached_property
    def _slopes(self) -> Floats:
        """(places, channels, departures) change of the deflections."""
        return self.theory.slopes(self.fit.vector, self._loads, tuple(self.theory.kinds))

    @cached_property
    def _weights(self) -> Floats:
        """(places, channels) change of the best estimate of the position with each deflection."""
        moved = self.theory.deflections(self.fit.vector, self._loads).moved_mm
        moved = moved[:1] if self.theory.prior.force_is_known else moved
        whitened = np.moveaxis(moved, 0, 2) / self._deviation_mm[..., None]
        weights: Floats = np.linalg.pinv(whitened)[:, 0] / self._deviation_mm
        return weights

    @cached_property
    def _deviation_mm(self) -> Floats:
        """(places, channels), with a typical floor."""
        spread = np.einsum("lcv,vw,lcw->lc", self._slopes, self.relative, self._slopes)
        deviation: Floats = np.sqrt(self.noise_mm**2 + spread)
        return deviation

    @cached_property
    def _moves(self) -> Floats:
        """(places, departures) change of the position with the departures."""
        moves: Floats = np.einsum("lc,lcv->lv", self._weights, self._slopes)
        return moves

    @cached_property
    def relative(self) -> Floats:
        """(departures, departures) covariance without the common scale of the gains, which is force if that is open."""
        if self.theory.prior.force_is_known:
            return self.covariance
        project, gain = np.eye(self.theory.size), self.theory.kinds["gain"]
        project[gain, gain] -= 1 / self.theory.prior.channels
        whole: Floats = project @ self.covariance @ project.T
        return whole
