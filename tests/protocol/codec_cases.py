"""Frames and streams for the codecs in Python and in C: golden ones, random ones, damaged ones."""

import json
import random
from typing import Any

from beamtouch_protocol import messages as kinds
from beamtouch_protocol.messages import Hello, Identify, Message, Ping, Pong, Reading, Start, Stop
from support.programs.toolchain import FIRMWARE_PROTOCOL

GOLDEN: dict[str, Any] = json.loads((FIRMWARE_PROTOCOL / "golden_vectors.json").read_text())


def golden_message(vector: dict[str, Any]) -> Message:
    """Return the message of a golden vector."""
    fields = {name: tuple(value) if isinstance(value, list) else value for name, value in vector["fields"].items()}
    message: Message = getattr(kinds, vector["message"])(**fields)
    return message


def random_message(chance: random.Random) -> Message:
    """Return any message, often with the smallest and largest values of a byte in its fields."""

    def number(bits: int) -> int:
        return chance.choice([0, 1, 255, 256, chance.getrandbits(bits)]) % (1 << bits)

    counts = tuple(number(16) for _ in range(chance.randint(1, 32)))
    messages: list[Message] = [
        Reading(number(16), number(32), number(8), counts),
        Hello(number(8), number(32), number(32), number(8), number(8), number(16)),
        Pong(number(16), number(32)),
        Ping(number(16)),
        Identify(number(8)),
        Start(number(16), number(8)),
        Stop(),
    ]
    return chance.choice(messages)


def damage(chance: random.Random, stream: bytearray, times: int) -> None:
    """Damage a stream as lines do: flip a bit; change, lose or insert bytes."""
    for _ in range(times):
        place = chance.randrange(len(stream))
        match chance.randrange(4):
            case 0:
                stream[place] ^= 1 << chance.randrange(8)
            case 1:
                stream[place] = chance.choice([0, 1, 255, chance.randrange(256)])
            case 2:
                del stream[place : place + chance.randint(1, 5)]
            case _:
                stream[place:place] = chance.randbytes(chance.choice([1, 5, 80]))


def noise(chance: random.Random, number: int, part_of_zeros: float) -> bytes:
    """Return random bytes, of which a part are delimiters."""
    return bytes(0 if chance.random() < part_of_zeros else chance.randrange(256) for _ in range(number))
