"""The fit of a surface's departures from its scene to known loads, limited to those that the loads support.

Maximum a posteriori: generalised least squares with a prior on each departure, of its plausible size. The covariance
of the residuals holds the noise of the recording, the errors of position and force of each load, and a residual that
neither explains. The residual is as large as makes the weighted squares equal to their degrees of freedom (Paule &
Mandel 1982, doi 10.6028/jres.087.022). Kinds of departures are added one by one, each only if it lowers the error of
loads that are left out of the fit. The residuals of these come from the leverages of all loads in one fit (PRESS; Allen
1974, doi 10.1080/00401706.1974.10489157).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.calibration.loads import Deflections, Loads, RecordingErrors
from beamtouch_models.calibration.theory import FIXITY, MAX_FIXITY, Theory
from beamtouch_models.metadata import Departures
from beamtouch_models.progress import Fraction


def hat_matrix(slopes: Floats) -> Floats:
    """Return the hat matrix of whitened residuals, with priors of variance 1 on the departures."""
    matrix: Floats = slopes @ np.linalg.solve(slopes.T @ slopes + np.eye(slopes.shape[1]), slopes.T)
    return matrix


def left_out_residuals(residual: Floats, slopes: Floats) -> Floats:
    """Return the whitened residuals (loads, channels, 1) of each load when it is left out of the fit."""
    hat, channels = hat_matrix(slopes), residual.shape[1]
    own = [slice(start, start + channels) for start in range(0, residual.size, channels)]
    pairs = zip(own, residual, strict=True)
    return np.array([np.linalg.solve(np.eye(channels) - hat[rows, rows], one) for rows, one in pairs])


WORTH = 0.95
"""A kind of departure is added if it lowers the error of left-out loads to at most this fraction."""
ROUNDS = 3
"""Largest number of times that the residual is estimated."""


@dataclass(frozen=True)
class Fit:
    """A fit of some kinds of departures."""

    theory: Theory
    kinds: tuple[str, ...]
    vector: Floats
    errors: RecordingErrors
    """Errors of the recording as the fit finds them."""
    scatter: float
    """Standard deviation of the residuals, per degree of freedom, in units of the errors that the recording states."""
    freedom: float
    """Remaining degrees of freedom: deflections minus the departures that they determine."""
    left_out_mm: Floats
    """(loads, channels) measured minus predicted, each load left out of the fit; NaN without a measurement."""
    left_out: float
    """Root mean square of `left_out_mm`, in units of the errors that the recording states."""
    prediction_mm: float
    """Root mean square error of the predicted deflections, from that of the departures."""
    covariance: Floats
    """(departures, departures) covariance of the vector, in its units; 0 if not fitted."""

    @property
    def residual_mm(self) -> float:
        """Standard deviation of the residuals beyond all errors of the recording."""
        return self.errors.residual_mm

    @property
    def error_mm(self) -> float:
        """Root mean square of the deflections of left-out loads."""
        return float(np.sqrt(np.nanmean(self.left_out_mm**2)))

    @property
    def spread(self) -> Floats:
        """(departures,) standard errors, in the units of the vector; 0 if not fitted."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def departures(self) -> Departures:
        """The fitted departures."""
        return self.theory.departures(self.vector)


@dataclass(frozen=True)
class _Problem:
    """The fit of some kinds of departures to loads."""

    theory: Theory
    loads: Loads
    kinds: tuple[str, ...]

    @cached_property
    def free(self) -> Indices:
        """Places of the fitted departures in the vector of all."""
        return free_of(self.theory, self.kinds)

    @cached_property
    def is_measured(self) -> Bools:
        """(loads, channels), whether there is a measurement."""
        return np.isfinite(self.loads.measured_mm)

    def with_free(self, vector: Floats, part: Floats) -> Floats:
        """Return the vector with other values of the fitted departures."""
        moved = vector.copy()
        moved[self.free] = part
        return moved

    def left_mm(self, vector: Floats) -> Floats:
        """Return the residuals (loads, channels); 0 without a measurement."""
        return np.where(self.is_measured, self.loads.measured_mm - self.theory.measured_mm(vector, self.loads), 0.0)

    def slopes(self, vector: Floats) -> Floats:
        """Return the change of each deflection with the fitted departures, (loads, channels, departures)."""
        return self.theory.slopes(vector, self.loads, self.kinds)[..., self.free] * self.is_measured[..., None]

    def weighed(self, slopes: Floats, whitening: Floats) -> Floats:
        """Return whitened slopes, a row for each deflection."""
        return (whitening @ slopes).reshape(self.is_measured.size, len(self.free))

    def solved(self, vector: Floats, whitening: Floats) -> Floats:
        """Return the vector with the likeliest departures for this whitening of the residuals."""
        if not len(self.free):
            return vector

        def residuals(part: Floats) -> Floats:
            left_mm = self.left_mm(self.with_free(vector, part))
            return np.concatenate([np.einsum("lcd,ld->lc", whitening, left_mm).ravel(), part])

        def jacobian(part: Floats) -> Floats:
            slopes = self.slopes(self.with_free(vector, part))
            return np.concatenate([-self.weighed(slopes, whitening), np.eye(len(part))])

        low, high = bounds_of(self.theory, self.free)
        # The default method, "trf", cannot leave a start on a bound, and fixities start at 0.
        start = np.clip(vector[self.free], low, high)
        found = least_squares(residuals, start, jacobian, bounds=(low, high), method="dogbox", ftol=1e-5, max_nfev=30)
        return self.with_free(vector, found.x)


