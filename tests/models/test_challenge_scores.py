"""The scores of `design-sensors challenge`, by hand."""

from dataclasses import replace

import numpy as np
import pytest

from beamtouch_models.challenge.challenge import misses
from beamtouch_models.challenge.judge import Judged, JudgedSample, Said
from beamtouch_models.challenge.scoring import Row, ghosts, scored


def said(*samples: JudgedSample) -> Judged:
    columns = (np.array(column) for column in zip(*samples, strict=True))
    by_name = dict(zip(JudgedSample._fields, columns, strict=True))
    return Judged(**by_name, mean_mm=np.zeros((len(samples), 4)), valid=np.ones((len(samples), 4), np.bool_))


def test_scores_of_samples_by_hand() -> None:
    contact = Said.CONTACT
    judged = said(
        JudgedSample(contact, False, False, 100.0, 90.0, 120.0),  # 100 +20: holds 115
        JudgedSample(contact, False, False, 100.0, 90.0, 120.0),  # 135: within twice the half of 20
        JudgedSample(contact, False, False, 100.0, 90.0, 120.0),  # 141 is not
        JudgedSample(contact, False, False, 100.0, 90.0, 120.0),  # 79: more than twice 10 below
        JudgedSample(contact, True, False, 100.0, 90.0, 120.0),  # far off, and said to be unsteady
        JudgedSample(contact, True, False, 100.0, 90.0, 120.0),
        JudgedSample(contact, True, True, 100.0, 90.0, 120.0),
        JudgedSample(Said.CLEAR),
        JudgedSample(Said.UNEXPLAINED, unsteady=True),
        JudgedSample(),
    )
    truth = np.array([115.0, 135.0, 141.0, 79.0, 300.0, 100.0, 100.0, 50.0, 50.0, 50.0])
    row = scored("by hand", judged, truth, honest=True, exact_mm=np.full(10, 20.0))
    assert row == Row(
        name="by hand", honest=True, quiet=False, samples=10, error_mm=(15 + 35 + 41 + 21 + 200) / 7,
        held=0.25, plain=4, held_unsteady=0.5, unsteady=2, held_noted=1.0, unexplained=0.1, noted=0.3, clear=0.1,
        silent=0.1, misleading=0.2, interval_mm=30.0, width=1.5,
    )  # fmt: skip
    nowhere = scored("a fault", judged, np.full(10, np.nan), honest=False)
    assert (nowhere.held, nowhere.error_mm, nowhere.misleading) == (None, None, 0.4)
    assert nowhere.noticed == pytest.approx(0.4)


def test_a_contact_that_begins_twice_is_a_ghost() -> None:
    nothing, clear, contact, unexplained = Said.NOTHING, Said.CLEAR, Said.CONTACT, Said.UNEXPLAINED
    once = [
        [nothing, clear, contact, contact, contact, clear, clear],
        [nothing, clear, contact, unexplained, contact, nothing, contact],
        [contact, contact, clear, clear, clear, clear, clear],
        [clear] * 7,
    ]
    assert ghosts(np.array(once)) == 0
    twice = [
        [nothing, clear, contact, clear, contact, contact, contact],
        [contact, clear, unexplained, unexplained, contact, clear, clear],
    ]
    assert ghosts(np.array(twice)) == 1
    assert ghosts(np.array(once + twice)) == pytest.approx(1 / 3)


def test_a_goal_is_missed_only_by_more_than_chance() -> None:
    good = Row("row", True, True, 400, 1.0, 0.95, 400, 0.95, 400, None, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0)
    assert misses(good) == []
    assert misses(replace(good, held=0.92)) == []  # 32 of 400, where 28 are allowed
    assert misses(replace(good, held=0.88)) == ["held 88%"]
    assert misses(replace(good, held_unsteady=0.85)) == ["held 85% when unsteady"]
    assert misses(replace(good, misleading=0.02)) == ["misleading 2.0%"]
    assert misses(replace(good, noted=0.04)) == ["noted 4.0%"]
    assert misses(replace(good, ghosts=0.04)) == ["ghosts 4.0%"]
    assert misses(replace(good, quiet=False, noted=0.04)) == []
    assert misses(replace(good, width=1.2)) == ["interval 1.20 of the exact one"]
    fault = replace(good, honest=False, noticed=0.8, power=1.0)
    assert misses(fault) == ["noticed 80% of 100%"]
    assert misses(replace(fault, power=0.85)) == []
    assert misses(replace(fault, noticed=0.0, power=0.5)) == []
