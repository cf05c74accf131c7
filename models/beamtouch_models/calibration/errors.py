"""The errors of a recording: those of stated positions and forces, and a residual that neither explains."""

from dataclasses import astuple, dataclass

import numpy as np

from beamtouch_models.arrays import Bools, Floats

PSEUDO_LOADS = 0.25
"""Weight of the stated errors, in loads; they matter where the loads tell little."""
UPDATES = 10
"""Number of improvements of the errors in each round of a fit. A round starts from the errors of the previous one."""


@dataclass(frozen=True)
class RecordingErrors:
    """Standard deviations."""

    placing_mm: float
    """Of a load's position about the stated one."""
    force: float
    """Of the force of a load, relative to the stated one."""
    residual_mm: float = 0.0
    """Of each deflection, beyond its noise."""

    def at_least(self, other: "RecordingErrors") -> "RecordingErrors":
        """Return the larger of each pair."""
        return RecordingErrors(*np.maximum(astuple(self), astuple(other)).tolist())


@dataclass(frozen=True)
class Deflections:
    """The causes that move measured deflections away from their prediction."""

    is_measured: Bools
    """(loads, channels), whether there is a measurement."""
    noise_mm: Floats
    """(loads, channels)"""
    moved_mm: Floats
    """(2, loads, channels) by 1 mm of a load's position, and by its whole force."""

    def covariance_mm2(self, errors: RecordingErrors) -> Floats:
        """Return the covariance (loads, channels, channels); a channel without a measurement has variance 1."""
        variance = np.where(self.is_measured, self.noise_mm**2 + errors.residual_mm**2, 1.0)
        own = variance[..., None] * np.eye(self._channels)
        moved = self.moved_mm * np.array([errors.placing_mm, errors.force])[:, None, None]
        covariance: Floats = own + np.einsum("klc,kld->lcd", moved, moved)
        return covariance

    def whitening(self, errors: RecordingErrors) -> Floats:
        """Return W (loads, channels, channels), with W'W the inverse of the covariance."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance_mm2(errors)))

    def errors_of(
        self, left_mm: Floats, about: RecordingErrors, start: RecordingErrors, freedom: float
    ) -> RecordingErrors:
        """Return the likely errors behind residuals (loads, channels) with `freedom` degrees of freedom.

        They maximise the likelihood (Zhou, Hu, Qiao & Lange 2019, doi 10.1080/10618600.2018.1529601), where `about`
        counts as much as `PSEUDO_LOADS` loads.
        """
        share = freedom / self.is_measured.sum()
        moved, left = np.moveaxis(self.moved_mm, 0, 2), left_mm[..., None]
        prior = np.array([about.placing_mm, about.force]) ** 2
        variance = np.array(astuple(start)) ** 2
        variance[2] = max(variance[2], float((self.noise_mm[self.is_measured] ** 2).mean()))
        for _ in range(UPDATES):
            inverse = np.linalg.inv(self.covariance_mm2(RecordingErrors(*np.sqrt(variance).tolist())))
            pulled = inverse @ left
            pulls = ((moved.transpose(0, 2, 1) @ pulled) ** 2).sum(axis=(0, 2))
            traces = share * (moved * (inverse @ moved)).sum(axis=(0, 1))
            safe = np.maximum(variance[:2], np.finfo(np.float64).tiny)
            pulls, traces = pulls + PSEUDO_LOADS * prior / safe**2, traces + PSEUDO_LOADS / safe
            own = share * np.trace(inverse * self.is_measured[..., None], axis1=1, axis2=2).sum()
            variance[:2] *= np.sqrt(pulls / traces)
            variance[2] *= np.sqrt((pulled**2).sum() / own)
        return RecordingErrors(*np.sqrt(variance).tolist())

    @property
    def _channels(self) -> int:
        return int(self.is_measured.shape[1])
