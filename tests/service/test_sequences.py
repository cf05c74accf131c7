"""New, repeated, lost: the story of sequence numbers."""

from hypothesis import given, settings
from hypothesis import strategies as st

from beamtouch_service.surfaces.sequence_log import Admission, Runs, SequenceLog


def test_a_batch_sent_twice_is_new_once() -> None:
    log = SequenceLog()

    assert log.admit("boot-a", [1, 2, 3]) == Admission(accepted=3, repeated=0, lost=0)
    assert log.admit("boot-a", [1, 2, 3]) == Admission(accepted=0, repeated=3, lost=0)


def test_a_batch_that_overlaps_the_last_one_counts_for_its_new_part() -> None:
    log = SequenceLog()
    log.admit("boot-a", [1, 2, 3])

    assert log.admit("boot-a", [2, 3, 4, 5]) == Admission(accepted=2, repeated=2, lost=0)


def test_gaps_are_losses_between_batches_and_within_one() -> None:
    log = SequenceLog()
    log.admit("boot-a", [10])

    assert log.admit("boot-a", [12, 15]) == Admission(accepted=2, repeated=0, lost=3)


def test_the_first_batch_of_a_sender_shows_only_the_gaps_within_it() -> None:
    assert SequenceLog().admit("boot-a", [4711, 4713]) == Admission(accepted=2, repeated=0, lost=1)


def test_a_restarted_sender_counts_anew() -> None:
    log = SequenceLog()
    log.admit("boot-a", [100])

    assert log.admit("boot-b", [0]) == Admission(accepted=1, repeated=0, lost=0)
    assert log.admit("boot-a", [100]) == Admission(accepted=0, repeated=1, lost=0)


def test_only_so_many_senders_are_remembered_and_the_one_heard_longest_ago_is_forgotten() -> None:
    log = SequenceLog(max_senders=2)
    log.admit("boot-a", [1])
    log.admit("boot-b", [1])
    log.admit("boot-a", [2])
    log.admit("boot-c", [1])

    assert log.admit("boot-a", [2]).repeated == 1
    assert log.admit("boot-b", [1]).accepted == 1


def test_what_was_sent_late_is_new_and_fills_its_gap() -> None:
    log = SequenceLog()
    log.admit("boot-a", [0, 1, 2])

    assert log.admit("boot-a", [10, 11]) == Admission(accepted=2, repeated=0, lost=7)
    assert log.admit("boot-a", [2, 3, 4, 7]) == Admission(accepted=3, repeated=1, lost=-3)
    assert log.admit("boot-a", [5, 6, 8, 9, 10]) == Admission(accepted=4, repeated=1, lost=-4)


@settings(deadline=None)
@given(st.lists(st.sets(st.integers(0, 60), min_size=1), max_size=20))
def test_any_order_of_batches_gives_what_a_set_gives(batches: list[set[int]]) -> None:
    log, known, lost = SequenceLog(), set[int](), 0
    for batch in batches:
        admission = log.admit("boot-a", sorted(batch))
        assert (admission.accepted, admission.repeated) == (len(batch - known), len(batch & known))
        known |= batch
        lost += admission.lost
        assert lost == max(known) - min(known) + 1 - len(known)


def test_only_so_many_gaps_are_remembered_and_the_oldest_is_never_filled_any_more() -> None:
    runs = Runs(max_runs=3)
    for number in (0, 10, 20, 30):
        runs.add(number, number + 1)

    assert 5 in runs
    assert 15 not in runs
    assert runs.missing == 27


def test_gaps_that_are_not_remembered_stay_lost() -> None:
    log = SequenceLog()

    assert log.admit("boot-a", range(0, 4000, 2)).lost == 1999
    assert log.admit("boot-a", [1]) == Admission(accepted=0, repeated=1, lost=0)
    assert log.admit("boot-a", [3997]) == Admission(accepted=1, repeated=0, lost=-1)
