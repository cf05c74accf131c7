"""An evaluation against closed forms, of a model whose answers are sums of its channels.

It states 100 + 100 (d2 + 2 d3) mm +- 1 mm, a force of 10 (d1 + d2 + d3) N and log odds of ten times that. Under 1 N at
x, its sensors show 1, (x - 100) / 100 and 0 mm, each with the same noise: only the second tells the place.
"""

import numpy as np
import pytest
from scipy.stats import norm

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.evaluation import Evaluation, estimates, evaluate
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.places import Extent
from beamtouch_models.runtime.error_model import Errors
from support.surfaces.small_model import model_of

NOISE_MM = 0.004
MODEL = model_of()
LIMIT_MM = 100 * NOISE_MM * (2 / np.pi) ** 0.5
"""The mean size of a normal error of 100 noises; the model's are the root of 5 times as large."""


def shown(place_mm: Floats) -> Floats:
    x = place_mm[:, 0]
    return np.stack([np.ones(len(x)), x / 100 - 1, np.zeros(len(x))], axis=1)


def prior(noise_mm: float = NOISE_MM, force_n: tuple[float, float] = (1.0, 1.0)) -> Prior:
    return Prior(Extent.of_beam((0.0, 400.0)), 400.0, force_n, Errors(noise_mm), 3, shown)


@pytest.fixture(scope="module")
def found() -> Evaluation:
    return evaluate(MODEL, prior(), draws=4096, seed=3)


def test_errors_are_those_of_the_channels_that_the_model_adds_up(found: Evaluation) -> None:
    assert found.span.mean_mm.value == pytest.approx(5**0.5 * LIMIT_MM, rel=0.02)
    assert found.span.p95_mm.value == pytest.approx(5**0.5 * 100 * NOISE_MM * norm.isf(0.025), rel=0.03)
    assert found.span.limit_mean_mm is not None
    assert found.span.limit_mean_mm.value == pytest.approx(LIMIT_MM, rel=0.01)
    assert found.span.limit_p95_mm is not None
    assert found.span.limit_p95_mm.value == pytest.approx(100 * NOISE_MM * norm.isf(0.025), rel=0.03)
    assert found.span.ratio is not None
    assert found.span.ratio.value == pytest.approx(5**0.5, rel=0.02)
    assert 3 < found.span.worst_mm / (5**0.5 * 100 * NOISE_MM) < 5
    assert found.cramer_rao_mean_mm == pytest.approx(LIMIT_MM, rel=1e-3)
    assert (found.noise_mm, found.draws, found.length_mm) == (NOISE_MM, 4096, 400.0)
    assert found.middle is not None
    assert found.middle.mean_mm.value == pytest.approx(5**0.5 * LIMIT_MM, rel=0.03)
    assert found.middle.worst_mm <= found.span.worst_mm


def test_intervals_hold_as_often_as_a_normal_error_is_that_small(found: Evaluation) -> None:
    assert found.position_coverage is not None
    assert found.position_coverage.value == pytest.approx(1 - 2 * norm.sf(1 / (5**0.5 * 100 * NOISE_MM)), abs=0.01)
    assert found.position_width_mm is not None
    assert found.position_width_mm.value == pytest.approx(2.0, rel=1e-4)
    assert found.axis_coverage is None


def test_shares_are_those_of_the_stretches_where_a_threshold_is_passed(found: Evaluation) -> None:
    """Odds of x are a touch beyond 10 mm; a misfit of 10 (100 - x) is explained from 97 mm on; a force is x / 10."""
    assert found.missed is not None
    assert found.missed.value == pytest.approx(10 / 400, abs=3e-3)
    assert found.unexplained is not None
    assert found.unexplained.value == pytest.approx(97 / 400, abs=3e-3)
    assert found.force_error_n is not None
    assert found.force_error_n.value == pytest.approx((5 + 390**2 / 20) / 400, rel=5e-3)
    assert found.force_coverage is None  # the force is exact
    assert found.smallest_force_n is not None


def test_without_a_channel_the_others_are_judged_by_their_own_thresholds() -> None:
    """Odds are then x - 100, and no misfit of two channels is odd."""
    fewer = evaluate(MODEL, prior(), draws=1024, seed=3, missing=(0,))
    assert fewer.missed is not None
    assert fewer.missed.value == pytest.approx(110 / 400, abs=0.01)
    assert fewer.unexplained is not None
    assert fewer.unexplained.value == 0.0
    assert fewer.span.mean_mm.value == pytest.approx(5**0.5 * LIMIT_MM, rel=0.03)
    answers = estimates(MODEL, prior().without(0), np.array([[0.5, 0.25]]), missing=(0,))
    assert answers["position_mm"] == pytest.approx([200.0])
    assert answers["force_n"] == pytest.approx([7.5])


def test_without_noise_there_is_no_limit_and_an_open_force_has_a_coverage() -> None:
    silent = evaluate(MODEL, prior(0.0), draws=64, seed=1)
    assert (silent.span.ratio, silent.span.limit_mean_mm, silent.span.limit_p95_mm) == (None, None, None)
    assert (silent.cramer_rao_mean_mm, silent.smallest_force_n) == (None, None)
    assert silent.span.mean_mm.value == pytest.approx(0.0, abs=1e-4)
    steps = list[float]()
    open_force = evaluate(MODEL, prior(force_n=(0.999, 1.001)), draws=64, seed=1, progress=steps.append)
    assert open_force.force_coverage is not None
    assert steps == sorted(steps)
    assert steps[-2:] == pytest.approx([0.8, 0.9])


def test_a_model_of_places_alone_states_no_evidence_and_no_force() -> None:
    bare = evaluate(model_of(outputs=("position_mm",)), prior(), draws=64, seed=1)
    assert (bare.position_coverage, bare.position_width_mm, bare.force_error_n, bare.missed) == (None,) * 4
    assert (bare.unexplained, bare.smallest_force_n) == (None, None)


def test_the_middle_is_from_a_fifth_to_four_fifths() -> None:
    """At 79 mm at most no contact lies in it; up to 100 mm a fifth does."""
    for end_mm, has_middle in ((79.0, False), (100.0, True)):
        short = Prior(Extent.of_beam((0.0, end_mm)), 400.0, (1.0, 1.0), Errors(NOISE_MM), 3, shown)
        assert (evaluate(MODEL, short, draws=512, seed=1).middle is not None) == has_middle
    beyond = Prior(Extent.of_beam((321.0, 400.0)), 400.0, (1.0, 1.0), Errors(NOISE_MM), 3, shown)
    assert evaluate(MODEL, beyond, draws=512, seed=1).middle is None
