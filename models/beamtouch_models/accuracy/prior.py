"""The prior of a surface: everything that an estimator or an accuracy limit is made from.

Physics ends here: a scene, a calibrated beam and a measured beam all become an influence matrix.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Self

import numpy as np
from scipy.interpolate import CubicSpline

from beamtouch_models.arrays import Floats
from beamtouch_models.physics.influence import InfluenceFunction

TABLE = 2001
"""Number of load positions in an influence table."""


@dataclass(frozen=True)
class Prior:
    """The range of contacts, uniform in position and force, and the deflections that the sensors measure."""

    length_mm: float
    position_mm: tuple[float, float]
    force_n: tuple[float, float]
    """Equal ends: the force is known."""
    noise_mm: float
    """Standard deviation of a sample, per channel."""
    channels: int
    influence_at: Callable[[Floats], Floats]
    """From load positions in mm (loads,) to the influence matrix (loads, channels) in mm/N."""
    stated: Callable[[Floats], Floats] = lambda deflection_mm: deflection_mm
    """From deflections (samples, channels) that are linear in the force to measured deflections."""

    @classmethod
    def of(cls, influence: InfluenceFunction, sensor_mm: Floats, noise_mm: float) -> Self:
        """Prior of a structure with sensors at `sensor_mm` (channels,) and `noise_mm` per sample."""
        return cls(
            length_mm=influence.length_mm,
            position_mm=influence.position_mm,
            force_n=influence.force_n,
            noise_mm=noise_mm,
            channels=len(sensor_mm),
            influence_at=partial(influence.at, sensor_mm),
        )

    @property
    def force_is_known(self) -> bool:
        """Whether the force is known."""
        return self.force_n[0] == self.force_n[1]

    @cached_property
    def table(self) -> CubicSpline:
        """Interpolated influence, within 1e-7 of the largest value; beam elements take much longer."""
        grid = np.linspace(*self.position_mm, TABLE)
        return CubicSpline(grid, self.influence_at(grid))

    def without(self, *missing: int) -> Self:
        """Return the prior of the surface without some channels."""
        kept = np.setdiff1d(np.arange(self.channels), missing)
        whole = self.stated

        def stated(deflection_mm: Floats) -> Floats:
            every = np.zeros((len(deflection_mm), self.channels))
            every[:, kept] = deflection_mm
            return whole(every)[:, kept]

        influence = lambda load_mm: self.influence_at(load_mm)[:, kept]  # noqa: E731
        return replace(self, channels=len(kept), influence_at=influence, stated=stated)
