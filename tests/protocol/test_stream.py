"""Properties of the decoder for any chunks and any damage of a stream."""

import random
from collections.abc import Iterable

from hypothesis import given
from hypothesis import strategies as st

from beamtouch_protocol.framing import MAX_FRAME_BYTES, Decoder, encode
from beamtouch_protocol.messages import MESSAGE_TYPES, Hello, Message, Reading, Start, Stop

any_message = st.one_of([st.from_type(message) for message in MESSAGE_TYPES.values()])
messages = st.lists(any_message, max_size=8)
overlong = st.integers(70, 200).map(lambda length: b"\x55" * length)
pieces = st.lists(st.binary(max_size=100) | overlong | any_message.map(encode), max_size=8)


def decode(chunks: Iterable[bytes]) -> tuple[list[Message], Decoder]:
    decoder = Decoder()
    received = [message for chunk in chunks for message in decoder.feed(chunk)]
    return received, decoder


@given(messages)
def test_every_message_sent_arrives(sent: list[Message]) -> None:
    received, decoder = decode([b"".join(map(encode, sent))])
    assert received == sent
    assert decoder.counts.rejected == 0


@given(pieces, st.data())
def test_any_split_of_a_stream_gives_the_same_messages_and_the_same_counts(
    parts: list[bytes], data: st.DataObject
) -> None:
    stream = b"".join(parts)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=20)))
    chunks = [stream[begin:end] for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    whole, at_once = decode([stream])
    split, in_chunks = decode(chunks)
    single, by_bytes = decode(bytes([byte]) for byte in stream)
    assert whole == split == single
    assert at_once.counts == in_chunks.counts == by_bytes.counts


@given(st.binary(max_size=300), any_message)
def test_after_any_garbage_the_decoder_resynchronises_at_the_next_delimiter(garbage: bytes, message: Message) -> None:
    received, _ = decode([garbage, b"\0", encode(message)])
    assert received == [message]


def test_random_bytes_neither_raise_nor_decode_to_a_message() -> None:
    generator = random.Random(1)  # noqa: S311 - noise, not secrets
    for chance_of_zero in (0.0, 0.01, 0.1, 0.5):
        noise = bytes(0 if generator.random() < chance_of_zero else generator.randrange(256) for _ in range(100_000))
        received, decoder = decode(noise[begin : begin + 64] for begin in range(0, len(noise), 64))
        assert received == []
        assert decoder.counts.frames == 0
        assert len(decoder._frame) < MAX_FRAME_BYTES


def damage(generator: random.Random, stream: bytearray) -> None:
    """Damage a stream once as lines do: flip a bit, or change, lose or insert bytes."""
    place = generator.randrange(len(stream))
    match generator.randrange(4):
        case 0:
            stream[place] ^= 1 << generator.randrange(8)
        case 1:
            stream[place] = generator.choice([0, 1, 255, generator.randrange(256)])
        case 2:
            del stream[place : place + generator.randint(1, 5)]
        case _:
            stream[place:place] = generator.randbytes(generator.randint(1, 5))


def test_a_damaged_stream_loses_messages_but_never_changes_or_invents_one() -> None:
    generator = random.Random(2)  # noqa: S311 - noise, not secrets
    received_in_all = 0
    for round_ in range(1500):
        sent: list[Message] = [Reading((round_ + n) % 65536, 500 * n, 1, (n, 0, 4095, 256 * n)) for n in range(6)]
        sent += [Start(1000, 1), Stop(), Hello(1, round_, round_, 4, 12, 1000)]
        stream = bytearray(b"".join(map(encode, sent)))
        damages = generator.randint(1, 4)
        for _ in range(damages):
            damage(generator, stream)
        received, decoder = decode([bytes(stream)])
        assert set(received) <= set(sent)
        assert received == [message for message in sent if message in received]
        assert len(received) == decoder.counts.frames
        assert (
            len(received) >= len(sent) - 3 * damages
        )  # up to five bytes lost or changed touch two frames, rarely three
        received_in_all += len(received)
    assert received_in_all > 1500 * 9 // 2
