"""The prior of a surface: everything that an estimator or an accuracy limit is made from.

Physics ends here: a scene, a calibrated beam and a measured beam all become influence at places, and errors. The prior
of the force is the range that the scene states; estimators add tails for improbable forces beyond it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_common.outline import axes_of
from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.design.physics.place_table import PlaceTable
from beamtouch_models.places import Extent, grid_of
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.force_range import ForceRange

TAIL = 0.01
"""Share of forces that an estimator expects outside the range of its scene, half of them below and half above it."""
MAX_FORCE_RATIO = 10.0
"""Largest force that an estimator considers, over the largest of its scene."""
STEP = 3.0
"""Ratio of forces over which the density of `interval_forces` changes beyond the range."""
BELOW, ABOVE = (4.0, 1.7), (0.5, 0.1)
"""Densities of `interval_forces` of an open force below and above the range, over that within it, from the smallest
force up; about one over the force below, and one over its square above."""
SHOULDER = 0.2
"""Length by which `interval_forces` of a known force reach beyond either end of the range, over half of it."""
EXACT_BELOW = 3e-4
"""Noise over the largest deflection below which the table is not exact enough: at its worst it is off by about a tenth
of this noise."""


@dataclass(frozen=True)
class Piece:
    """A share of all forces, spread evenly over a range; equal ends: one exact force."""

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


def interval_forces(force_n: tuple[float, float], tail: float = TAIL) -> Forces:
    """Return a prior of the force for intervals, which leans on neither end of the range.

    With `forces_of`, hardly any interval holds the position of a force at an end of the range, or a little outside it,
    because there is always a place that a force within the range explains. So a narrow range is a little wider here,
    between tails as thin as there. As it opens, the tails rise to those of a force that may as well be outside, and the
    range ends where it is stated.
    """
    stated = ForceRange(*force_n)
    opened, reach = stated.openness, SHOULDER * (1 - stated.openness) * stated.half_n
    low, high = force_n[0] - reach, force_n[1] + reach
    ends = (0.0, force_n[0] / STEP, low, high, STEP * force_n[1], MAX_FORCE_RATIO * force_n[1])
    if low == high:
        return forces_of(force_n, tail)
    # Densities over that within the range, of thin tails and of those of an open force.
    within = (1 - tail) / (high - low)
    thin = [tail / 2 / low / within] * 2 + [tail / 2 / (ends[-1] - high) / within] * 2
    below, above = (
        [thin_one ** (1 - opened) * open_one**opened for thin_one, open_one in zip(part, wide, strict=True)]
        for part, wide in ((thin[:2], BELOW), (thin[2:], ABOVE))
    )
    shares = [
        density * (most - least)
        for density, least, most in zip((*below, 1.0, *above), ends[:-1], ends[1:], strict=True)
    ]
    return tuple(
        Piece(least, most, share / sum(shares)) for share, least, most in zip(shares, ends[:-1], ends[1:], strict=True)
    )


def _as_it_is(deflection_mm: Floats) -> Floats:
    return deflection_mm


@dataclass(frozen=True, eq=False)
class Prior:
    """Knowledge before a sample: the contacts, uniform in place and force, influence and errors."""

    extent: Extent
    """Extent of the contacts."""
    diagonal_mm: float
    """Length of which errors are a percentage: that of a beam."""
    force_n: tuple[float, float]
    """Equal ends: the force is exact."""
    errors: Errors
    channels: int
    influence_at: Callable[[Floats], Floats]
    """From places (places, axes) in mm to the influence matrix (places, channels) in mm/N."""
    variance_at: Callable[[Floats], Floats] | None = None
    """From places (places, axes) to the variance of the influence (places, channels) in (mm/N)^2 that the mounting of
    the sensors and the interpolation of a table leave; None: it is exact."""
    shared: Floats | None = None
    """(channels, sources) loadings of that variance, see `Interpolation`; None: channels err independently."""
    measured: Callable[[Floats], Floats] = _as_it_is
    """From deflections (samples, channels) that are linear in the force to measured deflections."""

    @classmethod
    def of(cls, influence: InfluenceFunction, sensor_mm: Floats, errors: Errors) -> Self:
        """Prior of a structure with sensors at places (channels, axes)."""
        at_mm, mounting_mm = np.array(sensor_mm), errors.mounting_mm  # a copy: the caller may change its array
        return cls(
            extent=influence.extent,
            diagonal_mm=influence.diagonal_mm,
            force_n=influence.force_n,
            errors=errors,
            channels=len(at_mm),
            influence_at=partial(influence.at, at_mm),
            variance_at=partial(influence.variance, at_mm, tolerance_mm=mounting_mm)
            if influence.is_uncertain(mounting_mm)
            else None,
            shared=influence.shared(at_mm),
        )

    def sampled(self, place_mm: Floats, force_n: Floats) -> tuple[Floats, Floats]:
        """Return true deflections of contacts and the standard deviation of their samples, (contacts, channels) in mm.

        Places are (contacts, axes), forces (contacts,).
        """
        clean = force_n[:, None] * self.influence_at(place_mm)
        mounting = 0.0 if self.variance_at is None else force_n[:, None] ** 2 * self.variance_at(place_mm)
        return clean, self.errors.deviation_mm(clean, mounting)

    def draw(self, place_mm: Floats, force_n: Floats, rng: np.random.Generator) -> Floats:
        """Return samples of contacts with all their errors, (contacts, channels) in mm; arguments as `sampled`."""
        return self.with_errors(place_mm, force_n, rng.normal(size=(len(place_mm), self.channels)))

    def with_errors(self, place_mm: Floats, force_n: Floats, normal: Floats) -> Floats:
        """Return the samples of `draw` for independent errors of variance 1, `normal` (contacts, channels)."""
        clean, deviation = self.sampled(place_mm, force_n)
        if self.shared is None:
            return np.asarray(clean + normal * deviation)
        moved_mm = self._moved_mm(place_mm, force_n)
        covariance = moved_mm[:, :, None] * self._correlation * moved_mm[:, None, :]
        each = np.arange(self.channels)
        covariance[:, each, each] = deviation**2
        return np.asarray(clean + np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), normal))

    def moved(self, place_mm: Floats, force_n: Floats, normal: Floats) -> Floats:
        """Return what mounting and interpolation add to deflections of contacts, arguments as `with_errors`."""
        moved_mm = self._moved_mm(place_mm, force_n)
        return moved_mm * (normal @ np.linalg.cholesky(self._correlation).T)

    def _moved_mm(self, place_mm: Floats, force_n: Floats) -> Floats:
        """Return the standard deviation (contacts, channels) that mounting and interpolation leave."""
        if self.variance_at is None:
            return np.zeros((len(place_mm), self.channels))
        return np.asarray(force_n[:, None] * np.sqrt(self.variance_at(place_mm)))

    @property
    def _correlation(self) -> Floats:
        """(channels, channels) of what mounting and interpolation leave."""
        if self.shared is None:
            return np.eye(self.channels)
        correlation: Floats = self.shared @ self.shared.T
        np.fill_diagonal(correlation, 1.0)
        return correlation

    @property
    def rest_mm(self) -> Floats:
        """Standard deviation of a sample at rest, (channels,) in mm."""
        return self.errors.deviation_mm(np.zeros(self.channels))

    def tabled_deviation_mm(self, place_mm: Floats, force_n: Floats | float) -> Floats:
        """Return the deviation of samples of contacts, with all errors, from the tables.

        Places are (contacts, axes), forces (contacts, 1).
        """
        mounting = 0.0 if self.variance_table is None else force_n**2 * self.variance_table(place_mm)
        return self.errors.deviation_mm(force_n * self.influence_table(place_mm), mounting)

    def at_noise(self, noise_mm: float) -> Self:
        """Return the prior of samples with another noise; without any, all errors are 0."""
        if noise_mm > 0:
            return replace(self, errors=replace(self.errors, noise_mm=noise_mm))
        return self.with_noise_alone(0.0)

    def with_floor(self, gain: ArrayLike, zero_mm: ArrayLike) -> Self:
        """Return the prior of samples with other errors of gains and zeros, (channels,) or one number each."""
        return replace(self, errors=replace(self.errors, gain=gain, zero_mm=zero_mm))

    def with_noise_alone(self, noise_mm: float) -> Self:
        """Return the prior of samples whose only error is a noise."""
        return replace(self, errors=Errors(noise_mm), variance_at=None, shared=None)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes."""
        return axes_of(self.extent.axes)

    @property
    def force_range(self) -> ForceRange:
        """The range of forces as evidence."""
        return ForceRange(*self.force_n)

    @cached_property
    def influence_table(self) -> PlaceTable:
        """Interpolated influence; beam elements take much longer."""
        return PlaceTable.over(self.extent, self.influence_at)

    @cached_property
    def variance_table(self) -> PlaceTable | None:
        """Interpolated variance of the influence; None if the places of the sensors are exact."""
        return None if self.variance_at is None else PlaceTable.over(self.extent, self.variance_at, least=0.0)

    @cached_property
    def largest_mm(self) -> float:
        """Largest deflection."""
        return self.force_n[1] * float(np.abs(self.influence_table.values).max())

    def influence_within_noise(self, place_mm: Floats) -> Floats:
        """Return `influence_at` places (places, axes), from the table where the noise hides its error."""
        is_exact = self.errors.noise_mm < EXACT_BELOW * self.largest_mm
        return self.influence_at(place_mm) if is_exact else self.influence_table(place_mm)

    def influence_in(self, ticks_mm: Sequence[Floats]) -> tuple[Floats, Floats | None]:
        """Return `influence_within_noise` and its variance on grids, (grids, places, channels) each.

        `ticks_mm` are the coordinates along each axis, arrays (grids, ticks).
        """
        variance = None if self.variance_table is None else self.variance_table.on_grids(ticks_mm)
        if self.errors.noise_mm >= EXACT_BELOW * self.largest_mm:
            return self.influence_table.on_grids(ticks_mm), variance
        places = np.concatenate([grid_of(list(ticks)) for ticks in zip(*ticks_mm, strict=True)])
        return self.influence_at(places).reshape(len(ticks_mm[0]), -1, self.channels), variance

    def without(self, *missing: int) -> Self:
        """Return the prior of the surface without some channels; `measured` remains that of all."""
        working = np.setdiff1d(np.arange(self.channels), missing)
        return replace(
            self,
            channels=len(working),
            errors=self.errors.take(working, self.channels),
            influence_at=partial(_columns, self.influence_at, working),
            variance_at=None if self.variance_at is None else partial(_columns, self.variance_at, working),
            shared=None if self.shared is None else self.shared[working],
        )


def _columns(matrix_at: Callable[[Floats], Floats], kept: Indices, place_mm: Floats) -> Floats:
    return matrix_at(place_mm)[:, kept]
