"""A model behind the daemon's filters: from readings to its statement on every sample."""

from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Self

import numpy as np

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.challenge.surface import SimulatedSurface
from beamtouch_models.decision.decider import AT_REST, Hypotheses, State
from beamtouch_models.decision.evidence import Weighed, evidence, is_overload, is_unchecked
from beamtouch_models.decision.suspects import Suspects
from beamtouch_models.filters import Chain
from beamtouch_models.metadata import Metadata
from beamtouch_models.pricing.noise import chain_of
from beamtouch_models.session import Run


class Said(IntEnum):
    """A statement on a sample."""

    NOTHING = 0
    """Too few channels work: the service gives no answer."""
    CLEAR = 1
    CONTACT = 2
    UNEXPLAINED = 3


NOBODY = -1
"""Index of a channel where none is said to be wrong."""


_SAID = {State.CLEAR: Said.CLEAR, State.CONTACT: Said.CONTACT, State.UNEXPLAINED: Said.UNEXPLAINED}


@dataclass(frozen=True)
class Judged:
    """Statements on samples, (draws, samples)."""

    said: Indices
    """Values of `Said`."""
    unsteady: Bools
    other_note: Bools
    """Whether there is a note other than `unsteady`."""
    position_mm: Floats
    low_mm: Floats
    high_mm: Floats
    """NaN where nothing is said."""
    suspect: Indices
    """Index of the channel that `check-NAME` names; NOBODY if there is none."""
    mean_mm: Floats
    """(draws, samples, channels); 0 for a channel that takes no part."""
    valid: Bools
    """(draws, samples, channels), which channels take part."""

    @classmethod
    def silent(cls, mean_mm: Floats, valid: Bools) -> Self:
        """Return statements of which there are none yet."""
        shape = mean_mm.shape[:2]
        position, low, high = np.full((3, *shape), np.nan)
        unsteady, other = np.zeros((2, *shape), np.bool_)
        nothing, nobody = np.full(shape, Said.NOTHING), np.full(shape, NOBODY)
        return cls(nothing, unsteady, other, position, low, high, nobody, mean_mm, valid)

    def at(self, readings: list[int]) -> "Judged":
        """Return the statements at some readings of each draw, as one axis of samples."""
        parts = (getattr(self, field.name)[:, readings] for field in fields(self))
        return Judged(*(part.reshape(-1, *part.shape[2:]) for part in parts))


def _chain_of(surface: SimulatedSurface) -> Chain:
    """Return the filters of a surface's model."""
    stated = surface.metadata
    per_count_mm = stated.sensor.gain_mm_per_count
    return chain_of(stated.filter, surface.channels, stated.noise.reading_mm, per_count_mm, surface.slowest_period)


def judge(
    surface: SimulatedSurface,
    run: Run,
    readings_mm: Floats,
    first: int = 0,
    *,
    lost: Bools | None = None,
    naming: bool = False,
) -> Judged:
    """Return the statements of a surface's model on each reading (draws, readings, channels); draws begin anew.

    There is none on the readings before number `first`, and on those that are `lost` (draws, readings). With `naming`,
    suspects are sought as in the service, which takes time.
    """
    metadata, chain = surface.metadata, _chain_of(surface)
    came = np.ones(readings_mm.shape[:2], np.bool_) if lost is None else ~lost
    filtered = []
    for readings, there in zip(readings_mm, came, strict=True):
        chain.restart()
        skipped = np.diff(np.flatnonzero(there), prepend=-1) - 1
        filtered.append(chain.apply(readings[there], skipped.tolist()))
    mean, variance = np.full(readings_mm.shape, np.nan), np.full(readings_mm.shape, np.nan)
    covariance = np.zeros((*readings_mm.shape, surface.channels))
    mean[came] = np.concatenate([one.mean_mm for one in filtered])
    variance[came] = np.concatenate([one.relative_variance for one in filtered])
    covariance[came] = np.concatenate([one.covariance_mm2 for one in filtered])
    # A channel whose newest reading is not good takes no part, whatever its filter still holds.
    valid = ~(np.isnan(mean) | np.isnan(readings_mm))
    mean = np.where(valid, mean, 0.0)
    samples = Weighed(
        np.concatenate(mean),
        np.concatenate(covariance),
        np.nan_to_num(np.concatenate(variance)) * metadata.noise.reading_mm**2,
        np.concatenate(valid),
    )
    length, before, decider = readings_mm.shape[1], -1, Hypotheses(metadata.thresholds, [AT_REST])
    judged = Judged.silent(mean, valid)
    asked = np.arange(len(samples.valid)) % length >= first
    enough = np.flatnonzero(asked & came.ravel() & (samples.valid.sum(axis=1) >= metadata.min_channels))
    found = evidence(metadata, run, samples.part(enough)) if len(enough) else []
    for index, one in zip(enough.tolist(), found, strict=True):
        if index // length != before:
            before, decider = index // length, Hypotheses(metadata.thresholds, [AT_REST])
        verdict, at = decider.step(one), divmod(index, length)
        judged.said[at], judged.unsteady[at] = _SAID[verdict.state], verdict.unsteady
        if verdict.state is State.CONTACT:
            judged.other_note[at] = is_overload(metadata, one) or is_unchecked(one)
            judged.position_mm[at] = one.answer["position_mm"]
            judged.low_mm[at], judged.high_mm[at] = one.answer["position_low_mm"], one.answer["position_high_mm"]
    if naming:
        _name_suspects(metadata, run, samples, judged)
    return judged


def _name_suspects(metadata: Metadata, run: Run, samples: Weighed, judged: Judged) -> None:
    """Add the suspect of each unexplained sample."""
    suspects, names = Suspects(metadata, run), [channel.name for channel in metadata.layout]
    unexplained = np.flatnonzero(judged.said == Said.UNEXPLAINED).tolist()
    without = suspects.leave_out(samples.part(np.array(unexplained, np.intp)))
    for before, index, left in zip([NOBODY, *unexplained], unexplained, without, strict=False):
        if index != before + 1 or index % judged.said.shape[1] == 0:
            suspects.clear()
        suspects.add(left)
        if suspects.suspect is not None:
            judged.suspect.flat[index] = names.index(suspects.suspect)
