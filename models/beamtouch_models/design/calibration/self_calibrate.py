"""Self-calibration: unlabelled contacts turn a model into one of the real surface, but for the scale of its forces."""

from dataclasses import dataclass

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.calibration.calibrate import rebuilt
from beamtouch_models.design.calibration.nominal_surface import FIXITY, GAIN, NominalSurface
from beamtouch_models.design.calibration.recordings import MIN_SPREAD, UnlabelledContacts
from beamtouch_models.design.calibration.unlabelled import (
    ContactFit,
    RemainingUncertainty,
    fit_contacts,
    locate,
    measure_remaining,
    stated_mm,
)
from beamtouch_models.design.effort import USUAL, Effort
from beamtouch_models.design.pricing.noise import GAIN_ERROR
from beamtouch_models.design.scene.tables import MAX_GAIN_PERCENT
from beamtouch_models.design.sweeps import Progress
from beamtouch_models.errors import NotGoodEnoughError
from beamtouch_models.runtime.departures import Calibration
from beamtouch_models.runtime.loading import ModelFile
from beamtouch_models.runtime.metadata import Metadata

KINDS = ("gain", "position", "curve", "offset")
"""Departures that unlabelled contacts determine. Rigidity is a scale of the forces, and fixity they hardly tell from
gains and positions: they only show that it is there."""
MIN_CONTACTS = 12
"""Smallest number of contacts."""
MAX_NOT_SINGLE = 1 / 3
"""Largest share of samples that are not a single contact on this surface."""
FIXED = 10.0
"""Decrease of a fit's cost that shows a fixity of the ends; without one, none of 120 fits reached it."""


@dataclass(frozen=True)
class SelfFit:
    """A fit that unlabelled contacts determine and confirm."""

    fit: ContactFit
    remaining: RemainingUncertainty
    misfit_before: float
    """Median sum of squares of the contacts' residuals by the given model, in units of noise and zero."""
    misfit_after: float
    """The same by the fit."""


@dataclass(frozen=True)
class SelfCalibrated:
    """A model of the real surface, with the fit and its errors."""

    content: bytes
    metadata: Metadata
    found: SelfFit


def self_calibrate(
    model: ModelFile, contacts: UnlabelledContacts, progress: Progress, effort: Effort = USUAL
) -> SelfCalibrated:
    """Fit a model to unlabelled contacts and rebuild it; `effort` is that of the measurements on the new model.

    Raises
    ------
    NotGoodEnoughError
        The contacts are too few or too close together to determine a fit, are not single contacts, show that the beam
        itself is not as modelled, or leave a gain less well known than a scene may state it; the message says which.
    """
    metadata, fit = model.metadata, self_fit(model, contacts, progress)
    prior, calibration = calibrated_prior(metadata, fit)
    content, fresh = rebuilt(metadata, prior, calibration, progress, effort)
    return SelfCalibrated(content, fresh, fit)


def self_fit(model: ModelFile, contacts: UnlabelledContacts, progress: Progress) -> SelfFit:
    """Fit the departures of a model's surface to unlabelled contacts; raises as `self_calibrate`."""
    metadata = model.metadata
    nominal = NominalSurface.of(metadata)
    _check_contacts(nominal, len(contacts))
    zero_mm, gain = np.array(metadata.floor.zero_mm), np.array(metadata.floor.gain)
    # A wide floor of gains that were never calibrated is no excuse for another beam.
    most = min(float(gain.mean()), GAIN_ERROR)
    start = np.zeros(nominal.size)
    if metadata.calibration is not None:
        start = nominal.vector_of(metadata.calibration.departures)
    progress("fitting", 0.0)
    kinds = tuple(kind for kind in KINDS if kind in nominal.kinds)
    fit = fit_contacts(nominal, start, contacts, kinds, zero_mm)
    _check_single(fit, most)
    _check_spread(fit)
    covariance = fit.covariance
    if "fixity" in nominal.kinds:
        progress("looking for another beam", 0.3)
        with_fixity = fit_contacts(nominal, start, contacts, (*kinds, "fixity"), zero_mm, like=fit)
        _check_beam(fit, with_fixity)
        # A fixity that is too small to be seen leaves its share of the error.
        covariance = with_fixity.covariance
    noise_mm = np.hypot(metadata.noise.sample_mm, zero_mm)

    def remaining_by(covariance: Floats) -> RemainingUncertainty:
        before_fit, left = fit.start, fit.left_error
        return measure_remaining(
            nominal, fit.vector, covariance, noise_mm, start=before_fit, left_error=left, is_scale_open=True
        )

    _check_determined(fit, remaining_by(fit.covariance), gain)
    before, after = (locate(nominal, vector, contacts, zero_mm).residuals for vector in (start, fit.vector))
    misfits = (float(np.median(residuals.misfit(nominal.contact_errors))) for residuals in (before, after))
    remaining = remaining_by(covariance)
    _check_gains(metadata, remaining, len(contacts))
    return SelfFit(fit, remaining, *misfits)


