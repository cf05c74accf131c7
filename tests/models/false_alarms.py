"""False contacts and false stretches of `unexplained` per day: through a graph, over sequences of overlapping windows.

Importance sampling over sequences (`rare_rest`): zeros anywhere within twice their drift, evenly, and the errors of the
gains likewise. A contact lasts from the threshold of touch to an
eighth of it, a stretch begins with three odd samples in a row.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import gammaln

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.design.accuracy.drawing import draw
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.thresholds import (
    DRIFTS,
    directions,
    noise_at_rest,
    rate_per_sample,
    readings_alike,
    shapes_at_rest,
)
from beamtouch_models.design.building.measure import thresholds_of
from beamtouch_models.design.estimators.onnx_graph import to_bytes
from beamtouch_models.design.rates import SECONDS_PER_DAY
from beamtouch_models.design.scene import Scene, load_scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.runtime.decision.decider import PERSISTENCE
from beamtouch_models.runtime.metadata_parts import FilterChoice, Thresholds
from beamtouch_models.runtime.session import Run, runner
from models.posterior_cases import graph_of
from models.rare_rest import FARTHEST, Sequences, at_rest, log_tilt, overlapping_means, rest_like_contact, tilted
from support.surfaces.example_scenes import SCENES
from support.surfaces.stated_problems import fewest_mm, real_prior

LIFT = 1 / 8
"""Log odds at which a contact ends, over the threshold of touch."""


@dataclass(frozen=True)
class Watched:
    """A shipped scene as it is built."""

    scene: Scene
    filter: FilterChoice
    prior: Prior
    thresholds: Thresholds
    run: Run

    @property
    def samples_per_day(self) -> float:
        """Number of samples in a day."""
        return SECONDS_PER_DAY * self.scene.sensors.rate_hz

    def answers(self, kept: tuple[int, ...], deflection_mm: Floats) -> dict[str, Floats]:
        """Answers to settled samples (..., channels) of which the channels `kept` are valid; each is (...)."""
        flat = deflection_mm.reshape(-1, self.prior.channels)
        valid = np.zeros(flat.shape, np.bool_)
        valid[:, kept] = True
        reading = np.where(valid, flat, 0.0)
        weights = self.prior.errors.whitening(reading, valid=valid)
        square = (np.einsum("dij,dj->di", weights, reading) ** 2).sum(axis=1)
        found = {name: values.astype(np.float64) for name, values in self.run(reading, weights).items()}
        return {name: values.reshape(deflection_mm.shape[:-1]) for name, values in (*found.items(), ("rest", square))}


def windows_of(chosen: FilterChoice) -> tuple[int, int]:
    """Return the numbers of readings in a mean at which stretches are counted."""
    return max(2, chosen.window), max(2, readings_alike(chosen))


@cache
def surface(name: str) -> Watched:
    """The surface of a shipped scene."""
    scene, _ = load_scene(SCENES / f"{name}.toml")
    built = resolve(scene)
    noise_mm = built.noise.sample_mm
    prior = real_prior(built.scene, fewest_mm(built.scene, noise_mm), noise_mm)
    return Watched(scene, built.filter, prior, thresholds_of(prior, built), runner(to_bytes(graph_of(prior))))


def false_contacts_per_day(on: Watched, kept: tuple[int, ...], draws: int, seed: int = 5) -> float:
    """Contacts per day that begin at rest while the channels `kept` are valid."""
    noise, threshold = noise_at_rest(on.prior)[list(kept)], on.thresholds.touch[len(kept) - 1]
    rate = rate_per_sample(on.thresholds.false_contacts_per_day, on.scene.sensors.rate_hz, on.filter.window)
    rest = rest_like_contact(directions(shapes_at_rest(on.prior)[:, kept]), noise, rate, draws, seed)
    means, first = overlapping_means(rest.noise / noise, on.filter.window, 1, np.random.default_rng(seed))
    reading = _unwhitened(on.prior, kept, rest.zero[:, None] + noise * means)
    begun = on.answers(kept, reading[:, first])["contact_log_odds"] > threshold
    odds = on.answers(kept, reading[begun])["contact_log_odds"]
    # A sample belongs to the same contact if none between them lies below the threshold of a lift.
    after, before = odds[:, first:], odds[:, first::-1]
    count = np.zeros(len(odds))
    for side in (after, before):
        count += ((side > threshold) & (np.minimum.accumulate(side, axis=1) > LIFT * threshold)).sum(axis=1)
    return float((rest.weight[begun] / (count - 1)).sum() / draws * on.samples_per_day)


def false_stretches_per_day(on: Watched, kept: tuple[int, ...], draws: int, seed: int = 6) -> float:
    """Stretches per day that begin at rest while only `kept` are valid, in the worst of the filter's windows."""
    return max(_stretches_at_rest(on, kept, window, draws, seed) for window in windows_of(on.filter))


