"""The codec in Python: against golden frames and an encoder written by hand, and on damaged streams.

The encoder in this file uses neither zlib nor cobs nor the package, so a number on which both agree is right.
"""

import dataclasses
import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beamtouch_protocol import messages
from beamtouch_protocol.framing import MAX_FRAME_BYTES, Decoder, Rejection, encode
from beamtouch_protocol.messages import PROTOCOL_VERSION, SCHEMA_HASH, Hello, Identify, Message, Reading, Start, Stop
from beamtouch_protocol.sequence import DeviceClock, missing_between

from .codec_cases import GOLDEN, damage, golden_message, noise, random_message

TYPE_AND_WIDTHS: dict[str, tuple[int, list[int]]] = {
    "HelloRequest": (0x01, []),
    "Ping": (0x02, [2]),
    "Identify": (0x03, [1]),
    "Start": (0x10, [2, 1]),
    "Stop": (0x11, []),
    "Hello": (0x81, [1, 4, 4, 1, 1, 2]),
    "Pong": (0x82, [2, 4]),
    "Reading": (0x90, [2, 4, 1, 2]),
}
READING = Reading(sequence=7, device_us=1_000_000, oversampling=1, counts=(0, 1, 4095, 65535))
HELLO = Hello(PROTOCOL_VERSION, SCHEMA_HASH, boot_id=1, channel_count=8, adc_bits=12, max_rate_hz=2000)
FRAME = encode(READING)


def bitwise_crc(data: bytes, seed: int) -> int:
    register = seed ^ 0xFFFFFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = (register >> 1) ^ (0xEDB88320 if register & 1 else 0)
    return register ^ 0xFFFFFFFF


def handmade_frame(vector: dict[str, Any]) -> bytes:
    number, widths = TYPE_AND_WIDTHS[vector["message"]]
    body = [number]
    for value, width in zip(vector["fields"].values(), widths, strict=True):
        for item in value if isinstance(value, list) else [value]:
            body += [item >> 8 * place & 0xFF for place in range(width)]
    seed = 0 if vector["message"] in {"Hello", "HelloRequest"} else int(GOLDEN["schema_hash_hex"], 16)
    content = bytes(body) + bitwise_crc(bytes(body), seed).to_bytes(4, "little")
    assert bytes(body).hex() == vector["body_hex"]
    assert len(content) < 254
    return b"".join(bytes([len(piece) + 1]) + piece for piece in content.split(b"\0")) + b"\0"


def reasons(decoder: Decoder) -> dict[Rejection, int]:
    return {reason: number for reason, number in decoder.counts.rejected_by.items() if number}


@pytest.mark.parametrize("vector", GOLDEN["vectors"], ids=lambda vector: vector["name"])
def test_a_message_and_its_golden_frame_are_one(vector: dict[str, Any]) -> None:
    message, frame = golden_message(vector), bytes.fromhex(vector["frame_hex"])
    assert handmade_frame(vector) == encode(message) == frame
    decoder = Decoder()
    assert decoder.feed(frame[:-1]) == []  # its delimiter ends it
    assert decoder.feed(frame[-1:]) == [message]


@pytest.mark.parametrize("rejected", GOLDEN["rejected"], ids=lambda frame: frame["name"])
def test_a_damaged_frame_is_rejected_for_its_reason_and_the_next_one_is_accepted(rejected: dict[str, str]) -> None:
    decoder = Decoder()
    assert decoder.feed(bytes.fromhex(rejected["frame_hex"]) + encode(Stop())) == [Stop()]
    assert reasons(decoder) == {Rejection(rejected["reason"]): 1}


