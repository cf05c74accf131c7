"""The fit of some kinds of departures of a surface from its scene, and of what a recording adds, to known loads.

Maximum a posteriori: generalised least squares with a prior on each departure, of its plausible size. The covariance
of the residuals holds the noise of the recording, the errors of position and force of each load, and a residual that
neither explains. The residual is as large as makes the weighted squares equal to their degrees of freedom (Paule &
Mandel 1982, doi 10.6028/jres.087.022). How large each kind is, `choice` says.
"""

from collections.abc import Mapping
from dataclasses import astuple, dataclass
from types import MappingProxyType

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.calibration.nominal_surface import Fitted, NominalSurface, best_step
from beamtouch_models.design.calibration.recordings import Loads
from beamtouch_models.design.calibration.session import Session
from beamtouch_models.runtime.health.residuals import LoadErrors, Residuals, leave_out

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
EACH_PLAUSIBLE: Mapping[str, float] = MappingProxyType({})
"""Each kind has its plausible size."""
UPDATES = 10
"""Number of improvements of the errors in each round of a fit. A round starts from the errors of the previous one."""


@dataclass(frozen=True)
class Fit(Fitted):
    """A fit of some kinds of departures to known loads."""

    session: Session
    errors: LoadErrors
    """Errors of the recording as the fit finds them, and the residual beyond all of them."""
    scatter: float
    """Standard deviation of the residuals, per degree of freedom, in units of the errors that the recording states."""
    freedom: float
    """Remaining degrees of freedom: deflections minus the departures that they determine."""
    left_out_mm: Floats
    """(loads, channels) measured minus predicted, each load left out of the fit; NaN without a measurement."""
    log_evidence: float
    """Logarithm of the probability of the recording by these kinds, but for a constant."""
    sizes: Mapping[str, float]
    """How large each kind is, over what is plausible, where that is not 1."""

    @property
    def prediction_mm(self) -> float:
        """Root mean square error of the predicted deflections, from that of the departures."""
        slopes = self.session.slopes(self.vector, self.kinds)
        measured = np.isfinite(self.session.loads.measured_mm).sum()
        return float(np.sqrt(np.einsum("lcv,vw,lcw->", slopes, self.covariance, slopes) / measured))

    @property
    def error_mm(self) -> float:
        """Root mean square of the deflections of left-out loads."""
        return float(np.sqrt(np.nanmean(self.left_out_mm**2)))


def fit(
    nominal: NominalSurface,
    loads: Loads,
    kinds: tuple[str, ...],
    start: Floats | None = None,
    *,
    rounds: int = ROUNDS,
    sizes: Mapping[str, float] = EACH_PLAUSIBLE,
) -> Fit:
    """Fit some kinds of departures; the others stay as in the scene.

    `sizes` has how large a kind is, over what is plausible, where that is not 1.
    """
    session = Session(nominal, loads)
    free, about, vector, errors = session.places_of(kinds), session.about(sizes), np.zeros(session.size), loads.errors
    if start is not None:
        vector[free] = start[free]
    residuals = session.residuals(vector)
    measured = int(residuals.is_measured.sum())
    for _ in range(rounds):
        vector = _solve(session, kinds, about, vector, residuals.whitening(errors))
        residuals, slopes = session.residuals(vector), session.slopes(vector, kinds)[..., free]
        # Only departures that the data determine, rather than the prior, use up degrees of freedom.
        weighed = residuals.whitening(errors) @ slopes
        own = _covariance(weighed, about[free])
        freedom = max(1.0, measured - float(np.einsum("lcv,vw,lcw->", weighed, own, weighed)))
        errors = _likely_errors(residuals, loads.errors, errors, freedom)
    whitening, as_stated = residuals.whitening(errors), residuals.whitening(loads.errors)
    weighed, residual_mm = whitening @ slopes, residuals.left_mm[..., None]
    own = _covariance(weighed, about[free])
    left_out = np.linalg.solve(whitening, leave_out((whitening @ residual_mm)[..., 0], weighed, own)[..., None])
    covariance = np.zeros((session.size, session.size))
    covariance[np.ix_(free, free)] = own
    return Fit(
        nominal,
        kinds,
        vector,
        covariance,
        session,
        errors,
        scatter=float(np.sqrt(((as_stated @ residual_mm) ** 2).sum() / freedom)),
        freedom=freedom,
        left_out_mm=np.where(residuals.is_measured, left_out[..., 0], np.nan),
        log_evidence=_log_evidence(whitening, residuals, vector, own, loads.errors, errors),
        sizes=sizes,
    )


