"""One unit of a surface: when it is given up and tried again, and how its requests are counted."""

import asyncio
from collections.abc import Sequence
from contextlib import AbstractAsyncContextManager, AbstractContextManager, nullcontext

import pytest

from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.sources import polled
from beamtouch_daemon.sources.host_address import HostAddress, no_connection
from beamtouch_daemon.sources.polled import Part
from beamtouch_daemon.sources.reading import NoAnswerError, Schedule
from beamtouch_daemon.sources.registers import Block, RegisterAnswer, Value
from beamtouch_daemon.sources.requests import Failure, Requests

BLOCKS = [Block(4, 2), Block(9, 1)]
FIRST, SECOND = RegisterAnswer((7, 8), asked_s=50.0), RegisterAnswer((9,), asked_s=51.0)


class Unit:
    """A unit that gives these answers, in turn."""

    name = "unit 3"
    rest_s = 20.0
    observed = ""
    limits: tuple[str, ...] = ()

    def __init__(self, *answers: RegisterAnswer | NoAnswerError, boots_until_s: float = 0.0) -> None:
        self.requests = Requests()
        self.boots_until_s = boots_until_s
        self._answers = list(answers)

    def opened(self) -> AbstractAsyncContextManager[None]:
        return nullcontext()

    def kept_open(self) -> AbstractContextManager[None]:
        return nullcontext()

    async def read(self, _block: Block) -> RegisterAnswer:
        answer = self._answers.pop(0)
        if isinstance(answer, NoAnswerError):
            raise answer
        return answer


def part(*answers: RegisterAnswer | NoAnswerError, boots_until_s: float = 0.0) -> Part:
    return Part(Unit(*answers, boots_until_s=boots_until_s), BLOCKS, {0: Value(4)})


def read(one: Part) -> tuple[dict[int, int], float] | None:
    found = asyncio.run(one.read())
    return None if found is None else (dict(found[0]), found[1])


SILENT = NoAnswerError("unit 3 does not answer")
REFUSED, BUSY = RegisterAnswer(exception=2), RegisterAnswer(exception=6)


def test_the_registers_of_all_answers_are_as_old_as_the_first_request() -> None:
    one = part(FIRST, SECOND)
    assert read(one) == ({4: 7, 5: 8, 9: 9}, 50.0)
    assert (one.refusal, one.link.requests.asked, one.link.requests.failures) == ("", 2, 0)


def test_a_unit_that_refuses_some_registers_gives_the_others_and_says_which_it_lacks() -> None:
    one = part(FIRST, REFUSED, FIRST, SECOND)
    assert read(one) == ({4: 7, 5: 8}, 50.0)
    assert one.refusal.startswith("unit 3 answers with exception 2: it has no such register: asked for 9; ")
    assert (one.link.requests.failures, one.is_given_up) == (0, False)
    read(one)
    assert one.refusal == ""


@pytest.mark.parametrize(
    ("answers", "asked", "failed"),
    [
        ([FIRST, SILENT], 2, {"silent": 1}),
        ([NoAnswerError("late", Failure.LATE)], 1, {"late": 1}),
        ([BUSY, SILENT], 2, {"exception-6": 1, "silent": 1}),
        ([REFUSED, SILENT], 2, {"silent": 1}),
        ([REFUSED, REFUSED], 2, {"exception-2": 2}),
        ([FIRST, BUSY], 2, {"exception-6": 1}),
        ([FIRST._replace(refusals=(6, 5)), SECOND], 4, {"exception-6": 1, "exception-5": 1}),
    ],
)
def test_requests_are_counted_by_what_became_of_them(
    answers: Sequence[RegisterAnswer | NoAnswerError], asked: int, failed: dict[str, int]
) -> None:
    one = part(*answers)
    one._failures = 0
    read(one)
    assert (one.link.requests.asked, one.link.requests.failed) == (asked, failed)


def test_a_unit_that_failed_in_three_slots_in_a_row_is_given_up_for_its_rest() -> None:
    one = part(FIRST, SECOND, SILENT, SILENT, FIRST, SECOND, SILENT, SILENT, SILENT)
    for is_given_up in [False] * 6:
        before_s = uptime_s()
        found = read(one)
        assert one.is_given_up == is_given_up
    assert found is None
    read(one)
    assert (one.is_given_up, one.complaint) == (True, "unit 3 does not answer")
    assert before_s + 20.0 <= one.rests_until_s <= uptime_s() + 20.0
    assert one.link.requests.describe("unit 3") == ""  # it was away


def test_a_unit_that_begins_or_is_tried_again_is_given_up_at_its_first_failure() -> None:
    one = part(SILENT, SILENT)
    read(one)
    assert one.is_given_up
    one.revive()
    assert not one.is_given_up
    read(one)
    assert one.is_given_up


def test_a_unit_without_a_register_is_a_failure_with_its_reason() -> None:
    one = part(REFUSED, REFUSED)
    assert read(one) is None
    assert one.complaint.startswith("unit 3 answers with exception 2: ")
    nothing = part(RegisterAnswer(), RegisterAnswer())
    assert read(nothing) is None
    assert nothing.complaint == "unit 3 answers with no registers"


@pytest.mark.parametrize(
    ("boots_s", "rests_s", "may_boot"),
    [(-1.0, 20.0, False), (0.0, 20.0, False), (0.1, 0.5, True), (7.0, 7.0, True), (60.0, 20.0, True)],
)
def test_a_unit_that_may_boot_is_tried_again_at_the_end_of_that_time(
    boots_s: float, rests_s: float, may_boot: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(polled, "uptime_s", lambda: 100.0)
    one = part(boots_until_s=100.0 + boots_s)
    one.failed("away")
    assert (one.may_boot, one.rests_until_s) == (may_boot, 100.0 + rests_s)


def test_slots_begin_at_their_times_and_those_that_are_over_are_missed() -> None:
    schedule = Schedule(4.0, 100.0)
    taken = [schedule.advance(now_s) for now_s in (99.5, 100.1, 100.25, 100.6, 101.3, 101.3)]
    assert [(round(wait_s, 6), missed) for wait_s, missed in taken] == [
        (0.5, 0),  # slot 0 at 100
        (0.15, 0),  # slot 1 at 100.25
        (0.25, 0),  # slot 2 at 100.5
        (0.15, 0),  # slot 3 at 100.75
        (0.0, 1),  # slot 4 is over, slot 5 began at 101.25
        (0.2, 0),
    ]


def test_an_address_is_told_with_its_port() -> None:
    assert [str(HostAddress(host, 1502)) for host in ("plc", "::1")] == ["plc:1502", "[::1]:1502"]
    said = "no connection to plc:1502; is the device on, and is the address right?"
    assert no_connection(HostAddress("plc", 1502)) == said
    assert asyncio.run(HostAddress("::0001", 7).resolve(1.0)) == "::1"
