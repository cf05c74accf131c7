"""A model behind the daemon's filters: from readings to its statement on every sample."""

from dataclasses import dataclass, fields
from enum import IntEnum

import numpy as np

from beamtouch_common.outline import names_of
from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.design.pricing.noise import chain_of
from beamtouch_models.design.replay import replay
from beamtouch_models.filters import Zeros
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
    """True where there is a note other than `unsteady`."""
    place_mm: Floats
    """(draws, samples, axes), as are its interval; NaN where nothing is said."""
    low_mm: Floats
    high_mm: Floats
    valid: Bools
    """(draws, samples, channels), which channels take part."""

    @classmethod
    def silent(cls, valid: Bools, axes: int) -> "Verdicts":
        """Return verdicts of which there are none yet."""
        shape = valid.shape[:2]
        place, low, high = np.full((3, *shape, axes), np.nan)
        unsteady, other = np.zeros((2, *shape), np.bool_)
        return cls(np.full(shape, Outcome.NOTHING), unsteady, other, place, low, high, valid)

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
    samples = _samples(surface, readings_mm, came)
    figures = [names_of(axis, "mm") for axis in metadata.axes]
    judged = Verdicts.silent(samples.valid.reshape(readings_mm.shape), len(figures))
    is_asked = np.arange(len(samples.valid)) % length >= first
    enough = np.flatnonzero(is_asked & came.ravel() & (samples.valid.sum(axis=1) >= metadata.min_channels))
    shown = evidence(metadata, run, samples.part(enough)) if len(enough) else []
    deciders = [Hypotheses(metadata.thresholds, [AT_REST]) for _ in readings_mm]
    for index, of_sample in zip(enough.tolist(), shown, strict=True):
        draw, _ = place = divmod(index, length)
        verdict = deciders[draw].step(of_sample)
        judged.outcome[place], judged.unsteady[place] = Outcome[verdict.state.name], verdict.unsteady
        if verdict.state is State.CONTACT:
            answer = of_sample.answer
            judged.other_note[place] = is_overload(metadata, of_sample) or is_unchecked(metadata, of_sample)
            for axis, names in enumerate(figures):
                judged.place_mm[place][axis], judged.low_mm[place][axis], judged.high_mm[place][axis] = (
                    answer[name] for name in names
                )
    return judged


def _samples(surface: SimulatedSurface, readings_mm: Floats, came: Bools) -> Weighed:
    """Return the samples of all readings (draws x readings), behind the filters of the surface's model."""
    metadata, channels, walk = surface.metadata, surface.channels, surface.walk
    noise_mm, per_count_mm = metadata.noise.reading_mm, metadata.sensor.gain_mm_per_count
    swings = surface.slowest_period, surface.unseen_swing
    chain = chain_of(metadata.filter, channels, noise_mm, per_count_mm, *swings)
    tracking = None
    if walk is not None:
        rate_hz = metadata.sensor.rate_hz
        tracking = walk, Zeros(walk, rate_hz, noise_mm, per_count_mm, surface.slowest_period, channels)
    samples = replay(chain, readings_mm, came=came, tracking=tracking)
    valid, flat = ~np.isnan(samples.mean_mm), (-1, channels)
    return Weighed(
        np.where(valid, samples.mean_mm, 0.0).reshape(flat),
        samples.covariance_mm2.reshape(-1, channels, channels),
        np.nan_to_num(samples.relative_variance).reshape(flat) * noise_mm**2,
        valid.reshape(flat),
    ).with_zeros(np.square(samples.drift_mm).reshape(-1, 2) if samples.drift_mm.any() else None)