def test_the_vectors_are_those_of_this_version_and_leave_nothing_out() -> None:
    assert (GOLDEN["protocol_version"], GOLDEN["schema_hash_hex"]) == (PROTOCOL_VERSION, f"{SCHEMA_HASH:08x}")
    assert bitwise_crc(messages.SCHEMA_TEXT.encode("ascii"), 0) == SCHEMA_HASH
    assert bitwise_crc(b"123456789", 0) == 0xCBF43926  # the published check value
    assert {frame["reason"] for frame in GOLDEN["rejected"]} == set(Rejection)
    assert {vector["message"] for vector in GOLDEN["vectors"]} == set(TYPE_AND_WIDTHS)
    assert max(len(vector["frame_hex"]) // 2 for vector in GOLDEN["vectors"]) == MAX_FRAME_BYTES


@pytest.mark.parametrize(
    ("stream", "expected", "rejected"),
    [
        (b"\0\0\0" + FRAME + b"\0", [READING], 0),  # empty frames do not count
        (FRAME[5:] + FRAME, [READING], 1),  # the line was opened during a frame
        (FRAME[:9] + b"\0" + encode(Stop()), [Stop()], 1),  # the device was reset during a frame
        (FRAME[:-1] + FRAME + encode(Stop()), [Stop()], 1),  # a delimiter was lost
        (FRAME[:-1] + 100 * b"\x55" + b"\0" + encode(Stop()), [Stop()], 1),  # an overlong frame that begins well
    ],
)
def test_what_lines_do_costs_the_frames_that_they_damage_and_no_more(
    stream: bytes, expected: list[Message], rejected: int
) -> None:
    decoder = Decoder()
    assert decoder.feed(stream) == expected
    assert (decoder.counts.frames, decoder.counts.rejected) == (len(expected), rejected)


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (dataclasses.replace(HELLO, boot_id=-1), "^boot_id must be a whole number from 0 to 4294967295, not -1$"),
        (
            dataclasses.replace(HELLO, max_rate_hz=2**16),
            "^max_rate_hz must be a whole number from 0 to 65535, not 65536$",
        ),
        (Identify(256), "^seconds must be a whole number from 0 to 255, not 256$"),
        (Reading(0, 0.5, 1, (1,)), r"^device_us .* not 0\.5"),  # type: ignore[arg-type]
        (Reading(0, 0, 1, (1, 2, 65536)), r"^counts\[2\] must be .* not 65536$"),
        (Reading(0, 0, 1, ()), "^counts must hold 1 to 32 values, not 0$"),
        (Reading(0, 0, 1, (0,) * 33), "^counts must hold 1 to 32 values, not 33$"),
    ],
)
def test_a_value_that_the_wire_cannot_carry_is_refused_by_name(message: Message, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        encode(message)


def test_only_the_same_version_and_schema_are_compatible() -> None:
    assert HELLO.is_compatible
    assert not dataclasses.replace(HELLO, protocol_version=PROTOCOL_VERSION + 1).is_compatible
    assert not dataclasses.replace(HELLO, schema_hash=SCHEMA_HASH ^ 1).is_compatible


pieces = st.lists(
    st.binary(max_size=100)
    | st.integers(70, 200).map(lambda length: b"\x55" * length)
    | st.integers(0, 2**32).map(lambda seed: encode(random_message(random.Random(seed)))),  # noqa: S311 - test data
    max_size=8,
)


@given(pieces, st.data())
def test_any_split_of_a_stream_gives_the_same_messages_and_the_same_counts(
    parts: list[bytes], data: st.DataObject
) -> None:
    stream = b"".join(parts)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=20)))
    at_once, in_chunks, by_bytes = Decoder(), Decoder(), Decoder()
    whole = at_once.feed(stream)
    chunks = zip([0, *cuts], [*cuts, len(stream)], strict=True)
    assert [message for begin, end in chunks for message in in_chunks.feed(stream[begin:end])] == whole
    assert [message for byte in stream for message in by_bytes.feed(bytes([byte]))] == whole
    assert at_once.counts == in_chunks.counts == by_bytes.counts


@pytest.mark.parametrize("rounds", [300, pytest.param(10_000, marks=pytest.mark.soak)])
def test_a_damaged_stream_loses_messages_but_never_changes_or_invents_one(rounds: int) -> None:
    chance, received_in_all = random.Random(2), 0  # noqa: S311 - noise, not secrets
    for round_ in range(rounds):
        sent: list[Message] = [Reading((round_ + n) % 65536, 500 * n, 1, (n, 0, 4095, 256 * n)) for n in range(6)]
        sent += [Start(1000, 1), Stop(), Hello(1, round_, round_, 4, 12, 1000)]
        stream, times = bytearray(b"".join(map(encode, sent))), chance.randint(1, 4)
        damage(chance, stream, times)
        decoder = Decoder()
        received = decoder.feed(bytes(stream))
        assert received == [message for message in sent if message in received]
        assert len(received) == decoder.counts.frames >= len(sent) - 3 * times  # damage touches three frames at most
        received_in_all += len(received)
    assert received_in_all > rounds * len(sent) // 2


@pytest.mark.parametrize("number", [60_000, pytest.param(5_000_000, marks=pytest.mark.soak)])
@pytest.mark.parametrize("part_of_zeros", [0.0, 0.02, 0.2])
def test_noise_gives_no_message_takes_no_memory_and_ends_at_the_next_delimiter(
    number: int, part_of_zeros: float
) -> None:
    chance, decoder = random.Random(1), Decoder()  # noqa: S311 - noise, not secrets
    for _ in range(number // 1000):
        assert decoder.feed(noise(chance, 1000, part_of_zeros)) == []
        assert len(decoder._frame) < MAX_FRAME_BYTES
    assert decoder.counts.frames == 0
    assert decoder.feed(b"\0" + FRAME) == [READING]


@pytest.mark.parametrize(
    ("previous", "current", "missing"),
    [(0, 1, 0), (41, 45, 3), (65535, 0, 0), (65530, 4, 9), (1, 0, 65534), (5, 5, 65535)],
)
def test_readings_lost_between_two_that_arrived(previous: int, current: int, missing: int) -> None:
    assert missing_between(previous, current) == missing


def test_a_clock_counts_on_over_its_wraps_and_follows_values_that_overtake_each_other() -> None:
    clock, wrap, half = DeviceClock(), 2**32, 2**31  # half a wrap is 35 minutes
    values = [wrap - 1000, wrap - 1, 999, wrap - 500, 1000, wrap // 2, wrap - 1, 5, half + 6, half + 4]
    expected = [
        wrap - 1000,
        wrap - 1,
        wrap + 999,
        wrap - 500,
        wrap + 1000,
        wrap + wrap // 2,
        2 * wrap - 1,
        2 * wrap + 5,
        2 * wrap + 5 - half + 1,
        2 * wrap + 5 + half - 1,
    ]
    assert [clock.follow(value) for value in values] == expected
