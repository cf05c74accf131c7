"""The surface that is challenged: the world of a model's scene as calibrated, and what the model states of it."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.metadata import Metadata
from beamtouch_models.scene import Scene
from beamtouch_models.surface import Surface
from beamtouch_models.world import SensorErrors, World

SPARE = 8
"""Readings after everything that a filter looks back on, so that the state has followed them."""


@dataclass(frozen=True)
class SimulatedSurface:
    """A surface and its model."""

    metadata: Metadata
    scene: Scene
    world: World
    slowest_period: float
    """In readings; 0 if it is not known."""
    gain: Floats
    """(channels,) standard deviation of the relative gain error."""
    zero_mm: Floats
    """(channels,) standard deviation of the zero."""

    @classmethod
    def of(cls, metadata: Metadata) -> Self:
        """Return the surface that a model was made for, with all effects that its scene states.

        Raises
        ------
        SceneError
            The scene in the model cannot be computed.
        """
        surface, channels = Surface.of_model(metadata), len(metadata.layout)
        gain, zero_mm = (np.full(channels, value) for value in (surface.readings.gain, surface.readings.floor_mm))
        if metadata.calibration is not None:
            gain, zero_mm = np.array(metadata.floor.gain), np.array(metadata.floor.zero_mm)
        # The noise that a model states of a reading holds the steps of the ADC.
        steps_mm2 = metadata.sensor.gain_mm_per_count**2 / 12
        noise_mm = float(np.sqrt(max(0.0, metadata.noise.reading_mm**2 - steps_mm2)))
        world = World.of(surface.stated, metadata.sensor, metadata.layout_mm, noise_mm, metadata.departures)
        return cls(metadata, surface.stated, world, surface.slowest_period, gain, zero_mm)

    @property
    def channels(self) -> int:
        """Number of channels."""
        return self.world.channels

    @property
    def min_noise_mm(self) -> float:
        """Noise of a settled sample."""
        return self.metadata.filter.min_noise_mm(self.metadata.noise)

    @property
    def look_back(self) -> int:
        """Number of readings after which nothing before them is in a sample or in the state of the surface."""
        return self.metadata.filter.max_readings + self.decided

    @property
    def decided(self) -> int:
        """Number of readings after which the state of the surface has followed a settled filter."""
        return 2 * self.metadata.filter.window + int(np.ceil(self.slowest_period)) + SPARE

    def honest(self, draws: int, rng: np.random.Generator) -> SensorErrors:
        """Return errors as large as the scene states, or as the calibration left."""
        shape = (draws, self.channels)
        gain, zero_mm = 1 + rng.normal(size=shape) * self.gain, rng.normal(size=shape) * self.zero_mm
        return replace(SensorErrors.none(*shape), gain=gain, zero_mm=zero_mm)
