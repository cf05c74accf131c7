"""Samples as a model weighs them: in the order of its channels, with their covariance. Pure."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.modelfile import ModelFile, Weighed
from beamtouch_service.samples import Batch, Quality, Sample

CONTRADICTION = 1.25
"""The noise of a sender contradicts that of the model if one is more than this many times the other."""
_OUT_OF_RANGE = {Quality.GOOD: Quality.OUT_OF_RANGE}
"""Quality of a channel that the sender calls good, and that takes no part all the same."""


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
        self.contradicts = noise_contradicts(model, batch)
        """Whether the noise that the sender states contradicts the model."""
        self._of = batch.channels, batch.noise_mm
        self._names = model.channels
        self._places = [batch.channels.index(name) for name in self._names]
        self._is_as_sent = self._places == list(range(len(batch.channels)))
        self._all_good = [Quality.GOOD] * len(self._places)
        count = len(self._places)
        # The place of each entry of a matrix in the lower triangle of a batch.
        rows, columns = np.maximum.outer(self._places, self._places), np.minimum.outer(self._places, self._places)
        self._entries = (rows * (rows + 1) // 2 + columns).ravel()
        self._largest_mm = model.largest_mm
        said = model.metadata.noise
        self._settled_mm2 = np.full(count, said.sample_mm**2)
        stated = [batch.noise_mm[place] for place in self._places] if batch.noise_mm else None
        self._stated_mm2 = np.square(stated) if stated else np.full(count, said.reading_mm**2)
        self._reading_mm2 = np.maximum(self._stated_mm2, said.reading_mm**2) if self.contradicts else self._stated_mm2

    def fits(self, batch: Batch) -> bool:
        """Return whether another batch for the same model has this arrangement, too."""
        return self._of == (batch.channels, batch.noise_mm)

    def weighed(self, samples: Sequence[Sample]) -> tuple[Weighed, list[dict[str, Quality]]]:
        """Return samples as arrays, and for each the qualities of the channels that take no part."""
        deflection_mm, valid, bad = self._values(samples)
        settled = [sample.readings is None for sample in samples]
        readings = np.array([[sample.readings or 1] for sample in samples], np.float64)
        noise_mm2 = self._reading_mm2 / readings
        if any(settled):
            noise_mm2[settled] = self._settled_mm2
        channels = len(self._names)
        covariance_mm2 = np.zeros((len(samples), channels * channels))
        variances = covariance_mm2[:, :: channels + 1]
        variances[:] = noise_mm2
        stated = [row for row, sample in enumerate(samples) if sample.covariance_mm2 is not None]
        if stated:
            triangles = np.array([samples[row].covariance_mm2 for row in stated])
            covariance_mm2[stated] = triangles[:, self._entries]
            variances[stated] += noise_mm2[stated] - self._stated_mm2 / readings[stated]
        return Weighed(deflection_mm, covariance_mm2.reshape(-1, channels, channels), noise_mm2, valid), bad

    def _values(
        self, samples: Sequence[Sample]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], list[dict[str, Quality]]]:
        """Return the deflections [mm], 0 for channels that take no part, which channels do, and why others do not."""
        sent = np.array([sample.deflection_mm for sample in samples], np.float64)  # NaN for null
        values = sent if self._is_as_sent else sent[:, self._places]
        # No load goes that far. In single precision, the model could answer anything.
        valid = np.abs(values) <= self._largest_mm
        if self._is_as_sent and valid.all() and all(sample.quality == self._all_good for sample in samples):
            return values, valid, [{} for _ in samples]
        bad = []
        for row, sample in enumerate(samples):
            qualities = [sample.quality[place] for place in self._places]
            valid[row] &= [quality is Quality.GOOD for quality in qualities]
            each = zip(self._names, qualities, valid[row].tolist(), strict=True)
            left_out = {name: quality for name, quality, takes_part in each if not takes_part}
            bad.append({name: _OUT_OF_RANGE.get(quality, quality) for name, quality in left_out.items()})
        return np.where(valid, values, 0.0), valid, bad
