"""What is known of a state although samples before are missing: the same as if they were not."""

from __future__ import annotations

import random

import numpy as np

from beamtouch_models.decision.decider import AT_REST, decide
from beamtouch_models.metadata import Thresholds
from beamtouch_models.modelfile import (
    LOG_ODDS,
    MISFIT,
    Evidence,
    Hypotheses,
    memories_after,
)

TOUCH = 16.0
THRESHOLDS = Thresholds(touch=[TOUCH] * 4, rest=[50.0] * 4, misfit=[30.0] * 4, false_contacts_per_day=1 / 30)
WEAK, STRONG, BETWEEN, REST = 1.5 * TOUCH, 6 * TOUCH, TOUCH / 4, 0.0


def sample(
    log_odds: float, still_log_odds: float | None = None, *, precision: float = 100.0, settled: bool = True
) -> Evidence:
    """One sample of 0.1 mm per channel; it moves if it says something else under the noise alone."""
    still = log_odds if still_log_odds is None else still_log_odds
    deflection_mm = np.full(4, 0.1 if log_odds > TOUCH else 0.01)
    answer = {LOG_ODDS: log_odds, MISFIT: 1.0}
    whitening, still_whitening = np.eye(4) * precision, np.eye(4) * 100.0
    misfit = float(np.square(whitening @ deflection_mm).sum())
    moves = still_log_odds is not None
    return Evidence(deflection_mm, whitening, answer, 4, misfit, moves, still, still_whitening, settled)


def any_sample(rng: random.Random) -> Evidence:
    """A still sample, a swing that shows little, or one of a few readings."""
    odds = rng.choice([REST, REST, BETWEEN, WEAK, STRONG])
    if rng.random() < 0.5:
        return sample(odds, settled=rng.random() < 0.8)
    still = max(odds, rng.choice([REST, WEAK, STRONG]))
    return sample(odds, still, precision=rng.choice([1.0, 50.0, 100.0]), settled=rng.random() < 0.8)


def test_a_state_that_is_shown_does_not_depend_on_the_samples_before() -> None:
    shown = known = 0
    for seed in range(150):
        rng = random.Random(seed)  # noqa: S311 - samples, not secrets
        whole, part = AT_REST, Hypotheses(THRESHOLDS, memories_after(None))
        for _ in range(rng.randint(0, 20)):
            whole = decide(THRESHOLDS, whole, any_sample(rng))[0]
        for _ in range(30):
            one = any_sample(rng)
            whole = decide(THRESHOLDS, whole, one)[0]
            if part.step(one).shown:
                shown += 1
                assert part.state is whole.state
            if len(part.memories) == 1:
                known += 1
                assert part.memories == (whole,)
    # Most of the 4500 samples show the state, so this compares something.
    assert shown > 2250
    assert known > 2250


def said(*samples: Evidence) -> list[tuple[str, bool, bool]]:
    """State, note and whether the state is known, after samples of which nothing is known."""
    hypotheses = Hypotheses(THRESHOLDS, memories_after(None))
    found = [hypotheses.step(one) for one in samples]
    return [(one.state.value, one.unsteady, one.shown) for one in found]


def test_a_weak_contact_after_a_start_is_never_clear_without_a_note() -> None:
    assert said(*[sample(WEAK)] * 4) == [("clear", True, False)] * 2 + [("contact", False, True)] * 2


def test_a_contact_that_moves_after_a_start_is_never_clear_without_a_note() -> None:
    assert said(*[sample(BETWEEN, STRONG)] * 20) == [("clear", True, False)] * 20
    assert said(sample(BETWEEN)) == [("clear", True, False)]


def test_a_still_beam_after_a_start_is_clear_at_once() -> None:
    assert said(sample(REST)) == [("clear", False, True)]
    # Means of few readings take three.
    assert said(*[sample(REST, settled=False)] * 3) == [("clear", True, False)] * 2 + [("clear", False, True)]


def test_a_strong_contact_after_a_start_is_a_contact_at_once() -> None:
    assert said(sample(STRONG)) == [("contact", False, True)]
    assert said(sample(STRONG, STRONG)) == [("contact", True, True)]
