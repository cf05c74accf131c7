"""The wiring that presses above the sensors show: which channel has which sensor, inverted or dead. Pure.

A press above a sensor moves its neighbours, too. So each press is compared with the influence of the model, channel by
channel, for every way to wire the sensors that is looked for. The force of a press is not known, and its place only
about; both are those that fit best.
"""

import math
from collections.abc import Callable, Generator, Iterable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamtouch_service.commissioning.pressing import Floats

Influence = Callable[[Floats], Floats]
"""Places (places, axes) in mm -> deflection at each sensor (places, sensors) in mm/N."""

FAULT = 2 * math.log(100.0)
"""Price of a fault in a wiring, as a sum of squares: one cable or sensor in a hundred is taken to be wrong. The same
decides between two wirings: the better one must be a hundred times as likely."""
TOLERANCE = 0.03
"""Error of a movement, as a part of the largest one of its press, as a standard deviation: gains and mounting of a
surface that is not calibrated yet."""
PLACE_SD_MM = 4.0
"""Standard deviation of the place at which a person presses when asked to press above a sensor."""
REACH = 2.0
"""Places of a press are tried up to so many deviations from the place that was asked for, along each axis."""
TRIED = (17, 9)
"""Number of coordinates that are tried along the axis of a beam, and along each axis of a plate."""
EXPLAINED = 4.0
"""A press is explained if the mean square of its errors over its channels is at most this: two deviations."""
SEEN = 3.0
"""Nothing is said of a channel whose sensor should move by less than this many deviations, in all presses together."""
KEPT = 16
"""Number of the best wirings to which one more fault is added. The search is a beam of this width."""
_ROUNDING = 1e-6
"""A wiring that explains as much with one fault more costs the price of that fault: rounding makes it no rival."""
_TINY = float(np.finfo(np.float64).tiny)


class Press(NamedTuple):
    """A press at a place of the structure."""

    at_mm: Floats
    """The channel's place in the layout (axes,)."""
    moved_mm: Floats
    """Movement of each channel (channels,) from rest, positive in the direction of the load; NaN for one that had
    mostly no values: nothing is known of it then."""
    noise_mm: Floats
    """Standard deviation of these (channels,)."""


class Wiring(NamedTuple):
    """The sensor on each channel."""

    sensors: tuple[int, ...]
    """Index of the sensor whose movement the channel shows."""
    signs: tuple[int, ...]
    """1 as it should be, -1 inverted, 0 dead; the sensor of a dead channel is not known, and stated as its own."""

    @property
    def moved(self) -> dict[int, int]:
        """Channel -> sensor, where these differ."""
        return {channel: sensor for channel, sensor in enumerate(self.sensors) if channel != sensor}


class Explanation(NamedTuple):
    """The wiring that explains presses best."""

    wiring: Wiring
    rivals: list[Wiring]
    """Others that explain them about as well."""
    is_explained: bool
    """True if it explains every press, with a gain of its own for each channel."""
    forces_n: list[float]
    """Force of each press."""
    shares: Floats
    """Movement of each channel over that expected of the sensor that it shows (channels,), relative to the others:
    -1 for an inverted one, 0 for a dead one. NaN where that sensor moves too little to be seen."""


def explain(presses: Sequence[Press], influence: Influence) -> Generator[None, None, Explanation]:
    """Return, after some steps, the wiring that explains presses best, and those that explain them about as well.

    Parameters
    ----------
    presses : at least one
    influence : of the model, its channels in the order of those of the presses
    """
    moved_mm, noise_mm = np.array([one.moved_mm for one in presses]), np.array([one.noise_mm for one in presses])
    moved_mm[:, np.isnan(moved_mm).all(axis=0)] = 0.0  # a channel that never has values is dead
    fits = [_Fit(one._replace(moved_mm=moved), influence) for one, moved in zip(presses, moved_mm, strict=True)]
    prices = yield from _search(fits, len(presses[0].moved_mm))
    best = min(prices, key=lambda wiring: prices[wiring])
    rivals = [one for one, price in prices.items() if one != best and price < prices[best] + FAULT - _ROUNDING]
    each = [fit.best(best) for fit in fits]
    expected_mm = np.array([one.moved_mm[list(best.sensors)] for one in each])
    shares = _shares(moved_mm, expected_mm, noise_mm)
    left = (moved_mm - np.nan_to_num(shares, nan=1.0) * expected_mm) / np.array([fit.deviation_mm for fit in fits])
    return Explanation(
        best,
        sorted(rivals, key=lambda wiring: prices[wiring]),
        bool((np.nanmean(left**2, axis=1) <= EXPLAINED).all()),
        [one.force_n for one in each],
        _next_to_others(shares, np.isfinite(shares) & (np.array(best.signs) != 0)),
    )


