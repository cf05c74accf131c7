"""Intervals by the place of the contact: as many hold at the ends of the range, and next to a support, as elsewhere."""

from functools import cache

import numpy as np
import pytest
from scipy.stats import binom

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.places import on_axis
from models.posterior_cases import answers_of, graph_of, prior_of, with_floor

SCENES = (("bench", 4, 0.1), ("cantilever", 3, 0.2), ("two-spans", 5, 0.25))
"""Name, sensors, and noise in percent of the largest deflection."""
LEAST = 0.93
"""Least share of contacts that their intervals hold, wherever they are."""
CHANCE = 1e-4
"""Probability that a stretch which just meets it fails here."""
BINS, CONTACTS = 20, 800
"""Stretches of the range, and contacts in each."""
LAST = 0.004
"""Part of the range that is the last stretch before an end: 1.6 mm on the bench."""


@cache
def _prior(name: str, sensors: int, noise_percent: float) -> Prior:
    return with_floor(prior_of(name, sensors, noise_percent, known=False))


def _held(prior: Prior, low_mm: float, high_mm: float, seed: int) -> Bools:
    """Return whether intervals hold contacts in a stretch, of forces over their range; of contacts that are seen."""
    rng = np.random.default_rng(seed)
    place: Floats = rng.uniform(low_mm, high_mm, CONTACTS)
    force = rng.uniform(*prior.force_n, CONTACTS)
    answers = answers_of(graph_of(prior), prior, prior.draw(on_axis(place), force, rng))
    held = (answers["position_low_mm"] <= place) & (place <= answers["position_high_mm"])
    return np.asarray(held[answers["contact_log_odds"] > 15])


def _fewest(count: int) -> int:
    """The fewest of a number of contacts that are held but for chance."""
    return int(binom.ppf(CHANCE, count, LEAST))


@pytest.mark.parametrize(("name", "sensors", "noise_percent"), SCENES)
@pytest.mark.parametrize("from_end", [0, 1])
def test_contacts_at_an_end_of_the_range_are_held(name: str, sensors: int, noise_percent: float, from_end: int) -> None:
    prior = _prior(name, sensors, noise_percent)
    low, high = prior.extent.range_mm
    last = LAST * (high - low)
    held = _held(prior, *((low, low + last) if from_end == 0 else (high - last, high)), seed=from_end)
    assert len(held) > CONTACTS / 4
    assert held.sum() >= _fewest(len(held))


@pytest.mark.parametrize(("name", "sensors", "noise_percent"), SCENES)
def test_contacts_in_each_stretch_of_the_range_are_held(name: str, sensors: int, noise_percent: float) -> None:
    prior = _prior(name, sensors, noise_percent)
    edges = np.linspace(*prior.extent.range_mm, BINS + 1)
    stretches = zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
    held = [_held(prior, low, high, seed) for seed, (low, high) in enumerate(stretches)]
    too_few = [
        part for part, those in enumerate(held) if len(those) > CONTACTS / 4 and those.sum() < _fewest(len(those))
    ]
    assert not too_few