def _log_evidence(
    whitening: Floats, residuals: Residuals, vector: Floats, covariance: Floats, about: LoadErrors, errors: LoadErrors
) -> float:
    """Return the logarithm of the probability of a recording by what was fitted, but for a constant.

    It is that of all departures that their priors allow (Laplace's approximation; MacKay 1992, doi
    10.1162/neco.1992.4.3.415), so departures that gain little cost more than they bring.
    """
    whitened = np.einsum("lij,lj->li", whitening, residuals.left_mm)
    _, log_weights = np.linalg.slogdet(whitening)
    _, log_volume = np.linalg.slogdet(covariance)
    fitted, stated = _own(errors), _own(about)
    safe = np.maximum(fitted, np.finfo(np.float64).tiny)
    of_errors = -PSEUDO_LOADS / 2 * float((stated / safe + np.log(safe)).sum())
    return float(log_weights.sum() - ((whitened**2).sum() + vector @ vector - log_volume) / 2) + of_errors


def _own(errors: LoadErrors) -> Floats:
    """Return the variances of places and forces, (2,)."""
    return np.array(astuple(errors)[:2]) ** 2


def _covariance(weighed: Floats, about: Floats) -> Floats:
    """Return the covariance of the fitted departures, from their whitened slopes and the deviations of their priors."""
    return np.linalg.inv(np.einsum("lcv,lcw->vw", weighed, weighed) + np.diag(about**-2))


def _solve(session: Session, kinds: tuple[str, ...], about: Floats, vector: Floats, whitening: Floats) -> Floats:
    """Return the vector with the likeliest entries for this whitening of the residuals."""
    free = session.places_of(kinds)
    low, high = session.bounds_of(free)

    def price(vector: Floats) -> float:
        residuals = session.residuals(vector)
        whitened = whitening @ residuals.left_mm[..., None]
        price = float((whitened**2).sum() + ((vector[free] / about[free]) ** 2).sum())
        # Where the curve of a sensor turns back, what it shows has no bounds.
        is_possible = np.isfinite(price) and np.abs(residuals.moved_mm).max() < BEYOND_MM
        return price if is_possible else np.inf

    here = price(vector)
    for _ in range(STEPS if len(free) else 0):
        weighed = whitening @ session.slopes(vector, kinds)[..., free]
        whitened = np.einsum("lij,lj->li", whitening, session.residuals(vector).left_mm)
        step, _ = best_step(weighed, whitened, vector[free], about[free], (low - vector[free], high - vector[free]))
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
    moved, residual_mm = np.moveaxis(residuals.moved_mm, 0, 2), residuals.left_mm[..., None]
    prior = _own(about)
    # Loads are placed as well along each axis.
    each = [0] * (moved.shape[2] - 1) + [1]
    variance = np.array(astuple(start)) ** 2
    variance[2] = max(variance[2], float((noise_mm[is_measured] ** 2).mean()))
    for _ in range(UPDATES):
        inverse = np.linalg.inv(residuals.covariance_mm2(LoadErrors(*np.sqrt(variance).tolist())))
        pulled = inverse @ residual_mm
        pulls = np.bincount(each, ((moved.transpose(0, 2, 1) @ pulled) ** 2).sum(axis=(0, 2)))
        traces = np.bincount(each, share * (moved * (inverse @ moved)).sum(axis=(0, 1)))
        safe = np.maximum(variance[:2], np.finfo(np.float64).tiny)
        pulls, traces = pulls + PSEUDO_LOADS * prior / safe**2, traces + PSEUDO_LOADS / safe
        own = share * np.trace(inverse * is_measured[..., None], axis1=1, axis2=2).sum()
        variance[:2] *= np.sqrt(pulls / traces)
        variance[2] *= np.sqrt((pulled**2).sum() / own)
    return LoadErrors(*np.sqrt(variance).tolist())
