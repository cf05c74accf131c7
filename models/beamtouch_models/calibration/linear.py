"""Unlabelled contacts at their best places and forces, about which their deflections are linear in the departures."""

from dataclasses import dataclass, replace

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.calibration.contacts import UnlabelledContacts
from beamtouch_models.calibration.errors import Deflections, RecordingErrors
from beamtouch_models.calibration.loads import Loads
from beamtouch_models.calibration.places import places
from beamtouch_models.calibration.theory import Theory

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

    def misfit(self, theory: Theory, left_error: float, left_mm: Floats | None = None) -> Floats:
        """Return the misfits (contacts,) of `left_mm`, or of other residuals, under that covariance."""
        left_mm = self.left_mm if left_mm is None else left_mm
        misfit: Floats = (np.einsum("lcd,ld->lc", self.whitening(theory, left_error), left_mm) ** 2).sum(axis=1)
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