def _stretches_at_rest(on: Watched, kept: tuple[int, ...], window: int, draws: int, seed: int) -> float:
    drawn = at_rest(noise_at_rest(on.prior)[list(kept)], window, draws, seed)
    return _stretches_per_day(on, kept, drawn, _unwhitened(on.prior, kept, drawn.sample))


def false_stretches_of_contacts_per_day(on: Watched, kept: tuple[int, ...], draws: int, seed: int = 7) -> float:
    """Stretches per day that begin while contacts of the prior last, in the worst of the filter's windows.

    Gains are off by up to twice the floor.
    """
    return max(_stretches_of_contacts(on, kept, window, draws, seed) for window in windows_of(on.filter))


def _stretches_of_contacts(on: Watched, kept: tuple[int, ...], window: int, draws: int, seed: int) -> float:
    prior, size, rng = on.prior, len(kept), np.random.default_rng(seed)
    contacts = draw(prior, draws, seed)
    clean = contacts.force_n[:, None] * prior.influence_table(contacts.place_mm)
    moved = contacts.force_n[:, None] * prior.influence_table.slope(contacts.place_mm)[..., 0]
    deviation = prior.errors.deviation_mm(clean)
    clean, moved, deviation = (values[:, kept] for values in (clean, moved, deviation))
    noise = prior.errors.noise_mm / deviation
    # All directions but those of the force and of the position, in deviations of the noise.
    known = np.stack([clean / deviation, moved / deviation], axis=2)
    basis = np.linalg.qr(known, mode="complete")[0][:, :, 2:]
    inside, _ = np.linalg.qr(basis * noise[:, :, None])
    radius = FARTHEST * rng.random(draws)
    toward = rng.normal(size=(draws, size - 2))
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    along = np.einsum("dcm,dm->dc", inside, toward)
    white = rng.normal(size=(draws, size))
    white -= np.einsum("dcm,dnm,dn->dc", inside, inside, white)
    means, first = overlapping_means(white + radius[:, None] * along, window, PERSISTENCE, rng)
    tilt = radius[:, None] * np.einsum("dcm,dnm,dn->dc", basis, basis, along / noise)
    density = (size - 3) * np.log(radius) - radius**2 / 2 - ((size - 2) / 2 - 1) * np.log(2) - gammaln((size - 2) / 2)
    constant = np.zeros_like(clean)
    gain, zero_mm = (
        np.broadcast_to(value, prior.channels)[list(kept)] for value in (prior.errors.gain, prior.errors.zero_mm)
    )
    for error in (zero_mm / deviation, gain * np.abs(clean) / deviation):
        part = tilted(tilt, DRIFTS * error, rng)
        density -= log_tilt(part, tilt, DRIFTS * error)
        constant += part
    sample = np.zeros((draws, means.shape[1], prior.channels))
    sample[:, :, kept] = (clean + deviation * constant)[:, None] + prior.errors.noise_mm * means
    drawn = Sequences(means, FARTHEST * np.exp(density), first)
    return _stretches_per_day(on, kept, drawn, sample)


def _stretches_per_day(on: Watched, kept: tuple[int, ...], drawn: Sequences, reading: Floats) -> float:
    # Only sequences that are odd where they are drawn large count.
    candidates = np.ones(len(reading), np.bool_)
    for sample in range(drawn.first, drawn.first + PERSISTENCE):
        candidates[candidates] = _odd(on, kept, reading[candidates, sample])
    odd = np.zeros(reading.shape[:2], np.bool_)
    odd[candidates] = _odd(on, kept, reading[candidates])
    runs = odd[:, :-2] & odd[:, 1:-1] & odd[:, 2:]
    counted = runs[:, drawn.first]
    return float((drawn.weight[counted] / runs[counted].sum(axis=1)).sum() / len(odd)) * on.samples_per_day


def _odd(on: Watched, kept: tuple[int, ...], reading: Floats) -> Bools:
    answers, misfit = on.answers(kept, reading), on.thresholds.misfit[len(kept) - 1]
    odd: Bools = (answers["rest"] > on.thresholds.rest[len(kept) - 1]) & (answers["misfit"] > misfit)
    return odd


def _unwhitened(prior: Prior, kept: tuple[int, ...], sample: Floats) -> Floats:
    """Deflections (..., channels) of whitened samples (..., kept) at rest."""
    deflection = np.zeros((*sample.shape[:-1], prior.channels))
    deflection[..., kept] = sample * prior.rest_mm[list(kept)]
    return deflection