def fit(
    theory: Theory, loads: Loads, kinds: tuple[str, ...], start: Floats | None = None, *, rounds: int = ROUNDS
) -> Fit:
    """Fit some kinds of departures; the others stay as in the scene."""
    problem, errors = _Problem(theory, loads, kinds), loads.errors
    none = np.zeros(theory.size)
    vector = none if start is None else problem.with_free(none, start[problem.free])
    for _ in range(rounds):
        moved = theory.deflections(vector, loads)
        whitening = moved.whitening(errors)
        vector = problem.solved(vector, whitening)
        left, at = problem.left_mm(vector), problem.slopes(vector)
        # Only departures that the data determine, rather than the prior, use up degrees of freedom.
        freedom = max(1.0, problem.is_measured.sum() - float(np.trace(hat_matrix(problem.weighed(at, whitening)))))
        errors = moved.errors_of(left, loads.errors, errors, freedom)
    return _judged(problem, vector, moved, errors, freedom, left, at)


def _judged(
    problem: _Problem,
    vector: Floats,
    moved: Deflections,
    errors: RecordingErrors,
    freedom: float,
    left: Floats,
    at: Floats,
) -> Fit:
    """Return the fit with these residuals and slopes, and its errors of loads that are left out of it."""
    theory, measured, free = problem.theory, problem.is_measured, problem.free
    whitening, as_stated = moved.whitening(errors), moved.whitening(problem.loads.errors)
    weighed = problem.weighed(at, whitening)
    left_out = np.linalg.solve(whitening, left_out_residuals(whitening @ left[..., None], weighed))[..., 0]
    own = np.linalg.inv(weighed.T @ weighed + np.eye(len(free)))
    covariance = np.zeros((theory.size, theory.size))
    covariance[np.ix_(free, free)] = own
    return Fit(
        theory,
        problem.kinds,
        vector,
        errors,
        scatter=float(np.sqrt(((as_stated @ left[..., None]) ** 2).sum() / freedom)),
        freedom=freedom,
        left_out_mm=np.where(measured, left_out, np.nan),
        left_out=float(np.sqrt(((as_stated @ left_out[..., None]) ** 2).sum() / measured.sum())),
        prediction_mm=float(np.sqrt(np.einsum("lcv,vw,lcw->", at, own, at) / measured.sum())),
        covariance=covariance,
    )


def supported_fit(theory: Theory, loads: Loads, progress: Fraction) -> Fit:
    """Fit the kinds of departures that lower the error of left-out loads."""
    best, open_kinds = fit(theory, loads, ()), list(theory.kinds)
    while open_kinds:
        progress(1 - len(open_kinds) / len(theory.kinds))
        trials = [fit(theory, loads, (*best.kinds, kind), best.vector) for kind in open_kinds]
        trial = min(trials, key=lambda one: one.left_out)
        if trial.left_out > WORTH * best.left_out:
            break
        best = trial
        open_kinds.remove(trial.kinds[-1])
    return best


def free_of(theory: Theory, kinds: tuple[str, ...]) -> Indices:
    """Return the places of some kinds in the vector of all departures."""
    places = np.arange(theory.size)
    return np.concatenate([places[:0], *(places[theory.kinds[kind]] for kind in kinds)])


def bounds_of(theory: Theory, free: Indices) -> tuple[Floats, Floats]:
    """Return the smallest and the largest values of fitted departures, in the units of the vector."""
    low, high = np.full(theory.size, -8.0), np.full(theory.size, 8.0)
    if "fixity" in theory.kinds:
        low[theory.kinds["fixity"]], high[theory.kinds["fixity"]] = 0.0, MAX_FIXITY / FIXITY
    return low[free], high[free]
