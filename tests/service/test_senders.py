"""The samples that change the contact, from one sender or several: over HTTP."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamtouch_models import modelfile
from beamtouch_service.surfaces.surface import Surface
from service.conftest import Bench, batch_of
from service.small_model import write_model

if TYPE_CHECKING:
    from service.conftest import MakeBatch

STALE_S = 0.5


def moves(bench: Bench, boot_id: str, sequence: int, age_s: float = 0.0) -> bool:
    """Send a sample, and return whether the contact stands on it. No other sender has sent this number."""
    assert bench.post(batch_of(sequence=sequence, boot_id=boot_id, age_ms=age_s * 1e3)).status_code == 200
    return bool(bench.get("/contact").json().get("sequence") == sequence)


def test_a_former_sender_returns_when_the_present_is_stale_and_not_before(bench: Bench) -> None:
    assert moves(bench, "daemon-one", 12)
    bench.now_s += 0.1
    assert moves(bench, "stray-by-hand", 1)

    bench.now_s += STALE_S
    assert not moves(bench, "daemon-one", 13)
    bench.now_s += 0.001
    assert moves(bench, "daemon-one", 14)
    bench.now_s += 0.001
    assert moves(bench, "daemon-one", 15)
    assert 'beamtouch_sender_changes_total{surface="press-7"} 2.0' in bench.get("/metrics").text


def test_a_former_sender_never_goes_backwards(bench: Bench) -> None:
    moves(bench, "daemon-one", 12)
    bench.now_s += 0.1
    moves(bench, "stray-by-hand", 1)
    bench.now_s += 0.05
    assert moves(bench, "stray-by-hand", 2)

    bench.now_s += 10
    assert not moves(bench, "daemon-one", 12)
    assert not moves(bench, "daemon-one", 13, age_s=10.1)
    assert moves(bench, "daemon-one", 14)
    bench.now_s += 10
    assert not moves(bench, "stray-by-hand", 2)


def test_a_sender_that_started_anew_is_followed_at_once(bench: Bench) -> None:
    moves(bench, "first-life", 1000)
    assert moves(bench, "second-life", 1)
    assert not moves(bench, "third-life", 2, age_s=0.1)


def test_of_the_former_senders_those_that_were_followed_last_are_remembered(bench: Bench) -> None:
    boots = [f"boot-{number:04}" for number in range(18)]
    for number, boot_id in enumerate(boots, start=1):
        bench.now_s += 0.01
        assert moves(bench, boot_id, number)

    assert not moves(bench, boots[-2], 101)
    assert not moves(bench, boots[1], 102)
    assert moves(bench, boots[0], 103)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> modelfile.ModelFile:
    return modelfile.load(write_model(tmp_path_factory.mktemp("model")))


_OFFER = st.tuples(st.sampled_from("abc"), st.integers(1, 9), st.floats(0, 0.4), st.floats(0, 1))


@settings(max_examples=25)
@given(st.lists(_OFFER, min_size=1, max_size=20))
def test_whatever_comes_no_sender_goes_backwards_and_none_takes_over_with_older_samples(
    model: modelfile.ModelFile, offers: list[tuple[str, int, float, float]]
) -> None:
    bench, last, present, present_s = Bench(Surface("press-7", model)), dict[str, int](), "", 0.0
    for sender, number, age_s, pause_s in offers:
        bench.now_s += pause_s
        sequence = number + 100 * ord(sender)
        was_there = last.get(present) == sequence
        if moves(bench, f"boot-of-{sender}", sequence, age_s) and not was_there:
            assert number > last.get(sender, 0) % 100
            assert sender == present or not present or bench.now_s - age_s >= present_s
            last[sender], present, present_s = sequence, sender, bench.now_s - age_s


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
