"""The prior of a surface: everything that an estimator or an accuracy limit is made from.

Physics ends here: a scene, a calibrated beam and a measured beam all become an influence matrix. The prior of the force
is the range that the scene states; estimators add tails for improbable forces beyond it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.runtime.error_model import variance_mm2, whitening

TAIL = 0.01
"""Share of forces that an estimator expects outside the range of its scene, half of them below and half above it."""
MAX_FORCE_RATIO = 10.0
"""Largest force that an estimator considers, over the largest of its scene."""
STEP = 3.0
"""Ratio of forces over which the density of `cautious_forces` changes beyond the range."""
BELOW, ABOVE = (4.0, 1.7), (0.5, 0.1)
"""Densities of `cautious_forces` below and above the range, over that within it, from the smallest force up; about one
over the force below, and one over its square above."""
TABLE = 2001
"""Number of load positions in an influence table."""
EXACT_BELOW = 3e-4
"""Noise over the largest deflection below which the table is not exact enough: at its worst it is off by about a tenth
of this noise."""


@dataclass(frozen=True)
class Piece:
    """A share of all forces, spread evenly over a range; equal ends: one known force."""

    low_n: float
    high_n: float
    share: float


Forces = tuple[Piece, ...]
"""Pieces side by side, whose shares sum to 1."""


def forces_of(force_n: tuple[float, float], tail: float = TAIL) -> Forces:
    """Return a prior of the force: its range, and `tail` of the mass from 0 to MAX_FORCE_RATIO times its end."""
    low, high = force_n
    core = Piece(low, high, 1.0 - tail)
    if not tail:
        return (core,)
    return Piece(0.0, low, tail / 2), core, Piece(high, MAX_FORCE_RATIO * high, tail / 2)


def cautious_forces(force_n: tuple[float, float]) -> Forces:
    """Return a prior of an open force for intervals, which leans on neither end of the range.

    With `forces_of`, hardly any interval holds the position of a force that is a little outside the range, because
    there is always a place that a force within the range explains.
    """
    low, high = force_n
    ends = (0.0, low / STEP, low, high, STEP * high, MAX_FORCE_RATIO * high)
    shares = [
        density * (most - least)
        for density, least, most in zip((*BELOW, 1.0, *ABOVE), ends[:-1], ends[1:], strict=True)
    ]
    return tuple(
        Piece(least, most, share / sum(shares)) for share, least, most in zip(shares, ends[:-1], ends[1:], strict=True)
    )


@dataclass(frozen=True)
class SampleErrors:
    """Errors of a sample, as standard deviations, the same for every channel."""

    noise_mm: float
    gain: float = 0.0
    """Relative gain error that is left after calibration."""
    zero_mm: float = 0.0
    mounting_mm: float = 0.0
    """Error of a sensor's position along the beam."""
    min_noise_mm: float | None = None
    """Noise of a sample of the most readings; None: `noise_mm`."""
    rate_hz: float = 100.0
    """Readings per second."""
    readings: int = 24
    """Readings in the means for which the threshold of misfit holds."""

    def variance_mm2(self, deflection_mm: Floats, moved_mm: Floats | float = 0.0) -> Floats:
        """Return the variances of samples (..., channels); arguments as those of `error_model.variance_mm2`."""
        return variance_mm2(deflection_mm, self.noise_mm, self.gain, self.zero_mm, moved_mm)


