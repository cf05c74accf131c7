"""The residual equation of a load: what its place and its force leave unexplained of the deflections. Numpy only, pure.

A load of force F at x deflects the sensors by z = measure(F G(x)). If its place and force are off by dx and dF, the
deflections move along F G'(x), one direction an axis, and F G(x). Errors of known size along these count as noise. A
place or a force that is not known takes its directions out altogether: only what is left across them says anything of
the surface (variable projection: Golub & Pereyra 1973, doi 10.1137/0710036). Known loads, unlabelled contacts, loads
that may be mistyped and the health of the sensors are judged by this one equation.
"""

from dataclasses import astuple, dataclass
from typing import Self

import numpy as np

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.runtime.curve import InfluenceCurve

_TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class LoadErrors:
    """Standard deviations of what loads are off by; infinite for what is not known."""

    placing_mm: float
    """Of a load's place about the stated one, along each axis."""
    force: float
    """Of the force of a load, relative to the stated one."""
    residual_mm: float = 0.0
    """Of each deflection, beyond its noise."""

    def along(self, moved_mm: Floats) -> Floats:
        """Return the errors along each direction of `moved_mm` (axes + 1, ...): that of the place for each axis."""
        return np.array([*[self.placing_mm] * (len(moved_mm) - 1), self.force])

    def at_least(self, other: "LoadErrors") -> "LoadErrors":
        """Return the larger of each pair."""
        return LoadErrors(*np.maximum(astuple(self), astuple(other)).tolist())


UNKNOWN = LoadErrors(placing_mm=np.inf, force=np.inf)
"""Nothing is known of the loads."""


@dataclass(frozen=True)
class Residuals:
    """Deflections of loads, less those that a surface predicts, and what moves them."""

    left_mm: Floats
    """(loads, channels) measured minus predicted; 0 without a measurement."""
    noise_mm: Floats
    """(loads, channels) standard deviation of the measurement."""
    moved_mm: Floats
    """(axes + 1, loads, channels) by 1 mm of a load's place along each axis, and by its whole force; 0 without a
    measurement."""
    is_measured: Bools
    """(loads, channels)"""

    @classmethod
    def of(
        cls, curve: InfluenceCurve, place_mm: Floats, force_n: Floats, measured_mm: Floats, noise_mm: Floats
    ) -> Self:
        """Return those of loads at places (loads, axes) with deflections (loads, channels).

        Deflections are NaN without a measurement.
        """
        there = np.isfinite(measured_mm)
        left_mm = np.where(there, measured_mm - curve.measured_mm(place_mm, force_n), 0.0)
        return cls(left_mm, noise_mm, curve.moved_mm(place_mm, force_n) * there, there)

    def covariance_mm2(self, errors: LoadErrors) -> Floats:
        """Return the covariance (loads, channels, channels), without what is not known.

        A channel without a measurement has variance 1.
        """
        variance = np.where(self.is_measured, self.noise_mm**2 + errors.residual_mm**2, 1.0)
        sizes = errors.along(self.moved_mm)
        moved = self.moved_mm * np.where(np.isfinite(sizes), sizes, 0.0)[:, None, None]
        covariance: Floats = variance[..., None] * np.eye(variance.shape[1])
        covariance += np.einsum("klc,kld->lcd", moved, moved)
        return covariance

    def whitening(self, errors: LoadErrors) -> Floats:
        """Return W (loads, channels, channels), with W'W the inverse of the covariance.

        Directions that are not known are projected out: W is 0 along them.
        """
        whitening = np.linalg.inv(np.linalg.cholesky(self.covariance_mm2(errors)))
        unknown = ~np.isfinite(errors.along(self.moved_mm))
        if not unknown.any():
            return whitening
        along = whitening @ np.moveaxis(self.moved_mm[unknown], 0, 2)
        # At a support nothing moves along the force: then there is nothing to take out.
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), _TINY)
        return whitening - along @ (np.linalg.pinv(along) @ whitening)

    def misfit(self, errors: LoadErrors, slopes: Floats | None = None, covariance: Floats | None = None) -> Floats:
        """Return the misfits (loads,): the squares of the residuals in units of the errors.

        The surface itself may be uncertain: its departures move the deflections by `slopes` (loads, channels,
        departures), and have this covariance (departures, departures).
        """
        whitening = self.whitening(errors)
        left = (whitening @ self.left_mm[..., None])[..., 0]
        if slopes is None or covariance is None:
            squares: Floats = (left**2).sum(axis=1)
            return squares
        slopes = whitening @ slopes
        wide = np.eye(left.shape[1]) + slopes @ covariance @ slopes.transpose(0, 2, 1)
        misfits: Floats = np.einsum("lc,lc->l", left, np.linalg.solve(wide, left[..., None])[..., 0])
        return misfits


def leave_out(left: Floats, slopes: Floats, covariance: Floats) -> Floats:
    """Return the whitened residuals (loads, channels) of each load by a fit without it.

    They come from the leverages of all loads in one fit (PRESS; Allen 1974, doi 10.1080/00401706.1974.10489157).

    Parameters
    ----------
    left : (loads, channels), whitened residuals of the fit to all
    slopes : (loads, channels, departures), their change with the departures
    covariance : (departures, departures), of the departures by that fit
    """
    leverage = slopes @ covariance @ slopes.transpose(0, 2, 1)
    without: Floats = np.asarray(np.linalg.solve(np.eye(left.shape[1]) - leverage, left[..., None])[..., 0], np.float64)
    return without
