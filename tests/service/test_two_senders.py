"""Two daemons that send for one surface are told; one that was started anew, or delivers its log, is not."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from service.conftest import Bench, MakeBatch

STEP_S = 0.1


class Daemon:
    """Sends one sample at a time."""

    def __init__(self, bench: Bench, make_batch: MakeBatch, boot_id: str) -> None:
        self._bench, self._make_batch, self._boot_id = bench, make_batch, boot_id
        self._number = 0

    def send(self, age_s: float = 0.0) -> None:
        self._number += 1
        batch = self._make_batch(sequence=self._number, boot_id=self._boot_id, age_ms=age_s * 1e3)
        assert self._bench.post(batch).status_code == 200


def notes(bench: Bench) -> list[str]:
    found: dict[str, Any] = bench.get("/contact").json()
    words: list[str] = found["notes"]
    return words


@pytest.mark.parametrize("age_s", [0.0, 0.05, 0.4])
def test_two_that_send_in_turn_are_told_until_one_stops(
    bench: Bench, make_batch: MakeBatch, caplog: pytest.LogCaptureFixture, age_s: float
) -> None:
    caplog.set_level(logging.INFO, "beamtouch.service")
    one, other = Daemon(bench, make_batch, "daemon-one"), Daemon(bench, make_batch, "daemon-two")
    for _ in range(20):
        bench.now_s += STEP_S
        one.send()
        other.send(age_s)
    assert notes(bench) == ["senders"]
    assert 'beamtouch_note{note="senders",surface="press-7"} 1.0' in bench.get("/metrics").text
    for _ in range(60):
        bench.now_s += 2 * STEP_S
        other.send(age_s)
    assert notes(bench) == []
    said = [message for message in caplog.messages if "daemon" in message and "changed to" not in message]
    assert said == [
        "surface press-7: two daemons send its samples, from testclient:50000 and from testclient:50000; "
        "stop one of them",
        "surface press-7: one daemon sends its samples again",
    ]


def test_a_daemon_that_is_started_anew_and_delivers_its_log_is_one(bench: Bench, make_batch: MakeBatch) -> None:
    boots = [Daemon(bench, make_batch, f"daemon-{number}") for number in range(3)]
    begun_s = []
    for number, boot in enumerate(boots):
        begun_s.append(bench.now_s)
        for _ in range(10):
            bench.now_s += STEP_S
            boot.send()
            # Beside its own samples, those that the earlier ones left on disk: an hour old, or of their last second.
            for old, began_s in zip(boots[:number], begun_s, strict=False):
                old.send(age_s=3600.0)
                old.send(age_s=bench.now_s - began_s - 1.0)
            assert notes(bench) == []


def test_a_batch_that_was_held_up_on_its_way_is_no_second_daemon(bench: Bench, make_batch: MakeBatch) -> None:
    former, present = Daemon(bench, make_batch, "daemon-one"), Daemon(bench, make_batch, "daemon-two")
    former.send()
    bench.now_s += STEP_S
    present.send()
    former.send()
    for _ in range(10):
        bench.now_s += STEP_S
        present.send()
    assert notes(bench) == []
