"""Samples of one sender or of several: which count as new, which move the contact, and when two daemons send."""

import re
from collections.abc import Iterable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.bench import START_US, TOKEN, Bench, batch_of, surface_of, surface_with

STALE_S = 0.5
STEP_S = 0.1


def moves(bench: Bench, boot_id: str, sequence: int, age_s: float = 0.0) -> bool:
    """Send a sample, and return whether the contact stands on it. No other sender has sent this number."""
    bench.send(sequence=sequence, boot_id=boot_id, age_ms=age_s * 1e3)
    return bool(bench.get("/contact").json().get("sequence") == sequence)


@pytest.mark.promise(
    "docs/reference/samples.md",
    "A sender that another one has replaced returns only when the newest sample is stale.",
    "So a single sample posted by hand blocks the daemon for at most `stale_ms`.",
)
def test_a_former_sender_returns_when_the_present_is_stale_and_not_before(bench: Bench) -> None:
    assert moves(bench, "daemon-one", 12)
    bench.now_s += STEP_S
    assert moves(bench, "stray-by-hand", 1)
    for number in range(4):
        # Its age is stated wrongly: as if it were taken just now.
        assert not moves(bench, "daemon-one", 13 + number)
        bench.now_s += STALE_S / 4
    assert not moves(bench, "daemon-one", 18)
    bench.now_s += 0.001
    assert moves(bench, "daemon-one", 19)
    assert moves(bench, "daemon-one", 20)
    assert 'beamtouch_sender_changes_total{surface="press-7"} 2.0' in bench.metrics()


def test_a_former_sender_never_goes_backwards(bench: Bench) -> None:
    moves(bench, "daemon-one", 12)
    bench.now_s += STEP_S
    assert moves(bench, "stray-by-hand", 1)
    bench.now_s += 10
    assert not moves(bench, "daemon-one", 11)
    assert not moves(bench, "daemon-one", 12)
    assert bench.problem() == "stale"
    assert not moves(bench, "daemon-one", 13, age_s=10.1)
    assert moves(bench, "daemon-one", 14)
    bench.now_s += 10
    assert not moves(bench, "stray-by-hand", 1)


def test_a_sender_that_started_anew_is_followed_at_once_but_not_with_older_samples(bench: Bench) -> None:
    assert moves(bench, "first-life", 1000)
    assert moves(bench, "second-life", 1)
    assert not moves(bench, "third-life", 2, age_s=STEP_S)


OFFERS = st.tuples(st.sampled_from("abc"), st.integers(1, 9), st.floats(0, 0.4), st.floats(0, 1))
"""Sender, number, age and the pause before [s]."""


@settings(max_examples=10)
@given(st.lists(OFFERS, min_size=1, max_size=12))
def test_no_sender_goes_backwards_and_none_takes_over_with_older_samples(
    offers: list[tuple[str, int, float, float]],
) -> None:
    bench, newest, present, present_s = Bench(surface_of()), dict[str, int](), "", 0.0
    for sender, number, age_s, pause_s in offers:
        bench.now_s += pause_s
        sequence = number + 100 * ord(sender)  # no two senders share a number
        is_repeated = newest.get(present) == sequence
        if moves(bench, f"boot-of-{sender}", sequence, age_s) and not is_repeated:
            assert sequence > newest.get(sender, 0)
            assert sender == present or not present or bench.now_s - age_s >= present_s
            newest[sender], present, present_s = sequence, sender, bench.now_s - age_s


class Numbers:
    """Sends samples of these numbers to a surface without a model."""

    def __init__(self) -> None:
        self._bench = Bench(surface_with(None))

    def send(self, numbers: Iterable[int], boot_id: str = "boot-0001") -> tuple[int, int]:
        """Return how many of them count as new, and how many as repeated."""
        numbers = list(numbers)
        batch = batch_of(*[[0.5]] * len(numbers), boot_id=boot_id)
        for sample, number in zip(batch["samples"], numbers, strict=True):
            sample["sequence"] = number
        receipt = self._bench.post(batch).json()
        return receipt["accepted"], receipt["repeated"]

    @property
    def lost(self) -> int:
        lost: int = self._bench.get("/surfaces/press-7").json()["samples"]["lost"]
        return lost


@settings(max_examples=12)
@given(batches=st.lists(st.sets(st.integers(1, 60), min_size=1), min_size=1, max_size=12))
def test_any_order_of_batches_gives_what_a_set_gives(batches: list[set[int]]) -> None:
    sender, known = Numbers(), set[int]()
    for batch in batches:
        assert sender.send(sorted(batch)) == (len(batch - known), len(batch & known))
        known |= batch
        assert sender.lost == max(known) - min(known) + 1 - len(known)


