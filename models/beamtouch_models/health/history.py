"""Sums of contacts over time: single contacts while they are new, and ever longer blocks when they are old."""

from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.arrays import Floats

NEW = 64
"""Number of newest contacts that are kept apart."""
RESOLUTION = 8
"""An old block holds at most one in this many of the contacts after it; the time of a change is known as closely."""


@dataclass(frozen=True)
class Block:
    """Sums over contacts. Weights are inverse variances."""

    first_us: int
    """Time of the first contact [us since 1970]."""
    contacts: int
    information: Floats
    """(channels, channels) of the gains."""
    score: Floats
    """(channels,) information times gains."""
    rest_weight: Floats
    """(channels,) 1/mm^2; 0 where no rest was seen."""
    rest_sum: Floats
    """(channels,) weight times deflection at rest, 1/mm."""

    def __add__(self, other: "Block") -> "Block":
        sums = (getattr(self, name) + getattr(other, name) for name in _SUMS)
        return Block(min(self.first_us, other.first_us), self.contacts + other.contacts, *sums)


_SUMS = [field.name for field in fields(Block)][2:]


class History:
    """Blocks in the order of time."""

    def __init__(self, channels: int, blocks: list[Block] | None = None) -> None:
        self.channels = channels
        self.blocks = list(blocks or [])

    def add(self, block: Block, boundaries: set[int]) -> None:
        """Add a contact; `boundaries` are first times of blocks that never become part of the block before."""
        place = len(self.blocks)
        while place and self.blocks[place - 1].first_us > block.first_us:
            place -= 1
        self.blocks.insert(place, block)
        if len(self.blocks) > NEW:
            self.blocks = _merged(self.blocks, boundaries)

    @property
    def contacts(self) -> int:
        """Number of contacts."""
        return sum(block.contacts for block in self.blocks)

    def after(self) -> Floats:
        """Return the number of contacts from each block on, (blocks,)."""
        counts: Floats = np.array([block.contacts for block in self.blocks], np.float64)[::-1].cumsum()[::-1]
        return counts

    def since(self, name: str) -> Floats:
        """Return a sum of `Block` from each block on, (blocks, ...); there is at least one block."""
        each = np.array([getattr(block, name) for block in self.blocks])
        sums: Floats = each[::-1].cumsum(axis=0)[::-1]
        return sums

    def to_json(self) -> list[list[Any]]:
        """Return the blocks as JSON values."""
        sums = [[getattr(block, name).tolist() for name in _SUMS] for block in self.blocks]
        return [[block.first_us, block.contacts, *one] for block, one in zip(self.blocks, sums, strict=True)]

    @classmethod
    def from_json(cls, channels: int, rows: list[list[Any]]) -> Self:
        """Return a history from JSON values; raises ValueError if they have another number of channels."""
        shapes: list[tuple[int, ...]] = [(channels, channels), (channels,), (channels,), (channels,)]
        blocks = []
        for first_us, contacts, *values in rows:
            sums: list[NDArray[np.float64]] = [np.array(value, np.float64) for value in values]
            if [one.shape for one in sums] != shapes:
                raise ValueError("the history is that of another layout")
            blocks.append(Block(int(first_us), int(contacts), *sums))
        return cls(channels, blocks)


def _merged(blocks: list[Block], boundaries: set[int]) -> list[Block]:
    """Return the blocks with pairs of old ones merged."""
    after = sum(block.contacts for block in blocks)
    found: list[Block] = []
    for index, block in enumerate(blocks):
        after -= block.contacts
        is_old = index < len(blocks) - NEW and block.first_us not in boundaries
        if is_old and found and (found[-1].contacts + block.contacts) * RESOLUTION <= after:
            found[-1] = found[-1] + block
        else:
            found.append(block)
    return found
