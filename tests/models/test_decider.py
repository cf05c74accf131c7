"""What one sample changes, beside the thresholds: each bound holds, and what is next to it does not."""

from math import inf, nextafter

import numpy as np
import pytest

from beamtouch_models.runtime import LOG_ODDS, MISFIT, Evidence, Hypotheses, Memory, State, is_odd, memories_after
from beamtouch_models.runtime.decision.decider import AT_REST, decide
from beamtouch_models.runtime.metadata_parts import Thresholds

TOUCH, LIFT, STRONG = 16.0, 2.0, 64.0
"""Log odds of a touch, an eighth of them, and four times as many."""
REST_MISFIT, CONTACT_MISFIT = 50.0, 30.0
THRESHOLDS = Thresholds(
    touch=[1e3, 1e3, 1e3, TOUCH],
    rest=[1e3, 1e3, 1e3, REST_MISFIT],
    misfit=[1e3, 1e3, 1e3, CONTACT_MISFIT],
    false_contacts_per_day=1 / 30,
)
"""Those of one to four channels; here all four work."""
SEEN_MM = (0.5, 0.5, 0.0, 0.0)
CONTACT = Memory(State.CONTACT, seen_mm=SEEN_MM)
RINGING = Memory(State.CLEAR)
STRETCH = Memory(State.UNEXPLAINED, seen_mm=SEEN_MM)


def above(value: float) -> float:
    return nextafter(value, inf)


def sample(
    log_odds: float,
    still_log_odds: float | None = None,
    *,
    moves: bool = False,
    precision: float = 16.0,
    odd: bool = False,
    settled: bool = True,
) -> Evidence:
    """Return a sample of four channels, each with this precision [1/mm]; 16 if it were still."""
    still = log_odds if still_log_odds is None else still_log_odds
    answer = {LOG_ODDS: log_odds, MISFIT: above(CONTACT_MISFIT) if odd else CONTACT_MISFIT}
    weights = np.eye(4)
    misfit = above(REST_MISFIT) if odd else 0.0
    return Evidence(
        np.array(SEEN_MM), precision * weights, answer, 4, misfit, moves, still, 16.0 * weights, is_settled=settled
    )


def after(memory: Memory, *samples: Evidence) -> list[str]:
    """Return the state after each sample, with a mark if it is unsteady."""
    said = []
    for one in samples:
        memory, is_unsteady = decide(THRESHOLDS, memory, one)
        said.append(memory.state.value + "*" * is_unsteady)
    return said


def test_a_sample_is_odd_if_neither_rest_nor_a_contact_is_within_its_threshold() -> None:
    odd = sample(0.0, odd=True)
    assert is_odd(THRESHOLDS, odd)
    assert not is_odd(THRESHOLDS, odd._replace(rest_misfit=REST_MISFIT))
    assert not is_odd(THRESHOLDS, odd._replace(answer={LOG_ODDS: 0.0, MISFIT: CONTACT_MISFIT}))


def test_a_beam_at_rest_is_touched_above_the_log_odds_of_a_touch() -> None:
    assert after(AT_REST, sample(TOUCH)) == ["clear"]
    assert after(AT_REST, sample(above(TOUCH))) == ["contact"]
    # By a sample that scatters, if it would show a contact without that.
    assert after(AT_REST, sample(0.0, TOUCH, moves=True)) == ["clear*"]
    assert after(AT_REST, sample(0.0, above(TOUCH), moves=True)) == ["contact*"]


def test_a_beam_that_rings_is_touched_above_four_times_these_log_odds() -> None:
    assert after(RINGING, sample(STRONG)) == ["clear*"]
    assert after(RINGING, sample(above(STRONG))) == ["contact"]
    assert after(RINGING, sample(0.0, above(STRONG), moves=True)) == ["clear*"]