def calibrated_prior(metadata: Metadata, found: SelfFit) -> tuple[Prior, Calibration]:
    """Return the prior of the fitted surface with its floor, and the record of the fit for the model file."""
    fit, before = found.fit, metadata.calibration
    departures = fit.departures
    calibration = Calibration(
        departures=departures,
        fitted=list(dict.fromkeys([*(before.fitted if before else ()), *fit.kinds])),
        loads=before.loads if before else 0,
        residual_mm=before.residual_mm if before else 0.0,
        error_before_mm=before.error_before_mm if before else None,
        error_after_mm=before.error_after_mm if before else None,
        contacts=len(fit.single),
        misfit_before=found.misfit_before,
        misfit_after=found.misfit_after,
        force_error=_force_error(fit),
    )
    prior = fit.nominal.prior_with(departures)
    return prior.with_floor(found.remaining.floor, np.array(metadata.floor.zero_mm)), calibration


def _force_error(fit: ContactFit) -> float:
    """Return the relative error of all forces together: that of the mean of the gains, which residuals do not see."""
    if not fit.nominal.prior.force_range.is_open:
        return 0.0
    gain = fit.nominal.kinds["gain"]
    return float(GAIN * np.sqrt(fit.covariance[gain, gain].sum()) / fit.nominal.prior.channels)


def _refuse(reason: str) -> NotGoodEnoughError:
    """Return the error with a reason not to calibrate."""
    return NotGoodEnoughError(f"nothing was written: {reason}")


def _check_contacts(nominal: NominalSurface, count: int) -> None:
    """Raise NotGoodEnoughError if there are too few channels or contacts."""
    channels, degrees = nominal.prior.channels, nominal.degrees
    if degrees < 1:
        raise _refuse(
            f"{channels} channels fit a contact of any place and force, so that unlabelled contacts tell nothing; it "
            f"takes {channels - degrees + 1}. Calibrate with known loads"
        )
    if count < MIN_CONTACTS:
        raise _refuse(f"{count} contacts are too few; it takes {MIN_CONTACTS}, and 200 are better")


def _check_single(fit: ContactFit, max_error: float) -> None:
    """Raise NotGoodEnoughError if contacts do not fit this surface; a relative error of `max_error` is allowed."""
    not_single = 1 - float(fit.single.mean())
    if not_single > MAX_NOT_SINGLE or fit.left_error > max_error:
        unexplained = f"{fit.left_error:.1%} of the deflections remain unexplained"
        shown = (
            f"{not_single:.0%} of them are no single contacts on this beam"
            if not_single > MAX_NOT_SINGLE
            else unexplained
        )
        raise _refuse(
            f"the contacts do not fit this model's surface: at best, {shown}. Check that file and model belong "
            "together, and that the order of the sensors and the beam are as modelled"
        )


def _check_spread(fit: ContactFit) -> None:
    """Raise NotGoodEnoughError if the contacts lie at one place."""
    low, high = fit.nominal.prior.extent.range_mm
    first, last = np.quantile(fit.position_mm[fit.single > 0.5], [0.1, 0.9])
    if last - first < MIN_SPREAD * (high - low):
        raise _refuse(
            f"most contacts lie between {digits(first, 4)} and {digits(last, 4)} mm, which determines no fit. Touch "
            "the whole beam, or calibrate with known loads"
        )


def _check_beam(fit: ContactFit, other: ContactFit) -> None:
    """Raise NotGoodEnoughError if the beam itself departs from the model: `other` is a fit with fixities."""
    if fit.cost - other.cost < FIXED:
        return
    left, right = other.departures.fixity
    errors = FIXITY * other.spread[fit.nominal.kinds["fixity"]]
    raise _refuse(
        "the beam itself is not as modelled. The contacts fit as if its ends were fixed by "
        f"{left:.2f} +- {errors[0]:.2f} (left) and {right:.2f} +- {errors[1]:.2f} (right), where 0 is as in the scene; "
        "check supports, width of contacts and stiffness, or calibrate with known loads"
    )


def _check_determined(fit: ContactFit, remaining: RemainingUncertainty, gain: Floats) -> None:
    """Raise NotGoodEnoughError if the contacts determine too little to improve the given model."""
    open_mm, claimed_mm = (
        float(np.sqrt((values**2).mean())) for values in (remaining.position_mm, stated_mm(remaining.per_gain_mm, gain))
    )
    if open_mm > max(claimed_mm, remaining.shift_mm):
        raise _refuse(
            f"{len(fit.single)} contacts determine too little. They move positions by "
            f"{digits(remaining.shift_mm, 3)} mm and leave {digits(open_mm, 3)} mm open, more than the "
            f"{digits(claimed_mm, 3)} mm that the model states; record more, over the whole beam"
        )


def _check_gains(metadata: Metadata, remaining: RemainingUncertainty, count: int) -> None:
    """Raise NotGoodEnoughError if the contacts leave a gain less well known than a scene may state it."""
    worst = int(np.argmax(remaining.floor))
    percent = 100 * float(remaining.floor[worst])
    if percent > MAX_GAIN_PERCENT:
        raise _refuse(
            f"{count} contacts leave the gain of {metadata.layout[worst].name} known to {digits(percent, 2)} % only, "
            f"worse than {MAX_GAIN_PERCENT:g} %; record more, over the whole beam, or calibrate with known loads"
        )