def _as_it_is(deflection_mm: Floats) -> Floats:
    return deflection_mm


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known before a sample: the range of contacts, uniform in position and force, influence and errors."""

    length_mm: float
    position_mm: tuple[float, float]
    force_n: tuple[float, float]
    """Equal ends: the force is known."""
    noise_mm: float
    """Standard deviation of a sample, per channel, without the floor."""
    channels: int
    influence_at: Callable[[Floats], Floats]
    """From load positions in mm (loads,) to the influence matrix (loads, channels) in mm/N."""
    measured: Callable[[Floats], Floats] = _as_it_is
    """From deflections (samples, channels) that are linear in the force to measured deflections."""
    gain: ArrayLike = 0.0
    """(channels,) or one number, standard deviation of the relative gain error that is left after calibration."""
    zero_mm: ArrayLike = 0.0
    """(channels,) or one number, standard deviation of the zero."""
    uncertain_at: Callable[[Floats], Floats] | None = None
    """From load positions (loads,) to the standard deviation of the influence (loads, channels) in mm/N that the
    mounting of the sensors leaves, of either sign; None: their positions are exact."""

    @classmethod
    def of(cls, influence: InfluenceFunction, sensor_mm: Floats, noise_mm: float) -> Self:
        """Prior of a structure with perfect sensors at `sensor_mm` (channels,) and `noise_mm` per sample."""
        return cls(
            length_mm=influence.length_mm,
            position_mm=influence.position_mm,
            force_n=influence.force_n,
            noise_mm=noise_mm,
            channels=len(sensor_mm),
            influence_at=partial(influence.at, np.array(sensor_mm)),  # a copy: the caller may change its array
        )

    @classmethod
    def real(cls, influence: InfluenceFunction, sensor_mm: Floats, errors: SampleErrors) -> Self:
        """Like `of`, with all errors of samples."""
        mounting_mm = errors.mounting_mm
        at_mm = np.array(sensor_mm)
        uncertain_at = partial(influence.deviation, at_mm, tolerance_mm=mounting_mm) if mounting_mm else None
        perfect = cls.of(influence, sensor_mm, errors.noise_mm)
        return replace(perfect, gain=errors.gain, zero_mm=errors.zero_mm, uncertain_at=uncertain_at)

    def sampled(self, position_mm: Floats, force_n: Floats) -> tuple[Floats, Floats]:
        """Return true deflections of contacts and the standard deviation of their samples, (contacts, channels) in mm.

        Positions and forces are (contacts,).
        """
        clean = force_n[:, None] * self.influence_at(position_mm)
        moved = 0.0 if self.uncertain_at is None else force_n[:, None] * self.uncertain_at(position_mm)
        return clean, self.deviation_mm(clean, moved)

    def draw(self, position_mm: Floats, force_n: Floats, rng: np.random.Generator) -> Floats:
        """Return samples of contacts with all their errors, (contacts, channels) in mm; arguments as `sampled`."""
        clean, deviation = self.sampled(position_mm, force_n)
        samples: Floats = clean + rng.normal(size=clean.shape) * deviation
        return samples

    def deviation_mm(self, deflection_mm: Floats, moved_mm: Floats | float = 0.0) -> Floats:
        """Return the standard deviation of measurements of deflections (..., channels), in mm, floor included.

        `moved_mm` is that of the deflections which the mounting of the sensors leaves.
        """
        deviation: Floats = np.sqrt(variance_mm2(deflection_mm, self.noise_mm, self.gain, self.zero_mm, moved_mm))
        return deviation

    @property
    def rest_mm(self) -> Floats:
        """Standard deviation of a sample at rest, (channels,) in mm."""
        return self.deviation_mm(np.zeros(self.channels))

    def deviation_in_table_mm(self, position_mm: Floats, force_n: Floats | float) -> Floats:
        """Return the deviation of samples of contacts, with all errors, from the tables.

        Places are (contacts,), forces (contacts, 1).
        """
        moved = 0.0 if self.uncertainty is None else force_n * self.uncertainty(position_mm)
        return self.deviation_mm(force_n * self.table(position_mm), moved)

    def whitening(self, deflection_mm: Floats, valid: Bools | None = None) -> Floats:
        """Return the whitening (samples, channels, channels) of samples with the prior's own noise, in 1/mm.

        Parameters and errors are those of `error_model.whitening`.
        """
        covariance = np.eye(self.channels) * self.noise_mm**2
        return whitening(deflection_mm.astype(np.float64), covariance, self.gain, self.zero_mm, valid)

    @property
    def force_is_known(self) -> bool:
        """Whether the force is known."""
        return self.force_n[0] == self.force_n[1]

    @cached_property
    def table(self) -> CubicSpline:
        """Interpolated influence; beam elements take much longer.

        It is off by at most 2e-6 of the largest value for any shipped scene, and by 3e-5 right at a sensor under a beam
        with shear, which has a kink there.
        """
        grid = np.linspace(*self.position_mm, TABLE)
        return CubicSpline(grid, self.influence_at(grid))

    @cached_property
    def largest_mm(self) -> float:
        """Largest deflection."""
        return self.force_n[1] * float(np.abs(self.table(self.table.x)).max())

    def influence_within_noise(self, position_mm: Floats) -> Floats:
        """Return `influence_at` positions (loads,), from the table where the noise hides its error."""
        is_exact = self.noise_mm < EXACT_BELOW * self.largest_mm
        influence: Floats = self.influence_at(position_mm) if is_exact else self.table(position_mm)
        return influence

    @cached_property
    def uncertainty(self) -> CubicSpline | None:
        """Interpolated deviation of the influence; None if the sensors' positions are exact."""
        grid = np.linspace(*self.position_mm, TABLE)
        return None if self.uncertain_at is None else CubicSpline(grid, self.uncertain_at(grid))

    def without(self, *missing: int) -> Self:
        """Return the prior of the surface without some channels; `measured` remains that of all."""
        kept = np.setdiff1d(np.arange(self.channels), missing)
        influence = partial(_columns, self.influence_at, kept)
        uncertain = None if self.uncertain_at is None else partial(_columns, self.uncertain_at, kept)
        gain, zero_mm = (np.broadcast_to(value, self.channels)[kept] for value in (self.gain, self.zero_mm))
        return replace(
            self,
            channels=len(kept),
            influence_at=influence,
            gain=gain,
            zero_mm=zero_mm,
            uncertain_at=uncertain,
        )


def _columns(matrix_at: Callable[[Floats], Floats], kept: Indices, load_mm: Floats) -> Floats:
    return matrix_at(load_mm)[:, kept]