class _Best(NamedTuple):
    """A press at the place and with the force that fit it best under one wiring."""

    force_n: float
    moved_mm: Floats
    """Expected movement of each sensor (sensors,)."""
    square: float
    """Sum of the squares of what is left."""


class _Fit:
    """One press, and what the model expects of it at each place that is tried.

    With m for how the channels moved and g for what they should per newton, both over their deviations, the force that
    fits best is m.g / g.g, and leaves m.m - (m.g)^2 / g.g. Each channel adds to the two sums on its own.
    """

    def __init__(self, press: Press, influence: Influence) -> None:
        tolerance_mm = TOLERANCE * np.nanmax(np.abs(press.moved_mm))
        self.deviation_mm = np.sqrt(press.noise_mm**2 + tolerance_mm**2)
        """Standard deviation of the movement of each channel (channels,)."""
        reach = _reach(len(press.at_mm))
        self._per_newton = influence(press.at_mm + PLACE_SD_MM * reach)
        weight = np.isfinite(press.moved_mm) / self.deviation_mm
        moved = np.nan_to_num(press.moved_mm) * weight
        self._square = moved @ moved + (reach**2).sum(axis=1)
        """The squares that a press leaves without any force, plus the improbability of its place (places,)."""
        expected = self._per_newton[:, None] * weight[:, None]
        self._along, self._own = expected * moved[:, None], expected**2
        """The terms that each channel adds to m.g and g.g with each sensor (places, channels, sensors)."""

    def best(self, wiring: Wiring) -> _Best:
        """Return how one wiring fits the press."""
        each, sensors, signs = np.arange(len(wiring.signs)), list(wiring.sensors), np.array(wiring.signs)
        along = self._along[:, each, sensors] @ signs
        own = self._own[:, each, sensors] @ signs**2
        squares = self._left(along, own)
        place = squares.argmin()
        force_n = max(0.0, float(along[place])) / max(float(own[place]), _TINY)
        return _Best(force_n, force_n * self._per_newton[place], float(squares[place]))

    def squares_with_one_more(self, wiring: Wiring) -> Floats:
        """Return the least sums of squares of the wirings with one more fault, in the order of `_with_one_more`."""
        signs = np.array(wiring.signs)
        along = _sums_with_one_more(self._along, wiring, signs, (2, 1))
        own = _sums_with_one_more(self._own, wiring, signs**2, (0, 1))
        squares: Floats = self._left(along, own).min(axis=0)
        return squares

    def _left(self, along: Floats, own: Floats) -> Floats:
        """Return what is left with the best force of each place, from m.g and g.g (places, ...); a force presses."""
        left: Floats = (self._square - (np.maximum(along, 0.0) ** 2 / np.maximum(own, _TINY)).T).T
        return left


def _reach(axes: int) -> Floats:
    """Return the places of a press that are tried (places, axes), in deviations from the place that was asked for."""
    ticks = np.linspace(-REACH, REACH, TRIED[axes - 1])
    return np.stack(np.meshgrid(*[ticks] * axes, indexing="ij"), axis=-1).reshape(-1, axes)


def _sums_with_one_more(table: Floats, wiring: Wiring, signs: NDArray[np.int_], away: tuple[int, int]) -> Floats:
    """Return sums over the channels of wirings with one more fault (places, wirings), as `_with_one_more` has them.

    Two swapped cables change two terms of a sum. An inverted sensor, and a dead channel, take their own term from it
    `away` times.
    """
    at = table[:, :, list(wiring.sensors)] * signs[:, None]
    own = np.diagonal(at, axis1=1, axis2=2)
    total = own.sum(axis=1)[:, None]
    one, other = np.triu_indices(len(signs), 1)
    swapped = total - own[:, one] - own[:, other] + at[:, one, other] + at[:, other, one]
    single = total[:, :, None] - own[:, signs != 0, None] * np.array(away)
    return np.concatenate([swapped, single.reshape(len(table), -1)], axis=1)


