"""The rows of a case of `design-sensors challenge`, of answers that are known: which readings they judge, and how."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2, norm

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.lab.challenge import challenge, faults
from beamtouch_models.lab.challenge.challenge import Row, distances, rows_of
from beamtouch_models.lab.challenge.judge import Outcome, Verdicts
from beamtouch_models.lab.challenge.play import Case, DrawnContacts, Play, SimulatedSurface
from beamtouch_models.runtime import ModelFile
from models.bench_contacts import drawn

DRAWS, READINGS = 4, 90
TOUCHED = np.repeat([[1, 2, 2, 1, 2, 2]], DRAWS, axis=0).repeat(15, axis=1)
"""Clear, a contact, clear and a contact: in each draw one begins twice."""

Scored = Callable[..., list[Row]]
Vary = Callable[[Play], Play]


def vary_nothing(play: Play) -> Play:
    return play


@pytest.fixture
def scored(bench: ModelFile, surface: SimulatedSurface, monkeypatch: pytest.MonkeyPatch) -> Scored:
    """Scores a play of four draws whose answers are contacts at 100 +- 10 mm, or clear, as given."""

    def rows(
        asked: dict[str, Any], *, honest: bool = True, outcome: Floats = TOUCHED, vary: Vary = vary_nothing
    ) -> list[Row]:
        def judge(_s: object, _r: object, readings: Floats, first: int, *, lost: Bools | None) -> Verdicts:
            asked.update(first=first, lost=lost, shape=readings.shape)
            judged = Verdicts.silent(np.ones(readings.shape, np.bool_), axes=1)
            judged.outcome[:] = outcome
            judged.place_mm[:], judged.low_mm[:], judged.high_mm[:] = 100.0, 90.0, 110.0
            return judged

        def make(at: DrawnContacts) -> Play:
            truth_mm = np.full((DRAWS, READINGS, 1), 105.0)
            truth_mm[:, 80] = 115.0  # beyond the interval, and within twice its half
            truth_mm[:, 85] = 121.0
            still = np.zeros((DRAWS, READINGS, 4))
            return vary(Play(still, truth_mm, at.honest, ROWS))

        monkeypatch.setattr(challenge, "judge", judge)
        return rows_of(bench, surface, Case(honest, make), DRAWS, np.random.default_rng(3))

    return rows


ROWS = (("early", 70), ("late", 80), ("early", 50), ("late", 85))


def test_readings_with_one_name_are_one_row_in_the_order_of_the_play(scored: Scored, surface: SimulatedSurface) -> None:
    asked = dict[str, Any]()
    lost = np.zeros((DRAWS, READINGS), np.bool_)
    early, late = scored(asked, vary=lambda play: replace(play, quiet=True, lost=lost))
    assert (asked["first"], asked["shape"]) == (50 - surface.decided, (DRAWS, READINGS, 4))
    assert asked["lost"] is lost
    assert (early.name, early.samples, early.honest, early.quiet) == ("early", 2 * DRAWS, True, True)
    # At 50 it is clear.
    assert (early.clear, early.held, early.error_mm, early.misleading) == (0.5, 1.0, 5.0, 0.0)
    assert (late.name, late.samples, late.held, late.error_mm, late.misleading) == ("late", 8, 0.0, 18.0, 0.5)


def test_ghosts_are_counted_in_the_last_row_among_draws_that_cross_no_support(scored: Scored) -> None:
    once = TOUCHED.copy()
    once[:2, 15:45] = Outcome.CLEAR  # in two draws it begins once
    early, late = scored({}, outcome=once)
    assert (early.ghosts, early.plays) == (None, 0)
    assert (late.ghosts, late.plays) == (0.5, 4)
    *_, late = scored({}, outcome=once, vary=lambda play: replace(play, crosses=np.arange(DRAWS) == 0))
    assert late.ghosts == pytest.approx(2 / 3)
    assert late.plays == 3
    *_, late = scored({}, outcome=once, vary=lambda play: replace(play, crosses=np.ones(DRAWS, np.bool_)))
    assert (late.ghosts, late.plays) == (None, 0)
    *_, late = scored({}, outcome=once, vary=lambda play: replace(play, again=True))
    assert (late.ghosts, late.plays) == (None, 0)


def test_a_fault_has_the_power_of_the_test_that_knows_it(
    scored: Scored, bench: ModelFile, surface: SimulatedSurface
) -> None:
    """The false rate is that of the misfit of four channels, less the place and the force of a contact."""
    fault_mm = faults.pulled(drawn(surface, DRAWS), times=0.02).fault_mm
    assert fault_mm is not None
    rows = (("settled", 80),)
    (row,) = scored({}, honest=False, vary=lambda play: replace(play, fault_mm=fault_mm, rows=rows))
    alpha = chi2.sf(bench.metadata.thresholds.misfit[3], 2)
    every = np.ones(fault_mm.shape, np.bool_)
    power = norm.cdf(distances(surface, fault_mm, every) - norm.isf(alpha)).mean()
    assert row.power == pytest.approx(power)
    assert 0.01 < power < 0.99
    assert row.noticed is not None
    assert all(
        one.power is None
        for one in scored({}, honest=True, vary=lambda play: replace(play, fault_mm=fault_mm, rows=rows))
    )
    assert all(one.power is None for one in scored({}, honest=False))


def test_channels_that_take_no_part_tell_no_fault(surface: SimulatedSurface) -> None:
    valid, fault_mm = np.ones((3, 4), np.bool_), np.zeros((3, 4))
    fault_mm[0, 1] = fault_mm[1, 1] = -0.02  # no contact pulls
    valid[1, 1] = False
    away, unseen, none = distances(surface, fault_mm, valid)
    # The noise of a settled sample, a zero of 1 um and a gain that is off by 0.3 %.
    assert away == pytest.approx(0.02 / np.hypot(np.hypot(surface.min_noise_mm, 0.001), 0.003 * 0.02), rel=1e-3)
    assert (unseen, none) == (pytest.approx(0.0, abs=1e-6), pytest.approx(0.0, abs=1e-6))


def test_a_calibrated_surface_is_compared_with_the_contacts_of_its_gains(surface: SimulatedSurface) -> None:
    gains = np.array([1.1, 0.95, 1.0, 1.05])
    departures = surface.world.departures.model_copy(update={"gain": gains.tolist()})
    calibrated = replace(surface, world=replace(surface.world, departures=departures))
    at = drawn(surface, 5)
    valid = np.ones((5, 4), np.bool_)
    assert distances(calibrated, gains * at.deflection_mm, valid) == pytest.approx(np.zeros(5), abs=1e-2)
    assert distances(calibrated, at.deflection_mm, valid).min() > 1.0
