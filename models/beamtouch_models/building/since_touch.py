"""The error of a model by the time since a touch, behind the filter that it is made for.

Readings of the simulated world of `challenge` run through the daemon's own filter: of a touch that the beam follows at
once, and of a sudden force, after which it rings in all modes with the damping of the scene. Few contacts are enough,
because they only give the difference to the plain mean of their loaded readings, whose error comes from many contacts.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from beamtouch_models.accuracy.limit import Draws, draw_evenly
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.statistics import Measurement, mean_of, ratio_of
from beamtouch_models.arrays import Floats
from beamtouch_models.error_model import whitening
from beamtouch_models.filters import Chain
from beamtouch_models.metadata import FilterChoice
from beamtouch_models.session import Run
from beamtouch_models.surface import Surface
from beamtouch_models.world import SensorErrors, World

CONTACTS, KNOWN = 96, 4096
"""Simulated contacts that run through the filter reading by reading, which bounds the time of a build, and those of
which only the plain mean of the readings is taken."""
MOST = 256
"""Most readings of a touch, and of the rest before it."""
STILL = 8
"""Readings at rest before a touch, beyond a period of the beam: the filter then knows that it lay still."""
FIRST = 2
"""Readings in the first answer: a single one may be a spike."""


@dataclass(frozen=True)
class Answer:
    """The answer once so many readings of a touch have come."""

    readings: int
    since_ms: float
    error_mm: Measurement
    """Mean error, on a beam that follows the touch at once."""
    ringing_mm: Measurement | None = None
    """The same after a sudden force, after which the beam rings; None without it, or if its mass is not stated."""


@dataclass(frozen=True, eq=False)
class Touches:
    """Simulated contacts on a world, and what is wrong with the sensors as long as a contact lasts."""

    prior: Prior
    world: World
    drawn: Draws
    shown_mm: Floats
    """(contacts, channels) deflections at rest, at the sensors where they really stand."""
    errors: SensorErrors

    @classmethod
    def draw(cls, prior: Prior, world: World, count: int, seed: int) -> Self:
        """Draw at least `count` contacts of a prior, evenly."""
        drawn, rng = draw_evenly(prior, count, seed), np.random.default_rng([seed, prior.channels])
        shown = world.under(drawn.position_mm, drawn.force_n)
        gain, zero_mm, mounting = rng.normal(size=(3, *shown.shape))
        if prior.uncertain_at is not None:
            shown = shown + mounting * drawn.force_n[:, None] * prior.uncertain_at(drawn.position_mm)
        perfect = SensorErrors.none(*shown.shape)
        errors = replace(perfect, gain=1 + gain * prior.gain, zero_mm=zero_mm * prior.zero_mm)
        return cls(prior, world, drawn, shown, errors)

    def errors_mm(self, run: Run, sample_mm: Floats, covariance_mm2: Floats) -> Floats:
        """Return the errors (contacts,) of the answers to a sample of each contact, (contacts, channels).

        A channel is NaN, and missing, if its only reading was taken for a spike or is beyond the sensor's range.
        """
        valid = np.isfinite(sample_mm)
        weights = whitening(sample_mm, covariance_mm2, self.prior.gain, self.prior.zero_mm, valid)
        answer = run(np.where(valid, sample_mm, 0.0), weights)["position_mm"].astype(np.float64)
        error: Floats = np.abs(answer - self.drawn.position_mm)
        return error

    def plain_errors_mm(self, run: Run, count: int, noise: Floats) -> Floats:
        """Return the errors (contacts,) for means of as many readings, whose noise is `noise` times its deviation."""
        deviation_mm = self.world.reading_mm / math.sqrt(count)
        sample_mm = self.world.measured(self.shown_mm[:, None], self.errors)[:, 0] + deviation_mm * noise
        return self.errors_mm(run, sample_mm, np.eye(self.prior.channels) * deviation_mm**2)


@dataclass(frozen=True, eq=False)
class Course:
    """A rest, and then touches, each at any time before the first loaded reading."""

    touches: Touches
    chain: Chain
    before: int
    """Readings at rest."""
    since_s: Floats
    """(contacts, readings) since the touch."""
    seed: int

    @classmethod
    def draw(cls, touches: Touches, surface: Surface, longest: int, seed: int) -> Self:
        """Draw the moments of touches of which `longest` loaded readings come."""
        before, rng = STILL + min(MOST, math.ceil(surface.slowest_period)), np.random.default_rng([seed, longest])
        since = np.arange(1 - before, longest + 1) - rng.uniform(size=(len(touches.shown_mm), 1))
        return cls(touches, surface.chain(touches.prior.channels), before, since / surface.stated.sensors.rate_hz, seed)

    def readings(self, ringing_mm: Floats | float = 0.0) -> Floats:
        """Return the readings (contacts, readings, channels), with the same noise each time.

        `ringing_mm` is what ringing adds to the deflections at rest under the load.
        """
        touches = self.touches
        true_mm = (self.since_s > 0)[:, :, None] * (touches.shown_mm[:, None] + ringing_mm)
        return touches.world.readings(true_mm, touches.errors, np.random.default_rng([self.seed, 1]))

    def errors_mm(self, run: Run, readings_mm: Floats, counts: Sequence[int]) -> Floats:
        """Return the errors (counts, contacts) behind the filter after so many loaded readings."""
        at, means, covariances = self.before - 1 + np.array(counts), [], []
        for readings in readings_mm:
            self.chain.restart()
            filtered = self.chain.apply(readings)
            # A channel whose newest reading is not good takes no part.
            means.append(np.where(np.isnan(readings[at]), np.nan, filtered.mean_mm[at]))
            covariances.append(filtered.covariances_mm2(at))
        samples = zip(np.array(means).swapaxes(0, 1), np.array(covariances).swapaxes(0, 1), strict=True)
        return np.array([self.touches.errors_mm(run, *sample) for sample in samples])

    def plain_errors_mm(self, run: Run, readings_mm: Floats, counts: Sequence[int]) -> Floats:
        """Return the errors (counts, contacts) of the plain means of the first loaded readings."""
        touches, variance_mm2 = self.touches, self.touches.world.reading_mm**2 * np.eye(self.touches.world.channels)
        found = []
        for count in counts:
            loaded = readings_mm[:, self.before : self.before + count]
            with np.errstate(invalid="ignore"):  # a channel that is always beyond its range is missing
                mean = np.nansum(loaded, axis=1) / np.isfinite(loaded).sum(axis=1)
            found.append(touches.errors_mm(run, mean, variance_mm2 / count))
        return np.array(found)


def readings_of(chosen: FilterChoice) -> list[int]:
    """Return the numbers of readings since a touch whose answers are measured, up to the longest mean or `MOST`."""
    longest = min(chosen.max_readings, max(MOST, chosen.window))
    return sorted({min(FIRST, longest), chosen.window, min(4 * chosen.window, longest), longest})


def answers_of_means(
    prior: Prior, run: Run, surface: Surface, world: World, error_mm: Measurement, seed: int
) -> list[Answer]:
    """Return the mean errors of a graph for plain means of loaded readings, on a beam that follows a touch at once.

    Parameters
    ----------
    prior, run : of the model, and its graph
    surface, world : the surface, and its world
    error_mm : mean error of the model for a mean of `filter.window` readings at rest
    seed : seed of contacts and noise
    """
    chosen, rate_hz = surface.filter, surface.stated.sensors.rate_hz
    many = Touches.draw(prior, world, KNOWN, seed + 1)
    noise = np.random.default_rng([seed, prior.channels]).normal(size=many.shown_mm.shape)
    usual = many.plain_errors_mm(run, chosen.window, noise) * many.drawn.weight
    found = []
    for count in readings_of(chosen):
        ratio = ratio_of(many.plain_errors_mm(run, count, noise) * many.drawn.weight, usual)
        scatter = math.hypot(ratio.standard_error * error_mm.value, ratio.value * error_mm.standard_error)
        found.append(Answer(count, count * 1e3 / rate_hz, Measurement(ratio.value * error_mm.value, scatter)))
    return found


def answers_since_touch(
    plain: Sequence[Answer], prior: Prior, run: Run, surface: Surface, world: World, seed: int
) -> list[Answer]:
    """Return the mean errors of a model by the time since a touch, behind its filter.

    `plain` are those of `answers_of_means`; so are the other arguments.
    """
    counts = [answer.readings for answer in plain]
    touches = Touches.draw(prior, world, CONTACTS, seed)
    course = Course.draw(touches, surface, counts[-1], seed)
    still = course.readings()
    plain_mm = course.plain_errors_mm(run, still, counts)

    def measure(readings_mm: Floats) -> list[Measurement]:
        more = [mean_of(one, touches.drawn.weight) for one in course.errors_mm(run, readings_mm, counts) - plain_mm]
        return [
            Measurement(one.error_mm.value + other.value, math.hypot(one.error_mm.standard_error, other.standard_error))
            for one, other in zip(plain, more, strict=True)
        ]

    answers = [replace(one, error_mm=error_mm) for one, error_mm in zip(plain, measure(still), strict=True)]
    if world.modes is None:
        return answers
    rings = measure(course.readings(world.ringing_mm(touches.drawn.position_mm, touches.drawn.force_n, course.since_s)))
    return [replace(one, ringing_mm=error_mm) for one, error_mm in zip(answers, rings, strict=True)]
