"""A beam that rings: error, interval and first contact by the time since a touch, and what a reading costs.

`python tests/benchmarks/ringing_curve.py MODEL ... [--draws 60]` plays sudden forces from rest and 0.7 s after a lift,
with the filter as it is and without the fit of the swings. Beside them are two references that know the instant of the
touch: the mean of all readings since, and the posterior of one who knows all modes of the beam, gains and zeros.
`--cost` prints what a reading costs instead, at rest, while the beam rings and while a load moves.
"""

import argparse
import time
from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from functools import partial
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import numpy as np

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.design.pricing.noise import chain_of
from beamtouch_models.filters.ringing import Ringing
from beamtouch_models.lab.challenge.contacts import moves
from beamtouch_models.lab.challenge.judge import Outcome, Verdicts, judge
from beamtouch_models.lab.challenge.play import DrawnContacts, Make, Play, SimulatedSurface
from beamtouch_models.lab.challenge.ringing import lifts, rings, touches_again
from beamtouch_models.runtime.decision.evidence import Weighed, evidence
from beamtouch_models.runtime.loading import ModelFile, load

SINCE_MS = (10, 20, 30, 50, 80, 100, 200, 500, 1000)
LIFT_S = 0.7
NEVER_MS = 1e4
BATCHES = (1, 20)
"""Readings that reach the filter at once: of a polled device, and of a line that delivers bursts."""
PLACES = 401
"""Places among which the one who knows all modes decides."""
COST_DRAWS, COST_S = 8, 0.5
SPEED_MM_PER_S = 100.0


class Played(NamedTuple):
    """A play, and what sensors read of it."""

    play: Play
    readings: Floats
    perfect: Floats
    """Readings of sensors that have noise, and no other errors."""
    offset: Floats
    """Of the times of readings, (draws, 1), in readings."""


@contextmanager
def following(*, is_on: bool) -> Iterator[None]:
    """Let the filter follow swings, or not."""
    if is_on:
        yield
        return
    with patch.object(Ringing, "follow", return_value=([], None)):
        yield


def played(surface: SimulatedSurface, make: Make, draws: int) -> Played:
    """Return a play and its readings."""
    rng = np.random.default_rng(7)
    at = DrawnContacts.of(surface, draws, rng)
    offset = deepcopy(rng).uniform(size=(draws, 1))
    play = make(at)
    honest, perfect = (surface.world.readings(play.deflection_mm, errors, rng) for errors in (play.errors, at.perfect))
    return Played(play, honest, perfect, offset)


def places(surface: SimulatedSurface, began: int, readings: int) -> list[int]:
    """Return the readings at which errors are stated, as far as a play has them."""
    after = [began + max(0, round(ms * 1e-3 * surface.metadata.sensor.rate_hz - 0.5)) for ms in SINCE_MS]
    return [at for at in after if at < readings]


def line(name: str, position_mm: Floats, truth_mm: Floats, there: Bools, length_mm: float) -> str:
    """Return the mean errors in percent of the length as a row of a table; all have shape (draws, times)."""
    off = np.where(there, np.abs(position_mm - truth_mm), np.nan) / length_mm * 100
    cells = [f"{np.nanmean(one):.2g}" if np.isfinite(one).any() else "" for one in off.T]
    return f"| {' | '.join([name, *cells])} |"


def said_lines(surface: SimulatedSurface, name: str, verdicts: Verdicts, play: Play, began: int) -> list[str]:
    """Return the errors of a play, and the share of intervals that hold."""
    at = places(surface, began, play.truth_mm.shape[1])
    truth, contact = play.truth_mm[:, at, 0], verdicts.outcome[:, at] == Outcome.CONTACT
    held = ((verdicts.low_mm[:, at, 0] <= truth) & (truth <= verdicts.high_mm[:, at, 0]) & contact).sum(axis=0)
    shares = [f"{100 * one / of:.0f}" if of else "" for one, of in zip(held, contact.sum(axis=0), strict=True)]
    errors = line(name, verdicts.place_mm[:, at, 0], truth, contact, surface.metadata.length_mm)
    return [errors, f"| ... intervals that hold, % | {' | '.join(shares)} |"]


def mean_since(surface: SimulatedSurface, model: ModelFile, of: Played, began: int) -> str:
    """Return the errors of the mean of all readings since the touch."""
    at = places(surface, began, of.readings.shape[1])
    found = np.full((len(of.readings), len(at)), np.nan)
    noise_mm2, channels = surface.metadata.noise.reading_mm**2, surface.channels
    for column, end in enumerate(at):
        mean = of.readings[:, began : end + 1].mean(axis=1)
        whole = np.flatnonzero(~np.isnan(mean).any(axis=1))
        white = np.full((len(whole), channels), noise_mm2 / (end + 1 - began))
        samples = Weighed(mean[whole], white[:, :, None] * np.eye(channels), white, np.ones(white.shape, np.bool_))
        found[whole, column] = [one.answer["position_mm"] for one in evidence(surface.metadata, model.run, samples)]
    return line(
        "mean since a known touch", found, of.play.truth_mm[:, at, 0], ~np.isnan(found), surface.metadata.length_mm
    )


