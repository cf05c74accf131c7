"""New, repeated, lost: what receipts and the summary say of sequence numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamtouch_service.surfaces.surface import Surface
from service.conftest import Bench, batch_of

if TYPE_CHECKING:
    from collections.abc import Iterable

ROW: list[float | None] = [0.5]


class Sender:
    """Sends samples of these numbers."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def send(self, numbers: Iterable[int], boot_id: str = "boot-0001") -> tuple[int, int]:
        """Return how many of them count as new, and how many as repeated."""
        numbers = list(numbers)
        batch = batch_of(*[ROW] * len(numbers), boot_id=boot_id)
        for sample, number in zip(batch["samples"], numbers, strict=True):
            sample["sequence"] = number
        receipt = self._bench.post(batch).json()
        return receipt["accepted"], receipt["repeated"]

    @property
    def lost(self) -> int:
        lost: int = self._bench.get("/surfaces/press-7").json()["samples"]["lost"]
        return lost


@pytest.fixture
def sender() -> Sender:
    return Sender(Bench(Surface("press-7")))


def test_a_batch_that_overlaps_the_last_one_counts_for_its_new_part(sender: Sender) -> None:
    assert sender.send([1, 2, 3]) == (3, 0)
    assert sender.send([1, 2, 3]) == (0, 3)
    assert sender.send([2, 3, 4, 5]) == (2, 2)
    assert sender.lost == 0


def test_gaps_are_losses_between_batches_and_within_one(sender: Sender) -> None:
    assert sender.send([4711, 4713]) == (2, 0)
    assert sender.lost == 1
    assert sender.send([4715, 4718]) == (2, 0)
    assert sender.lost == 4


def test_what_was_sent_late_is_new_and_fills_its_gap(sender: Sender) -> None:
    sender.send([1, 2, 3])
    assert sender.send([11, 12]) == (2, 0)
    assert sender.lost == 7
    assert sender.send([3, 4, 5, 8]) == (3, 1)
    assert sender.lost == 4
    assert sender.send([6, 7, 9, 10, 11]) == (4, 1)
    assert sender.lost == 0


def test_a_restarted_sender_counts_anew_and_the_one_heard_longest_ago_is_forgotten(sender: Sender) -> None:
    sender.send([100, 102])
    for number in range(15):
        assert sender.send([1], f"boot-{number:04}-later") == (1, 0)
    assert sender.send([100]) == (0, 1)
    for number in range(20, 36):
        sender.send([1], f"boot-{number:04}-later")
    assert sender.send([100]) == (1, 0)
    assert sender.lost == 1  # what a forgotten sender lost stays counted


def test_gaps_that_are_not_remembered_stay_lost(sender: Sender) -> None:
    for first in (1, 2001):
        sender.send(range(first, first + 2000, 2))
    assert sender.lost == 1999
    assert sender.send([2]) == (0, 1)
    assert sender.send([3998]) == (1, 0)
    assert sender.lost == 1998


@settings(max_examples=25)
@given(batches=st.lists(st.sets(st.integers(1, 60), min_size=1), min_size=1, max_size=12))
def test_any_order_of_batches_gives_what_a_set_gives(batches: list[set[int]]) -> None:
    sender, known = Sender(Bench(Surface("press-7"))), set[int]()
    for batch in batches:
        assert sender.send(sorted(batch)) == (len(batch - known), len(batch & known))
        known |= batch
        assert sender.lost == max(known) - min(known) + 1 - len(known)
