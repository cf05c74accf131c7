"""The C codec, under sanitizers, against the golden vectors and the Python codec; and its size on the chip."""

import random
import subprocess
from collections.abc import Callable, Iterable
from dataclasses import astuple
from pathlib import Path
from typing import Any

import pytest

from beamtouch_protocol.framing import MAX_FRAME_BYTES, Decoder, Rejection, encode
from beamtouch_protocol.messages import MESSAGE_TYPES, PROTOCOL_VERSION, SCHEMA_HASH, Message, Reading
from support.programs.toolchain import CODEC, made_once, need, run

from .codec_cases import GOLDEN, damage, golden_message, noise, random_message

WARNINGS = ("-Wall", "-Wextra", "-Werror", "-pedantic")
SANITIZERS = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
DEVICE_BYTES = 10
DEVICE = (f"-DBEAMTOUCH_MAX_FRAME_BYTES={DEVICE_BYTES}", "-DBEAMTOUCH_MAX_CHANNELS=8")
"""As a device has it, which receives no longer frames."""
MAX_FLASH_BYTES = 2048

Filter = Callable[[str, bytes], list[str]]
Decoded = tuple[list[Message], int, dict[Rejection, int]]
"""Messages, accepted frames, and rejected frames by reason."""


def compiled(folder: Path, *defines: str) -> None:
    sources = (Path(__file__).parent / "codec_filter.c", CODEC / "beamtouch_protocol.c")
    run("gcc", "-std=c99", *WARNINGS, *SANITIZERS, *defines, f"-I{CODEC}", *sources, "-o", folder / "codec_filter")


def filter_with(factory: pytest.TempPathFactory, name: str, *defines: str) -> Filter:
    need("gcc")
    program = made_once(factory, name, lambda folder: compiled(folder, *defines)) / "codec_filter"

    def lines(what: str, given: bytes) -> list[str]:
        done = subprocess.run([program, *what.split()], input=given, capture_output=True, timeout=60, check=False)
        assert done.returncode == 0, done.stderr.decode()
        return done.stdout.decode().splitlines()

    return lines


@pytest.fixture(scope="session")
def codec(tmp_path_factory: pytest.TempPathFactory) -> Filter:
    """The filter with the codec as built for a host."""
    return filter_with(tmp_path_factory, "codec")


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


def decoded(codec: Filter, stream: bytes) -> Decoded:
    *lines, last = codec("decode", stream)
    frames, *rejected = map(int, last.split())
    found = [from_numbers([int(word) for word in line.split()]) for line in lines]
    return found, frames, dict(zip(Rejection, rejected, strict=True))  # the filter counts them in this order


def decoded_by_python(stream: bytes) -> Decoded:
    decoder = Decoder()
    return decoder.feed(stream), decoder.counts.frames, decoder.counts.rejected_by


def test_the_constants_and_the_checksum_are_those_of_the_protocol(codec: Filter) -> None:
    assert codec("constants", b"") == [f"{PROTOCOL_VERSION} {SCHEMA_HASH} {MAX_FRAME_BYTES}"]
    for check in GOLDEN["crc_checks"]:
        seed = int(check["seed_hex"], 16)
        assert codec(f"crc {seed}", check["text"].encode()) == [str(int(check["crc_hex"], 16))]


def test_golden_messages_and_their_frames_are_one(codec: Filter) -> None:
    sent, frames = map(golden_message, GOLDEN["vectors"]), [vector["frame_hex"] for vector in GOLDEN["vectors"]]
    assert encoded(codec, messages := list(sent)) == frames
    assert decoded(codec, bytes.fromhex("".join(frames))) == (messages, len(frames), dict.fromkeys(Rejection, 0))


def test_damaged_golden_frames_are_rejected_for_their_reasons_and_the_frames_between_them_are_taken(
    codec: Filter,
) -> None:
    between = encode(golden_message(GOLDEN["vectors"][0]))
    damaged = b"".join(bytes.fromhex(frame["frame_hex"]) + between for frame in GOLDEN["rejected"])
    reasons = [frame["reason"] for frame in GOLDEN["rejected"]]
    _, frames, rejected = decoded(codec, damaged)
    assert frames == len(reasons)
    assert rejected == {reason: reasons.count(reason) for reason in Rejection}


