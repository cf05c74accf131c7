"""Simulated readings with the posterior's answers, from which a network learns."""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.estimators.posterior.graph import posterior_graph
from beamtouch_models.metadata import FORCE_OUTPUTS, POSITION_OUTPUTS
from beamtouch_models.session import runner

REST_SHARE, WEAK_SHARE = 0.1, 0.15
"""Shares of the examples without a contact, and with a weak contact, at which the odds change sign."""
MISSING_SHARE = 0.2
"""Share of the examples in which one channel is missing, if a position can be found without it."""
MAX_ODDS = 30.0
"""Log odds are clipped to this value; beyond it, contact or rest is certain."""


@dataclass(frozen=True)
class Lessons:
    """Readings and answers. The columns of the answers are the median and the ends of the 95 % interval."""

    deflection_mm: Floats
    """(samples, channels), with noise."""
    valid: Bools
    touched: Bools
    """Whether a contact with a force in the range touches."""
    true_position_mm: Floats
    true_force_n: Floats
    position: Floats
    """(samples, 3) mm"""
    force: Floats
    """(samples, 3) N"""
    log_odds: Floats


def may_miss_one(prior: Prior) -> bool:
    """Return whether position and, if it is open, force are still determined without any one channel."""
    return prior.channels > (1 if prior.force_is_known else 2)


def lessons(prior: Prior, rng: np.random.Generator, size: int, *, contacts_only: bool = False) -> Lessons:
    """Draw contacts and, unless `contacts_only`, some examples at rest, weak contacts and missing channels."""
    position = rng.uniform(*prior.position_mm, size=size)
    force = rng.uniform(*prior.force_n, size=size)
    kind = np.ones(size) if contacts_only else rng.random(size)
    touched = kind >= REST_SHARE + WEAK_SHARE
    part = np.where(touched, 1.0, np.where(kind < REST_SHARE, 0.0, rng.random(size)))
    clean, deviation = prior.sampled(position, force * part)
    deflection = clean + rng.normal(size=clean.shape) * deviation
    valid = np.ones(deflection.shape, np.bool_)
    if may_miss_one(prior) and not contacts_only:
        lacking = np.flatnonzero(rng.random(size) < MISSING_SHARE)
        valid[lacking, rng.integers(prior.channels, size=len(lacking))] = False
    run = runner(posterior_graph(prior, with_force=True).SerializeToString())
    answers = run(np.where(valid, deflection, 0.0), prior.whitening(deflection, valid))
    columns = {name: values.astype(np.float64) for name, values in answers.items()}
    return Lessons(
        deflection,
        valid,
        touched,
        position,
        force,
        np.stack([columns[name] for name in POSITION_OUTPUTS[:3]], axis=1),
        np.stack([columns[name] for name in FORCE_OUTPUTS], axis=1),
        np.clip(columns[POSITION_OUTPUTS[3]], -MAX_ODDS, MAX_ODDS),
    )
