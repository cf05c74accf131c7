"""Processor time of the daemon's filters per sample: the growing mean beside the fixed mean, with their covariances.

`python tests/benchmarks/bench_filters.py [--runs 5]`. Readings of four channels come in pieces of 5 ms, as from a
serial line, or of one reading. Each figure is the least of several runs, which a busy machine disturbs least.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np

from beamtouch_models.filters import Chain, FloatArray, Mean

RATES_HZ = (50, 200, 1000)
PIECE_S = 0.005
LATENCY_S = 0.02
PERIOD_S = 0.11
"""Of the slowest motion of the beam, about that of `bench.toml`."""
SPIKE = 6.0
"""Limit of the spike filter; all values are in units of the noise of a reading."""
CONTACT = np.array([40.0, 80.0, 80.0, 50.0])
WAY_PER_S = np.array([80.0, -30.0, -30.0, 40.0])
"""Of a load that moves at about 100 mm/s on the bench."""
RUNS = 5


def filters(rate_hz: int) -> dict[str, Mean]:
    """Return the filters that are compared."""
    window = max(1, round(LATENCY_S * rate_hz))
    return {
        "fixed": Mean("moving-average", window, spike_mm=SPIKE),
        "growing": Mean("growing-mean", window, rate_hz, SPIKE),
    }


def at_rest(since_s: FloatArray) -> FloatArray:
    """Return a beam without a load."""
    truth: FloatArray = 0.0 * since_s[:, np.newaxis] * CONTACT
    return truth


def touched(since_s: FloatArray) -> FloatArray:
    """Return a beam under a load that rests."""
    truth: FloatArray = (since_s >= 0)[:, np.newaxis] * CONTACT
    return truth


def moving(since_s: FloatArray) -> FloatArray:
    """Return a beam under a load that moves."""
    truth: FloatArray = CONTACT + np.maximum(since_s, 0.0)[:, np.newaxis] * WAY_PER_S
    return truth


COURSES: dict[str, Callable[[FloatArray], FloatArray]] = {
    "at rest": at_rest,
    "first second of a contact": touched,
    "moving": moving,
}


def per_sample_us(mean: Mean, rate_hz: int, truth: FloatArray) -> float:
    """Return the processor time per sample of the last second [us]."""
    rng = np.random.default_rng(0)
    piece = max(1, round(PIECE_S * rate_hz))
    chain = Chain(mean, len(CONTACT), 1.0, PERIOD_S * rate_hz)
    values = truth + rng.standard_normal(truth.shape)
    first = len(values) - rate_hz
    chain.apply(values[:first])
    began = time.process_time()
    for start in range(first, len(values), piece):
        filtered = chain.apply(values[start : start + piece])
        filtered.covariances_mm2(np.flatnonzero(filtered.uncertain))
    return (time.process_time() - began) / rate_hz * 1e6


def run(runs: int = RUNS) -> list[dict[str, object]]:
    """Return a row per rate and course: the time with a growing mean over that with a fixed one."""
    rows: list[dict[str, object]] = []
    for rate_hz in RATES_HZ:
        since_s = np.arange(-2 * rate_hz, rate_hz) / rate_hz
        for name, course in COURSES.items():
            truth = course(since_s)
            least = {
                kind: min(per_sample_us(stages, rate_hz, truth) for _ in range(runs))
                for kind, stages in filters(rate_hz).items()
            }
            ratio = least["growing"] / least["fixed"]
            each = {f"{kind}, us per sample": value for kind, value in least.items()}
            rows.append({"name": f"{rate_hz} Hz, {name}: growing over fixed", "value": ratio, "unit": "times", **each})
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=RUNS, metavar="N", help=f"runs per figure ({RUNS})")
    for row in run(parser.parse_args().runs):
        print(*(f"{key} {value:.3g}" if isinstance(value, float) else value for key, value in row.items()), sep="  ")
