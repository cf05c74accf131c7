"""How fast a change of a sensor is named, and how often one is named by chance: contacts drawn from the scene."""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

from bench_calibration import model_of

from beamtouch_models.runtime import Health
from models.drawn_contacts import SuccessiveContacts

RUNS, BASELINE = 100, 200
HONEST = 20_000
"""Contacts without a change."""
RESTED_MS = 250
"""A contact that has rested; the mean of its readings."""
LATEST = {0.04: 8, 0.01: 60}
"""Change -> contacts after which a run ends."""
GOALS = {0.04: 3, 0.01: 20}


def run() -> list[dict[str, object]]:
    """Contacts until a gain that falls is named, for each channel of two scenes."""
    rows: list[dict[str, object]] = []
    for name in ("bench", "conveyor"):
        drawn = SuccessiveContacts(model_of(name))
        rested = round(RESTED_MS * drawn.metadata.sensor.rate_hz / 1e3)
        for readings in (None, rested):
            label = f"{name}, {readings or drawn.metadata.filter.window} readings"
            for fall in GOALS:
                rows += [_power(drawn, label, readings, fall, channel) for channel in range(len(drawn.gain))]
        rows += [_honest(drawn, name), _creep(drawn, name)]
    return rows


def _power(drawn: SuccessiveContacts, label: str, readings: int | None, fall: float, channel: int) -> dict[str, object]:
    """Return in which part of the runs a channel is named in time, and after how many contacts in 90 % of them."""
    needed = []
    wrong = 0
    for seed in range(RUNS):
        drawn.begin(seed, readings)
        health = Health(drawn.metadata)
        health.add(drawn.contacts(BASELINE))
        drawn.gain[channel] *= 1 - fall
        count = LATEST[fall] + 1
        for number in range(1, LATEST[fall] + 1):
            health.add(drawn.contacts(1))
            named = [place for place, one in enumerate(health.channels()) if one.gain.changed]
            if named:
                wrong += named != [channel]
                count = number if named == [channel] else count
                break
        needed.append(count)
    goal = GOALS[fall]
    return {
        "name": f"{label}: s{channel + 1} falls by {fall:.0%}, named within {goal} contacts",
        "value": float(np.mean(np.array(needed) <= goal) * 100),
        "unit": "%",
        "goal": "90",
        "half within": float(np.quantile(needed, 0.5)),
        "90 % within": float(np.quantile(needed, 0.9)),
        "another named, runs": wrong,
    }


def _honest(drawn: SuccessiveContacts, name: str) -> dict[str, object]:
    """Return how many channels are named without a change."""
    named = 0
    for seed in range(HONEST // 1000):
        drawn.begin(1000 + seed)
        health = Health(drawn.metadata)
        for _ in range(100):
            health.add(drawn.contacts(10))
            named += any(one.gain.changed or (one.zero is not None and one.zero.changed) for one in health.channels())
    return {
        "name": f"{name}: named without a change, in {HONEST} contacts",
        "value": float(named),
        "unit": "",
        "goal": "0",
    }


def _creep(drawn: SuccessiveContacts, name: str) -> dict[str, object]:
    """Return in which part of the runs a zero that creeps is named as a zero, and as no gain."""
    right = 0
    for seed in range(RUNS):
        drawn.begin(2000 + seed)
        health = Health(drawn.metadata)
        health.add(drawn.contacts(BASELINE))
        channel = seed % len(drawn.gain)
        for _ in range(100):
            drawn.zero_mm[channel] += drawn.metadata.floor.zero_mm[channel] / 8
            health.add(drawn.contacts(1))
        found = health.channels()
        zeros = [place for place, one in enumerate(found) if one.zero is not None and one.zero.changed]
        right += zeros == [channel] and not any(one.gain.changed for one in found)
    return {
        "name": f"{name}: a zero creeps by 12 drifts, and is no gain",
        "value": right * 100 / RUNS,
        "unit": "%",
        "goal": "90",
    }