@pytest.mark.parametrize("line", ["0", "18", "128", "255", "144 1 2 3", "144 1 2 3" + 33 * " 4"])
def test_what_is_no_message_makes_no_frame(codec: Filter, line: str) -> None:
    assert codec("encode", line.encode() + b"\n") == [""]


def test_random_messages_whole_damaged_and_in_noise_go_through_both_codecs_alike(codec: Filter) -> None:
    chance = random.Random(3)  # noqa: S311 - test data, not secrets
    sent = [random_message(chance) for _ in range(3000)]
    frames = [encode(message) for message in sent]
    assert encoded(codec, sent) == [frame.hex() for frame in frames]
    assert decoded(codec, b"".join(frames))[0] == sent
    frames += [bytes.fromhex(frame["frame_hex"]) for frame in 20 * GOLDEN["rejected"]]
    chance.shuffle(frames)
    stream = bytearray(b"".join(frames))
    damage(chance, stream, len(stream) // 50)
    ours = decoded(codec, bytes(stream))
    assert ours == decoded_by_python(bytes(stream))
    assert ours[1] > 500
    assert min(ours[2].values()) > 10  # every reason has occurred
    for part_of_zeros in (0.0, 0.01, 0.1, 0.5):
        garbage = noise(chance, 20_000, part_of_zeros)
        assert decoded(codec, garbage) == decoded_by_python(garbage)


def test_a_device_accepts_all_messages_to_it_and_drops_longer_ones(tmp_path_factory: pytest.TempPathFactory) -> None:
    messages = [golden_message(vector) for vector in GOLDEN["vectors"]]
    to_device = [message for message in messages if message.TYPE < 0x80]
    longer = [message for message in messages if len(encode(message)) > DEVICE_BYTES][: len(to_device)]
    stream = b"".join(encode(message) for pair in zip(to_device, longer, strict=True) for message in pair)
    found, _, rejected = decoded(filter_with(tmp_path_factory, "device-codec", *DEVICE), stream)
    assert found == to_device
    assert rejected == dict.fromkeys(Rejection, 0) | {Rejection.OVERLONG: len(longer)}


def test_a_reading_of_more_channels_than_the_codec_was_built_for_is_refused(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """There is no room for its counts, though there is for its frame."""
    few = filter_with(tmp_path_factory, "few-channels", "-DBEAMTOUCH_MAX_CHANNELS=4", "-DBEAMTOUCH_MAX_FRAME_BYTES=78")
    sent = [Reading(number, 0, 1, (1,) * channels) for number, channels in enumerate((4, 5, 32, 4))]
    found, _, rejected = decoded(few, b"".join(map(encode, sent)))
    assert found == [sent[0], sent[3]]
    assert rejected == dict.fromkeys(Rejection, 0) | {Rejection.LENGTH: 2}


@pytest.mark.parametrize("defines", [(), DEVICE])
def test_the_codec_with_all_messages_takes_less_than_2_kb_of_flash(tmp_path: Path, defines: tuple[str, ...]) -> None:
    need("avr-gcc", "avr-size")
    target = tmp_path / "codec.o"
    source = CODEC / "beamtouch_protocol.c"
    run("avr-gcc", "-std=c99", *WARNINGS, "-Os", "-mmcu=atmega328p", *defines, "-c", source, "-o", target)
    text, data, bss = map(int, run("avr-size", target).splitlines()[1].split()[:3])
    assert text + data < MAX_FLASH_BYTES
    assert data + bss == 0


def test_an_arduino_sketch_in_cpp_can_include_the_codec(tmp_path: Path) -> None:
    need("avr-g++")
    sketch, target = tmp_path / "sketch.cpp", tmp_path / "sketch.o"
    sketch.write_text(
        '#include "beamtouch_protocol.h"\nbeamtouch_decoder decoder;\n'
        "bool take(uint8_t byte, beamtouch_message &m) { return beamtouch_decode(&decoder, byte, &m); }\n"
    )
    run("avr-g++", "-Wall", "-Wextra", "-Werror", "-mmcu=atmega328p", f"-I{CODEC}", "-c", sketch, "-o", target)
    assert " U beamtouch_decode\n" in run("avr-nm", target)
