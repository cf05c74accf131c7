"""Frames of the serial protocol are found in any stream of bytes."""

import zlib

import pytest
from cobs import cobs

from beamtouch_protocol.framing import DELIMITER, MAX_FRAME_BYTES, Decoder, Rejection, encode
from beamtouch_protocol.messages import (
    SCHEMA_HASH,
    Hello,
    HelloRequest,
    Identify,
    Message,
    Ping,
    Pong,
    Reading,
    Start,
    Stop,
)

READING = Reading(sequence=7, device_us=1_000_000, oversampling=1, counts=(0, 1, 4095, 65535))
FOREIGN_HELLO = Hello(
    protocol_version=9, schema_hash=0xFEEDFACE, boot_id=3, channel_count=60, adc_bits=24, max_rate_hz=1
)
TO_DEVICE: list[Message] = [HelloRequest(), Ping(7), Identify(5), Start(1000, 4), Stop()]
MESSAGES: list[Message] = [*TO_DEVICE, Pong(7, 99), FOREIGN_HELLO, READING]


def seal(body: bytes, seed: int) -> bytes:
    encoded: bytes = cobs.encode(body + zlib.crc32(body, seed).to_bytes(4, "little"))
    return encoded + DELIMITER


def reasons(decoder: Decoder) -> dict[Rejection, int]:
    return {reason: number for reason, number in decoder.counts.rejected_by.items() if number}


@pytest.mark.parametrize("message", MESSAGES)
def test_a_frame_has_one_zero_at_its_end_and_decodes_to_its_message(message: Message) -> None:
    frame = encode(message)
    assert frame.index(0) == len(frame) - 1
    assert Decoder().feed(frame) == [message]


def test_messages_come_out_in_the_order_they_went_in() -> None:
    decoder = Decoder()
    assert decoder.feed(b"".join(map(encode, MESSAGES))) == MESSAGES
    assert decoder.counts.frames == len(MESSAGES)
    assert decoder.counts.rejected == 0


def test_a_message_appears_with_its_delimiter_and_not_before() -> None:
    decoder = Decoder()
    frame = encode(READING)
    assert decoder.feed(frame[:-1]) == []
    assert decoder.feed(frame[-1:]) == [READING]


def test_empty_frames_are_skipped_and_not_counted() -> None:
    decoder = Decoder()
    assert decoder.feed(b"\0\0\0" + encode(READING) + b"\0") == [READING]
    assert (decoder.counts.frames, decoder.counts.rejected) == (1, 0)


def test_a_host_that_opens_the_line_during_a_frame_loses_only_that_frame() -> None:
    for cut in range(1, len(encode(READING)) - 1):
        decoder = Decoder()
        assert decoder.feed(encode(READING)[cut:] + encode(READING)) == [READING]
        assert decoder.counts.rejected == 1


def test_a_device_that_resets_during_a_frame_ends_it_with_a_delimiter() -> None:
    decoder = Decoder()
    assert decoder.feed(encode(READING)[:9] + DELIMITER + encode(FOREIGN_HELLO)) == [FOREIGN_HELLO]
    assert decoder.counts.rejected == 1


def test_a_lost_delimiter_costs_two_frames_and_no_more() -> None:
    decoder = Decoder()
    assert decoder.feed(encode(READING)[:-1] + encode(READING) + encode(Stop())) == [Stop()]
    assert decoder.counts.rejected == 1


def test_a_reading_of_another_schema_is_never_accepted() -> None:
    body = bytes([Reading.TYPE]) + READING.to_bytes()
    decoder = Decoder()
    assert decoder.feed(seal(body, SCHEMA_HASH ^ 1) + seal(body, 0)) == []
    assert reasons(decoder) == {Rejection.CRC: 2}
    assert decoder.feed(seal(body, SCHEMA_HASH)) == [READING]


def test_the_hello_of_another_version_is_always_accepted() -> None:
    body = bytes([Hello.TYPE]) + FOREIGN_HELLO.to_bytes()
    assert Decoder().feed(seal(body, 0)) == [FOREIGN_HELLO]


def test_the_longest_frame_fits_and_one_byte_more_does_not() -> None:
    longest = Reading(65535, 2**32 - 1, 255, (65535,) * 32)
    assert len(encode(longest)) == MAX_FRAME_BYTES
    body = bytes([Reading.TYPE]) + longest.to_bytes() + b"\x01"
    decoder = Decoder()
    assert decoder.feed(encode(longest) + seal(body, SCHEMA_HASH)) == [longest]
    assert reasons(decoder) == {Rejection.OVERLONG: 1}


def test_overlong_garbage_counts_once_takes_no_memory_and_ends_at_the_next_delimiter() -> None:
    decoder = Decoder()
    for _ in range(1000):
        assert decoder.feed(b"\x55" * 100) == []
        assert len(decoder._frame) < MAX_FRAME_BYTES
    assert decoder.feed(encode(Stop())) == []  # its delimiter ends the garbage
    assert decoder.feed(encode(READING)) == [READING]
    assert reasons(decoder) == {Rejection.OVERLONG: 1}


def test_the_beginning_of_an_overlong_frame_is_not_decoded() -> None:
    decoder = Decoder()
    assert decoder.feed(encode(READING)[:-1]) == []
    assert decoder.feed(b"\x55" * 100) == []
    assert decoder.feed(DELIMITER + encode(Stop())) == [Stop()]
    assert reasons(decoder) == {Rejection.OVERLONG: 1}


def test_an_out_of_range_value_cannot_be_encoded() -> None:
    with pytest.raises(ValueError, match="rate_hz"):
        encode(Start(65536, 1))
