"""Means of readings with their uncertainty: what a chain of filters gives."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.readings import FloatArray


class Found(NamedTuple):
    """The place where a beam that swings will rest, or is just after a touch, as the mean of some readings."""

    mean_mm: FloatArray
    """Shape (channels,); NaN of a channel that is missing in the newest reading."""
    readings: int
    """Number of readings in it."""
    excess_mm2: FloatArray
    """Its covariance beyond the noise of that mean, shape (channels, channels); 0 of missing channels."""
    is_rest: bool = True
    """True if the beam will rest there."""


@dataclass(frozen=True)
class Filtered:
    """Means of readings and their uncertainty."""

    mean_mm: FloatArray
    """Shape (readings, channels); NaN where a channel has no value."""
    relative_variance: FloatArray
    """Variance of the white noise of each mean, relative to that of a reading; 1/n for a mean of n readings."""
    noise_mm: FloatArray | None
    """Standard deviation of a reading, shape (channels,); None if it is not known."""
    moves: NDArray[np.bool_]
    """True where the readings scatter more than their noise explains, shape (readings,); not if it is unknown."""
    lags: NDArray[np.bool_]
    """True where the newest readings are apart from a long mean that does not move, shape (readings,)."""
    excess_mm2: FloatArray
    """Covariance beyond that of the noise, of the means that move or lag, shape (uncertain, channels, channels)."""
    found: NDArray[np.bool_]
    """True where the mean is the rest about which the beam swings, shape (readings,)."""

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return the means of successive readings as one."""
        if len(parts) == 1:
            return parts[0]
        return cls(
            np.concatenate([part.mean_mm for part in parts]),
            np.concatenate([part.relative_variance for part in parts]),
            parts[0].noise_mm,
            np.concatenate([part.moves for part in parts]),
            np.concatenate([part.lags for part in parts]),
            np.concatenate([part.excess_mm2 for part in parts]),
            np.concatenate([part.found for part in parts]),
        )

    def replaced(self, found: Sequence[tuple[int, Found]]) -> Self:
        """Return the means, of which some that move are replaced: by their rows, and where that is less uncertain."""
        rows = np.array([row for row, _ in found])
        means = np.array([rest.mean_mm for _, rest in found])
        shares = np.array([[1 / rest.readings] for _, rest in found])
        rests_mm2 = np.array([rest.excess_mm2 for _, rest in found])
        there, place = ~np.isnan(self.mean_mm[rows]), np.cumsum(self.uncertain)[rows] - 1
        noise_mm2 = 0.0 if self.noise_mm is None else self.noise_mm**2

        shares_more = np.where(np.isnan(means), 0.0, shares) - np.where(there, self.relative_variance[rows], 0.0)
        excesses_more_mm2 = np.trace(rests_mm2 - self.excess_mm2[place], axis1=1, axis2=2)
        better = (shares_more * noise_mm2).sum(axis=1) + excesses_more_mm2 < 0
        better &= ~(np.isnan(means) & there).any(axis=1)
        if not better.any():
            return self
        mean_mm, variance, excess_mm2 = self.mean_mm.copy(), self.relative_variance.copy(), self.excess_mm2.copy()
        rows, there = rows[better], there[better]
        mean_mm[rows] = np.where(there, means[better], mean_mm[rows])
        variance[rows] = np.where(there, shares[better], variance[rows])
        excess_mm2[place[better]] = rests_mm2[better]
        is_found = self.found.copy()
        is_found[rows] = np.array([rest.is_rest for _, rest in found])[better]
        return replace(self, mean_mm=mean_mm, relative_variance=variance, excess_mm2=excess_mm2, found=is_found)

    def at(self, rows: NDArray[np.intp]) -> Self:
        """Return some of the means, by their ascending rows."""
        is_chosen = np.isin(np.flatnonzero(self.uncertain), rows)
        return replace(
            self,
            mean_mm=self.mean_mm[rows],
            relative_variance=self.relative_variance[rows],
            moves=self.moves[rows],
            lags=self.lags[rows],
            excess_mm2=self.excess_mm2[is_chosen] if len(is_chosen) else self.excess_mm2,
            found=self.found[rows],
        )

    @property
    def uncertain(self) -> NDArray[np.bool_]:
        """True where the covariance of a mean is more than that of the noise, shape (readings,)."""
        return self.moves | self.lags

    @property
    def readings(self) -> FloatArray:
        """Number of readings whose mean has the noise of the least noisy channel, shape (readings,); NaN for none."""
        least = np.where(np.isnan(self.relative_variance), np.inf, self.relative_variance).min(axis=1)
        return np.where(np.isfinite(least), 1 / least, np.nan)

    @property
    def covariance_mm2(self) -> FloatArray:
        """Covariance of the means [mm^2], shape (readings, channels, channels); zero rows for channels without a value.

        Raises
        ------
        ValueError
            The noise of a reading is not known.
        """
        return self.covariances_mm2(np.arange(len(self.moves)))

    def covariances_mm2(self, rows: NDArray[np.intp]) -> FloatArray:
        """Return the covariances of some of the means [mm^2], shape (rows, channels, channels); errors as above."""
        if self.noise_mm is None:
            raise ValueError("the covariance needs the noise of a reading")
        missing = np.isnan(self.mean_mm[rows])
        white = np.where(missing, 0.0, self.relative_variance[rows]) * self.noise_mm**2
        covariances: FloatArray = white[:, :, np.newaxis] * np.eye(white.shape[1])
        uncertain = self.uncertain
        exceeding = uncertain[rows]
        covariances[exceeding] += self.excess_mm2[np.cumsum(uncertain)[rows[exceeding]] - 1]
        covariances[missing] = covariances.transpose(0, 2, 1)[missing] = 0.0
        return covariances
