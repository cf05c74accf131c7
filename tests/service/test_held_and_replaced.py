"""What was held up on its way looks as old as it is, and a sender that was replaced does not come back: over HTTP."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from service.conftest import batch_of, kind

if TYPE_CHECKING:
    import httpx2

    from service.conftest import Bench

APART_S = 7_000.0
"""The clock of the sender began so much later than that of the service."""


def send(bench: Bench, sequence: int, held_s: float = 0.0, boot_id: str = "boot-0001") -> None:
    """Send a sample of this moment, which was on its way for so long."""
    sent_us = round((bench.now_s - held_s + APART_S) * 1e6)
    answer = bench.post(batch_of(sequence=sequence, boot_id=boot_id) | {"sent_us": sent_us})
    assert answer.status_code == 200, answer.text


def contact(bench: Bench) -> dict[str, Any]:
    answer: httpx2.Response = bench.get("/contact")
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


@pytest.mark.parametrize("outage_s", [0.6, 5.0, 29.0, 31.0, 59.0, 61.0, 600.0])
@pytest.mark.parametrize("before_s", [1, 45, 70])
def test_a_batch_that_was_held_over_an_outage_is_no_contact(bench: Bench, before_s: int, outage_s: float) -> None:
    for number in range(before_s):
        bench.now_s += 1.0
        send(bench, 1 + number)
    bench.now_s += outage_s
    send(bench, 100, held_s=outage_s)
    assert kind(bench.get("/contact")) == "stale"
    # What is sent now is not held up any longer.
    send(bench, 101)
    assert contact(bench)["sequence"] == 101


@pytest.mark.parametrize("held_s", [0.05, 0.2, 0.4])
def test_the_age_holds_the_time_on_the_way(bench: Bench, held_s: float) -> None:
    for number in range(40):
        bench.now_s += 1.0
        send(bench, 1 + number)
    send(bench, 100, held_s=held_s)
    assert contact(bench)["age_ms"] == pytest.approx(held_s * 1e3, abs=10)


def test_a_sender_that_was_replaced_is_taken_back_only_once_the_other_is_silent(bench: Bench) -> None:
    send(bench, 10, boot_id="boot-before")
    bench.now_s += 0.1
    send(bench, 1, boot_id="boot-present")
    for step in range(8):
        bench.now_s += 0.1
        send(bench, 11 + step, boot_id="boot-before")
        if step % 2 == 0:  # the one that replaced it still sends, and its samples count
            send(bench, 2 + step, boot_id="boot-present")
        assert contact(bench)["sequence"] == 2 + step - step % 2
    bench.now_s += 0.61
    send(bench, 30, boot_id="boot-before")
    assert contact(bench)["sequence"] == 30


def test_a_sender_that_was_replaced_never_comes_back_with_an_old_sample(bench: Bench) -> None:
    send(bench, 10, boot_id="boot-before")
    bench.now_s += 0.1
    send(bench, 1, boot_id="boot-present")
    bench.now_s += 5.0
    send(bench, 10, boot_id="boot-before")
    assert kind(bench.get("/contact")) == "stale"