def _search(fits: Sequence[_Fit], channels: int) -> Generator[None, None, dict[Wiring, float]]:
    """Return the price of each wiring that was tried: its sum of squares, and that of its faults."""
    faults = {wiring: count for count, wirings in enumerate(_simple(channels)) for wiring in wirings}
    prices = {wiring: sum(fit.best(wiring).square for fit in fits) + FAULT * count for wiring, count in faults.items()}
    for _ in range(channels):
        squares = dict[Wiring, float]()
        for wiring in sorted(prices, key=lambda wiring: prices[wiring])[:KEPT]:
            more = sum((fit.squares_with_one_more(wiring) for fit in fits), start=np.zeros(1))
            for worse, square in zip(_with_one_more(wiring), more.tolist(), strict=True):
                if worse not in prices:
                    squares[worse] = square
                    faults[worse] = min(faults.get(worse, channels * 2), faults[wiring] + 1)
            yield
        if not squares:
            break
        before = min(prices.values())
        prices |= {wiring: square + FAULT * faults[wiring] for wiring, square in squares.items()}
        # A fault too many costs its price: what is twice that above the best wiring leads to no better one.
        if min(prices[wiring] for wiring in squares) > before + 2 * FAULT:
            break
    return prices


def _simple(channels: int) -> list[list[Wiring]]:
    """Return the right wiring, and those with one fault that is more than one step away: reversed, or all inverted."""
    own, right = tuple(range(channels)), (1,) * channels
    far = [Wiring(own[::-1], right)] if channels > 1 else []
    return [[Wiring(own, right)], [*far, Wiring(own, (-1,) * channels)]]


def _with_one_more(wiring: Wiring) -> Iterable[Wiring]:
    """Yield the wirings with one more fault: two cables swapped, a sensor inverted, a channel dead."""
    sensors, signs = list(wiring.sensors), list(wiring.signs)
    for one, other in combinations(range(len(sensors)), 2):
        swapped = sensors.copy()
        swapped[one], swapped[other] = sensors[other], sensors[one]
        yield _plain(swapped, signs)
    for channel, sign in enumerate(signs):
        for other_sign in (-sign, 0) if sign else ():
            yield _plain(sensors, [*signs[:channel], other_sign, *signs[channel + 1 :]])


def _plain(sensors: Sequence[int], signs: Sequence[int]) -> Wiring:
    """Return a wiring in the form that is the same for all that cannot be told apart."""
    each = enumerate(zip(sensors, signs, strict=True))
    return Wiring(tuple(sensor if sign else channel for channel, (sensor, sign) in each), tuple(signs))


def _shares(moved_mm: Floats, expected_mm: Floats, noise_mm: Floats) -> Floats:
    """Return how far each channel moved over what is expected (channels,), from tables (presses, channels)."""
    expected_mm = np.where(np.isfinite(moved_mm), expected_mm, 0.0)
    moved_mm = np.nan_to_num(moved_mm)
    square = (expected_mm**2).sum(axis=0)
    shares = np.full(len(square), np.nan)
    is_seen = square > (SEEN * noise_mm.max(axis=0)) ** 2
    shares[is_seen] = (moved_mm * expected_mm).sum(axis=0)[is_seen] / square[is_seen]
    return shares


def _next_to_others(shares: Floats, is_alive: NDArray[np.bool_]) -> Floats:
    """Return each share over the median of the other living channels (channels,).

    The force is that which fits best: a sensor that moves too little makes the others seem to move more. With its own
    share in the median, a sensor would hide itself where there are two, or two and two alike.
    """
    found = shares.copy()
    for channel in range(len(shares)):
        is_other = is_alive.copy()
        is_other[channel] = False
        others = np.abs(shares[is_other if is_other.any() else is_alive])
        if len(others):
            found[channel] /= np.median(others)
    return found
