"""The decoder over ten million random and mutated bytes: never an exception, never a frame that was not sent."""

import numpy as np
import pytest

from beamtouch_protocol.framing import MAX_FRAME_BYTES, Decoder, encode
from beamtouch_protocol.messages import Message, Reading, Stop

BYTES = 5_000_000
CHUNK = 4096
FRAMES = 5000


def decode(stream: bytes) -> tuple[list[Message], Decoder]:
    decoder, found = Decoder(), list[Message]()
    for begin in range(0, len(stream), CHUNK):
        found += decoder.feed(stream[begin : begin + CHUNK])
        assert len(decoder._frame) < MAX_FRAME_BYTES
    return found, decoder


@pytest.mark.parametrize("part_of_zeros", [0.0, 0.02, 0.2])
def test_random_bytes_decode_to_nothing_and_the_next_frame_is_accepted(part_of_zeros: float) -> None:
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 256, BYTES // 3, dtype=np.uint8)
    noise[rng.random(len(noise)) < part_of_zeros] = 0
    found, decoder = decode(noise.tobytes())
    assert found == []
    assert decoder.counts.frames == 0
    assert part_of_zeros == 0 or decoder.counts.rejected > 1000
    assert decoder.feed(b"\0" + encode(Stop())) == [Stop()]


def test_mutated_frames_decode_only_to_sent_messages_in_their_order() -> None:
    rng = np.random.default_rng(2)
    sent = [
        Reading(number % 65536, 500 * number, 1, tuple(int(c) for c in rng.integers(0, 4096, 8)))
        for number in range(FRAMES)
    ]
    clean = [encode(message) for message in sent]
    numbers: dict[Message, int] = {message: number for number, message in enumerate(sent)}
    length, received = 0, 0
    while length < BYTES:
        stream = np.frombuffer(b"".join(clean), np.uint8).copy()
        hit = rng.random(len(stream)) < 10 ** rng.uniform(-4, -1.5)
        stream[hit] ^= rng.integers(1, 256, hit.sum(), dtype=np.uint8)
        stream = np.delete(stream, np.flatnonzero(rng.random(len(stream)) < 1e-4))
        found, decoder = decode(stream.tobytes())
        order = [numbers[message] for message in found]  # KeyError for a message that was not sent
        assert order == sorted(set(order))
        assert decoder.counts.frames == len(found)
        # An unchanged frame is lost only if one of its bytes was deleted or the frame before it lost its delimiter.
        whole = FRAMES - int(np.unique(np.flatnonzero(hit) // (len(stream) // FRAMES)).size)
        assert len(found) >= 0.5 * whole
        length, received = length + len(stream), received + len(found)
    assert received > FRAMES
