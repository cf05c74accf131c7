"""The fit of a surface's departures from its scene to known loads, limited to those that the loads support.

Maximum a posteriori: generalised least squares with a prior on each departure, of its plausible size. The covariance
of the residuals holds the noise of the recording, the errors of position and force of each load, and a residual that
neither explains. The residual is as large as makes the weighted squares equal to their degrees of freedom (Paule &
Mandel 1982, doi 10.6028/jres.087.022). Kinds of departures are added one by one, each only if it lowers the error of
loads that are left out of the fit.
"""

from dataclasses import astuple, dataclass

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.calibration.recordings import Loads
from beamtouch_models.calibration.theory import Fitted, Theory, best_step
from beamtouch_models.health.residuals import LoadErrors, Residuals, leave_out
from beamtouch_models.sweeps import Fraction

WORTH = 0.95
"""A kind of departure is added if it lowers the error of left-out loads to at most this fraction."""
ROUNDS = 3
"""Largest number of times that the residual is estimated."""
STEPS = 8
"""Largest number of steps of a fit for one estimate of the residual."""
HALVINGS = 6
"""Largest number of times that a step is halved until it gains."""
BEYOND_MM = 1e6
"""Farther than any deflection."""
CLOSE = 1e-3
"""A fit ends with a step below this, in units of plausible departures."""
PSEUDO_LOADS = 0.25
"""Weight of the stated errors, in loads; they matter where the loads tell little."""
UPDATES = 10
"""Number of improvements of the errors in each round of a fit. A round starts from the errors of the previous one."""


@dataclass(frozen=True)
class Fit(Fitted):
    """A fit of some kinds of departures to known loads."""

    errors: LoadErrors
    """Errors of the recording as the fit finds them, and the residual beyond all of them."""
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

    @property
    def error_mm(self) -> float:
        """Root mean square of the deflections of left-out loads."""
        return float(np.sqrt(np.nanmean(self.left_out_mm**2)))


def fit(
    theory: Theory, loads: Loads, kinds: tuple[str, ...], start: Floats | None = None, *, rounds: int = ROUNDS
) -> Fit:
    """Fit some kinds of departures; the others stay as in the scene."""
    free, vector, errors = theory.free_of(kinds), np.zeros(theory.size), loads.errors
    if start is not None:
        vector[free] = start[free]
    residuals = residuals_of(theory, loads, vector)
    measured = int(residuals.is_measured.sum())
    for _ in range(rounds):
        vector = _solve(theory, loads, kinds, vector, residuals.whitening(errors))
        residuals, slopes = residuals_of(theory, loads, vector), _slopes(theory, loads, kinds, vector)
        # Only departures that the data determine, rather than the prior, use up degrees of freedom.
        weighed = residuals.whitening(errors) @ slopes
        freedom = max(1.0, measured - float(np.einsum("lcv,vw,lcw->", weighed, _covariance(weighed), weighed)))
        errors = _likely_errors(residuals, loads.errors, errors, freedom)
    whitening, as_stated = residuals.whitening(errors), residuals.whitening(loads.errors)
    weighed, left = whitening @ slopes, residuals.left_mm[..., None]
    own = _covariance(weighed)
    left_out = np.linalg.solve(whitening, leave_out((whitening @ left)[..., 0], weighed, own)[..., None])
    return Fit(
        theory,
        kinds,
        vector,
        theory.covariance_of(kinds, own),
        errors,
        scatter=float(np.sqrt(((as_stated @ left) ** 2).sum() / freedom)),
        freedom=freedom,
        left_out_mm=np.where(residuals.is_measured, left_out[..., 0], np.nan),
        left_out=float(np.sqrt(((as_stated @ left_out) ** 2).sum() / measured)),
        prediction_mm=float(np.sqrt(np.einsum("lcv,vw,lcw->", slopes, own, slopes) / measured)),
    )


