"""Reasons not to calibrate from unlabelled contacts."""

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.calibration.left_open import HeldOut, LeftOpen
from beamtouch_models.calibration.loads import MIN_SPREAD
from beamtouch_models.calibration.theory import FIXITY, Theory
from beamtouch_models.calibration.unlabelled import ContactFit, degrees_of
from beamtouch_models.errors import NotGoodEnoughError

MIN_CONTACTS = 12
"""Smallest number of contacts."""
MAX_NOT_SINGLE = 1 / 3
"""Largest share of samples that are not a single contact on this surface."""
WORSE = 1.5
"""Median misfit of left-out contacts over the expected one up to which a fit cannot be worse than the given model."""
FIXED = 10.0
"""Decrease of a fit's cost that shows a fixity of the ends; without one, none of 120 fits reached it."""


def check_contacts(theory: Theory, count: int) -> None:
    """Raise NotGoodEnoughError if there are too few channels or contacts."""
    degrees = degrees_of(theory)
    if degrees < 1:
        message = (
            f"nothing was written: {theory.prior.channels} channels fit a contact of any place and force, so that "
            f"unlabelled contacts tell nothing; it takes {theory.prior.channels - degrees + 1}. Calibrate with known "
            "loads"
        )
        raise NotGoodEnoughError(message)
    if count < MIN_CONTACTS:
        message = f"nothing was written: {count} contacts are too few; it takes {MIN_CONTACTS}, and 200 are better"
        raise NotGoodEnoughError(message)


def check_single(fit: ContactFit, max_error: float) -> None:
    """Raise NotGoodEnoughError if contacts do not fit this surface; a relative error of `max_error` is allowed."""
    other = 1 - float(fit.single.mean())
    if other > MAX_NOT_SINGLE or fit.left_error > max_error:
        left = f"leaves {fit.left_error:.1%} of the deflections unexplained"
        shown = f"{other:.0%} of them are no single contacts on this beam" if other > MAX_NOT_SINGLE else left
        message = (
            f"nothing was written: the contacts do not fit this model's surface. At best, {shown}. "
            "Check that file and model belong together, and that the order of the sensors and the beam are as modelled"
        )
        raise NotGoodEnoughError(message)


def check_spread(fit: ContactFit) -> None:
    """Raise NotGoodEnoughError if the contacts lie at one place."""
    low, high = fit.theory.prior.position_mm
    first, last = np.quantile(fit.position_mm[fit.single > 0.5], [0.1, 0.9])
    if last - first < MIN_SPREAD * (high - low):
        message = (
            f"nothing was written: most contacts lie between {digits(first, 4)} and {digits(last, 4)} mm, which "
            "determines no fit. Touch the whole beam, or calibrate with known loads"
        )
        raise NotGoodEnoughError(message)


def check_beam(fit: ContactFit, other: ContactFit) -> None:
    """Raise NotGoodEnoughError if the beam itself departs from the model: `other` is a fit with fixities."""
    if fit.cost - other.cost < FIXED:
        return
    left, right = fit.theory.departures(other.vector).fixity
    errors = FIXITY * other.spread[fit.theory.kinds["fixity"]]
    message = (
        "nothing was written: the beam itself is not as modelled. The contacts fit as if its ends were fixed by "
        f"{left:.2f} +- {errors[0]:.2f} (left) and {right:.2f} +- {errors[1]:.2f} (right), where 0 is as in the scene; "
        "check supports, width of contacts and stiffness, or calibrate with known loads"
    )
    raise NotGoodEnoughError(message)


def check_determined(fit: ContactFit, left_open: LeftOpen, gain: Floats) -> None:
    """Raise NotGoodEnoughError if the contacts determine too little to improve the given model."""
    open_mm, claimed_mm = (
        float(np.sqrt((values**2).mean())) for values in (left_open.position_mm, left_open.stated_mm(gain))
    )
    changed_mm = left_open.shift_mm()
    if open_mm > max(claimed_mm, changed_mm):
        message = (
            f"nothing was written: {len(fit.single)} contacts determine too little. They move positions by "
            f"{digits(changed_mm, 3)} mm and leave {digits(open_mm, 3)} mm open, more than the "
            f"{digits(claimed_mm, 3)} mm that the model states; record more, over the whole beam"
        )
        raise NotGoodEnoughError(message)


def check_held_out(found: HeldOut) -> None:
    """Raise NotGoodEnoughError if left-out contacts contradict the fit, or the given model explains them better."""
    if found.beyond > 1:
        message = (
            "nothing was written: the beam itself is not as modelled. The misfit of left-out contacts is "
            f"{digits(found.beyond, 3)} times the largest that noise and floor allow; calibrate with known loads"
        )
        raise NotGoodEnoughError(message)
    if found.after > max(found.before, WORSE * found.expected):
        message = (
            "nothing was written: the fit would be worse. The median misfit of left-out contacts is "
            f"{digits(found.after, 3)}, by the given model {digits(found.before, 3)}; record more contacts, over the "
            "whole beam"
        )
        raise NotGoodEnoughError(message)
