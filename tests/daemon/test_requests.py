"""Requests to a unit of which some fail: how many and why, what is said, and which are repeated."""

import asyncio
from collections.abc import Sequence

import pytest

from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.sources.registers import Block, RegisterAnswer
from beamtouch_daemon.sources.requests import Failure, Requests, exception_words, insist, refusal_text


def outcomes(*reasons: str) -> Requests:
    """Return the outcomes of requests; an empty reason: it was answered."""
    requests = Requests()
    for reason in reasons:
        requests.fail(reason) if reason else requests.answered()
    return requests


@pytest.mark.parametrize(
    ("reasons", "share"),
    [
        ([""] * 8 + [Failure.LATE], 0.0),
        ([""] * 7 + [Failure.LATE] * 2, 0.0),  # nine requests say nothing
        ([""] * 8 + [Failure.LATE] * 2, 0.2),
        ([""] * 30 + [Failure.LATE], 0.0),  # one of them may be chance
        ([Failure.SILENT] * 10 + [""] * 90, 0.1),
        ([Failure.SILENT] * 10 + [""] * 95, 0.05),  # the first five are over a hundred requests ago
        ([Failure.SILENT] * 10 + [""] * 99, 0.0),
    ],
)
def test_the_share_of_failed_requests_is_of_the_newest_hundred(reasons: list[str], share: float) -> None:
    assert outcomes(*reasons).failed_share == share


def test_all_requests_are_counted_by_reason() -> None:
    requests = outcomes(*["", Failure.LATE, "exception-6"] * 50)
    assert (requests.asked, requests.failures) == (150, 100)
    assert requests.failed == {"late": 50, "exception-6": 50}


def test_what_a_unit_did_before_it_was_away_says_nothing_of_later_requests() -> None:
    requests = outcomes(*[Failure.SILENT] * 20)
    requests.forget()
    assert (requests.failed_share, requests.describe("unit 3")) == (0.0, "")
    for _ in range(10):
        requests.answered()
    assert (requests.failed_share, requests.asked, requests.failures) == (0.0, 30, 20)
    requests.forget()
    for _ in range(7):
        requests.answered()
    for _ in range(2):
        requests.fail(Failure.LATE)
    assert requests.failed_share == 0.0  # nine requests say nothing
    assert requests.describe("unit 3") == "2 of 9 requests to unit 3 fail: late answer (2); raise timeout_ms"


@pytest.mark.parametrize(
    ("reasons", "said"),
    [
        ([""] * 12, ""),
        (
            ["", Failure.LATE, "exception-6", Failure.LATE],
            "3 of 4 requests to unit 7 fail: late answer (2), exception 6, device busy (1); raise timeout_ms",
        ),
        (
            ["exception-2", ""],
            "1 of 2 requests to unit 7 fail: exception 2, it has no such register (1); look in its manual what that "
            "means",
        ),
        (
            ["exception-11"],
            "1 of 1 requests to unit 7 fail: exception 11, gateway (1); check supply, wiring and timeout of the unit's "
            "line behind the gateway",
        ),
    ],
)
def test_the_failures_are_described_the_most_frequent_first_with_what_to_do(reasons: list[str], said: str) -> None:
    assert outcomes(*reasons).describe("unit 7") == said


@pytest.mark.parametrize(
    ("exception", "block", "said"),
    [
        (
            2,
            Block(30, 4),
            "exception 2: it has no such register: asked for 30 to 33; addresses count from 0, so a manual's 30001 or "
            "40001 is 0",
        ),
        (3, Block(7, 1), "exception 3: it refuses that many registers: asked for 7"),
        (4, Block(7, 1), "exception 4: device failure; look in its manual what that means"),
        (77, Block(7, 1), "exception 77: an error"),
    ],
)
def test_a_refusal_is_told_with_the_registers_and_what_to_do(exception: int, block: Block, said: str) -> None:
    assert refusal_text(exception, block) == said


@pytest.mark.parametrize(
    ("exception", "words"),
    [
        # The codes are those of the Modbus Application Protocol Specification 1.1b3, chapter 7.
        (0, "an error"),
        (1, "it does not know this function"),
        (2, "it has no such register"),
        (3, "it refuses that many registers"),
        (4, "device failure"),
        (5, "it needs more time"),
        (6, "device busy"),
        (7, "an error"),
        (8, "memory error"),
        (9, "an error"),
        (10, "gateway path unavailable"),
        (11, "gateway"),
        (12, "an error"),
        (77, "an error"),
    ],
)
def test_a_refusal_in_a_few_words_is_what_the_standard_means_and_names_no_registers(exception: int, words: str) -> None:
    assert exception_words(exception) == f"exception {exception}, {words}"


BUSY, LASTING, ANSWERED = RegisterAnswer(exception=6), RegisterAnswer(exception=2), RegisterAnswer((5, 6))


@pytest.mark.parametrize(
    ("answers", "refusals", "asked"),
    [
        ([ANSWERED], (), 1),
        ([LASTING], (), 1),
        ([BUSY, ANSWERED], (6,), 2),
        ([BUSY, BUSY, ANSWERED], (6, 6), 3),
        ([BUSY, BUSY, BUSY, ANSWERED], (6, 6), 3),
    ],
)
def test_a_request_that_is_refused_for_now_is_sent_three_times(
    answers: Sequence[RegisterAnswer], refusals: tuple[int, ...], asked: int
) -> None:
    sent = list[Block]()

    async def ask(block: Block) -> RegisterAnswer:
        sent.append(block)
        return answers[len(sent) - 1]._replace(asked_s=100.0 + len(sent))

    answer = asyncio.run(insist(ask, Block(4, 2)))
    assert sent == [Block(4, 2)] * asked
    assert answer == answers[asked - 1]._replace(asked_s=101.0, refusals=refusals)  # as old as the first request


@pytest.mark.parametrize(("ago_s", "asked"), [(0.0, 2), (700.0, 1)])
def test_a_refusal_that_took_long_is_not_followed_by_another_request(ago_s: float, asked: int) -> None:
    number = 0

    async def ask(_block: Block) -> RegisterAnswer:
        nonlocal number
        number += 1
        return BUSY._replace(asked_s=uptime_s() - ago_s) if number == 1 else ANSWERED

    asyncio.run(insist(ask, Block(4, 2), refused_within_s=600.0))
    assert number == asked
