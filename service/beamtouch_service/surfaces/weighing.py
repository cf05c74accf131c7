"""Samples as a model weighs them: in the order of its channels, with their covariance. Pure."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.modelfile import ModelFile, Weighed
from beamtouch_service.samples import Batch, Quality, Sample, triangle_rows

CONTRADICTION = 1.25
"""The noise of a sender contradicts that of the model if one is more than this many times the other."""
LARGEST = 100.0
"""A deflection is out of range beyond this many times the largest one that the scene allows."""


def noise_contradicts(model: ModelFile, batch: Batch) -> bool:
    """Return whether the noise that a sender states contradicts the model; then the larger one counts."""
    if batch.noise_mm is None:
        return False
    made_for_mm = model.metadata.noise.reading_mm
    stated_mm = [batch.noise_mm[batch.channels.index(name)] for name in model.channels]
    low_mm, high_mm = made_for_mm / CONTRADICTION, made_for_mm * CONTRADICTION
    return not all(low_mm <= one <= high_mm for one in stated_mm)


class Arrangement:
    """The channels of a model in the order of a batch, and the noise of a reading of each."""

    def __init__(self, model: ModelFile, batch: Batch) -> None:
        self.channels = [(name, batch.channels.index(name)) for name in model.channels]
        self._places = [place for _, place in self.channels]
        self._largest_mm = LARGEST * model.metadata.max_deflection_mm
        said = model.metadata.noise
        self._settled_mm2 = np.full(len(self.channels), said.sample_mm**2)
        stated = [batch.noise_mm[place] for place in self._places] if batch.noise_mm else None
        self._stated_mm2 = np.square(stated) if stated else np.full(len(self.channels), said.reading_mm**2)
        contradicts = noise_contradicts(model, batch)
        self._reading_mm2 = np.maximum(self._stated_mm2, said.reading_mm**2) if contradicts else self._stated_mm2

    def weighed(self, samples: Sequence[Sample]) -> tuple[Weighed, list[dict[str, Quality]]]:
        """Return samples as arrays, and for each the qualities of the channels that take no part."""
        count, channels = len(samples), len(self.channels)
        deflection_mm, noise_mm2 = np.zeros((count, channels)), np.empty((count, channels))
        covariance_mm2 = np.zeros((count, channels, channels))
        diagonal = np.arange(channels)
        bad = []
        for row, sample in enumerate(samples):
            values, left_out = self._values(sample)
            deflection_mm[row] = values
            bad.append(left_out)
            settled = sample.readings is None
            noise_mm2[row] = self._settled_mm2 if settled else self._reading_mm2 / (sample.readings or 1)
            if sample.covariance_mm2 is None:
                covariance_mm2[row, diagonal, diagonal] = noise_mm2[row]
            else:
                covariance_mm2[row] = self._ordered(sample.covariance_mm2)
                covariance_mm2[row, diagonal, diagonal] += noise_mm2[row] - self._stated_mm2 / (sample.readings or 1)
        valid = np.array([[name not in one for name, _ in self.channels] for one in bad], np.bool_)
        return Weighed(deflection_mm, covariance_mm2, noise_mm2, valid.reshape(count, channels)), bad

    def _values(self, sample: Sample) -> tuple[list[float], dict[str, Quality]]:
        """Return the deflections [mm], 0 for a channel that takes no part, and the qualities of those."""
        values: list[float] = []
        bad: dict[str, Quality] = {}
        for name, place in self.channels:
            value, quality = sample.deflection_mm[place], sample.quality[place]
            if value is None or quality is not Quality.GOOD:
                bad[name] = quality
            elif abs(value) > self._largest_mm:
                # No load does that. In single precision, the model could answer anything.
                bad[name] = Quality.OUT_OF_RANGE
            values.append(0.0 if value is None or name in bad else value)
        return values, bad

    def _ordered(self, triangle: list[float]) -> NDArray[np.float64]:
        """Return a lower triangle in the order of the batch as a matrix in the order of the model."""
        rows = triangle_rows(triangle)
        return np.array(
            [[rows[max(one, two)][min(one, two)] for two in self._places] for one in self._places], np.float64
        )
