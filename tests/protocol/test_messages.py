"""Messages of the serial protocol, to bytes and back."""

import dataclasses
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beamtouch_protocol.messages import (
    MESSAGE_TYPES,
    PROTOCOL_VERSION,
    SCHEMA_HASH,
    SCHEMA_TEXT,
    Hello,
    HelloRequest,
    Identify,
    Message,
    Ping,
    Pong,
    Reading,
    Start,
    Stop,
    crc_seed,
)

HELLO = Hello(PROTOCOL_VERSION, SCHEMA_HASH, boot_id=1, channel_count=8, adc_bits=12, max_rate_hz=2000)
READING = Reading(sequence=0, device_us=0, oversampling=1, counts=(1, 2, 3))


@given(st.one_of([st.from_type(message) for message in MESSAGE_TYPES.values()]))
def test_a_payload_gives_back_the_message_it_came_from(message: Message) -> None:
    assert type(message).from_bytes(message.to_bytes()) == message


def test_integers_are_little_endian_and_without_gaps() -> None:
    assert Reading(0x0102, 0x03040506, 0x0B, (0x0708, 0x090A)).to_bytes() == bytes.fromhex("0201 06050403 0b 0807 0a09")


def test_messages_without_fields_have_no_payload() -> None:
    assert HelloRequest().to_bytes() == Stop().to_bytes() == b""


@pytest.mark.parametrize(
    ("field", "value", "limit"),
    [
        ("protocol_version", 2**8, 255),
        ("schema_hash", 2**32, 4294967295),
        ("boot_id", -1, 4294967295),
        ("channel_count", 256, 255),
        ("adc_bits", -1, 255),
        ("max_rate_hz", 2**16, 65535),
    ],
)
def test_an_out_of_range_value_is_refused_by_name(field: str, value: int, limit: int) -> None:
    with pytest.raises(ValueError, match=f"^{field} must be a whole number from 0 to {limit}, not {value}$"):
        dataclasses.replace(HELLO, **{field: value}).to_bytes()


def test_half_a_microsecond_is_refused_by_name() -> None:
    half: dict[str, Any] = {"device_us": 0.5}
    with pytest.raises(ValueError, match=r"device_us .* not 0\.5"):
        dataclasses.replace(READING, **half).to_bytes()


def test_an_out_of_range_count_is_named_with_its_channel() -> None:
    with pytest.raises(ValueError, match=r"^counts\[2\] must be .* not 65536$"):
        Reading(0, 0, 1, (1, 2, 65536, 4)).to_bytes()


@pytest.mark.parametrize("channels", [0, 33])
def test_a_reading_has_one_to_32_channels(channels: int) -> None:
    with pytest.raises(ValueError, match=f"^counts must hold 1 to 32 values, not {channels}$"):
        Reading(0, 0, 1, (0,) * channels).to_bytes()


@pytest.mark.parametrize(
    "message", [HelloRequest(), Ping(7), Identify(5), Start(1000, 4), Stop(), HELLO, Pong(7, 99), READING]
)
def test_a_payload_of_another_length_is_refused(message: Message) -> None:
    payload = message.to_bytes()
    wrong = [payload + b"\x01", *(payload[:end] for end in range(len(payload)))]
    if isinstance(message, Reading):
        wrong.remove(payload[:9])  # one channel
        wrong.remove(payload[:11])  # two channels
    for candidate in wrong:
        with pytest.raises(ValueError, match=r"too long|cut off|cannot be"):
            type(message).from_bytes(candidate)


def test_a_hello_decodes_with_any_values_of_another_version() -> None:
    foreign = Hello.from_bytes(b"\xff" * 13)
    assert (foreign.protocol_version, foreign.channel_count, foreign.adc_bits) == (255, 255, 255)


def test_only_the_same_version_and_schema_are_compatible() -> None:
    assert HELLO.is_compatible
    assert not dataclasses.replace(HELLO, protocol_version=PROTOCOL_VERSION + 1).is_compatible
    assert not dataclasses.replace(HELLO, schema_hash=SCHEMA_HASH ^ 1).is_compatible


def test_only_hello_and_its_request_are_readable_across_versions() -> None:
    unseeded = {number for number in range(256) if crc_seed(number) == 0}
    assert unseeded == {HelloRequest.TYPE, Hello.TYPE}
    assert {crc_seed(number) for number in set(range(256)) - unseeded} == {SCHEMA_HASH}


def test_an_answer_has_the_number_of_its_question_plus_0x80() -> None:
    for question, answer in ((HelloRequest, Hello), (Ping, Pong), (Start, Reading)):
        assert question.TYPE + 0x80 == answer.TYPE
    to_device = [message for number, message in MESSAGE_TYPES.items() if number < 0x80]
    assert to_device == [HelloRequest, Ping, Identify, Start, Stop]


def test_the_schema_names_every_field_of_every_message() -> None:
    for number, message in MESSAGE_TYPES.items():
        line = next(line for line in SCHEMA_TEXT.splitlines() if line.startswith(f"0x{number:02x} "))
        words = line.split()
        assert words[1] == message.__name__
        assert [word.split(":")[0] for word in words[2:]] == [field.name for field in dataclasses.fields(message)]


def test_a_message_cannot_be_changed() -> None:
    for field in dataclasses.fields(READING):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(READING, field.name, 1)
