"""New, repeated, lost: the story of sequence numbers."""

from beamtouch_service.sequences import Admission, SequenceLog


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
