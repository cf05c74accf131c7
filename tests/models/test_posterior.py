"""The posterior graph: against a plain integral, against the accuracy limit, with channels missing."""

from itertools import combinations

import numpy as np
import pytest

from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats
from beamtouch_models.estimators.onnx_graph import IR_VERSION, OPSET
from beamtouch_models.estimators.posterior.channels import fewest_channels
from beamtouch_models.export import to_bytes
from posterior_cases import answers_of, graph_of, prior_of

QUANTILES = (0.5, 0.025, 0.975)


def plain_posterior(prior: Prior, reading: Floats) -> tuple[Floats, tuple[float, float], float]:
    """Quantiles of position, mean and deviation of force, log odds of contact, as sums over a grid of both."""
    # By the trapezoidal and the midpoint rule: finer grids change nothing by a twentieth of what is tolerated.
    grid = np.linspace(*prior.position_mm, 3001)
    ends = np.linspace(*prior.force_n, 1 if prior.force_is_known else 501)
    force = ends if prior.force_is_known else (ends[1:] + ends[:-1]) / 2
    shape = prior.influence_at(grid) / prior.noise_mm
    z = reading / prior.noise_mm
    # |z - F g|^2 expanded; in float64 that costs no digit that matters at these sizes.
    square = (shape**2).sum(axis=1)[:, None] * force**2 - 2 * (shape @ z)[:, None] * force
    mass = np.exp(-square / 2 - (-square / 2).max())
    along = mass.mean(axis=1)
    below = np.append(0, np.cumsum(along[1:] + along[:-1])) / 2
    odds = float((-square / 2).max() + np.log(below[-1] / (len(grid) - 1)))
    position = np.interp(QUANTILES, below / below[-1], grid)
    share = mass.sum(axis=0) / mass.sum()
    mean = float(share @ force)
    return position, (mean, float(share @ (force - mean) ** 2) ** 0.5), odds


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("noise_percent", [10.0, 2.0])
def test_answers_are_those_of_a_plain_integral_over_position_and_force(noise_percent: float, known: bool) -> None:
    prior = prior_of("bench", 3, noise_percent, known=known)
    drawn = limit.draw(prior, 40, 5)
    answers = answers_of(graph_of(prior), drawn.deflection_mm)
    for row, reading in enumerate(drawn.deflection_mm):
        position, force, odds = plain_posterior(prior, reading)
        found = [answers[name][row] for name in ("position_mm", "position_low_mm", "position_high_mm")]
        assert found == pytest.approx(position.tolist(), abs=0.05 * (position[2] - position[1]))
        assert answers["contact_log_odds"][row] == pytest.approx(odds, abs=0.2)
        if not known:
            mean, deviation = force
            # A cell gives its best force, not its mean: that is off where the range cuts the force off.
            assert answers["force_n"][row] == pytest.approx(mean, abs=0.4 * deviation)
            # From 1.645 deviations either side, of an even distribution, to 1.96; less where the range ends.
            width = answers["force_high_n"][row] - answers["force_low_n"][row]
            assert 2.2 * deviation < width < 4.2 * deviation


CASES = [
    (name, sensors, noise, known)
    for name, sensors in (("bench", 4), ("two-spans", 5), ("cantilever", 2))
    for noise in (10.0, 1.0, 0.1, 0.01)
    for known in (True, False)
]


