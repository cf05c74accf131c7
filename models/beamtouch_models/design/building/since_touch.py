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

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.drawing import Draws, draw_evenly
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.statistics import Measurement, mean_of, ratio_of
from beamtouch_models.design.effort import USUAL, Effort
from beamtouch_models.design.replay import replay
from beamtouch_models.design.surface import Surface
from beamtouch_models.design.world import SensorErrors, World
from beamtouch_models.places import as_stated, distances_mm
from beamtouch_models.runtime.session import Run, stated_mm

CONTACTS, KNOWN = 96, 4096
"""Usual numbers of simulated contacts that run through the filter reading by reading, which bounds the time of a
build, and of those of which only the plain mean of the readings is taken."""
LEAST_CONTACTS, LEAST_KNOWN = 8, 256
"""The smallest."""
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
        shown = world.under(as_stated(drawn.place_mm), drawn.force_n)
        gain, zero_mm, mounting = rng.normal(size=(3, *shown.shape))
        if prior.variance_at is not None:
            shown = shown + prior.moved(drawn.place_mm, drawn.force_n, mounting)
        perfect = SensorErrors.none(*shown.shape)
        errors = replace(perfect, gain=1 + gain * prior.errors.gain, zero_mm=zero_mm * prior.errors.zero_mm)
        return cls(prior, world, drawn, shown, errors)

    def errors_mm(self, run: Run, sample_mm: Floats, covariance_mm2: Floats) -> Floats:
        """Return the errors (contacts,) of the answers to a sample of each contact, (contacts, channels).

        A channel is NaN, and missing, if its only reading was taken for a spike or is beyond the sensor's range.
        """
        valid = np.isfinite(sample_mm)
        weights = self.prior.errors.whitening(sample_mm, covariance_mm2, valid)
        answer_mm = stated_mm(run(np.where(valid, sample_mm, 0.0), weights), self.prior.axes)
        return distances_mm(answer_mm - self.drawn.place_mm)

    def plain_errors_mm(self, run: Run, count: int, noise: Floats) -> Floats:
        """Return the errors (contacts,) for means of as many readings, whose noise is `noise` times its deviation."""
        deviation_mm = self.world.reading_mm / math.sqrt(count)
        sample_mm = self.world.measured(self.shown_mm[:, None], self.errors)[:, 0] + deviation_mm * noise
        return self.errors_mm(run, sample_mm, np.eye(self.prior.channels) * deviation_mm**2)


def answers_of_means(
    prior: Prior,
    run: Run,
    surface: Surface,
    world: World,
    error_mm: Measurement,
    seed: int,
    effort: Effort = USUAL,
) -> list[Answer]:
    """Return the mean errors of a graph for plain means of loaded readings, on a beam that follows a touch at once.

    They are those of the first answer, of the mean that the model is made for, and of longer ones.

    Parameters
    ----------
    prior, run : of the model, and its graph
    surface, world : the surface, and its world
    error_mm : mean error of the model for a mean of `filter.window` readings at rest
    seed : seed of contacts and noise
    effort : how many contacts are drawn
    """
    window, rate_hz = surface.filter.window, surface.scene.sensors.rate_hz
    longest = min(surface.filter.max_readings, max(MOST, window))
    many = Touches.draw(prior, world, effort.of(KNOWN, LEAST_KNOWN), seed + 1)
    noise = np.random.default_rng([seed, prior.channels]).normal(size=many.shown_mm.shape)
    counts = sorted({min(FIRST, longest), window, min(4 * window, longest), longest})
    errors_mm = {count: many.plain_errors_mm(run, count, noise) * many.drawn.weight for count in counts}
    answers = []
    for count in counts:
        ratio = ratio_of(errors_mm[count], errors_mm[window])
        scatter = math.hypot(ratio.standard_error * error_mm.value, ratio.value * error_mm.standard_error)
        answers.append(Answer(count, count * 1e3 / rate_hz, Measurement(ratio.value * error_mm.value, scatter)))
    return answers


def answers_since_touch(
    plain: Sequence[Answer],
    prior: Prior,
    run: Run,
    surface: Surface,
    world: World,
    seed: int,
    effort: Effort = USUAL,
) -> list[Answer]:
    """Return the mean errors of a model by the time since a touch, behind its filter.

    `plain` are those of `answers_of_means`; so are the other arguments.
    """
    counts, chain = [answer.readings for answer in plain], surface.chain(prior.channels)
    touches = Touches.draw(prior, world, effort.of(CONTACTS, LEAST_CONTACTS), seed)
    # Readings at rest, and then touches, each at any time before the first loaded reading.
    before, rng = STILL + min(MOST, math.ceil(surface.slowest_period)), np.random.default_rng([seed, counts[-1]])
    since = np.arange(1 - before, counts[-1] + 1) - rng.uniform(size=(len(touches.shown_mm), 1))
    since_s = since / surface.scene.sensors.rate_hz

    def readings_of(ringing_mm: Floats | float = 0.0) -> Floats:
        """Return readings (contacts, readings, channels), with the same noise each time, of a beam that rings."""
        true_mm = (since_s > 0)[:, :, None] * (touches.shown_mm[:, None] + ringing_mm)
        return world.readings(true_mm, touches.errors, np.random.default_rng([seed, 1]))

    still, variance_mm2 = readings_of(), world.reading_mm**2 * np.eye(world.channels)
    plain_mm = []
    for count in counts:
        loaded = still[:, before : before + count]
        with np.errstate(invalid="ignore"):  # a channel that is always beyond its range is missing
            mean = np.nansum(loaded, axis=1) / np.isfinite(loaded).sum(axis=1)
        plain_mm.append(touches.errors_mm(run, mean, variance_mm2 / count))

    def measure(readings_mm: Floats) -> list[Measurement]:
        """Return the error behind the filter after each number of loaded readings."""
        samples = replay(chain, readings_mm, [before - 1 + count for count in counts])
        measured = []
        for index, (answer, of_mean) in enumerate(zip(plain, plain_mm, strict=True)):
            behind = touches.errors_mm(run, samples.mean_mm[:, index], samples.covariance_mm2[:, index])
            more = mean_of(behind - of_mean, touches.drawn.weight)
            scatter = math.hypot(answer.error_mm.standard_error, more.standard_error)
            # Of few touches, chance may take the sum below 0.
            measured.append(Measurement(max(answer.error_mm.value + more.value, 0.0), scatter))
        return measured

    answers = [replace(answer, error_mm=error_mm) for answer, error_mm in zip(plain, measure(still), strict=True)]
    if world.modes is None:
        return answers
    rings = measure(readings_of(world.ringing_mm(as_stated(touches.drawn.place_mm), touches.drawn.force_n, since_s)))
    return [replace(answer, ringing_mm=error_mm) for answer, error_mm in zip(answers, rings, strict=True)]
