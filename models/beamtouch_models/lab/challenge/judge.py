"""A model behind the daemon's filters: from readings to its statement on every sample."""

from dataclasses import dataclass, fields
from enum import IntEnum

import numpy as np

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.design.pricing.noise import chain_of
from beamtouch_models.filters import Zeros, beyond_start
from beamtouch_models.lab.challenge.play import SimulatedSurface
from beamtouch_models.runtime.decision.decider import AT_REST, Hypotheses, State
from beamtouch_models.runtime.decision.evidence import Weighed, evidence, is_overload, is_unchecked
from beamtouch_models.runtime.session import Run


class Outcome(IntEnum):
    """A statement on a sample: nothing, or a `State` by its name."""

    NOTHING = 0
    """Too few channels work: the service gives no answer."""
    CLEAR = 1
    CONTACT = 2
    UNEXPLAINED = 3


@dataclass(frozen=True)
class Verdicts:
    """Verdicts on samples, (draws, samples)."""

    outcome: Indices
    """Values of `Outcome`."""
    unsteady: Bools
    other_note: Bools
    """Whether there is a note other than `unsteady`."""
    position_mm: Floats
    low_mm: Floats
    high_mm: Floats
    """NaN where nothing is said."""
    valid: Bools
    """(draws, samples, channels), which channels take part."""

    @classmethod
    def silent(cls, valid: Bools) -> "Verdicts":
        """Return verdicts of which there are none yet."""
        shape = valid.shape[:2]
        position, low, high = np.full((3, *shape), np.nan)
        unsteady, other = np.zeros((2, *shape), np.bool_)
        return cls(np.full(shape, Outcome.NOTHING), unsteady, other, position, low, high, valid)

    def at(self, readings: list[int]) -> "Verdicts":
        """Return the statements at some readings of each draw, as one axis of samples."""
        parts = (getattr(self, field.name)[:, readings] for field in fields(self))
        return Verdicts(*(part.reshape(-1, *part.shape[2:]) for part in parts))


def judge(
    surface: SimulatedSurface, run: Run, readings_mm: Floats, first: int = 0, *, lost: Bools | None = None
) -> Verdicts:
    """Return the statements of a surface's model on each reading (draws, readings, channels); draws begin anew.

    There is none on the readings before number `first`, and on those that are `lost` (draws, readings).
    """
    metadata, length = surface.metadata, readings_mm.shape[1]
    came = np.ones(readings_mm.shape[:2], np.bool_) if lost is None else ~lost
    samples = _filter(surface, readings_mm, came)
    judged = Verdicts.silent(samples.valid.reshape(readings_mm.shape))
    asked = np.arange(len(samples.valid)) % length >= first
    enough = np.flatnonzero(asked & came.ravel() & (samples.valid.sum(axis=1) >= metadata.min_channels))
    found = evidence(metadata, run, samples.part(enough)) if len(enough) else []
    draw, decider = -1, Hypotheses(metadata.thresholds, [AT_REST])
    for index, one in zip(enough.tolist(), found, strict=True):
        if index // length != draw:
            draw, decider = index // length, Hypotheses(metadata.thresholds, [AT_REST])
        verdict, at = decider.step(one), divmod(index, length)
        judged.outcome[at], judged.unsteady[at] = Outcome[verdict.state.name], verdict.unsteady
        if verdict.state is State.CONTACT:
            judged.other_note[at] = is_overload(metadata, one) or is_unchecked(one)
            judged.position_mm[at] = one.answer["position_mm"]
            judged.low_mm[at], judged.high_mm[at] = one.answer["position_low_mm"], one.answer["position_high_mm"]
    return judged


def _filter(surface: SimulatedSurface, readings_mm: Floats, came: Bools) -> Weighed:
    """Return the samples of all readings (draws x readings), behind the filters of the surface's model."""
    metadata, channels = surface.metadata, surface.channels
    noise_mm, per_count_mm = metadata.noise.reading_mm, metadata.sensor.gain_mm_per_count
    seen = surface.slowest_period, surface.unseen_swing
    chain = chain_of(metadata.filter, channels, noise_mm, per_count_mm, *seen)
    mean, variance = np.full((2, *readings_mm.shape), np.nan)
    covariance, drift = np.zeros((*readings_mm.shape, channels)), np.zeros((*readings_mm.shape[:2], 2))
    walk = surface.walk
    zeros = walk and Zeros(walk, metadata.sensor.rate_hz, noise_mm, per_count_mm, surface.slowest_period, channels)
    for draw, (readings, there) in enumerate(zip(readings_mm, came, strict=True)):
        chain.restart()
        skipped = (np.diff(np.flatnonzero(there), prepend=-1) - 1).tolist()
        values = readings[there]
        filtered = chain.apply(values, skipped)
        mean[draw, there], variance[draw, there] = filtered.mean_mm, filtered.relative_variance
        covariance[draw, there] = filtered.covariance_mm2
        if walk and zeros:
            zeros.restart()
            tracked = zeros.track(values, skipped, filtered)
            mean[draw, there] -= tracked.zero_mm
            noise_mm2 = filtered.relative_variance * noise_mm**2
            drift[draw, there] = beyond_start(tracked, walk, filtered.mean_mm, noise_mm2)
    # A channel whose newest reading is not good takes no part, whatever its filter still holds.
    valid = ~(np.isnan(mean) | np.isnan(readings_mm))
    every = (-1, channels)
    return Weighed(
        np.where(valid, mean, 0.0).reshape(every),
        covariance.reshape(-1, channels, channels),
        np.nan_to_num(variance).reshape(every) * noise_mm**2,
        valid.reshape(every),
    ).with_zeros(np.square(drift).reshape(-1, 2) if drift.any() else None)
