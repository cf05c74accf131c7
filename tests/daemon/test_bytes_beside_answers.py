"""What came beside an answer on a Modbus line, what a silent unit is said to lack, and late answers."""

import pytest

from beamtouch_daemon.sources.frame_diagnosis import (
    Request,
    describe_beside,
    describe_received,
    describe_silence,
    holds_answer,
)
from beamtouch_daemon.sources.registers import Block

from .devices import with_crc

ANSWER = with_crc(bytes([3, 4, 4, 0, 7, 0, 8]))
SECOND = with_crc(bytes([3, 4, 4, 0, 7, 0, 9]))
ASKED = Request(3, Block(0, 2), 100.0, ANSWER)
EARLIER = Request(5, Block(0, 1), 99.75)
LATE = with_crc(bytes([5, 4, 2, 0, 7]))
STRAY = (
    "stray bytes, harmless while answers come intact: noise, no bias or termination, or a transmitter that is switched "
    "too late"
)


@pytest.mark.parametrize(
    ("before", "after", "is_echoed", "said"),
    [
        (b"", b"", False, ""),
        (b"", b"", True, "the adapter echoes requests"),
        (b"\xfe", b"", True, f"the adapter echoes requests; 1 byte came before it (fe): {STRAY}"),
        (b"", b"\xfe\1", False, f"2 bytes came after it (fe 01): {STRAY}"),
        (
            LATE,
            b"",
            False,
            f"7 bytes came before it ({LATE.hex(' ')}): the late answer of unit 5 to the request before, read 375 ms "
            "after it: raise timeout_ms",
        ),
        (
            b"\xfe",
            SECOND,
            False,
            f"1 byte came before it (fe): {STRAY}; 9 bytes came after it ({SECOND.hex(' ')}): a second answer of unit "
            "3 to one request, unlike the first: two units have the number 3",
        ),
        (
            b"",
            ANSWER,
            False,
            f"9 bytes came after it ({ANSWER.hex(' ')}): a second answer of unit 3 to one request, equal to the first: "
            "an adapter that repeats, or two units with this number",
        ),
        (b"", LATE, False, f"7 bytes came after it ({LATE.hex(' ')}): an intact answer of unit 5"),
        (
            b"",
            ANSWER[:-1] + b"\0",
            False,
            f"9 bytes came after it ({(ANSWER[:-1] + bytes(1)).hex(' ')}): an answer of unit 3 with a wrong checksum, "
            "where others were intact: a bad line (wiring, termination, noise), or two masters",
        ),
    ],
)
def test_bytes_beside_an_answer_are_named(before: bytes, after: bytes, is_echoed: bool, said: str) -> None:
    assert describe_beside(before, after, ASKED, EARLIER, 100.125, is_echoed=is_echoed) == said


def test_without_an_earlier_request_an_answer_before_the_answer_is_of_anybody() -> None:
    said = describe_beside(LATE, b"", ASKED, None, 100.125, is_echoed=False)
    assert said == f"7 bytes came before it ({LATE.hex(' ')}): an intact answer of unit 5"


def test_a_late_answer_is_told_from_others_by_its_unit_and_its_length() -> None:
    assert [holds_answer(data, EARLIER) for data in (LATE, b"\0" + LATE + b"\1", ANSWER, b"")] == [
        True,
        True,
        False,
        False,
    ]
    assert not holds_answer(LATE, EARLIER._replace(block=Block(0, 2)))
    said = describe_received(LATE, b"\3\4", 3, EARLIER, 100.0)
    assert said == (
        f"7 bytes came ({LATE.hex(' ')}): the late answer of unit 5 to the request before, read 250 ms after it: raise "
        "timeout_ms"
    )


@pytest.mark.parametrize(
    ("has_answered", "others_answer", "said"),
    [
        (True, True, "unit 7 has answered before: check its supply and its cable, or raise timeout_ms"),
        (
            False,
            True,
            "other units answer, so the line works: check the number of unit 7, its supply and its cable",
        ),
        (
            False,
            False,
            "silence has many reasons: with the daemon stopped, `beamtouch-daemon scan /dev/x` finds baud, parity and "
            "number; if it finds no unit, exchange A and B, then check the supply",
        ),
    ],
)
def test_of_a_silent_unit_it_is_said_what_to_check(has_answered: bool, others_answer: bool, said: str) -> None:
    assert describe_silence("/dev/x", 7, has_answered=has_answered, others_answer=others_answer) == said


LONG = with_crc(bytes([9, 16]) + b"\x91" * 252)
"""A frame of 256 bytes, the most that the standard allows."""


@pytest.mark.parametrize(
    ("came", "said"),
    [
        (bytes([3, 4, 6, 0, 7]), "the beginning of an answer of unit 3, which breaks off after 5 of 11 bytes"),
        (b"\7\7\7", "no Modbus frame: another baud rate or parity"),
        (b"\xff\xff", "too few bytes to tell what they are"),
        (b"\0\0", "only 00 and ff, so the line has no level"),
        (b"\0\xff\xff", "only 00 and ff, so the line has no level"),
        (b"\xff\xff\xff", "only 00 and ff, so the line has no level"),
        (with_crc(bytes([9, 7])), "an intact frame with function 7, of unit 9 or to it: another master is on the line"),
        (with_crc(bytes([9, 7])) + b"\x55", "an intact frame with function 7, of unit 9 or to it"),
        (b"\x55\x56" + with_crc(bytes([9, 7])), "an intact frame with function 7, of unit 9 or to it"),
        (LONG, "an intact frame with function 16, of unit 9 or to it"),
        (LONG + b"\x55", "an intact frame with function 16, of unit 9 or to it"),
        (with_crc(bytes([9, 16]) + b"\x91" * 253), "no Modbus frame: another baud rate or parity"),
        (with_crc(bytes([9, 3, 0, 7, 0])), "an intact frame with function 3, of unit 9 or to it"),  # no whole request
        (with_crc(bytes([9, 5, 0, 7, 255, 0])), "an intact frame with function 5, of unit 9 or to it"),
    ],
)
def test_bytes_that_nobody_asked_for_are_named(came: bytes, said: str) -> None:
    assert said in describe_received(came, with_crc(bytes([3, 4, 0, 0, 0, 2])), 3)
