"""Inference times of many graphs, measured in turns, so that other load on the machine affects all of them alike."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Floats32
from beamtouch_models.metadata import INPUTS
from beamtouch_models.progress import Fraction, silent
from beamtouch_models.session import open_session

ROUNDS, CALLS = 40, 50
BATCH, BATCH_CALLS = 1000, 1


@dataclass(frozen=True)
class Times:
    """Inference times in microseconds."""

    p50_us: float
    """Median for single samples."""
    p99_us: float
    batch_us: float
    """Time per sample in batches of a thousand."""


def inference_times(
    graphs: Sequence[tuple[bytes, Floats32, Floats32]],
    progress: Fraction = silent,
    rounds: int = ROUNDS,
) -> list[Times]:
    """Time graphs, each with the deflection (1, channels) of a contact and its whitening (1, channels, channels)."""
    runs = [_session(*graph) for graph in graphs]
    single: list[list[int]] = [[] for _ in runs]
    many: list[list[int]] = [[] for _ in runs]
    for turn in range(rounds):
        progress(turn / rounds)
        for (one, batch), times, batch_times in zip(runs, single, many, strict=True):
            _time(one, CALLS, times)
            _time(batch, BATCH_CALLS, batch_times)
    return [
        Times(
            float(np.quantile(one, 0.5)) / 1e3,
            float(np.quantile(one, 0.99)) / 1e3,
            float(np.median(batch)) / 1e3 / BATCH,
        )
        for one, batch in zip(single, many, strict=True)
    ]


def _session(
    content: bytes, reading: Floats32, whitening: Floats32
) -> tuple[Callable[[], object], Callable[[], object]]:
    session = open_session(content)
    feeds = [
        dict(zip(INPUTS, (np.tile(reading, (batch, 1)), np.tile(whitening, (batch, 1, 1))), strict=True))
        for batch in (1, BATCH)
    ]
    return lambda: session.run(None, feeds[0]), lambda: session.run(None, feeds[1])


def _time(call: Callable[[], object], calls: int, times: list[int]) -> None:
    for _ in range(calls):
        start = time.perf_counter_ns()
        call()
        times.append(time.perf_counter_ns() - start)
