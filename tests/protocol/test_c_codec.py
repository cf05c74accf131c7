"""The C codec, under sanitizers, against the golden vectors and against the Python codec."""

import json
import random
import subprocess
from collections.abc import Callable, Iterable
from dataclasses import astuple
from pathlib import Path
from typing import Any

import pytest

from beamtouch_protocol import messages
from beamtouch_protocol.framing import MAX_FRAME_BYTES, Decoder, Rejection, encode
from beamtouch_protocol.messages import (
    MESSAGE_TYPES,
    PROTOCOL_VERSION,
    SCHEMA_HASH,
    Hello,
    Identify,
    Message,
    Ping,
    Pong,
    Reading,
    Start,
    Stop,
)
from toolchain import CODEC, FIRMWARE_PROTOCOL, made_once, need, run

GOLDEN = json.loads((FIRMWARE_PROTOCOL / "golden_vectors.json").read_text())
REASONS = list(Rejection)
"""In the order in which the filter counts them."""
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
SANITIZERS = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
DEVICE = ("-DBEAMTOUCH_MAX_FRAME_BYTES=10", "-DBEAMTOUCH_MAX_CHANNELS=8")
DEVICE_BYTES = 10

Filter = Callable[[str, bytes], list[str]]


def compiled_filter(folder: Path, *defines: str) -> None:
    sources = (Path(__file__).parent / "codec_filter.c", CODEC / "beamtouch_protocol.c")
    run("gcc", *WARNINGS, *SANITIZERS, *defines, f"-I{CODEC}", *sources, "-o", folder / "codec_filter")


def filter_in(folder: Path) -> Filter:
    def lines(what: str, given: bytes) -> list[str]:
        command = [str(folder / "codec_filter"), *what.split()]
        done = subprocess.run(command, input=given, capture_output=True, timeout=60, check=False)
        assert done.returncode == 0, done.stderr.decode()
        return done.stdout.decode().splitlines()

    return lines


@pytest.fixture(scope="session")
def codec(tmp_path_factory: pytest.TempPathFactory) -> Filter:
    """The filter with the codec as built for a host."""
    need("gcc")
    return filter_in(made_once(tmp_path_factory, "codec", compiled_filter))


@pytest.fixture(scope="session")
def device_codec(tmp_path_factory: pytest.TempPathFactory) -> Filter:
    """The filter with the codec as built for a device: frames of ten bytes at most."""
    need("gcc")
    return filter_in(made_once(tmp_path_factory, "device-codec", lambda folder: compiled_filter(folder, *DEVICE)))


def numbers(message: Message) -> list[int]:
    flat: list[int] = [message.TYPE]
    for value in astuple(message):
        flat += value if isinstance(value, tuple) else [value]
    return flat


def from_numbers(flat: list[int]) -> Message:
    number, *values = flat
    if number == Reading.TYPE:
        return Reading(values[0], values[1], values[2], tuple(values[3:]))
    maker: Any = MESSAGE_TYPES[number]
    message: Message = maker(*values)
    return message


def encoded(codec: Filter, sent: Iterable[Message]) -> list[str]:
    text = "".join(" ".join(map(str, numbers(message))) + "\n" for message in sent)
    return codec("encode", text.encode())


def decoded(codec: Filter, stream: bytes) -> tuple[list[Message], int, dict[Rejection, int]]:
    """Return the messages in a stream, the number of accepted frames, and the number of rejected frames by reason."""
    *lines, last = codec("decode", stream)
    frames, *rejected = map(int, last.split())
    found = [from_numbers([int(word) for word in line.split()]) for line in lines]
    return found, frames, dict(zip(REASONS, rejected, strict=True))


def decoded_by_python(stream: bytes) -> tuple[list[Message], int, dict[Rejection, int]]:
    decoder = Decoder()
    return decoder.feed(stream), decoder.counts.frames, decoder.counts.rejected_by


def golden_messages() -> list[Message]:
    found: list[Message] = []
    for vector in GOLDEN["vectors"]:
        fields: dict[str, Any] = vector["fields"]
        values = {name: tuple(value) if isinstance(value, list) else value for name, value in fields.items()}
        found.append(getattr(messages, vector["message"])(**values))
    return found


def test_the_constants_are_those_of_the_protocol(codec: Filter) -> None:
    assert codec("constants", b"") == [f"{PROTOCOL_VERSION} {SCHEMA_HASH} {MAX_FRAME_BYTES}"]


@pytest.mark.parametrize("check", GOLDEN["crc_checks"])
def test_the_checksum_has_the_published_check_value(codec: Filter, check: dict[str, str]) -> None:
    seed = int(check["seed_hex"], 16)
    assert codec(f"crc {seed}", check["text"].encode()) == [str(int(check["crc_hex"], 16))]


