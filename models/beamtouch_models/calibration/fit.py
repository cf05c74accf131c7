"""The fit of a surface's departures from its scene to known loads, limited to those that the loads support.

Maximum a posteriori: least squares with a prior on each departure, of its plausible size. Kinds of departures are
added one by one, each only if it lowers the error of loads that are left out of the fit (PRESS, from the leverages;
Allen 1974, doi 10.1080/00401706.1974.10489157).
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from beamtouch_models.accuracy.model_prior import departed, stated_by
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.calibration.loads import Loads
from beamtouch_models.metadata import Departures, Metadata
from beamtouch_models.progress import Fraction
from beamtouch_models.scene import Scene

GAIN, POSITION_MM, FIXITY, RIGIDITY, BEND, OFFSET_NOISES = 0.04, 1.5, 0.1, 0.1, 0.03, 3.0
"""Standard deviations of plausible departures: relative gain, sensor position, fixity, relative rigidity, relative bend
of the characteristic at full travel, and offset in units of the noise of a sample."""
MAX_FIXITY = 0.9
WORTH = 0.95
"""A kind of departure is added if it lowers the error of left-out loads to at most this fraction."""
ROUNDS = 3
"""Largest number of times that the residual is estimated."""
MAX_INFLUENCES = 64
"""Number of influence matrices that are kept; it bounds their memory."""


@dataclass(frozen=True)
class Theory:
    """The surface as its scene and its model describe it."""

    physics: Scene
    sensor_mm: Floats
    prior: Prior
    max_deflection_mm: float
    influences: dict[tuple[float, ...], Floats] = field(default_factory=dict, repr=False, compare=False)
    """Influence matrices that were computed recently."""

    @classmethod
    def of(cls, physics: Scene, metadata: Metadata) -> "Theory":
        """Return the theory of a model."""
        sensor_mm = np.array([channel.position_mm for channel in metadata.layout])
        prior = Prior.of(physics, sensor_mm, metadata.noise.sample_mm)
        return cls(physics, sensor_mm, prior, metadata.max_deflection_mm)

    @cached_property
    def kinds(self) -> dict[str, slice]:
        """Kinds of departures with their places in the vector of all, which has units of their plausible sizes."""
        channels = len(self.sensor_mm)
        sizes = {"rigidity": 1, "gain": channels, "position": channels, "curve": 1, "fixity": 2, "offset": channels}
        starts = np.cumsum([0, *sizes.values()]).tolist()
        kinds = {name: slice(start, start + size) for (name, size), start in zip(sizes.items(), starts, strict=False)}
        if not any(self.hinged):
            del kinds["fixity"]
        return kinds

    @cached_property
    def hinged(self) -> tuple[bool, bool]:
        """Whether the first and the last support can have a fixity."""
        supports = self.physics.beam.support_list
        if not supports:
            return False, False
        return supports[0].kind == "simple", len(supports) > 1 and supports[-1].kind == "simple"

    @property
    def size(self) -> int:
        """Length of the vector of all departures."""
        return 4 + 3 * len(self.sensor_mm)

    def departures(self, vector: Floats) -> Departures:
        """Return the departures that a vector encodes."""
        channels = len(self.sensor_mm)
        rigidity, gain, position, curve, fixity, offset = np.split(
            vector, np.cumsum([1, channels, channels, 1, 2]).tolist()
        )
        left, right = (
            float(np.clip(FIXITY * value, 0.0, MAX_FIXITY)) if hinged else 0.0
            for value, hinged in zip(fixity, self.hinged, strict=True)
        )
        return Departures(
            position_offset_mm=(POSITION_MM * position).tolist(),
            gain=np.exp(GAIN * gain).tolist(),
            offset_mm=(OFFSET_NOISES * self.prior.noise_mm * offset).tolist(),
            curve_per_mm=float(BEND / self.max_deflection_mm * curve[0]),
            fixity=(left, right),
            rigidity=float(np.exp(RIGIDITY * rigidity[0])),
        )

    def prior_with(self, departures: Departures) -> Prior:
        """Return the prior of the surface with departures."""
        return departed(self.prior, self.physics, self.sensor_mm, departures)

    def stated_mm(self, vector: Floats, loads: Loads) -> Floats:
        """Return the deflections that its sensors measure under loads, (loads, channels)."""
        departures = self.departures(vector)
        # Gains, offsets and the curve do not change the beam, so its influence matrix can often be reused.
        ungained = departures.model_copy(update={"gain": [1.0] * len(departures.gain)})
        parts = (ungained.rigidity, *ungained.fixity, *ungained.position_offset_mm, *loads.position_mm.tolist())
        if parts not in self.influences:
            if len(self.influences) >= MAX_INFLUENCES:
                self.influences.clear()
            self.influences[parts] = self.prior_with(ungained).influence_at(loads.position_mm)
        deflection_mm = loads.force_n[:, None] * np.array(departures.gain) * self.influences[parts]
        return stated_by(departures, deflection_mm)


@dataclass(frozen=True)
class Fit:
    """A fit of some kinds of departures."""

    theory: Theory
    kinds: tuple[str, ...]
    vector: Floats
    residual_mm: float
    """Standard deviation of the residuals beyond the noise of the recording."""
    scatter_mm: float
    """Standard deviation of the residuals, per degree of freedom."""
    freedom: float
    """Remaining degrees of freedom: deflections minus the departures that they determine."""
    left_out_mm: Floats
    """(loads, channels) measured minus predicted, each load left out of the fit; NaN without a measurement."""
    covariance: Floats
    """(departures, departures) covariance of the vector, in its units; 0 if not fitted."""

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


def fit(
    theory: Theory, loads: Loads, kinds: tuple[str, ...], start: Floats | None = None, *, rounds: int = ROUNDS
) -> Fit:
    """Fit some kinds of departures; the others stay as in the scene."""
    free = np.concatenate([np.arange(theory.size)[theory.kinds[kind]] for kind in kinds]) if kinds else np.arange(0)
    vector = np.zeros(theory.size) if start is None else start.copy()
    vector[np.setdiff1d(np.arange(theory.size), free)] = 0.0
    low, high = _bounds(theory, free)
    stated = np.isfinite(loads.stated_mm)
    unexplained, jacobian = 0.0, np.zeros((int(stated.sum()), len(free)))

    def residuals(part: Floats) -> Floats:
        vector[free] = part
        left = (loads.stated_mm - theory.stated_mm(vector, loads))[stated]
        return np.concatenate([left / np.hypot(loads.deviation_mm[stated], unexplained), part])

    for _ in range(rounds):
        if len(free):
            # The default method, "trf", cannot leave a start on a bound, and fixities start at 0.
            start_at = np.clip(vector[free], low, high)
            found = least_squares(residuals, start_at, bounds=(low, high), method="dogbox", ftol=1e-5, max_nfev=30)
            vector[free], jacobian = found.x, found.jac[: stated.sum()]
        left = (loads.stated_mm - theory.stated_mm(vector, loads))[stated]
        # Only departures that the data determine, rather than the prior, use up degrees of freedom.
        freedom = max(1.0, len(left) - float(np.trace(_hat(jacobian))))
        variance = float((left**2).sum() / freedom)
        before, unexplained = unexplained, float(np.sqrt(max(0.0, variance - (loads.deviation_mm[stated] ** 2).mean())))
        if unexplained == before:
            break
    weight = np.hypot(loads.deviation_mm[stated], unexplained)
    left_out = np.full(loads.stated_mm.shape, np.nan)
    left_out[stated] = _left_out(left / weight, jacobian, np.nonzero(stated)[0]) * weight
    covariance = np.zeros((theory.size, theory.size))
    covariance[np.ix_(free, free)] = np.linalg.inv(jacobian.T @ jacobian + np.eye(len(free)))
    return Fit(theory, kinds, vector.copy(), unexplained, float(np.sqrt(variance)), freedom, left_out, covariance)


def supported_fit(theory: Theory, loads: Loads, progress: Fraction) -> Fit:
    """Fit the kinds of departures that lower the error of left-out loads."""
    best, open_kinds = fit(theory, loads, ()), list(theory.kinds)
    while open_kinds:
        progress(1 - len(open_kinds) / len(theory.kinds))
        trials = [fit(theory, loads, (*best.kinds, kind), best.vector) for kind in open_kinds]
        trial = min(trials, key=lambda one: one.error_mm)
        if trial.error_mm > WORTH * best.error_mm:
            break
        best = trial
        open_kinds.remove(trial.kinds[-1])
    return best


def _bounds(theory: Theory, free: Indices) -> tuple[Floats, Floats]:
    low, high = np.full(theory.size, -8.0), np.full(theory.size, 8.0)
    if "fixity" in theory.kinds:
        low[theory.kinds["fixity"]], high[theory.kinds["fixity"]] = 0.0, MAX_FIXITY / FIXITY
    return low[free], high[free]


def _hat(jacobian: Floats) -> Floats:
    """Return the hat matrix of the residuals, with priors of variance 1 on the departures."""
    matrix: Floats = jacobian @ np.linalg.solve(jacobian.T @ jacobian + np.eye(jacobian.shape[1]), jacobian.T)
    return matrix


def _left_out(residual: Floats, jacobian: Floats, load: Indices) -> Floats:
    """Return the residuals of each load when all its channels are left out of the fit."""
    hat, left_out = _hat(jacobian), residual.copy()
    for one in np.unique(load):
        rows = np.flatnonzero(load == one)
        left_out[rows] = np.linalg.solve(np.eye(len(rows)) - hat[np.ix_(rows, rows)], residual[rows])
    return left_out
