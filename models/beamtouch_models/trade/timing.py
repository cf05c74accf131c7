"""Inference times of many graphs, measured in turns, so that other load on the machine affects all of them alike."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Floats32
from beamtouch_models.metadata import INPUTS
from beamtouch_models.session import open_session

ROUNDS, CALLS = 40, 50


@dataclass(frozen=True)
class Times:
    """Times of an inference of a single sample in microseconds."""

    p50_us: float
    p50_standard_error_us: float
    """From the scatter of the rounds."""
    p99_us: float


def inference_times(graphs: Sequence[tuple[bytes, Floats32, Floats32]]) -> list[Times]:
    """Time graphs, each with the deflection (1, channels) of a contact and its whitening (1, channels, channels)."""
    runs = [(open_session(content), dict(zip(INPUTS, feed, strict=True))) for content, *feed in graphs]
    times = np.empty((len(runs), ROUNDS, CALLS))
    for turn in range(ROUNDS):
        for (session, feed), taken in zip(runs, times[:, turn], strict=True):
            for call in range(CALLS):
                start = time.perf_counter_ns()
                session.run(None, feed)
                taken[call] = (time.perf_counter_ns() - start) / 1e3
    return [
        Times(
            float(np.median(one)),
            float(np.median(one, axis=1).std(ddof=1) / ROUNDS**0.5),
            float(np.quantile(one, 0.99)),
        )
        for one in times
    ]