def knowing_all(surface: SimulatedSurface, of: Played, began: int) -> str:
    """Return the errors of the posterior mean of one who knows the modes of the beam and the instant of the touch."""
    world, metadata = surface.world, surface.metadata
    at = places(surface, began, of.readings.shape[1])
    where = np.linspace(*metadata.ranges.position_mm, PLACES)
    static, force = world.under(where, np.ones(PLACES)), np.ones(PLACES)
    found = np.full((len(of.readings), len(at)), np.nan)
    for draw, (readings, offset) in enumerate(zip(of.perfect[:, began : at[-1] + 1], of.offset, strict=True)):
        seconds = np.broadcast_to(
            (np.arange(len(readings)) + offset) / metadata.sensor.rate_hz, (PLACES, len(readings))
        )
        each = static[:, None] + world.ringing_mm(where, force, seconds)
        each = np.where(np.isnan(readings), 0.0, each) / metadata.noise.reading_mm
        alike = np.cumsum((each * np.nan_to_num(readings / metadata.noise.reading_mm)).sum(axis=2), axis=1)
        square = np.cumsum((each * each).sum(axis=2), axis=1)
        for column, end in enumerate(at):
            like, size = alike[:, end - began], np.maximum(square[:, end - began], 1e-9)
            weight = np.maximum(like, 0.0) ** 2 / size / 2
            weight = np.exp(weight - weight.max()) / np.sqrt(size)
            found[draw, column] = weight @ where / weight.sum()
    truth = of.play.truth_mm[:, at, 0]
    return line("posterior, modes, gains and zeros known", found, truth, ~np.isnan(found), metadata.length_mm)


def first_ms(surface: SimulatedSurface, verdicts: Verdicts, state: Outcome, began: int) -> str:
    """Return after what time a state begins, in half of the plays and in 95 %."""
    there = verdicts.outcome[:, began:] == state
    first = np.where(there.any(axis=1), there.argmax(axis=1) / surface.metadata.sensor.rate_hz * 1e3, NEVER_MS)
    half, most = np.percentile(first, [50, 95], method="higher")
    return " / ".join("later" if one == NEVER_MS else f"{one:.0f}" for one in (half, most))


def curve(path: Path, draws: int) -> None:
    """Print the curves of a model."""
    model = load(path)
    surface = SimulatedSurface.of(model.metadata)
    rate_hz, began = surface.metadata.sensor.rate_hz, surface.look_back
    before = round(LIFT_S * rate_hz)
    long = partial(rings, least=round(SINCE_MS[-1] * 1e-3 * rate_hz) + 1)
    print(f"{path.stem}: error in percent of the length, by ms since the touch; ms are of half of the plays / of 95 %")
    print(f"| | {' | '.join(str(ms) for ms in SINCE_MS)} |\n|{'---|' * (1 + len(SINCE_MS))}")
    of = played(surface, long, draws)
    times = []
    for is_on, name in ((False, "without"), (True, "with the fit")):
        with following(is_on=is_on):
            verdicts = judge(surface, model.run, of.readings, began - surface.decided)
            print("\n".join(said_lines(surface, name, verdicts, of.play, began)))
            again = played(surface, partial(touches_again, after_s=LIFT_S), draws)
            first = first_ms(surface, verdicts, Outcome.CONTACT, began)
            verdicts = judge(surface, model.run, again.readings, began - surface.decided)
            print(
                "\n".join(
                    said_lines(surface, f"{name}, {LIFT_S:g} s after a lift", verdicts, again.play, began + before)
                )
            )
            second = first_ms(surface, verdicts, Outcome.CONTACT, began + before)
            lifted = played(surface, lifts, draws)
            verdicts = judge(surface, model.run, lifted.readings, began - surface.decided)
            clear = first_ms(surface, verdicts, Outcome.CLEAR, began)
            times.append(f"{name}: contact {first} ms, {LIFT_S:g} s after a lift {second} ms, clear {clear} ms")
    print(mean_since(surface, model, of, began))
    print(knowing_all(surface, of, began))
    print("\n".join(times))


def costs(path: Path) -> None:
    """Print what a reading costs, with and without, one after the other."""
    metadata = load(path).metadata
    surface = SimulatedSurface.of(metadata)
    began, many = surface.look_back, int(COST_S * metadata.sensor.rate_hz)
    seen = surface.slowest_period, surface.unseen_swing
    chain = chain_of(
        metadata.filter, surface.channels, metadata.noise.reading_mm, metadata.sensor.gain_mm_per_count, *seen
    )
    ringing = played(surface, partial(rings, least=many), COST_DRAWS).readings
    moving = played(surface, partial(moves, speed_mm_per_s=SPEED_MM_PER_S, least=many), COST_DRAWS).readings
    rest = played(surface, partial(rings, least=many), COST_DRAWS).readings[:, : began - 2]
    print(f"{path.stem}: processor time of a reading, us")
    for batch in BATCHES:
        for what, readings, begin in (
            ("rest", rest, max(0, began - 2 - many)),
            ("ringing", ringing, began),
            ("moving", moving, began),
        ):
            taken: dict[bool, list[float]] = {True: [], False: []}
            for one in readings:
                for is_on, spent in taken.items():
                    chain.restart()
                    chain.apply(one[:begin])
                    end = min(begin + many, len(one))
                    with following(is_on=is_on):
                        start = time.process_time()
                        for at in range(begin, end, batch):
                            chain.apply(one[at : min(at + batch, end)])
                        spent.append((time.process_time() - start) / (end - begin) * 1e6)
            on, off = (np.median(taken[is_on]) for is_on in (True, False))
            print(f"  {what}, {batch} at once: {off:.0f} without, {on:.0f} with, {on / off:.2f} times")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("models", type=Path, nargs="+")
    parser.add_argument("--draws", type=int, default=60)
    parser.add_argument("--cost", action="store_true")
    given = parser.parse_args()
    for model_file in given.models:
        costs(model_file) if given.cost else curve(model_file, given.draws)
