"""The Cramer-Rao bound against derivatives of a textbook formula in 40 digits, and against the limit at small noise."""

import dataclasses

import mpmath
import numpy as np
import pytest

from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.cramer_rao import mean_error_mm, position_deviation_mm
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.physics.beam import influence_of
from example_scenes import paper_scene
from posterior_cases import prior_of

SENSORS = (122.0, 278.0)


def textbook_mm_per_n(sensor: mpmath.mpf, load: mpmath.mpf) -> mpmath.mpf:
    """Deflection of the paper's simply supported beam (Roark's Formulas for Stress and Strain, table 8.1, case 1e)."""
    length, rigidity = mpmath.mpf(400), mpmath.mpf(210e3) * 25 * mpmath.mpf(3) ** 3 / 12
    near, far = min(sensor, load), max(sensor, load)
    return near * (length - far) * (length**2 - near**2 - (length - far) ** 2) / (6 * rigidity * length)


@pytest.mark.parametrize("position", [3.0, 60.0, 150.0, 200.0, 390.0])
@pytest.mark.parametrize("known", [True, False])
def test_the_bound_agrees_with_the_textbook_formula(position: float, known: bool) -> None:
    prior = Prior.of(influence_of(paper_scene()), np.array(SENSORS), 0.002)
    force = 10.0
    if not known:
        prior = dataclasses.replace(prior, force_n=(2.0, 20.0))
    with mpmath.workdps(40):
        g = [textbook_mm_per_n(mpmath.mpf(s), mpmath.mpf(position)) for s in SENSORS]
        d = [mpmath.diff(lambda x, s=s: textbook_mm_per_n(mpmath.mpf(s), x), mpmath.mpf(position)) for s in SENSORS]
        # Two channels: the part of d across g is their cross product over the length of g.
        told = abs(g[0] * d[1] - g[1] * d[0]) / mpmath.hypot(*g) if not known else mpmath.hypot(*d)
        exact = float(mpmath.mpf(0.002) / (told * force))
    assert position_deviation_mm(prior, [position], force)[0] == pytest.approx(exact, rel=1e-4)


def test_one_channel_gives_no_position_if_the_force_is_open() -> None:
    prior = dataclasses.replace(Prior.of(influence_of(paper_scene()), np.array([122.0]), 0.002), force_n=(2.0, 20.0))
    assert position_deviation_mm(prior, [50.0, 200.0], 10.0).min() > 1e6


@pytest.mark.parametrize("known", [True, False])
def test_the_limit_approaches_the_bound_as_the_noise_vanishes(known: bool) -> None:
    wide = prior_of("bench", 4, 0.003, known=known)
    prior = dataclasses.replace(wide, position_mm=(80.0, 320.0))
    best = limit.accuracy_limit(prior, 2000, 1)
    bound = mean_error_mm(prior) / prior.length_mm * 100
    assert best.percent == pytest.approx(bound, abs=4 * best.standard_error + 0.02 * bound)


def test_without_information_the_mean_error_is_that_of_a_guess() -> None:
    prior = prior_of("bench", 2, 1e7, known=False)
    # At x in 1..399 a uniform guess is off by ((x - 1)^2 + (399 - x)^2) / (2 * 398), which is 398 / 3 on average.
    assert mean_error_mm(prior) == pytest.approx(398 / 3, rel=1e-3)