def test_a_beam_that_rings_is_touched_by_three_samples_in_a_row() -> None:
    weak, still = sample(above(TOUCH)), sample(TOUCH)
    assert after(RINGING, weak, weak, weak) == ["clear*", "clear*", "contact"]
    assert after(RINGING, weak, weak, still, weak, weak, still) == ["clear*", "clear*", "clear"] * 2
    assert after(RINGING, weak, still, weak, weak, weak)[-1] == "contact"


def test_five_still_samples_in_a_row_show_rest() -> None:
    still, swing, weak = sample(0.0), sample(0.0, moves=True), sample(above(TOUCH))
    assert after(RINGING, *[still] * 5, weak)[-1] == "contact"
    assert after(RINGING, *[still] * 4, weak)[-1] == "clear*"
    assert after(RINGING, *[still] * 4, swing, *[still] * 4, weak)[-1] == "clear*"
    assert after(RINGING, swing, *[still] * 5, weak)[-1] == "contact"
    assert decide(THRESHOLDS, RINGING._replace(still=4), still)[0] == AT_REST
    assert decide(THRESHOLDS, AT_REST, swing)[0] == AT_REST  # nothing but a touch moves it


def test_the_sample_of_a_lift_is_the_first_at_rest() -> None:
    assert after(CONTACT, *[sample(0.0)] * 5, sample(above(TOUCH)))[-1] == "contact"
    assert after(CONTACT, *[sample(0.0)] * 4, sample(above(TOUCH)))[-1] == "clear*"
    assert after(CONTACT, sample(0.0, moves=True), *[sample(0.0)] * 4, sample(above(TOUCH)))[-1] == "clear*"


def test_after_a_lift_a_touch_takes_three_samples_in_a_row() -> None:
    touched = [sample(above(TOUCH))] * 3
    assert after(CONTACT, sample(0.0), *touched) == ["clear", "clear*", "clear*", "contact"]


def test_a_contact_ends_at_an_eighth_of_the_log_odds_of_a_touch() -> None:
    assert after(CONTACT, sample(above(LIFT))) == ["contact*"]
    assert after(CONTACT, sample(LIFT)) == ["clear"]
    assert after(CONTACT, sample(TOUCH)) == ["contact*"]
    assert after(CONTACT, sample(above(TOUCH))) == ["contact"]


@pytest.mark.parametrize("unclear", [sample(LIFT, above(TOUCH)), sample(LIFT, settled=False)], ids=["large", "few"])
def test_a_lift_that_is_not_plain_takes_three_samples_in_a_row(unclear: Evidence) -> None:
    assert after(CONTACT, unclear, unclear, unclear) == ["contact*", "contact*", "clear"]
    held = sample(above(LIFT))
    assert after(CONTACT, unclear, unclear, held, unclear, unclear) == ["contact*"] * 5
    touched = sample(above(TOUCH))
    assert after(CONTACT, unclear, unclear, touched, unclear, unclear)[-1] == "contact*"
    assert after(CONTACT, sample(LIFT, TOUCH)) == ["clear"]


def test_a_state_ends_on_a_sample_that_could_have_shown_what_it_stands_on() -> None:
    """That would have a misfit of 128 if the beam lay still, and must have one of 32, twice that of a touch."""
    assert after(CONTACT, sample(0.0, moves=True, precision=8.0)) == ["clear*"]
    assert after(CONTACT, sample(0.0, moves=True, precision=7.99)) == ["contact*"]
    # What these channels cannot show better needs half of what they can.
    weak = CONTACT._replace(seen_mm=(0.25, 0.25, 0.0, 0.0))
    assert after(weak, sample(0.0, moves=True, precision=11.32)) == ["clear*"]
    assert after(weak, sample(0.0, moves=True, precision=11.31)) == ["contact*"]
    # Nothing is known of what it stands on.
    assert after(CONTACT._replace(seen_mm=None), sample(0.0, moves=True)) == ["contact*"]
    assert after(CONTACT._replace(seen_mm=None), sample(0.0)) == ["clear"]


