"""The samples that change the contact, from one sender or several."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hypothesis import given
from hypothesis import strategies as st

from beamtouch_service.surfaces.order import MAX_SENDERS, Senders

if TYPE_CHECKING:
    import pytest

    from service.conftest import Bench, MakeBatch

STALE_MS = 500.0


def offer(senders: Senders, boot_id: str, sequence: int, acquired_s: float, arrival_s: float | None = None) -> bool:
    arrival_s = acquired_s if arrival_s is None else arrival_s
    moves = senders.is_after_newest(boot_id, sequence, acquired_s, arrival_s)
    if moves:
        senders.move(boot_id, sequence, acquired_s)
    return moves


def test_a_former_sender_returns_when_the_present_is_stale_and_not_before() -> None:
    senders = Senders(STALE_MS)
    assert offer(senders, "daemon", 12, 10.0)
    assert offer(senders, "stray", 1, 10.1)

    assert not offer(senders, "daemon", 13, 10.6)
    assert offer(senders, "daemon", 14, 10.601)
    assert offer(senders, "daemon", 15, 10.602)
    assert senders.changes == 2


def test_a_former_sender_never_goes_backwards() -> None:
    senders = Senders(STALE_MS)
    offer(senders, "daemon", 12, 10.0)
    offer(senders, "stray", 1, 10.1)

    assert not offer(senders, "daemon", 12, 20.0)
    assert not offer(senders, "daemon", 13, 10.05, arrival_s=20.0)
    assert offer(senders, "daemon", 13, 20.0)
    assert not offer(senders, "stray", 1, 30.0)


def test_a_sender_that_started_anew_is_followed_at_once() -> None:
    senders = Senders(STALE_MS)
    offer(senders, "first-life", 1000, 10.0)

    assert offer(senders, "second-life", 0, 10.0)
    assert not offer(senders, "third-life", 0, 9.9)


def test_of_the_former_senders_those_that_were_followed_last_are_remembered() -> None:
    senders, boots = Senders(STALE_MS), [f"boot-{number}" for number in range(MAX_SENDERS + 2)]
    for number, boot_id in enumerate(boots):
        offer(senders, boot_id, 0, 10.0 + number / 100)

    assert not offer(senders, boots[-2], 1, 10.35)
    assert not offer(senders, boots[1], 1, 10.35)
    assert offer(senders, boots[0], 1, 10.35)


@given(
    st.lists(
        st.tuples(st.sampled_from("abc"), st.integers(0, 9), st.floats(0, 2), st.floats(0, 1)), min_size=1, max_size=30
    )
)
def test_whatever_comes_no_sender_goes_backwards_and_none_takes_over_with_older_samples(
    offers: list[tuple[str, int, float, float]],
) -> None:
    senders, last, present, now_s = Senders(STALE_MS), dict[str, int](), ("", 0.0), 0.0
    for boot_id, sequence, age_s, pause_s in offers:
        now_s += pause_s
        if offer(senders, boot_id, sequence, now_s - age_s, now_s):
            assert sequence > last.get(boot_id, -1)
            assert boot_id == present[0] or not present[0] or now_s - age_s >= present[1]
            last[boot_id], present = sequence, (boot_id, now_s - age_s)


def test_a_change_of_sender_is_counted_and_logged_seldom(
    bench: Bench, make_batch: MakeBatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "beamtouch.service")
    bench.post(make_batch(sequence=1))
    assert not caplog.records
    for number in range(1, 6):
        bench.now_s += 1
        bench.post(make_batch(boot_id="stray-by-hand", sequence=number))
        bench.now_s += 1
        bench.post(make_batch(sequence=2 + number))

    (changed,) = [one for one in caplog.records if "the sender changed" in one.getMessage()]
    assert "press-7: the sender changed to stray-by-hand" in changed.getMessage()
    assert sum("two daemons send its samples" in one.getMessage() for one in caplog.records) <= 1
    assert 'beamtouch_sender_changes_total{surface="press-7"} 10.0' in bench.get("/metrics").text
