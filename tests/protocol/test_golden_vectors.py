"""The golden vectors against the package, and both against an independent encoder in this file.

The independent encoder uses neither zlib nor cobs nor the package, so a number on which both agree is right.
"""

import json
from pathlib import Path
from typing import Any

import pytest

from beamtouch_protocol import messages
from beamtouch_protocol.framing import Decoder, Rejection, encode
from beamtouch_protocol.messages import PROTOCOL_VERSION, SCHEMA_HASH, Message, Stop

GOLDEN = json.loads((Path(__file__).parents[2] / "firmware_protocol" / "golden_vectors.json").read_text())
VECTORS = [pytest.param(vector, id=vector["name"]) for vector in GOLDEN["vectors"]]
REJECTED = [pytest.param(frame, id=frame["name"]) for frame in GOLDEN["rejected"]]

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


def bitwise_crc(data: bytes, seed: int) -> int:
    register = seed ^ 0xFFFFFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = (register >> 1) ^ (0xEDB88320 if register & 1 else 0)
    return register ^ 0xFFFFFFFF


def handmade_cobs(content: bytes) -> bytes:
    assert len(content) < 254
    return b"".join(bytes([len(piece) + 1]) + piece for piece in content.split(b"\0"))


def handmade_body(message: str, fields: dict[str, Any]) -> bytes:
    number, widths = TYPE_AND_WIDTHS[message]
    body = [number]
    for value, width in zip(fields.values(), widths, strict=True):
        for item in value if isinstance(value, list) else [value]:
            body += [item >> 8 * place & 0xFF for place in range(width)]
    return bytes(body)


def as_message(vector: dict[str, Any]) -> Message:
    fields = {name: tuple(value) if isinstance(value, list) else value for name, value in vector["fields"].items()}
    message: Message = getattr(messages, vector["message"])(**fields)
    return message


@pytest.mark.parametrize("vector", VECTORS)
def test_a_message_encodes_to_its_golden_frame(vector: dict[str, Any]) -> None:
    message = as_message(vector)
    assert (bytes([message.TYPE]) + message.to_bytes()).hex() == vector["body_hex"]
    assert encode(message).hex() == vector["frame_hex"]


@pytest.mark.parametrize("vector", VECTORS)
def test_a_golden_frame_decodes_to_its_message(vector: dict[str, Any]) -> None:
    assert Decoder().feed(bytes.fromhex(vector["frame_hex"])) == [as_message(vector)]


@pytest.mark.parametrize("vector", VECTORS)
def test_an_encoder_written_by_hand_gives_the_same_frame(vector: dict[str, Any]) -> None:
    body = handmade_body(vector["message"], vector["fields"])
    seed = 0 if vector["message"] in {"Hello", "HelloRequest"} else int(GOLDEN["schema_hash_hex"], 16)
    frame = handmade_cobs(body + bitwise_crc(body, seed).to_bytes(4, "little")) + b"\0"
    assert body.hex() == vector["body_hex"]
    assert frame.hex() == vector["frame_hex"]


@pytest.mark.parametrize("rejected", REJECTED)
def test_a_damaged_frame_is_rejected_for_its_reason_and_the_next_one_is_accepted(rejected: dict[str, str]) -> None:
    decoder = Decoder()
    assert decoder.feed(bytes.fromhex(rejected["frame_hex"])) == []
    assert {reason for reason, number in decoder.counts.rejected_by.items() if number} == {rejected["reason"]}
    assert decoder.counts.rejected == 1
    assert decoder.feed(encode(Stop())) == [Stop()]


def test_every_reason_and_every_message_has_a_golden_frame() -> None:
    assert {frame["reason"] for frame in GOLDEN["rejected"]} == set(Rejection)
    assert {vector["message"] for vector in GOLDEN["vectors"]} == set(TYPE_AND_WIDTHS)


@pytest.mark.parametrize("check", GOLDEN["crc_checks"])
def test_the_checksum_has_its_published_check_value(check: dict[str, str]) -> None:
    assert bitwise_crc(check["text"].encode(), int(check["seed_hex"], 16)) == int(check["crc_hex"], 16)


def test_the_vectors_are_those_of_this_version() -> None:
    assert GOLDEN["protocol_version"] == PROTOCOL_VERSION
    assert GOLDEN["schema_hash_hex"] == f"{SCHEMA_HASH:08x}"
    assert [check["crc_hex"] for check in GOLDEN["crc_checks"] if check["seed_hex"] == "00000000"] == ["cbf43926"]
    assert bitwise_crc(messages.SCHEMA_TEXT.encode("ascii"), 0) == SCHEMA_HASH