def test_every_golden_message_encodes_to_its_frame(codec: Filter) -> None:
    assert encoded(codec, golden_messages()) == [vector["frame_hex"] for vector in GOLDEN["vectors"]]


def test_every_golden_frame_decodes_to_its_message(codec: Filter) -> None:
    stream = b"".join(bytes.fromhex(vector["frame_hex"]) for vector in GOLDEN["vectors"])
    found, frames, rejected = decoded(codec, stream)
    assert found == golden_messages()
    assert frames == len(found)
    assert not any(rejected.values())


@pytest.mark.parametrize("damaged", [pytest.param(frame, id=frame["name"]) for frame in GOLDEN["rejected"]])
def test_a_damaged_frame_is_rejected_for_its_reason_and_the_next_one_is_taken(
    codec: Filter, damaged: dict[str, str]
) -> None:
    found, frames, rejected = decoded(codec, bytes.fromhex(damaged["frame_hex"]) + encode(Stop()))
    assert (found, frames) == ([Stop()], 1)
    assert {reason: number for reason, number in rejected.items() if number} == {Rejection(damaged["reason"]): 1}


@pytest.mark.parametrize("line", ["0", "18", "128", "255", "144 1 2 3", "144 1 2 3" + 33 * " 4"])
def test_what_is_no_message_makes_no_frame(codec: Filter, line: str) -> None:
    assert codec("encode", line.encode() + b"\n") == [""]


def random_message(generator: random.Random) -> Message:
    def number(bits: int) -> int:
        return generator.choice([0, 1, 255, 256, generator.getrandbits(bits)]) % (1 << bits)

    match generator.randrange(6):
        case 0:
            return Reading(
                number(16), number(32), number(8), tuple(number(16) for _ in range(generator.randint(1, 32)))
            )
        case 1:
            return Hello(number(8), number(32), number(32), number(8), number(8), number(16))
        case 2:
            return Pong(number(16), number(32))
        case 3:
            return Ping(number(16))
        case 4:
            return Identify(number(8))
        case _:
            return Start(number(16), number(8))


def damaged(generator: random.Random, stream: bytearray) -> bytes:
    """Damage a stream as lines do, many times: flip bits; change, lose, repeat and insert bytes."""
    for _ in range(len(stream) // 50):
        place = generator.randrange(len(stream))
        match generator.randrange(4):
            case 0:
                stream[place] ^= 1 << generator.randrange(8)
            case 1:
                stream[place] = generator.choice([0, 1, 255])
            case 2:
                del stream[place : place + generator.randint(1, 5)]
            case _:
                stream[place:place] = generator.randbytes(generator.choice([1, 5, 80]))
    return bytes(stream)


def test_random_messages_go_through_both_codecs_alike(codec: Filter) -> None:
    generator = random.Random(3)  # noqa: S311 - test data, not secrets
    sent = [random_message(generator) for _ in range(5000)]
    assert encoded(codec, sent) == [encode(message).hex() for message in sent]
    assert decoded(codec, b"".join(map(encode, sent)))[0] == sent


def test_a_damaged_stream_gives_the_same_messages_and_the_same_counts_in_both(codec: Filter) -> None:
    generator = random.Random(4)  # noqa: S311 - noise, not secrets
    frames = [encode(random_message(generator)) for _ in range(5000)]
    frames += [bytes.fromhex(frame["frame_hex"]) for frame in 20 * GOLDEN["rejected"]]
    generator.shuffle(frames)
    stream = damaged(generator, bytearray(b"".join(frames)))
    ours = decoded(codec, stream)
    assert ours == decoded_by_python(stream)
    assert ours[1] > 500
    assert min(ours[2].values()) > 10  # every reason has occurred


@pytest.mark.parametrize("chance_of_zero", [0.0, 0.01, 0.1, 0.5])
def test_noise_gives_the_same_counts_in_both(codec: Filter, chance_of_zero: float) -> None:
    generator = random.Random(5)  # noqa: S311 - noise, not secrets
    noise = bytes(0 if generator.random() < chance_of_zero else generator.randrange(256) for _ in range(100_000))
    assert decoded(codec, noise) == decoded_by_python(noise)


def test_a_ten_byte_decoder_accepts_all_messages_to_a_device_and_drops_longer_ones(device_codec: Filter) -> None:
    to_device = [message for message in golden_messages() if message.TYPE < 0x80]
    longer = [message for message in golden_messages() if len(encode(message)) > DEVICE_BYTES]
    stream = b"".join(encode(message) for pair in zip(to_device, longer, strict=False) for message in pair)
    found, _, rejected = decoded(device_codec, stream)
    expected = to_device[: len(longer)]
    assert found == expected
    assert {reason: number for reason, number in rejected.items() if number} == {Rejection.OVERLONG: len(expected)}
