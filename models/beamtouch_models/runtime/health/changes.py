"""Contacts over time, and the changes of channels that they show: a likelihood ratio for each channel and time.

Contacts are kept as sums: single ones while they are new, and ever longer blocks when they are old.

Gains show in contacts, zeros at rest before them: no gain moves these. The gain errors g of the beginning have the
floor of the model as their prior. A change adds one unknown to the gain of a channel, from some block on. It is fitted
together with all others, so its likelihood ratio counts only what neither the other channels' first errors nor earlier
changes explain.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.runtime.error_model import NORMAL_975

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
        values = np.array([getattr(block, name) for block in self.blocks])
        sums: Floats = values[::-1].cumsum(axis=0)[::-1]
        return sums

    def to_json(self) -> list[list[Any]]:
        """Return the blocks as JSON values."""
        sums = [[getattr(block, name).tolist() for name in _SUMS] for block in self.blocks]
        return [[block.first_us, block.contacts, *totals] for block, totals in zip(self.blocks, sums, strict=True)]

    @classmethod
    def from_json(cls, channels: int, rows: list[list[Any]]) -> Self:
        """Return a history from JSON values; raises ValueError if they have another number of channels."""
        shapes: list[tuple[int, ...]] = [(channels, channels), (channels,), (channels,), (channels,)]
        blocks = []
        for first_us, contacts, *values in rows:
            sums: list[NDArray[np.float64]] = [np.array(value, np.float64) for value in values]
            if [array.shape for array in sums] != shapes:
                raise ValueError("the history is that of another layout")
            blocks.append(Block(int(first_us), int(contacts), *sums))
        return cls(channels, blocks)


def _merged(blocks: list[Block], boundaries: set[int]) -> list[Block]:
    """Return the blocks with pairs of old ones merged."""
    after = sum(block.contacts for block in blocks)
    merged: list[Block] = []
    for index, block in enumerate(blocks):
        after -= block.contacts
        is_old = index < len(blocks) - NEW and block.first_us not in boundaries
        if is_old and merged and (merged[-1].contacts + block.contacts) * RESOLUTION <= after:
            merged[-1] = merged[-1] + block
        else:
            merged.append(block)
    return merged


CERTAIN = 27.0
"""Twice the logarithm of the likelihood ratio that names a change of one of four gains: one false name in 1e6 contacts
(measured: docs/figures.md). Of more channels, one is the more often wrong by chance."""
APART = 7.0
"""The ratio of a channel that is named exceeds that of every other channel by this much: odds of 30."""
MIN_CONTACTS = 3
"""Fewest contacts since a change that is named, of a gain or a zero."""
NEAR = 2.0
"""Times of a change whose ratios differ by less than this are about as likely."""
GAIN_CHANGE = 0.5
"""Standard deviation of the prior of a change of a gain; it bounds intervals of channels of which nothing is seen."""
EXACT = 1e-4
"""Smallest standard deviation of the gain errors of the beginning; a scene may state none."""


@dataclass(frozen=True)
class Estimate:
    """A change with its 95 % interval."""

    value: float
    low: float
    high: float
    changed: bool
    """True if the change is certain."""

    @classmethod
    def of(cls, value: float, deviation: float, *, changed: bool) -> Self:
        """Return a change with its interval, from its standard deviation."""
        return cls(value, value - NORMAL_975 * deviation, value + NORMAL_975 * deviation, changed)


@dataclass(frozen=True)
class Change:
    """A change of one channel."""

    block: int
    """The first block with it."""
    channel: int


@dataclass(frozen=True)
class ChangeCandidates:
    """Changes of the gain of each channel from each block on, (blocks, channels)."""

    ratio: Floats
    """Twice the logarithm of the likelihood ratio to no change."""
    gain: Floats
    """Most likely change."""
    information: Floats
    """One over its variance."""


class Gains:
    """The gains of a history under some changes."""

    def __init__(self, history: History, floor: Floats, changes: Sequence[Change]) -> None:
        """Fit them; `floor` (channels,) is the standard deviation of the gain errors of the beginning."""
        self._changes, self._channels = changes, len(floor)
        empty = not history.blocks
        self._information = np.zeros((1, len(floor), len(floor))) if empty else history.since("information")
        self._score = np.zeros((1, len(floor))) if empty else history.since("score")
        size = len(floor) + len(changes)
        total = np.diag(np.concatenate([1 / np.maximum(floor, EXACT) ** 2, np.full(len(changes), GAIN_CHANGE**-2)]))
        total[: len(floor), : len(floor)] += self._information[0]
        score = np.concatenate([self._score[0], np.zeros(len(changes))])
        for place, change in enumerate(changes, len(floor)):
            column = self._column(np.array([change.block]), change.channel)[0]
            total[place, : len(floor)] = total[: len(floor), place] = column[: len(floor)]
            total[place, len(floor) :] += column[len(floor) :]
            score[place] = self._score[change.block, change.channel]
        self._covariance: Floats = np.linalg.inv(total)
        self._means = self._covariance @ score
        self._picked = np.eye(len(floor), size)
        for place, change in enumerate(changes, len(floor)):
            self._picked[change.channel, place] = 1

    def _column(self, blocks: Indices, channel: int) -> Floats:
        """Return the information that a channel's change from each block on shares with each unknown."""
        own = self._information[blocks][:, :, channel]
        later = [
            self._information[np.maximum(blocks, change.block)][:, change.channel, channel] for change in self._changes
        ]
        return np.column_stack([own, *later])

    def now(self) -> tuple[Floats, Floats]:
        """Return the newest gain errors (channels,) and their covariance."""
        return self._picked @ self._means, self._picked @ self._covariance @ self._picked.T

    def changed(self, channel: int) -> tuple[float, float]:
        """Return the sum of the changes of a channel and its standard deviation."""
        picked = self._picked[channel].copy()
        picked[: self._channels] = 0.0
        return float(picked @ self._means), float(np.sqrt(picked @ self._covariance @ picked))

    def candidates(self) -> ChangeCandidates:
        """Return what one more change would be worth."""
        blocks = np.arange(len(self._information))
        shape = len(blocks), self._channels
        score, information = np.empty(shape), np.empty(shape)
        for channel in range(self._channels):
            column = self._column(blocks, channel)
            score[:, channel] = self._score[:, channel] - column @ self._means
            explained = np.einsum("ni,ij,nj->n", column, self._covariance, column)
            information[:, channel] = self._information[:, channel, channel] - explained
        information = np.maximum(information, 0.0) + GAIN_CHANGE**-2
        return ChangeCandidates(score**2 / information, score / information, information)