@pytest.mark.parametrize(("name", "sensors", "noise_percent", "known"), CASES)
def test_the_error_is_at_the_limit_and_intervals_hold_the_truth(
    name: str, sensors: int, noise_percent: float, known: bool
) -> None:
    prior = prior_of(name, sensors, noise_percent, known=known)
    drawn = limit.draw(prior, 2500, 11)
    answers = answers_of(graph_of(prior), drawn.deflection_mm)
    error = np.abs(answers["position_mm"] - drawn.position_mm)
    best = np.abs(limit.posterior_median_mm(prior, drawn.deflection_mm) - drawn.position_mm)
    ratio = error.mean() / best.mean()
    spread = (error - ratio * best).std() / best.mean() / len(error) ** 0.5
    assert ratio < 1.05 + 3 * spread
    assert ratio > 0.999 - 3 * spread  # nothing is better than the limit, which is itself computed on a grid
    pairs = [("position_low_mm", "position_high_mm", drawn.position_mm)]
    if not known:
        pairs.append(("force_low_n", "force_high_n", drawn.force_n))
    for low, high, truth in pairs:
        inside = ((answers[low] <= truth) & (truth <= answers[high])).mean()
        # 95 +- 1 %, and four deviations of so many draws.
        assert abs(inside - 0.95) < 0.01 + 4 * (0.95 * 0.05 / len(truth)) ** 0.5


@pytest.mark.parametrize(
    ("name", "sensors", "known"), [("bench", 4, False), ("bench", 3, True), ("foundation", 4, False)]
)
def test_any_channels_that_determine_a_position_do_so_as_well_as_they_can(name: str, sensors: int, known: bool) -> None:
    prior = prior_of(name, sensors, 1.0, known=known)
    fewest = fewest_channels(prior, 0)
    assert fewest < sensors
    drawn = limit.draw(prior, 1500, 12)
    graph = graph_of(prior)
    for size in range(fewest, sensors):
        for kept in combinations(range(sensors), size):
            valid = np.zeros(drawn.deflection_mm.shape, np.bool_)
            valid[:, kept] = True
            # What a missing channel holds is no number.
            answers = answers_of(graph, np.where(valid, drawn.deflection_mm, np.nan), valid)
            missing = set(range(sensors)) - set(kept)
            best = limit.posterior_median_mm(prior.without(*missing), drawn.deflection_mm[:, kept])
            error, least = (np.abs(x - drawn.position_mm).mean() for x in (answers["position_mm"], best))
            assert error < 1.05 * least, kept
            held = (answers["position_low_mm"] <= drawn.position_mm) & (
                drawn.position_mm <= answers["position_high_mm"]
            )
            assert abs(held.mean() - 0.95) < 0.035, kept


def test_a_single_sensor_that_sees_both_halves_alike_determines_nothing() -> None:
    alike = prior_of("bench", 1, 1.0, known=True)
    middle = Prior(
        alike.length_mm,
        alike.position_mm,
        alike.force_n,
        alike.noise_mm,
        3,
        lambda load_mm: np.repeat(np.sin(np.pi * load_mm / 400)[:, None], 3, axis=1),
    )
    assert fewest_channels(middle, 0) == 3
    assert fewest_channels(prior_of("cantilever", 3, 1.0, known=True), 0) == 1


def test_the_log_odds_are_honest() -> None:
    prior = prior_of("bench", 2, 10.0, known=False)
    rng = np.random.default_rng(3)
    graph = graph_of(prior)
    rest = answers_of(graph, rng.normal(scale=prior.noise_mm, size=(60_000, 2)))["contact_log_odds"]
    touched = answers_of(graph, limit.draw(prior, 60_000, 4).deflection_mm)["contact_log_odds"]
    for low, high in ((-1.5, -0.5), (-0.5, 0.5), (0.5, 1.5), (1.5, 2.5)):
        at_rest, in_contact = (((low < odds) & (odds < high)).sum() for odds in (rest, touched))
        spread = (1 / at_rest + 1 / in_contact) ** 0.5
        # Samples with such odds come from contacts that many times as often as from rest.
        inside = np.concatenate([odds[(low < odds) & (odds < high)] for odds in (rest, touched)])
        assert np.log(in_contact / at_rest) == pytest.approx(inside.mean(), abs=4 * spread + 0.1)


def test_the_same_prior_gives_the_same_bytes_for_the_oldest_runtime() -> None:
    prior = prior_of("bench", 4, 1.0, known=False)
    first, second = graph_of(prior), graph_of(prior)
    assert to_bytes(first) == to_bytes(second)
    assert (first.opset_import[0].version, first.ir_version) == (OPSET, IR_VERSION) == (17, 8)
