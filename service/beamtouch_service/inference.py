"""One sample through the model, and how long that takes."""

from bisect import bisect_left
from time import perf_counter

import numpy as np

from beamtouch_models.modelfile import ModelFile

BUCKETS_S = (10e-6, 20e-6, 50e-6, 100e-6, 200e-6, 500e-6, 1e-3, 2e-3, 5e-3, 10e-3)
"""Upper ends, of durations [s]."""


class Durations:
    """A histogram of durations."""

    def __init__(self) -> None:
        self.counts = [0] * (len(BUCKETS_S) + 1)
        """One per bucket and one for what is longer."""
        self.sum_s = 0.0

    def add(self, duration_s: float) -> None:
        """Count a duration [s]."""
        self.counts[bisect_left(BUCKETS_S, duration_s)] += 1
        self.sum_s += duration_s


class Inference:
    """Asks a model about one sample at a time, always from the same two arrays."""

    def __init__(self, model: ModelFile, durations: Durations) -> None:
        self._durations = durations
        self._run = model.session.run
        self._outputs = list(model.outputs)
        count = len(model.channels)
        self._deflection_mm = np.zeros((1, count), np.float32)
        self._valid = np.zeros((1, count), np.bool_)
        self._inputs = {"deflection_mm": self._deflection_mm, "valid": self._valid}

    def estimate(self, deflection_mm: list[float], valid: list[bool]) -> dict[str, float]:
        """Return a value per output for the deflections [mm] of the channels in the order of the model."""
        begin_s = perf_counter()
        self._deflection_mm[0] = deflection_mm
        self._valid[0] = valid
        answers = self._run(self._outputs, self._inputs)
        estimate = {name: float(value[0]) for name, value in zip(self._outputs, answers, strict=True)}
        self._durations.add(perf_counter() - begin_s)
        return estimate
