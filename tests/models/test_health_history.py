"""The history of the sensors of a surface, in few blocks."""

import numpy as np
import pytest

from beamtouch_models.runtime.health.changes import RESOLUTION, Block, History


def _block(number: int, channels: int) -> Block:
    return Block(number, 1, np.eye(channels), np.ones(channels), np.ones(channels), np.zeros(channels))


def test_a_long_history_takes_few_blocks_and_loses_nothing() -> None:
    history = History(2)
    for number in range(5_000):
        history.add(_block(number, 2), set())
    assert len(history.blocks) < 250
    assert history.contacts == 5_000
    assert history.since("score")[0] == pytest.approx([5_000.0] * 2)
    later = history.after()
    for block, rest in zip(history.blocks, later, strict=True):
        assert block.contacts == 1 or block.contacts * RESOLUTION <= rest
    # A late contact has its place in time.
    history.add(_block(4_990, 2), set())
    assert [block.first_us for block in history.blocks] == sorted(block.first_us for block in history.blocks)
