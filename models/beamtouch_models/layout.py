"""Where sensors may stand: the candidate grid and the rules of a scene."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.errors import SceneError
from beamtouch_models.scene import Scene

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Candidates:
    """The positions a sensor may take."""

    position_mm: Array
    """(candidates,), ascending; the grid without its keep-outs, plus the fixed sensors."""
    fixed: Indices
    """Candidates that are sensors already."""
    min_distance_mm: float

    def allowed(self, layouts: Indices) -> NDArray[np.bool_]:
        """Whether each layout (population, sensors) keeps the minimum distance; (population,)."""
        if self.min_distance_mm <= 0:
            return np.ones(len(layouts), np.bool_)
        positions = np.sort(self.position_mm[layouts], axis=1)
        kept: NDArray[np.bool_] = np.all(np.diff(positions, axis=1) >= self.min_distance_mm - 1e-9, axis=1)
        return kept

    def nearest(self, position_mm: Array) -> Indices:
        """Candidate nearest to each position, any shape."""
        after = np.clip(np.searchsorted(self.position_mm, position_mm), 1, len(self.position_mm) - 1)
        left, right = self.position_mm[after - 1], self.position_mm[after]
        chosen: Indices = np.where(position_mm - left <= right - position_mm, after - 1, after)
        return chosen


def candidates(scene: Scene) -> Candidates:
    """Return the candidates of a scene; raises SceneError where its rules leave no room."""
    sensors, length = scene.sensors, scene.beam.length_mm
    grid = np.arange(1, np.ceil(length / sensors.grid_mm)) * sensors.grid_mm
    for start, end in sensors.keep_out_mm:
        grid = grid[(grid <= start) | (grid >= end)]
    position = np.union1d(grid, np.asarray(sensors.fixed_mm, dtype=np.float64))
    if len(position) < 2:
        message = "sensors: grid_mm and keep_out_mm leave fewer than two positions; make the grid finer"
        raise SceneError(message)
    fixed = np.searchsorted(position, np.unique(np.asarray(sensors.fixed_mm, dtype=np.float64)))
    return Candidates(position, fixed, sensors.min_distance_mm)


def equal_pitch_mm(scene: Scene, count: int) -> Array:
    """The layout that divides the beam in equal parts; (count,) in mm."""
    return scene.beam.length_mm * np.arange(1, count + 1) / (count + 1)
