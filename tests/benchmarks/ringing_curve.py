"""A beam that rings: error, interval and first contact by the time since a touch, and what a reading costs.

`python tests/benchmarks/ringing_curve.py MODEL [--draws 60]` plays sudden forces from rest and 0.7 s after a lift, with
the filter as it is and without the fit of the swings.
"""

import argparse
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.challenge.judge import Judged, Said, judge
from beamtouch_models.challenge.play import Drawn, Make, Play, SimulatedSurface
from beamtouch_models.challenge.ringing import lifts, rings, touches_again
from beamtouch_models.filters.ringing import Ringing
from beamtouch_models.loading import ModelFile, load
from beamtouch_models.pricing.noise import chain_of

SINCE_MS = (10, 20, 30, 50, 80, 100, 200, 500)
LIFT_S = 0.7
NEVER_MS = 1e4
BATCHES = (1, 20)
"""Readings that reach the filter at once: of a polled device, and of a line that delivers bursts."""


@contextmanager
def following(*, is_on: bool) -> Iterator[None]:
    """Let the filter follow swings, or not."""
    if is_on:
        yield
        return
    with patch.object(Ringing, "follow", return_value=([], None)):
        yield


def played(surface: SimulatedSurface, make: Make, draws: int) -> tuple[Play, Floats]:
    """Return a play and its readings."""
    rng = np.random.default_rng(7)
    play = make(Drawn.of(surface, draws, rng))
    return play, surface.world.readings(play.deflection_mm, play.errors, rng)


def errors(surface: SimulatedSurface, play: Play, said: Judged, began: int) -> None:
    """Print mean error in percent of the length, and the share of intervals that hold, by the time since a touch."""
    for ms in SINCE_MS:
        at = began + max(0, round(ms * 1e-3 * surface.metadata.sensor.rate_hz - 0.5))
        truth, contact = play.truth_mm[:, at], said.said[:, at] == Said.CONTACT
        off = np.abs(said.position_mm[:, at] - truth)[contact] / surface.metadata.length_mm * 100
        held = ((said.low_mm[:, at] <= truth) & (truth <= said.high_mm[:, at]))[contact]
        if len(off):
            print(f"    {ms:4d} ms  error {off.mean():5.2f} %  median {np.median(off):5.2f} %  held {held.mean():4.0%}")


def first_ms(surface: SimulatedSurface, said: Judged, state: Said, began: int) -> str:
    """Return after what time a state begins, in half of the plays and in 95 %."""
    there = said.said[:, began:] == state
    first = np.where(there.any(axis=1), there.argmax(axis=1) / surface.metadata.sensor.rate_hz * 1e3, NEVER_MS)
    half, most = np.percentile(first, [50, 95], method="higher")
    return f"{half:.0f} ms, 95 %: {'later' if most == NEVER_MS else f'{most:.0f} ms'}"


def costs(model: ModelFile, surface: SimulatedSurface, readings: Floats, began: int) -> None:
    """Print what a reading costs, with and without, one after the other."""
    metadata, second = model.metadata, int(model.metadata.sensor.rate_hz)
    seen = surface.slowest_period, surface.unseen_swing
    chain = chain_of(
        metadata.filter, surface.channels, metadata.noise.reading_mm, metadata.sensor.gain_mm_per_count, *seen
    )
    for batch in BATCHES:
        for what, begin, end in (("rest", began - second // 2, began - 2), ("ringing", began, began + second // 2)):
            taken: dict[bool, list[float]] = {True: [], False: []}
            for one in readings[:6]:
                for is_on, spent in taken.items():
                    chain.restart()
                    chain.apply(one[:begin])
                    with following(is_on=is_on):
                        start = time.process_time()
                        for at in range(begin, end, batch):
                            chain.apply(one[at : min(at + batch, end)])
                        spent.append((time.process_time() - start) / (end - begin) * 1e6)
            on, off = (np.median(taken[is_on]) for is_on in (True, False))
            print(f"    {what}, {batch} at once: {off:.0f} us without, {on:.0f} us with, {on / off:.2f} times")


def main(path: Path, draws: int) -> None:
    """Print all figures of a model."""
    model = load(path)
    surface = SimulatedSurface.of(model.metadata)
    rate_hz = surface.metadata.sensor.rate_hz
    before = round(LIFT_S * rate_hz)
    for is_on in (False, True):
        print("with the fit of the swings" if is_on else "without")
        with following(is_on=is_on):
            for make, name, extra in (
                (rings, "from rest", 0),
                (partial(touches_again, after_s=LIFT_S), f"{LIFT_S:g} s after a lift", before),
            ):
                play, readings = played(surface, make, draws)
                began = surface.look_back + extra
                said = judge(surface, model.run, readings, began - surface.decided - extra)
                print(f"  sudden force {name}: contact after {first_ms(surface, said, Said.CONTACT, began)}")
                errors(surface, play, said, began)
            play, readings = played(surface, lifts, draws)
            said = judge(surface, model.run, readings, surface.look_back - surface.decided)
            print(f"  lift: clear after {first_ms(surface, said, Said.CLEAR, surface.look_back)}")
    print("processor time of a reading")
    costs(model, surface, played(surface, rings, 6)[1], surface.look_back)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("--draws", type=int, default=60)
    given = parser.parse_args()
    main(given.model, given.draws)