def find_changes(history: History, floor: Floats) -> list[Change]:
    """Return the changes that are certain, the likeliest first; `floor` as for `Gains`.

    A change below the floor is none: calibration left as much. Where two channels explain the contacts about as well,
    none of them is named.
    """
    changes: list[Change] = []
    if not history.blocks:
        return changes
    after = history.after()
    certain = CERTAIN + 2 * np.log(max(1.0, len(floor) / 4))
    while len(changes) < 2 * len(floor):
        candidates = Gains(history, floor, changes).candidates()
        ratio = np.where(np.abs(candidates.gain) >= floor, candidates.ratio, 0.0)
        block, channel = (int(place) for place in np.unravel_index(int(ratio.argmax()), ratio.shape))
        most = ratio[block, channel]
        others = np.delete(ratio.max(axis=0), channel)
        # A contact near a support says little of any gain, so the change may as well have begun before it.
        likely = np.flatnonzero(ratio[:, channel] > most - NEAR)
        if most <= certain or most - others.max(initial=0.0) < APART or after[likely[0]] < MIN_CONTACTS:
            break
        changes.append(Change(block, channel))
    return changes


NEWEST = 8
"""Newest contacts, whose rests give the present zero."""
DRIFT = 4.0
"""A zero that moved by less than this many standard deviations of the stated drift has not changed."""
CERTAIN_ZERO = 28.0
"""Square of the move beyond that, over its variance, above which a change is certain."""
EXACT_MM = 1e-7
"""Smallest standard deviation of a zero; a scene may state none."""


def zero_of(history: History, channel: int, zero_mm: float) -> tuple[Estimate, int] | None:
    """Return how the zero of a channel has changed, and the block with which it began; None if no rest was seen.

    A zero drifts by `zero_mm` (standard deviation) after a tare.
    """
    weight, total = history.since("rest_weight")[:, channel], history.since("rest_sum")[:, channel]
    if not weight[0] > 0:
        return None
    after, seen = history.after(), weight > 0
    # Before the first contact the zero was where the tare put it, up to its drift.
    weight_before = weight[0] - weight + 1 / max(zero_mm, EXACT_MM) ** 2
    before = (total[0] - total) / weight_before
    mean = np.divide(total, weight, out=np.zeros_like(total), where=seen)
    variance = np.divide(1.0, weight, out=np.full_like(weight, np.inf), where=seen)
    ratio = np.where(after >= MIN_CONTACTS, _beyond(mean - before, zero_mm) ** 2 / (variance + 1 / weight_before), 0.0)
    change, newest = int(ratio.argmax()), _last(after, seen, min(NEWEST, after[0] / 2))

    def moved(first: int) -> tuple[float, float]:
        """Return how far the zero is now from where it was before a block, with its variance."""
        return float(mean[newest] - before[first]), float(variance[newest] + 1 / weight_before[first])

    # A zero that creeps has moved before it is seen to: it is compared with the first half of what was before.
    value, spread = moved(_last(after, seen, (after[0] + after[change]) / 2))
    if min(ratio[change], _beyond(np.array(value), zero_mm) ** 2 / spread) > CERTAIN_ZERO:
        return Estimate.of(value, spread**0.5, changed=True), change
    half = _last(after, seen, after[0] / 2)
    value, spread = moved(half)
    return Estimate.of(value, spread**0.5, changed=False), half


def _beyond(moved_mm: Floats, zero_mm: float) -> Floats:
    """Return how far changes exceed the drift."""
    beyond: Floats = np.maximum(np.abs(moved_mm) - DRIFT * zero_mm, 0.0)
    return beyond


def _last(after: Floats, seen: Bools, contacts: float) -> int:
    """Return the last block with a rest and at least this many contacts from it on."""
    return int(np.flatnonzero((after >= contacts) & seen)[-1])
