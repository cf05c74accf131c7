"""Best samples of contacts drawn from the scene of a model, on sensors with the errors that its floor states."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.arrays import Floats
from beamtouch_models.runtime import Answers, BestSample, ModelFile, Weighed, evidence
from support.surfaces.deflections import deflections_of

REST_READINGS = 32


class SuccessiveContacts:
    """Contacts of one surface, one after another; tests change its sensors."""

    every_us = 1_000_000

    def __init__(self, model: ModelFile) -> None:
        self.model, self.metadata = model, model.metadata
        self.begin(0)

    def begin(self, seed: int, readings: int | None = None) -> None:
        """Begin anew, with other errors; samples are means of this many readings, or else those of the model."""
        said, self.random = self.metadata, np.random.default_rng(seed)
        channels = len(said.layout)
        self.at_us = 0
        self.gain = 1 + self.random.normal(size=channels) * said.floor.gain
        self.zero_mm = self.random.normal(size=channels) * said.floor.zero_mm
        self.noise_mm = said.noise.reading_mm / readings**0.5 if readings else said.noise.sample_mm

    def contacts(self, count: int, at_mm: Sequence[float] = ()) -> list[BestSample]:
        """Return the next contacts: of one load anywhere, or of equal loads at these positions."""
        said, channels = self.metadata, len(self.metadata.layout)
        shape = count, len(at_mm) or 1
        position, force = (self.random.uniform(*ends, shape) for ends in (said.ranges.position_mm, said.ranges.force_n))
        if at_mm:
            position, force = np.broadcast_to(at_mm, shape), np.broadcast_to(force[:, :1], shape)
        each = deflections_of(self.model, position.ravel(), force.ravel()).reshape(*shape, channels)
        true = each.sum(axis=1)
        rest_noise_mm = said.noise.reading_mm / REST_READINGS**0.5
        measured = true * self.gain + self.zero_mm + self._noise(count, self.noise_mm)
        rest = self.zero_mm + self._noise(count, rest_noise_mm)
        deviation, rest_deviation = [self.noise_mm] * channels, [rest_noise_mm] * channels
        found = []
        for row, is_contact in enumerate(self._explained(measured)):
            values, rests = measured[row].tolist(), rest[row].tolist()
            found.append(BestSample(self.at_us, values, deviation, rests, rest_deviation, is_contact))
            self.at_us += self.every_us
        return found

    def _explained(self, measured_mm: Floats) -> list[bool]:
        """Return whether a single contact explains each sample, by the model."""
        count, channels = measured_mm.shape
        covariance = np.tile(np.eye(channels) * self.noise_mm**2, (count, 1, 1))
        every = np.ones((count, channels), np.bool_)
        samples = Weighed(measured_mm, covariance, np.full((count, channels), self.noise_mm**2), every)
        limits = self.metadata.thresholds
        each = evidence(self.metadata, self._run, samples)
        return [one.misfit <= (limits.misfit[-1] or np.inf) or one.rest_misfit <= limits.rest[-1] for one in each]

    def _run(self, deflection_mm: NDArray[np.floating], whitening_per_mm: NDArray[np.floating]) -> Answers:
        return self.model.run(deflection_mm, whitening_per_mm)

    def _noise(self, count: int, deviation_mm: float) -> Floats:
        noise: Floats = self.random.normal(size=(count, len(self.metadata.layout))) * deviation_mm
        return noise
