"""What is known of a state although samples before are missing: the same as if they were not."""

from __future__ import annotations

import random

import numpy as np
import pytest

from beamtouch_models.runtime import (
    LOG_ODDS,
    MISFIT,
    Evidence,
    Hypotheses,
    Memory,
    State,
    memories_after,
)
from beamtouch_models.runtime.metadata_parts import Thresholds

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
        whole = Hypotheses(THRESHOLDS, [Memory(State.CLEAR, armed=True)])
        part = Hypotheses(THRESHOLDS, memories_after(None))
        for _ in range(rng.randint(0, 20)):
            whole.step(any_sample(rng))
        for _ in range(30):
            one = any_sample(rng)
            whole.step(one)
            if part.step(one).shown:
                shown += 1
                assert part.state is whole.state
            if len(part.memories) == 1:
                known += 1
                assert part.memories == whole.memories
    # Most of the 4500 samples show the state, so this compares something.
    assert shown > 2250
    assert known > 2250


CLEAR, DOUBTED, CONTACT = ("clear", False, True), ("clear", True, False), ("contact", False, True)
"""State, whether it is unsteady, and whether it is known."""


@pytest.mark.parametrize(
    ("samples", "expected"),
    [
        ([sample(WEAK)] * 4, [DOUBTED] * 2 + [CONTACT] * 2),  # never clear without a note
        ([sample(BETWEEN, STRONG)] * 20, [DOUBTED] * 20),  # nor one that moves
        ([sample(BETWEEN)], [DOUBTED]),
        ([sample(REST)], [CLEAR]),
        ([sample(REST, settled=False)] * 3, [DOUBTED] * 2 + [CLEAR]),  # means of few readings take three
        ([sample(STRONG)], [CONTACT]),
        ([sample(STRONG, STRONG)], [("contact", True, True)]),
    ],
)
def test_a_contact_after_a_start_is_never_clear_without_a_note(
    samples: list[Evidence], expected: list[tuple[str, bool, bool]]
) -> None:
    hypotheses = Hypotheses(THRESHOLDS, memories_after(None))
    found = [hypotheses.step(one) for one in samples]
    assert [(one.state.value, one.unsteady, one.shown) for one in found] == expected