@pytest.mark.promise(
    "docs/reference/samples.md",
    "If two programs send samples of a surface in turn, the contact has the note `senders`",
)
@pytest.mark.promise(
    "docs/how-to/troubleshooting.md",
    "The log says `one daemon sends its samples again` some seconds later.",
)
@pytest.mark.parametrize("age_s", [0.0, 0.05, 0.4])
def test_two_daemons_that_send_in_turn_are_told_until_one_stops(
    bench: Bench, caplog: pytest.LogCaptureFixture, age_s: float
) -> None:
    caplog.set_level("INFO", "beamtouch_service")
    for number in range(1, 21):
        bench.now_s += STEP_S
        moves(bench, "daemon-one", number)
        moves(bench, "daemon-two", number, age_s)
    assert bench.contact()["notes"] == ["senders"]
    assert 'beamtouch_note{note="senders",surface="press-7"} 1.0' in bench.metrics()
    for number in range(21, 81):
        bench.now_s += 2 * STEP_S
        moves(bench, "daemon-two", number, age_s)
    assert bench.contact()["notes"] == []
    assert [message for message in caplog.messages if "daemon" in message and "changed to" not in message] == [
        "surface press-7: two daemons send its samples, from testclient:50000 and from testclient:50000; "
        "stop one of them",
        "surface press-7: one daemon sends its samples again",
    ]
    assert sum("the sender changed to" in message for message in caplog.messages) <= 2  # one a minute


@pytest.mark.promise("docs/reference/samples.md", "Behind a proxy, the address is the one in `X-Forwarded-For`.")
def test_the_line_about_two_daemons_names_the_one_behind_a_proxy(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    headers = {"Authorization": f"Bearer {TOKEN}", "X-Forwarded-For": "203.0.113.7, 10.0.0.6"}
    for number in range(1, 21):
        bench.now_s += STEP_S
        moves(bench, "daemon-one", number)
        batch = batch_of(sequence=number, boot_id="daemon-two")
        assert bench.client.post("/surfaces/press-7/samples", json=batch, headers=headers).status_code == 200
    (line,) = (message for message in caplog.messages if "two daemons" in message)
    assert "10.0.0.6 (through testclient:50000)" in line
    assert "203.0.113.7" not in line


def test_a_daemon_that_is_started_anew_and_delivers_its_log_is_one(bench: Bench) -> None:
    begun_s, sent = list[float](), 0
    for number in range(3):
        begun_s.append(bench.now_s)
        for _ in range(10):
            bench.now_s += STEP_S
            sent += 1
            moves(bench, f"daemon-{number}", sent)
            # Beside its own samples, those that the earlier ones left on disk: an hour old, or of their last second.
            for old, began_s in enumerate(begun_s[:number]):
                for age_s in (3600.0, bench.now_s - began_s - 1.0):
                    sent += 1
                    moves(bench, f"daemon-{old}", sent, age_s)
            assert bench.contact()["notes"] == []


def test_a_daemon_with_another_clock_than_the_service_is_named_once_an_hour(caplog: pytest.LogCaptureFixture) -> None:
    bench = Bench(surface_of(), surface_of("press-8"))
    for number in range(3):
        bench.now_s += 1
        bench.send(sequence=number + 1, begin_us=START_US + 8 * 86_400_000_000)
        bench.send(sequence=number + 1, surface="press-8", begin_us=START_US - 50_000_000)
    assert caplog.messages == [
        "surface press-7: the clock of its daemon is 8 days ahead of that of this machine; events have the time of the "
        "daemon"
    ]
    ahead_s = figures(bench, "beamtouch_sender_clock_ahead_seconds")
    assert ahead_s == {"press-7": pytest.approx(8 * 86_400, abs=10), "press-8": pytest.approx(-50, abs=10)}
    bench.now_s += 10
    # Nothing is known of one whose samples have stopped.
    assert figures(bench, "beamtouch_sender_clock_ahead_seconds") == {}
    bench.now_s += 3600
    bench.send(sequence=10, begin_us=START_US - 2 * 3_600_000_000)
    assert caplog.messages[1:] == [
        "surface press-7: the clock of its daemon is 2 hours behind that of this machine; events have the time of the "
        "daemon"
    ]


def figures(bench: Bench, name: str) -> dict[str, float]:
    """Return a metric of each surface."""
    found = re.findall(rf'^{name}{{surface="(.*?)"}} (.*)$', bench.metrics(), re.MULTILINE)
    return {surface: float(value) for surface, value in found}
