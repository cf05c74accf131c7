"""The error of a model by the time since a touch, behind the filter that it is made for.

Simulated readings run through the daemon's own filter: of a touch that the beam follows at once, and of a sudden force,
after which it rings in all modes with the damping of the scene, as in `challenge`. Few contacts are enough, because
they only give the difference to the plain mean of their loaded readings, whose error comes from many contacts.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from beamtouch_models.accuracy.limit import Draws, draw_evenly
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.statistics import Measurement, mean_of, ratio_of
from beamtouch_models.arrays import Floats
from beamtouch_models.error_model import whitening
from beamtouch_models.filters import Chain
from beamtouch_models.metadata import FilterChoice, SinceTouch
from beamtouch_models.physics.motion import Modes, damping_of, swings
from beamtouch_models.session import Run
from beamtouch_models.surface import Surface

CONTACTS, KNOWN = 96, 4096
"""Simulated contacts that run through the filter reading by reading, which bounds the time of a build, and those of
which only the plain mean of the readings is taken."""
MOST = 256
"""Most readings of a touch, and of the rest before it."""
STILL = 8
"""Readings at rest before a touch, beyond a period of the beam: the filter then knows that it lay still."""
FIRST = 2
"""Readings in the first answer: a single one may be a spike."""


@dataclass(frozen=True, eq=False)
class Touches:
    """Simulated contacts, and what is wrong with the sensors as long as a contact lasts."""

    prior: Prior
    drawn: Draws
    reading_mm: float
    """Noise of a reading."""
    shown_mm: Floats
    """(contacts, channels) deflections at the sensors where they really stand."""
    gain: Floats
    zero_mm: Floats
    """(contacts, channels) relative error of the gain, and the zero."""

    @classmethod
    def draw(cls, prior: Prior, reading_mm: float, count: int, seed: int) -> Self:
        """Draw at least `count` contacts of a prior, evenly."""
        drawn, rng = draw_evenly(prior, count, seed), np.random.default_rng([seed, prior.channels])
        shown = drawn.force_n[:, None] * prior.influence_at(drawn.position_mm)
        gain, zero_mm, mounting = rng.normal(size=(3, *shown.shape))
        if prior.uncertain_at is not None:
            shown = shown + mounting * drawn.force_n[:, None] * prior.uncertain_at(drawn.position_mm)
        return cls(prior, drawn, reading_mm, shown, gain * prior.gain, zero_mm * prior.zero_mm)

    @property
    def weight(self) -> Floats:
        """Weight of each contact in an average, (contacts,)."""
        return np.broadcast_to(self.drawn.weight, len(self.shown_mm))

    def measured_mm(self, true_mm: Floats) -> Floats:
        """Return readings without noise of true deflections; both (contacts, readings, channels)."""
        linear = (true_mm * (1 + self.gain[:, None])).reshape(-1, self.prior.channels)
        return self.prior.measured(linear).reshape(true_mm.shape) + self.zero_mm[:, None]

    def errors_mm(self, run: Run, sample_mm: Floats, covariance_mm2: Floats) -> Floats:
        """Return the errors (contacts,) of the answers to a sample of each contact, (contacts, channels).

        A channel whose only reading was taken for a spike is NaN, and missing.
        """
        valid = np.isfinite(sample_mm)
        weights = whitening(sample_mm, covariance_mm2, self.prior.gain, self.prior.zero_mm, valid)
        answer = run(np.where(valid, sample_mm, 0.0), weights)["position_mm"].astype(np.float64)
        error: Floats = np.abs(answer - self.drawn.position_mm)
        return error

    def plain_errors_mm(self, run: Run, count: int, noise: Floats) -> Floats:
        """Return the errors (contacts,) for means of as many readings, whose noise is `noise` times its deviation."""
        deviation_mm = self.reading_mm / math.sqrt(count)
        sample_mm = self.measured_mm(self.shown_mm[:, None])[:, 0] + deviation_mm * noise
        return self.errors_mm(run, sample_mm, np.eye(self.prior.channels) * deviation_mm**2)


@dataclass(frozen=True, eq=False)
class Course:
    """The readings of touches: a rest, and then a touch at any time before the first loaded reading."""

    touches: Touches
    chain: Chain
    before: int
    """Readings at rest."""
    since_s: Floats
    """(contacts, readings) since the touch."""
    noise_mm: Floats
    """(contacts, readings, channels)"""

    @classmethod
    def draw(cls, touches: Touches, surface: Surface, longest: int, seed: int) -> Self:
        """Draw the noise and the moments of touches of which `longest` loaded readings come."""
        channels, rate_hz = touches.prior.channels, surface.stated.sensors.rate_hz
        before = STILL + min(MOST, math.ceil(surface.slowest_period))
        rng = np.random.default_rng([seed, channels, longest])
        since_s = (np.arange(1 - before, longest + 1) - rng.uniform(size=(len(touches.shown_mm), 1))) / rate_hz
        noise_mm = touches.reading_mm * rng.normal(size=(*since_s.shape, channels))
        return cls(touches, surface.chain(channels), before, since_s, noise_mm)

    def errors_mm(self, run: Run, counts: Sequence[int], ringing_mm: Floats | float = 0.0) -> Floats:
        """Return the errors (counts, contacts) behind the filter after so many loaded readings.

        `ringing_mm` (contacts, readings, channels) is what ringing adds to the deflections.
        """
        true_mm = (self.since_s > 0)[:, :, None] * (self.touches.shown_mm[:, None] + ringing_mm)
        at, means, covariances = self.before - 1 + np.array(counts), [], []
        for readings in self.touches.measured_mm(true_mm) + self.noise_mm:
            self.chain.restart()
            filtered = self.chain.apply(readings)
            means.append(filtered.mean_mm[at])
            covariances.append(filtered.covariances_mm2(at))
        samples = zip(np.array(means).swapaxes(0, 1), np.array(covariances).swapaxes(0, 1), strict=True)
        return np.array([self.touches.errors_mm(run, *sample) for sample in samples])

    def plain_errors_mm(self, run: Run, counts: Sequence[int]) -> Floats:
        """Return the errors (counts, contacts) of the plain means of the same loaded readings."""
        loaded = self.noise_mm[:, self.before :] / self.touches.reading_mm
        return np.array(
            [self.touches.plain_errors_mm(run, one, loaded[:, :one].sum(axis=1) / math.sqrt(one)) for one in counts]
        )


def readings_of(chosen: FilterChoice) -> list[int]:
    """Return the numbers of readings since a touch whose answers are measured, up to the longest mean or `MOST`."""
    longest = min(chosen.max_readings, max(MOST, chosen.window))
    return sorted({min(FIRST, longest), chosen.window, min(4 * chosen.window, longest), longest})


def errors_of_means(
    prior: Prior, run: Run, reading_mm: float, counts: Sequence[int], window: int, error: Measurement, seed: int
) -> list[Measurement]:
    """Return the mean errors of a graph for plain means of so many loaded readings, with their standard errors.

    Parameters
    ----------
    prior, run : of the model, and its graph
    reading_mm : noise of a reading
    counts : numbers of readings
    window, error : number of readings in a mean whose error is known, and this error; the result is in its unit
    seed : seed of contacts and noise
    """
    many = Touches.draw(prior, reading_mm, KNOWN, seed + 1)
    noise = np.random.default_rng([seed, prior.channels]).normal(size=many.shown_mm.shape)
    usual = many.plain_errors_mm(run, window, noise) * many.weight
    found = []
    for count in counts:
        ratio = ratio_of(many.plain_errors_mm(run, count, noise) * many.weight, usual)
        scatter = math.hypot(ratio.standard_error * error.value, ratio.value * error.standard_error)
        found.append(Measurement(ratio.value * error.value, scatter))
    return found


def errors_since_touch(
    prior: Prior, run: Run, surface: Surface, sensor_mm: Floats, error: Measurement, seed: int
) -> list[SinceTouch]:
    """Return the mean errors of the model by the time since a touch, with their standard errors.

    Parameters
    ----------
    prior, run : of the model, and its graph
    surface, sensor_mm : the surface, and the positions of its sensors (channels,)
    error : mean error of the model in percent, for a mean of `filter.window` readings at rest
    seed : seed of contacts and noise
    """
    chosen, rate_hz = surface.filter, surface.stated.sensors.rate_hz
    beam, reading_mm = surface.stated.beam, surface.noise.reading_mm
    counts = readings_of(chosen)
    longest = counts[-1]
    known = errors_of_means(prior, run, reading_mm, counts, chosen.window, error, seed)
    touches = Touches.draw(prior, reading_mm, CONTACTS, seed)
    course = Course.draw(touches, surface, longest, seed)
    plain, weight = course.plain_errors_mm(run, counts), touches.weight

    def measured(errors_mm: Floats) -> list[Measurement]:
        worse = [mean_of(one, weight).scaled(100 / prior.length_mm) for one in errors_mm - plain]
        return [
            Measurement(one.value + more.value, math.hypot(one.standard_error, more.standard_error))
            for one, more in zip(known, worse, strict=True)
        ]

    followed, modes = measured(course.errors_mm(run, counts)), Modes.of(beam, surface.stated.contact.width_mm)
    answers = [
        SinceTouch(
            since_ms=count * 1e3 / rate_hz,
            readings=count,
            error_percent=one.value,
            error_standard_error=one.standard_error,
        )
        for count, one in zip(counts, followed, strict=True)
    ]
    if modes is None:
        return answers
    drawn = touches.drawn
    loaded = swings(
        modes.at(sensor_mm), modes.under(drawn.position_mm), modes.square_s2, drawn.force_n, drawn.force_n * 0
    )
    ringing = measured(course.errors_mm(run, counts, loaded.ringing_mm(course.since_s, damping_of(beam))))
    return [
        answer.model_copy(update={"ringing_percent": one.value, "ringing_standard_error": one.standard_error})
        for answer, one in zip(answers, ringing, strict=True)
    ]
