"""Samples as a model weighs them, and the evidence in them. Pure: no clock, no I/O."""

from collections.abc import Callable, Iterator, Sequence
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.runtime import Answers, Evidence, ModelFile, Weighed, evidence
from beamtouch_service.problems import Problem
from beamtouch_service.samples import Batch, Quality, Sample
from beamtouch_service.surfaces.surface_problems import too_few_channels, unusable_estimate

CHUNK = 64
"""Samples that are weighed together, in about a millisecond. More would save no time."""
CONTRADICTION = 1.25
"""The noise of a sender contradicts that of the model if one is more than this many times the other."""


class Estimate(NamedTuple):
    """One sample, and the evidence in it under the model."""

    sample: Sample
    bad: dict[str, Quality]
    """Channels that took no part."""
    evidence: Evidence | Problem
    """The evidence, or the problem if there is none."""
    together: Weighed
    """The samples that were weighed together."""
    row: int
    """Index of this sample among them."""
    characteristic: str | None
    """Identity of the sender's characteristics and rest gaps; None if it states none."""

    @property
    def weighed(self) -> Weighed:
        """The sample as it was weighed, as a batch of one."""
        return self.together.part(np.array([self.row]))


class Estimator:
    """A model that runs on the samples of one surface."""

    def __init__(self, model: ModelFile, surface: str, on_run: Callable[[float], None] = lambda _took_s: None) -> None:
        """Call `on_run` after each run of the graph with the time that it took [s]."""
        self.model = model
        self.contradicts = False
        """True if the noise that the newest sender states contradicts the model; then the larger one counts."""
        self._surface, self._on_run = surface, on_run
        self._arranged: tuple[list[str], list[float] | None] | None = None
        """Channels and noise of the last batch: what follows from them is the same for the next one."""

    def estimate(self, batch: Batch, samples: Sequence[Sample]) -> Iterator[Estimate]:
        """Give the evidence in samples of a batch, one after another."""
        if self._arranged != (batch.channels, batch.noise_mm):
            self._arrange(batch)
        for start in range(0, len(samples), CHUNK):
            yield from self._chunk(samples[start : start + CHUNK], batch.characteristic)

    def _arrange(self, batch: Batch) -> None:
        """Find the channels of the model in a batch, and the noise of a reading of each."""
        self._places = places = [batch.channels.index(name) for name in self.model.channels]
        # The place of each entry of a covariance in the lower triangle of a batch.
        rows, columns = np.maximum.outer(places, places), np.minimum.outer(places, places)
        self._entries = (rows * (rows + 1) // 2 + columns).ravel()
        reading_mm = np.full(len(places), self.model.metadata.noise.reading_mm)
        stated_mm = np.array(batch.noise_mm)[places] if batch.noise_mm else reading_mm
        ratio = stated_mm / reading_mm
        self.contradicts = bool((ratio > CONTRADICTION).any() or (ratio < 1 / CONTRADICTION).any())
        self._stated_mm2 = stated_mm**2
        self._reading_mm2 = np.maximum(stated_mm, reading_mm) ** 2 if self.contradicts else self._stated_mm2
        self._arranged = batch.channels, batch.noise_mm

    def _chunk(self, samples: Sequence[Sample], characteristic: str | None) -> list[Estimate]:
        deflection_mm, valid, bad = self._values(samples)
        weighed = Weighed(deflection_mm, *self._errors(samples), valid).with_zeros(self._zeros(samples))
        outcomes: Sequence[Evidence | Problem]
        if weighed.is_whole:
            outcomes = self._evidence(weighed)
        else:
            enough = np.flatnonzero(valid.sum(axis=1) >= self.model.metadata.min_channels)
            by_row = dict(zip(enough.tolist(), self._evidence(weighed.part(enough)), strict=True))
            outcomes = [by_row.get(row) or self._too_few(left_out) for row, left_out in enumerate(bad)]
        each = enumerate(zip(samples, bad, outcomes, strict=True))
        return [
            Estimate(sample, left_out, outcome, weighed, row, characteristic)
            for row, (sample, left_out, outcome) in each
        ]

    def _values(
        self, samples: Sequence[Sample]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], list[dict[str, Quality]]]:
        """Return the deflections [mm], 0 for channels that take no part, which channels do, and why others do not."""
        sent_mm = np.array([sample.deflection_mm for sample in samples], np.float64)[:, self._places]  # NaN for null
        is_good = [[quality is Quality.GOOD for quality in sample.quality] for sample in samples]
        # No load goes beyond the largest deflection. In single precision, the model could answer anything.
        valid = np.array(is_good)[:, self._places] & (np.abs(sent_mm) <= self.model.largest_mm)
        if valid.all():
            return sent_mm, valid, [{} for _ in samples]
        bad = []
        for sample, takes_part in zip(samples, valid.tolist(), strict=True):
            left_out = {
                name: sample.quality[place]
                for name, place, is_valid in zip(self.model.channels, self._places, takes_part, strict=True)
                if not is_valid
            }
            # The sender calls a channel good that is beyond the largest deflection.
            good = Quality.GOOD
            bad.append({name: Quality.OUT_OF_RANGE if one is good else one for name, one in left_out.items()})
        return np.where(valid, sent_mm, 0.0), valid, bad

    def _errors(self, samples: Sequence[Sample]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return covariances (samples, channels, channels) and noise (samples, channels) [mm^2]."""
        readings = np.array([[sample.readings or 1] for sample in samples], np.float64)
        noise_mm2 = self._reading_mm2 / readings
        settled = [sample.readings is None for sample in samples]
        if any(settled):
            noise_mm2[settled] = self.model.metadata.noise.sample_mm**2
        channels = len(self._places)
        covariance_mm2 = np.zeros((len(samples), channels * channels))
        variances = covariance_mm2[:, :: channels + 1]
        variances[:] = noise_mm2
        stated = [row for row, sample in enumerate(samples) if sample.covariance_mm2 is not None]
        if stated:
            triangles = np.array([samples[row].covariance_mm2 for row in stated])
            covariance_mm2[stated] = triangles[:, self._entries]
            variances[stated] += noise_mm2[stated] - self._stated_mm2 / readings[stated]
        return covariance_mm2.reshape(-1, channels, channels), noise_mm2

    def _zeros(self, samples: Sequence[Sample]) -> NDArray[np.float64] | None:
        """Return the variances of the zeros (samples, 2) [mm^2]; None if no sample states any."""
        if all(sample.zero_mm is None for sample in samples):
            return None
        return np.square([sample.zero_mm or (0.0, 0.0) for sample in samples])

    def _evidence(self, samples: Weighed) -> list[Evidence | Problem]:
        """Return the evidence in each sample. One without a usable covariance does not spoil the others."""
        count = len(samples.deflection_mm)
        if not count:
            return []
        try:
            return list(evidence(self.model.metadata, self._run, samples))
        except ValueError as error:
            if count == 1:
                return [unusable_estimate(self._surface, f"For the newest sample, {error}.")]
        return [one for row in range(count) for one in self._evidence(samples.part(np.array([row])))]

    def _run(self, deflection_mm: NDArray[np.floating], whitening_per_mm: NDArray[np.floating]) -> Answers:
        begin_s = perf_counter()
        answers = self.model.run(deflection_mm, whitening_per_mm)
        self._on_run(perf_counter() - begin_s)
        return answers

    def _too_few(self, bad: dict[str, Quality]) -> Problem:
        working = len(self.model.channels) - len(bad)
        return too_few_channels(self._surface, working, self.model.metadata.min_channels, bad)
