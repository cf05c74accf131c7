"""Changes of single channels in a history of contacts: a likelihood ratio for every channel and time of change.

The gain errors g of the beginning have the floor of the model as their prior. A change adds one unknown to the gain of
a channel, from some block on. It is fitted together with all others, so its likelihood ratio counts only what neither
the other channels' first errors nor earlier changes explain.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.health.history import History

CERTAIN = 27.0
"""Twice the logarithm of the likelihood ratio that names a change of one of four gains: one false name in 1e6 contacts
(measured: docs/figures.md). Of more channels, one is the more often wrong by chance."""
APART = 7.0
"""The ratio of a channel that is named exceeds that of every other channel by this much: odds of 30."""
MIN_CONTACTS = 3
"""Fewest contacts since a change that is named."""
NEAR = 2.0
"""Times of a change whose ratios differ by less than this are about as likely."""
GAIN_CHANGE = 0.5
"""Standard deviation of the prior of a change of a gain; it bounds intervals of channels of which nothing is seen."""
EXACT = 1e-4
"""Smallest standard deviation of the gain errors of the beginning; a scene may state none."""


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
        later = [self._information[np.maximum(blocks, one.block)][:, one.channel, channel] for one in self._changes]
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
        found = Gains(history, floor, changes).candidates()
        ratio = np.where(np.abs(found.gain) >= floor, found.ratio, 0.0)
        block, channel = (int(place) for place in np.unravel_index(int(ratio.argmax()), ratio.shape))
        most = ratio[block, channel]
        others = np.delete(ratio.max(axis=0), channel)
        # A contact near a support says little of any gain, so the change may as well have begun before it.
        likely = np.flatnonzero(ratio[:, channel] > most - NEAR)
        if most <= certain or most - others.max(initial=0.0) < APART or after[likely[0]] < MIN_CONTACTS:
            break
        changes.append(Change(block, channel))
    return changes
