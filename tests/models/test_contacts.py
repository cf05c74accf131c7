"""Simulated contacts: figures from them scatter as they say, and have the mean of plain draws."""

import numpy as np
import pytest
from scipy.stats import chi2

from beamtouch_models.design.accuracy import posterior
from beamtouch_models.design.accuracy.drawing import draw
from beamtouch_models.design.accuracy.limit import simulated
from beamtouch_models.design.accuracy.statistics import Measurement, mean_of, quantile_of, share_of
from models.posterior_cases import prior_of

SEEDS = 50
CASES = [
    pytest.param(("cantilever", 2, 1.0, False), marks=pytest.mark.soak),
    ("bench", 2, 1e-3, False),
    pytest.param(("paper", 2, 2.0, True), marks=pytest.mark.soak),
    pytest.param(("two-spans", 3, 10.0, False), marks=pytest.mark.soak),
]


def figures_of(case: tuple[str, int, float, bool], count: int, seed: int) -> dict[str, Measurement]:
    """Figures of an estimator that is a little off, and states an interval that is a little short."""
    name, sensors, noise, known = case
    prior = prior_of(name, sensors, noise, known=known)
    contacts = simulated(prior, count, seed)
    weight, median = contacts.drawn.weight, contacts.median_mm
    many = np.broadcast_to(weight[:, None], contacts.likely_mm.shape[:2])
    off = median + contacts.distance_mm[:, None]
    reached = contacts.reached(off)
    held = np.abs(contacts.likely_mm - median[:, None])[..., 0] < 2 * contacts.distance_mm[:, None]
    return {
        "limit": reached.limit_mm,
        "error": reached.error_mm,
        "ratio": reached.ratio,
        "95th percentile": quantile_of(contacts.error_mm(off), 0.95, many),
        "held": share_of(held, many),
    }


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_the_stated_standard_errors_are_those_over_seeds(case: tuple[str, int, float, bool]) -> None:
    every = [figures_of(case, 128, seed) for seed in range(SEEDS)]
    for name in every[0]:
        values = np.array([one[name].value for one in every])
        stated = np.array([one[name].standard_error for one in every])
        # The stated variance has 15 degrees of freedom each time, the spread 49; a part in a million on either side.
        spread = (SEEDS - 1) * values.var(ddof=1) / (stated**2).mean()
        low, high = chi2.ppf([1e-6, 1 - 1e-6], SEEDS - 1)
        assert low < spread < high * (2 if name == "95th percentile" else 1), name


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("draws", [5_000, pytest.param(20_000, marks=pytest.mark.soak)])
def test_the_figures_are_those_of_plain_draws(case: tuple[str, int, float, bool], draws: int) -> None:
    name, sensors, noise, known = case
    prior = prior_of(name, sensors, noise, known=known)
    drawn = draw(prior, draws, 7)
    quantiles, deviation = posterior.posterior_quantiles(prior, drawn.deflection_mm)
    median = quantiles[:, 0]
    plain = {
        "limit": mean_of(np.abs(median - drawn.position_mm)),
        "error": mean_of(np.abs(median + deviation - drawn.position_mm)),
        "95th percentile": quantile_of(np.abs(median + deviation - drawn.position_mm), 0.95),
        "held": share_of(np.abs(median - drawn.position_mm) < 2 * deviation),
    }
    found = figures_of(case, 2048, 8)
    for figure, expected in plain.items():
        off = abs(found[figure].value - expected.value)
        assert off < 5 * np.hypot(found[figure].standard_error, expected.standard_error), figure
    # Of as many contacts, with a bound that also a case of rare and large errors keeps.
    assert found["limit"].standard_error < plain["limit"].standard_error * (draws / 2048) ** 0.5 * 0.7


def test_a_weight_counts_like_repeated_cases() -> None:
    values, counts = np.arange(64.0), np.tile([1.0, 3.0], 32)
    every = np.repeat(values, counts.astype(int))
    assert mean_of(values, counts).value == pytest.approx(every.mean())
    assert quantile_of(values, 0.8, counts).value == pytest.approx(np.quantile(every, 0.8), abs=1)


def test_a_share_of_none_has_a_standard_error() -> None:
    assert share_of(np.zeros(999, np.bool_)).standard_error == pytest.approx(1e-3, rel=0.02)
