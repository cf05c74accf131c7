"""The uncertainty that a fit to unlabelled contacts leaves, as errors of the position.

The errors of a fit are correlated across channels, and the largest of them lie along the influence curve, where
residuals do not see them. The floor of a model is independent per channel. So it is scaled until it states the position
error.
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.calibration.unlabelled import ContactFit

PLACES = 61
"""Number of contacts over the range at which errors are computed."""
INNER = 0.05
"""Share of the range at each end that is left out: next to a support, a contact has no position error worth stating."""
ENOUGH = 0.75
"""Share of these contacts at which the floor states at least the position error that the fit leaves."""
MIN_GAIN = 5e-4
"""Smallest floor of a gain: sensors and amplifiers are not steadier than that."""


@dataclass(frozen=True)
class LeftOpen:
    """Errors of the estimates of a fitted model, at contacts over the range with a force from its middle."""

    position_mm: Floats
    """Standard deviation (places,) of the position, from the departures."""
    shift_mm: float
    """Root mean square of the change of positions from the given model to the fitted one."""
    per_gain_mm: Floats
    """(places, channels) change of the position with the gain of each channel."""
    relative: Floats
    """(departures, departures) covariance without the common scale of the gains, which is force if that is open."""
    floor: Floats
    """Gain errors (channels,) that state what the fit leaves open."""

    def stated_mm(self, gain: Floats) -> Floats:
        """Return the standard deviation (places,) of the position that a floor of the gains (channels,) states."""
        return _stated_mm(self.per_gain_mm, gain)


def _stated_mm(per_gain_mm: Floats, gain: Floats) -> Floats:
    stated_mm: Floats = np.linalg.norm(per_gain_mm * gain, axis=1)
    return stated_mm


def measure_left_open(fit: ContactFit, covariance: Floats, noise_mm: Floats) -> LeftOpen:
    """Return what a fit leaves open.

    Parameters
    ----------
    covariance : (departures, departures), of the departures, in the units of the vector
    noise_mm : (channels,) noise of a sample with the deviation of its zero
    """
    theory, curve = fit.theory, fit.theory.curve(fit.vector)
    (low, high), is_known = theory.prior.position_mm, theory.prior.force_is_known
    margin = INNER * (high - low)
    position = np.linspace(low + margin, high - margin, PLACES)
    force = np.full(PLACES, np.mean(theory.prior.force_n))
    clean = curve.measured_mm(position, force)
    slopes = theory.slopes(fit.vector, position, force, tuple(theory.kinds))
    relative = covariance
    if not is_known:
        project, gain = np.eye(theory.size), theory.kinds["gain"]
        project[gain, gain] -= 1 / theory.prior.channels
        relative = project @ covariance @ project.T
    spread = np.einsum("lcv,vw,lcw->lc", slopes, relative, slopes)
    # The best estimate of the position, with a typical floor.
    deviation = np.sqrt(noise_mm**2 + spread)
    along = curve.moved_mm(position, force)[: 1 if is_known else 2]
    weights = np.linalg.pinv(np.moveaxis(along, 0, 2) / deviation[..., None])[:, 0] / deviation
    moves = np.einsum("lc,lcv->lv", weights, slopes)
    open_mm = np.sqrt(np.einsum("lv,vw,lw->l", moves, covariance, moves))
    each = np.sqrt((spread / np.maximum(clean**2, np.finfo(np.float64).tiny)).mean(axis=0))
    each = np.maximum(each, MIN_GAIN)
    factor = float(np.quantile(open_mm / _stated_mm(weights * clean, each), ENOUGH))
    floor = np.maximum(np.hypot(factor * each, fit.left_error), MIN_GAIN)
    shift_mm = float(np.sqrt(((moves @ (fit.vector - fit.start)) ** 2).mean()))
    return LeftOpen(open_mm, shift_mm, weights * clean, relative, floor)