def test_three_odd_samples_in_a_row_are_unexplained() -> None:
    odd, still, touched = sample(0.0, odd=True), sample(0.0), sample(above(TOUCH))
    assert after(AT_REST, odd, odd, odd, odd) == ["clear*", "clear*", "unexplained", "unexplained"]
    assert after(AT_REST, odd, odd, still, odd, odd) == ["clear*", "clear*", "clear", "clear*", "clear*"]
    assert after(CONTACT, odd, odd, touched, odd, odd) == ["contact*", "contact*", "contact", "contact*", "contact*"]
    assert after(AT_REST, *[odd] * 2, sample(0.0, odd=True, moves=True)) == ["clear*", "clear*", "unexplained*"]


def test_three_samples_that_are_explained_end_a_stretch() -> None:
    odd, still, touched = sample(0.0, odd=True), sample(TOUCH), sample(above(TOUCH))
    assert after(STRETCH, still, still, still) == ["unexplained", "unexplained", "clear"]
    assert after(STRETCH, *[sample(0.0)] * 3) == ["unexplained", "unexplained", "clear"]
    assert after(STRETCH, still, still, touched) == ["unexplained", "unexplained", "contact"]
    assert after(STRETCH, still, still, odd, still, still) == ["unexplained"] * 5
    vague = sample(0.0, moves=True, precision=7.99)
    assert after(STRETCH, still, still, vague, still) == ["unexplained", "unexplained", "unexplained*", "clear"]
    assert after(STRETCH, still, still, still, *[sample(0.0)] * 4, touched)[-1] == "contact"


def test_what_missing_samples_may_have_left() -> None:
    contacts = [Memory(State.CONTACT, changing=changing) for changing in range(3)]
    ringing = [Memory(State.CLEAR, still=still, changing=changing) for still in range(5) for changing in range(3)]
    assert memories_after(State.UNEXPLAINED) == (Memory(State.UNEXPLAINED),)
    assert memories_after(State.CONTACT) == tuple(contacts)
    assert memories_after(State.CLEAR) == (*ringing, AT_REST)
    assert memories_after(None) == (Memory(State.CLEAR, run=2), *ringing, AT_REST, *contacts)


def test_a_contact_of_which_nothing_is_known_may_be_lifted_by_a_sample_that_moves() -> None:
    unknown = Memory(State.CONTACT)
    hypotheses = Hypotheses(THRESHOLDS, [unknown])
    assert hypotheses.is_known
    assert hypotheses.step(sample(above(LIFT), moves=True)) == (State.CONTACT, True, False)
    assert set(hypotheses.memories) == {unknown, RINGING, *memories_after(State.CONTACT)}
    # One that lies still tells.
    hypotheses = Hypotheses(THRESHOLDS, [unknown])
    assert hypotheses.step(sample(above(LIFT))) == (State.CONTACT, True, True)
    assert hypotheses.memories == (unknown,)
    # And one that shows the contact says what it is.
    assert Hypotheses(THRESHOLDS, [unknown]).step(sample(above(TOUCH), moves=True)) == (State.CONTACT, True, True)


def test_a_state_is_doubted_until_it_was_known_once() -> None:
    hypotheses = Hypotheses(THRESHOLDS, [AT_REST, Memory(State.CONTACT)])
    assert hypotheses.step(sample(above(LIFT))) == (State.CLEAR, True, False)
    assert hypotheses.step(sample(0.0)) == (State.CLEAR, False, True)
    known = Hypotheses(THRESHOLDS, [AT_REST, Memory(State.CONTACT)], is_known=True)
    assert known.step(sample(above(LIFT))) == (State.CLEAR, False, False)
    unexplained = Hypotheses(THRESHOLDS, [STRETCH, AT_REST])
    assert unexplained.step(sample(0.0)) == (State.UNEXPLAINED, False, False)