def residuals_of(theory: Theory, loads: Loads, vector: Floats) -> Residuals:
    """Return the residuals of known loads on a surface with departures."""
    return Residuals.of(theory.curve(vector), loads.position_mm, loads.force_n, loads.measured_mm, loads.deviation_mm)


def _slopes(theory: Theory, loads: Loads, kinds: tuple[str, ...], vector: Floats) -> Floats:
    """Return the change of each deflection with the fitted departures, (loads, channels, departures)."""
    slopes = theory.slopes(vector, loads.position_mm, loads.force_n, kinds)[..., theory.free_of(kinds)]
    return slopes * np.isfinite(loads.measured_mm)[..., None]


def _covariance(weighed: Floats) -> Floats:
    """Return the covariance of the fitted departures, from their whitened slopes and their prior of variance 1."""
    return np.linalg.inv(np.einsum("lcv,lcw->vw", weighed, weighed) + np.eye(weighed.shape[2]))


def _solve(theory: Theory, loads: Loads, kinds: tuple[str, ...], vector: Floats, whitening: Floats) -> Floats:
    """Return the vector with the likeliest departures for this whitening of the residuals."""
    free = theory.free_of(kinds)
    low, high = theory.bounds_of(free)

    def price(vector: Floats) -> float:
        residuals = residuals_of(theory, loads, vector)
        left = whitening @ residuals.left_mm[..., None]
        price = float((left**2).sum() + (vector[free] ** 2).sum())
        # Where the curve of a sensor turns back, what it shows has no bounds.
        is_possible = np.isfinite(price) and np.abs(residuals.moved_mm).max() < BEYOND_MM
        return price if is_possible else np.inf

    here = price(vector)
    for _ in range(STEPS if len(free) else 0):
        weighed = whitening @ _slopes(theory, loads, kinds, vector)
        left = (whitening @ residuals_of(theory, loads, vector).left_mm[..., None])[..., 0]
        step, _ = best_step(weighed, left, vector[free], 1.0, (low - vector[free], high - vector[free]))
        # Far from the truth, as with a wrong wiring, a whole step may lead to a worse place.
        for _ in range(HALVINGS):
            nearer = vector.copy()
            nearer[free] += step
            there = price(nearer)
            if there <= here:
                break
            step = step / 2
        else:
            break
        vector, here = nearer, there
        if np.abs(step).max() < CLOSE:
            break
    return vector


def _likely_errors(residuals: Residuals, about: LoadErrors, start: LoadErrors, freedom: float) -> LoadErrors:
    """Return the likely errors behind residuals with `freedom` degrees of freedom.

    They maximise the likelihood (Zhou, Hu, Qiao & Lange 2019, doi 10.1080/10618600.2018.1529601), where `about`
    counts as much as `PSEUDO_LOADS` loads.
    """
    is_measured, noise_mm = residuals.is_measured, residuals.noise_mm
    share = freedom / is_measured.sum()
    moved, left = np.moveaxis(residuals.moved_mm, 0, 2), residuals.left_mm[..., None]
    prior = np.array([about.placing_mm, about.force]) ** 2
    variance = np.array(astuple(start)) ** 2
    variance[2] = max(variance[2], float((noise_mm[is_measured] ** 2).mean()))
    for _ in range(UPDATES):
        inverse = np.linalg.inv(residuals.covariance_mm2(LoadErrors(*np.sqrt(variance).tolist())))
        pulled = inverse @ left
        pulls = ((moved.transpose(0, 2, 1) @ pulled) ** 2).sum(axis=(0, 2))
        traces = share * (moved * (inverse @ moved)).sum(axis=(0, 1))
        safe = np.maximum(variance[:2], np.finfo(np.float64).tiny)
        pulls, traces = pulls + PSEUDO_LOADS * prior / safe**2, traces + PSEUDO_LOADS / safe
        own = share * np.trace(inverse * is_measured[..., None], axis1=1, axis2=2).sum()
        variance[:2] *= np.sqrt(pulls / traces)
        variance[2] *= np.sqrt((pulled**2).sum() / own)
    return LoadErrors(*np.sqrt(variance).tolist())


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
