"""Self-calibration: unlabelled contacts turn a model into one of the real surface, but for the scale of its forces."""

from dataclasses import dataclass, replace

import numpy as np

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.calibration.contacts import UnlabelledContacts
from beamtouch_models.calibration.left_open import HeldOut, LeftOpen, held_out
from beamtouch_models.calibration.rebuilt import rebuilt
from beamtouch_models.calibration.refusals import (
    check_beam,
    check_contacts,
    check_determined,
    check_held_out,
    check_single,
    check_spread,
)
from beamtouch_models.calibration.theory import GAIN, Theory
from beamtouch_models.calibration.unlabelled import ContactFit, fit_contacts
from beamtouch_models.loading import ModelFile
from beamtouch_models.metadata import Calibration, Metadata
from beamtouch_models.pricing.noise import GAIN_ERROR
from beamtouch_models.progress import Progress

KINDS = ("gain", "position", "curve", "offset")
"""Departures that unlabelled contacts determine. Rigidity is a scale of the forces."""
FIXITY = "fixity"
"""Unlabelled contacts hardly tell it from gains and positions; they only show that it is there."""


@dataclass(frozen=True)
class SelfFit:
    """A fit that unlabelled contacts determine and confirm."""

    fit: ContactFit
    left_open: LeftOpen
    held_out: HeldOut


@dataclass(frozen=True)
class SelfCalibrated:
    """A model of the real surface, with the fit and its errors."""

    content: bytes
    metadata: Metadata
    found: SelfFit


def self_fit(model: ModelFile, contacts: UnlabelledContacts, progress: Progress) -> SelfFit:
    """Fit the departures of a model's surface to unlabelled contacts; raises as `self_calibrate`."""
    metadata = model.metadata
    theory = Theory.of(metadata)
    check_contacts(theory, len(contacts))
    zero_mm, gain = np.array(metadata.floor.zero_mm), np.array(metadata.floor.gain)
    # A wide floor of gains that were never calibrated is no excuse for another beam.
    most = min(float(gain.mean()), GAIN_ERROR)
    start = np.zeros(theory.size)
    if metadata.calibration is not None:
        start = theory.vector_of(metadata.calibration.departures)
    progress("fitting", 0.0)
    fit = fit_contacts(theory, start, contacts, KINDS, zero_mm)
    covariance = fit.covariance
    check_single(fit, most)
    check_spread(fit)
    if FIXITY in theory.kinds:
        progress("looking for another beam", 0.3)
        other = fit_contacts(theory, start, contacts, (*KINDS, FIXITY), zero_mm, like=fit)
        check_beam(fit, other)
        # A fixity that is too small to be seen leaves its share of the error.
        covariance = other.covariance
    noise_mm = np.hypot(metadata.noise.sample_mm, zero_mm)
    check_determined(fit, LeftOpen(fit, fit.covariance, noise_mm), gain)
    progress("leaving out a part of the contacts at a time", 0.5)
    left_out = held_out(fit, contacts, zero_mm, most)
    check_held_out(left_out)
    return SelfFit(fit, LeftOpen(fit, covariance, noise_mm), left_out)


def self_calibrate(model: ModelFile, contacts: UnlabelledContacts, progress: Progress) -> SelfCalibrated:
    """Fit a model to unlabelled contacts and rebuild it.

    Raises
    ------
    NotGoodEnoughError
        The contacts are too few or too close together to determine a fit, are not single contacts, or show that the
        beam itself is not as modelled; the message says which.
    """
    metadata, found = model.metadata, self_fit(model, contacts, progress)
    prior, calibration = calibrated_prior(metadata, found)
    content, fresh = rebuilt(metadata, prior, calibration, progress)
    return SelfCalibrated(content, fresh, found)


def calibrated_prior(metadata: Metadata, found: SelfFit) -> tuple[Prior, Calibration]:
    """Return the prior of the fitted surface with its floor, and the record of the fit for the model file."""
    fit, before = found.fit, metadata.calibration
    departures = fit.theory.departures(fit.vector)
    calibration = Calibration(
        departures=departures,
        fitted=list(dict.fromkeys([*(before.fitted if before else ()), *fit.kinds])),
        loads=before.loads if before else 0,
        residual_mm=before.residual_mm if before else 0.0,
        error_before_mm=before.error_before_mm if before else None,
        error_after_mm=before.error_after_mm if before else None,
        contacts=len(fit.single),
        misfit_before=found.held_out.before,
        misfit_after=found.held_out.after,
        force_error=force_error(fit),
    )
    prior = replace(
        fit.theory.prior_with(departures), gain=found.left_open.floor(), zero_mm=np.array(metadata.floor.zero_mm)
    )
    return prior, calibration


def force_error(fit: ContactFit) -> float:
    """Return the relative error of all forces together: that of the mean of the gains, which residuals do not see."""
    if fit.theory.prior.force_is_known:
        return 0.0
    gain = fit.theory.kinds["gain"]
    return float(GAIN * np.sqrt(fit.covariance[gain, gain].sum()) / fit.theory.prior.channels)
