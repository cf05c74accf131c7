"""The misfit of unlabelled contacts that are left out of a fit."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from beamtouch_models.arrays import Floats
from beamtouch_models.calibration.contacts import UnlabelledContacts
from beamtouch_models.calibration.linear import degrees_of, linear
from beamtouch_models.calibration.unlabelled import ContactFit, fit_contacts

PARTS = 4
"""Number of parts of the contacts; each is left out of one fit."""
ROUNDS = 5
"""Rounds of a fit without a part, which begins with the fit to all."""
CHANCE = 1e-4
"""Probability that contacts on a surface as modelled are said to contradict it."""


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
    total = at.covariance_mm2(theory, left_error)
    if covariance is not None:
        slopes = theory.slopes(vector, at.loads, fit.kinds)
        total = total + np.einsum("lcv,vw,ldw->lcd", slopes, covariance, slopes)
    misfit: Floats = np.einsum("lc,lc->l", at.left_mm, np.linalg.solve(total, at.left_mm[..., None])[..., 0])
    return misfit
