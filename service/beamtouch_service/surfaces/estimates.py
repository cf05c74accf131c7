"""Runs the model on all samples of a batch in one call. Pure: no clock, no state, no I/O."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.modelfile import Answers, Evidence, ModelFile, Weighed, evidence
from beamtouch_service.problems import Kind, Problem
from beamtouch_service.samples import Batch, Quality, Sample
from beamtouch_service.surfaces.weighing import Arrangement

Ask = Callable[[NDArray[np.floating], NDArray[np.floating]], Answers]
"""Takes deflections [mm] (samples, channels) and their whitening [1/mm] (samples, channels, channels); returns a value
per output and sample."""
CHUNK = 256
"""Samples that are weighed together. More would cost memory and save no time."""


class Estimated(NamedTuple):
    """One sample, and the evidence in it under the model."""

    sequence: int
    acquired_unix_us: int
    readings: int | None
    """Number of readings in it; None if its sender does not say."""
    bad: dict[str, Quality]
    """Channels that took no part."""
    evidence: Evidence | Problem
    """The evidence, or the problem if there is none."""
    weighed: Weighed
    """The samples that were weighed together."""
    row: int
    """Index of this sample among them."""
    characteristic: str | None = None
    """Identity of the sender's characteristics and rest gaps; None if it states none."""


def estimate(
    model: ModelFile,
    surface: str,
    batch: Batch,
    samples: Sequence[Sample],
    ask: Ask | None = None,
    arrangement: Arrangement | None = None,
) -> list[Estimated]:
    """Return the evidence in `samples` of a batch of `surface` under `model`.

    By default, `model.run` runs it, and the arrangement is made for this batch.
    """
    arrangement = arrangement or Arrangement(model, batch)
    found: list[Estimated] = []
    for start in range(0, len(samples), CHUNK):
        part = samples[start : start + CHUNK]
        found += _chunk(model, surface, arrangement, part, ask or model.run, batch.characteristic)
    return found


def _chunk(
    model: ModelFile,
    surface: str,
    arrangement: Arrangement,
    samples: Sequence[Sample],
    ask: Ask,
    characteristic: str | None,
) -> list[Estimated]:
    weighed, bad = arrangement.weighed(samples)
    found: Sequence[Evidence | Problem]
    if weighed.is_whole:
        found = _evidence(model, surface, ask, weighed)
    else:
        enough = np.flatnonzero(weighed.valid.sum(axis=1) >= model.metadata.min_channels)
        known = dict(zip(enough.tolist(), _evidence(model, surface, ask, weighed.part(enough)), strict=True))
        found = [known.get(row) or _too_few(model, surface, left_out) for row, left_out in enumerate(bad)]
    return [
        Estimated(
            sample.sequence, sample.acquired_unix_us, sample.readings, left_out, one, weighed, row, characteristic
        )
        for row, (sample, left_out, one) in enumerate(zip(samples, bad, found, strict=True))
    ]


def _evidence(model: ModelFile, surface: str, ask: Ask, samples: Weighed) -> list[Evidence | Problem]:
    """Return the evidence in each sample. One without a usable covariance does not spoil the others."""
    count = len(samples.deflection_mm)
    if not count:
        return []
    try:
        return list(evidence(model.metadata, ask, samples))
    except ValueError as error:
        if count == 1:
            return [Problem(Kind.UNUSABLE_ESTIMATE, f"For the newest sample, {error}.", surface)]
    rows = range(count)
    return [one for row in rows for one in _evidence(model, surface, ask, samples.part(np.array([row])))]


def _too_few(model: ModelFile, surface: str, bad: dict[str, Quality]) -> Problem:
    working = len(model.channels) - len(bad)
    named = ", ".join(f"{name} ({quality.value})" for name, quality in bad.items())
    works = "1 channel works" if working == 1 else f"{working} channels work"
    detail = f"Only {works}; the model needs {model.metadata.min_channels}. Check {named}."
    return Problem(Kind.TOO_FEW_CHANNELS, detail, surface, {"bad_channels": dict(bad)})
