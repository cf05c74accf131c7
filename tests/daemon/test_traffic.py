"""What an open port has carried since its last frame, and what to check."""

from math import inf

import pytest

from beamtouch_daemon.sources.traffic import Traffic, text_of

OPENED_S = 100.0
BOOTING = b"\0\xff\0 ets Jul 29 2019, rst:0x1 "


def traffic(*others: bytes, frame_s: float | None = None) -> Traffic:
    """Return a port that was opened, carried a frame at this time if any, and bytes that are no frame since."""
    port = Traffic(OPENED_S)
    if frame_s is not None:
        port.note_other(b"before it")
        port.note_frame(frame_s)
    for data in others:
        port.note_other(data)
    return port


def test_a_device_may_boot_for_8_s_until_its_first_frame() -> None:
    assert (traffic().boots_until_s, traffic(frame_s=101.0).boots_until_s) == (108.0, -inf)


@pytest.mark.parametrize(
    ("port", "silent_from_s"), [(traffic(), 130.0), (traffic(b"\0"), 130.0), (traffic(frame_s=107.5), 137.5)]
)
def test_a_port_is_opened_again_after_half_a_minute_without_a_frame(port: Traffic, silent_from_s: float) -> None:
    assert [port.is_silent(silent_from_s + beyond_s) for beyond_s in (-0.01, 0.0)] == [False, True]


def test_the_time_of_the_last_frame_is_told() -> None:
    assert traffic().describe_last_frame(103.0) == "no intact frame has come since the port was opened"
    assert traffic(frame_s=101.5).describe_last_frame(104.25) == "the last intact frame came 2.8 s ago"


@pytest.mark.parametrize(
    ("port", "said"),
    [
        (traffic(), "the port is open, but not a byte came; check supply and wiring"),
        (traffic(frame_s=101.0), "the port is open, but not a byte came since its last frame; check supply and wiring"),
        (
            traffic(b"\0\1\2", b"\3\4"),
            "the port is open, and 5 bytes came, none of them a frame; check baud and parity",
        ),
        (
            traffic(b"\0\1\2", frame_s=101.0),
            "the port is open, and 3 bytes came since its last frame, none of them a frame; check baud and parity",
        ),
        (
            traffic(BOOTING),
            "the device prints text: 'ets Jul 29 2019, rst:0x1'; is it the right device, and does it start again and "
            "again?",
        ),
    ],
)
def test_what_came_instead_of_frames_is_described(port: Traffic, said: str) -> None:
    assert port.describe(110.0) == said


def test_a_line_that_carried_a_frame_within_2_s_works() -> None:
    port = traffic(b"\0\1\2", frame_s=101.0)
    assert [bool(port.describe(now_s)) for now_s in (102.99, 103.0)] == [False, True]


def test_bytes_that_came_with_other_settings_say_nothing() -> None:
    port = traffic(b"rst:0x1 and more")
    port.forget()
    assert (port.noise, port.text) == ("", "")


def test_of_many_bytes_the_newest_256_may_be_text() -> None:
    port = traffic(b"\0" * 1000, b"a" * 86)
    assert (port.text, port.noise) == ("a" * 60, "1086 bytes")  # a third of 256 readable
    assert traffic(b"\0" * 1000, b"a" * 85).text == ""


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"", ""),
        (b"boots", ""),
        (b"boot 1", "boot 1"),
        (b"\1abcd\2efgh\3", "abcd efgh"),
        (b"abc\1def\2ghi", ""),  # words of three characters come by chance
        (b"  \tboot 1\t ", "boot 1"),
        (b"abcdef" + b"\1" * 12, "abcdef"),
        (b"abcdef" + b"\1" * 13, ""),
        (b"x" * 61, "x" * 60),
        (b"abcde\x7f\x80fghij", "abcde fghij"),
    ],
)
def test_bytes_are_text_if_enough_of_them_are_readable_in_words(data: bytes, text: str) -> None:
    assert text_of(data) == text
